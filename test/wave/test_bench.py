"""First-order systems against Gaussian beams and Collins' integral written out; benches and their gradients."""

import warnings

import numpy as np
import pytest
import scipy.special
import torch
from physics import coordinates, relative_error, wrapped_phasor

import odak
from odak.wave import (
    CircularAperture,
    FirstOrderSystem,
    FreeSpace,
    Mask,
    PhaseModulator,
    Polarizer,
    RectangularAperture,
    ThinLens,
    WavePlate,
    optical_bench,
    power_budget,
    propagate_abcd,
    propagate_beam,
)

WAVELENGTH = 532e-9


def space(z):
    return np.array([[1.0, z], [0.0, 1.0]])


def lens(f):
    return np.array([[1.0, 0.0], [-1 / f, 1.0]])


SYSTEMS = {
    "focus": space(0.2) @ lens(0.2),
    "near the lens": space(0.01) @ lens(0.2),
    "backwards": space(-0.3),
    "telescope": space(0.03) @ lens(0.03) @ space(0.33) @ lens(0.3) @ space(0.3),
    "inverted 4f": space(0.1) @ lens(0.1) @ space(0.2) @ lens(0.1) @ space(0.1),
    "behind a 4f": space(0.01) @ space(0.1) @ lens(0.1) @ space(0.2) @ lens(0.1) @ space(0.1),
    "magnified": space(0.6) @ lens(0.2) @ space(0.3),
}


def gaussian(shape, pitch, q):
    y, x = coordinates(shape, 1.0)
    return np.exp(1j * np.pi / WAVELENGTH * ((y * pitch[0]) ** 2 + (x * pitch[1]) ** 2) / q)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("dx", [8e-6, (10e-6, 8e-6)])
def test_gaussian_beams_follow_the_abcd_law(name, dx):
    """q' = (Aq + B)/(Cq + D), amplitude 1/(A + B/q): Siegman, Lasers (1986), section 20.2."""
    (a, b), (c, d) = SYSTEMS[name]
    q = 0.02 - 1j * np.pi * (2e-4) ** 2 / WAVELENGTH
    both = dx if isinstance(dx, tuple) else (dx, dx)
    beam = gaussian((256, 280), both, q)
    length = 0.123
    found, pitch = propagate_abcd(beam, SYSTEMS[name], dx, WAVELENGTH, path_length=length)
    out = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    expected = gaussian((256, 280), out, (a * q + b) / (c * q + d)) / (a + b / q) * wrapped_phasor(length, WAVELENGTH)
    assert relative_error(found, expected) < 1e-8
    finer, same = propagate_abcd(beam, SYSTEMS[name], dx, WAVELENGTH, np.min(out) / 2, (64, 60), length)
    assert same == np.min(out) / 2
    expected = gaussian((64, 60), (same, same), (a * q + b) / (c * q + d)) / (a + b / q)
    assert relative_error(finer, expected * wrapped_phasor(length, WAVELENGTH)) < 1e-8


