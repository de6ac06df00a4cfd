"""Valid arguments of the calls on NumPy arrays."""

import numpy
from api_sweep.build import Build, field, numbers, tensor, tensor_field

from odak.raytracing import Conic, get_sphere_normal, sphere_function

RAY = numpy.array([[0.0, 0.0, -5.0], [0.0, 0.0, 1.0]])
TRIANGLE = numpy.array([[-5.0, -5.0, 0.0], [5.0, -5.0, 0.0], [0.0, 5.0, 0.0]])
SPOTS = numpy.array([[-1e-4, 0.0, 0.05], [1e-4, 5e-5, 0.06], [0.0, -1e-4, 0.05]])
RAYS = RAY + numbers(4, 1, 3) * numpy.array([[1.0], [0.0]])
NORMAL = numpy.array([[0.0, 0.0, 0.0], [0.0, 0.1, 1.0]])
MATERIAL = '{"formula": "cauchy", "A": [1.5, 0.004], "range": [0.4, 0.8], "source": "made up"}'
MASKS = numpy.stack([numpy.tri(16), 1 - numpy.tri(16)])

EDGE = 1 / (1 + numpy.exp(12 + 0.15 * numpy.arange(24)[:, None] - numpy.arange(32)))


class _Figure:
    def add_surface(self, **settings):
        self.settings = settings


def _powers(x, parameters):
    return x ** numpy.arange(parameters.size).reshape(parameters.shape)


def _polynomial(x, parameters):
    return (parameters * _powers(x, parameters)).sum()


def _gradient(x, y, function, parameters):
    return 2 * (function(x, parameters) - y) * _powers(x, parameters)


def _loss(truth, estimate):
    return ((truth - estimate) ** 2).mean()


def _materials_file(folder):
    path = folder / "materials.json"
    path.write_text(f'{{"materials": {{"glass {folder.name}": {MATERIAL}}}}}', encoding="utf-8")
    return path


