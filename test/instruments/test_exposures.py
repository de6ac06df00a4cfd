"""Exposure, dynamic range, settling and polarisation of simulated tables, through the protocols alone."""

import dataclasses
import warnings

import numpy as np
import pytest
from laboratory import Altered, Laboratory, random_table
from tables import Counting

from odak import AccuracyWarning, instruments
from odak.instruments import exposures, phase_response, protocols, spots

SMALL = {"shape": (32, 32), "distance": 4e-3, "camera_shape": (48, 48)}


def fresh_seed(number):
    return int(np.random.default_rng(number).integers(10_000))


def test_exposure_reaches_a_share_of_the_range():
    table = instruments.SimulatedTable(fresh_seed(1), **SMALL)
    lens = spots.lens_phase(table.modulator, 532e-9, 4e-3)
    for start in (1e-6, 1.0):
        table.camera.exposure = start
        show = lambda: table.modulator.show(phase_response.nearest_levels(lens, table.truth.phases))  # noqa: E731
        instruments.set_exposure(table.camera, show, level=0.5)
        assert 0.35 < table.camera.capture().max() / 4095 < 0.6
    with pytest.raises(ValueError, match="level must be below"):
        instruments.set_exposure(table.camera, level=1.0)


def test_a_wide_range_of_brightness_is_captured():
    table = instruments.SimulatedTable(fresh_seed(2), **SMALL)
    # A spot, a thousand times as bright as what surrounds it.
    lens = spots.lens_phase(table.modulator, 532e-9, 4e-3)
    instruments.set_exposure(
        table.camera, lambda: table.modulator.show(phase_response.nearest_levels(lens, table.truth.phases))
    )
    single = table.camera.exposure
    dark = instruments.measure_dark(table.camera, table.laser)
    assert table.laser.power == 1.0 and dark.mean() == pytest.approx(20 * 4095 / 20000, abs=0.2)
    rate = instruments.capture_hdr(table.camera, single * 6.0 ** np.arange(4), dark=dark, captures=2)
    light, pitch = table.intensity()
    v, u = np.indices(table.camera.shape).astype(float)
    points = table.truth.plane_points(np.stack([u, v], axis=-1), table.camera.shape)
    truth = table.camera._sampled(points, light, pitch) * table._unit / 1e-3 * 4095 / 20000
    assert truth.max() > 1000 * np.quantile(truth, 0.2)
    dim = truth < np.quantile(truth, 0.5)
    error = (rate / truth - 1)[dim & (truth > 1e-3 * truth.max() / 50)]
    one = ((table.camera.capture(8).mean(0) - dark) / single / truth - 1)[dim & (truth > 1e-3 * truth.max() / 50)]
    assert np.abs(rate / truth - 1)[truth > 0.01 * truth.max()].mean() < 0.02
    assert error.std() < 0.1 * one.std()
    assert table.camera.exposure == single


def test_pixels_that_are_always_saturated_are_reported():
    table = instruments.SimulatedTable(fresh_seed(3), **SMALL)
    with pytest.warns(AccuracyWarning, match="pixels are saturated at all exposures"):
        rate = instruments.capture_hdr(table.camera, [1e3, 1e4])
    assert np.isinf(rate).any()
    with pytest.raises(ValueError, match="at least two"):
        instruments.capture_hdr(table.camera, [1.0])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_the_time_constant_is_found(seed):
    table = instruments.SimulatedTable(fresh_seed(seed), **SMALL, time_constant=8e-3)
    table.camera.exposure = 0.5
    table._unit *= 40
    found = instruments.measure_settling(table.modulator, table.camera, table.truth.phases, samples=10)
    assert found.time_constant == pytest.approx(table.truth.time_constant, rel=0.03)
    assert abs(found.time_constant - table.truth.time_constant) < 5 * found.uncertainty
    # After that time the phase is within 0.02 rad, with a tenth for the error of the measurement.
    assert 2.9 * np.exp(-found.settling_time / table.truth.time_constant) < 0.025
    assert table.modulator.settling_time == 0.08 and table.camera.exposure == 0.5
    with pytest.warns(AccuracyWarning, match="settling time is uncertain"):
        instruments.measure_settling(table.modulator, table.camera, table.truth.phases, samples=6, longest=4e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [4, 5])
