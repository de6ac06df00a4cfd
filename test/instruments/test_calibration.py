"""Calibrations of simulated tables find what was hidden by a seed, through the protocols alone."""

import contextlib
import dataclasses
import json
import warnings
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from laboratory import Laboratory, without_defocus

from odak import AccuracyWarning, instruments
from odak.instruments import calibration, focus, phase_response, protocols, registration, spots


class Blind:
    """Instrument with the members of its protocol only, so that calibrations cannot read the true parameters."""

    def __init__(self, instrument, names):
        object.__setattr__(self, "_parts", (instrument, names))

    def __getattr__(self, name):
        instrument, names = object.__getattribute__(self, "_parts")
        if name not in names:
            raise AttributeError(name)
        return getattr(instrument, name)

    def __setattr__(self, name, value):
        instrument, names = self._parts
        assert name in names
        setattr(instrument, name, value)


def instruments_of(table):
    modulator = Blind(table.modulator, ("shape", "pitch", "bits", "settling_time", "show"))
    camera = Blind(table.camera, ("shape", "pitch", "bits", "exposure", "region", "capture"))
    return modulator, camera


class Counting:
    """Camera that counts its captures."""

    def __init__(self, camera):
        object.__setattr__(self, "camera", camera)
        object.__setattr__(self, "taken", 0)

    def __getattr__(self, name):
        return getattr(self.camera, name)

    def __setattr__(self, name, value):
        setattr(self.camera, name, value)

    def capture(self, count=1):
        object.__setattr__(self, "taken", self.taken + count)
        return self.camera.capture(count)


def fresh_seed(number):
    return int(np.random.default_rng(number).integers(10_000))


def low_modes(modulator):
    return spots.aberration_modes(modulator, 2)[[0, 1, spots.DEFOCUS]]


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def distance_in_pixels(registration, table):
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (200, 2)) * min(table.modulator.shape) * 8e-6
    seen = registration.camera_pixels(points)
    missed = (table.truth.plane_points(seen, table.camera.shape) - points) / table.camera.pitch
    return np.linalg.norm(missed, axis=-1)


SMALLER = {"shape": (108, 108), "camera_shape": (240, 240), "distance": 15e-3}


@pytest.fixture(scope="module")
def calibrated():
    """A table with all faults, and what its calibration found."""
    table = instruments.SimulatedTable(seed=int(np.random.default_rng(5).integers(1000)), **SMALLER)
    found = instruments.calibrate_table(*instruments_of(table), table.laser.wavelength, SMALLER["distance"])
    return table, found


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_phase_response_within_two_hundredths(calibrated):
    table, found = calibrated
    assert np.abs(found.phases - table.truth.phases).max() < 0.02


@pytest.mark.parametrize("span", [0.5, 1.6])
def test_phase_response_of_small_and_large_ranges(span):
    table = instruments.SimulatedTable(4, shape=(64, 64), camera_shape=(100, 100), distance=6e-3)
    table.truth = dataclasses.replace(table.truth, phases=table.truth.phases * span)
    with pytest.warns(AccuracyWarning, match="leave out") if span < 1 else contextlib.nullcontext():
        found = instruments.measure_phase_response(*instruments_of(table), 532e-9, 6e-3, samples=17)
    assert np.abs(found - table.truth.phases).max() < 0.02


@pytest.mark.parametrize(
    ("shape", "offset", "message"),
    [
        (
            (96, 128),
            (2.4e-4, 0.0),
            r"on the side of smaller columns: move the camera by at least 0\.\d+ mm toward smaller",
        ),
        pytest.param(
            (96, 128),
            (0.0, -1.6e-4),
            r"on the side of larger rows: move the camera by at least 0\.\d+ mm toward larger rows",
            marks=pytest.mark.slow,
        ),
        ((150, 128), (0.0, 0.0), r"the light of the modulator is \d+ pixels, .* mm, wider than it along rows"),
    ],
)
def test_a_camera_that_does_not_see_the_panel_is_told_where_to_move(shape, offset, message):
    table = Laboratory(shape, distance=0.01, camera_shape=(200, 260), offset=offset)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "phases_with_uncertainty", lambda *_: (table.phases, 0.0, 0.0))
        with pytest.raises(RuntimeError, match=message):
            instruments.calibrate_table(*instruments_of(table), 532e-9, 0.01)
    assert table.camera.taken < 150


