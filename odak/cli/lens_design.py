"""Design of lenses for `odak design`: from a starting lens by least squares, or from flat plates by a curriculum."""

import copy
import math
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import torch
from tqdm import tqdm

from odak._drawn import png
from odak._warnings import ArgumentWarning, warn
from odak.cli import files
from odak.cli.options import InputError, option_name, refusing
from odak.cli.report import about, finite, versions
from odak.cli.settings import LENS_LENGTHS, DesignSettings
from odak.cli.trace import read_glasses, read_system
from odak.learn.raytracing import system as lenses
from odak.learn.raytracing.system.automatic import STANDARD_LIMITS, standard_limits
from odak.learn.raytracing.system.operands import View, clear_heights, edge_thicknesses
from odak.learn.raytracing.system.sketches import field_label
from odak.learn.raytracing.system.surfaces import is_break
from odak.learn.raytracing.system.system_files import MICROMETRES
from odak.tools.paths import write_file

CROWN, FLINT = "N-LAK33B", "SF5"
# Materials for a number of elements: flints next to the stop, as in the triplet and the double Gauss.
LAYOUTS = {
    1: ("stop", "N-BK7"),
    2: ("stop", "N-BK7", "N-SF2"),
    3: (CROWN, "stop", FLINT, CROWN),
    4: (CROWN, FLINT, "stop", FLINT, CROWN),
    5: (CROWN, CROWN, "stop", FLINT, CROWN, CROWN),
    6: (CROWN, CROWN, FLINT, "stop", FLINT, CROWN, CROWN),
}
RINGS = 8


def materials_of(job: DesignSettings) -> list[Any]:
    """Return the elements with "stop" among them, cemented ones as tuples; InputError for anything else."""
    text = str(job.elements).strip()
    if text.lstrip("+-").isdigit():
        if int(text) not in LAYOUTS:
            raise InputError(f"--elements must be 1 to {max(LAYOUTS)} or materials, got {text}")
        return list(LAYOUTS[int(text)])
    elements = [tuple(part.strip() for part in word.split("+")) for word in text.split(",")]
    return [item if len(item) > 1 else item[0] for item in elements]


@files.claiming
def run(job: DesignSettings, notices: files.Notices = files.SILENT) -> dict[str, Any]:
    """Design a lens and write lens.json, layout.png and report.json, and lens.zmx if requested.

    Parameters
    ----------
    job : DesignSettings
        Settings of the run.
    notices : files.Notices
        What to do about results of earlier runs.

    Returns
    -------
    dict
        The report.

    Raises
    ------
    InputError
        If an argument cannot be used, or no lens is found that keeps all rays. No file is written then.
    """
    folder = files.writable_folder(job.output)
    asked = job.values("glasses")
    given = [Path(name) for name in (job.system, *job.glasses) if name is not None]
    mark = files.fingerprint({"command": "design", **asked}, [path for path in given if path.is_file()])
    if (kept := files.kept_report(folder, mark, notices)) is not None:
        return kept
    names = ["lens.json", *(["lens.zmx"] if job.zmx else []), "layout.png"]
    if job.system is not None:
        # A file that cannot be read is refused before anything is announced.
        read_glasses(job.glasses)
        read_system(job.system)
    files.announce(folder, [*names, files.REPORT], notices)
    begun = time.perf_counter()
    bar = tqdm(desc="design", unit="step", disable=job.quiet)
    with bar, refusing(lambda text: _of_options(text, job), TypeError, ValueError):
        start, lens, did, merit, limits = (_from_plates if job.system is None else _from_system)(job, bar.update)
    rows = lenses.lens_limits(lens, limits, aim=job.aim)
    for row in rows:
        if not row.met and job.values().get(row.name) is not None:
            option = option_name(row.name)
            told = f"{option} was not reached: {row.kind} {row.limit:.4g} was asked for, the lens has {row.value:.4g}"
            warn(told, ArgumentWarning)
    report = {
        "did": did,
        "asked": {name: value for name, value in asked.items() if value not in (None, False)},
        "files": [*names, files.REPORT],
        "unit": lens.unit,
        "first_order": {name: finite(value) for name, value in lenses.first_order(lens)._asdict().items()},
        "fields": _judged(start, lens, job.aim),
        "temperatures": [
            {"temperature": degrees} | dict(zip(("rms_spot_at_start", "rms_spot"), spots, strict=True))
            for degrees, spots in _over_temperatures(job, start, lens)
        ],
        "elements": elements_of(lens, job.aim),
        "limits": [row._asdict() | {"value": finite(row.value)} for row in rows],
        "merit": merit,
        "seconds": time.perf_counter() - begun,
        **about("design"),
    }
    drawing = _drawing(lens)
    lenses.save_system(lens, folder / "lens.json")
    if job.zmx:
        lenses.write_zmx(lens, folder / "lens.zmx")
    write_file(folder / "layout.png", png(drawing))
    return files.write_report(folder, report, mark, names)


