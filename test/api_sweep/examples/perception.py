"""Valid arguments of odak.learn.perception."""

import importlib.util

import torch
from api_sweep.build import Build, tensor

from odak.learn.perception import (
    FrequencySteerablePyramid,
    Metamer,
    MetamericLoss,
    MetamericLossUniform,
    SpatialSteerablePyramid,
    Viewing,
    get_steerable_pyramid_filters,
    sample_observers,
)

PICTURE, OTHER = tensor(1, 3, 32, 32), tensor(1, 3, 32, 32, seed=9)
SMALL, SMALL_OTHER = tensor(1, 3, 16, 16), tensor(1, 3, 16, 16, seed=9)
COLUMNS = "# a title\n400 0.1 0.3\n500 0.5 0.2\n600 0.9 0.1\n"
HERE = "odak.learn.perception"


def _spectra(folder):
    path = folder / "spectra.txt"
    path.write_text(COLUMNS)
    return path


def _statistics(seed):
    return Build(lambda _: MetamericLoss(n_pyramid_levels=2).calc_statsmaps(tensor(1, 3, 32, 32, seed=seed)))


def _uniform_statistics(seed):
    return Build(lambda _: MetamericLossUniform(n_pyramid_levels=2).calc_statsmaps(tensor(1, 3, 32, 32, seed=seed), 8))


_METAMER = {"model": torch.square, "picture": tensor(1, 1, 16, 16), "samples": 2, "seed": 0}


def _metamer_file(folder):
    Metamer(**_METAMER).save(folder / "run.pt")
    return folder / "run.pt"


def _gaze_table(folder):
    path = folder / "gaze.csv"
    path.write_text("time,x,y\n0,0.5,0.5\n0.1,0.6,0.5\n")
    return path


PAIR = {"predictions": PICTURE, "targets": OTHER}
BY_NAME = {
    HERE: {
        "image": PICTURE,
        "target": OTHER,
        "input_image": SMALL,
        "target_image": SMALL_OTHER,
        "simulated_image": OTHER,
        "ground_truth": SMALL_OTHER,
        "gaze": [0.5, 0.4],
        "predictions": PICTURE,
        "targets": OTHER,
        "n_pyramid_levels": 2,
        "n_levels": 2,
        "n_orientations": 2,
        "device": torch.device("cpu"),
        "gaze_location": [0.5, 0.4],
        "gaze_angles": [0.5, 0.4],
        "image_pixel_size": [16, 16],
        "size": [16, 16],
        "signal": SMALL,
        "light": SMALL,
        "luminance": SMALL,
        "values": SMALL,
        "peak_luminance": 1000.0,
        "black_luminance": 0.1,
        "roi_high": [0, 8, 0, 8],
        "roi_low": [8, 16, 8, 16],
        "wavelengths": [450.0, 500.0, 550.0],
        "pooling_size": 8.0,
        "seed": 3,
        # A descent amplifies rounding: results of other precisions would be other metamers.
        "iterations": 0,
        "sample": tensor(1, 1, 32, 32),
        "low": SMALL,
        "source_white": [0.95, 1.0, 1.09],
        "target_white": [0.96, 1.0, 0.83],
        "centre": [0.5, 0.4],
        "frequency": 4.0,
        "first": 100 * SMALL,
        "second": 100 * SMALL_OTHER,
        "lms_image": SMALL,
        "lms_color_tensor": SMALL,
        "primaries": SMALL,
        "rgb": SMALL,
        "lms": SMALL,
        "l_response": tensor(301, seed=1),
        "m_response": tensor(301, seed=2),
        "s_response": tensor(301, seed=3),
        "cone_spectrum": tensor(301, seed=1),
        "light_spectrum": tensor(301, seed=2),
        "wavelength": 500.0,
        "function": tensor(301).tolist(),
        "dataset": torch.stack((torch.linspace(400, 700, 31), tensor(31)), -1),
        "dtype": torch.float64,
        "loss_name": "TestLoss",
        "epsilon": 1e-3,
        "visualise_loss": True,
    },
}
for _path in (
    "change_primaries", "hsv_to_rgb", "lab_to_srgb", "linear_rgb_to_rgb", "linear_rgb_to_xyz", "rgb_2_ycrcb",
    "rgb_to_hsv", "rgb_to_linear_rgb", "srgb_to_lab", "xyz_to_linear_rgb", "ycrcb_2_rgb",
    "simulate_color_vision_deficiency", "extract_local_patches", "weber_contrast", "michelson_contrast",
):  # fmt: skip
    BY_NAME[f"{HERE}.{_path}"] = {"image": SMALL}