def test_the_time_constant_of_a_table_with_all_faults_is_found(seed):
    """Little light, fringing fields, gaps, flicker and a response that varies over the modulator."""
    faults = {**instruments.simulated.REALISTIC, "dust": 1}
    table = instruments.SimulatedTable(fresh_seed(seed), **SMALL, **faults, time_constant=8e-3)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Angular Spectrum is outside its range")
        found = instruments.measure_settling(table.modulator, table.camera, table.truth.phases, samples=8)
    assert found.time_constant == pytest.approx(table.truth.time_constant, rel=0.06)
    assert abs(found.time_constant - table.truth.time_constant) < 4 * found.uncertainty
    assert found.phase.shape == (8,) and abs(found.phase[-1] - 0.9 * np.pi) < 0.1


@pytest.mark.parametrize("seed", [6, pytest.param(7, marks=pytest.mark.slow)])
def test_the_axis_of_the_modulator_is_found(seed):
    table = instruments.SimulatedTable(fresh_seed(seed), **SMALL, polarisation=True, aberration=0.05)
    phase = spots.lens_phase(table.modulator, 532e-9, 4e-3)
    levels = phase_response.nearest_levels(phase, table.truth.phases)
    found = instruments.measure_polarisation(table.modulator, table.camera, table.polariser, levels, dark=4.1)
    assert abs(found.angle - table.truth.polarisation) < 0.5 and found.uncertainty < 0.5
    assert table.polariser.angle == found.angle and found.contrast > 20


