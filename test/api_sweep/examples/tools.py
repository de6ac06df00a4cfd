"""Valid arguments of odak.tools and odak.learn.tools."""

import importlib.util
import json

import numpy
import torch
from api_sweep.build import Build, field, numbers, tensor

from odak.learn.tools import generate_bspline_basis_2d, multi_layer_perceptron, save_image, save_torch_tensor
from odak.tools import save_ome_tiff, write_PLY

CLOUD = numbers(4, 3)
RAY = numpy.array([[0.1, 0.2, -0.5], [0.0, 0.6, 0.8]])
SAMPLING = {"no": [3, 3], "center": [1.0, 2.0, 3.0], "angles": [5.0, 10.0, 15.0], "k": [1.0, 2.0]}


def written(name, write):
    """Return a sample: a file that `write` has put into an empty folder."""

    def build(folder):
        path = folder / name
        write(path)
        return path

    return Build(build)


def unwritten(name):
    """Return a sample: a file that does not exist yet."""
    return Build(lambda folder: folder / name)


TEXT = written("a.txt", lambda path: path.write_text("# a\n\nb\n"))
MESH = written("a.ply", lambda path: write_PLY(numbers(3, 3, 3), path))
PICTURE = written("a.png", lambda path: save_image(path, tensor(3, 8, 8)))
OME = written("a.ome.tif", lambda path: save_ome_tiff(path, numbers(8, 8), 8e-6))
PERCEPTRON = {"n_input": 1, "n_hidden": 4, "n_output": 1, "n_layers": 1}

