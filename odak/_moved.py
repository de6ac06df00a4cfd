"""Tables of earlier module paths and names, which stay importable."""

import functools
from pathlib import Path

# Modules by the paths that their names had before: a word is a module beside them, one with a dot a path below odak. A
# word may stand with several, which share its names.
FORMER_MODULES: dict[str, str] = {
    "odak.catalog.materials": "dispersion material_files",
    "odak.catalog.optics": "detectors diffusers lenses",
    "odak.cli.report": "pictures",
    "odak.contrib.commands": "visualize.blender.commands visualize.blender.libblend visualize.blender.server "
    "visualize.blender.session "
    "visualize.blender.wrapper",
    "odak.contrib.large_language_model": "tools.large_language_model",
    "odak.contrib.texts": "tools.latex tools.markdown tools.texts",
    "odak.fit.regression": "descent line threshold",
    "odak.jones.calculus": "elements stokes_vectors",
    "odak.learn._tensors": "learn.perception.color_matrices learn.perception.util learn.tools.device",
    "odak.learn.jones.calculus": "elements stokes_vectors",
    "odak.learn.lensless.speckle_tracking": "models",
    "odak.learn.models.gaussians": "volume_losses",
    "odak.learn.models.layers": "_inputs attention components convolutions",
    "odak.learn.models.perceptrons": "components models",
    "odak.learn.models.training": "weights",
    "odak.learn.models.unets": "adaptive adaptive_convolution components models",
    "odak.learn.perception.color": "color_conversion color_difference color_matrices color_spaces",
    "odak.learn.perception.color_vision_deficiency": "cvd_loss_functions",
    "odak.learn.perception.csf": "castle_csf visibility",
    "odak.learn.perception.display_color": "color_conversion observers spectra",
    "odak.learn.perception.foveation": "blur_loss pooling radially_varying_blur",
    "odak.learn.perception.metameric": "metamer_mse_loss metameric_loss metameric_loss_uniform pooling "
    "pyramid_statistics",
    "odak.learn.perception.metamers": "pyramid_statistics",
    "odak.learn.perception.pooled_statistics": "pooling pyramid_statistics",
    "odak.learn.perception.pyramids": "frequency_steerable_pyramid pyramid_filter_design spatial_steerable_pyramid "
    "steerable_pyramid_filters",
    "odak.learn.perception.quality": "contrast eccentricity image_quality_losses learned_perceptual_losses",
    "odak.learn.raytracing.boundary": "cylinders detector",
    "odak.learn.raytracing.mesh": "triangle_hits triangle_search triangles",
    "odak.learn.raytracing.primitives": "cylinders",
    "odak.learn.raytracing.surfaces": "implicit parametric",
    "odak.learn.raytracing.system.analysis": "fans spots wavefronts",
    "odak.learn.raytracing.system.drawing": "analysis_figures reports",
    "odak.learn.raytracing.system.optimise": "tolerances",
    "odak.learn.raytracing.system.pupils": "launching",
    "odak.learn.raytracing.system.sequence": "curved_rays",
    "odak.learn.raytracing.system.surfaces": "coatings lens prescription",
    "odak.learn.raytracing.system.system_files": "lens_files",
    "odak.learn.raytracing.system.tracing": "launching",
    "odak.learn.raytracing.system.waves": "huygens psf",
    "odak.learn.raytracing.system.zemax": "lens_files",
    "odak.learn.tools.file": "checkpoints",
    "odak.learn.tools.matrix": "learn.perception.util mask",
    "odak.learn.tools.models": "fitcurve",
    "odak.learn.tools.transformation": "camera vector",
    "odak.learn.wave.elements": "aberrations lens",
    "odak.learn.wave.fields": "util",
    "odak.learn.wave.gaussians": "complex_gaussians",
    "odak.learn.wave.gaussians.sets": "flat parameters spatial splat_files",
    "odak.learn.wave.gaussians.splatting": "learn.wave.gaussian_tiles learn.wave.splatting",
    "odak.learn.wave.holograms": "classical",
    "odak.learn.wave.loss": "focal_targets perceptual_loss",
    "odak.learn.wave.older.eyebox": "learn.wave.eyebox",
    "odak.learn.wave.older.kernels": "learn.wave.classical learn.wave.kernels learn.wave.light_kernels",
    "odak.learn.wave.older.multi_color": "learn.wave.optimizers learn.wave.optimizers.mixed_color "
    "learn.wave.optimizers.multi_color",
    "odak.learn.wave.older.multiplane": "learn.wave.legacy learn.wave.optimizers learn.wave.optimizers.multiplane",
    "odak.learn.wave.older.propagators": "learn.wave.propagators",
    "odak.learn.wave.older.terms": "learn.wave.optimizers.terms",
    "odak.learn.wave.older.volume": "learn.wave.hardware learn.wave.volume",
    "odak.learn.wave.propagation": "classical partial_coherence",
    "odak.learn.wave.slm": "crosstalk phase_levels",
    "odak.manager.distribute": "failures",
    "odak.measurement.image_quality": "slanted_edge",
    "odak.raytracing.batches": "learn.raytracing.recompute",
    "odak.raytracing.geometry": "watertight",
    "odak.raytracing.interfaces": "phases",
    "odak.raytracing.intersections": "closed_forms status",
    "odak.raytracing.ray": "learn.raytracing.fields fields",
    "odak.raytracing.surfaces": "sag",
    "odak.tools.file": "images",
    "odak.tools.matrix": "conversions nonuniform",
    "odak.tools.transformation": "vector",
    "odak.visualize.blender.items": "materials meshes render_materials",
    "odak.visualize.blender.scenes": "locate process",
    "odak.visualize.blender.shapes": "lens_shapes",
    "odak.visualize.plotly.field_figures": "fields plots show_field",
    "odak.visualize.plotly.figures": "browser figure_style",
    "odak.visualize.plotly.ray_figures": "rays show_system system_figures",
    "odak.wave.coherence": "learn.wave.partial_coherence partial_coherence",
    "odak.wave.elements": "aberrations lens",
    "odak.wave.fields": "learn.wave.util learn.wave.vector double_phase utils vector",
    "odak.wave.imaging": "learn.wave.incoherent_propagation incoherent_propagation",
    "odak.wave.phase_retrieval": "learn.wave.classical learn.wave.spots classical spots",
    "odak.wave.propagation": "learn.wave.classical classical kernels",
    "odak.wave.tilted": "learn.wave.tilted",
    "odak.wave.transfer_functions": "convolution kernel_cache kernels",
    "odak.wave.windows": "learn.wave.windows",
}


