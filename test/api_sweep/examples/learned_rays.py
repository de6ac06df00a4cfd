"""Valid arguments of odak.learn.raytracing and its optical systems."""

import functools

import torch
from api_sweep.build import Build, tensor

from odak.learn.raytracing import Conic, define_circle, define_cylinder, light_source, sphere_function
from odak.learn.raytracing.system import (
    Coating,
    Perturbation,
    Variable,
    configurations,
    first_order,
    huygens_point_spread_function,
    launch,
    optical_system,
    point_spread_function,
    point_spread_map,
    save_system,
    sensitivity,
    spot_diagram,
    surface,
    system_to_dict,
    wavefront,
    write_len,
    write_seq,
    write_zmx,
)
from odak.raytracing.gradients import RadialGradient

HERE = "odak.learn.raytracing"
# Numbers that half precision holds.
RAY = torch.tensor([[0.125, 0.25, -5.0], [0.0, 0.0, 1.0]])
RAYS = torch.stack([RAY, RAY + torch.tensor([[0.5, 0.0, 0.0], [0.0, 0.0, 0.0]])])
TRIANGLE = torch.tensor([[-5.0, -5.0, 0.0], [5.0, -5.0, 0.0], [0.0, 5.0, 0.0]])
VERTICES = torch.tensor([[-5.0, -5.0, 0.0], [5.0, -5.0, 0.0], [0.0, 5.0, 0.0], [0.0, -9.0, 1.0]])


def _zoom():
    return configurations(_lens(), [("thickness", -1, [97.0, 96.0])])


def _lens():
    surfaces = [surface(51.5, thickness=4.0, material="N-BK7", semi_diameter=8.0), surface(thickness=97.0)]
    return optical_system(surfaces, aperture=10.0, fields=(0.0, 2.0), wavelengths=[486.1e-6, 587.6e-6], name="a lens")


def _wave_lens():
    return optical_system([surface(5.0, material=1.5, thickness=0.2), surface(thickness=9.8)], aperture=0.1)


def _near_lens():
    lens = [surface(5.0, material=1.5, thickness=0.2), surface(thickness=9.8)]
    return optical_system(lens, aperture=0.1, object_distance=9.8)


def _rod():
    rod = surface(thickness=2.0, material=1.5, gradient=RadialGradient([-0.01]))
    return optical_system([rod, surface()], aperture=1.0)


@functools.cache
def _rod_rays():
    return launch(_rod(), "y", 3)


def _spread():
    return point_spread_map(_lens(), (9, 9), 0.05, grid=(2, 2), kernel=5, count=2)


def _sensitivity():
    return sensitivity(_lens(), [Perturbation("radius", 0, 1e-3, relative=True)])


def _cylinder():
    return define_cylinder(torch.zeros(3), 2.0, (90.0, 0.0, 0.0))[0]


def _saved(folder, write, name):
    write(_lens(), folder / name)
    return folder / name


PLACE = torch.tensor([1.0, 2.0], dtype=torch.float64, requires_grad=True)


def _start():
    with torch.no_grad():
        PLACE.copy_(torch.tensor([1.0, 2.0]))
    return [PLACE]


