"""One word for one thing: names of the parameters of all that is public."""

import dataclasses
import inspect
from collections import defaultdict
from fnmatch import fnmatchcase

import pytest
from api_sweep import walk

# Beside `pitch`, the distance of a device's pixels, `dx` is the distance of a field's samples.
WORDS = {
    "iterations": ["n_iteration", "n_iterations", "number_of_iterations", "iteration_number", "n_iter"],
    "pitch": ["pixel_pitch", "slm_pitch", "pixel_size"],
    "resolution": ["nx", "ny"],
    "focal_length": ["focal", "focal_distance"],
    "center": ["centre", "centers", "centres"],
    "color": ["colour"],
    "filename": ["fn", "file_name"],
    "learning_rate": ["lr", "step_size"],
    "propagation_type": ["prop_type", "propagation_method"],
    "seed": ["random_state", "rng"],
    "initial_phase": ["phase_initial", "start_phase"],
    "progress": ["verbose", "verbosity"],
}
# Older functions, whose scripts name them so, and those beside them that take the same: this only shrinks.
OLDER = {
    "n_iteration": ["wave.stochastic_gradient_descent"],
    "n_iterations": ["wave.*gerchberg_saxton*", "wave.spot_hologram"],
    "number_of_iterations": ["wave.*_hologram_optimizer*"],
    "iteration_number": ["fit.gradient_descent_1d", "fit.perceptron"],
    "pixel_pitch": [
        "measurement.slanted_edge_mtf", "perception.display_color_hvs", "wave.*multiplane_loss", "wave.propagator",
        "wave.holographic_display", "wave.shift_w_double_phase", "wave.simulated_camera",
        "wave.stochastic_gradient_descent",
    ],
    "nx": ["wave.*_grating", "wave.double_convergence", "wave.*_phase_function", "wave.zernike_*"],
    "ny": ["wave.*_grating", "wave.double_convergence", "wave.*_phase_function", "wave.zernike_*"],
    "focal": [
        "wave.*lens_phase", "wave.quadratic_phase_function", "wave.fresnel_zone_plate", "wave.ThinLens",
        "wave.focus_polarized", "wave.rayleigh_resolution", "wave.spot_hologram",
    ],
    "centre": ["perception.RadiallyVaryingBlur.*"],
    "centers": ["models.gaussian_3d_volume.initialize_parameters", "tools.evaluate_3d_gaussians"],
    "colour": ["perception.VisibilityLoss"],
    "fn": ["tools.load_image", "tools.save_*", "tools.torch_load", "tools.read_PLY", "visualize.blender.render"],
    "step_size": ["wave.speckle_contrast"],
    "phase_initial": ["wave.multiplane_hologram_optimizer*"],
    "verbose": ["manager.agent", "models.gaussian_3d_volume.optimize", "visualize.blender.scene.*"],
}  # fmt: skip
pytestmark = pytest.mark.xdist_group("structure")


def public():
    """Return functions, classes, records and methods by their shortest names."""
    found = walk.public_callables()
    for module in walk.public_modules():
        records = ((name, getattr(module, name)) for name in getattr(module, "__all__", ()))
        found |= {f"{module.__name__}.{name}": one for name, one in records if dataclasses.is_dataclass(one)}
    return found


def test_parameters_have_the_words_of_the_vocabulary():
    used = defaultdict(set)
    for path, function in public().items():
        for name in inspect.signature(function).parameters:
            used[name].add(path.removeprefix("odak.").removeprefix("learn."))
    wrong, left = {}, {}
    for word, others in WORDS.items():
        for other in others:
            allowed = OLDER.get(other, ())
            new = {path for path in used[other] if not any(fnmatchcase(path, pattern) for pattern in allowed)}
            wrong |= dict.fromkeys(new, f"{other}: call it {word}")
            gone = {pattern for pattern in allowed if not any(fnmatchcase(path, pattern) for path in used[other])}
            left |= {other: gone} if gone else {}
    assert not wrong
    assert not left, "no longer needed"