def _of_options(text: str, job: DesignSettings) -> str:
    """Return a message about an argument of the library as one about the option, or about what was designed."""
    name, _, rest = text.partition(" ")
    name = {"half_field": "field"}.get(name, name)
    if name in job.values():
        return f"{option_name(name)} {rest}"
    return f"{'--elements' if job.system is None else 'SYSTEM'}: {text}"


def _judged(start: lenses.optical_system, lens: lenses.optical_system, aim: str) -> list[dict[str, Any]]:
    """Return spots and distortion of each field before and after the design."""
    with torch.no_grad():
        before, after = (lenses.rms_spot(item, "rings", RINGS, vignetting=False, aim=aim) for item in (start, lens))
        bent = lenses.distortion(lens, aim=aim)[lens.reference]
    return [
        {"field": list(field), "label": field_label(lens, i)}
        | {"rms_spot_at_start": finite(a), "rms_spot": finite(b), "distortion": finite(c)}
        for i, (field, a, b, c) in enumerate(zip(lens.fields, before, after, bent, strict=True))
    ]


def _over_temperatures(job: DesignSettings, *systems: lenses.optical_system):
    """Yield each temperature of a design and the root mean square of the spots of systems there."""
    for degrees in job.temperatures() or ():
        with torch.no_grad():
            warm = [lenses.in_environment(item, degrees, mount=job.mount) for item in systems]
            spots = [lenses.rms_spot(item, "rings", RINGS, vignetting=False, aim=job.aim) for item in warm]
        yield degrees, [finite(found.square().mean().sqrt()) for found in spots]


def elements_of(lens: lenses.optical_system, aim: str = "paraxial") -> list[dict[str, Any]]:
    """Return what a workshop asks of each element: its glass, the diameter of its beam, and its thicknesses."""
    view = View(lens, lens.prescription(), aim=aim)
    items: list[Any] = list(lens.surfaces)
    index = view.prescription.index[lens.reference].tolist()
    places = [i for i in range(len(items) - 1) if index[i + 1] > 1.01 and not items[i].reflects]
    with torch.no_grad():
        edges: Any = edge_thicknesses(view, places) if places else []
        heights = view.heights
    return [
        {
            "surface": i,
            "material": str(getattr(items[i].material, "name", index[i + 1])),
            "diameter": finite(2 * heights[i : i + 2].max()),
            "center": finite(items[i].thickness),
            "edge": finite(edge),
        }
        for i, edge in zip(places, edges, strict=True)
    ]


