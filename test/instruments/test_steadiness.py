"""Tables that are not steady, of the independent laboratory: sizes that are named, errors, and what stays right."""

import re
import warnings

import numpy as np
import pytest
from laboratory import Altered, random_table
from tables import instruments_of

from odak import AccuracyWarning, instruments
from odak.instruments import OpticalTable, calibration
from odak.instruments.phase_response import phases_with_uncertainty

UNSTEADY = {
    "flicker": r"phases of the modulator flicker by ([\d.]+)%",
    "wander": r"the light varies by ([\d.]+)%",
    "vibration": r"the image moves by ([\d.]+) pixels",
}


def calibrated(seed, **unsteady):
    """Return a table, its calibration, and what was warned of."""
    table, nominal = random_table(seed)
    for name, value in unsteady.items():
        setattr(table, name, value)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = instruments.calibrate_table(*instruments_of(table), table.wavelength, nominal)
    return table, found, [str(warning.message) for warning in caught]


def phases_of(seed, **unsteady):
    """Return the largest error of a phase response in radians, and what was warned of."""
    table, nominal = random_table(seed)
    for name, value in unsteady.items():
        setattr(table, name, value)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        phases = instruments.measure_phase_response(
            OpticalTable(*instruments_of(table), table.wavelength, nominal), captures=2
        )
    return np.abs(phases - table.phases).max(), " ".join(str(warning.message) for warning in caught)


def test_a_steady_table_is_silent_within_116_captures():
    table, _, texts = calibrated(201)
    assert not [text for text in texts if "steady" in text or "drifts" in text or "ambient" in text]
    assert table.camera.taken <= 116


def test_phases_are_right_while_the_camera_vibrates():
    """By a tenth of a pixel; without alignment the error is 0.1 rad."""
    error, text = phases_of(201, vibration=0.1)
    assert error < 0.03
    assert 0.05 < float(re.search(UNSTEADY["vibration"], text)[1]) < 0.2


@pytest.mark.parametrize(
    ("name", "value", "bounds"),
    [
        ("wander", 0.02, (1.0, 4.0)),
        pytest.param("flicker", 0.05, (2.0, 9.0), marks=pytest.mark.slow),
        pytest.param("vibration", 0.3, (0.15, 0.6), marks=pytest.mark.slow),
    ],
)
def test_what_is_not_steady_is_named_by_its_size(name, value, bounds):
    _, found, texts = calibrated(201, **{name: value})
    (text,) = (text for text in texts if "not steady" in text)
    named = [other for other, pattern in UNSTEADY.items() if re.search(pattern, text)]
    # Large changes of the phases change the light where it is seen, too.
    assert named == [name] or (name == "flicker" and named == ["flicker", "wander"])
    assert bounds[0] < float(re.search(UNSTEADY[name], text)[1]) < bounds[1]
    assert found.uncertainty["phases"] > 0.005


def test_a_drift_of_the_light_is_named_and_corrected():
    """Of 10 % in 100 captures, from which the phases are 0.02 rad off without correction."""
    table, found, texts = calibrated(201, dimming=0.1)
    (text,) = (text for text in texts if "drifts" in text)
    assert 8 < float(re.search(r"the light changed by -([\d.]+)%", text)[1]) < 16
    assert table.errors(found)["phases"] < 4e-3


@pytest.mark.parametrize("after", [12, 20])
def test_a_lamp_that_is_switched_on_is_named_by_its_size_and_corrected(after):
    """While levels are shown; without correction it was taken for what the level changes."""
    error, text = phases_of(201, lamp=1.0, dark_captures=after)
    assert error < 5e-3
    assert 15 < float(re.search(r"ambient light, .*, changed by ([\d.]+)% of the brightest", text)[1]) < 30


def test_a_lamp_that_blinds_the_camera_is_an_error_by_name():
    with pytest.raises(RuntimeError, match=r"of the camera's pixels are saturated in a capture"):
        phases_of(201, lamp=5.0, dark_captures=12)