@pytest.mark.parametrize("matrix", [space(0.05) @ lens(0.03), space(-0.02) @ lens(0.2)])
def test_the_integral_written_out(matrix, random):
    (a, b), (_, d) = matrix
    dx, out, n = 8e-6, 5e-6, 9
    field = random.normal(size=(n, n)) + 1j * random.normal(size=(n, n))
    x1, x2 = (np.arange(n) - n // 2) * dx, (np.arange(7) - 3) * out
    kernel = np.exp(1j * np.pi / (WAVELENGTH * b) * (a * x1**2 - 2 * x1 * x2[:, None] + d * x2[:, None] ** 2)) * dx
    expected = kernel @ field @ kernel.T / (1j * WAVELENGTH * b)
    found, pitch = propagate_abcd(field, matrix, dx, WAVELENGTH, out, (7, 7))
    assert pitch == out
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(
    ("ratio", "magnification", "out", "count"),
    [(1.1, 1.0, None, 16), (1.1, 1.0, 8e-6, 16), (8.0, -0.5, None, 16), (0.2, -0.5, 4e-6, 64), (1.5, 2.0, 16e-6, 40)],
)
def test_light_at_the_edge_of_the_band_has_no_orders(ratio, magnification, out, count, random):
    """Against the Fresnel integral of the band that the pitch holds, a magnification and a lens."""
    n, dx, c = 16, 8e-6, 3.0
    field = np.exp(2j * np.pi * random.random((n, n)))
    a, b = magnification, magnification * ratio * n * dx**2 / WAVELENGTH
    found, pitch = propagate_abcd(field, [[a, b], [c, (1 + b * c) / a]], dx, WAVELENGTH, out, (count, count))
    nodes, weights = np.polynomial.legendre.leggauss(600)
    f, x1, x2 = nodes / (2 * dx), (np.arange(n) - n // 2) * dx, (np.arange(count) - count // 2) * pitch
    waves = weights / 2 * np.exp(2j * np.pi * f * x2[:, None] / a - 1j * np.pi * WAVELENGTH * b / a * f**2)
    lens_factor = np.exp(1j * np.pi * c / a / WAVELENGTH * x2**2)[:, None]
    kernel = lens_factor * (waves @ np.exp(-2j * np.pi * f[:, None] * x1))
    expected = kernel @ field @ kernel.T / a
    # Noise up to the edge of the band has long tails; orders were 80 % and more.
    assert relative_error(found, expected) < 0.2
    assert (abs(found) ** 2).sum() == pytest.approx((abs(expected) ** 2).sum(), rel=0.05)


def test_window_behind_lens_is_dark_beyond_highest_frequency(random):
    field = np.exp(2j * np.pi * random.random((8, 8)))
    matrix = space(0.1) @ lens(0.1)
    focus, pitch = propagate_abcd(field, matrix, 8e-6, WAVELENGTH)
    wide, _ = propagate_abcd(field, matrix, 8e-6, WAVELENGTH, pitch, (32, 32))
    np.testing.assert_allclose(wide[12:20, 12:20], focus, atol=1e-9 * abs(focus).max())
    assert abs(wide[:, :12]).max() == abs(wide[21:]).max() == 0


def test_cylindrical_systems_and_energy():
    beam = gaussian((128, 128), (8e-6, 8e-6), -1j * np.pi * (1e-4) ** 2 / WAVELENGTH)
    rows, columns = space(0.1) @ lens(0.1), space(0.1)
    found, pitch = propagate_abcd(beam, (rows, columns), 8e-6, WAVELENGTH)
    power = (np.abs(found) ** 2).sum() * pitch**2 / ((np.abs(beam) ** 2).sum() * 64e-12)
    assert power == pytest.approx(1, rel=1e-9)
    swapped, _ = propagate_abcd(beam, (columns, rows), 8e-6, WAVELENGTH)
    np.testing.assert_allclose(swapped, found.T, atol=1e-12)


def test_a_relay_with_two_focal_lengths_is_an_inverted_image(random):
    field = random.normal(size=(33, 31)) + 1j * random.normal(size=(33, 31))
    long, short = 0.3, 0.03
    matrix = space(short) @ lens(short) @ space(long + short) @ lens(long) @ space(long)
    image, pitch = propagate_abcd(field, matrix, 40e-6, WAVELENGTH)
    assert pitch == pytest.approx(4e-6)
    np.testing.assert_allclose(image, -10 * field[::-1, ::-1], atol=1e-9)


def focusing(focal, distance, radius, wavelength=WAVELENGTH):
    return optical_bench(
        [CircularAperture(radius), ThinLens(focal), FreeSpace(distance, "Angular Spectrum")], wavelength
    )


def test_a_bench_is_its_elements_one_after_another(random):
    field = random.normal(size=(32, 30)) + 1j * random.normal(size=(32, 30))
    mask = random.random((32, 30))
    bench = optical_bench(
        [
            Mask(mask),
            FreeSpace(0.005, "AS"),
            RectangularAperture(1e-4, 1.2e-4, (1.6e-5, 0.0)),
            ThinLens(0.05, (0.0, 8e-6)),
            FreeSpace(0.01, window_shape=(20, 24), window_dx=4e-6, offset=(0.0, 1e-5)),
            FirstOrderSystem(space(0.1), 0.1, 5e-6),
        ],
        WAVELENGTH,
    )
    planes = bench.planes(field, 8e-6)
    assert [round(float(plane.position), 6) for plane in planes] == [0, 0, 0.005, 0.005, 0.005, 0.015, 0.115]
    assert [plane.pitch for plane in planes] == [8e-6] * 5 + [4e-6, 5e-6]
    np.testing.assert_allclose(planes[1].field, field * mask)
    expected = propagate_beam(field * mask, None, 0.005, 8e-6, WAVELENGTH, "AS", zero_padding=(True, False, True))
    np.testing.assert_allclose(planes[2].field, expected)
    open_samples = (np.abs(planes[3].field) > 1e-6).any(1).sum(), (np.abs(planes[3].field) > 1e-6).any(0).sum()
    assert open_samples == (13, 15)
    found, pitch = bench.propagate(field, 8e-6)
    np.testing.assert_array_equal(found, planes[-1].field)
    assert pitch == 5e-6
    np.testing.assert_allclose(bench.matrix(), space(0.11) @ lens(0.05) @ space(0.005))
    picture = bench.draw(2e-4)
    assert picture.size == (900, 300)
    assert len(np.unique(np.asarray(picture).reshape(-1, 3), axis=0)) > 4


def test_medium_shortens_wavelength_and_reduced_distance(random):
    field = random.normal(size=(16, 16)) + 1j * random.normal(size=(16, 16))
    water = optical_bench([FreeSpace(0.002, "AS", index=1.33)], WAVELENGTH)
    expected = propagate_beam(field, None, 0.002, 8e-6, WAVELENGTH / 1.33, "AS", zero_padding=(True, False, True))
    np.testing.assert_allclose(water.propagate(field, 8e-6)[0], expected)
    assert water.matrix()[0][1] == pytest.approx(0.002 / 1.33)


def test_a_bench_focuses_like_the_integral():
    beam = gaussian((256, 256), (8e-6, 8e-6), -1j * np.pi * (3e-4) ** 2 / WAVELENGTH)
    found, _ = focusing(0.2, 0.15, 1.0).propagate(beam, 8e-6)
    expected, _ = propagate_abcd(beam, space(0.15) @ lens(0.2), 8e-6, WAVELENGTH, 8e-6, path_length=0.15)
    assert relative_error(found, expected) < 1e-4


def test_gradients_and_faces(random):
    field = random.normal(size=(8, 7)) + 1j * random.normal(size=(8, 7))
    values = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.02, 0.003, 2.1e-5, WAVELENGTH)]
    tensor = torch.from_numpy(field)
    expected, _ = focusing(0.02, 0.003, 2.1e-5).propagate(field, 8e-6)
    found, _ = focusing(*values).propagate(tensor, 8e-6)
    np.testing.assert_allclose(found.detach().numpy(), expected, atol=1e-10)

    def scaled(*units):
        parts = [value.detach() * unit for value, unit in zip(values, units, strict=True)]
        return focusing(*parts).propagate(tensor, 8e-6)[0]

    ones = tuple(torch.ones((), dtype=torch.float64, requires_grad=True) for _ in values[:3])
    wave = torch.ones((), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda *units: scaled(*units, wave), ones, fast_mode=True)

    def system(a, z):
        matrix = [[a, z * 0.05], [0.0 * a, 1 / a]]
        return odak.learn.wave.propagate_abcd(tensor, matrix, 8e-6, WAVELENGTH, 9e-6)[0]

    assert torch.autograd.gradcheck(system, ones[:2], fast_mode=True)
    assert torch.autograd.gradcheck(lambda a, z: system(0.01 * z - 2 * a, 1e-4 * z), ones[:2], fast_mode=True)


