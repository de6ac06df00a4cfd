"""Gradients in the conditions of use: aperture, fields, object distance, temperature and pressure, by differences."""

import copy
import math

import matplotlib.pyplot as plt
import pytest
import torch

from odak.learn.raytracing.system import (
    Conjugates,
    Fields,
    SystemAperture,
    distortion,
    field_figure,
    first_order,
    huygens_point_spread_function,
    in_environment,
    iso_10110_tolerances,
    modulation_transfer_function,
    optical_system,
    paraxial_rays,
    point_spread_function,
    point_spread_map,
    read_zmx,
    relative_illumination,
    rms_spot,
    scaled_system,
    seidel_sums,
    simulate_image,
    surface,
    system_from_dict,
    system_to_dict,
    wavefront,
    write_zmx,
)
from odak.raytracing.interfaces import IdealLens

MEDIA = [("N-SK16", 3.259), ("air", 6.008), ("N-F2", 1.0), ("air", 4.75), ("N-SK16", 2.952), ("air", 42.208)]
RADII = [22.01, -435.8, -22.21, 20.29, 79.68, -18.40]


def triplet(
    aperture=10.0, kind: str = "EPD", field=10.0, distance: float | torch.Tensor = math.inf, image: float = 42.208
) -> optical_system:
    rows = [(bend, *medium) for bend, medium in zip(RADII, [*MEDIA[:-1], ("air", image)], strict=True)]
    items = [surface(r, thickness=t, material=m, stop=i == 3) for i, (r, m, t) in enumerate(rows)]
    return optical_system(
        items,
        SystemAperture(aperture, kind),
        fields=Fields([0.0, field]),
        wavelengths=["588nm"],
        conjugates=Conjugates(distance),
    )


BUILDS = {
    "EPD": (lambda v: triplet(v), 10.0),
    "F-number": (lambda v: triplet(v, "F-number"), 5.0),
    "stop": (lambda v: triplet(v, "stop"), 7.0),
    "NA": (lambda v: triplet(v, "NA", 20.0, 300.0, 50.0), 0.012),
    "field": (lambda v: triplet(field=v), 10.0),
    "object field": (lambda v: triplet(8.0, field=v, distance=300.0, image=50.0), 20.0),
    "distance": (lambda v: triplet(8.0, field=20.0, distance=v, image=50.0), 300.0),
    "temperature": (lambda v: in_environment(triplet(), v, mount=20e-6), 40.0),
    "pressure": (lambda v: in_environment(triplet(), pressure=v), 6e4),
}


def picture(lens: optical_system) -> torch.Tensor:
    scene = torch.rand(1, 16, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    seen = simulate_image(scene, point_spread_map(lens, (16, 16), 0.5, grid=(3, 3), count=4, kernel=15))
    return (seen * torch.linspace(0, 1, 16, dtype=torch.float64)).sum()


def transfer(lens: optical_system) -> torch.Tensor:
    return modulation_transfer_function(point_spread_function(lens, 64, 64))[1][..., 6].sum()


RESULTS = {
    "rms_spot": lambda lens: rms_spot(lens).sum(),
    "rms_spot, aimed": lambda lens: rms_spot(lens, aim="real").sum(),
    "wavefront": lambda lens: wavefront(lens, "rings", 4).rms.sum(),
    "modulation": transfer,
    "huygens": lambda lens: huygens_point_spread_function(lens, 40, 32, 1e-3).intensity.square().sum(),
    "simulate_image": picture,
    "distortion": lambda lens: distortion(lens).sum(),
    "illumination": lambda lens: relative_illumination(lens, 4).sum(),
    "illumination, aimed": lambda lens: relative_illumination(lens, 3, aim="real").sum(),
    "seidel": lambda lens: seidel_sums(lens).seidel.sum(),
    "paraxial": lambda lens: paraxial_rays(lens).chief_height.sum() + first_order(lens).image_distance,
}
QUICK = ("rms_spot", "rms_spot, aimed", "wavefront", "distortion", "seidel", "paraxial")
SLOW = ("EPD", "field", "distance", "temperature")
# A sensor sees the same picture whatever the fields of the system are. Rays that are aimed depend on temperature and
# distance as those of the spots do, and the light that they carry as that of others.
LEFT_OUT = {("field", "simulate_image"), ("temperature", "illumination, aimed"), ("distance", "illumination, aimed")}
CASES = [
    (build, result)
    for build in BUILDS
    for result in RESULTS
    if (result in QUICK or build in SLOW) and (build, result) not in LEFT_OUT
]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("build", "result"), CASES)
def test_gradients_in_conditions_are_those_of_differences(build, result):
    make, start = BUILDS[build]

    def value(number):
        return RESULTS[result](make(number))

    given = torch.tensor(start, dtype=torch.float64, requires_grad=True)
    found = value(given)
    gradient = torch.autograd.grad(found, given)[0].item() if found.requires_grad else 0.0
    step = 1e-4 * start
    expected = float(value(start + step) - value(start - step)) / (2 * step)
    assert gradient == pytest.approx(expected, rel=2e-5, abs=1e-9 * abs(float(found.detach())) / start)


