"""Pictures through lenses: sums, convolutions, distortion, illumination, sensors and gradients."""

import math

import pytest
import torch

from odak import AccuracyWarning
from odak.learn.raytracing.system import (
    Coating,
    demosaic,
    distortion,
    expose_sensor,
    launch,
    load_system,
    optical_system,
    point_spread_function,
    point_spread_map,
    polarized_trace,
    simulate_image,
    surface,
    trace_fields,
)
from odak.learn.raytracing.system.image_simulation import _linear_shares, _splat, ideal_points
from odak.raytracing.interfaces import IdealLens

F64 = torch.float64


def ideal_lens(defocus=0.0, **options):
    return optical_system(
        [surface(phase=IdealLens(20.0), thickness=20.0 + defocus, **options)], 4.0, wavelengths=550e-6
    )


def picture_of(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


def test_an_ideal_lens_leaves_the_picture_but_for_cos4():
    """No blur, no distortion, and the irradiance of an even object falls as cos⁴θ."""
    found = point_spread_map(ideal_lens(), (41, 61), 0.2, grid=(7, 11), kernel=5, count=4)
    radius = found.ideal.square().sum(-1)
    expected = (1 / (1 + radius / 400)) ** 2
    assert torch.allclose(found.illumination[0], expected, rtol=0, atol=1e-10)
    assert torch.allclose(found.kernels.sum((-2, -1))[0], expected, rtol=0, atol=1e-10)
    assert torch.allclose(found.real, found.ideal, rtol=0, atol=1e-9)
    centre = found.kernels[0, ..., 2, 2]
    assert torch.allclose(centre, expected, rtol=0, atol=1e-7)
    picture = picture_of(1, 41, 61)
    image = simulate_image(picture, found)
    y, x = torch.meshgrid((torch.arange(41) - 20) * 0.2, (torch.arange(61) - 30) * 0.2, indexing="ij")
    falls = (1 / (1 + (x * x + y * y) / 400)) ** 2
    # Between the points of the grid the illumination is interpolated.
    assert float((image - picture * falls).abs().max()) < 0.005


def test_an_even_blur_is_a_plain_convolution():
    """All kernels alike and no distortion: what conv2d of the padded picture gives."""
    found = point_spread_map(ideal_lens(0.5), (24, 32), 0.01, grid=(2, 3), kernel=15, count=6)
    same = found._replace(kernels=found.kernels[:, :1, :1].expand_as(found.kernels))
    picture = picture_of(2, 1, 24, 32)
    padded = torch.nn.functional.pad(picture, (7, 7, 7, 7), "replicate")
    kernel = found.kernels[0, 0, 0].flip(0, 1)[None, None]
    expected = torch.nn.functional.conv2d(padded, kernel)
    assert torch.allclose(simulate_image(picture, same), expected, rtol=0, atol=1e-9)
    assert float(found.kernels[0, 0, 0, 7, 7]) < 0.2


def test_distortion_is_that_of_the_analysis():
    """A point of the picture lands where the chief ray does, over the field of the triplet."""
    lens = load_system("cooke_triplet")
    pitch = 0.25
    found = point_spread_map(lens, (81, 121), pitch, grid=(3, 3), kernel=9, count=3)
    fields = torch.tensor([[0.0, 8.0], [6.0, 9.0], [-14.0, 2.0]], dtype=F64)
    chief = trace_fields(lens, torch.zeros(1, 2, dtype=F64), fields=fields, vignetting=False)
    real = torch.stack([chief.x, chief.y], -1)[lens.reference, :, 0]
    ideal = ideal_points(found.undistort, real)
    ratio = real.norm(dim=-1) / ideal.norm(dim=-1) - 1
    assert torch.allclose(ratio, distortion(lens, fields=fields)[lens.reference], rtol=0, atol=2e-5)
    # A spot in the picture moves with it, to a hundredth of a pixel.
    y, x = torch.meshgrid((torch.arange(81) - 40) * pitch, (torch.arange(121) - 60) * pitch, indexing="ij")
    spot = torch.exp(-((x - ideal[2, 0]) ** 2 + (y - ideal[2, 1]) ** 2) / (3 * pitch) ** 2)
    image = simulate_image(spot.expand(3, -1, -1), found)[1]
    place = [(value * image).sum() / image.sum() for value in (x, y)]
    assert math.dist([float(v) for v in place], real[2].tolist()) < 0.1 * pitch


def test_functions_of_waves_are_those_of_diffraction():
    """The second moment and the sum of a diffraction image are kept when it is put on pixels."""
    lens = load_system("cooke_triplet")
    pitch = 0.002
    found = point_spread_map(lens, (9, 9), pitch, grid=(3, 3), kernel=41, kind="waves", count=6)
    direct = point_spread_function(lens, 48, 96, fields=[[0.0, 0.0]])
    assert torch.allclose(found.kernels.sum((-2, -1)), found.illumination, rtol=0.03, atol=0)
    line = (torch.arange(96, dtype=F64) - 48) * direct.pitch[1, 0, 0]
    inside = line.abs() <= 20 * pitch
    weight = direct.intensity[1, 0][inside][:, inside]
    expected = (weight.sum(1) * line[inside].square()).sum() / weight.sum()
    middle = found.kernels[1, 1, 1]
    pixels = (torch.arange(41, dtype=F64) - 20) * pitch
    moment = (middle.sum(1) * pixels.square()).sum() / middle.sum()
    assert 0.95 < float(moment / (expected + pitch**2 / 6)) < 1.05


def test_vignetting_and_losses_dim_the_picture():
    """Half of the rays blocked is half of the light; a coating's transmittance cancels on the axis, not off it."""
    clear = point_spread_map(ideal_lens(), (5, 5), 0.1, grid=(2, 2), kernel=5, count=8)
    lens = optical_system(
        [
            surface(thickness=5.0, stop=True),
            surface(thickness=0.0, semi_diameter=2.0),
            surface(phase=IdealLens(20.0), thickness=20.0),
        ],
        4.0,
        wavelengths=550e-6,
    )
    found = point_spread_map(lens, (161, 161), 0.1, grid=(3, 3), kernel=5, count=24)
    field = math.atan(8 / 20)
    shift = 5 * math.tan(field) / 2
    share = 2 / math.pi * (math.acos(shift / 2) - shift / 2 * math.sqrt(1 - shift**2 / 4))
    assert abs(float(found.illumination[0, 1, 0]) / (share * math.cos(field) ** 4) - 1) < 0.02
    assert float(clear.illumination.min()) > 0.999
    glass = optical_system(
        [surface(30.0, thickness=3.0, material=1.7, coating=Coating((1.3,), [1e-4])), surface(thickness=40.0)],
        2.0,
        fields=[0.0, 12.0],
        wavelengths=550e-6,
    )
    plain, lossy = (
        point_spread_map(glass, (3, 85), 0.2, grid=(2, 2), kernel=5, count=3, losses=losses) for losses in (False, True)
    )
    from odak.learn.raytracing.system.image_simulation import _fields_of

    fields = _fields_of(glass, torch.tensor([[0.0, 0.0], *plain.ideal[0, :1].tolist()], dtype=F64), None)
    power = polarized_trace(glass, launch(glass, torch.zeros(1, 2, dtype=F64), fields=fields)).transmittance[0, :, 0]
    ratio = float(lossy.illumination[0, 0, 0] / plain.illumination[0, 0, 0])
    assert abs(ratio - float(power[1] / power[0])) < 3e-4


@pytest.mark.parametrize("kind", ["rays", "waves"])
def test_kernels_that_lose_light_are_told(kind):
    """Half a millimetre out of focus at f/5, a point is a disc of 0.1 mm: 20 pixels wide."""
    options = {"grid": (2, 2), "kind": kind, "count": 6}
    with pytest.warns(AccuracyWarning, match="larger kernel"):
        small = point_spread_map(ideal_lens(0.5), (5, 5), 0.005, kernel=5, **options)
    large = point_spread_map(ideal_lens(0.5), (5, 5), 0.005, kernel=41, **options)
    assert float(small.kernels.sum((-2, -1)).max()) < 0.3
    assert float((large.kernels.sum((-2, -1)) / large.illumination).min()) > 0.95


def test_gradients_reach_the_lens_and_the_picture():
    """A loss of the simulated image against finite differences in a curvature and in a pixel."""
    lens = load_system("singlet")
    parameter = lens.surfaces[0].vary("curvature")
    picture = picture_of(3, 9, 11).requires_grad_()
    target = picture_of(3, 9, 11, seed=1)

    def loss():
        found = point_spread_map(lens, (9, 11), 0.05, grid=(2, 2), kernel=9, count=3)
        return (simulate_image(picture, found) - target).square().sum()

    loss().backward()
    for value, place, step in ((parameter, (), 1e-7), (picture, (1, 4, 6), 1e-5)):
        slope = float(value.grad[place])
        ends = []
        for side in (1, -1):
            with torch.no_grad():
                value[place] += side * step
                ends.append(float(loss()))
                value[place] -= side * step
        assert abs((ends[0] - ends[1]) / (2 * step) / slope - 1) < 1e-3, value.shape


def test_noise_has_the_variance_of_photons_and_of_reading():
    grey = torch.full((1, 300, 400), 0.3, dtype=F64)
    read = expose_sensor(grey, full_well=5000.0, read_noise=20.0, bits=None)
    assert abs(float(read.mean()) - 0.3) < 2e-4
    assert abs(float(read.var()) * 5000**2 / (1500 + 400) - 1) < 0.02
    assert torch.equal(read, expose_sensor(grey, full_well=5000.0, read_noise=20.0, bits=None))
    ramp = torch.linspace(-0.2, 1.4, 64, dtype=F64).reshape(1, 8, 8).requires_grad_()
    found = expose_sensor(ramp, bits=3, seed=None)
    assert set((found.detach() * 7).round(decimals=9).unique().tolist()) == set(range(8))
    (slope,) = torch.autograd.grad(found.sum(), ramp)
    assert torch.equal(slope, ((ramp > 0) & (ramp < 1)).to(F64))


@pytest.mark.parametrize("pattern", ["RGGB", "GBRG"])
def test_mosaics_keep_planes_of_colour(pattern):
    """A linear ramp of each channel comes back exactly away from the rim; each pixel reads the channel it names."""
    y, x = torch.meshgrid(torch.arange(8.0, dtype=F64), torch.arange(10.0, dtype=F64), indexing="ij")
    picture = torch.stack([0.1 + 0.01 * x, 0.3 + 0.02 * y, 0.6 - 0.01 * x - 0.02 * y])
    raw = expose_sensor(picture, bits=None, seed=None, pattern=pattern)
    for i, letter in enumerate(pattern):
        place = (slice(i // 2, None, 2), slice(i % 2, None, 2))
        assert torch.allclose(raw[0][place], picture["RGB".index(letter)][place], rtol=0, atol=1e-15)
    assert torch.allclose(demosaic(raw, pattern)[:, 1:-1, 1:-1], picture[:, 1:-1, 1:-1], rtol=0, atol=1e-12)


def test_what_is_refused():
    lens = load_system("cooke_triplet")
    with pytest.raises(ValueError, match="kernel must be odd"):
        point_spread_map(lens, (9, 9), 0.1, kernel=4)
    with pytest.raises(ValueError, match="response must be weights"):
        point_spread_map(lens, (9, 9), 0.1, response=[[1.0, 2.0]])
    found = point_spread_map(ideal_lens(), (5, 5), 0.1, grid=(2, 2), kernel=3, count=2)
    with pytest.raises(ValueError, match="picture must be"):
        simulate_image(torch.zeros(1, 5, 6), found)
    with pytest.raises(ValueError, match="irradiance must be"):
        expose_sensor(torch.zeros(2, 4, 4), pattern="RGGB")


def test_lattices_of_samples_are_shared_among_pixels_like_single_samples():
    """Samples on a lattice, some of them outside of the image and one in the middle of a pixel."""
    generator = torch.Generator().manual_seed(1)
    shares = torch.rand(2, 3, 30, 40, dtype=F64, generator=generator)
    y, x = (
        torch.arange(n, dtype=F64) * 0.31 - 3.0 + torch.rand(2, 3, 1, dtype=F64, generator=generator) for n in (30, 40)
    )
    y[0, 0, 10] = 4.0
    offsets = torch.stack(torch.broadcast_tensors(x[..., None, :], y[..., :, None]), -1).flatten(2, 3)
    expected = _splat(offsets - 7 // 2, shares.flatten(2), 7)
    found = _linear_shares(y, 7).mT @ shares @ _linear_shares(x, 7)
    torch.testing.assert_close(found, expected, rtol=0.0, atol=1e-12)
