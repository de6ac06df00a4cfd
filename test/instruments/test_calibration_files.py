"""Files of calibrations: nonsense is refused by the name of its field."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from odak import instruments
from odak.instruments import calibration_files


def nominal(shape=(6, 8), camera_shape=(5, 7)):
    table = instruments.SimulatedTable(1, shape=shape, camera_shape=camera_shape)
    found = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 2e-2)
    return dataclasses.replace(found, uncertainty={"distance": 1e-6})


NAN, INF, FLAT = np.nan, np.inf, np.array([[1.0, 0, 0], [2, 0, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"wavelength": NAN}, "wavelength must be finite, got nan"),
        ({"wavelength": 532.0}, "wavelength must be from 1e-09 to 0.001 metres, got 532"),
        ({"pitch": -8e-6}, "pitch must be from 1e-08 to 0.01 metres, got -8e-06"),
        ({"distance": INF}, "distance must be finite, got inf"),
        ({"distance": 0.0}, "distance must be from"),
        ({"phases": np.full(256, NAN)}, "phases must be from .* got nan"),
        ({"phases": np.zeros((2, 128))}, r"phases must be \[levels\], got \[2, 128\]"),
        ({"phases": np.zeros(1)}, "phases must have at least 2 levels, got 1"),
        ({"amplitude": np.full((6, 8), -1.0)}, "amplitude must be from 0 to 1, got -1"),
        ({"amplitude": np.zeros((6, 8))}, "amplitude must be above 0"),
        ({"amplitude": np.ones((0, 8))}, "amplitude must not be empty"),
        ({"wavefront": np.zeros((8, 6))}, r"wavefront must be \[6, 8\], got \[8, 6\]"),
        ({"wavefront": np.full((6, 8), -INF)}, "wavefront must be from .* got -inf"),
        ({"regional_phases": np.zeros((2, 2, 9))}, r"regional_phases must be \[region rows, region columns, 256\]"),
        ({"regional_phases": np.zeros((7, 2, 256))}, "regional_phases must have at most"),
        ({"homography": np.zeros((3, 3))}, "homography must map the whole sensor"),
        ({"homography": FLAT * 1e-6}, "homography must map"),
        ({"homography": np.diag([1.0, 1e-6, 1e-6])}, "homography must map a pixel to an area"),
        ({"homography": np.array([[4e-6, 0, 0], [0, 4e-6, 0], [0.4, 0, 1]])}, "homography .* has a pole on it"),
        ({"homography": np.full((3, 3), NAN)}, "homography must be from .* got nan"),
        ({"camera_shape": [5.5, 7]}, r"camera_shape\[0\] must be a whole number"),
        ({"camera_shape": [5, 7, 3]}, "camera_shape must be two numbers"),
        ({"distortion": -0.5}, "distortion must be from"),
        ({"residual": -1.0}, "residual must be from 0"),
        ({"uncertainty_distance": NAN}, "uncertainty_distance must be finite"),
    ],
)
@pytest.mark.parametrize("end", ["npz", "h5"])
def test_nonsense_in_calibrations_is_refused_by_its_name(values, told, end, tmp_path, monkeypatch):
    if end == "h5":
        pytest.importorskip("h5py", reason="h5py is not installed")
    path, found = tmp_path / f"a.{end}", nominal()
    instruments.save_calibration(path, found)
    before = path.read_bytes()
    with pytest.raises((ValueError, TypeError), match=f"^{told}"):
        calibration_files._checked(calibration_files._values(found) | values)
    # As a file that another program wrote: without the checks of this one.
    with monkeypatch.context() as without:
        written = calibration_files._values(found) | values
        without.setattr(calibration_files, "_checked", lambda values: values)
        without.setattr(calibration_files, "_values", lambda given: written)
        instruments.save_calibration(path, found)
    assert path.read_bytes() != before
    with pytest.raises(ValueError, match=rf"a\.{end}' cannot be read as a calibration: {told}"):
        instruments.load_calibration(path)


def test_threads_save_hdf5_at_the_same_time(tmp_path):
    pytest.importorskip("h5py", reason="h5py is not installed")
    found = nominal()
    with ThreadPoolExecutor(20) as threads:
        list(threads.map(lambda i: instruments.save_calibration(tmp_path / f"{i}.h5", found), range(40)))
    assert all(instruments.load_calibration(tmp_path / f"{i}.h5").wavelength == 532e-9 for i in range(40))
