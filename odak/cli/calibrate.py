"""Calibration of an optical table for `odak calibrate`: instruments by name, steps, results, pictures and a report."""

import dataclasses
import importlib.util
import inspect
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from odak import instruments
from odak._call_forms import did_you_mean
from odak._drawn import png
from odak._lengths import parse_length
from odak.cli import files
from odak.cli.job import is_length
from odak.cli.options import InputError, refusing
from odak.cli.report import about, collected_warnings
from odak.cli.settings import CalibrateSettings, InstrumentsSettings, TableSettings
from odak.instruments import Calibration, Lens
from odak.instruments.calibration import UNITS
from odak.instruments.exposures import set_exposure
from odak.instruments.focus import distance_with_uncertainty
from odak.instruments.illumination import illumination_with_uncertainty
from odak.instruments.mapping import ray_matrix
from odak.instruments.phase_response import phases_with_uncertainty, regions_with_uncertainty
from odak.instruments.protocols import checked_camera
from odak.instruments.registration import SPREAD
from odak.instruments.simulated import REALISTIC
from odak.instruments.spots import lens_phase, spots_phase
from odak.instruments.wavefronts import wavefront_with_uncertainty
from odak.tools.paths import write_file

SIMULATED, RESULTS = "simulated", "calibration"


class Table(NamedTuple):
    """Instruments of a table; None for those that it does not have."""

    modulator: Any
    camera: Any
    polariser: Any


class Found(NamedTuple):
    """What a step found: the calibration with it, values and units by name, and a function that draws it."""

    calibration: Calibration
    values: dict[str, tuple[Any, str]]
    draw: Callable[[Figure], None]


def parse_lens(text: str) -> Lens:
    """Return a lens from its focal length and what else is known of it: ``200mm,before=150mm,after=201mm,block=1mm``.

    Raises
    ------
    InputError
        If the text is none.
    """
    first, *others = text.split(",")
    given = [("focal_length", first), *((name.strip(), value) for name, _, value in (o.partition("=") for o in others))]
    names = [name for name, _ in given]
    told = (
        "--lens must be a focal length, such as 200mm, or one with distances and the radius of a block, such as "
        f"200mm,before=150mm,after=201mm,block=0.5mm; got {text!r}: "
    )
    with refusing(told, ValueError):
        if len(set(names)) < len(names) or not {*names} <= {"focal_length", "before", "after", "block"}:
            raise ValueError("what follows the focal length is before=, after= or block=, each once")
        if any(not is_length(value) for _, value in given):
            raise ValueError("lengths have a unit, such as 200mm")
        return Lens(**{name: parse_length(value) for name, value in given})


def faults_of(step: str, faults: str) -> dict[str, Any]:
    """Return the parameters of a simulated table: some of its faults or all, and the one that a step measures."""
    measured: dict[str, dict[str, Any]] = {
        "settling": {"time_constant": 5e-3},
        "polarisation": {"polarisation": True},
        "regions": {"regional": 0.05},
    }
    return {**(REALISTIC if faults == "all" else {}), **measured.get(step, {})}


def reach_of(job: TableSettings) -> float | Lens:
    """Return the distance of a table in metres, or its lens."""
    return job.distance if job.lens is None else parse_lens(job.lens)