@pytest.mark.slow
def test_the_middle_of_a_panel_that_is_larger_than_the_camera():
    y, x = ((np.arange(n) - n // 2) / 64 for n in (150, 128))
    wavefront = np.pi * (x**2 * y[:, None] + 0.5 * x**3)
    table = Laboratory((150, 128), distance=0.02, camera_shape=(200, 260), wavefront=wavefront)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "phases_with_uncertainty", lambda *_: (table.phases, 0.0, 0.0))
        patch.setattr(calibration, "illumination_with_uncertainty", lambda part, *_, **__: (np.ones(part.shape), 0.0))
        found = instruments.calibrate_table(*instruments_of(table), 532e-9, 0.02, partial=True)
    seen = np.flatnonzero(found.amplitude.any(-1))
    assert found.amplitude.shape == (150, 128) and 90 < len(seen) < 140 and found.amplitude[seen].all()
    assert seen.mean() == pytest.approx(74.5)
    part = np.s_[seen[0] : seen[-1] + 1]
    low = np.stack(np.broadcast_arrays(x, y[part, None], x**2 + y[part, None] ** 2))
    assert rms(spots.without((found.wavefront - wavefront)[part], low)) < 2 * np.pi / 100
    assert found.distance == pytest.approx(0.02, rel=2e-3)


@pytest.mark.parametrize("wrong", [-0.1, 0.1])
def test_a_response_that_falls_with_the_level(wrong):
    table = Laboratory((96, 128), distance=0.01, camera_shape=(200, 240), phases=-2 * np.pi * np.arange(256) / 256)
    there = (*instruments_of(table), 532e-9, 0.01 * (1 + wrong))
    found = instruments.measure_phase_response(*there, samples=9, captures=1)
    assert np.abs(found - table.phases).max() < 0.01


@pytest.mark.parametrize(("fringing", "bound"), [(0.2, 0.03), (0.4, 0.1)])
def test_fringing_fields_do_not_falsify_the_phase_response_in_silence(fringing, bound):
    """The bounds are 0.5 % and 5 % of the largest phase; more than a tenth of a radian comes with a warning."""
    table = instruments.SimulatedTable(
        5, shape=(96, 96), camera_shape=(80, 80), distance=8e-3, fringing=fringing, samples_per_pixel=2
    )
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        found = instruments.measure_phase_response(*instruments_of(table), 532e-9, 8e-3, samples=9, captures=1)
    error = np.abs(found - table.truth.phases).max()
    assert error < bound
    assert error < 0.1 or any(issubclass(w.category, AccuracyWarning) for w in told)


@pytest.mark.parametrize("seed", [17, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (18, 19))])
def test_a_response_that_varies_is_reported_where_it_is_not_measured(seed):
    """The filter of the tests makes the warning an error, which ends the calibration."""
    table = instruments.SimulatedTable(
        fresh_seed(seed), shape=(96, 96), camera_shape=(80, 80), distance=8e-3, regional=0.05
    )
    with pytest.raises(AccuracyWarning, match=r"use regions=\(3, 3\)"):
        instruments.calibrate_table(*instruments_of(table), 532e-9, 8e-3, regions=(1, 1))


def test_a_modulator_that_does_not_modulate_is_reported():
    table = instruments.SimulatedTable(4, shape=(32, 32), camera_shape=(40, 40), distance=3e-3)
    table.truth = dataclasses.replace(table.truth, phases=np.zeros(256))
    with pytest.raises(RuntimeError, match="must observe how the interference"):
        instruments.measure_phase_response(*instruments_of(table), 532e-9, 3e-3, samples=9, captures=2)


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_wavefront_within_a_hundredth_of_a_wavelength(calibrated):
    table, found = calibrated
    low = low_modes(table.modulator)
    error = spots.without(found.wavefront - table.truth.wavefront, low)
    assert rms(error) < 2 * np.pi / 100 < 0.1 * rms(table.truth.wavefront)


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_registration_within_a_tenth_of_a_pixel(calibrated):
    table, found = calibrated
    assert distance_in_pixels(found.registration, table).max() < 0.1


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_distance_within_a_thousandth(calibrated):
    table, found = calibrated
    assert found.distance == pytest.approx(table.truth.distance, rel=1e-3)


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_illumination_within_two_percent(calibrated):
    table, found = calibrated
    assert rms(found.amplitude - table.truth.amplitude / table.truth.amplitude.max()) < 0.02
    assert found.amplitude.max() == 1.0


UNCERTAIN = ("phases", "registration", "wavefront", "distance", "amplitude")


