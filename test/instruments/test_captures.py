"""Captures, their noise, and their files."""

import importlib.util
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from odak import instruments

ROOT = Path(__file__).resolve().parents[2]


def captured(count=4, patterns=5):
    table = instruments.SimulatedTable(4, shape=(24, 24), distance=2e-3, camera_shape=(40, 44), dust=1)
    table.camera.exposure = 0.1
    levels = np.random.default_rng(0).integers(256, size=(patterns, 24, 24))
    places = np.linspace(0, 1e-4, patterns)
    offset = 20 * 4095 / 20000
    there = (table.modulator, table.camera, levels, 532e-9)
    return instruments.record_captures(*there, captures=count, positions=places, stage=table.stage, dark=offset)


def test_noise_is_that_of_electrons():
    slope, offset = captured(8).noise()
    # Counts per electron; read noise of 3 electrons and the steps of the converter.
    assert slope == pytest.approx(4095 / 20000, rel=0.06)
    assert offset == pytest.approx(9 * (4095 / 20000) ** 2 + 1 / 12, rel=0.3)
    with pytest.raises(ValueError, match="at least 2 captures"):
        captured(1).noise()


def test_parts_and_means():
    captures = captured()
    part = captures[1:3]
    assert len(part) == 2 and np.array_equal(part.frames, captures.frames[1:3]) and part.exposure == captures.exposure
    assert np.allclose(captures.means(), captures.frames.mean(1) - captures.dark)
    table = instruments.SimulatedTable(4, shape=(24, 24), camera_shape=(40, 44))
    for wrong, message in (
        ({"positions": np.ones(2)}, "one number for each"),
        ({"positions": np.ones(1)}, "stage must"),
    ):
        with pytest.raises(ValueError, match=message):
            instruments.record_captures(table.modulator, table.camera, np.zeros((1, 24, 24), int), 532e-9, **wrong)
    with pytest.raises(ValueError, match=r"levels must be \[patterns, 24, 24\]"):
        instruments.record_captures(table.modulator, table.camera, np.zeros((24, 24), int), 532e-9)


def test_files_are_read_back_and_say_their_units(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    captures = captured(2, 3)
    instruments.save_captures(tmp_path / "a.h5", captures)
    again = instruments.load_captures(tmp_path / "a.h5")
    for name, value in captures.__dict__.items():
        assert np.array_equal(getattr(again, name), value)
    with h5py.File(tmp_path / "a.h5") as store:
        assert store.attrs["format"] == "odak captures" and store["frames"].attrs["units"] == "count"
    with pytest.raises(FileNotFoundError):
        instruments.load_captures(tmp_path / "b.h5")
    (tmp_path / "b.h5").write_bytes(b"no such format")
    with pytest.raises(ValueError, match=r"b\.h5' cannot be read as captures"):
        instruments.load_captures(tmp_path / "b.h5")


def test_files_that_reach_outside_of_themselves_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    instruments.save_captures(tmp_path / "a.h5", captured(2, 3))
    with h5py.File(tmp_path / "a.h5", "a") as store:
        store["more"] = h5py.ExternalLink("elsewhere.h5", "/secret")
    with pytest.raises(ValueError, match="'more' is not an array of numbers within the file"):
        instruments.load_captures(tmp_path / "a.h5")


def test_the_captures_of_the_package_are_those_that_its_script_makes():
    pytest.importorskip("h5py", reason="h5py is not installed")
    path = files("odak") / "assets" / "simulated_captures.h5"
    captures = instruments.load_captures(path)
    script = ROOT / "scripts" / "make_simulated_captures.py"
    if not script.exists():
        pytest.skip("an installed package has no scripts")
    specification = importlib.util.spec_from_file_location("make_simulated_captures", script)
    made = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(made)
    assert len(captures) == 10 and np.array_equal(captures.levels, made.patterns(10))
    table = made.table()
    table.camera.exposure = captures.exposure
    table.modulator.show(captures.levels[3])
    again = table.camera.capture(2).astype(float)
    # Shot noise of another draw.
    slope, floor = captures.noise()
    variance = slope * np.clip(captures.means()[3], 0, None) + floor
    assert np.mean((again.mean(0) - captures.dark - captures.means()[3]) ** 2 / variance) == pytest.approx(1, abs=0.15)