@pytest.mark.parametrize("shape", [(3, 16, 18), (3, 3, 3), (2, 3, 12, 12)])
def test_a_bench_takes_one_wavelength_for_each_field(shape, random):
    field, colours = random.normal(size=shape) + 0j, np.array([639e-9, 532e-9, 473e-9])
    bench = [
        FreeSpace(1e-3, index=1.5),
        ThinLens(0.05, offset=(0.0, 1e-5)),
        CircularAperture(4e-5),
        FirstOrderSystem([[1, 0.1], [0, 1]], output_dx=5e-6, path_length=0.1),
        FirstOrderSystem([[-0.5, 0.0], [0, -2]]),
    ]
    for count in range(1, len(bench)):
        found, pitch = optical_bench(bench[:count], colours).propagate(field, (8e-6, 6e-6))
        tensors, _ = optical_bench(bench[:count], torch.as_tensor(colours)).propagate(
            torch.as_tensor(field), (8e-6, 6e-6)
        )
        for k, colour in enumerate(colours):
            alone, own = optical_bench(bench[:count], colour).propagate(field[..., k, :, :], (8e-6, 6e-6))
            assert own == pitch and np.allclose(found[..., k, :, :], alone, rtol=1e-9, atol=1e-12)
        assert np.allclose(tensors, found, rtol=1e-9, atol=1e-12)
    with pytest.raises(ValueError, match="output_dx must be given for several wavelengths"):
        propagate_abcd(field, [[1, 0.1], [0, 1]], 8e-6, colours)