def errors_of(found, table):
    truth = table.truth
    wavefront = spots.without(found.wavefront - truth.wavefront, low_modes(table.modulator))
    return {
        "phases": np.abs(found.phases - truth.phases * truth.response.mean()).max(),
        "registration": distance_in_pixels(found.registration, table).max(),
        "wavefront": rms(wavefront),
        "distance": abs(found.distance - truth.distance),
        "amplitude": rms(found.amplitude - truth.amplitude / truth.amplitude.max()),
    }


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_uncertainties_contain_the_errors_and_are_of_their_size(calibrated):
    table, found = calibrated
    errors = errors_of(found, table)
    for name, bound in zip(UNCERTAIN, (0.03, 0.2, 2 * np.pi / 100, 1e-3 * found.distance, 0.03), strict=True):
        assert errors[name] < found.uncertainty[name] < bound


def test_pixels_that_are_not_square_are_refused():
    table = instruments.SimulatedTable(2, shape=(24, 24), camera_shape=(48, 48), distance=2e-3)
    modulator, camera = table.modulator, table.camera
    known = instruments.Registration(table.truth.homography, 0.0, camera.shape)
    modulator.pitch = (8e-6, 6e-6)
    there = (modulator, camera, 532e-9, 2e-3)
    for step in (
        lambda: instruments.calibrate_table(*there),
        lambda: instruments.Calibration.nominal(*there),
        lambda: instruments.register_camera(*there, table.truth.phases),
        lambda: instruments.measure_regional_response(*there, known),
        lambda: instruments.measure_wavefront(*there, table.truth.phases, known),
        lambda: instruments.measure_distance(*there, table.truth.phases, known),
        lambda: instruments.measure_illumination(*there, table.truth.phases, known),
        lambda: instruments.record_captures(modulator, camera, np.zeros((1, 24, 24), int), 532e-9),
    ):
        with pytest.raises(ValueError, match=r"modulator\.pitch must be one number"):
            step()
    with pytest.raises(TypeError, match="pitch must be one number"):
        instruments.SimulatedTable(2, pitch=(8e-6, 6e-6))


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_a_corrected_spot_is_as_bright_as_an_ideal_one(calibrated):
    table, found = calibrated
    ideal = instruments.SimulatedTable(
        1, misalignment=False, aberration=0.0, nonlinearity=False, distance_error=0.0, reflection=0.0, **SMALLER
    )
    nominal = spots.lens_phase(ideal.modulator, 532e-9, SMALLER["distance"]) % (2 * np.pi)
    linear = np.rint(nominal * 255 / (2 * np.pi)).astype(int)
    peaks = []
    corrected = found.levels(spots.lens_phase(table.modulator, found.wavelength, found.distance))
    for there, levels in ((table, corrected), (table, linear), (ideal, linear)):
        there.modulator.show(levels)
        light, _ = there.intensity()
        peaks.append(light.max() / there.truth.amplitude.sum() ** 2 * there.truth.distance**2)
    corrected, uncorrected, perfect = peaks
    assert corrected > 0.95 * perfect and uncorrected < 0.5 * perfect


@pytest.mark.xdist_group("calibrated")
@pytest.mark.slow
def test_files_are_read_back(calibrated, tmp_path):
    _, found = calibrated
    instruments.save_calibration(tmp_path / "a.npz", found)
    again = instruments.load_calibration(tmp_path / "a.npz")
    assert (again.wavelength, again.pitch, again.distance) == (found.wavelength, found.pitch, found.distance)
    for name in ("phases", "amplitude", "wavefront"):
        assert np.array_equal(getattr(again, name), getattr(found, name))
    assert again.uncertainty == found.uncertainty and set(again.uncertainty) == set(UNCERTAIN)
    assert again.registration.uncertainty == found.uncertainty["registration"]
    pixels = np.random.default_rng(0).uniform(0, 300, (5, 2))
    assert np.array_equal(again.registration.plane_points(pixels), found.registration.plane_points(pixels))
    with np.load(tmp_path / "a.npz") as store:
        header = json.loads(store["header"].tobytes())
    assert header["units"]["distance"] == "m" and header["version"] == 1
    with pytest.raises(FileNotFoundError, match=r"b\.npz"):
        instruments.load_calibration(tmp_path / "b.npz")
    (tmp_path / "b.npz").write_bytes(b"PK no archive")
    with pytest.raises(ValueError, match=r"b\.npz' cannot be read as a calibration"):
        instruments.load_calibration(tmp_path / "b.npz")
    np.savez(tmp_path / "c.npz", header=np.frombuffer(b'{"format": "other", "version": 1}', np.uint8))
    with pytest.raises(ValueError, match="its format is 'other'"):
        instruments.load_calibration(tmp_path / "c.npz")


