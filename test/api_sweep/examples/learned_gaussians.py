"""Valid arguments of the complex Gaussians."""

from argparse import Namespace

import torch
from api_sweep.build import Build, tensor

from odak.learn.tools import PerspectiveCamera
from odak.learn.wave import Splats, complex_2d_gaussians, complex_3d_gaussians, save_splats

SETTINGS = Namespace(
    num_planes=2,
    is_outdoor=False,
    wavelengths=[639e-9, 532e-9, 473e-9],
    pixel_pitch=8e-6,
    distances=[1e-3, 2e-3],
    pad_size=[16, 16],
    aperture_size=-1,
)


def _camera(folder):
    return PerspectiveCamera(torch.eye(3), torch.tensor([0.0, 0.0, 40.0]), [30.0, 30.0], [8.0, 8.0])


def _flat(folder):
    return complex_2d_gaussians(4, (16, 16), "cpu", seed=3)


def _solid(folder):
    return complex_3d_gaussians("random", "cpu", num_points=4, args_prop=SETTINGS, seed=3)


def _flat_file(folder):
    _flat(folder).save_gaussians(folder / "gaussians.pt")
    return folder / "gaussians.pt"


def _splats():
    return Splats(tensor(4, 3), tensor(4, 4), tensor(4, 3), tensor(4), tensor(4, 4, 3))


def _splat_file(folder):
    save_splats(folder / "splats.ply", _splats())
    return folder / "splats.ply"


def _reconstruction(folder):
    (folder / "cameras.txt").write_text("3 PINHOLE 64 48 70 60 33 20\n")
    (folder / "images.txt").write_text("1 1 0 0 0 0 0 5 3 a.png\n\n")
    return folder


POINTS = tensor(4, 3)
AHEAD = POINTS + torch.tensor([0.0, 0.0, 40.0])
COVARIANCES = torch.tensor([[2.0, 0.3], [0.3, 1.5]]).expand(4, 2, 2).clone()

BY_NAME = {
    "odak.learn.wave.complex_2d_gaussians": {
        "num_points": 4,
        "img_size": [16, 16],
        "scales": tensor(4, 2),
        "rotation": tensor(4),
        "cov_00": tensor(4) + 1,
        "cov_01": tensor(4, seed=4) * 0.1,
        "cov_11": tensor(4, seed=6) + 1,
        "save_path": Build(lambda folder: folder / "gaussians.pt"),
        "load_path": Build(_flat_file),
    },
    "odak.learn.wave.complex_3d_gaussians.densify": {
        "gradients": tensor(4),
        "threshold": 0.5,
        "split_scale": 1.0,
    },
    "odak.learn.wave.complex_3d_gaussians.prune": {"least_opacity": 0.1, "largest_scale": 10.0},
    "odak.learn.wave.complex_3d_gaussians": {
        "init_type": "random",
        "num_points": 4,
        "args_prop": SETTINGS,
        "img_size": [16, 16],
        "cam_means_3D": AHEAD,
        "means_2D": POINTS[:, :2] * 16,
        "cov_2D": COVARIANCES,
        "quats": tensor(4, 4),
        "scales": tensor(4, 3),
        "fx": 30.0,
        "fy": 30.0,
        "px": 8.0,
        "py": 8.0,
        "R": torch.eye(3),
        "pre_act_quats": tensor(4, 4),
        "pre_act_scales": tensor(4, 3),
        "pre_act_phase": tensor(4, 3, seed=4),
        "pre_act_opacities": tensor(4),
        "pre_act_plane_assignment": tensor(4, 2),
        "save_path": Build(lambda folder: folder / "gaussians.pt"),
    },
    "odak.learn.wave.Scene": {
        "gaussians": Build(_solid),
        "args_prop": SETTINGS,
        "camera": Build(_camera),
        "alphas": tensor(2, 4, 4),
        "means_3D": POINTS,
        "cam_means_3D": AHEAD,
        "z_vals": AHEAD[:, 2].clone(),
        "quats": tensor(4, 4),
        "scales": tensor(4, 3),
        "colours": tensor(4, 3),
        "phase": tensor(4, 3, seed=4),
        "opacities": tensor(4),
        "plane_probs": torch.eye(2).repeat(2, 1),
        "wavelengths": torch.tensor([639e-9, 532e-9, 473e-9]),
        "img_size": [16, 16],
        "tile_size": [8, 8],
        "tile_x": 0,
        "tile_y": 1,
        "gaussian_indices": torch.arange(4),
        "R": torch.eye(3),
        "fx": 30.0,
        "fy": 30.0,
        "px": 8.0,
        "py": 8.0,
    },
    "odak.learn.wave.load_colmap": {"folder": Build(_reconstruction)},
    "odak.learn.wave.load_splats": {"path": Build(_splat_file)},
    "odak.learn.wave.save_splats": {"path": Build(lambda folder: folder / "splats_written.ply"), "splats": _splats()},
    "odak.learn.wave.spherical_harmonics": {"degree": 2, "directions": tensor(4, 3)},
    "odak.learn.wave.view_colours": {"harmonics": tensor(4, 4, 3), "directions": tensor(4, 3)},
    "odak.learn.wave.Scene2D": {"gaussians": Build(_flat), "args_prop": SETTINGS, "img_size": [16, 16]},
    "odak.learn.wave.StraightThroughEstimator": {"x": tensor(4, 3)},
}
NOT_CALLED = {
    "odak.learn.wave.complex_3d_gaussians.check_if_trainable": "of new Gaussians it raises RuntimeError, as documented",
}
ALLOWED = {
    ("odak.learn.wave.view_colours", "directions", "infinity inside"): "documented: colours are at least 0",
    ("odak.learn.wave.Scene.render", "bg_colour", "*"): "documented as without effect",
    ("odak.learn.wave.Scene.render", "*step", "*"): "documented as without effect",
    ("odak.learn.wave.complex_3d_gaussians.apply_activations", "*step", "*"): "documented as without effect",
    ("odak.learn.wave.Scene.splat_tile", "wavelengths", "*"): "documented as without effect",
    (
        "odak.learn.wave.Scene.get_idxs_to_filter_and_sort",
        "z_vals",
        "NaN inside",
    ): "the result is numbers of Gaussians; that of NaN is among them, so that the picture shows it",
    ("odak.learn.wave.Scene.*", "z_vals", "infinity inside"): "a Gaussian infinitely far away is the last in order",
    ("odak.learn.wave.Scene.splat_tile", "cam_means_3D", "infinity inside"): "beyond the picture on one side",
    ("odak.learn.wave.complex_3d_gaussians.apply_activations", "pre_act_opacities", "infinity inside"): "the sigmoid "
    "is one there",
    ("odak.learn.wave.complex_3d_gaussians.calculate_gaussian_bounds", "*", "infinity inside"): "boxes are cut at the "
    "picture's rim",
    ("odak.learn.wave.complex_3d_gaussians.compute_cov_2D", "cam_means_3D", "infinity inside"): "the slope of the "
    "projection is that at the rim of the view for points beyond it, as documented",
}