@pytest.mark.slow
@pytest.mark.parametrize("after", [45, 75, 100])
def test_a_lamp_that_is_switched_on_changes_no_calibration(after):
    """As bright as the panel is lit; the table has the same errors without it."""
    table, found, texts = calibrated(201, lamp=1.0, dark_captures=after)
    bounds = {"phases": 3e-3, "registration": 0.1, "wavefront": 0.03, "distance": 1e-3, "amplitude": 0.01}
    assert all(abs(error) < bounds[name] for name, error in table.errors(found).items())
    (text,) = (text for text in texts if "ambient" in text)
    assert 15 < float(re.search(r"changed by ([\d.]+)%", text)[1]) < 30


@pytest.mark.slow
def test_a_drift_of_the_image_is_named():
    _, _, texts = calibrated(201, sliding=1.0)
    (text,) = (text for text in texts if "drifts" in text)
    # Along both axes.
    assert 1.2 < float(re.search(r"the image moved by ([\d.]+) pixels", text)[1]) < 2.5


def test_light_that_goes_out_is_an_error_by_name():
    table, nominal = random_table(201)
    modulator, camera = instruments_of(table)
    dark = Altered(camera, lambda frames, _: frames if table.camera.taken < 45 else np.zeros_like(frames) + 6)
    with pytest.raises(RuntimeError, match=r"no longer sees what it saw|sees no light|no spot was found on the axis"):
        instruments.calibrate_table(modulator, dark, table.wavelength, nominal)


def test_light_that_varies_is_not_called_a_gamma_curve():
    """Of 16 cameras whose light varies by 4 % from frame to frame, several look so from three captures."""
    for seed in range(16):
        draw = np.random.default_rng(seed)
        table = instruments.SimulatedTable(1, shape=(24, 24), distance=3e-3, camera_shape=(32, 32))
        varying = Altered(table.camera, lambda f, _, draw=draw: (f * (1 + 0.04 * draw.normal())).astype(np.uint16))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            instruments.set_exposure(varying, level=0.4)
        # It is exposed to the level, but for four standard deviations of the light and the noise of photons.
        assert 0.32 < table.camera.capture()[0].max() / 4095 < 0.48


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_of_three_errors_lie_within_one_sigma_where_nothing_is_named(monkeypatch):
    """Of 64 errors 35 to 54 do so in 99 of 100 cases where it is 68 % of all; the illumination is not measured."""
    monkeypatch.setattr(
        calibration, "illumination_with_uncertainty", lambda part, *_, **__: (np.ones(part.modulator.shape), 0.0)
    )
    names = ("phases", "registration", "wavefront", "distance")
    within = dict.fromkeys(names, 0)
    for number, (name, value) in enumerate(8 * [("flicker", 0.01), ("vibration", 0.04)]):
        table, found, _ = calibrated(500 + number // 2, **{name: value})
        errors = table.errors(found)
        errors["distance"] *= table.distance
        for key in names:
            within[key] += abs(errors[key]) < found.uncertainty[key]
    assert all(count >= 6 for count in within.values()) and 35 <= sum(within.values()) <= 54, within


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("unsteady", [{"flicker": 0.01}, {"flicker": 0.05}, {"wander": 0.02}, {"vibration": 0.1}])
def test_two_of_three_errors_of_a_phase_response_lie_within_one_sigma(unsteady):
    """Of 40 errors 20 to 34 do so in 98 of 100 cases where it is 68 % of all."""
    within = 0
    for seed in range(700, 740):
        table, nominal = random_table(seed)
        for name, value in unsteady.items():
            setattr(table, name, value)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AccuracyWarning)
            there = OpticalTable(*instruments_of(table), table.wavelength, nominal)
            phases, sigma, _ = phases_with_uncertainty(there)
        within += np.abs(phases - table.phases).max() < sigma
    assert 20 <= within <= 34