BY_NAME = {
    "odak.tools": {
        **SAMPLING,
        "a": numbers(3, seed=11),
        "angle": 10.0,
        "b": numbers(3, seed=9),
        "cwd": Build(lambda folder: folder),
        "directory": unwritten("folder"),
        "entry": CLOUD,
        "exit": CLOUD + 1,
        "eps": 1e-9,
        "field": numbers(16, 16),
        "filename": TEXT,
        "file_path": TEXT,
        "first_tensor": numbers(8, 8),
        "fx": numbers(4, 4, seed=7),
        "fy": numbers(4, 4, seed=8),
        "image_field": numbers(8, 8) * 255,
        "j": 3,
        "kernel": numbers(3, 3),
        "kernel_length": [4, 4],
        "lookat": [1.0, 2.0, 3.0],
        "location": [0.0, 0.5, 1.0],
        "m": 0,
        "n": 2,
        "nsigma": [2.0, 3.0],
        "offset": [0.1, 0.2, 0.3],
        "origin": [0.1, 0.2, 0.3],
        "p1": numbers(3),
        "p2": numbers(3, seed=4),
        "path": Build(lambda folder: folder),
        "point": numbers(3),
        "point1": numbers(4, 3),
        "point2": numbers(4, 3, seed=5),
        "points": CLOUD,
        "points0": CLOUD,
        "points1": numbers(5, 3, seed=6),
        "ray": RAY,
        "ray_point_0": numbers(4, 3, seed=7),
        "ray_point_1": numbers(4, 3, seed=8),
        "rho": numbers(5),
        "second_tensor": numbers(8, 8, seed=4),
        "seed": 3,
        "size": [20, 24],
        "theta": numbers(5, seed=5),
        "timeout": 10.0,
        "vector1": RAY,
        "vector2": numbers(2, 3),
    },
    "odak.learn.tools": {
        **SAMPLING,
        "a": [0.5, 0.7],
        "angle": torch.tensor([10.0]),
        "angles": torch.tensor([[5.0, 10.0, 15.0]]),
        "basis_matrix": generate_bspline_basis_2d([4, 4], [16, 16])[0],
        "base": tensor(8, 8),
        "centers": tensor(2, 3),
        "coefficients": [tensor(4)],
        "control_coefficients": tensor(16),
        "cmax": 1.0,
        "device": "cpu",
        "epochs": 2,
        "epsilon": 0.5,
        "field": tensor(16, 16),
        "filename": written("a.pt", lambda path: torch.save(multi_layer_perceptron(**PERCEPTRON).state_dict(), path)),
        "fn": written("a.pt", lambda path: save_torch_tensor(path, tensor(3))),
        "focal_length": torch.tensor([100.0, 101.0]),
        "frame": tensor(3, 16, 16),
        "ground_truth": tensor(3, 16, 16, seed=4),
        "image": tensor(3, 16, 16),
        "image_field": tensor(8, 8),
        "img": tensor(3, 8, 8),
        "kernel_length": [5, 5],
        "learning_rate": 1e-3,
        "levels": 2,
        "map_location": "cpu",
        "model": Build(lambda folder: torch.nn.Linear(2, 2)),
        "multiplier": 0.5,
        "mu": [0.1, 0.2],
        "nsigma": [2.0, 3.0],
        "num_control_points": [4, 4],
        "n_scales": 1,
        "offset": torch.tensor([[0.1, 0.2, 0.3]]),
        "opacity": tensor(2, 1),
        "origin": torch.tensor([[0.1, 0.2, 0.3]]),
        "p1": tensor(3),
        "p2": tensor(3, seed=4),
        "b": tensor(3, seed=9),
        "ply_filename": MESH,
        "point": tensor(4, 3),
        "point1": tensor(4, 3),
        "point2": tensor(4, 3, seed=4),
        "points": tensor(4, 3),
        "principal_point": torch.tensor([8.0, 9.0]),
        "progress": False,
        "px": 8,
        "py": 8,
        "quaternions": tensor(4, 4),
        "r": 2.0,
        "residuals": [tensor(8, 8, seed=4)],
        "resolution": [16, 16],
        "roi_high": [0, 4, 0, 4],
        "roi_low": [8, 12, 8, 12],
        "R": torch.eye(3),
        "T": tensor(3),
        "rows": tensor(2, 8),
        "columns": tensor(3, 8),
        "scales": tensor(2, 3),
        "seed": 3,
        "size": [20, 24],
        "smooth_factor": [0.1, 0.2],
        "tensor": tensor(3),
        "theta": 0.3,
        "value": tensor(4),
        "vector1": tensor(2, 3),
        "vector2": tensor(2, 3, seed=4),
        "voxel_size": [0.2, 0.2, 0.2],
        "x": tensor(4, 1),
        "x_values": tensor(4, 1),
        "y_values": tensor(4, 1, seed=4),
        **PERCEPTRON,
    },
}
BY_CALL = {
    "odak.learn.tools.box_volume_sample": {"no": [2, 2, 2], "size": [1.0, 2.0, 3.0]},
    "odak.learn.tools.crop_center": {"size": [8, 8]},
    "odak.learn.tools.grid_sample": {"size": [1.0, 2.0]},
    "odak.learn.tools.load_image": {"fn": PICTURE, "normalizeby": 2.0},
    "odak.learn.tools.decompose_bspline_2d": {"image": tensor(16, 16)},
    "odak.learn.tools.decompose_wavelet_like": {"image": tensor(16, 16)},
    "odak.learn.tools.multi_layer_perceptron.save_weights": {"filename": unwritten("a.pt")},
    "odak.learn.tools.rotate_points": {"angles": torch.tensor([[5.0, 10.0, 15.0]])},
    "odak.learn.tools.same_side": {"a": tensor(3, seed=8)},
    "odak.learn.tools.save_image": {"fn": unwritten("a.png")},
    "odak.learn.tools.save_torch_tensor": {"fn": unwritten("a.pt")},
    "odak.tools.box_volume_sample": {"no": [2, 2, 2], "size": [1.0, 2.0, 3.0]},
    "odak.tools.convert_bytes": {"num": 5000.0},
    "odak.tools.convert_to_numpy": {"a": tensor(3)},
    "odak.tools.load_ome_tiff": {"filename": OME},
    "odak.tools.napari_reader": {"path": "a.ome.tif"},
    "odak.tools.save_ome_tiff": {
        "filename": unwritten("a.ome.tif"),
        "field": field(3, 8, 8),
        "pitch": 8e-6,
        "spacing": 1e-3,
        "wavelength": 532e-9,
    },
    "odak.tools.to_xarray": {"field": field(8, 8), "pitch": 8e-6, "wavelength": 532e-9, "distance": 0.1, "name": "u"},
    "odak.tools.copy_file": {"source": TEXT, "destination": unwritten("b.txt")},
    "odak.tools.create_group_tensor": {"number_of_elements": 6, "group_percentages": [0.5, 0.5], "number_of_groups": 2},
    "odak.tools.crop_center": {"size": [8, 8]},
    "odak.tools.expanduser": {"filename": "~/a.txt"},
    "odak.tools.generate_bandlimits": {"size": [16, 16], "levels": 2},
    "odak.tools.get_base_filename": {"filename": "a/b.txt"},
    "odak.tools.grid_sample": {"size": [1.0, 2.0]},
    "odak.tools.latex": {"filename": TEXT},
    "odak.tools.latex.set_latex_dictonaries": {
        "begin_dictionary": ["a"],
        "end_dictionary": ["b"],
        "syntax_dictionary": ["c"],
    },
    "odak.tools.list_files": {"key": "*.txt"},
    "odak.tools.load_dictionary": {"filename": written("a.json", lambda path: path.write_text(json.dumps({"a": 1})))},
    "odak.tools.load_image": {"fn": PICTURE},
    "odak.tools.markdown.set_dictonaries": {
        "begin_dictionary": ["a"],
        "end_dictionary": ["b"],
        "syntax_dictionary": ["c"],
    },
    "odak.tools.nufft2": {"field": field(4, 4), "size": [4, 4]},
    "odak.tools.nuifft2": {"field": field(4, 4), "size": [4, 4]},
    "odak.tools.point_to_ray_distance": {"point": CLOUD},
    "odak.tools.random_sample_point_cloud": {"point_cloud": CLOUD, "no": 3, "p": [0.1, 0.2, 0.3, 0.4]},
    "odak.tools.read_PLY": {"fn": MESH},
    "odak.tools.read_PLY_point_cloud": {"filename": MESH},
    "odak.tools.save_dictionary": {"settings": {"a": 1.0}, "filename": unwritten("a.json")},
    "odak.tools.save_image": {"fn": unwritten("a.png"), "img": numbers(8, 8) * 255, "cmin": 0.0, "cmax": 255.0},
    "odak.tools.shell_command": {"cmd": ["python", "--version"]},
    "odak.tools.smooth_pad": {"smooth_factor": [0.1, 0.2]},
    "odak.tools.validate_path": {"allowed_extensions": [".txt"], "path": unwritten("a.txt")},
    "odak.tools.validate_shell_command": {"cmd_list": ["python", "--version"]},
    "odak.tools.write_PLY": {"triangles": numbers(3, 3, 3), "savefn": unwritten("a.ply")},
    "odak.tools.write_PLY_from_points": {"points": numbers(3, 4, 3), "savefn": unwritten("a.ply")},
    "odak.tools.write_to_text_file": {"content": ["a", "b"], "filename": unwritten("a.txt")},
}
SIDES = {
    "odak.tools": {"no", "kernel_length", "target_size"},
    "odak.learn.tools": {"no", "kernel_length", "num_control_points"},
    **{f"odak.tools.{name}": {"size"} for name in ("generate_bandlimits", "nuifft2", "smooth_pad", "zero_pad")},
    **{f"odak.learn.tools.{name}": {"size"} for name in ("smooth_pad", "zero_pad")},
}
FREE_TEXT = {
    "odak.tools": {"filename", "key", "content"},
}
POSITIVE = {
    "odak.learn.tools": {"peak_value", "multiplier"},
}
NOT_CALLED = {
    "odak.tools.query_llm": "asks a server that a test does not have",
}
if importlib.util.find_spec("xarray") is None:
    NOT_CALLED["odak.tools.to_xarray"] = "needs the package xarray"