def _drawing(lens: lenses.optical_system):
    """Return a section through a lens, with at most three of its fields."""
    shown = copy.copy(lens)
    if len(lens.fields) > 3:
        shown.fields = tuple(lens.fields[i] for i in (0, (len(lens.fields) - 1) // 2, -1))
    return lenses.layout_figure(shown)


def _asked(job: DesignSettings, metre: float) -> dict[str, Any]:
    """Return the numbers that are asked for by the names of the library, lengths in units of which a metre has some."""
    names = {"field": "half_field"}
    return {
        names.get(name, name): value * metre if name in LENS_LENGTHS else value
        for name, value in job.values().items()
        if value is not None
    }


def _of(kind: type[Any], asked: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers that are fields of a dataclass."""
    return {item.name: asked[item.name] for item in fields(kind) if item.name in asked}


def _from_plates(job: DesignSettings, step: Callable[[], Any]):
    """Return the plates, the lens, what was done, the merit of each stage and the limits for first-order demands."""
    materials = materials_of(job)
    read_glasses(job.glasses)
    asked = _asked(job, 1e3)
    requirements = lenses.LensRequirements(**_of(lenses.LensRequirements, asked))
    room = lenses.LensDimensions(**_of(lenses.LensDimensions, asked))
    f, speed, field = requirements.focal_length, requirements.f_number, requirements.half_field
    search = lenses.DesignSearch(
        job.starts or None, iterations=job.iterations or None, seed=job.seed, callback=lambda _: step()
    )
    makers = job.makers() or None
    # Behind a stop in front aspheres vary from the beginning.
    steep = bool(job.aspheric_terms) and materials[0] == "stop"
    search = search._filled(steep, makers)
    try:
        found = lenses.automatic_design(
            materials,
            requirements,
            dimensions=room,
            aspheric_terms=job.aspheric_terms,
            makers=makers,
            search=search,
        )
    except ValueError as error:
        if not str(error).startswith("rays are lost"):
            raise
        advice = "ask for a larger --f-number or a smaller --field, or take another --seed"
        raise InputError(f"no lens was found: {str(error).partition(':')[0]}; {advice}") from None
    lens, start = found.system, found.start
    start.aperture, start.fields, start.vignetting_factors = lens.aperture, lens.fields, lens.vignetting_factors
    glasses = ["+".join(item) if isinstance(item, tuple) else item for item in materials if item != "stop"]
    lens.name = f"{len(glasses)} elements, {f:g} mm, f/{speed:g}, {2 * field:g}°"
    lens.source = f"designed by odak {versions()['odak']} from flat plates, seed {job.seed}"
    did = [
        f"began with {search.starts} designs from random bendings of flat plates of {', '.join(glasses)}",
        f"grew aperture and field in {len(found.stages)} stages, to f/{speed:g} and {field:g} degrees",
        f"held the focal length at {f:g} mm; "
        + (
            "the image distance was a variable"
            if steep
            else "the image at the paraxial focus, with a defocus as variable"
        ),
    ]
    merit = [{"aperture": s.aperture, "field": s.field, "rms": finite(s.rms)} for s in found.stages]
    if job.substitute is not None:
        surfaces: list[Any] = list(lens.surfaces)
        names = (getattr(item.material, "name", item.material) for item in surfaces)
        did.append(_substituted([name for name in names if name not in (None, "air")]))
    return start, lens, did, merit, requirements.limits(room, molded=steep)


def _substituted(names: Sequence[str]) -> str:
    return f"replaced the glasses by {', '.join(names)}"


def _set_semi_diameters(system: lenses.optical_system, aim: str) -> None:
    """Set the semi-diameters of all surfaces to the extent of the beam."""
    surfaces: list[Any] = list(system.surfaces)
    with torch.no_grad():
        for item, size in zip(surfaces, clear_heights(system, system.prescription(), aim=aim), strict=True):
            item.semi_diameter = 1.001 * float(size)


def _from_system(job: DesignSettings, step: Callable[[], Any]):
    """Return the start, the lens, what was done, the merits of the last run and the limits for a given system."""
    read_glasses(job.glasses)
    system, did = read_system(str(job.system))
    did = [f"ignored in the file: {line}" for line in did]
    _check_start(system, job)
    metre = 1e6 / MICROMETRES[system.unit]
    found = lenses.first_order(system)
    f = float(found.focal_length.detach())
    if not math.isfinite(f):
        raise InputError(f"SYSTEM {job.system!r} is afocal; a design needs a focal length")
    if job.focal_length is not None:
        wanted = math.copysign(job.focal_length * metre, f)
        with refusing(lambda text: f"--focal-length: {text}, in {job.system!r}; leave it out", ValueError):
            system = lenses.scaled_system(system, wanted / f)
        did.append(f"scaled by {wanted / f:.6g} from a focal length of {f:.6g} {system.unit}")
        f = wanted
    # Bounds of edges and the evaluation of spots use the whole beam.
    for item in system.surfaces:
        item.semi_diameter = None
    if system.at_infinity:
        size = float(lenses.first_order(system).entrance_pupil_diameter.detach())
        system.aperture_type, system.aperture, size = "EPD", size, abs(f) / job.f_number if job.f_number else size
    elif job.f_number is not None:
        system.aperture_type, system.aperture, size = "F-number", float(found.f_number.detach()), job.f_number
    else:
        size = system.aperture
    own, goal = (system.aperture, system.fields), (size, _fields_to(system.fields, job.field))
    for item in system.surfaces if job.aspheric_terms else ():
        if item.own_shape is None and bool(item.curvature != 0):
            lacking = max(0, job.aspheric_terms + 1 - item.coefficients.numel())
            item.coefficients = torch.cat([item.coefficients, torch.zeros(lacking, dtype=torch.float64)])
    start = copy.deepcopy(system)
    start.aperture, start.fields = goal
    merit, names, chosen, limits = _optimised(system, own, goal, job, f, metre, step)
    _set_semi_diameters(system, job.aim)
    did.append("varied " + ", ".join(names))
    if job.temperature is not None:
        degrees = ", ".join(f"{value:g}" for value in job.temperatures() or ())
        did.append(f"counted the spots at {degrees} °C in mounts that expand by {job.mount:g} per kelvin")
    if chosen:
        did.append(_substituted(chosen))
    did.append(f"held the focal length at {f:.9g} {system.unit}; semi-diameters follow the beam")
    system.source = f"{system.source}; optimised by odak {versions()['odak']}, seed {job.seed}".lstrip("; ")
    return start, system, did, merit, limits


def _check_start(system: lenses.optical_system, job: DesignSettings) -> None:
    """Raise InputError where a system cannot be designed further by this command."""
    for i, item in enumerate(system.surfaces):
        if is_break(item) or item.is_off_axis:
            raise InputError(f"SYSTEM {job.system!r}: surface {i} is not centred on the axis, as a design needs it")
    if job.focal_length is not None and not system.at_infinity:
        raise InputError(
            f"--focal-length needs an object at infinity; in {job.system!r} it is at {system.object_distance:g} "
            f"{system.unit}"
        )
    if job.f_number is not None and system.telecentric:
        raise InputError(f"--f-number has no effect with {job.system!r}, which is telecentric on the object's side")
    if job.zmx:
        with tempfile.TemporaryDirectory() as folder, refusing("--zmx: ", ValueError):
            lenses.write_zmx(system, Path(folder) / "lens.zmx")


def _fields_to(own: tuple, largest: float | None) -> tuple:
    """Return field points whose largest distance from the axis is the requested one."""
    size = max(math.hypot(*point) for point in own)
    if largest is None:
        return own
    if size == 0:
        return ((0.0, 0.0), (0.0, 0.7 * largest), (0.0, largest)) if largest else own
    return tuple((x * largest / size, y * largest / size) for x, y in own)


def _optimised(system, own, goal, job: DesignSettings, f: float, metre: float, step):
    """Optimise a system in place in steps from its own aperture and fields to the requested ones.

    Returns the merits of the last run, what varied in words, the names of the glasses that were substituted, and the
    limits.
    """

    def set_conditions(share: float) -> None:
        if share == 1:
            system.aperture, system.fields = goal
            return
        system.aperture = own[0] + share * (goal[0] - own[0])
        # Towards the goals from the axis, where the system has not as many fields as there are goals.
        points = own[1] if len(own[1]) == len(goal[1]) else ((0.0, 0.0),) * len(goal[1])
        both = zip(points, goal[1], strict=True)
        system.fields = tuple(tuple(a + share * (b - a) for a, b in zip(p, q, strict=True)) for p, q in both)

    limits = {name: value for name, value in _asked(job, metre).items() if name in STANDARD_LIMITS}

    def problem(makers: Sequence[str] | None = job.makers() or None) -> lenses.lens_design:
        return lenses.standard_design(
            system,
            f,
            limits=limits,
            makers=makers,
            aspheric=bool(job.aspheric_terms),
            aim=job.aim,
            temperatures=job.temperatures(),
            mount=job.mount,
        )

    def keeps_rays(design: lenses.lens_design) -> bool:
        with torch.no_grad():
            return bool(torch.isfinite(design.residuals(design.values)).all())

    def told(number: int, merit: float) -> None:
        step()

    iterations = job.iterations or 40
    here, way = 0.0, 1.0
    while True:
        share = min(1.0, here + way)
        set_conditions(share)
        held = standard_limits(system, limits, abs(f), job.aim)
        design = problem()
        if keeps_rays(design):
            result = design.optimise(iterations, tolerance=1e-6, rounds=2 if share == 1 else 1, callback=told)
            here, way = share, 1.0
            if share == 1:
                break
            continue
        way /= 2
        if way < 1 / 64:
            place = (
                f"an aperture of {system.aperture:.4g} and fields to {max(math.hypot(*p) for p in system.fields):.4g}"
            )
            raise InputError(f"rays are lost beyond {place}: a larger --f-number, a smaller --field, or another SYSTEM")
    if job.starts and job.starts > 1:
        result = design.restarts(job.starts, seed=job.seed, iterations=iterations)
    history, chosen, names = list(result.history), (), _varied(design)
    if "glass" in design.places:
        chosen = design.substitute_glasses(job.makers(), iterations=iterations)
        # The glasses are fixed now, and with them the terms of the merit.
        history = list(problem(None).optimise(iterations, tolerance=1e-6, rounds=2, callback=told).history)
    return history, names, chosen, held


def _varied(design: lenses.lens_design) -> list[str]:
    """Return what varies in words."""
    found = {name: {place for place, _ in places} for name, places in design.places.items()}
    for name, place in design.solved:
        found.setdefault(name, set()).add(place)
    names = [f"{len(found['curvature'])} curvatures", f"{len(found['thickness']) - 1} thicknesses", "the focus"]
    for name, text in (
        ("conic", "{} conic constants"),
        ("coefficients", "aspheric coefficients of {} surfaces"),
        ("glass", "{} glasses"),
    ):
        names += [text.format(len(found[name]))] if name in found else []
    return names
