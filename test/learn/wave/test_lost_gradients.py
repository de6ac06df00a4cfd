"""Numbers that require gradients: the result carries them, or a warning says that it does not."""

import pytest
import torch

import odak
from odak.learn import perception, wave
from odak.learn.raytracing import system


def number(value):
    return torch.tensor(value, dtype=torch.float64, requires_grad=True)


def test_quadratures_of_light_sources():
    def directions(radius, y, x):
        return wave.disk_source(radius, 2, 3, (y, x))[0]

    assert torch.autograd.gradcheck(directions, (number(0.3), number(0.1), number(-0.2)), fast_mode=True)

    def wavelengths(wavelength, width):
        # In micrometres, so that differences of the check are not those of rounding.
        return wave.gaussian_spectrum(wavelength * 1e-6, width * 1e-6, 4)[0] * 1e6

    assert torch.autograd.gradcheck(wavelengths, (number(0.55), number(0.02)), fast_mode=True)


@pytest.mark.parametrize(
    "chart",
    [
        lambda w, d, x, y: perception.make_3d_location_map([3, 4], w, d, dtype=torch.float64) + 0 * (x + y),
        lambda w, d, x, y: torch.stack(
            perception.make_eccentricity_distance_maps((x, y), [3, 4], w, d, dtype=torch.float64)
        ),
        lambda w, d, x, y: perception.make_pooling_size_map_pixels((x, y), [3, 4], 0.3, w, d, dtype=torch.float64),
        lambda w, d, x, y: perception.make_radial_map([3, 4], (x, y), dtype=torch.float64) * w * d,
        lambda w, d, x, y: perception.make_equi_pooling_size_map_pixels((x, y), [3, 4], dtype=torch.float64) * w * d,
    ],
)
def test_maps_of_the_visual_field(chart):
    assert torch.autograd.gradcheck(chart, (number(0.3), number(0.6), number(0.31), number(0.42)), fast_mode=True)


def ones():
    return torch.ones(4, 4, dtype=torch.complex64)


def focal_targets(pitch):
    geometry = {"number_of_planes": 2, "wavelengths": [5e-7], "distances": [0.0, 2e-3]}
    return wave.multiplane_loss(torch.ones(1, 4, 4), torch.ones(4, 4), pixel_pitch=pitch, **geometry)


def optimised(distance, pitch):
    return wave.stochastic_gradient_descent(torch.ones(4, 4), 5e-7, distance, pitch, n_iteration=1, progress=False)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("pupil_diameter", lambda v: system.eye_refraction(pupil_diameter=1e3 * v)),
        ("pitch", lambda v: system.eye_transfer_function((4, 4), v)),
        ("dx", lambda v: wave.pupil_function([4, 4], v, 5e-7, 0.1)),
        ("alpha", lambda v: perception.RadiallyVaryingBlur().blur(torch.ones(1, 1, 8, 8), v)),
        ("centre", lambda v: perception.RadiallyVaryingBlur().blur(torch.ones(1, 1, 8, 8), centre=(v, 0.5))),
        ("distance", lambda v: wave.gerchberg_saxton(torch.ones(4, 4, dtype=torch.complex64), 1, v, 8e-6, 5e-7)),
        ("dx", lambda v: wave.point_wise(torch.ones(4, 4), 5e-7, 3e-3, (8e-6, v), None, lens_size=3)),
        ("pixel_pitch", lambda v: optimised(3e-3, v / 375)),
        ("distance", lambda v: optimised(v, 8e-6)),
        ("period", lambda v: wave.dammann_grating((4, 4), v, 1e-5)),
        ("pixel_pitch", lambda v: focal_targets(v / 375)),
        ("k", lambda v: wave.propagate_beam(ones(), v * (2 * torch.pi / 3e-3 / 5e-7), 1e-4, 8e-6, 5e-7)),
    ],
)
def test_a_gradient_that_is_lost_is_reported(name, call):
    with pytest.warns(odak.AccuracyWarning, match=f"{name} requires a gradient"):
        call(number(3e-3))
    with torch.no_grad():
        call(number(3e-3))
    call(3e-3)