ALLOWED = {
    ("odak.tools.napari_reader", "path", "*"): "documented: None for what it does not read, as napari asks",
    ("odak.tools.save_ome_tiff", "field", "* inside"): "a file keeps not-a-number and infinity",
    ("odak.tools.to_xarray", "field", "* inside"): "an array keeps not-a-number and infinity",
    ("odak*tools.crop_center", "field", "* inside"): "the spoilt sample is cropped away",
    ("odak*tools.cross_product", "vector2", "* inside"): "the second ray's start is not part of the result",
    ("odak*tools.same_side", "*", "* inside"): "a comparison with not-a-number is false",
    ("odak*tools.save_image", "img", "* inside"): "documented: not-a-number is black, infinity the nearest limit",
    ("odak*tools.quantize", "image_field", "* inside"): "documented: not-a-number takes level 0, infinity the nearest",
    ("odak.learn.tools.histogram_loss", "*", "* inside"): "documented: values outside the limits do not count",
    ("odak.learn.tools.evaluate_3d_gaussians", "*", "infinity inside"): "a Gaussian is zero at infinity",
    ("odak.learn.tools.radial_basis_function", "value", "infinity inside"): "the function is zero at infinity",
    ("odak.learn.tools.multi_layer_perceptron.fit", "*_values", "* inside"): "the loss shows it; the result is True",
    ("odak.learn.tools.save_torch_tensor", "tensor", "*"): "documented: whatever torch.save takes",
    ("odak.tools.save_dictionary", "settings", "a text"): "JSON holds a text by itself as well",
    ("odak.tools.copy_dict_with_keys", "d", "*"): "documented: None for what is not a dictionary",
    ("odak.tools.create_group_tensor", "number_of_groups", "*"): "documented: counts only where no shares are given",
    ("odak.tools.write_to_text_file", "content", "a text"): "documented: a string is one item",
    ("odak.tools.zernike_polynomial", "rho", "infinity inside"): "documented: zero beyond the rim",
}
