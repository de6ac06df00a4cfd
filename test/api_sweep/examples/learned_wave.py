"""Valid arguments of odak.learn.wave."""

import json
import math

import torch
from api_sweep.build import Build, tensor, tensor_field

from odak.learn.wave import (
    Display,
    Eyes,
    LightField,
    Modulator,
    Observer,
    Run,
    Splats,
    display_model,
    focal_surface_light_propagation,
    optimise,
    propagator,
)

COLOUR = 515e-9


def _display(folder):
    return propagator([16, 16], [COLOUR], propagator_type="forward", volume_depth=0, aperture="open")


def _small_display(folder):
    return display_model([16, 16], 8e-6, COLOUR, 2e-3, [20, 20], 4e-6)


def _powers(folder):
    torch.save(torch.ones(1, 1), folder / "powers.pt")
    return folder / "powers.pt"


def _focal_surface_model():
    return focal_surface_light_propagation(1, 2)


def _weights(folder):
    torch.save(_focal_surface_model().state_dict(), folder / "weights.pt")
    return folder / "weights.pt"


def _key_mapping(folder):
    parts = {"sv_kernel_generation": "sv_kernel_generation_key_mapping", "light_propagation": "light_prop_key_mapping"}
    model = _focal_surface_model()
    mapping = {part: {f"{sub}.{key}": key for key in getattr(model, sub).state_dict()} for sub, part in parts.items()}
    (folder / "keys.json").write_text(json.dumps(mapping))
    return folder / "keys.json"


def _hologram_network(folder):
    from odak.learn.wave import holobeam_multiholo

    holobeam_multiholo(1, 2).save_weights(folder / "weights.pt")
    return folder / "weights.pt"


def _in(name):
    return Build(lambda folder: folder / name)


def _squared_error(image, target, *others):
    return ((image - target) ** 2).mean()


def _looked_at(folder):
    """Return a display of the size of the picture and the views in these examples."""
    return Display(Modulator((32, 48), 8e-6), COLOUR, Eyes(0.1, diameter=2e-3))


def _mesh(folder):
    from odak.learn.raytracing import triangle_mesh

    return triangle_mesh(tensor(4, 3), torch.tensor([[0, 1, 2], [0, 2, 3]]))


def _splats(folder):
    return Splats(tensor(4, 3), torch.ones(4, 4), torch.full((4, 3), -2.0), torch.ones(4), torch.ones(4, 1, 3))


def _views(folder):
    LightField(torch.rand(2, 32, 48), [(0.0, 0.0), (0.0, 1e-3)]).save(folder / "known")
    return folder / "known"


def _seen_by_eyes(folder):
    display = Display(Modulator((16, 24), 8e-6), COLOUR, Eyes(0.1, diameter=2e-3))
    return optimise(display, torch.ones(16, 24), run=Run(1, progress=False, seed=0))


def _twice(part):
    return 2 * part


def _callback(iteration, loss):
    return None


