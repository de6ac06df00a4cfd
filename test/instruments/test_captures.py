"""Captures, their noise, and their files."""

import dataclasses
import importlib.resources
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from odak import instruments
from odak.instruments import array_files, captures

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
        assert store.attrs["format"] == b"odak captures" and store["frames"].attrs["units"] == "count"
    with pytest.raises(FileNotFoundError):
        instruments.load_captures(tmp_path / "b.h5")
    (tmp_path / "b.h5").write_bytes(b"no such format")
    with pytest.raises(ValueError, match=r"b\.h5' cannot be read as captures"):
        instruments.load_captures(tmp_path / "b.h5")


def test_texts_of_variable_length_are_not_read(tmp_path):
    """HDF5 takes memory for the length that a broken one states; earlier files had the format as such."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    path = tmp_path / "a.h5"
    instruments.save_calibration(path, nominal())
    with h5py.File(path, "a") as store:
        store.attrs["format"] = "odak calibration"
    assert instruments.load_calibration(path).distance == 2e-2
    content, text = path.read_bytes(), b"odak calibration"
    length = (len(text)).to_bytes(4, "little")
    heap = content.rfind(b"GCOL", 0, content.rfind(text)).to_bytes(8, "little")
    assert content.count(length + heap) == 1
    path.write_bytes(content.replace(length + heap, (1 << 20).to_bytes(4, "little") + heap))
    assert instruments.load_calibration(path).distance == 2e-2
    with h5py.File(path) as store, pytest.raises(OSError, match="does not match"):
        store.attrs["format"]


def test_files_that_reach_outside_of_themselves_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    instruments.save_captures(tmp_path / "a.h5", captured(2, 3))
    with h5py.File(tmp_path / "a.h5", "a") as store:
        store["more"] = h5py.ExternalLink("elsewhere.h5", "/secret")
    with pytest.raises(ValueError, match="'more' is not an array of numbers within the file"):
        instruments.load_captures(tmp_path / "a.h5")


def nominal(shape=(6, 8), camera_shape=(5, 7)):
    table = instruments.SimulatedTable(1, shape=shape, camera_shape=camera_shape)
    found = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 2e-2)
    return dataclasses.replace(found, uncertainty={"distance": 1e-6})


NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"frames": np.full((3, 2, 5, 7), 5000)}, "frames must be from 0 to 4095, got 5000"),
        ({"frames": np.zeros((3, 2, 5, 7))}, "frames must be integers, got float64"),
        ({"frames": np.zeros((2, 2, 5, 7), int)}, r"frames must be \[3, captures, camera rows, camera columns\]"),
        ({"levels": np.full((3, 6, 8), -1)}, "levels must be from 0 to 65535, got -1"),
        ({"positions": np.array([0.0, NAN, 0.0])}, "positions must be from -1000 to 1000, got nan"),
        ({"dark": np.zeros((7, 5))}, r"dark must be \[5, 7\], got \[7, 5\]"),
        ({"dark": -3.0}, "dark must be from 0 to 4095 counts, got -3"),
        ({"exposure": NAN}, "exposure must be finite"),
        ({"camera_bits": 0}, "camera_bits must be from 1 to 32, got 0"),
        ({"camera_pitch": 4.0}, "camera_pitch must be from 1e-08 to 0.01 metres, got 4.0"),
    ],
)
def test_nonsense_in_captures_is_refused_by_its_name(values, told, tmp_path):
    pytest.importorskip("h5py", reason="h5py is not installed")
    table = instruments.SimulatedTable(1, shape=(6, 8), camera_shape=(5, 7))
    levels = np.random.default_rng(0).integers(256, size=(3, 6, 8))
    found = instruments.record_captures(table.modulator, table.camera, levels, 532e-9)
    with pytest.raises((ValueError, TypeError), match=f"^{told}"):
        instruments.save_captures(tmp_path / "a.h5", dataclasses.replace(found, **values))
    assert not list(tmp_path.iterdir())
    parts = found.__dict__ | values
    arrays = {name: np.asarray(parts.pop(name)) for name in ("levels", "frames", "positions", "dark")}
    header = {"format": captures.CAPTURES, "version": captures.CAPTURES_VERSION, **parts}
    array_files.write_hdf5(tmp_path / "a.h5", arrays, header, captures.CAPTURE_UNITS)
    with pytest.raises(ValueError, match=rf"a\.h5' cannot be read as captures: {told}"):
        instruments.load_captures(tmp_path / "a.h5")


def test_what_compresses_best_is_read_too(tmp_path, monkeypatch):
    """A panel without faults is two maps of one value, which gzip shrinks by a factor of a thousand."""
    pytest.importorskip("h5py", reason="h5py is not installed")
    monkeypatch.setattr(array_files, "MOST_BYTES", 1 << 16)
    found = nominal((120, 160))
    instruments.save_calibration(tmp_path / "a.h5", found)
    assert np.array_equal(instruments.load_calibration(tmp_path / "a.h5").amplitude, found.amplitude)


def test_captures_of_package_are_those_that_its_script_makes():
    pytest.importorskip("h5py", reason="h5py is not installed")
    path = importlib.resources.files("odak") / "assets" / "simulated_captures.h5"
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