def regional(seed, regions, samples, **options):
    table = instruments.SimulatedTable(seed, **{"regional": 0.05, **options})
    truth, camera = table.truth, table.camera
    known = instruments.Registration(truth.homography, truth.distortion, camera.shape)
    there = (table.modulator, camera, 532e-9, truth.distance, known)
    found = instruments.measure_regional_response(*there, regions=regions, samples=samples)
    rows, columns = table.modulator.shape
    # The pixels in front of the middle of a region are evaluated.
    middles = [
        [n * (2 * i + 1) // (2 * parts) for i in range(parts)]
        for n, parts in zip((rows, columns), regions, strict=True)
    ]
    reach = [n // (4 * parts) for n, parts in zip((rows, columns), regions, strict=True)]
    parts = [[np.s_[i - reach[0] : i + reach[0], j - reach[1] : j + reach[1]] for j in middles[1]] for i in middles[0]]
    gains = np.array([[truth.response[part].mean() for part in line] for line in parts])
    return found, gains[..., None] * truth.phases


def test_the_response_of_regions_is_found():
    found, truth = regional(
        fresh_seed(8), (2, 2), 9, shape=(64, 64), distance=8e-3, camera_shape=(140, 140), aberration=0.1
    )
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.02 and np.ptp(truth[..., -1]) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("faults", [{}, {"fringing": 0.2, "fill_factor": 0.92, "samples_per_pixel": 2}])
def test_the_response_of_nine_regions_is_found_to_two_hundredths(faults):
    found, truth = regional(fresh_seed(9), (3, 3), 15, **faults)
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.02 and np.ptp(truth[..., -1]) > 0.2


def test_regions_of_one_column_are_those_of_one_row_turned():
    options = {
        "shape": (48, 40),
        "distance": 5e-3,
        "camera_shape": (120, 120),
        "aberration": 0.1,
        "misalignment": False,
        "regional": 0.02,
    }
    found, truth = regional(fresh_seed(10), (2, 1), 9, **options)
    assert found.shape == (2, 1, 256) and np.sqrt(np.mean((found - truth) ** 2)) < 0.03
    with pytest.raises(ValueError, match="regions must be two or more"):
        regional(3, (1, 1), 9, **options)


def test_a_response_that_is_a_parabola_is_exact_up_to_the_edges():
    """The tables of 3 x 3 regions hold the values in their middles, those of 5 x 5 a cubic."""
    for parts, order in ((3, 2), (5, 3)):
        table = instruments.SimulatedTable(1, shape=(30, 60), camera_shape=(32, 32))
        nominal = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
        row, column = (np.arange(n) + 0.5 for n in (30, 60))
        gain = 1.3 + 0.2 * (row[:, None] / 30 - 0.4) ** order + 0.1 * (column / 60 - 0.7) ** order
        middles = (np.arange(parts) + 0.5) / parts
        known = 1.3 + 0.2 * (middles[:, None] - 0.4) ** order + 0.1 * (middles - 0.7) ** order
        found = dataclasses.replace(nominal, regional_phases=known[..., None] * nominal.phases)
        phase = np.random.default_rng(0).uniform(-9, 9, (30, 60))
        apart = np.abs(np.angle(np.exp(1j * (gain * nominal.phases[found.levels(phase)] - phase))))
        assert (apart <= gain * np.pi / 256 + 1e-9).all()


def test_levels_of_regions_are_nearest_everywhere(tmp_path):
    table = instruments.SimulatedTable(1, shape=(30, 40), camera_shape=(32, 32))
    nominal = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    tables = nominal.phases * np.array([[1.2, 1.3], [1.4, 1.5]])[..., None]
    found = dataclasses.replace(nominal, regional_phases=tables)
    phase = np.random.default_rng(0).uniform(-9, 9, (30, 40))
    row, column = (np.arange(30) + 0.5) / 15 - 0.5, (np.arange(40) + 0.5) / 20 - 0.5
    gain = 1.2 + 0.1 * column + 0.2 * row[:, None]
    shown = gain * nominal.phases[found.levels(phase)]
    apart = np.abs(np.angle(np.exp(1j * (shown - phase))))
    assert apart.max() <= 1.65 * np.pi / 256 + 1e-9
    for name in ("a.npz", "a.h5"):
        if name.endswith("h5"):
            pytest.importorskip("h5py", reason="h5py is not installed")
        instruments.save_calibration(tmp_path / name, found)
        again = instruments.load_calibration(tmp_path / name)
        assert np.array_equal(again.regional_phases, tables) and again.registration.shape == (32, 32)
        assert np.array_equal(again.wavefront, found.wavefront) and again.distance == found.distance


def laboratory(**options):
    return Laboratory((96, 128), distance=0.01, camera_shape=(200, 240), **options)


def response(table, change, **members):
    camera = Altered(table.camera, change, **members)
    return instruments.measure_phase_response(table.modulator, camera, 532e-9, 0.01, samples=9, captures=1)


FORMS = {
    "colours": lambda frames, _: np.stack([frames // 9, frames, frames // 7], axis=-1),
    "transparency": lambda frames, _: np.stack([frames, 0 * frames, 0 * frames, 0 * frames + 4095], axis=-1),
    "one frame": lambda frames, _: frames[0],
    "one frame of colours": lambda frames, _: np.stack([frames[0], frames[0] // 3, 0 * frames[0]], axis=-1),
    "an axis of channels": lambda frames, _: frames[:, None],
    "floats": lambda frames, _: frames.astype(float),
    "shares of the range": lambda frames, _: (frames / 4095).astype(np.float32),
}


@pytest.mark.parametrize(
    "form",
    [
        form if form in ("colours", "shares of the range") else pytest.param(form, marks=pytest.mark.slow)
        for form in FORMS
    ],
)
def test_captures_in_other_forms_are_taken(form):
    table = laboratory()
    assert np.abs(response(table, FORMS[form]) - table.phases).max() < 0.01


def test_a_camera_that_ignores_its_region_is_read_whole():
    table = laboratory()
    table.camera.region = (20, 30, 40, 50)
    there = protocols.checked_camera(Altered(table.camera, lambda *_: np.arange(48_000).reshape(1, 200, 240) % 4001))
    assert np.array_equal(there.capture()[0], (np.arange(48_000).reshape(200, 240) % 4001)[20:60, 30:80])


FAULTS = {
    "gamma": (lambda frames, _: np.rint(4095 * (frames / 4095) ** (1 / 2.2)).astype(int), r"the power 0\.4\d .* gamma"),
    "shifted": (lambda frames, _: frames << 4, "multiples of 16, .* shifts its data left by 4 bits"),
    "deeper": (lambda frames, _: 37 * frames + 1, "counts from 0 to 4095, camera.bits = 12"),
    "signed": (lambda frames, _: (37 * frames).astype(np.int16) - 100, "16 bits were read as signed integers"),
    "other shares": (lambda frames, _: frames / 4096, r"no multiples of 1/4095: return the counts of the camera"),
    "fewer bits": (lambda frames, _: (frames >> 4).astype(np.uint8), r"of 8 bits \(uint8\) .*: set camera.bits to 8"),
    "no number": (lambda frames, _: frames * np.nan, "got nan to nan"),
    "too many": (lambda frames, _: np.repeat(frames, 2, axis=0), r"must return \[1, .*, got \[2, "),
    "automatic": (lambda frames, _: np.rint(2400 * (frames / frames.max())).astype(int), "automatic"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_cameras_are_named(fault):
    change, message = FAULTS[fault]
    table = laboratory()
    table.camera.exposure = 3.0
    with pytest.raises((RuntimeError, ValueError), match=message):
        response(table, change)


def test_transposed_captures_are_named():
    table = laboratory()
    camera = Altered(table.camera, lambda frames, _: frames.swapaxes(1, 2))
    with pytest.raises(ValueError, match=r"got \[1, 240, 200\]; these are columns and rows: transpose the frames"):
        instruments.set_exposure(camera)


@pytest.mark.parametrize("late", ["exposure", "pattern"])
def test_frames_older_than_the_pattern_or_the_exposure_are_named(late):
    table, kept = laboratory(), []

    def older(frames, camera):
        kept.append((frames, table.modulator.shown))
        # Of the exposure before, or only of the pattern before.
        same = [f for f, shown in kept[:-1] if f.shape == frames.shape and (late == "exposure" or shown < kept[-1][1])]
        fresh = late == "pattern" and kept[-2:][0][1] == kept[-1][1]
        return frames if fresh or not same else same[-1]

    with pytest.raises(RuntimeError, match=r"1 frames that the camera returned after .* discard as many frames"):
        response(table, older)


@pytest.mark.parametrize(
    ("count", "value"),
    [pytest.param(1, 4095, marks=pytest.mark.slow), pytest.param(6, 4095, marks=pytest.mark.slow), (6, 3000)],
)
def test_stuck_pixels_do_not_set_the_exposure(count, value):
    """A saturated one ended in an exposure of 15 ns, six in an error of the phase response."""
    table, places = laboratory(), np.random.default_rng(1).integers(60, 140, (count, 2))

    def hot(frames, camera):
        row, column, *_ = camera.region or (0, 0)
        frames[:, places[:, 0] - row, places[:, 1] - column] = value
        return frames

    with pytest.warns(AccuracyWarning, match=f"^{count} pixels of the camera do not change with its exposure"):
        found = response(table, hot)
    assert np.abs(found - table.phases).max() < 0.01


def test_a_dark_table_and_limits_of_the_exposure_are_named():
    """The exposure was 100 000 s."""
    table = laboratory()
    table.power, table.camera.exposure = 0.0, 1e-3
    with pytest.raises(RuntimeError, match=r"sees no light: .* of 4095 counts .* laser is on"):
        instruments.set_exposure(table.camera)
    assert table.camera.exposure == 1e-3
    table.power = 1.0
    camera = Altered(table.camera, lambda frames, _: frames, exposure_limits=(1e-5, 0.05))
    with pytest.warns(AccuracyWarning, match="0.05 s is at a limit of the camera: .* use more light"):
        assert instruments.set_exposure(camera) == 0.05


@pytest.mark.slow
def test_a_response_that_ends_early_is_named():
    table = laboratory(phases=1.5 * np.pi * np.arange(256) / 255)
    with pytest.warns(AccuracyWarning, match=r"leave out 0\.5π of 2π"):
        found = response(table, lambda frames, _: frames)
    assert np.abs(found - table.phases).max() < 0.01


def test_exposures_of_patterns_are_remembered():
    table = instruments.SimulatedTable(fresh_seed(5), **SMALL)
    table.modulator.show(np.zeros((32, 32), int))
    counting = Counting(table.camera)
    camera = protocols.checked_camera(counting)
    exposures.exposed(camera, "even")
    right = camera.exposure
    # The last one of the pattern fits; half of it is doubled.
    for remembered, captures in ((right, 1), (right / 2, 2)):
        camera.exposure, camera.exposures["even"] = 100 * right, remembered
        before = counting.taken
        frame = exposures.exposed(camera, "even")
        assert counting.taken == before + captures
        assert 0.4 < frame.max() / camera.top < 0.75


def test_dark_counts_of_another_size_are_named():
    table = instruments.SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    exposure, levels = table.camera.exposure, np.zeros((1, 24, 24), int)
    for dark in (np.zeros(32), np.zeros((16, 32)), np.zeros((1, 32, 32))):
        with pytest.raises(ValueError, match=r"^dark must be a number or an image \[32, 32\], .* got the shape"):
            instruments.capture_hdr(table.camera, [exposure / 4, exposure], dark=dark)
        with pytest.raises(ValueError, match=r"^dark must be"):
            instruments.record_captures(table.modulator, table.camera, levels, 532e-9, dark=dark)
    assert instruments.capture_hdr(table.camera, [exposure / 4, exposure], dark=np.zeros((32, 32))).shape == (32, 32)


class Stepped(Altered):
    """A camera whose exposure has steps."""

    step = 1e-3

    def __init__(self, camera, step):
        super().__init__(camera, lambda frames, _: frames)
        object.__setattr__(self, "step", step)

    def __setattr__(self, name, value):
        if name == "exposure":
            value = max(round(value / self.step), 1) * self.step
        super().__setattr__(name, value)


def lit(seed=3):
    table = instruments.SimulatedTable(fresh_seed(seed), shape=(32, 32), camera_shape=(40, 48))
    table.modulator.show(np.zeros((32, 32), int))
    return table, instruments.set_exposure(table.camera)


@pytest.mark.parametrize("limit", [(0.5, 0.9), (1.1, 4.0)])
def test_exposures_that_a_camera_limits_give_the_true_counts(limit):
    """The exposures asked for were taken for those that the camera had: results were 10 and 0.28 times the truth."""
    table, exposure = lit()
    wanted = [exposure / 8, exposure / 2, 4 * exposure]
    free = instruments.capture_hdr(table.camera, wanted, dark=20, captures=8)
    camera = Altered(table.camera, lambda frames, _: frames, exposure_limits=tuple(exposure * np.array(limit)))
    limited = instruments.capture_hdr(camera, wanted, dark=20, captures=8)
    bright = free > 0.3 * free.max()
    assert abs((limited / free)[bright & np.isfinite(limited)].mean() - 1) < 0.03


def test_exposures_with_steps_give_the_true_counts():
    table, exposure = lit()
    wanted = [0.45 * exposure, 1.4 * exposure]
    free = instruments.capture_hdr(table.camera, wanted, dark=20, captures=8)
    stepped = instruments.capture_hdr(Stepped(table.camera, 0.3 * exposure), wanted, dark=20, captures=8)
    bright = (free > 0.3 * free.max()) & np.isfinite(stepped) & np.isfinite(free)
    assert abs((stepped / free)[bright].mean() - 1) < 0.03
    with pytest.warns(AccuracyWarning, match="the camera took .* for each"):
        instruments.capture_hdr(Stepped(table.camera, exposure), [0.9 * exposure, 1.1 * exposure], dark=20)


def test_a_linear_camera_with_steps_is_taken_for_linear():
    """Half of an exposure of five steps is two or three: it was refused as a gamma curve."""
    table, exposure = lit()
    for steps in (5.3, 7.7, 11.1):
        instruments.set_exposure(Stepped(table.camera, exposure / steps))
    assert exposures._power(2**0.5, 4.0, 2.0, 1.0) == pytest.approx(0.5, rel=1e-6)
    assert exposures._power((5**0.45 - 3**0.45) / (3**0.45 - 1), 5.0, 3.0, 1.0) == pytest.approx(0.45, rel=1e-6)


def test_two_saturated_columns_are_replaced_and_do_not_set_the_exposure():
    """Four hundred pixels; they once reduced the exposure to 1e-16 s."""
    table, _ = random_table(1)

    def saturated(frames, camera):
        frames = frames.copy()
        frames[..., 100:102] = (1 << camera.bits) - 1
        return frames

    table.modulator.show(np.zeros(table.modulator.shape, int))
    expected = instruments.set_exposure(table.camera)
    inner = table.camera
    broken = Altered(inner, saturated, shape=inner.shape, pitch=inner.pitch, bits=inner.bits)
    inner.exposure = 1e-3
    with pytest.warns(AccuracyWarning, match=r"\d+ pixels of the camera do not change with its exposure.*column 100"):
        assert instruments.set_exposure(broken) == pytest.approx(expected, rel=0.5)


def test_a_camera_that_ignores_its_exposure_in_dim_light_is_not_told_to_see_none():
    table, _ = random_table(1)
    table.modulator.show(np.zeros(table.modulator.shape, int))

    class Deaf:
        shape, pitch, bits, exposure, region = table.camera.shape, table.camera.pitch, table.camera.bits, 1e-3, None

        def capture(self, count=1):
            table.camera.exposure = 3e-2
            return table.camera.capture(count)

    with pytest.raises(RuntimeError, match=r"counts of the camera do not follow its exposure: its brightest pixel has"):
        instruments.set_exposure(Deaf())