BY_CALL = {
    f"{HERE}.rgb_to_gray": {"image": tensor(3, 16, 16)},
    f"{HERE}.correlated_color_temperature": {"image": 0.9 + 0.05 * tensor(1, 3, 16, 16)},
    f"{HERE}.change_primaries": {"source": "BT.709", "target": "BT.2020"},
    f"{HERE}.rgb_to_xyz_matrix": {
        "primaries": [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06]],
        "white": [0.95, 1.0, 1.09],
    },
    f"{HERE}.blur_gaussian": {"field": tensor(1, 1, 16, 16), "kernel_length": [5, 5], "nsigma": [1.0, 1.0]},
    f"{HERE}.compute_local_contrast_similarity": {"patch_x": tensor(4, 5), "patch_y": tensor(4, 5, seed=9)},
    f"{HERE}.content_aware_contrast_ratio": {"image": tensor(2, 16, 16), "window_size": 5},
    f"{HERE}.weber_contrast": {"image": tensor(3, 16, 16)},
    f"{HERE}.michelson_contrast": {"image": tensor(3, 16, 16)},
    f"{HERE}.contrast_sensitivity": {"luminance": 100.0, "size": 60.0},
    f"{HERE}.castle_contrast_sensitivity": {"luminance": 100.0},
    f"{HERE}.pupil_diameter": {"luminance": 100.0, "size": 60.0},
    f"{HERE}.CSFLoss": {"peak_luminance": 100.0},
    f"{HERE}.crop_steerable_pyramid_filters": {
        "filters": Build(lambda _: get_steerable_pyramid_filters(9, 2, "full")),
        "size": 5,
    },
    f"{HERE}.get_steerable_pyramid_filters": {"size": 5, "filter_type": "cropped"},
    f"{HERE}.display_color_hvs": {"primaries_spectrum": tensor(3, 301)},
    f"{HERE}.read_spectra": {"path": Build(_spectra)},
    f"{HERE}.spectrum_to_xyz": {"spectrum": tensor(2, 3)},
    f"{HERE}.spectra_to_xyz_matrix": {"spectra": tensor(2, 3)},
    **{
        f"{HERE}.{name}": {"spectrum": 1 + tensor(41), "wavelengths": [float(nm) for nm in range(380, 781, 10)]}
        for name in ("color_rendering_index", "color_fidelity")
    },
    f"{HERE}.slice_rgbd_targets": {
        "target": tensor(3, 8, 8),
        "depth": tensor(8, 8, seed=9),
        "depth_plane_positions": [0.0, 0.5, 1.0],
    },
    f"{HERE}.MSSSIM.forward": {"predictions": tensor(1, 1, 176, 176), "targets": tensor(1, 1, 176, 176, seed=9)},
    f"{HERE}.multi_scale_structural_similarity": {
        "predictions": tensor(1, 1, 176, 176),
        "targets": tensor(1, 1, 176, 176, seed=9),
    },
    f"{HERE}.eccentricity_report": {"edges": [0.0, 5.0, 10.0]},
    f"{HERE}.ring_masks": {"edges": [0.0, 5.0, 10.0]},
    f"{HERE}.SpatialSteerablePyramid": {"n_channels": 3},
    f"{HERE}.convert_color": {"source": "sRGB", "target": "Lab", "luminance": 100.0},
    f"{HERE}.SpatialSteerablePyramid.reconstruct_from_pyramid": {
        "pyramid": Build(
            lambda _: SpatialSteerablePyramid(n_channels=3, n_orientations=2).construct_pyramid(PICTURE, 3)
        ),
    },
    f"{HERE}.SpatialSteerablePyramid.construct_pyramid": {"n_levels": 3},
    f"{HERE}.FrequencySteerablePyramid": {"n_levels": 3},
    f"{HERE}.FrequencySteerablePyramid.reconstruct_from_pyramid": {
        "pyramid": Build(lambda _: FrequencySteerablePyramid(3, 2).construct_pyramid(PICTURE)),
    },
    f"{HERE}.MetamericLoss.metameric_loss_stats": {"statsmap_a": _statistics(3), "statsmap_b": _statistics(9)},
    f"{HERE}.MetamericLossUniform.metameric_loss_stats": {
        "statsmap_a": _uniform_statistics(3),
        "statsmap_b": _uniform_statistics(9),
    },
    f"{HERE}.individual_cone_fundamentals": {
        "wavelengths": [450.0, 550.0],
        "lens": 1.7,
        "macular": 0.3,
        "densities": [0.5, 0.5, 0.4],
        "shifts": [0.0, 1.0, 0.0],
    },
    f"{HERE}.sample_observers": {"number": 2, "wavelengths": [450.0, 550.0]},
    f"{HERE}.metameric_failure": {
        "primaries": torch.eye(3, 5, dtype=torch.float64),
        "reference": torch.ones(5, dtype=torch.float64),
        "observers": Build(lambda _: sample_observers(2, [430.0, 480.0, 530.0, 580.0, 630.0])),
        "wavelengths": [430.0, 480.0, 530.0, 580.0, 630.0],
    },
    f"{HERE}.foveated_budget": {"edges": [0.0, 5.0, 20.0]},
    f"{HERE}.highest_frequency": {"eccentricity": 3.0},
    f"{HERE}.unified_pupil_diameter": {"area": 400.0, "age": 30.0, "luminance": 100.0},
    f"{HERE}.synthesize_texture": {"size": [32, 32]},
    f"{HERE}.metamer": {"model": torch.square, "picture": tensor(1, 1, 16, 16)},
    f"{HERE}.Metamer": _METAMER,
    f"{HERE}.FlickerLoss.forward": {"frames": tensor(1, 2, 1, 8, 8)},
    f"{HERE}.dither": {"image": SMALL, "bits": 2, "frames": 2, "encoding": "sRGB"},
    f"{HERE}.read_gaze": {"path": Build(_gaze_table)},
    f"{HERE}.retinal_image": {"frames": tensor(2, 3, 8, 8), "gaze": [[0.5, 0.5], [0.6, 0.5]]},
    f"{HERE}.sequence_loss": {
        "loss": lambda image, target, gaze: (image - target).square().mean(),
        "image": tensor(2, 1, 8, 8),
        "target": tensor(2, 1, 8, 8, seed=5),
        "gaze": [[0.5, 0.5], [0.6, 0.5]],
    },
    f"{HERE}.export_experiment": {
        "metamer": Build(lambda _: Metamer(torch.nn.AvgPool2d(4), tensor(1, 1, 16, 16), samples=2, seed=0)),
        "folder": Build(lambda folder: folder),
        "viewing": Viewing(0.4, 0.7),
    },
    f"{HERE}.Metamer.save": {"path": Build(lambda folder: folder / "run.pt")},
    f"{HERE}.Metamer.resume": {"path": Build(_metamer_file)},
    f"{HERE}.PooledModel.pool": {"picture": tensor(1, 1, 32, 32)},
    f"{HERE}.PooledModel.over_deviations": {"pictures": tensor(2, 1, 32, 32)},
    f"{HERE}.eigendistortions": {"model": torch.square, "picture": tensor(1, 1, 16, 16)},
    f"{HERE}.maximum_differentiation": {
        "held": torch.nn.functional.mse_loss,
        "driven": torch.nn.functional.huber_loss,
        "picture": tensor(1, 1, 16, 16),
        "start": tensor(1, 1, 16, 16, seed=5),
    },
    f"{HERE}.texture_statistics": {"picture": tensor(1, 1, 32, 32)},
    f"{HERE}.RadiallyVaryingBlur.sampler": {
        "alpha": 0.2,
        "real_image_width": 0.2,
        "real_viewing_distance": 0.7,
        "mode": "linear",
        "equi": False,
    },
}
POSITIVE = {
    HERE: {
        "peak_value", "data_range", "pooling_size", "epsilon", "window_size", "step", "max_iter", "peak_luminance",
        "frequency", "n_orientations", "n_channels", "patch_size", "stride", "kernel_size", "peak",
    },
    f"{HERE}.pupil_diameter": {"size", "luminance"},
    f"{HERE}.contrast_sensitivity": {"size", "luminance"},
}  # fmt: skip
SIDES = {HERE: {"image_pixel_size", "n_channels"}, f"{HERE}.make_radial_map": {"size"}, f"{HERE}.ring_masks": {"size"}}
FREE_TEXT = {HERE: {"loss_name", "image_colorspace", "read_spectrum"}}
NOT_CALLED = {
    f"{HERE}.*.visualise_loss_map": "needs a loss that has compared two pictures: `forward` runs it",
}
if importlib.util.find_spec("pycvvdp") is None:
    NOT_CALLED[f"{HERE}.castle_contrast_sensitivity"] = "needs the tables of the package cvvdp"
