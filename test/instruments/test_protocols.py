"""Checks of instruments where they come in, and drivers by entry points."""

from importlib.metadata import EntryPoint

import numpy as np
import pytest

from odak import instruments
from odak.instruments import protocols


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


def test_drivers_are_found_by_entry_points(monkeypatch):
    table = instruments.SimulatedTable(1, shape=(8, 8), camera_shape=(8, 8))
    installed = [EntryPoint("screen", "a:b", "odak.instruments"), EntryPoint("wrong", "a:c", "odak.instruments")]
    monkeypatch.setattr(protocols, "entry_points", lambda group: [e for e in installed if e.group == group])
    drivers = {"screen": lambda display: table.modulator, "wrong": dict}
    monkeypatch.setattr(EntryPoint, "load", lambda self: drivers[self.name])
    assert instruments.open_instrument("screen", display=1) is table.modulator
    with pytest.raises(TypeError, match="implements none of the instrument protocols"):
        instruments.open_instrument("wrong")
    with pytest.raises(ValueError, match=r"installed drivers \('screen', 'wrong'\), got 'camera'"):
        instruments.open_instrument("camera")