def options_of(texts: Sequence[str], places: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the options of instruments by the instruments' names, from ``INSTRUMENT.NAME=VALUE``.

    Raises
    ------
    InputError
        If a text is none, or its instrument not among the places.
    """
    given: dict[str, dict[str, Any]] = {name: {} for name in places}
    for text in texts:
        key, equals, value = text.partition("=")
        place, dot, option = key.partition(".")
        if not equals or not dot or place not in given:
            raise InputError(f"--option must be {'|'.join(given)}.NAME=VALUE, got {text!r}")
        try:
            given[place][option] = json.loads(value)
        except json.JSONDecodeError:
            given[place][option] = value
    return given


def open_table(job: TableSettings, step: str) -> Table:
    """Return the instruments of a table; of a simulated one with the fault that a step measures.

    Parameters
    ----------
    job : TableSettings
        Settings of the table: entry points of drivers, "simulated" for a table of one's own, and their options,
        ``instrument.option=value``, with values as JSON or plain text.
    step : str
        What is measured.

    Returns
    -------
    Table
        The instruments.

    Raises
    ------
    InputError
        If an instrument cannot be opened.
    """
    names: dict[str, str | None] = {"modulator": job.modulator, "camera": job.camera}
    names |= {"polariser": job.polariser} if isinstance(job, CalibrateSettings) else {}
    given = options_of(job.option, (*names, SIMULATED))
    simulated = [name for name, entry in names.items() if entry == SIMULATED]
    with refusing("an instrument cannot be opened: ", ImportError, OSError, TypeError, ValueError):
        if simulated:
            if len(simulated) != len([entry for entry in names.values() if entry is not None]):
                raise InputError(f"--{simulated[0]} is simulated, so all other instruments must be simulated too")
            known = inspect.signature(instruments.SimulatedTable).parameters
            for option in given[SIMULATED]:
                if option not in known:
                    raise InputError(
                        f"--option: {SIMULATED} has no option {option!r}; it has {', '.join(known)}."
                        f"{did_you_mean(option, known)}"
                    )
            twin = {"wavelength": job.wavelength, "distance": reach_of(job), **faults_of(step, job.faults)}
            made = instruments.SimulatedTable(job.seed, **{**twin, **given[SIMULATED]})
            return Table(made.modulator, made.camera, made.polariser)
        opened = {
            name: None if entry is None else instruments.open_instrument(entry, **given[name])
            for name, entry in names.items()
        }
    return Table(opened["modulator"], opened["camera"], opened.get("polariser"))


@files.claiming
def run(job: CalibrateSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Calibrate a table by one step, and write its results, a picture and a report.

    What the file of the results holds, ``calibration.h5`` in the folder by default, is taken as known, and the step
    adds to it; where it does not exist, a file of the same name that ends in ``.npz``, as earlier versions wrote, is
    read instead.

    Parameters
    ----------
    job : CalibrateSettings
        Settings of the run.
    notices : Notices
        What to do about the picture of an earlier run of the step.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If the step is unknown, or an instrument or a file cannot be used.
    """
    step, results = job.step, job.results
    table, distance = open_table(job, step), reach_of(job)
    if step not in STEPS:
        raise InputError(f"STEP must be one of {', '.join(STEPS)}; got {step!r}.{did_you_mean(step, STEPS)}")
    with refusing("the camera cannot be used: ", TypeError, ValueError):
        table = table._replace(camera=checked_camera(table.camera))
    folder = files.writable_folder(job.output)
    path = folder / f"{RESULTS}.h5" if results is None else Path(results).expanduser()
    if path.suffix.lower() not in (".npz", ".h5", ".hdf5"):
        raise InputError(f"--results must end in .h5, or in .npz for results of earlier versions, got {str(path)!r}")
    earlier, path = path.with_suffix(".npz"), path.with_suffix(".h5") if path.suffix.lower() == ".npz" else path
    if importlib.util.find_spec("h5py") is None:
        # Before anything is measured.
        raise InputError("results are HDF5 files, which need h5py: pip install h5py")
    # Steps add to the results: nobody else may write between reading and writing.
    files.claim(folder)
    files.claim(files.writable_folder(path.parent, "--results"), "--results")
    known = known_table(table, path if path.exists() or not earlier.exists() else earlier, job.wavelength, distance)
    # What a second run of the same step replaces.
    files.announce(folder, [f"{step}.png"], notices)
    with collected_warnings() as texts, refusing(f"the step {step} failed: ", RuntimeError, TypeError, ValueError):
        found = STEPS[step](table, known)
    instruments.save_calibration(path, found.calibration)
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    found.draw(figure)
    write_file(folder / f"{step}.png", png(figure, 110))
    report = {
        "step": step,
        "found": {name: value for name, (value, _) in found.values.items()},
        "units": {name: unit for name, (_, unit) in found.values.items()},
        "results": str(path),
        "figure": f"{step}.png",
        "warnings": texts,
        **about("calibrate"),
    }
    files.write_json(folder / files.REPORT, report)
    return report


def known_table(
    table: Table, path: Path, wavelength: float, distance: float | Lens, option: str = "--results"
) -> Calibration:
    """Return the calibration in a file, and the nominal properties of a table where there is no such file.

    Parameters
    ----------
    table : Table
        The instruments.
    path : Path
        File of the results.
    wavelength : float
        Of the light in metres.
    distance : float or Lens
        From the modulator to the camera in metres, or the lens between them.
    option : str
        Name of the file in messages.

    Raises
    ------
    InputError
        If it cannot be read, or belongs to another modulator, wavelength or lens.
    """
    if not path.exists():
        return Calibration.nominal(table.modulator, table.camera, wavelength, distance)
    with refusing(f"{option}: ", ImportError, ValueError):
        known = instruments.load_calibration(path)
    if known.amplitude.shape != tuple(table.modulator.shape) or known.wavelength != wavelength:
        raise InputError(
            f"{option} {str(path)!r} belongs to another setup: it must have {list(table.modulator.shape)} pixels "
            f"at {wavelength:g} m, got {list(known.amplitude.shape)} at {known.wavelength:g} m"
        )
    # A distance is measured, and so may differ; a lens is not.
    lenses = [path if isinstance(path, Lens) else None for path in (known.distance, distance)]
    if lenses[0] != lenses[1]:
        raise InputError(
            f"{option} {str(path)!r} belongs to another setup: --lens must be the lens of the file, {lenses[0]}, got "
            f"{lenses[1]}"
        )
    return known


def _doubts(uncertainty: dict[str, float]) -> dict[str, tuple[float, str]]:
    return {f"uncertainty_{name}": (value, UNITS[f"uncertainty_{name}"]) for name, value in uncertainty.items()}


def _added(
    known: Calibration,
    values: dict[str, tuple[Any, str]],
    draw: Callable[[Figure], None],
    uncertainty: float,
    **result: Any,
) -> Found:
    """Return what a step found: a calibration with its one result, and values of the report with its uncertainty."""
    (name,) = result
    found = dataclasses.replace(known, **result, uncertainty={**known.uncertainty, name: uncertainty})
    return Found(found, {**values, **_doubts({name: uncertainty})}, draw)


def _phase(table: Table, known: Calibration) -> Found:
    phases, doubt, _ = phases_with_uncertainty(known.table(table.modulator, table.camera))
    line = np.linspace(phases[0], phases[-1], len(phases))
    values = {
        "phase_range": (float(phases[-1] - phases[0]), "rad"),
        "largest_departure_from_a_line": (float(np.abs(phases - line).max()), "rad"),
    }
    return _added(known, values, lambda figure: _curves(figure, phases), doubt, phases=phases)


def _regions(table: Table, known: Calibration) -> Found:
    tables, doubts = regions_with_uncertainty(known.table(table.modulator, table.camera))
    curves, values = tables.reshape(-1, tables.shape[-1]), {"phase_ranges": (tables[..., -1].tolist(), "rad")}
    doubt = float(doubts.max())
    return _added(known, values, lambda figure: _curves(figure, *curves), doubt, regional_phases=tables)


def _registration(table: Table, known: Calibration) -> Found:
    middle = not known.wavefront.any()
    mapping = instruments.register_camera(known.table(table.modulator, table.camera), middle=middle)
    # The grid of spots, as register_camera places it.
    seen = table.camera if isinstance(known.distance, Lens) else table.modulator
    farthest = known.wavelength * abs(ray_matrix(known.distance)[1]) / (2 * table.modulator.pitch)
    half = np.minimum(0.375 * np.array(seen.shape[::-1]) * seen.pitch, (SPREAD if middle else 0.8) * farthest)
    axes = [np.linspace(-h, h, 6) for h in half]
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    frame = table.camera.capture(2).mean(0)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.imshow(np.sqrt(np.clip(frame, 0, None)), cmap="gray")
        places = mapping.camera_pixels(points)
        axis.scatter(places[:, 0], places[:, 1], s=60, facecolors="none", edgecolors="tab:orange", linewidths=0.8)
        axis.set(xlabel="camera column", ylabel="camera row", title="Spots, and where the mapping expects them")

    values = {
        "residual_pixels": (mapping.residual, "pixels"),
        "distortion": (mapping.distortion, "1/(half diagonal)²"),
    }
    return _added(known, values, draw, mapping.uncertainty, registration=mapping)


def _wavefront(table: Table, known: Calibration) -> Found:
    wavefront, doubt = wavefront_with_uncertainty(known.table(table.modulator, table.camera))
    waves = wavefront / (2 * np.pi)
    values = {"wavefront_rms_waves": (float(waves.std()), "wavelengths")}
    return _added(known, values, _map(waves, known.pitch, "aberration (wavelengths)"), doubt, wavefront=wavefront)


def _distance(table: Table, known: Calibration) -> Found:
    distance, doubt = distance_with_uncertainty(known.table(table.modulator, table.camera))
    spot = _spot(table, known, dataclasses.replace(known, distance=distance))
    return _added(known, {"distance": (distance, "m")}, spot, doubt, distance=distance)


def _illumination(table: Table, known: Calibration) -> Found:
    amplitude, doubt = illumination_with_uncertainty(known.table(table.modulator, table.camera))
    values = {"illumination_min": (float(amplitude.min()), "of the largest amplitude")}
    drawn = _map(amplitude, known.pitch, "amplitude of the illumination")
    return _added(known, values, drawn, doubt, amplitude=amplitude)


def _exposure(table: Table, known: Calibration) -> Found:
    phase = lens_phase(table.modulator, known.wavelength, known.distance)
    table.modulator.show(known.levels(phase))
    exposure = set_exposure(table.camera)
    frame = table.camera.capture(1)[0]

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.hist(frame.ravel(), bins=100, log=True, color="tab:blue")
        axis.set(xlabel="counts", ylabel="pixels", title=f"Counts of a spot at {exposure:.3g} s")

    top = (1 << table.camera.bits) - 1
    share = float(frame.max() / top)
    return Found(known, {"exposure": (exposure, "s"), "brightest_share": (share, "of the range")}, draw)


def _settling(table: Table, known: Calibration) -> Found:
    before = table.modulator.settling_time
    longest = None if before > 0 else 0.2
    result = instruments.measure_settling(table.modulator, table.camera, known.phases, longest=longest)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.plot(1e3 * result.delays, result.phase, "o-")
        axis.axvline(1e3 * result.settling_time, color="tab:orange", label="settled to 0.02 rad")
        axis.set(xlabel="delay (ms)", ylabel="phase (rad)")
        axis.legend()

    names = ("time_constant", "settling_time", "uncertainty")
    return Found(known, {name: (float(getattr(result, name)), "s") for name in names}, draw)


def _polarisation(table: Table, known: Calibration) -> Found:
    if table.polariser is None:
        raise InputError("--polariser must be given for the step polarisation")
    levels = known.levels(lens_phase(table.modulator, known.wavelength, known.distance))
    result = instruments.measure_polarisation(table.modulator, table.camera, table.polariser, levels)

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.plot(result.angles, result.brightness, "o")
        axis.axvline(result.angle % 180, color="tab:orange", label="most light modulated")
        axis.set(xlabel="angle of the polariser (degrees)", ylabel="brightness of the spot (counts)")
        axis.legend()

    contrast = float(result.contrast) if np.isfinite(result.contrast) else None
    values = {
        "angle": (float(result.angle), "degrees"),
        "uncertainty": (float(result.uncertainty), "degrees"),
        "contrast": (contrast, ": 1"),
    }
    return Found(known, values, draw)


def _all(table: Table, known: Calibration) -> Found:
    found = instruments.calibrate_table(known.table(table.modulator, table.camera))

    def draw(figure: Figure) -> None:
        left, middle, right = figure.subplots(1, 3)
        left.plot(found.phases)
        left.set(xlabel="level", ylabel="phase (rad)")
        _draw_map(middle, found.wavefront / (2 * np.pi), found.pitch, "aberration (wavelengths)")
        _draw_map(right, found.amplitude, found.pitch, "amplitude")

    values = {
        "residual_pixels": (found.registration.residual, "pixels"),
        **({"distance": (found.distance, "m")} if isinstance(found.distance, (int, float)) else {}),
        "wavefront_rms_waves": (float(found.wavefront.std() / (2 * np.pi)), "wavelengths"),
        "illumination_min": (float(found.amplitude.min()), "of the largest amplitude"),
        "phase_range": (float(found.phases[-1]), "rad"),
        **_doubts(found.uncertainty),
    }
    return Found(found, values, draw)


STEPS: dict[str, Callable[[Table, Calibration], Found]] = {
    "exposure": _exposure,
    "settling": _settling,
    "polarisation": _polarisation,
    "phase": _phase,
    "registration": _registration,
    "wavefront": _wavefront,
    "distance": _distance,
    "illumination": _illumination,
    "regions": _regions,
    "all": _all,
}


def _curves(figure: Figure, *tables: np.ndarray) -> None:
    axis = figure.subplots()
    for phases in tables:
        axis.plot(phases)
    axis.axhline(2 * np.pi, color="grey", linewidth=0.8, linestyle=":")
    axis.set(xlabel="level", ylabel="phase (rad)", title="Phase of each level" + " of each region" * (len(tables) > 1))


def _map(values: np.ndarray, pitch: float, label: str) -> Callable[[Figure], None]:
    return lambda figure: _draw_map(figure.subplots(), values, pitch, label)


def _draw_map(axis: Any, values: np.ndarray, pitch: float, label: str) -> None:
    rows, columns = values.shape
    extent = 1e3 * pitch / 2 * np.array([-columns, columns, rows, -rows])
    drawn = axis.imshow(values, extent=extent)
    axis.set(xlabel="x (mm)", ylabel="y (mm)")
    axis.figure.colorbar(drawn, ax=axis, label=label, shrink=0.9)


def _spot(table: Table, before: Calibration, after: Calibration) -> Callable[[Figure], None]:
    """Return a function that draws captures of spots with the distance before and after."""
    reach = 0.15 * min(table.modulator.shape) * table.modulator.pitch
    points = np.array([[-reach, 0.0], [reach, 0.0], [0.0, reach]])
    frames = []
    for number, calibration in enumerate((after, before)):
        phase = spots_phase(table.modulator, calibration.wavelength, calibration.distance, points)
        table.modulator.show(calibration.levels(phase))
        if number == 0:
            set_exposure(table.camera)
        frames.append(table.camera.capture(2).mean(0))

    def draw(figure: Figure) -> None:
        for axis, frame, name in zip(figure.subplots(1, 2), frames[::-1], ("before", "after"), strict=True):
            axis.imshow(frame, cmap="gray", vmin=0, vmax=frames[0].max())
            axis.set(xlabel="camera column", ylabel="camera row", title=f"Three spots {name}")

    return draw


@files.claiming
def check_driver(job: InstrumentsSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Test a driver, and write a report.

    Parameters
    ----------
    job : InstrumentsSettings
        Settings of the run.
    notices : Notices
        What to do about the report of an earlier run.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If an instrument cannot be opened, or is neither a camera nor a modulator.
    """
    folder = files.writable_folder(job.output)
    files.claim(folder)
    files.announce(folder, [files.REPORT], notices)
    given = options_of(job.option, ("driver", "beside"))
    opened: list[Any] = []
    try:
        with refusing("an instrument cannot be opened: ", ImportError, OSError, TypeError, ValueError):
            if job.driver == SIMULATED:
                table = instruments.SimulatedTable(**{"seed": 0, **given["driver"]})
                opened = [table.camera, table.modulator]
            else:
                opened.append(instruments.open_instrument(job.driver, **given["driver"]))
                if job.beside is not None:
                    opened.append(instruments.open_instrument(job.beside, **given["beside"]))
        cameras = [one for one in opened if isinstance(one, instruments.Camera)]
        modulators = [one for one in opened if isinstance(one, instruments.SLMDriver)]
        if len(cameras) > 1 or len(modulators) > 1 or not cameras + modulators:
            raise InputError("DRIVER and --beside must be a camera, a modulator, or one of each")
        with collected_warnings() as texts:
            camera, modulator = next(iter(cameras), None), next(iter(modulators), None)
            found = instruments.check_instruments(camera, modulator, captures=job.captures)
    finally:
        for one in opened:
            getattr(one, "close", lambda: None)()
    report = {
        "driver": job.driver,
        "beside": job.beside,
        "options": list(job.option),
        "passed": all(finding.passed is not False for finding in found),
        "checks": [dataclasses.asdict(finding) for finding in found],
        "warnings": texts,
        **about("instruments"),
    }
    files.write_json(folder / files.REPORT, report)
    return report