for _measure, _module in (("CVVDP", "pycvvdp"), ("FVVDP", "pyfvvdp"), ("LPIPS", "lpips"), ("ImageQuality", "pyiqa")):
    if importlib.util.find_spec(_module) is None:
        NOT_CALLED[f"{HERE}.{_measure}.forward"] = f"needs the package {_module}"
ALLOWED = {
    (f"{HERE}.display_color_hvs", "resolution", "*"): "kept for the caller, counts nowhere",
    (f"{HERE}.display_color_hvs", "distance_from_screen", "*"): "kept for the caller, counts nowhere",
    (f"{HERE}.display_color_hvs", "pixel_pitch", "*"): "kept for the caller, counts nowhere",
    (f"{HERE}.display_color_hvs", "read_spectrum", "*"): "kept for the caller, counts nowhere",
    (f"{HERE}.display_color_hvs.forward", "gaze", "*"): "accepted, counts nowhere",
    (f"{HERE}.color_appearance", "image", "in half precision"): "its rounding turns the hue of what is nearly grey",
    (f"{HERE}.rgb_to_ictcp", "*", "infinity inside"): "values beyond the range count as its end, as documented",
    (f"{HERE}.ictcp_to_rgb", "*", "infinity inside"): "values beyond the range count as its end, as documented",
    (f"{HERE}.display_color_hvs", "primaries_spectrum", "a text"): "a text is the name of a file, which is not there",
    (f"{HERE}.rgb_to_linear_rgb", "threshold", "*"): "the standard's counts whatever is given, as documented",
    (f"{HERE}.ocular_modulation_transfer", "frequency", "zero"): "what is uniform passes as a whole",
    (f"{HERE}.pq_*code", "*", "infinity inside"): "values beyond the range count as its end, as documented",
    (f"{HERE}.pu21_*code", "*", "infinity inside"): "values beyond the range count as its end, as documented",
    (f"{HERE}.content_aware_contrast_ratio", "image", "infinity inside"): "pictures are held to 0 … 1, as documented",
    (f"{HERE}.slice_rgbd_targets", "depth", "* inside"): "a pixel without a depth is in no slice, as documented",
    (f"{HERE}.blur_gaussian", "padding", "a number"): "so many zeros around the picture, as documented",
}