def _by_former_path() -> dict[str, tuple[str, ...]]:
    """Return the modules that hold the names of each former path."""
    found: dict[str, tuple[str, ...]] = {}
    for module, words in FORMER_MODULES.items():
        for word in words.split():
            former = f"odak.{word}" if "." in word else f"{module.rpartition('.')[0]}.{word}"
            found[former] = (*found.get(former, ()), module)
    return found


MOVED_MODULES = _by_former_path()

# Names that were exposed in a package unintentionally, with the package they belong to, or that are others now, with
# package:name; they come with a DeprecationWarning.
MOVED_NAMES: dict[str, dict[str, str]] = {
    "odak.catalog": {"Material": "odak.catalog:OpticalMaterial"},
    "odak.instruments": {"Modulator": "odak.instruments:SLMDriver"},
    "odak.learn.raytracing": {"Scene": "odak.learn.raytracing:RayScene"},
    "odak.learn.raytracing.system": {"Stage": "odak.learn.raytracing.system:DesignStage"},
    "odak.learn.tools": {"read_PLY": "odak.tools"},
    "odak.learn.wave": {
        "circular_binary_mask": "odak.learn.tools",
        "crop_center": "odak.learn.tools",
        "quantize": "odak.learn.tools",
        "zero_pad": "odak.learn.tools",
    },
    "odak.learn.wave.gaussians": {"Gaussians": "odak.learn.wave:complex_3d_gaussians"},
    "odak.raytracing": {"rotate_point": "odak.tools", "rotate_points": "odak.tools"},
    "odak.wave": {"save_image": "odak.tools", "zero_pad": "odak.tools"},
}


@functools.cache
def other_words() -> dict[str, str]:
    """Return the words, in small letters, by which other libraries and earlier releases call each public name.

    A key with a dot is a module that has the names itself.
    """
    text = Path(__file__).with_name("assets").joinpath("other_words.txt").read_text(encoding="utf-8")
    return dict(line.split(": ", 1) for line in text.splitlines())