def test_the_place_of_a_window_has_a_derivative_on_the_axis():
    field = torch.as_tensor(np.exp(-sum(c**2 for c in np.mgrid[-8:8, -8:8]) / 20.0) + 0j)

    def slope(start):
        place = torch.tensor(start, dtype=torch.float64, requires_grad=True)
        result, _ = FreeSpace(1e-3, offset=(0.0, place)).apply(field, 8e-6, 532e-9)
        return torch.autograd.grad((result.abs() ** 2)[8, 10], place)[0]

    assert slope(0.0) < 0 and torch.allclose(slope(0.0), slope(1e-12), rtol=1e-4)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [([[1, 0.1], [0, 2]], "determinant"), ([1, 2], "matrix must be"), ([[1, 2, 3], [1, 2, 3]], "matrix must be")],
)
def test_bad_matrices_are_refused(matrix, message):
    with pytest.raises(ValueError, match=message):
        propagate_abcd(np.ones((4, 4)), matrix, 8e-6, WAVELENGTH)
    with pytest.raises(TypeError, match="elements must have a method apply"):
        optical_bench([3.0], WAVELENGTH)


def test_abcd_takes_one_pitch_for_all_fields():
    fields = np.ones((3, 16, 16), complex)
    for name, options in (("dx", {"dx": np.full(3, 4e-5)}), ("output_dx", {"dx": 4e-5, "output_dx": np.full(3, 4e-5)})):
        with pytest.raises(ValueError, match=f"^{name} must be one number"):
            propagate_abcd(fields, space(0.1), wavelength=WAVELENGTH, **options)


def test_apertures_of_a_bench_are_those_of_fields():
    field, dx, offset = np.ones((41, 30), complex), (3e-6, 2e-6), (1e-6, -7e-6)
    disc, _ = CircularAperture(1.3e-6, offset).apply(field, dx, WAVELENGTH)
    np.testing.assert_array_equal(disc, odak.wave.circular_aperture(field.shape, dx, 1.3e-6, offset))
    # Narrower than a pixel along one axis.
    slit, _ = RectangularAperture(1.1e-6, 2.1e-5, offset).apply(field, dx, WAVELENGTH)
    np.testing.assert_array_equal(slit, odak.wave.rectangular_aperture(field.shape, dx, (1.1e-6, 2.1e-5), offset))
    assert slit.real.sum() * 6e-12 == pytest.approx(1.1e-6 * 2.1e-5)


def test_a_cylindrical_system_has_a_matrix_for_each_axis():
    rows, columns = space(0.1) @ lens(0.1), space(0.1)
    bench = optical_bench([FreeSpace(0.2), FirstOrderSystem((rows, columns)), ThinLens(0.5)], WAVELENGTH)
    for found, own in zip(bench.matrix(), (rows, columns), strict=True):
        np.testing.assert_allclose(found, lens(0.5) @ own @ space(0.2), atol=1e-15)
    assert bench.draw(1e-3).size == (900, 300)


