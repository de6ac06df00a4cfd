"""The command `odak calibrate` on simulated tables and on drivers of the package."""

import dataclasses
import json
import sys

import numpy as np
import pytest
import torch
from laboratory import Altered, Laboratory
from PIL import Image
from scipy.ndimage import map_coordinates

from odak import instruments
from odak.cli import calibrate as calibrate_command
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


def install(module, folder, monkeypatch):
    """Put a package of drivers where it is found as if it were installed: a module, and metadata that name them."""
    (folder / "rig_drivers.py").write_text(module)
    metadata = folder / "rig_drivers-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: rig-drivers\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        "[odak.instruments]\nrig-panel = rig_drivers:Panel\nrig-sensor = rig_drivers:sensor\n"
    )
    monkeypatch.syspath_prepend(str(folder))


def test_drivers_of_another_package_are_found_and_used(tmp_path, monkeypatch, capsys):
    install(DRIVER, tmp_path, monkeypatch)
    panel = instruments.open_instrument("rig-panel", number=4)
    camera = instruments.open_instrument("rig-sensor", number=4)
    assert isinstance(panel, instruments.SLMDriver) and isinstance(camera, instruments.Camera)
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
        (["phase", "--modulator", "none", "--camera", "none"], "must be one of the installed drivers"),
        (["phase", "--camera", "video"], "--modulator is simulated, so all other instruments must be"),
        (["phase", "--option", "nonsense"], "--option must be modulator|camera|polariser|simulated.NAME=VALUE"),
        (["phase", "--option", "simulated.shape=1"], "an instrument cannot be opened"),
        (["phase", "--option", "simulated.shpe=1"], "Did you mean 'shape'?"),
        (["phase", "--wavelength", "-3nm"], "--wavelength must be above 0 and at most 0.001 metres"),
        (["phase", "--wavelength", "532"], "--wavelength must be above 0 and at most 0.001 metres"),
        (["phase", "--distance", "20"], "--distance must be above 0 and at most 10 metres"),
        (["phase", "--results", "results.txt"], "--results must end in .h5"),
        (["phase", "--results", "/proc/none/results.npz"], "--results cannot be written to"),
        (["phase", "--wavelength", "green"], "'--wavelength': 'green' is not a length"),
        (["phase", "--faults", "none"], "--faults must be one of 'some', 'all'"),
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
    options = [
        "--calibration",
        str(tmp_path / "table.h5"),
        "--iterations",
        "30",
        "--device",
        "cpu",
        "--quiet",
        "--linear",
    ]
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
        (["--calibration", table, "--wavelength", "633nm"], "--wavelength must agree with --calibration"),
        (["--calibration", table, "--resolution", "64", "64"], "--resolution must agree with --calibration"),
        (["--calibration", table, "--preset", "holoeye-leto-3"], "--preset has no effect with --calibration"),
        (["--calibration", table, "--slm-range", "6"], "--calibration and --slm-range all state"),
        (["--slm-range", "6"], "--slm-range states the response at one wavelength"),
        (["--wavelength", "532nm", "--slm-range", "nan"], "--slm-range must be above 0"),
        (lut, "could not convert string 'x' to float64 at row 1"),
        ([*lut[:3], "nothing.txt"], "nothing.txt'"),
    ):
        assert main(["hologram", "photo", "--output", str(tmp_path / "out"), *arguments]) == 2, arguments
        assert message in capsys.readouterr().err
    text.write_text("0\n1\n2\n")
    assert main(["hologram", "photo", "--output", str(tmp_path / "out"), *lut]) == 2
    assert "must have 256 levels for --bits 8, got 3" in capsys.readouterr().err


@pytest.mark.usefixtures("sheets")
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


LENS = ["--lens", "20mm"]


