"""The command `odak calibrate` on simulated tables and on drivers of the package."""

import dataclasses
import json
import sys

import numpy as np
import pytest
import torch
from PIL import Image

from odak import instruments
from odak.cli import files, main
from odak.cli.job import Job
from odak.instruments import spots

pytest.importorskip("h5py", reason="h5py is not installed")

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
    found = instruments.load_calibration(tmp_path / "calibration.h5")
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
    lens = spots.lens_phase(panel, 532e-9, 20e-3)
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
        (["phase", "--results", "results.txt"], "--results must end in .h5"),
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


def measured(folder, levels=256):
    """Write a calibration with a bent response of regions, an aberration and uneven light; return it."""
    table = instruments.SimulatedTable(3, shape=(40, 40), camera_shape=(80, 80), distance=5e-3)
    found = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 5e-3)
    y, x = np.mgrid[-1:1:40j, -1:1:40j]
    phases = 6.4 * (np.arange(levels) / (levels - 1)) ** 1.3
    found = dataclasses.replace(
        found,
        phases=phases,
        regional_phases=phases * np.array([[1.0, 1.02], [0.98, 1.05]])[..., None],
        wavefront=2 * x * y,
        amplitude=np.exp(-(x**2) - y**2),
    )
    instruments.save_calibration(folder / "table.h5", found)
    return found


def test_a_hologram_is_that_of_the_calibrated_table(tmp_path):
    known, out = measured(tmp_path), tmp_path / "out"
    options = ["--calibration", str(tmp_path / "table.h5"), "--iterations", "30", "--device", "cpu", "--quiet"]
    options += ["--fill-factor", "0"]  # the reference below propagates points
    assert main(["hologram", "photo", *options, "--output", str(out)]) == 0
    report = json.loads((out / "report.json").read_text())
    stated = report["parameters"]
    assert (stated["resolution"], stated["wavelengths"], stated["distance"]) == ([40, 40], [532e-9], 5e-3)
    levels = np.asarray(Image.open(out / "hologram_532nm.png")).astype(int)
    # What the modulator shows by an independent interpolation: regions of 2 x 2 are bilinear between their middles.
    row = ((np.arange(40) + 0.5) / 20 - 0.5)[:, None]
    column = ((np.arange(40) + 0.5) / 20 - 0.5)[None]
    gain = (1 - row) * ((1 - column) + 1.02 * column) + row * (0.98 * (1 - column) + 1.05 * column)
    field = known.amplitude * np.exp(1j * (gain * known.phases[levels] + known.wavefront))
    padded = np.zeros((320, 320), complex)
    padded[140:180, 140:180] = field / np.sqrt(np.mean(known.amplitude**2))
    frequency = np.fft.fftfreq(320, 8e-6)
    axial = np.sqrt(1 / 532e-9**2 - frequency[:, None] ** 2 - frequency**2)
    image = np.abs(np.fft.ifft2(np.fft.fft2(padded) * np.exp(2j * np.pi * 5e-3 * axial)))[140:180, 140:180] ** 2
    rows, columns = (slice(*report["picture"][name]) for name in ("rows", "columns"))
    seen = np.asarray(Image.open(out / "reconstruction.png"))[rows, columns] / 255
    expected = (report["channels"][0]["scale"] * image)[rows, columns].clip(0, 1)
    assert np.abs(seen - expected).max() < 0.006
    assert report["psnr_db"] > 20


def test_levels_by_range_and_table_are_the_nearest(tmp_path):
    phase = torch.linspace(0, 2 * np.pi, 500, dtype=torch.float64)[None]
    hologram = torch.polar(torch.ones_like(phase), phase)
    for bits in (3, 8):
        bent = 7 * (np.arange(1 << bits) / ((1 << bits) - 1)) ** 1.5
        text = "\n".join(f"{level}, {value:.9f}" for level, value in list(enumerate(bent))[::-1])
        (tmp_path / "lut.txt").write_text(f"# level, phase\n{text}\n")
        for options, phases in (
            ({"slm_range": 4.0}, np.arange(1 << bits) * 4 / (1 << bits)),
            ({"lut": str(tmp_path / "lut.txt")}, bent),
        ):
            files._response.cache_clear()
            job = Job(wavelengths=(532e-9,), bits=bits, **options)
            response = files.response_of(job)
            assert np.allclose(response.phases, phases)
            levels = files.quantise(hologram, bits, response)[0].numpy()
            apart = np.abs(np.angle(np.exp(1j * (phases - phase.numpy()[0][:, None]))))
            chosen = apart[np.arange(500), levels]
            assert np.allclose(chosen, apart.min(1), atol=1e-8)
            path = tmp_path / "pattern.png"
            files.save_pattern(path, torch.from_numpy(levels)[None], bits)
            assert np.allclose(files.load_pattern(path, bits, response)[0].numpy(), phases[levels])