@pytest.mark.parametrize("name", ["Fraunhofer", "Incoherent Angular Spectrum", "custom"])
def test_spaces_whose_result_has_another_pitch_are_refused(name):
    with pytest.raises(ValueError, match="propagation_type"):
        FreeSpace(5.0, name).apply(np.ones((4, 4), complex), 8e-6, WAVELENGTH)


def test_wavelengths_of_a_list():
    field = np.ones((2, 8, 8), complex)
    waves = [5e-7, 6e-7]
    found, _ = optical_bench([FreeSpace(1e-3), ThinLens(0.1)], waves).propagate(field, 8e-6)
    expected, _ = optical_bench([FreeSpace(1e-3), ThinLens(0.1)], np.array(waves)).propagate(field, 8e-6)
    np.testing.assert_array_equal(found, expected)


def airy(diameter, focal, wavelength, count, pitch):
    """Return the intensity of the Airy pattern in the focal plane of a lens lit by a plane wave of amplitude 1."""
    y, x = coordinates((count, count), pitch)
    v = np.pi * diameter * np.hypot(y, x) / (wavelength * focal)
    v[v == 0] = 1e-9
    return (2 * scipy.special.j1(v) / v * np.pi * diameter**2 / 4 / (wavelength * focal)) ** 2


@pytest.mark.parametrize(("first", "between"), [("aperture", 0.0), ("lens", 0.0), ("lens", 0.75e-3)])
def test_a_steep_lens_gives_the_airy_pattern(first, between):
    """A lens of 1.8 mm, 1.5 mm wide, on 512² samples is 2.9 times beyond Nyquist; so is its light on the way."""
    wavelength, focal, diameter = 855e-9, 1.8e-3, 1.5e-3
    elements = [CircularAperture(diameter / 2), ThinLens(focal)][:: 1 if first == "aperture" else -1]
    steps = [FreeSpace(between)] if between else []
    window = FreeSpace(focal - between, window_shape=(48, 48), window_dx=0.3e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bench = optical_bench([*elements, *steps, window], wavelength)
        focus, pitch = bench.propagate(np.ones((512, 512), complex), diameter / 512)
    expected = airy(diameter, focal, wavelength, 48, pitch)
    assert np.abs(np.abs(focus) ** 2 - expected).max() < 1e-3 * expected.max()


def test_a_steep_lens_off_the_axis_focuses_on_its_own():
    wavelength, focal, diameter, place = 855e-9, 1.8e-3, 1.5e-3, (2e-4, -1e-4)
    lens = [CircularAperture(diameter / 2), ThinLens(focal, place)]
    light = np.ones((512, 512), complex)
    for shift in ((0.0, 0.0), (3e-6, 0.0)):
        at = tuple(p + s for p, s in zip(place, shift, strict=True))
        window = FreeSpace(focal, window_shape=(64, 64), window_dx=0.3e-6, offset=at)
        focus, pitch = optical_bench([*lens, window], wavelength).propagate(light, diameter / 512)
        expected = np.roll(airy(diameter, focal, wavelength, 64, pitch), -round(shift[0] / pitch), axis=0)
        assert np.abs(np.abs(focus) ** 2 - expected)[:44].max() < 1e-3 * expected.max()
    steps = [FreeSpace(5e-4, offset=(5e-5, 0.0)), FreeSpace(1.3e-3, "AS", (64, 64), 0.3e-6, (1.53e-4, -1e-4))]
    again, _ = optical_bench([*lens, *steps], wavelength).propagate(light, diameter / 512)
    assert relative_error(again, focus) < 1e-3


def test_steep_lenses_pass_on_gradients():
    y, x = coordinates((32, 32), 1.0)
    field = torch.as_tensor(np.exp(-(x**2 + y**2) / 100) + 0j)

    def focus(focal, place, distance):
        bench = optical_bench([ThinLens(focal, (place, 0.0)), FreeSpace(distance, window_dx=3e-6)], WAVELENGTH)
        assert len([light for _, light, _ in bench._light(field, 8e-6) if light.lenses]) == 1
        return torch.view_as_real(bench.propagate(field, 8e-6)[0])[16]

    numbers = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (2e-3, 1e-5, 1.9e-3)]
    assert torch.autograd.gradcheck(focus, numbers, eps=1e-10, atol=10, rtol=1e-4)


