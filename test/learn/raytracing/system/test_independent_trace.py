"""The NumPy trace that judges automatic designs: against closed forms; and what it finds for the lenses included."""

import importlib.util
import json
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import distortion, first_order, load_system, rms_spot

ROOT = Path(__file__).parents[4]
SPEC = importlib.util.spec_from_file_location("independent_trace", ROOT / "benchmarks" / "independent_trace.py")
TRACE = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(TRACE)
# Sellmeier coefficients B and C of the maker's data sheets (SCHOTT), relative to air, for micrometres.
SELLMEIER = {
    "N-LAK33B": ((1.42288601, 0.593661336, 1.1613526), (0.00670283452, 0.021941621, 80.7407701)),
    "SF5": ((1.46141885, 0.247713019, 0.949995832), (0.0111826126, 0.0508594669, 112.041888)),
    "N-BK7": ((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653)),
}


def index(name, wavelengths):
    squared = (1e3 * np.asarray(wavelengths)) ** 2
    if name.startswith("model "):
        return model_index(*map(float, name.split()[1:]), squared)
    if name not in SELLMEIER:
        return np.ones_like(squared)
    return np.sqrt(1 + sum(b * squared / (squared - c) for b, c in zip(*SELLMEIER[name], strict=True)))


def model_index(nd, vd, squared):
    """Return A + B/λ² + C/λ⁴ with the index at d, the dispersion from F to C and the partial one from g to F."""
    d, f, c, g = (
        np.array([1.0, wavelength**-2, wavelength**-4]) for wavelength in (0.5875618, 0.4861327, 0.6562725, 0.4358343)
    )
    spread = (nd - 1) / vd
    values = np.linalg.solve([d, f - c, g - f], [nd, spread, (0.6438 - 0.001682 * vd) * spread])
    return values[0] + values[1] / squared + values[2] / squared**2


def stored(name):
    """A lens as its file has it, and the indices of its glasses by the formula above."""
    lens = json.loads((ROOT / "odak" / "catalog" / "data" / f"system_{name}.json").read_text())
    media = ["air", *(s.get("material", "air") for s in lens["surfaces"])]
    return lens, np.stack([index(medium, lens["wavelengths"]) for medium in media], -1)


def one_surface(n, radius, conic, thickness, aperture):
    lens = {"surfaces": [{"radius": radius, "conic": conic, "thickness": thickness}], "aperture": aperture}
    return lens | {"reference": 0}, [[1.0, n]]


def test_an_ellipsoid_images_a_distant_point_without_aberration():
    """Of eccentricity 1/n, it has its far focus at n·R/(n − 1)."""
    n, radius = 1.5, 20.0
    found = TRACE.judged(*one_surface(n, radius, -1 / n**2, n * radius / (n - 1), 20.0), [0.0])
    assert found["rms"] < 1e-13 and found["lost"] == 0
    assert found["focal_length"] == pytest.approx(n * radius / (n - 1), rel=1e-9)


def test_a_sphere_refracts_as_trigonometry_says():
    """A ray at height h meets the axis at R + R·sin θ'/sin(θ − θ') with sin θ = h/R, sin θ' = sin θ/n."""
    n, radius, h, thickness = 1.5, 20.0, 6.0, 50.0
    first = math.asin(h / radius)
    second = math.asin(math.sin(first) / n)
    crossing = radius + radius * math.sin(second) / math.sin(first - second)
    expected = abs(thickness - crossing) * math.tan(first - second)
    found = TRACE.judged(*one_surface(n, radius, 0.0, thickness, 2 * h), [0.0], rings=1)
    # One ray at the centre and six at the rim.
    assert found["rms"] == pytest.approx(expected * math.sqrt(6 / 7), rel=1e-12)


def test_the_chief_ray_of_a_thin_lens_goes_straight_on():
    rows = [{"radius": 40.0, "thickness": 1e-9, "stop": True}, {"radius": -30.0, "thickness": 30.0}]
    found = TRACE.judged({"surfaces": rows, "aperture": 5.0, "reference": 0}, [[1.0, 1.5, 1.0]], [20.0])
    assert found["chief_ray_angle"] == pytest.approx(20.0, abs=1e-6) and found["centre"] == 1e-9


def test_edges_of_spheres_and_of_their_flanges():
    """Sags of both spheres at the first one's beam, or that of the second at its own, found by bisection."""
    n, first, second, thickness, h = 1.5, 40.0, -30.0, 6.0, 5.0
    rows = [{"stop": True, "thickness": 0.0}, {"radius": first, "thickness": thickness}, {"radius": second}]
    rows[2]["thickness"] = 30.0
    lens = {"surfaces": rows, "aperture": 2 * h, "reference": 0}
    strict, flat = (TRACE.judged(lens, [[1.0, 1.0, n, 1.0]], [0.0], flanges=option)["edge"] for option in (False, True))

    def sag(radius, y):
        return radius - math.copysign(math.sqrt(radius**2 - y**2), radius)

    fall = math.tan(math.asin(h / first) - math.asin(h / first / n))
    low, high = 0.0, 2 * thickness
    for _ in range(60):
        middle = (low + high) / 2
        short = sag(first, h) + middle < thickness + sag(second, h - fall * middle)
        low, high = (middle, high) if short else (low, middle)
    # The judge's beam includes that of a field of a thousandth of a degree.
    assert strict == pytest.approx(thickness + sag(second, h) - sag(first, h), rel=1e-6)
    assert flat == pytest.approx(thickness + sag(second, h - fall * low) - sag(first, h), rel=1e-5)


# Largest spots in millimetres and distortion.
LENSES = {
    "triplet_f28": (50.0, 2.8, np.linspace(0, 20, 9), 0.0203, 0.0095),
    "phone_f2": (4.55, 2.0, np.linspace(0, 40, 33), 0.0028, 0.02),
}


@pytest.mark.parametrize("name", ["triplet_f28", pytest.param("phone_f2", marks=pytest.mark.slow)])
def test_lenses_designed_automatically_are_judged(name):
    focal_length, f_number, angles, size, bent = LENSES[name]
    found = TRACE.judged(*stored(name), angles)
    assert found["focal_length"] == pytest.approx(focal_length, rel=1e-6)
    assert found["f_number"] == pytest.approx(f_number, rel=1e-6)
    assert found["rms"] < size and found["distortion"] < bent
    assert found["edge"] > 0 and found["lost"] == 0


@pytest.mark.parametrize("name", [*LENSES, "cooke_triplet", "double_gauss_f28"])
def test_the_library_finds_the_same(name):
    """Spots by the same rays, at the library's indices."""
    lens = load_system(name)
    rings = [(0.0, 0.0)] + [
        (k / 4 * math.cos(p + 0.37 * k), k / 4 * math.sin(p + 0.37 * k))
        for k in range(1, 5)
        for p in np.arange(6 * k) * math.pi / (3 * k)
    ]
    angles = [field[1] for field in lens.fields]
    plain = json.loads((ROOT / "odak" / "catalog" / "data" / f"system_{name}.json").read_text())
    found = TRACE.judged(plain, lens.prescription().index.detach(), angles, rings=4)
    ours = rms_spot(lens, torch.tensor(rings, dtype=torch.float64), vignetting=False)
    np.testing.assert_allclose(ours.detach(), found["sizes"], rtol=1e-9)
    assert float(first_order(lens).focal_length) == pytest.approx(found["focal_length"], rel=1e-8)
    assert float(distortion(lens)[lens.reference].abs().max()) == pytest.approx(found["distortion"], abs=1e-6)