BY_NAME = {
    "odak.wave": {
        "field": field(16, 16),
        "fields": field(2, 16, 16),
        "k": 2 * numpy.pi / 532e-9,
        "distance": 5e-3,
        "distances": [5e-3, 6e-3],
        "dx": 8e-6,
        "wavelength": 532e-9,
        "wavelengths": [532e-9],
        "nx": 16,
        "ny": 16,
        "nu": 16,
        "nv": 16,
        "focal": 0.1,
        "radius": 5e-5,
        "seed": 3,
        "n_iterations": 2,
        "resolution": [16, 16],
        "shape": [16, 16],
        "amplitude": numbers(16, 16),
        "phase": numbers(16, 16),
        "initial_phase": numbers(16, 16),
        "illumination": numbers(16, 16),
        "fixed_phase_after": 1,
        "angle": 0.1,
        "angles": [1.0, 2.0, 3.0],
        "r": 0.1,
        "kernel": field(16, 16),
        "intensities": numbers(3),
        "coefficients": {(2, 0): 0.5, (1, 1): 0.2},
        "width": 5e-9,
        "count": 3,
        "opd": numbers(16, 16),
        "bits": 8,
        "slm_range": 5.0,
        "native_range": 6.28,
        "native_wavelength": 532e-9,
        "working_wavelength": 639e-9,
        "diameter": 5e-3,
        "window_shape": [12, 10],
        "window_dx": 4e-6,
        "waist": 4e-5,
        "numerical_aperture": 0.6,
        "charge": 1,
        "thickness": 2e-5,
        "thicknesses": [9e-8],
        "indices": [1.0, 1.38, 1.52],
        "ordinary": 1.544,
        "extraordinary": 1.553,
        "matrix": field(2, 2),
        "transfer": field(2, 2, 16, 16),
        "target_dx": 1e-7,
    },
    "odak.raytracing": {
        "ray": RAYS,
        "ray0": RAY,
        "ray1": RAY + numpy.array([[0.0, 1.0, 0.0], [0.0, 0.1, 0.0]]),
        "triangle": TRIANGLE,
        "triangle_center": numpy.array([0.1, 0.2, 0.0]),
        "sphere": numpy.array([0.0, 0.0, 0.0, 2.0]),
        "cylinder": numpy.array([0.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0]),
        "circle": [TRIANGLE, [0.0, 0.0, 0.0], 2.0],
        "plane": TRIANGLE,
        "points": TRIANGLE,
        "point": numpy.array([0.1, 0.2, 0.3]),
        "point0": TRIANGLE[0],
        "point1": TRIANGLE[1],
        "point2": TRIANGLE[2],
        "pointtocheck": numpy.array([0.1, 0.2, 0.0]),
        "x0y0z0": numbers(4, 3),
        "x1y1z1": numbers(4, 3, seed=8) + 2,
        "abg": numpy.array([90.0, 60.0, 30.0]),
        "angles": [5.0, 10.0, 15.0],
        "rotation": [5.0, 10.0, 15.0],
        "center": [0.0, 0.1, 0.2],
        "radius": 2.0,
        "distance": 3.0,
        "distances": numpy.array([1.0, 2.0]),
        "error": 0.01,
        "n1": 1.0,
        "n2": 1.5,
        "normal": NORMAL,
        "normvector": NORMAL,
        "input_ray": RAYS,
        "vector": RAYS,
        "parametric_surface": numpy.array([0.0, 0.0, 0.0, 2.0]),
        "surface_function": sphere_function,
        "surface_normal_function": get_sphere_normal,
        "surface": Conic(0.1, -1.0),
        "aperture": 5.0,
        "field": field(8, 8),
        "dx": 1e-6,
        "wavelength": 532e-9,
    },
    "odak.jones": {
        "field": field(2, 4),
        "vector": numpy.array([1.0, 0.2, 0.3, 0.4]),
        "matrix": field(2, 2),
        "px": numbers(4),
        "py": field(4),
        "angle": numbers(3) * 90,
        "rotation": 30.0,
        "retardance": 90.0,
        "rx": field(3),
        "ry": 0.5,
        "first": field(3),
        "second": 0.1,
        "kept": 0.5,
        "wavelength": 550e-9,
        "indices": [1.0, 1.38 + 0.01j, 1.52],
        "thicknesses": [9e-8],
    },
    "odak.learn.jones": {
        "px": tensor(4),
        "py": tensor_field(4),
        "angle": tensor(3) * 90,
        "retardance": 90.0,
        "rx": tensor_field(3),
        "ry": 0.5,
        "first": tensor_field(3),
        "second": 0.1,
        "kept": tensor(3),
    },
    "odak.fit": {
        "x": numbers(6),
        "y": numbers(6, seed=4),
        "w": numbers(6),
        "input_data": numbers(6),
        "ground_truth_data": 2 * numbers(6) + 1,
        "parameters": numpy.array([0.1, 0.2]),
        "function": _polynomial,
        "gradient_function": _gradient,
        "loss_function": _loss,
        "threshold": 0.5,
        "iteration_number": 3,
    },
    "odak.catalog": {
        "name": "N-BK7",
        "wavelength": numpy.array([486e-9, 588e-9]),
        "medium": "air",
        "nd": 1.5168,
        "vd": 64.2,
        "path": Build(_materials_file),
        "ray": RAYS,
        "rays": RAYS,
        "n": 1.5,
        "location": [0.1, 0.2, 0.3],
        "rotation": [1.0, 2.0, 3.0],
        "figure": Build(lambda folder: _Figure()),
    },
    "odak.measurement": {
        "line": EDGE[8],
        "line_x": EDGE[8],
        "line_y": EDGE[9],
        "px_size": [0.1, 0.1],
        "image": EDGE,
        "location": [0, 16, 0, 24],
        "threshold": [0.1, 0.9, 0.1, 0.9],
    },
    "odak.log": {"logger_name": "odak.sweep", "logger_filename": Build(lambda folder: folder / "sweep.log")},
    "odak.tools": {
        "field": numbers(16, 16),
        "angle": 10.0,
        "point": [0.1, 0.2, 0.3],
        "a": numbers(3),
        "b": numbers(3, seed=9),
    },
}
POSITIVE = {
    "odak": {"dx", "wavelength", "pixel_pitch", "focal_length", "real_image_width", "real_viewing_distance", "pitch"},
    "odak.wave": {
        "diameter",
        "window_dx",
        "slm_range",
        "iterations",
        "n_iterations",
        "native_range",
        "working_wavelength",
        "native_wavelength",
        "radius",
        "width",
        "memory",
    },
}
SIDES = {"odak": {"nx", "ny", "nu", "nv", "px", "py", "resolution", "window_shape", "slm_resolution"}}
FREE_TEXT = {"odak": {"title", "label", "name", "color_scale"}, "odak.log": {"logger_name", "logger_datefmt"}}
BY_CALL = {
    "odak.fit.perceptron": {"x": numbers(6, 2), "y": numpy.array([0, 1, 0, 1, 0, 1])},
    "odak.fit.threshold_linear_model": {"x": numbers(6, 3)},
    "odak.catalog.plane_detector": {"field": field(8, 8, 2), "resolution": [8, 8]},
    "odak.catalog.plane_detector.raytrace": {"field": numbers(4, 1), "channel": [0]},
    "odak.catalog.plano_convex_lens": {"item": "LA1024", "wavelength": 5e-4},
    "odak.measurement.polynomial_fit": {"line_x": numpy.arange(32.0)},
    "odak.raytracing.fresnel_coefficients": {"ray": RAYS},
    "odak.raytracing.propagate_parametric_intersection_error": {"distance": [0.5, 1.0], "error": [0.3, 0.1]},
    "odak.raytracing.intersection_kernel_for_parametric_surfaces": {"distance": numpy.array([1.0, 2.0, 3.0, 4.0])},
    "odak.wave.disk_source": {"radius": 1e-3},
    "odak.wave.incoherent_focal_stack_rgbd": {
        "targets": numbers(2, 1, 16, 16),
        "masks": MASKS,
        "apertures": numbers(32, 32),
    },
    "odak.wave.gerchberg_saxton_3d": {"target_type": "double constraint", "coefficients": [1.0, 0.5, 1.0]},
    "odak.wave.propagate_on_disk": {"path": Build(lambda folder: folder / "far.zarr")},
    "odak.wave.hologram_in_chunks": {
        "target": numbers(4, 5),
        "folder": Build(lambda folder: folder / "hologram"),
        "initial_phase": numbers(4, 5),
        "iterations": 1,
    },
    "odak.wave.produce_phase_only_slm_pattern": {
        "hologram": field(16, 16),
        "filename": Build(lambda folder: folder / "pattern.png"),
    },
    "odak.wave.propagate_beam": {"kernel": None},
    "odak.wave.electric_field_per_plane_wave": {"k": 12.0, "w": 2.0, "t": 0.5},
    "odak.wave.propagate_plane_waves": {"k": 12.0, "w": 2.0, "t": 0.5},
    "odak.wave.rotationspeed": {"c": 3e11},
    # A start that half precision represents exactly, because the periods amplify its rounding error.
    "odak.wave.weighted_gerchberg_saxton": {"n_iterations": 1, "initial_phase": (8 * numbers(16, 16)).round() / 8},
    "odak.wave.airy_beam": {"dx": 4e-6, "scale": 4e-5},
    "odak.wave.apply_jones": {"field": field(2, 16, 16)},
    "odak.wave.filter_polarized": {"field": field(2, 16, 16)},
    "odak.wave.focus_polarized": {"field": field(2, 16, 16), "focal": 1e-4, "shape": [6, 5], "distance": 1e-7},
    "odak.wave.longitudinal_field": {"field": field(2, 16, 16)},
    "odak.wave.stokes_parameters": {"field": field(2, 16, 16)},
    "odak.wave.thin_film_transfer": {"dx": 4e-7},
    "odak.wave.axicon_phase": {"index": 1.5},
    "odak.wave.optical_bench.draw": {"height": 300.0, "width": 400},
    "odak.learn.wave.optical_bench.draw": {"height": 300.0, "width": 400},
    "odak.wave.point_spread_function": {"pupil": field(16, 16)},
    "odak.wave.propagate_abcd": {"matrix": numpy.array([[1.0, 0.05], [0.0, 1.0]])},
    "odak.wave.aspheric_lens_phase": {"radius": 1e-3, "index": 1.5, "conic": -1.0, "coefficients": [1e3]},
    "odak.wave.circular_aperture": {"inner_radius": 2e-5},
    "odak.wave.dammann_grating": {"period": 8e-5, "dx": 1e-6, "orders": 5},
    "odak.wave.fresnel_zone_plate": {"focal": 1e-2},
    "odak.wave.propagate_through_medium": {"index": 1.4 + 0.1 * numbers(2, 16, 16), "dz": 1e-6, "dx": 1e-6},
    "odak.wave.scattered_field": {
        "incident": field(6, 6),
        "index": 1 + 0.1 * numbers(6, 6),
        "dx": 1e-7,
        "absorber": 3e-7,
        "tolerance": 0.01,
        "background": 1.0,
    },
    "odak.wave.set_kernel_cache_size": {"maximum_bytes": 2**30},
    "odak.wave.eye_image": {
        "distance": 5e-2,
        "pupil_position": numpy.array([[0.0, 0.0], [0.0, 1e-3]]),
        "pupil_diameter": 1e-3,
        "focus": 6e-2,
        "rotation": [1.0, 2.0],
        "aberrations": {(2, 0): 0.3},
    },
    # A pitch at which a metre, which the sweep tries, is within the range of the methods: others take seconds.
    "odak.wave.sampling_report": {"dx": 2e-4, "distance": 0.5},
    "odak.wave.reference_wave": {"angles": [0.5, 1.0], "amplitude": 2.0},
    "odak.wave.recorded_intensity": {"reference": field(16, 16), "phase_steps": [0.0, 1.0, 2.5]},
    "odak.wave.off_axis_field": {"hologram": numbers(16, 16), "reference": field(16, 16), "bandwidth": 2e4},
    "odak.wave.unwrap_phase": {"phase": numbers(16, 16), "mask": numpy.ones((16, 16), dtype=bool)},
    "odak.wave.zernike_basis": {"modes": [(2, 0), (1, 1)], "radius": 5e-5},
    "odak.tools.save_image": {"fn": Build(lambda folder: folder / "a.png"), "img": numbers(8, 8) * 255},
}
NOT_CALLED = {
    "odak.raytracing.geometry.*": "formulas on plain arrays, checked by the calls that users make; as its siblings",
    "odak.raytracing.RayStatus": "an enumeration of numbers",
    "odak.jones.cascade": "takes any number of matrices and no named argument: test/jones has its errors",
    "odak.learn.jones.cascade": "takes any number of matrices and no named argument: test/jones has its errors",
    "odak.catalog.plane_detector.plot_field": "opens a browser",
}
ALLOWED = {
    ("odak.wave.sampling_report", "field", "in single precision"): "the predicted error includes that of the precision",
    ("odak.wave.propagate_abcd", "matrix", "in half precision"): "its rounding moves the image by many wavelengths",
    ("odak.wave.aspheric_lens_phase", "radius", "a negative number"): "a surface that diverges",
    ("odak.wave.spiral_phase", "charge", "half a step"): "a fractional charge, which has a step",
    ("odak.wave.q_plate", "charge", "half a step"): "a q-plate's charge is a multiple of 1/2",
    ("odak.raytracing.bring_plane_to_origin", "plane", "*"): "not used, as its description says; kept for older calls",
    ("odak.raytracing.bring_plane_to_origin", "shape", "*"): "not used, as its description says; kept for older calls",
    ("odak.raytracing.refract", "error", "*"): "not used, as its description says; kept for older calls",
    ("odak.raytracing.refract", "vector", "* inside"): "is where a ray starts, which has no part in where it goes",
    ("odak.raytracing.reflect", "input_ray", "* inside"): "is where a ray starts, which has no part in where it goes",
    ("odak.raytracing.fresnel_coefficients", "ray", "* inside"): "is where a ray starts: coefficients know directions",
    ("odak.raytracing.fresnel_coefficients", "normal", "* inside"): "is where a normal starts, which has no part here",
    ("odak.raytracing.fresnel_coefficients", "n2", "a complex number"): "an index that absorbs",
    ("odak.raytracing.is_it_on_triangle", "*", "* inside"): "a yes or no: what is not finite lies on no triangle",
    ("odak.raytracing.propagate_a_ray", "distance", "NaN"): "stands for a ray that is lost, and is seen in the result",
    (
        "odak.raytracing.inters*",
        "parametric_surface",
        "*",
    ): "handed on to the caller's own function",
    ("odak*.jones.*", "second", "a complex number"): "transmissions are real or complex",
    ("odak*.jones.*", "ry", "a complex number"): "reflection coefficients are real or complex",
    ("odak*.jones.*", "vector", "* inside"): "S0 has no part in the polarised light, whose vector or ellipse this is",
    ("odak.catalog.thin_diffuser", "phase", "*"): "not used, as its description says; kept for older calls",
    ("odak.catalog.plane_detector.raytrace", "field", "* inside"): "is in the detector's field, not in what comes back",
    ("odak.*", "aperture*", "a complex number"): "an aperture may turn the phase",
    ("odak.wave.calculate_phase", "field", "infinity inside"): "infinity along the real axis has phase zero",
    (
        "odak.wave.produce_phase_only_slm_pattern",
        "hologram",
        "infinity inside",
    ): "infinity along the real axis has phase 0",
    ("odak.wave.fraunhofer_equal_size_adjust", "field", "* inside"): "the spoilt sample is in the part that is cut off",
    ("odak.wave.set_amplitude", "field", "infinity inside"): "only the phase of the field counts, and that is zero",
}