def behind_a_lens(folder, panel=(40, 40), block=3e-5):
    """Write the calibration of an independent table with a lens, true in all its values; return the table."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in panel), indexing="ij")
    beam, phases = np.exp(-(x**2) - 0.5 * y**2), 6.4 * (np.arange(256) / 255) ** 1.3
    point = 532e-9 * 20e-3 / (8e-6 * panel[1])
    options = {"fill": 0.9, "camera_shape": panel, "camera_pitch": point, "phases": phases, "amplitude": beam}
    table = Laboratory(panel, focal_length=20e-3, wavefront=2 * x * y + x, **options)
    lens = instruments.Lens(20e-3, block=block)
    found = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, lens)
    found = dataclasses.replace(found, phases=phases, wavefront=table.wavefront, amplitude=beam / beam.max())
    instruments.save_calibration(folder / "lens.h5", found)
    return table


def holograms(folder, *more):
    arguments = ["hologram", "chart", "--calibration", str(folder / "lens.h5"), "--device", "cpu", "--quiet", "--again"]
    arguments += ["--linear"]
    return main([*arguments, "--output", str(folder / "out"), *more])


def test_a_hologram_behind_a_lens_is_that_which_the_table_shows(tmp_path):
    """The report's picture, from the saved pattern, is the light on an independent table."""
    table = behind_a_lens(tmp_path)
    assert holograms(tmp_path, "--iterations", "40") == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["psnr_db"] > 20 and report["warnings"] == []
    assert report["verification"]["lens"] == {"focal_length": 0.02, "before": 0.02, "after": 0.02, "block": 3e-5}
    table.modulator.show(np.asarray(Image.open(tmp_path / "out" / "hologram_532nm.png")).astype(int))
    light = table.light(0, 0, 40, 40) / np.mean(np.abs(table.illumination) ** 2)
    rows, columns = (slice(*report["picture"][name]) for name in ("rows", "columns"))
    seen = np.asarray(Image.open(tmp_path / "out" / "reconstruction.png"))[rows, columns] / 255
    # The light of the gaps, which no pattern changes, is on the axis.
    away = (np.hypot(*(np.indices((40, 40)) - 20)) > 4)[rows, columns]
    light = light[rows, columns]
    light = (light * (light * seen)[away].sum() / (light**2)[away].sum()).clip(0, 1)
    # A pixel of the camera is the mean of four points there, and its light that of an area here.
    assert np.sqrt(np.mean((light - seen)[away] ** 2)) < 0.012
    assert np.corrcoef(light[away], seen[away])[0, 1] > 0.999


def test_pictures_behind_a_lens_are_undistorted_misuse_is_named(tmp_path, capsys):
    behind_a_lens(tmp_path, (40, 60), 0.0)
    assert holograms(tmp_path, "--iterations", "3", "--resolution", "40", "60") == 0
    assert "forms a bright spot in the middle of the picture" in capsys.readouterr().err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    # The points of the rows are farther apart than those of the columns: as many rows as columns are square.
    down, across = report["verification"]["picture_pitch"]
    assert down / across == pytest.approx(60 / 40)
    height, width = (np.diff(report["picture"][name])[0] for name in ("rows", "columns"))
    with Image.open(report["picture"]["file"]) as file:
        assert height * down / (width * across) == pytest.approx(file.height / file.width, rel=1 / 20)
    for more, message in (
        (["--distance", "20mm"], "--distance has no effect with --calibration"),
        (["--method", "gs"], "--method gs cannot be used with --calibration of a table with a lens"),
        (["--fill-factor", "0"], "--fill-factor 0 cannot be used"),
        (["--grating"], "--grating cannot be used"),
        (["--propagation-type", "Angular Spectrum"], "--propagation-type Angular Spectrum cannot be used"),
    ):
        assert holograms(tmp_path, *more) == 2, more
        assert message in capsys.readouterr().err


def test_lenses_of_the_command_line(tmp_path, capsys):
    lens = calibrate_command.parse_lens("200mm,before=150mm,after=0.201m,block=1mm")
    assert lens == instruments.Lens(0.2, 0.15, 0.201, 1e-3)
    assert calibrate_command.parse_lens("0.2m") == instruments.Lens(0.2)
    behind_a_lens(tmp_path)
    size = ["--option", "simulated.shape=[40,40]", "--option", "simulated.camera_shape=[40,40]"]
    known_file = ["--results", str(tmp_path / "lens.h5")]
    for arguments, message in (
        (["phase", "--lens", "200"], "lengths have a unit"),
        (["phase", "--lens", "200mm,focus=1mm"], "--lens must be a focal length"),
        (["phase", "--lens", "200mm,after=2mm,after=3mm"], "each once"),
        (["phase", "--lens", "100mm,before=200mm,after=200mm"], "must not image the modulator"),
        (["phase", *LENS, "--distance", "20mm"], "--distance has no effect with --lens"),
        (["distance", *LENS, *size], "behind a lens measure_wavefront finds the defocus"),
        (["exposure", *size, *known_file], "--lens must be the lens of the file, Lens(focal_length=0.02"),
    ):
        assert main(["calibrate", *arguments, "--output", str(tmp_path / "found")]) == 2, arguments
        assert message in capsys.readouterr().err, arguments