@pytest.mark.parametrize("seed", [2, pytest.param(7, marks=pytest.mark.slow)])
def test_registration_of_an_unaberrated_table(seed):
    table = instruments.SimulatedTable(seed, aberration=0.0, distance_error=0.0)
    found = instruments.register_camera(*instruments_of(table), 532e-9, 20e-3, table.truth.phases)
    assert distance_in_pixels(found, table).max() < 0.1 and found.residual < 0.1
    pixels = np.random.default_rng(1).uniform(20, 300, (40, 2))
    assert np.abs(found.camera_pixels(found.plane_points(pixels)) - pixels).max() < 1e-6


@pytest.mark.slow
def test_large_wavefront_seen_by_a_camera_that_is_turned_and_mirrored():
    """Root mean square of half a wavelength, a panel that is not square; the response is known."""
    table = instruments.SimulatedTable(
        fresh_seed(11), shape=(84, 110), distance=15e-3, camera_shape=(290, 250), aberration=0.5
    )
    turn = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    table.truth = dataclasses.replace(table.truth, homography=table.truth.homography @ turn)
    modulator, camera = instruments_of(table)
    there = (modulator, Counting(camera), 532e-9, 15e-3, table.truth.phases)
    found, low = 0.0, low_modes(table.modulator)
    taken = 0
    for start, iterations, bound in ((False, 5, 3.0), (True, 3, 1.0)):
        known = instruments.register_camera(*there, wavefront=found, middle=not start)
        before = there[1].taken
        found = instruments.measure_wavefront(
            *there, known, iterations=iterations, captures=1 + start, start=found if start else None
        )
        taken += there[1].taken - before
        error = spots.without(found - table.truth.wavefront, low)
        assert rms(error) < bound * 2 * np.pi / 100
    assert taken <= 30


def test_an_aberration_beyond_the_lenslets_is_reported():
    table = instruments.SimulatedTable(
        fresh_seed(12), shape=(64, 64), distance=5e-3, camera_shape=(140, 140), aberration=4.0, misalignment=False
    )
    known = instruments.Registration(table.truth.homography, 0.0, table.camera.shape)
    with pytest.warns(AccuracyWarning, match="the wavefront is uncertain"):
        instruments.measure_wavefront(
            *instruments_of(table), 532e-9, 5e-3, table.truth.phases, known, iterations=5, captures=1
        )


def test_pixels_that_do_not_reach_the_axis_are_reported():
    table = instruments.SimulatedTable(2, shape=(24, 24), distance=2e-3, camera_shape=(48, 48), misalignment=False)
    known = instruments.Registration(table.truth.homography, 0.0, table.camera.shape)
    with pytest.warns(AccuracyWarning, match="the illumination is uncertain by .*: pixels at the edges"):
        instruments.measure_illumination(
            *instruments_of(table), 532e-9, 2e-3, table.truth.phases, known, cells=3, order=1, patterns=40
        )


def illumination_found(seed, **faults):
    table = instruments.SimulatedTable(seed, **faults)
    truth = table.truth
    known = instruments.Registration(truth.homography, truth.distortion, table.camera.shape)
    there = (*instruments_of(table), table.wavelength, truth.distance, truth.phases, known)
    found = instruments.measure_illumination(*there, wavefront=truth.wavefront)
    return rms(found - truth.amplitude / truth.amplitude.max())


