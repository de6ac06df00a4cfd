"""Panels of any width at any distance are calibrated, also where no point gets light from all pixels."""

import warnings

import numpy as np
import pytest
from laboratory import random_table, table_of
from tables import instruments_of

from odak import AccuracyWarning, instruments
from odak.instruments import calibration

# Pitch in µm, distance in mm of a panel of 1080 x 1920 pixels: pixels reach 0.2 to 2 times half of its width.
GEOMETRIES = [(pitch, distance) for pitch in (3.74, 6.4, 8.0) for distance in (50, 100, 200)]


@pytest.mark.parametrize(
    ("parts", "pitch", "distance", "bits"),
    [
        (12, 8.0, 100, 10),
        pytest.param(8, 8.0, 100, 10, marks=pytest.mark.slow),
        *(
            pytest.param(4, *sizes, bits, marks=pytest.mark.slow)
            for sizes, bits in zip(GEOMETRIES, (8, 10, 12) * 3, strict=True)
        ),
        # 540 x 960 pixels at 50 and at 100 mm.
        *(pytest.param(2, 8.0, distance, 10, marks=pytest.mark.slow) for distance in (100, 200)),
        pytest.param(1, 8.0, 100, 10, marks=[pytest.mark.slow, pytest.mark.timeout(3600)]),
    ],
)
def test_panels_of_any_width_at_any_distance(parts, pitch, distance, bits):
    """A panel of so many parts of 1080 x 1920 pixels, at that part of the distance: the same share is reached.

    The camera sees several orders of diffraction where the panel is wider than what its pixels reach.
    """
    table = table_of((1080 // parts, 1920 // parts), 1e-6 * pitch, 1e-3 * distance / parts, bits)
    there = instruments_of(table), table.wavelength, 1.015 * table.distance
    with warnings.catch_warnings():
        # Fewer pixels form larger spots, whose places and light are less certain.
        warnings.simplefilter("ignore", AccuracyWarning)
        found = instruments.calibrate_table(*there[0], *there[1:])
    errors = table.errors(found)
    bounds = {"phases": 5e-3, "registration": 0.3, "wavefront": 2 * np.pi / 30, "distance": 3e-3, "amplitude": 0.04}
    assert all(abs(errors[name]) < bound for name, bound in bounds.items()), errors


@pytest.mark.parametrize("seed", [409, pytest.param(415, marks=pytest.mark.slow)])
def test_beams_that_are_not_even_displace_no_spots(seed, monkeypatch):
    """Of lenslets beside one another the brighter draws the spots of the others to it: by 0.2 pixels here."""
    monkeypatch.setattr(
        calibration, "illumination_with_uncertainty", lambda part, *_, **__: (np.ones(part.modulator.shape), 0.0)
    )
    table, nominal = random_table(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AccuracyWarning)
        found = instruments.calibrate_table(*instruments_of(table), table.wavelength, nominal)
    errors = table.errors(found)
    assert errors["registration"] < 0.08 and errors["wavefront"] < 0.025 and abs(errors["distance"]) < 1e-3