INDEPENDENT = """
import numpy as np
from laboratory import Laboratory

y, x = np.meshgrid(*2 * [np.arange(-48, 48) / 48], indexing="ij")
level = np.arange(256) / 255
table = Laboratory(
    (96, 96), focal_length=20e-3, wavefront=0.7 * x * y + 0.5 * x**3 + 0.4 * y**2, fill=0.9, camera_pitch=4e-6,
    camera_shape=(340, 360), phases=2 * np.pi * (level**1.2 + 0.03 * np.sin(2 * np.pi * level)), offset=(3e-5, -2e-5),
    signs=(-1, 1), amplitude=np.exp(-((x - 0.2) ** 2 + (y + 0.1) ** 2) / 2),
)


def Panel():
    return table.modulator


def sensor():
    return table.camera
"""


@pytest.mark.slow
def test_from_independent_table_with_lens_to_hologram_on_it(tmp_path, monkeypatch):
    """Each step by the command line: its calibration, a hologram for it, a capture of this beside the prediction."""
    install(INDEPENDENT, tmp_path, monkeypatch)
    table = ["--modulator", "rig-panel", "--camera", "rig-sensor", *LENS, "--quiet"]
    assert main(["calibrate", "all", *table, "--output", str(tmp_path)]) == 0
    found = tmp_path / "calibration.h5"
    found.rename(tmp_path / "lens.h5")
    assert holograms(tmp_path, "--iterations", "60", "--fill-factor", "0.9") == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["psnr_db"] > 25
    table += ["--calibration", str(tmp_path / "lens.h5"), "--output", str(tmp_path / "seen")]
    assert main(["capture", str(tmp_path / "out"), *table]) == 0
    (result,) = json.loads((tmp_path / "seen" / "report.json").read_text())["patterns"]
    # The zero order, which the prediction does not contain, is a quarter of the light.
    assert result["correlation"] > 0.8
    frame = instruments.load_captures(tmp_path / "seen" / "captures.h5").frames[0].mean(0).astype(float)
    rig = sys.modules.pop("rig_drivers").table
    # The mean over the areas of the picture's points, by the measured mapping.
    rows, columns = (np.arange(*report["picture"][name]) for name in ("rows", "columns"))
    pitch = report["verification"]["picture_pitch"][0]
    inner = (np.arange(6) + 0.5) / 6 - 0.5
    y, x = (pitch * (np.add.outer(n - 48, inner)).ravel() for n in (rows, columns))
    places = instruments.load_calibration(tmp_path / "lens.h5").registration.camera_pixels(
        np.stack(np.meshgrid(x, y), axis=-1)
    )
    inside = ((places > 1) & (places < np.array(rig.camera.shape[::-1]) - 2)).all(-1)
    light = map_coordinates(frame, places.transpose(2, 0, 1)[::-1], order=3)
    light, inside = (v.reshape(len(rows), 6, len(columns), 6).mean((1, 3)) for v in (light, inside * 1.0))
    seen = np.asarray(Image.open(tmp_path / "out" / "reconstruction.png"))[np.ix_(rows, columns)] / 255
    away = (np.hypot(*np.meshgrid(rows - 48, columns - 48, indexing="ij")) > 6) & (inside == 1)
    assert np.corrcoef(light[away], seen[away])[0, 1] > 0.995


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


def test_a_driver_is_tested_and_the_report_tells(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = [f"--option=driver.{text}" for text in ("shape=[32,32]", "distance=4e-3", "camera_shape=[48,60]")]
    assert main(["instruments", "test", "simulated", "--captures", "10", *small]) == 0
    assert "passed  gamma" in capsys.readouterr().out
    report = json.loads((tmp_path / "instruments" / "report.json").read_text())
    assert report["passed"] and {check["passed"] for check in report["checks"]} == {True}
    table = instruments.SimulatedTable(1, shape=(32, 32), distance=4e-3, camera_shape=(48, 60))
    curved = Altered(table.camera, lambda frames, _: np.rint(4095 * (frames / 4095) ** 0.6).astype(np.uint16))
    monkeypatch.setattr(instruments, "open_instrument", lambda *_, **__: curved)
    assert main(["instruments", "test", "curved", "--captures", "10", "--again"]) == 1
    assert "remedy: " in capsys.readouterr().out
    assert not json.loads((tmp_path / "instruments" / "report.json").read_text())["passed"]
    monkeypatch.undo()
    assert main(["instruments", "test", "no-such-driver", "-o", str(tmp_path / "other")]) == 2