def test_a_lens_is_sampled_where_the_aperture_is_open():
    """An aperture leaves the part of a lens that the grid can follow, and free space keeps its own method."""
    light, steep = np.ones((64, 64), complex), ThinLens(4e-3)
    found, _ = optical_bench([steep, CircularAperture(1e-4), FreeSpace(1e-3, "AS")], WAVELENGTH).propagate(light, 8e-6)
    masked = CircularAperture(1e-4).apply(steep.times(light, 8e-6, WAVELENGTH), 8e-6, WAVELENGTH)[0]
    expected = propagate_beam(masked, None, 1e-3, 8e-6, WAVELENGTH, "AS", zero_padding=(True, False, True))
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_light_too_steep_to_go_on_is_named():
    light, lens = np.ones((64, 64), complex), ThinLens(2e-3)
    with pytest.warns(odak.SamplingWarning, match="the light behind the lens is .* a window_dx of at most"):
        optical_bench([lens, FreeSpace(2e-3), FreeSpace(1e-3)], WAVELENGTH).propagate(light, 8e-6)
    with pytest.warns(odak.SamplingWarning, match="the field behind the bench is .* beyond Nyquist"):
        optical_bench([lens], WAVELENGTH).propagate(light, 8e-6)


def test_a_budget_states_where_power_is_lost(random):
    """Against the same field on a grid that nothing leaves, and the area of the aperture."""
    n, dx, z = 64, 8e-6, 0.02
    field = np.exp(2j * np.pi * random.random((n, n)))
    opened = RectangularAperture(20 * dx, 32 * dx, (dx / 2, dx / 2)).apply(field, dx, WAVELENGTH)[0]
    wide = propagate_beam(np.pad(opened, n // 2), None, z, dx, WAVELENGTH, "BLAS")
    bench = optical_bench([RectangularAperture(20 * dx, 32 * dx, (dx / 2, dx / 2)), FreeSpace(z, "BLAS")], WAVELENGTH)
    powers = [(np.abs(u) ** 2).sum() for u in (field, opened, wide, wide[n // 2 : -n // 2, n // 2 : -n // 2])]
    lost = -np.diff(powers) / powers[0]
    for light in (field, torch.as_tensor(field)):
        with power_budget() as budget:
            bench.propagate(light, dx)
        assert [budget.aperture, budget.band, budget.window] == pytest.approx(lost, rel=1e-9)
        assert lost.min() > 0.02
        assert budget.kept == pytest.approx(powers[-1] / powers[0], rel=1e-9)
        assert [one.step for one in budget.steps] == ["RectangularAperture", "Bandlimited Angular Spectrum"]
        assert "all" in str(budget).splitlines()[-1]
    bench.propagate(field, dx)
    assert len(budget.steps) == 2


def test_windows_and_systems_state_what_they_hold():
    beam = odak.wave.gaussian_beam((128, 128), 8e-6, WAVELENGTH, 1e-4)
    with power_budget() as budget:
        odak.wave.propagate_to_window(beam, WAVELENGTH, 1e-4, 8e-6, (256, 128), 4e-6, offset=(0.0, 2.58e-4))
    assert budget.kept == pytest.approx(0.5, abs=1e-3)  # the window begins at the axis
    with power_budget() as budget:
        propagate_abcd(beam, space(0.1) @ lens(0.1), 8e-6, WAVELENGTH)
        propagate_abcd(beam, space(0.1) @ lens(0.1), 8e-6, WAVELENGTH, output_shape=(128, 1))
    assert budget.steps[0].window == pytest.approx(0, abs=1e-6)
    # One column, λf/(N·dx) wide, of the waist λf/(πw), by its midpoint.
    strip, waist = WAVELENGTH * 0.1 / (128 * 8e-6), WAVELENGTH * 0.1 / (np.pi * 1e-4)
    assert budget.steps[1].kept == pytest.approx((2 / np.pi) ** 0.5 * strip / waist, rel=1e-6)


@pytest.mark.parametrize(("elements", "kept"), [([FreeSpace(0.02, "auto")] * 2, "0.1"), ([FreeSpace(1e-4)], None)])
def test_spaces_that_lose_light_warn(elements, kept, random):
    field = np.exp(2j * np.pi * random.random((64, 64)))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        optical_bench(elements, WAVELENGTH).propagate(field, 8e-6)
        optical_bench(elements, WAVELENGTH).propagate(torch.as_tensor(field).requires_grad_(), 8e-6)
    texts = [str(one.message) for one in caught if "FreeSpace keeps" in str(one.message)]
    assert len(texts) == (len(elements) if kept else 0)


def test_modulator_polariser_and_wave_plate_in_a_bench(random):
    """A half-wave plate, a modulator along x and a crossed polariser show the phase as sin²(phase / 2)."""
    pattern = random.uniform(-np.pi, np.pi, (8, 6))
    along_x = np.zeros((2, 16, 12), complex)
    along_x[0] = 1
    elements = [WavePlate(180.0, 22.5), PhaseModulator(lambda: pattern, 2, 0.0), Polarizer(-45.0)]
    for field in (along_x, torch.as_tensor(along_x)):
        with power_budget() as budget:
            out, _ = optical_bench(elements, WAVELENGTH).propagate(field, 8e-6)
        expected = np.kron(np.sin(pattern / 2) ** 2, np.ones((2, 2)))
        np.testing.assert_allclose((abs(out) ** 2).sum(0), expected, atol=1e-12)
        assert budget.aperture == pytest.approx(1 - expected.mean())
        scalar, _ = PhaseModulator(pattern, 2).apply(field[0], 8e-6, WAVELENGTH)
        np.testing.assert_allclose(scalar[::2, ::2], np.exp(1j * pattern), atol=1e-12)
    turn = torch.tensor(20.0, dtype=torch.float64, requires_grad=True)
    passed, _ = optical_bench([Polarizer(turn)], WAVELENGTH).propagate(torch.as_tensor(along_x), 8e-6)
    (slope,) = torch.autograd.grad((abs(passed) ** 2).sum(0).mean(), turn)
    assert float(slope) == pytest.approx(-np.sin(np.radians(40)) * np.pi / 180)


def test_a_lens_transforms_a_gaussian_into_its_spectrum():
    # The waist w in the front focal plane becomes the waist λf/(πw) in the back one, real but for the path.
    axis, waist, focal = (np.arange(128) - 64) * 8e-6, 120e-6, 0.2
    beam = np.exp(-(axis[:, None] ** 2 + axis**2) / waist**2).astype(complex)
    found, pitch = odak.wave.lens_fourier_transform(beam, focal, 8e-6, WAVELENGTH)
    assert abs(pitch - WAVELENGTH * focal / (128 * 8e-6)) < 1e-15
    place, there = (np.arange(128) - 64) * pitch, WAVELENGTH * focal / (np.pi * waist)
    expected = waist / there * np.exp(-(place[:, None] ** 2 + place**2) / there**2)
    np.testing.assert_allclose(found * 1j * np.exp(-4j * np.pi * focal / WAVELENGTH), expected, atol=1e-9)
    # At the lens itself the same, times the curvature of a sphere about the lens.
    at_lens, _ = odak.wave.lens_fourier_transform(beam, focal, 8e-6, WAVELENGTH, distance=0.0)
    bent = np.exp(1j * np.pi * (place[:, None] ** 2 + place**2) / (WAVELENGTH * focal))
    expected = expected * bent * np.exp(2j * np.pi * focal / WAVELENGTH) / 1j
    np.testing.assert_allclose(at_lens, expected, atol=1e-9)


def test_fraunhofer_names_lens_where_far_field_is_not_meant():
    with pytest.warns(odak.SamplingWarning, match="lens_fourier_transform is for the focal plane of a lens"):
        odak.wave.propagate_beam(np.ones((64, 64), complex), None, 0.2, 8e-6, WAVELENGTH, "Fraunhofer")


@pytest.mark.parametrize("xp", ["numpy", "torch"])
def test_a_vortex_sends_the_light_of_a_disc_out_of_it(xp):
    # Mawet et al. (2005): behind a charge of 2 the disc of radius a is dark, and around it the amplitude is (a/r)².
    n, radius, wave = 256, 10.2e-3, odak.wave if xp == "numpy" else odak.learn.wave
    disc = odak.wave.circular_aperture((n, n), 1e-4, radius) + 0j
    field = disc if xp == "numpy" else torch.from_numpy(disc)
    module = np if xp == "numpy" else torch

    def vortex(y, x):
        turn = x + 1j * y
        return (turn / module.clip(abs(turn), 1e-30, None)) ** 2

    one, several = (wave.filter_in_focal_plane(field, vortex, 1.0, 1e-4, 1e-6, scales=s) for s in (1, 3))
    r = np.hypot(*np.meshgrid(*[(np.arange(n) - n // 2) * 1e-4] * 2, indexing="ij"))
    leaks = [float((abs(np.asarray(v))[r < 0.9 * radius] ** 2).sum() / (disc.real**2).sum()) for v in (one, several)]
    assert leaks[1] < 2e-8 and leaks[0] > 1e-5
    ring = (r > 1.05 * radius) & (r < 1.2 * radius)
    assert abs(abs(np.asarray(several))[ring] * (r[ring] / radius) ** 2 - 1).mean() < 0.02
    same = np.asarray(wave.filter_in_focal_plane(field, lambda y, x: 1 + 0 * y * x, 1.0, 1e-4, 1e-6))
    turned = np.roll(disc[::-1, ::-1], 1, (0, 1)) * np.exp(2j * np.pi * 4 / 1e-6) * -1
    np.testing.assert_allclose(same, turned, atol=2e-5)


def test_all_scales_of_a_focal_plane_are_taken_and_the_default_serves_high_charges():
    """The finest pitches, of nanometres, are none that a caller means; more scales change nothing that is left."""
    radius, inner = 1.02e-2, 0.9 * 1.02e-2
    disc = odak.wave.circular_aperture((256, 256), 1e-4, radius) + 0j
    inside = odak.wave.circular_aperture((256, 256), 1e-4, inner) > 0
    for charge in (6, 8):

        def vortex(y, x, charge=charge):
            turn = x + 1j * y
            return (turn / np.maximum(abs(turn), 1e-30)) ** charge

        default, most = (
            odak.wave.filter_in_focal_plane(disc, vortex, 1.0, 1e-4, 1e-6, **scales) for scales in ({}, {"scales": 6})
        )
        assert np.abs(default - most).max() < 1e-3
        left = [(abs(found[inside]) ** 2).sum() / (abs(disc) ** 2).sum() for found in (default, most)]
        # A plane that ends sharply where samples repeat the light leaves 5e-6.
        assert left[1] < 1e-7 and abs(left[0] - left[1]) < 1e-8


def test_a_bench_propagates_as_propagate_beam_does(random):
    field = np.exp(2j * np.pi * random.random((48, 40)))
    distance = 3 * 48 * 8e-6**2 / WAVELENGTH
    found, _ = optical_bench([FreeSpace(distance)], WAVELENGTH).propagate(field, 8e-6)
    exact = propagate_beam(field, None, distance, 8e-6, WAVELENGTH, "Linear Angular Spectrum")
    assert np.linalg.norm(found - exact) < 1e-6 * np.linalg.norm(exact)
    assert FreeSpace(distance).propagation_type == "auto"


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: CircularAperture(-1e-4), "radius must be positive and finite, got -0.0001"),
        (lambda: RectangularAperture(1e-4, 0.0), "width must be positive"),
        (lambda: RectangularAperture(np.asarray([1e-4, -1e-4]), 1e-4), "height must be positive"),
        (lambda: ThinLens(torch.tensor([0.1, 0.0])), "focal must be finite and not zero, got 0"),
        (lambda: FreeSpace(1e-3, index=-1.5), "index must be positive"),
    ],
)
def test_elements_that_cannot_be_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
    assert ThinLens(np.inf).matrix() == [[1.0, 0.0], [0.0, 1.0]]