@pytest.mark.slow
@pytest.mark.parametrize(
    "faults", [{"fill_factor": 0.9, "samples_per_pixel": 2}, {"fringing": 0.3, "samples_per_pixel": 2}, {}]
)
def test_illumination_does_not_depend_on_gaps_fringing_fields_and_the_wavelength(faults):
    """At 450 nm pixels at the edges do not reach the axis, and the uncertainty stated is up to 3 %."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the illumination is uncertain by 0.0[23]", AccuracyWarning)
        error = illumination_found(fresh_seed(13), **(faults or {"wavelength": 450e-9}))
    assert error < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("seed", [14, 15])
def test_dust_is_reported(seed):
    """The map is smooth; the pixels that the dust covers deviate."""
    with pytest.warns(AccuracyWarning, match="darker than the polynomial by up to"):
        error = illumination_found(fresh_seed(seed), dust=3)
    assert 0.02 < error < 0.05


@pytest.mark.slow
def test_a_response_that_varies_over_the_modulator_does_not_shift_the_image():
    """With the response of the whole panel alone, the image is 0.2 pixels beside its place."""
    table = instruments.SimulatedTable(fresh_seed(16), regional=0.05)
    with warnings.catch_warnings():
        # The response varies within the regions too.
        warnings.simplefilter("ignore", AccuracyWarning)
        found = instruments.calibrate_table(*instruments_of(table), 532e-9, 20e-3)
    errors = errors_of(found, table)
    assert all(errors[name] < found.uncertainty[name] for name in errors)
    assert distance_in_pixels(found.registration, table).max() < 0.1
    error = spots.without(found.wavefront - table.truth.wavefront, low_modes(table.modulator))
    assert rms(error) < 2 * np.pi / 100
    assert rms(found.amplitude - table.truth.amplitude / table.truth.amplitude.max()) < 0.02
    assert found.regional_phases.shape == (3, 3, 256)
    assert np.abs(found.phases - table.truth.phases * table.truth.response.mean()).max() < 0.02
    assert found.distance == pytest.approx(table.truth.distance, rel=1e-3)


@pytest.mark.parametrize("seed", [0, 3, 5])
@pytest.mark.slow
def test_first_registration_with_an_aberration_of_a_wavelength(seed):
    """Up to the shift by the tilt of the aberration in the middle, and the scale of the unknown distance."""
    table = instruments.SimulatedTable(seed, **SMALLER, aberration=1.0, regional=0.05, fill_factor=0.9)
    found = instruments.register_camera(
        *instruments_of(table), 532e-9, SMALLER["distance"], table.truth.phases, middle=True
    )
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (100, 2)) * 108 * 8e-6
    seen = table.truth.plane_points(found.camera_pixels(points), table.camera.shape)
    (*linear, _), *_ = np.linalg.lstsq(np.column_stack([points, np.ones(100)]), seen, rcond=None)
    assert np.abs(linear - np.eye(2) * table.truth.distance / SMALLER["distance"]).max() < 2e-3
    assert found.residual < 0.2


def test_first_registration_of_an_independent_table_with_orders_in_view():
    """Mirrored, with gaps between pixels and an aberration of a wavelength; the distance is wrong by 1.3 %."""
    y, x = ((np.arange(n) - n // 2) / 54 for n in (108, 108))
    y = y[:, None]
    surface = without_defocus(0.3 * x * y - 0.6 * (x**2 - y**2) + x**3 - 2 * x * y**2 - 0.4 * y * (x**2 + y**2))
    options = {"camera_shape": (240, 240), "camera_pitch": 4e-6, "fill": 0.9, "offset": (3e-5, -2e-5), "signs": (-1, 1)}
    surface *= 2 * np.pi / surface.std()
    table = Laboratory((108, 108), distance=15.2e-3, wavefront=surface, **options)
    found = instruments.register_camera(*instruments_of(table), 532e-9, 15e-3, table.phases, middle=True)
    points = np.random.default_rng(0).uniform(-0.35, 0.35, (100, 2)) * 108 * 8e-6
    pixels = found.camera_pixels(points)
    seen = np.stack([table.points(pixels[:, 0], 1), table.points(pixels[:, 1], 0)], axis=-1)
    (*linear, _), *_ = np.linalg.lstsq(np.column_stack([points, np.ones(100)]), seen, rcond=None)
    assert np.abs(linear - np.eye(2) * 15.2 / 15).max() < 2e-3
    assert found.residual < 0.2


@pytest.mark.slow
def test_registration_and_wavefront_through_a_lens():
    """On an independent table at the focal planes of a lens, with gaps whose light is the zero order."""
    focal, panel = 20e-3, (96, 96)
    y, x = ((np.arange(n) - n // 2) / 48 for n in panel)
    y = y[:, None]
    surface = 0.8 * (x**2 + y**2) + x * y - 0.6 * (x**2 - y**2) + x**3 - 0.4 * y * (x**2 + y**2) + 0.3 * (x - y)
    options = {"camera_shape": (220, 240), "camera_pitch": 4e-6, "fill": 0.9, "offset": (3e-5, -2e-5), "signs": (-1, 1)}
    table = Laboratory(panel, wavefront=surface, focal_length=focal, **options)
    there = (*instruments_of(table), 532e-9, instruments.Lens(focal), table.phases)
    registration = instruments.register_camera(*there, middle=True)
    wavefront = instruments.measure_wavefront(*there, registration, iterations=4, captures=1)
    registration = instruments.register_camera(*there, wavefront=wavefront)
    wavefront = instruments.measure_wavefront(*there, registration, iterations=2, start=wavefront)
    # Tilts belong to the registration; the defocus, of a camera beside the focus, does not.
    tilts = spots.aberration_modes(table.modulator, 1)
    assert rms(spots.without(wavefront - surface, tilts)) < 2 * np.pi / 200
    left = spots.without(surface - wavefront, spots.aberration_modes(table.modulator, 4)[2:])
    by_tilt = [np.gradient(left, table.modulator.pitch)[axis].mean() * 532e-9 * focal / (2 * np.pi) for axis in (1, 0)]
    points = np.random.default_rng(0).uniform(-3e-4, 3e-4, (100, 2))
    pixels = registration.camera_pixels(points)
    seen = np.stack([table.points(pixels[:, 0], 1), table.points(pixels[:, 1], 0)], axis=-1)
    assert np.abs(seen - points - by_tilt).max() < 0.1 * table.camera.pitch


@pytest.mark.slow
def test_calibration_through_a_lens(tmp_path):
    """Of an independent table: response, beam off the axis, aberration, defocus; its file, a predicted capture."""
    focal, panel = 20e-3, (96, 96)
    y, x = ((np.arange(n) - n // 2) / 48 for n in panel)
    y = y[:, None]
    surface = 0.6 * (x**2 + y**2) + 0.7 * x * y + 0.5 * without_defocus(x**3 + 0 * y) - 0.4 * (x**2 - y**2)
    level = np.arange(256) / 255
    beam = np.exp(-((x - 0.2) ** 2 + (y + 0.1) ** 2) / 2)
    options = {"camera_shape": (220, 240), "camera_pitch": 4e-6, "fill": 0.9, "offset": (3e-5, -2e-5), "signs": (-1, 1)}
    options |= {"phases": 2 * np.pi * (level**1.2 + 0.03 * np.sin(2 * np.pi * level)), "amplitude": beam / beam.max()}
    table = Laboratory(panel, wavefront=surface, focal_length=focal, **options)
    lens = instruments.Lens(focal)
    with warnings.catch_warnings():
        # Of so few pixels, some parts seem darker than the polynomial.
        warnings.filterwarnings("ignore", "the illumination is uncertain", AccuracyWarning)
        found = instruments.calibrate_table(*instruments_of(table), 532e-9, lens)
    wrong = spots.without(found.wavefront - surface, spots.aberration_modes(table.modulator, 1))
    assert rms(wrong) < 2 * np.pi / 200
    assert rms(wrong) < found.uncertainty["wavefront"]
    assert np.abs(found.phases - table.phases).max() < 0.02
    assert rms(found.amplitude - beam / beam.max()) < 0.02
    points = np.random.default_rng(0).uniform(-3e-4, 3e-4, (100, 2))
    pixels = found.registration.camera_pixels(points)
    seen = np.stack([table.points(pixels[:, 0], 1), table.points(pixels[:, 1], 0)], axis=-1)
    assert np.abs(seen - points).max() < 0.1 * table.camera.pitch
    instruments.save_calibration(tmp_path / "table.h5", found)
    read = instruments.load_calibration(tmp_path / "table.h5")
    assert read.distance == lens
    levels = read.levels(spots.spots_phase(table.modulator, 532e-9, lens, points[:9]))
    table.modulator.show(levels)
    capture, ideal = table.light(0, 0, 220, 240), calibration.predicted_capture(read, levels)
    away = np.hypot(*np.moveaxis(read.registration.plane_points(np.indices((220, 240))[::-1].T), -1, 0)).T > 5e-5
    assert np.corrcoef(capture[away], ideal[away])[0, 1] > 0.999


def test_steps_that_a_lens_does_not_have_say_why():
    table = instruments.SimulatedTable(1, distance=instruments.Lens(20e-3))
    known = instruments.Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (320, 320))
    with pytest.raises(TypeError, match="behind a lens measure_wavefront finds the defocus"):
        instruments.measure_distance(*instruments_of(table), 532e-9, instruments.Lens(0.2), table.truth.phases, known)
    with pytest.raises(ValueError, match="distance must be without a lens for regions and partial"):
        instruments.calibrate_table(*instruments_of(table), 532e-9, instruments.Lens(0.2), partial=True)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [fresh_seed(21), 3, 5])
def test_an_aberration_of_a_wavelength_and_a_response_that_varies(seed):
    """Registration 0.1 pixels, wavefront λ/100, phases 0.02 rad; the illumination is not measured."""
    table = instruments.SimulatedTable(seed, **SMALLER, aberration=1.0, regional=0.05, flicker=0.01)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "illumination_with_uncertainty", lambda *_, **__: (table.truth.amplitude, 0.0))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            found = instruments.calibrate_table(*instruments_of(table), 532e-9, SMALLER["distance"])
    errors = errors_of(found, table)
    for name, bound in (("registration", 0.1), ("wavefront", 2 * np.pi / 100), ("phases", 0.02)):
        assert errors[name] < bound
        assert errors[name] < found.uncertainty[name]


def test_sharpest_focus_has_the_astigmatism_of_the_table():
    """Its error is below λ/400, with a wrong registration and where the estimate is wrong by λ/10."""
    table = instruments.SimulatedTable(fresh_seed(22), shape=(96, 96), distance=12e-3, camera_shape=(140, 140))
    truth, modes = table.truth, spots.aberration_modes(table.modulator, 2)
    low = low_modes(table.modulator)
    astigmatism = spots.without(modes[2] - 0.5 * modes[4], low)
    wrong = truth.wavefront + astigmatism * (0.2 * np.pi / astigmatism.std())
    sheared = truth.homography @ np.array([[1.0, 0.02, 0.0], [0.02, 1.0, 0.0], [0.0, 0.0, 1.0]])
    known = instruments.Registration(sheared, truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, truth.distance, truth.phases, known)
    # Parabolas through sharpness of a tenth of a wavelength beside the peak, and then nearer to it.
    for _ in range(3):
        wrong = focus.astigmatism_by_focus(*there, wrong, captures=4)
    assert rms(spots.without(wrong - truth.wavefront, low)) < 2 * np.pi / 400


def test_a_camera_that_sees_few_spots_is_reported():
    table = instruments.SimulatedTable(2, aberration=0.0, camera_shape=(90, 90), misalignment=False)
    # As if the three single spots had been far apart.
    with (
        pytest.raises(RuntimeError, match=r"\d+ of 36 spots lie inside the image"),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(registration, "centroid", lambda frame, place, reach: np.asarray(place, float) * 2.8)
        instruments.register_camera(*instruments_of(table), 532e-9, 20e-3, table.truth.phases)


def test_focus_outside_of_the_range_warns():
    table = instruments.SimulatedTable(
        4, shape=(96, 96), camera_shape=(120, 120), distance=12e-3, aberration=0.0, distance_error=0.0
    )
    mapping = instruments.Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, 13.2e-3, table.truth.phases, mapping)
    with pytest.warns(AccuracyWarning, match="end of the range"):
        found = instruments.measure_distance(*there, span=0.05, captures=1)
    assert found == pytest.approx(table.truth.distance, rel=3e-3)


def test_distance_of_a_simulated_table():
    """Its pixels are squares, whose envelope shifts the sharpest focus by some hundredths of the depth of focus."""
    table = instruments.SimulatedTable(
        4, shape=(96, 96), camera_shape=(120, 120), distance=12e-3, aberration=0.0, reflection=0.0
    )
    mapping = instruments.Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    there = (*instruments_of(table), 532e-9, 12e-3, table.truth.phases, mapping)
    found = instruments.measure_distance(*there, samples=9, captures=32)
    assert found == pytest.approx(table.truth.distance, rel=1e-4)


def aligned(laboratory):
    pitch = laboratory.camera.pitch
    return instruments.Registration(np.diag([pitch, pitch, 1.0]), 0.0, laboratory.camera.shape)


def distance_found(wrong, shape, bits=8, distance=0.1, **options):
    table = Laboratory(shape, distance=distance, bits=bits)
    there = (*instruments_of(table), table.wavelength, distance * (1 + wrong), table.phases, aligned(table))
    return focus.distance_with_uncertainty(*there, **options)[0] / distance


def test_distance_of_a_panel_whose_depth_of_focus_is_narrow():
    """The focus of all pixels is 0.4 % deep; a sweep in steps of 4 % finds that of a small part of them first."""
    assert distance_found(-0.12, (480, 640), samples=9, captures=1) == pytest.approx(1, abs=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "bits", "distance"), [(0.02, 8, 0.1), (-0.12, 10, 0.2)])
def test_distance_of_a_full_panel(wrong, bits, distance):
    """1080 x 1920 pixels, depth of focus 0.1 %."""
    assert distance_found(wrong, (1080, 1920), bits, distance, captures=1) == pytest.approx(1, abs=1e-4)


def test_distance_without_light_is_an_error_that_says_what_was_seen():
    table = Laboratory((48, 64), distance=0.01, camera_shape=(120, 120))
    table.power = 0.0
    there = (*instruments_of(table), table.wavelength, 0.01, table.phases, aligned(table))
    with pytest.raises(RuntimeError, match=r"sees no light: .* of 4095 counts"):
        instruments.measure_distance(*there)
    still = Laboratory((48, 64), distance=0.01, camera_shape=(120, 120), phases=np.zeros(256))
    with pytest.raises(
        RuntimeError, match=r"no focus was found among focal lengths from .* of 4095 counts, .* registra"
    ):
        instruments.measure_distance(*instruments_of(still), *there[2:])
    with pytest.raises(ValueError, match="span must be a share of the distance below 1, got 1"):
        instruments.measure_distance(*there, span=1.0)


@pytest.mark.slow
def test_first_registration_of_an_oblong_panel_all_of_which_is_lit():
    """The second moments of its pixels differ along rows and columns: the curvature was 4 times too large."""
    y, x = ((np.arange(n) - n // 2) / 240 for n in (270, 480))
    y = y[:, None]
    wavefront = without_defocus(np.pi * (x**3 - 0.5 * x * y**2 + 0.8 * x * y + 0.5 * (x**2 - y**2)))
    table = Laboratory(
        (270, 480), 3.74e-6, 0.0375, camera_shape=(200, 300), camera_pitch=6.5e-6, wavefront=wavefront, signs=(-1, 1)
    )
    there = (*instruments_of(table), 532e-9, 1.015 * 0.0375, table.phases)
    assert instruments.register_camera(*there, middle=True, captures=2).residual < 0.1


def test_spots_that_do_not_move_with_the_pattern_are_reported():
    still = Laboratory((96, 128), distance=0.01, camera_shape=(200, 240), phases=np.zeros(256))
    with pytest.raises(RuntimeError, match=r"no spot was found on the axis .* does not move as the pattern does"):
        instruments.register_camera(*instruments_of(still), 532e-9, 0.01, 2 * np.pi * np.arange(256) / 256)


def test_nearest_levels_are_nearest():
    phases = np.random.default_rng(0).uniform(-4, 9, 16)
    wanted = np.random.default_rng(1).uniform(-20, 20, (30, 20))
    found = phase_response.nearest_levels(wanted, phases)
    apart = np.abs(np.angle(np.exp(1j * (phases[None, None] - wanted[..., None]))))
    assert np.allclose(np.take_along_axis(apart, found[..., None], -1)[..., 0], apart.min(-1))


def test_simulated_instruments_follow_the_protocols_and_are_repeatable():
    first, second, other = (
        instruments.SimulatedTable(seed, shape=(24, 32), camera_shape=(40, 48)) for seed in (3, 3, 4)
    )
    assert isinstance(first.modulator, instruments.Modulator) and isinstance(first.camera, instruments.Camera)
    assert isinstance(first.laser, instruments.Laser) and isinstance(first.stage, instruments.Stage)
    levels = np.random.default_rng(0).integers(256, size=(24, 32))
    for table in (first, second, other):
        table.modulator.show(levels)
        table.camera.exposure = 0.05
    frames = [table.camera.capture(2) for table in (first, second, other)]
    assert np.array_equal(frames[0], frames[1]) and not np.array_equal(frames[0], frames[2])
    assert not np.array_equal(frames[0][0], frames[0][1])
    first.camera.region = (5, 6, 7, 8)
    assert first.camera.capture().shape == (1, 7, 8)
    first.laser.power = 0.0
    assert first.camera.capture().max() < 12
    for wrong in (levels[:-1], levels * 2.0, levels + 200):
        with pytest.raises(ValueError, match="levels must be"):
            first.modulator.show(wrong)


def test_a_camera_counts_photons():
    table = instruments.SimulatedTable(6, misalignment=False, aberration=0.0, reflection=0.0)
    table.modulator.show(np.zeros(table.modulator.shape, int))
    table.camera.exposure, table.camera.region = 3.0, (140, 140, 40, 40)
    frames = table.camera.capture(200).astype(float) * instruments.simulated.FULL_WELL / 4095
    electrons = frames.mean(0) - 20
    # Shot noise, read noise of 3 electrons, and steps of 4.9 electrons.
    expected = electrons + 9 + (instruments.simulated.FULL_WELL / 4095) ** 2 / 12
    assert np.median(frames.var(0) / expected) == pytest.approx(1.0, abs=0.1) and electrons.mean() > 50
    table.camera.exposure = 1e4
    assert table.camera.capture().min() == 4095


def test_drivers_are_found_by_entry_points(monkeypatch):
    table = instruments.SimulatedTable(1, shape=(8, 8), camera_shape=(8, 8))
    installed = [EntryPoint("screen", "a:b", "odak.instruments"), EntryPoint("wrong", "a:c", "odak.instruments")]
    monkeypatch.setattr(protocols, "entry_points", lambda group: [e for e in installed if e.group == group])
    drivers = {"screen": lambda display: table.modulator, "wrong": dict}
    monkeypatch.setattr(EntryPoint, "load", lambda self: drivers[self.name])
    assert instruments.open_instrument("screen", display=1) is table.modulator
    with pytest.raises(TypeError, match="implements none of the instrument protocols"):
        instruments.open_instrument("wrong")
    with pytest.raises(ValueError, match=r"installed driver \('screen', 'wrong'\), got 'camera'"):
        instruments.open_instrument("camera")