DESIGN = {"operands": ["spot"], "variables": Build(lambda _: [Variable("curvature", 0)]), "count": 1, "pupil": "rings"}
LENS = Build(lambda _: _lens())
BY_NAME = {
    HERE: {
        "ray": RAYS,
        "ray0": RAY,
        "ray1": RAY + torch.tensor([[0.0, 1.0, 0.0], [0.0, 0.125, 0.0]]),
        "rays": RAYS,
        "input_ray": RAYS,
        "normal": torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.6, -0.8]]),
        "vector": RAYS,
        "normvector": torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]),
        "n1": 1.0,
        "n2": 1.5,
        "triangle": TRIANGLE,
        "points": TRIANGLE,
        "point_to_check": torch.tensor([[0.1, 0.2, 0.0], [9.0, 0.2, 0.0]]),
        "sphere": torch.tensor([0.0, 0.0, 0.0, 2.0]),
        "cylinder": Build(lambda _: _cylinder()),
        "circle": Build(lambda _: define_circle(torch.zeros(3), 2.0, torch.zeros(3))),
        "point": torch.tensor([0.1, 0.2, 0.3]),
        "angles": torch.tensor([5.0, 10.0, 15.0]),
        "angle_limit": 10.0,
        "center": torch.tensor([0.1, 0.2, 0.3]),
        "radius": 2.0,
        "tilt": torch.tensor([5.0, 10.0, 15.0]),
        "rotation": torch.tensor([5.0, 10.0, 15.0]),
        "offset": torch.tensor([0.1, 0.2, 0.3]),
        "size": [4.0, 6.0],
        "no": [2, 3],
        "num_ray": 4,
        "num_ray_per_light": 4,
        "origin": torch.tensor([0.1, 0.2, 0.3]),
        "seed": 3,
        "resolution": [4, 6],
        "number_of_meshes": [3, 4],
        "heights": tensor(3, 4, 1),
        "device": torch.device("cpu"),
        "distance": 3.0,
        "distances": torch.tensor([1.0, 2.0]),
        "x0y0z0": tensor(4, 3),
        "x1y1z1": tensor(4, 3, seed=9),
        "xyz": tensor(4, 3),
        "abg": 90 * tensor(4, 3),
        "vertices": VERTICES,
        "faces": torch.tensor([[0, 1, 2], [0, 3, 1]]),
        "surface": Conic(0.01),
        "parametric_surface": torch.tensor([0.0, 0.0, 0.0, 2.0]),
        "surface_function": sphere_function,
        "aperture": 4.0,
        "minimum_distance": 0.1,
        "leaving": torch.tensor([-1, -1]),
        "triangle_center": torch.tensor([0.1, 0.2, 0.3]),
        "filename": Build(lambda folder: folder / "mesh.ply"),
    },
    f"{HERE}.system": {
        "system": LENS,
        "count": 3,
        "size": 32,
        "seed": 3,
        "entry": Build(lambda _: system_to_dict(_lens())),
        "spread": Build(lambda _: point_spread_function(_lens(), 32, 64)),
        "axis": "y",
        "rays": Build(lambda _: launch(_lens(), count=1)),
        "surfaces": Build(lambda _: list(_lens().surfaces)),
        "aperture": 10.0,
        "wavelengths": [486.1e-6, 587.6e-6],
        "wavelength": 587.6e-6,
        "fields": [[0.0, 0.0], [0.0, 2.0]],
        "reference": 1,
    },
}
BY_CALL = {
    f"{HERE}.is_it_on_triangle_batch": {
        "point_to_check": tensor(2, 5, 3),
        "triangle": torch.stack([TRIANGLE, TRIANGLE]),
    },
    f"{HERE}.intersect_w_triangle_batch": {"triangle": torch.stack([TRIANGLE, TRIANGLE + 0.1])},
    f"{HERE}.intersect_w_surface_batch": {"triangle": torch.stack([TRIANGLE, TRIANGLE + 0.1])},
    f"{HERE}.bring_plane_to_origin": {"point": tensor(4, 3)},
    f"{HERE}.planar_mesh.save_heights": {"filename": Build(lambda folder: folder / "heights.pt")},
    f"{HERE}.triangle_mesh.write_PLY": {"filename": Build(lambda folder: folder / "mesh.ply")},
    f"{HERE}.intersect_parametric": {"iter_no_limit": 100},
    f"{HERE}.system.navarro_eye": {"wavelengths": [550e-9]},
    f"{HERE}.system.liou_brennan_eye": {"wavelengths": [550e-9]},
    f"{HERE}.system.eye_wavefront": {"radius": 1e-3 * tensor(3), "wavelengths": [550e-9]},
    f"{HERE}.system.eye_refraction": {"wavelengths": [550e-9]},
    f"{HERE}.system.eye_transfer_function": {"size": [8, 8], "pitch": 1e-3, "wavelengths": [550e-9]},
    f"{HERE}.system.retinal_image": {
        "picture": tensor(1, 8, 8),
        "vergences": 1.0,
        "pitch": 1e-3,
        "wavelengths": [550e-9],
    },
    f"{HERE}.system.retinal_field": {
        "field": tensor(16, 16) + 0j,
        "pitch": 5e-4,
        "wavelength": 550e-9,
        "rotation": [1.0, 2.0],
        "center": "gaze",
    },
    f"{HERE}.system.accommodation_response": {
        "picture": tensor(1, 16, 16),
        "vergences": 1.0,
        "pitch": 1e-3,
        "wavelengths": [550e-9],
        "accommodations": [0.5, 1.0, 1.5],
    },
    f"{HERE}.system.airy_pattern": {"radius": 2e-3 * tensor(5), "wavelength": 5e-4, "numerical_aperture": 0.1},
    f"{HERE}.system.draw_spots": {"found": Build(lambda _: spot_diagram(_lens(), count=2))},
    f"{HERE}.system.exit_field": {"wavelength": 0, "size": [64, 64], "system": Build(lambda _: _wave_lens())},
    f"{HERE}.system.TracedSystem": {"grid": [3, 3], "system": Build(lambda _: _near_lens())},
    f"{HERE}.system.TracedSystem.apply": {"field": tensor(16, 16) + 0j, "pitch": 8e-6, "wavelength": 550e-9},
    f"{HERE}.system.propagated_point_spread_function": {"size": 64, "system": Build(lambda _: _wave_lens())},
    f"{HERE}.detector.intersect": {"distances": True},
    f"{HERE}.system.levenberg_marquardt": {
        "residuals": lambda: PLACE**2 - 3,
        "parameters": Build(lambda _: _start()),
        "iterations": 2,
    },
    f"{HERE}.system.load_system": {"path": Build(lambda folder: _saved(folder, save_system, "lens.json"))},
    f"{HERE}.system.read_zmx": {"path": Build(lambda folder: _saved(folder, write_zmx, "lens.zmx"))},
    f"{HERE}.system.read_seq": {"path": Build(lambda folder: _saved(folder, write_seq, "lens.seq"))},
    f"{HERE}.system.read_len": {"path": Build(lambda folder: _saved(folder, write_len, "lens.len"))},
    f"{HERE}.system.write_len": {"path": Build(lambda folder: folder / "lens.len")},
    f"{HERE}.system.write_seq": {"path": Build(lambda folder: folder / "lens.seq")},
    f"{HERE}.system.configurations": {"settings": [("thickness", -1, [97.0, 96.0])]},
    f"{HERE}.system.configurations.vary": {"name": "thickness", "place": -1},
    f"{HERE}.system.configurations.view": {"place": 0},
    f"{HERE}.system.configurations.each": {"function": first_order},
    f"{HERE}.system.in_environment": {"temperature": 30.0, "pressure": 9e4},
    f"{HERE}.system.save_system": {"path": Build(lambda folder: folder / "lens.json")},
    f"{HERE}.system.write_zmx": {"path": Build(lambda folder: folder / "lens.zmx")},
    f"{HERE}.system.spot_diagram": {"reference": "centroid"},
    f"{HERE}.system.point_spread_function": {"samples": 16},
    f"{HERE}.system.polarized_point_spread_function": {"samples": 16, "size": 32, "polarization": [1.0, 0.5]},
    f"{HERE}.system.Coating": {"media": (1.38,), "thicknesses": [1e-4], "substrate": None},
    f"{HERE}.system.needle_design": {
        "start": Build(lambda _: Coating((2.1,), [1e-4])),
        "media": [1.38, 2.1],
        "between": ("air", 1.52),
        "wavelengths": [5e-4, 6e-4],
        "films": 2,
    },
    f"{HERE}.system.point_spread_map": {"shape": [9, 9], "pitch": 0.05, "grid": [2, 2], "kernel": 5, "count": 2}
    | {"response": [[1.0, 2.0]]},
    f"{HERE}.system.simulate_image": {"picture": tensor(1, 9, 9), "spread": Build(lambda _: _spread())},
    f"{HERE}.system.expose_sensor": {"irradiance": tensor(3, 4, 6), "pattern": "RGGB"},
    f"{HERE}.system.demosaic": {"raw": tensor(1, 4, 6)},
    f"{HERE}.system.tolerance": {
        "perturbations": Build(lambda _: [Perturbation("radius", 0, 1e-3, relative=True)]),
        "samples": 3,
    },
    f"{HERE}.system.automatic_design": {
        "elements": ["stop", "N-BK7"],
        "focal_length": 100.0,
        "f_number": 10.0,
        "half_field": 0.0,
        "wavelengths": [587.5618e-6],
        "starts": 1,
        "stages": 1,
        "iterations": 1,
        "polish": 0,
    },
    f"{HERE}.system.lens_limits": {"limits": {"track": 50.0}},
    f"{HERE}.system.lens_design": DESIGN,
    f"{HERE}.system.lens_design.optimise": {"iterations": 1},
    f"{HERE}.system.lens_design.restarts": {"count": 2, "spread": 0.2, "iterations": 1},
    f"{HERE}.system.lens_design.apply": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.lens_design.substitute_glasses": {"candidates": 1, "iterations": 1},
    f"{HERE}.system.lens_design.prescription": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.lens_design.residuals": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.lens_design.linearised": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.lens_design.view": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.lens_design.clear_heights": {"values": torch.tensor([0.02], dtype=torch.float64)},
    f"{HERE}.system.standard_design": {"limits": {"track": 120.0}, "makers": None},
    f"{HERE}.system.zoom_design": DESIGN | {"zoom": Build(lambda _: _zoom())},
    f"{HERE}.system.zoom_design.optimise": {"iterations": 1},
    f"{HERE}.system.zoom_design.restarts": {"count": 2, "spread": 0.2, "iterations": 1},
    f"{HERE}.system.zoom_design.substitute_glasses": {"candidates": 1, "iterations": 1},
    **{
        f"{HERE}.system.zoom_design.{name}": {"values": torch.tensor([0.02], dtype=torch.float64)}
        for name in ("apply", "prescription", "residuals", "linearised", "view", "clear_heights")
    },
    f"{HERE}.system.huygens_point_spread_function": {"samples": 24, "size": 16},
    f"{HERE}.system.modulation_at": {
        "spread": Build(lambda _: huygens_point_spread_function(_lens(), 24, 16)),
        "frequency": 5.0,
    },
    f"{HERE}.system.field_modulation": {"frequencies": [5.0], "samples": 16},
    f"{HERE}.system.incidence_angles": {"count": 3},
    f"{HERE}.system.pupil_aberration": {"count": 3},
    f"{HERE}.system.performance_figure": {"points": 3, "frequencies": [5.0]},
    f"{HERE}.system.pupil_figure": {"place": 0},
    f"{HERE}.system.strehl_ratio": {"count": 4},
    f"{HERE}.system.pupil_quadrature": {"count": 2},
    f"{HERE}.system.q_fit": {"found": Build(lambda _: wavefront(_lens(), count=4)), "radial": 2, "azimuthal": 2},
    f"{HERE}.system.zernike_fit": {"found": Build(lambda _: wavefront(_lens(), count=4)), "terms": 6},
    f"{HERE}.system.surface": {
        "radius": 51.5,
        "coefficients": [0.0, 1e-6],
        "semi_diameter": 8.0,
        "tilt": [0.0, 1.0],
        "aperture": None,
    },
    f"{HERE}.system.surface.vary": {"name": "curvature", "aperture": None},
    f"{HERE}.system.coordinate_break": {"tilt": [0.0, 1.0, 2.0], "return_to": None},
    f"{HERE}.system.coordinate_break.vary": {"name": "thickness"},
    f"{HERE}.system.trace": {"until": 1},
    f"{HERE}.system.curved_paths": {"system": Build(lambda _: _rod()), "rays": Build(lambda _: _rod_rays())}
    | {"place": 0, "ends": tensor(1, 1, 3, 3), "count": 2},
    f"{HERE}.system.encircled_energy": {"found": Build(lambda _: spot_diagram(_lens(), count=2)), "radii": [0.1, 0.2]},
    f"{HERE}.system.fans_figure": {"count": 5},
    f"{HERE}.system.path_fan": {"count": 5},
    f"{HERE}.system.field_figure": {"points": 3},
    f"{HERE}.system.spots_figure": {"found": Build(lambda _: spot_diagram(_lens(), count=2))},
    f"{HERE}.system.transfer_figure": {"samples": 16},
    f"{HERE}.Element": {"name": "a screen"},
    f"{HERE}.RayScene.trace": {
        "light": Build(lambda _: light_source("point", 8, half_angle=60.0, center=(0.0, 0.0, -3.0))),
        "wavelength": 550e-6,
    },
    f"{HERE}.system.through_focus": {"shifts": [-0.1, 0.0]},
    f"{HERE}.system.through_focus_modulation": {"shifts": [-0.1, 0.0], "frequency": 5.0, "samples": 32},
    f"{HERE}.system.through_focus_figure": {"shifts": [-0.1, 0.0, 0.1], "frequency": 5.0},
    f"{HERE}.system.axial_color": {"wavelengths": [550e-6, 600e-6]},
    f"{HERE}.system.distortion_grid": {"points": 3},
    f"{HERE}.system.footprint": {"place": 0, "count": 2},
    f"{HERE}.system.footprint_figure": {"places": [0, 1]},
    f"{HERE}.system.wavefront_figure": {"samples": 8},
    f"{HERE}.system.image_figure": {"points": 3},
    f"{HERE}.system.polarisation_figure": {"samples": 4},
    f"{HERE}.system.sensitivity": {
        "perturbations": Build(lambda _: [Perturbation("radius", 0, 1e-3, relative=True)]),
    },
    f"{HERE}.system.tolerances_for_yield": {
        "perturbations": Build(lambda _: [Perturbation("radius", 0, 1e-3, relative=True)]),
        "limit": 1.0,
        "samples": 2,
    },
    f"{HERE}.system.tolerance_figure": {"found": Build(lambda _: _sensitivity())},
    f"{HERE}.system.lens_report": {"path": Build(lambda folder: folder / "report.html"), "figures": {}},
    f"{HERE}.system.seidel_sums": {"field": 1.0},
    f"{HERE}.system.ghost_system": {"first": 0, "second": 1},
    f"{HERE}.system.scaled_system": {"factor": 2.0},
    f"{HERE}.system.lens_solids": {"segments": 8},
    f"{HERE}.system.save_solids": {"path": Build(lambda folder: folder / "lens.stl"), "segments": 8},
    f"{HERE}.system.flipped_system": {"first": 0, "last": 1},
    f"{HERE}.system.optical_system": {
        "image": Build(lambda _: surface(-50.0)),
        "fields": [0.0, 2.0],
        "name": "a lens",
    },
}
POSITIVE = {
    HERE: {"colors", "count", "samples", "terms", "iterations", "numerical_aperture"},
    f"{HERE}.system": {"aperture", "size", "semi_diameter", "wavelengths"},
}
SIDES = {HERE: {"no", "number_of_meshes"}, f"{HERE}.system.exit_field": {"size"}}
FREE_TEXT = {HERE: {"name", "source"}}
NO_USE = "kept so that older calls work, counts nowhere"
START = "only the direction counts: the result starts where the normal does"
ALLOWED = {
    (f"{HERE}.bring_plane_to_origin", "plane", "*"): NO_USE,
    (f"{HERE}.bring_plane_to_origin", "shape", "*"): NO_USE,
    (f"{HERE}.intersect_w_sphere", "learning_rate", "*"): NO_USE,
    (f"{HERE}.intersect_w_sphere", "number_of_steps", "*"): NO_USE,
    (f"{HERE}.intersect_w_sphere", "error_threshold", "*"): NO_USE,
    (f"{HERE}.refract", "error", "*"): NO_USE,
    (f"{HERE}.refract", "vector", "* inside"): START,
    (f"{HERE}.reflect", "input_ray", "* inside"): START,
    (f"{HERE}.fresnel_coefficients", "ray", "* inside"): "only directions count",
    (f"{HERE}.fresnel_coefficients", "normal", "* inside"): "only directions count",
    (f"{HERE}.fresnel_coefficients", "n2", "a complex number"): "the index of what absorbs",
    (f"{HERE}.create_ray_from_*_w_luminous_angle", "*", "in double precision"): "other precisions draw other numbers",
    (f"{HERE}.is_it_on_triangle*", "*", "* inside"): "what is not finite lies nowhere: False, as documented",
    (f"{HERE}.planar_mesh.mirror", "rays", "* inside"): "rays that miss are left out, as documented",
    (f"{HERE}.intersect_parametric", "parametric_surface", "*"): "handed on to the caller's functions, which judge it",
    (f"{HERE}.system.exit_field", "wavelength", "zero"): "the number of one of the system's wavelengths",
    (f"{HERE}.system.exit_field", "wavelength", "a negative number"): "counted from the last of the wavelengths",
    (f"{HERE}.system.surface", "material", "a number"): "an index that holds for all wavelengths, as documented",
    (f"{HERE}.system.Conjugates", "object_material", "a number"): "an index of all wavelengths, as documented",
}
