"""The command `odak calibrate` on simulated tables and on drivers of the package."""

import dataclasses
import json
import sys

import numpy as np
import pytest

from odak import instruments
from odak.cli import main
from odak.instruments import calibration as calibrating

SMALL = ["--option", "simulated.shape=[40,40]", "--option", "simulated.camera_shape=[80,80]", "--distance", "5mm"]


def calibrate(step, folder, *more):
    code = main(["calibrate", step, "--output", str(folder), "--seed", "3", *SMALL, "--quiet", *more])
    return code, json.loads((folder / "report.json").read_text()) if code == 0 else None


def truth_of(**options):
    return instruments.SimulatedTable(3, shape=(40, 40), camera_shape=(80, 80), distance=5e-3, **options).truth


def started(folder):
    """Write a file of results with the true response, and return the table."""
    table = instruments.SimulatedTable(3, shape=(40, 40), camera_shape=(80, 80), distance=5e-3)
    start = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 5e-3)
    start = dataclasses.replace(start, phases=table.truth.phases)
    instruments.save_calibration(folder / "calibration.npz", start)
    return table


def test_steps_add_to_one_file_of_results(tmp_path, capsys):
    """Registration with a correct response, then the exposure; earlier results are kept."""
    table = started(tmp_path)
    for step in ("registration", "exposure"):
        code, report = calibrate(step, tmp_path)
        assert code == 0 and report["step"] == step and (tmp_path / f"{step}.png").stat().st_size > 3000
    assert 0.3 < report["found"]["brightest_share"] < 0.9
    found = instruments.load_calibration(tmp_path / "calibration.npz")
    assert np.array_equal(found.phases, table.truth.phases)
    pixels = np.random.default_rng(0).uniform(16, 64, (20, 2))
    missed = found.registration.plane_points(pixels) - table.truth.plane_points(pixels, (80, 80))
    # The aberration, which has not been measured yet, shifts the spots.
    assert np.abs(missed).max() < 3 * 4e-6
    assert capsys.readouterr().out == ""


@pytest.mark.slow
def test_settling_and_polarisation(tmp_path):
    started(tmp_path)
    code, report = calibrate("settling", tmp_path)
    truth = truth_of(time_constant=5e-3)
    assert code == 0 and report["found"]["time_constant"] == pytest.approx(truth.time_constant, rel=0.25)
    code, report = calibrate("polarisation", tmp_path)
    assert code == 0 and abs(report["found"]["angle"] - truth_of(polarisation=True).polarisation) < 1


DRIVER = """
from odak.instruments import SimulatedTable

tables = {}


class Panel:
    bits, settling_time = 8, 0.0

    def __init__(self, number):
        self.inner = tables.setdefault(number, SimulatedTable(number, shape=(40, 40), camera_shape=(80, 80))).modulator
        self.shape, self.pitch = self.inner.shape, self.inner.pitch

    def show(self, levels):
        self.inner.show(levels)


def sensor(number):
    return tables[number].camera
"""


def test_drivers_of_another_package_are_found_and_used(tmp_path, monkeypatch, capsys):
    """A package as it is installed: a module, and metadata that name its drivers."""
    (tmp_path / "rig_drivers.py").write_text(DRIVER)
    metadata = tmp_path / "rig_drivers-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rig-drivers\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[odak.instruments]\nrig-panel = rig_drivers:Panel\nrig-sensor = rig_drivers:sensor\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    panel = instruments.open_instrument("rig-panel", number=4)
    camera = instruments.open_instrument("rig-sensor", number=4)
    assert isinstance(panel, instruments.Modulator) and isinstance(camera, instruments.Camera)
    options = [f"--option={name}.number=4" for name in ("modulator", "camera")]
    arguments = ["calibrate", "exposure", "--modulator", "rig-panel", "--camera", "rig-sensor", *options]
    assert main([*arguments, "--output", str(tmp_path / "found")]) == 0
    report = json.loads((tmp_path / "found" / "report.json").read_text())
    assert report["found"]["exposure"] == camera.exposure != 1e-3
    lens = calibrating.lens_phase(panel, 532e-9, 20e-3)
    shown = instruments.Calibration.nominal(panel, camera, 532e-9, 20e-3).levels(lens)
    assert np.array_equal(sys.modules.pop("rig_drivers").tables[4]._levels, shown)
    # Values are printed with their units.
    assert f"exposure: {camera.exposure:.6g} s\n" in capsys.readouterr().out


def test_instruments_that_do_not_open_are_named(tmp_path, capsys):
    for arguments, message in (
        (["nothing"], "STEP must be one of exposure"),
        (["phase", "--modulator", "none", "--camera", "none"], "must be that of an installed driver"),
        (["phase", "--camera", "video"], "--modulator is simulated, so all other instruments must be"),
        (["phase", "--option", "nonsense"], "--option must be modulator|camera|polariser|simulated.NAME=VALUE"),
        (["phase", "--option", "simulated.shape=1"], "an instrument cannot be opened"),
        (["phase", "--option", "simulated.shpe=1"], "Did you mean 'shape'?"),
        (["phase", "--wavelength", "-3nm"], "--wavelength must be above 0 and at most 0.001 metres"),
        (["phase", "--wavelength", "532"], "--wavelength must be above 0 and at most 0.001 metres"),
        (["phase", "--distance", "20"], "--distance must be above 0 and at most 10 metres"),
        (["phase", "--results", "results.txt"], "--results must end in .npz or .h5"),
        (["phase", "--results", "/proc/none/results.npz"], "--results cannot be written to"),
        (["phase", "--wavelength", "green"], "--wavelength: 'green' is not a length"),
        (["phase", "--faults", "none"], "--faults must be some or all"),
    ):
        assert main(["calibrate", *arguments, "--output", str(tmp_path)]) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "calibration.npz").write_bytes(b"nothing")
    assert calibrate("exposure", tmp_path)[0] == 2
    assert "cannot be read as a calibration" in capsys.readouterr().err


def test_results_of_another_table_are_refused(tmp_path, capsys):
    table = instruments.SimulatedTable(3, shape=(20, 20), camera_shape=(80, 80))
    start = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 5e-3)
    instruments.save_calibration(tmp_path / "calibration.npz", start)
    assert calibrate("exposure", tmp_path)[0] == 2
    assert "belongs to another setup: it must have" in capsys.readouterr().err


@pytest.mark.slow
def test_all_steps_find_the_true_parameters(tmp_path):
    results = tmp_path / "a.npz"
    for step in ("phase", "registration", "wavefront", "distance", "illumination", "regions"):
        code = main(["calibrate", step, "--output", str(tmp_path), "--seed", "5", "--results", str(results), "--quiet"])
        assert code == 0 and (tmp_path / f"{step}.png").exists()
    found = instruments.load_calibration(results)
    assert found.regional_phases.shape == (3, 3, 256)
    truth = instruments.SimulatedTable(5).truth
    assert np.abs(found.phases - truth.phases).max() < 0.03