def test_responses_that_cannot_be_used_are_named(tmp_path, capsys):
    measured(tmp_path)
    text = tmp_path / "lut.txt"
    text.write_text("0.0\nx\n")
    table, lut = str(tmp_path / "table.h5"), ["--wavelength", "532nm", "--lut", str(text)]
    for arguments, message in (
        (["--calibration", "none.h5"], "--calibration: there is no file"),
        (["--calibration", table, "--wavelength", "633nm"], "--wavelength must be that of --calibration"),
        (["--calibration", table, "--resolution", "64", "64"], "--resolution must be that of --calibration"),
        (["--calibration", table, "--preset", "holoeye-leto-3"], "--preset has no effect with --calibration"),
        (["--calibration", table, "--slm-range", "6"], "--calibration and --slm-range all state"),
        (["--slm-range", "6"], "--slm-range states the response at one wavelength"),
        (["--wavelength", "532nm", "--slm-range", "nan"], "--slm-range must be above 0"),
        (lut, "line 2 must be the phase in radians of one level of 0 to 255"),
        ([*lut[:3], "nothing.txt"], "nothing.txt' cannot be read"),
    ):
        assert main(["hologram", "photo", "--output", str(tmp_path / "out"), *arguments]) == 2, arguments
        assert message in capsys.readouterr().err
    text.write_text("0\n1\n2\n")
    assert main(["hologram", "photo", "--output", str(tmp_path / "out"), *lut]) == 2
    assert "must have 256 levels for --bits 8, but level 3 is missing" in capsys.readouterr().err


def test_captures_stand_beside_their_prediction(tmp_path, capsys):
    """The true values of a table predict its captures to the noise and the light of other orders."""
    options = {"shape": (40, 40), "camera_shape": (80, 80), "distance": 5e-3, "reflection": 0.0}
    table = instruments.SimulatedTable(3, **options)
    pixels = np.random.default_rng(0).uniform(0, 80, (60, 2))
    truth = table.truth
    nominal = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 5e-3)
    known = dataclasses.replace(
        nominal,
        phases=truth.phases,
        amplitude=truth.amplitude / truth.amplitude.max(),
        wavefront=truth.wavefront,
        distance=truth.distance,
        registration=instruments.Registration(truth.homography, truth.distortion, (80, 80)),
    )
    assert np.allclose(known.registration.plane_points(pixels), truth.plane_points(pixels, (80, 80)))
    instruments.save_calibration(tmp_path / "table.h5", known)
    level = known.levels(spots.lens_phase(table.modulator, 532e-9, 4e-3) + np.pi * (np.indices((40, 40))[0] > 17))
    Image.fromarray(level.astype(np.uint8)).save(tmp_path / "pattern.png")
    arguments = ["capture", str(tmp_path / "pattern.png"), "--seed", "3", *SMALL, "--option", "simulated.reflection=0"]
    correlations = []
    for more in (["--calibration", str(tmp_path / "table.h5")], []):
        assert main([*arguments, *more, "--output", str(tmp_path / "out"), "--again"]) == 0
        (result,) = json.loads((tmp_path / "out" / "report.json").read_text())["patterns"]
        correlations.append(result["correlation"])
        assert (tmp_path / "out" / "capture_pattern.png").stat().st_size > 3000
    # Pixels that emit as points reach 0.966.
    assert correlations[0] > 0.97 > 0.9 > correlations[1]
    found = instruments.load_captures(tmp_path / "out" / "captures.h5")
    assert np.array_equal(found.levels[0], level) and found.frames.shape == (1, 4, 80, 80)
    assert "correlation with the prediction" in capsys.readouterr().out
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(tmp_path / "small.png")
    for name, message in (
        ("none.png", "PATTERN not found"),
        ("small.png", "must have the 40 x 40 pixels"),
        (".", "without"),
    ):
        assert main(["capture", str(tmp_path / name), *SMALL, "--output", str(tmp_path / "out")]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.slow
def test_all_steps_find_the_true_parameters(tmp_path):
    results = tmp_path / "a.h5"
    for step in ("phase", "registration", "wavefront", "distance", "illumination", "regions"):
        code = main(["calibrate", step, "--output", str(tmp_path), "--seed", "5", "--results", str(results), "--quiet"])
        assert code == 0 and (tmp_path / f"{step}.png").exists()
    found = instruments.load_calibration(results)
    assert found.regional_phases.shape == (3, 3, 256)
    truth = instruments.SimulatedTable(5).truth
    assert np.abs(found.phases - truth.phases).max() < 0.03