def test_an_ideal_lens_gives_the_derivatives_of_its_closed_form():
    """An ideal lens of focal length f images s at f·s/(s − f): the spot in the plane z has the radius a·|1 − z/s′|."""
    distance = torch.tensor(120.0, dtype=torch.float64, requires_grad=True)
    aperture = torch.nn.Parameter(torch.tensor(8.0))  # float32, as a parameter of a network is
    lens = surface(phase=IdealLens(40.0), thickness=70.0)
    found = rms_spot(optical_system([lens], aperture, conjugates=Conjugates(distance)), "x", 2)[0]
    by_distance, by_aperture = torch.autograd.grad(found, (distance, aperture))
    # Radius 4·(70/60 − 1): by s, s′ = 60 changes by −f²/(s − f)² = −1/4; by the diameter, half of 1/6.
    assert float(found.detach()) == pytest.approx(4 / 6, rel=1e-9)
    assert float(by_distance) == pytest.approx(4 * 70 / 60**2 / 4, rel=1e-9)
    assert float(by_aperture) == pytest.approx(0.5 / 6, rel=1e-6) and by_aperture.dtype == torch.float32


def test_transforms_of_torch_func_take_conditions():
    def spot(field):
        return rms_spot(triplet(field=field), aim="real").sum()

    field = torch.tensor(10.0, dtype=torch.float64, requires_grad=True)
    (wanted,) = torch.autograd.grad(spot(field), field)
    plain = field.detach()
    assert torch.func.grad(spot)(plain).item() == pytest.approx(wanted.item(), rel=1e-9)
    assert torch.func.jvp(spot, (plain,), (torch.ones_like(plain),))[1].item() == pytest.approx(wanted.item(), rel=1e-9)


def test_pairs_and_tensors_of_fields_keep_their_gradients():
    fields = torch.tensor([[0.0, 5.0], [3.0, 10.0]], dtype=torch.float64, requires_grad=True)
    lens = optical_system(list(triplet().surfaces), 8.0, fields=fields)
    rms_spot(lens).sum().backward()
    assert fields.grad is not None and fields.grad.shape == (2, 2) and bool((fields.grad[1] != 0).all())


@pytest.mark.filterwarnings("error")
def test_files_copies_and_figures_have_plain_numbers(tmp_path):
    """What is written, copied and drawn is a number, without a warning; an aperture in a graph can be copied too."""
    parts = [torch.tensor(v, dtype=torch.float64, requires_grad=True) * 1.0 for v in (8.0, 20.0, 300.0)]
    lens = triplet(parts[0], "EPD", parts[1], parts[2], 50.0)
    numbers = (8.0, ((0.0, 0.0), (0.0, 20.0)), 300.0)
    write_zmx(lens, tmp_path / "lens.zmx")
    written, _ = read_zmx(tmp_path / "lens.zmx")
    for other in (system_from_dict(system_to_dict(lens)), scaled_system(lens, 1.0), written):
        assert (other.aperture, other.fields, other.object_distance) == numbers
        assert copy.deepcopy(other).aperture == 8.0
    plt.close(field_figure(lens))
    assert iso_10110_tolerances(lens) and "aperture=8 (EPD)" in repr(lens)
