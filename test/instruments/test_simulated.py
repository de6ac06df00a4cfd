"""Faults of simulated tables against independent computations."""

import dataclasses

import numpy as np
import pytest

from odak import instruments

IDEAL = {
    "misalignment": False,
    "aberration": 0.0,
    "nonlinearity": False,
    "distance_error": 0.0,
    "reflection": 0.0,
    "shape": (32, 32),
    "distance": 3e-3,
    "camera_shape": (48, 48),
}


def table_of(**faults):
    return instruments.SimulatedTable(5, **{**IDEAL, **faults})


def random_levels(shape=(32, 32)):
    return np.random.default_rng(2).integers(256, size=shape)


def with_truth(table, **changes):
    table.truth = dataclasses.replace(table.truth, **changes)
    return table


def deflected(size, along):
    """Return levels of a ramp of 0.375 cycles per pixel along an axis."""
    return np.moveaxis(np.broadcast_to(96 * np.arange(size) % 256, (size, size)), -1, along)


def shares(image, pitch, distance, along):
    """Return the light about 0.375 and 0 cycles per pixel along an axis."""
    middle = [(np.arange(n) - n // 2) * pitch * 8e-6 / (532e-9 * distance) for n in image.shape]
    line = np.moveaxis(image, along, 0).sum(1)
    return [line[abs(middle[along] - at) < 0.18].sum() for at in (0.375, 0.0)]


@pytest.mark.parametrize("along", [0, 1])
@pytest.mark.parametrize("fill", [1.0, 0.9])
def test_deflected_light_has_the_envelope_of_a_square_pixel(fill, along):
    """Goodman, section 4.4: fill·sinc(√fill·f) of the amplitude, 0.615 of the power at 0.375 cycles per pixel."""
    table = table_of(shape=(64, 64), distance=20e-3, camera_shape=(180, 180), camera_pitch=8e-6, fill_factor=fill)
    y, x = (np.arange(64) - 32.0 for _ in range(2))
    table = with_truth(table, amplitude=np.exp(-(x**2 + y[:, None] ** 2) / 200))
    found = []
    for levels in (np.zeros((64, 64), int), deflected(64, along)):
        table.modulator.show(levels)
        found.append(shares(*table.intensity(), 20e-3, along))
    wanted = fill**2 * np.sinc(np.sqrt(fill) * 0.375) ** 2
    assert found[1][0] / found[0][1] == pytest.approx(wanted, abs=1e-3)
    # Gaps reflect the rest straight on.
    assert found[1][1] / found[0][1] == pytest.approx((1 - fill) ** 2, abs=1e-3)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_light_of_gaps_and_orders_is_that_of_a_sum_over_rays(samples):
    """Rayleigh-Sommerfeld's sum over the samples of the panel gives the intensity on the axis of the camera."""
    # So far away that only one order of the samples reaches the axis.
    faults = {"samples_per_pixel": samples, "fill_factor": 0.8, "fringing": 0.4 if samples > 1 else 0}
    table = table_of(**faults, camera_pitch=1e-9, distance=8e-3)
    levels = (random_levels() // 4) + 20
    table.modulator.show(levels)
    light, pitch = table.intensity()
    truth, s = table.truth, samples
    from scipy.ndimage import gaussian_filter

    phase = np.kron(truth.phases[levels], np.ones((s, s)))
    if truth.fringing:
        phase = gaussian_filter(phase, truth.fringing * s, mode="nearest")
    field = np.exp(1j * phase)
    # Share of each sample that lies in the square that modulates, by counting points.
    fine = (np.arange(200 * s) + 0.5) / 200 - s / 2
    line = (np.abs(fine) < 0.5 * s * np.sqrt(0.8)).reshape(s, 200).mean(1)
    active = np.tile(np.outer(line, line), (32, 32))
    field = np.kron(truth.amplitude, np.ones((s, s))) * (active * field + 1 - active)
    at = ((np.arange(32 * s) + 0.5) / s - 0.5 - 16) * 8e-6
    x, y = np.meshgrid(at, at)
    k = 2 * np.pi / 532e-9
    points = light.shape[0] // 2 + np.arange(-6, 7, 3)
    for row in points[::2]:
        for column in points:
            u, v = ((i - light.shape[a] // 2) * pitch for a, i in ((1, column), (0, row)))
            r = np.sqrt((x - u) ** 2 + (y - v) ** 2 + truth.distance**2)
            wave = truth.distance / r * (1 / (2 * np.pi * r) - 1j / 532e-9) * np.exp(1j * k * r) / r
            found = np.abs((field * wave).sum() * (8e-6 / s) ** 2) ** 2
            assert light[row, column] == pytest.approx(found, rel=0.03, abs=0.01 * float(light.max()))


def test_fill_factor_of_one_sample_is_a_mixture():
    full, part = (table_of(camera_pitch=1e-9, fill_factor=fill, samples_per_pixel=1) for fill in (1.0, 0.5))
    for table in (full, part):
        table.modulator.show(np.full((32, 32), 128))
    # Half of the light with phase pi, half with 0: nothing is left.
    assert part.intensity()[0].max() < 1e-3 * full.intensity()[0].max()


def test_an_iris_stops_orders_and_keeps_power():
    faults = {"samples_per_pixel": 2, "camera_pitch": 1e-9, "distance": 5e-4}
    open_table, stopped, wide = (table_of(**faults, iris=iris) for iris in (None, 1.0, 3.0))
    powers = []
    for table in (open_table, stopped, wide):
        table.modulator.show(random_levels())
        light, pitch = table.intensity()
        powers.append(light.sum() * pitch**2)
    assert powers[2] == pytest.approx(powers[0], rel=1e-5)
    # The power spectrum of random pixels of two samples is that of one pixel, cos²(pi f p / 2) along each axis.
    f = (np.arange(400) + 0.5) / 400 - 0.5
    line = np.cos(np.pi * f / 2) ** 2
    inside = np.outer(line, line)[np.hypot(*np.meshgrid(f, f)) < 0.5].sum() / 400**2
    assert powers[1] / powers[0] == pytest.approx(inside, rel=0.1)


def test_flicker_is_averaged_over_long_exposures():
    table = table_of(flicker=0.05)
    table.modulator.show(random_levels())
    exposures, spreads, means = [0.1 / instruments.simulated.FLICKER_RATE, 1.0], [], []
    instants = 0.05 * np.sin(2 * np.pi * (np.arange(24) + 0.5) / 24)
    expected = np.mean([table.intensity(part)[0] for part in instants], axis=0)
    table._unit = 1e9
    for exposure in exposures:
        table.camera.exposure, table._unit = exposure, 3e3 / exposure * 1e-3 / expected.max()
        frames = table.camera.capture(60).astype(float)
        spreads.append(frames.std(0)[frames.mean(0) > 200].mean())
        means.append(frames.mean(0))
    assert spreads[0] > 1.5 * spreads[1]
    assert np.abs(means[0] - means[1]).mean() < 0.1 * means[1].mean()


def test_a_pattern_settles_exponentially():
    table = table_of(time_constant=5e-3)
    assert table.modulator.settling_time == 0.05
    table.modulator.show(np.full((32, 32), 0))
    table.modulator.settling_time = 3e-3
    table.modulator.show(np.full((32, 32), 100))
    wanted = table.truth.phases[100] * (1 - np.exp(-3e-3 / table.truth.time_constant))
    assert np.allclose(table.phase(), wanted) and 3.5e-3 <= table.truth.time_constant <= 6.5e-3
    table.camera.exposure = 4e-3
    table.camera.capture(2)
    wanted = table.truth.phases[100] * (1 - np.exp(-11e-3 / table.truth.time_constant))
    assert np.allclose(table.phase(), wanted)


def test_regions_respond_differently_and_dust_absorbs():
    table, clean = table_of(regional=0.05, dust=4), table_of()
    assert table.truth.response.mean() == pytest.approx(1) and table.truth.response.std() == pytest.approx(
        0.05, rel=0.05
    )
    dust = table.truth.amplitude / clean.truth.amplitude
    assert dust.min() < 0.6 and dust.max() == 1 and np.median(dust) == 1
    table.modulator.show(np.full((32, 32), 200))
    assert np.allclose(table.phase(), table.truth.phases[200] * table.truth.response)


def test_polarised_light_is_modulated_along_one_axis():
    table = with_truth(table_of(camera_pitch=1e-9, polarisation=True), polarisation=20.0)
    table.modulator.show(random_levels())
    found = []
    for angle in (20.0, 110.0, 65.0):
        table.polariser.turn(angle)
        found.append(table.intensity()[0])
    table.modulator.show(np.zeros((32, 32), int))
    assert np.allclose(found[1], table.intensity()[0], atol=1e-6)
    assert np.allclose(found[2], (found[0] + found[1]) / 2, atol=1e-6)
    assert isinstance(table.polariser, instruments.Rotator)


def test_colours_scale_phases_with_the_inverse_of_the_wavelength():
    table = table_of(camera_pitch=1e-9)
    other = instruments.SimulatedTable(5, **{**IDEAL, "camera_pitch": 1e-9, "wavelength": 639e-9})
    table.laser.wavelength = 639e-9
    table.modulator.show(random_levels())
    other.truth = dataclasses.replace(other.truth, phases=other.truth.phases * 532 / 639)
    other.modulator.show(random_levels())
    assert np.allclose(table.intensity()[0], other.intensity()[0], rtol=1e-4, atol=1e-5)


def test_realistic_tables_have_all_faults():
    truth = instruments.SimulatedTable.realistic(1, shape=(16, 16), camera_shape=(16, 16), dust=2).truth
    assert truth.flicker and truth.fringing and truth.fill_factor < 1 and truth.response.std() > 0.04


def through_a_lens(path, **options):
    """Return a table of 64 x 64 pixels behind which a lens is, its intensity and the pitch, of even light."""
    ideal = {"misalignment": False, "aberration": 0.0, "nonlinearity": False, "distance_error": 0.0, "reflection": 0.0}
    table = instruments.SimulatedTable(
        1, shape=(64, 64), distance=path, camera_shape=(600, 600), camera_pitch=4e-5, **(ideal | options)
    )
    table.truth.amplitude[:] = 1.0
    table.truth.phases[128] = np.pi
    table.camera.pitch = 1e-9
    return table


@pytest.mark.parametrize("fill", [1.0, 0.64])
def test_orders_of_a_grating_at_the_focal_plane_of_a_lens(fill):
    """Sines of the directions over λ are the frequencies; the envelope is sinc²; gaps send their light to the axis."""
    focal = 0.2
    table = through_a_lens(instruments.Lens(focal), fill_factor=fill)
    table.modulator.show(np.tile(np.where(np.arange(64) // 2 % 2, 128, 0), (64, 1)))
    light, pitch = table.intensity()
    middle, reach = light.shape[0] // 2, 532e-9 * focal / 8e-6 / pitch
    assert middle > 0.75 * reach
    whole = (64**2 * (8e-6) ** 2 / (532e-9 * focal)) ** 2
    for order in range(-3, 4):
        cell = abs(np.exp(-0.5j * np.pi * order * np.arange(4)) @ [1, 1, -1, -1]) / 4
        expected = (fill * np.sinc(np.sqrt(fill) * order / 4) * cell) ** 2 if order else (1 - fill) ** 2
        assert light[middle, middle + round(order * reach / 4)] / whole == pytest.approx(expected, abs=2e-6)


def test_light_of_a_lens_at_other_distances_is_collins_integral():
    """Against the sum over fine parts of pixels; a block and an iris leave a ring."""
    path = instruments.Lens(0.02, before=0.03, after=0.0206, block=1e-5)
    table = through_a_lens(path, fill_factor=0.81, iris=0.5)
    levels = np.random.default_rng(0).integers(256, size=(64, 64))
    table.modulator.show(levels)
    light, pitch = table.intensity()
    a, b = 1 - 0.0206 / 0.02, 0.03 + 0.0206 - 0.03 * 0.0206 / 0.02
    parts = 20
    at = ((np.arange(64 * parts) + 0.5) / parts - 32.5) * 8e-6
    inside = np.abs(np.mod(at / 8e-6 + 0.5, 1) - 0.5) < 0.45
    inside = np.outer(inside, inside)
    field = np.where(inside, np.kron(np.exp(1j * table.truth.phases[levels]), np.ones((parts, parts))), 1.0)
    for row, column in ((3, 5), (-40, 22), (7, -55), (1, 1), (60, 60)):
        y, x = row * pitch, column * pitch
        down, across = (np.exp(1j * np.pi / (532e-9 * b) * (a * at**2 - 2 * at * place)) for place in (y, x))
        expected = abs(down @ field @ across * (8e-6 / parts) ** 2 / (532e-9 * b)) ** 2
        if not 1e-5 <= np.hypot(y, x) <= 0.5 * 532e-9 * b / 16e-6:
            expected = 0.0
        found = light[light.shape[0] // 2 + row, light.shape[1] // 2 + column]
        assert found == pytest.approx(expected, abs=1e-4 * light.max())


def test_lenses_imaging_the_panel_or_out_of_focus_are_refused():
    with pytest.raises(ValueError, match="before and after must not image the modulator"):
        instruments.Lens(0.1, before=0.2, after=0.2)
    with pytest.raises(ValueError, match="distance must be a lens near whose back focal plane"):
        instruments.SimulatedTable(1, distance=instruments.Lens(2e-3, before=2e-3, after=6e-3))