BY_NAME = {
    "odak.learn.wave": {
        # Lengths and sizes.
        "wavelength": COLOUR,
        "wavelengths": [COLOUR],
        "k": 2 * math.pi / COLOUR,
        "distance": 5e-3,
        "distances": [5e-3],
        "dx": 8e-6,
        "pixel_pitch": 8e-6,
        "pixel_pitches": [8e-6],
        "nx": 16,
        "ny": 16,
        "nu": 16,
        "nv": 16,
        "shape": [16, 16],
        "resolution": [16, 16],
        "numerical_aperture": 0.1,
        "waist": 4e-5,
        "charge": 1,
        "indices": [1.0, 1.38, 1.52],
        "thicknesses": [9e-8],
        "focal": 0.1,
        "angle": 0.1,
        "radius": 1e-3,
        "width": 5e-9,
        "depth_shift": 1e-3,
        "lens_size": 5,
        "slm_range": 2 * math.pi,
        "samples": [3, 3, 1, 1],
        "aperture_samples": [3, 3, 1, 1],
        # Fields and images.
        "field": tensor_field(16, 16),
        "amplitude": tensor(16, 16),
        "phase": tensor(16, 16),
        "intensity": tensor(16, 16),
        "light": tensor(16, 16),
        "hologram": tensor_field(16, 16),
        "hologram_phase": tensor(16, 16),
        "hologram_amplitude": tensor(16, 16),
        "hologram_phases": tensor(1, 16, 16),
        "initial_phase": tensor(16, 16),
        "target": tensor(16, 16, seed=11),
        "image": tensor(16, 16),
        "illumination": tensor(16, 16),
        "aberration": tensor(16, 16),
        "input_image": tensor(16, 16),
        "target_image": tensor(16, 16, seed=4),
        "target_depth": tensor(16, 16, seed=6),
        "input_field": tensor_field(16, 16),
        "laser_powers": tensor(1, 1),
        "laser_power": tensor(1, 1),
        "channel_power": tensor(1, 1),
        "H": tensor_field(32, 32),
        "planes": slice(0, 1),
        # Optimization.
        "n_iterations": 2,
        "n_iteration": 2,
        "number_of_iterations": 2,
        "number_of_epochs": 1,
        "loss_function": _squared_error,
        "callback": _callback,
        "checkpoint": _in("state.pt"),
        "progress": False,
        "seed": 3,
        "device": "cpu",
        "plane_id": 0,
        "channel_id": 0,
        "wavelength_id": 0,
        "depth_id": 0,
        "number_of_planes": 2,
        # Zernike polynomials.
        "modes": [(1, 1), (2, 0)],
        "coefficients": {(2, 0): 0.5},
    },
    "odak.learn.wave.multi_color_hologram_optimizer": {
        "loss_function": None,
        "targets": tensor(1, 1, 16, 16),
        "propagator": Build(_display),
        "number_of_frames": 1,
        "channel_power_filename": Build(_powers),
        "min_learning_rate": 1e-4,
        "initial_phase": tensor(1, 16, 16),
        "phase": tensor(1, 16, 16),
        "phase_offset": tensor(1, seed=8),
        "input_image": tensor(1, 16, 16),
        "target_image": tensor(1, 16, 16, seed=4),
        "offset": 0.0,
        "diameter": 6.0,
        "weights": [1.0, 1.0, 0.0],
        "checkpoint_every": 1,
    },
    "odak.learn.wave.mixed_color_hologram_optimizer": {
        "loss_function": None,
        "targets": tensor(1, 1, 16, 16),
        "propagator": Build(_display),
        "number_of_frames": 1,
        "channel_power_filename": Build(_powers),
        "phase": tensor(1, 16, 16),
        "phase_offset": tensor(1, 16, 16, seed=8),
        "input_image": tensor(1, 16, 16),
        "target_image": tensor(1, 16, 16, seed=4),
        "offset": 0.0,
        "diameter": 6.0,
        "weights": [1.0, 1.0, 0.0],
    },
    "odak.learn.wave.multiplane_hologram_optimizer": {
        "loss_function": None,
        "image_location": 0.0,
        "image_spacing": 1e-3,
        "slm_pixel_pitch": 8e-6,
        "slm_resolution": [16, 16],
        "targets": tensor(2, 16, 16),
        "phase_initial": tensor(16, 16),
        "amplitude_initial": tensor(16, 16, seed=7),
        "shifted_phase": tensor(16, 16),
        "phase_offset": tensor(16, 16, seed=8),
    },
    "odak.learn.wave.propagator": {
        "laser_channel_power": tensor(1, 1),
        "aperture": tensor(32, 32),
        "aperture_size": 8.0,
        "memory_budget": 10**9,
        "holograms": tensor_field(1, 1, 1, 16, 16),
        "frames": slice(0, 1),
        "kernels": tensor_field(1, 1, 32, 32),
        "powers": tensor(1, 1),
        "zero_padding_size": [40, 40],
    },
    "odak.learn.wave.holographic_display": {
        "number_of_depth_layers": 2,
        "pinhole_size": 8.0,
        "aperture": tensor(32, 32),
        "aperture_size": 8.0,
    },
    "odak.learn.wave.simulated_camera": {"bits": 8},
    "odak.learn.wave.display_hologram": {
        "model": Build(_small_display),
        "phase": tensor(16, 16),
        "target": tensor(16, 16),
        "iterations": 2,
    },
    "odak.learn.wave.display_model": {
        "phases": torch.arange(256, dtype=torch.float64) * (2 * math.pi / 256),
        "amplitude": tensor(16, 16),
        "wavefront": tensor(16, 16),
        "registration": None,
        "iris": 1.0,
        "levels": torch.zeros(16, 16, dtype=torch.int64),
        "pixels": torch.arange(5),
    },
    "odak.learn.wave.AmplitudeResponse": {"contrast": 1000.0},
    "odak.learn.wave.spatial_light_modulator": {"phase_range": 2 * math.pi},
    "odak.learn.wave.temporal_modulator": {
        "frame_time": 1e-3,
        "response_time": 2e-4,
        "slm": None,
        "lit": [0.0, 1.0],
        "phase": tensor(2, 4, 4),
        "frames": 2,
    },
    "odak.learn.wave.speckle_contrast": {"kernel_size": 3},
    "odak.learn.wave.multiplane_loss": {
        "target_blur_size": 3,
        "inject_noise": False,
        "noise_ratio": 1e-3,
        "distances": [0.0, 5e-3],
        "wavelengths": [532e-9],
        "pixel_pitch": 8e-6,
        "numerical_aperture": 0.1,
    },
    "odak.learn.wave.perceptual_multiplane_loss": {
        "target_blur_size": 3,
        "base_loss_weights": {"base_l2_loss": 1.0},
        "distances": [0.0, 5e-3],
        "wavelengths": [532e-9],
        "pixel_pitch": 8e-6,
        "numerical_aperture": 0.1,
        "additional_loss_weights": {},
        "inject_noise": False,
        "noise_ratio": 1e-3,
    },
    "odak.learn.wave.holobeam_multiholo": {
        "n_hidden": 2,
        "x": tensor(1, 1, 16, 16),
        "input_data": tensor(1, 1, 16, 16),
        "ground_truth": tensor(1, 1, 16, 16, seed=4),
        "dataloader": [(tensor(1, 1, 16, 16), tensor(1, 1, 16, 16, seed=4))],
        "directory": _in("output"),
        "filename": _in("weights.pt"),
    },
    "odak.learn.wave.focal_surface_light_propagation": {
        "depth": 1,
        "dimensions": 2,
        "focal_surface": tensor(1, 1, 16, 16),
        "phase_only_hologram": tensor(1, 3, 16, 16),
        "weight_filename": Build(_weights),
        "key_mapping_filename": Build(_key_mapping),
    },
}
BY_CALL = {
    "odak.learn.wave.airy_beam": {"dx": 4e-6, "scale": 4e-5},
    "odak.learn.wave.aspheric_lens_phase": {"radius": 1e-3, "index": 1.5, "conic": -1.0, "coefficients": [1e3]},
    "odak.learn.wave.axicon_phase": {"index": 1.5},
    "odak.learn.wave.bessel_beam": {"angle": 0.5},
    "odak.learn.wave.circular_aperture": {"radius": 5e-5, "inner_radius": 2e-5},
    "odak.learn.wave.dammann_grating": {"period": 8e-5, "dx": 1e-6, "orders": 5},
    "odak.learn.wave.fresnel_zone_plate": {"focal": 1e-2},
    "odak.learn.wave.reference_wave": {"angles": [0.5, 1.0], "amplitude": 2.0},
    "odak.learn.wave.rectangular_aperture": {"size": [5e-5, 6e-5]},
    "odak.learn.wave.thin_film_transfer": {"dx": 4e-7},
    "odak.learn.wave.across_devices": {"function": _twice, "batch": tensor(3, 4), "devices": ["cpu", "cpu"]},
    "odak.learn.wave.across_ranks": {"function": _twice, "batch": tensor(3, 4)},
    "odak.learn.wave.exposure": {"field": tensor_field(2, 1, 3, 4, 4), "power": tensor(2, 3)},
    "odak.learn.wave.get_point_wise_impulse_response_fresnel_kernel": {
        "aperture_points": tensor(3, 2) * 1e-5,
        "aperture_field": tensor_field(3),
        "target_points": tensor(16, 2, seed=9) * 1e-4,
        "resolution": [4, 4],
    },
    "odak.learn.wave.holobeam_multiholo.load_weights": {"filename": Build(_hologram_network)},
    "odak.learn.wave.linear_grating": {"add": math.pi},
    "odak.learn.wave.normalize_phase": {"phase": tensor(4, 4)},
    "odak.learn.wave.rotationspeed": {"c": 3e11},
    "odak.learn.wave.double_convergence": {"r": 0.3},
    "odak.learn.wave.phase_gradient": {"kernel": tensor(3, 3)},
    "odak.learn.wave.produce_phase_only_slm_pattern": {"illumination": tensor(16, 16)},
    "odak.learn.wave.propagate_partially_coherent": {
        "spectrum": (torch.tensor([COLOUR], dtype=torch.float64), torch.ones(1, dtype=torch.float64)),
        "source": (torch.zeros(1, 2, dtype=torch.float64), torch.ones(1, dtype=torch.float64)),
        "window_shape": [8, 8],
        "window_dx": 8e-6,
    },
    "odak.learn.wave.Display.fields": {"phases": tensor(32, 48)},
    "odak.learn.wave.Display.forward": {"phases": tensor(32, 48)},
    "odak.learn.wave.Display.judge": {"phases": tensor(32, 48)},
    "odak.learn.wave.Display.light_beyond": {"phases": tensor(32, 48)},
    "odak.learn.wave.Display.recorded_by": {
        "observer": Observer.camera(),
        "phases": tensor(32, 48),
    },
    "odak.learn.wave.Display.lit_by": {"powers": tensor(1, 1)},
    "odak.learn.wave.Display.looked_at": {"eyes": Eyes(0.1)},
    "odak.learn.wave.DepthScene.images": {"display": Build(_looked_at)},
    "odak.learn.wave.LightField.images": {"display": Build(_looked_at)},
    "odak.learn.wave.LightField.load": {"folder": Build(_views), "rays": None, "plane": 0.1},
    "odak.learn.wave.LightField.save": {"folder": _in("views")},
    "odak.learn.wave.Placement": {},
    "odak.learn.wave.Placement.of": {"points": tensor(4, 3)},
    "odak.learn.wave.Placement.fitting": {
        "points": tensor(4, 3),
        "display": Build(_looked_at),
        "distance": 0.1,
        "turned": [10.0, 0.0, 0.0],
        "share": 0.9,
    },
    "odak.learn.wave.views_of_mesh": {
        "mesh": Build(_mesh),
        "display": Build(_looked_at),
        "places": tensor(2, 2) * 1e-3,
        "light": [0.0, 1e-3],
        "samples": 1,
    },
    "odak.learn.wave.views_of_splats": {
        "splats": Build(_splats),
        "display": Build(_looked_at),
        "places": tensor(2, 2) * 1e-3,
    },
    "odak.learn.wave.eyebox_map": {
        "hologram": Build(_seen_by_eyes),
        "target": tensor(16, 24),
        "box": 1e-3,
        "diameter": 2e-3,
        "steps": 1,
        "foci": [0.1],
        "distance": 0.1,
    },
    "odak.learn.wave.eye_report": {
        "display": Build(_looked_at),
        "target": tensor(32, 48),
        "box": 1e-3,
        "steps": 1,
        "diameter": 2e-3,
        "foci": [0.1],
        "parts": 2,
        "run": Run(iterations=1, progress=False),
    },
    "odak.learn.wave.optimise": {"target": tensor(48, 64), "run": Run(iterations=3, progress=False)},
    "odak.learn.wave.propagator": {"distances": tensor(1) * 1e-3},
    "odak.learn.wave.propagator.init_distances": {"distances": tensor(1) * 1e-3},
    "odak.learn.wave.holographic_display.init_distances": {"distances": tensor(1) * 1e-3},
    "odak.learn.wave.eyebox_hologram": {
        "targets": tensor(2, 16, 16),
        "distance": 5e-2,
        "pitch": 8e-6,
        "pupil_positions": [[0.0, 0.0], [0.0, 1e-3]],
        "pupil_diameter": 1e-3,
        "rotation": [[0.0, 0.0], [0.0, 2.0]],
        "focus": 6e-2,
        "iterations": 2,
        "initial_phase": tensor(16, 16),
        "frames": 1,
        "slm": None,
        "optimizer": "adam",
    },
    "odak.learn.wave.simulated_camera": {"distance": 5e-3},
    "odak.learn.wave.spatial_light_modulator.forward": {"scale": 1.0},
    "odak.learn.wave.temporal_average": {"intensity": tensor(3, 8, 8)},
    "odak.learn.wave.zernike_basis": {"radius": 8.0},
    "odak.learn.wave.zernike_phase": {"radius": 8.0},
}
NOT_CALLED = {
    "odak.learn.wave.fit_display": "takes seconds, and captures; its own test gives it wrong arguments",
    "odak.learn.wave.display_camera": "needs instruments; its own test gives it some",
    "odak.learn.wave.STEFunction*": "torch calls its methods; users call StraightThroughEstimator, or its apply",
}
ALLOWED = {
    ("odak.learn.wave.light_of", "picture", "a text"): "is the path of a file, which the message names",
    ("odak.learn.wave.eye_report", "target", "in double precision"): "iterations amplify rounding",
    ("odak.learn.wave.optimise", "target", "in double precision"): "iterations amplify rounding",
    ("odak.learn.wave.optimise", "target", "in half precision"): "iterations amplify rounding",
    ("odak.learn.wave.aspheric_lens_phase", "radius", "a negative number"): "a surface that diverges",
    ("odak.learn.wave.spiral_phase", "charge", "half a step"): "a fractional charge, which has a step",
    ("odak.learn.wave.q_plate", "charge", "half a step"): "a q-plate's charge is a multiple of 1/2",
    ("odak.learn.wave.*", "wavelength*", "in half precision"): "its steps of 6e-8 make other wavelengths of them",
    ("odak.learn.wave.*", "img_loss_thres", "*"): "documented as not used",
    ("odak.learn.wave.set_amplitude", "field", "infinity inside"): "it has a phase, which is all that is taken of it",
    ("odak.learn.wave.produce_phase_only_slm_pattern", "hologram", "infinity inside"): "it has a phase, which is all "
    "that is taken of it",
    ("odak.learn.wave.simulated_camera.captured", "light", "infinity inside"): "the sensor saturates",
    ("odak.learn.wave.spatial_light_modulator", "zero_order", "a complex number"): "light that is not modulated has a "
    "phase",
}
POSITIVE = {
    "odak.learn.wave": {
        "pixel_pitch",
        "slm_pixel_pitch",
        "learning_rate",
        "pinhole_size",
        "aperture_size",
        "slm_range",
        "diameter",
        "number_of_planes",
        "number_of_frames",
        "number_of_depth_layers",
        "number_of_iterations",
        "n_iteration",
        "iterations",
        "checkpoint_every",
        "exposure",
        "full_well",
        "bits",
        "peak_amplitude",
        "kernel_size",
        "lens_size",
    },
}
SIDES = {"odak.learn.wave": {"slm_resolution", "shape", "img_size", "zero_padding_size", "lens_size"}}
