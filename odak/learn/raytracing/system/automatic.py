"""Automatic design: lenses from flat plates, by a curriculum of growing aperture and field."""

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.analysis import rms_spot
from odak.learn.raytracing.system.design import Solve, Variable, lens_design
from odak.learn.raytracing.system.operands import Operand
from odak.learn.raytracing.system.paraxial import matrix, signed_indices
from odak.learn.raytracing.system.pupils import trace_fields
from odak.learn.raytracing.system.surfaces import optical_system, reference_of, surface

# Standard deviations of random curvatures of spheres and of aspheres in units of 1/focal length.
SPREAD = (2.5, 1.2)
# Steepest slopes of aspheres.
STEEPEST = 1.2
# Distance of lost rays from the centroid in focal lengths.
LOST = 0.1
# Fractions of aperture and field, number of designs retained in each stage, and rings of rays and fields in it.
CURRICULUM = (
    (0.25, 0.6, 1.0, 2, 3),
    (0.4, 0.7, 0.5, 2, 3),
    (0.55, 0.8, 0.3, 3, 4),
    (0.7, 0.85, 0.2, 3, 4),
    (0.85, 0.9, 0.15, 3, 5),
    (1.0, 1.0, 0.09, 4, 6),
)


# Aspheres: shares of aperture and field at first, and the part of the way after which the field is full.
LEAST, TURN = (0.2, 0.6), 0.4
# Longest step along the way, how often it is halved, root mean square of the spots in focal lengths above which steps
# become shorter, factor of the merit above which a step is repeated, and shares of the designs that are retained from
# points of the way on.
STEP, HALVINGS, ROUGH, WORST = 0.05, 4, 1.27e-3, 3.0
CULLS = ((0.1, 0.67), (TURN, 0.42), (0.7, 0.25))
# Shares of the beam at which slopes and edges are limited: where it will be as it grows, aspheres must not run away.
BEAM = (0.5, 0.7, 0.85, 1.0, 1.1)
# Weights of edges and, in focal lengths, of distortion while aspheres grow.
SOFT_EDGES, FIRM_EDGES, SOFT_DISTORTION = 0.4, 4.0, 0.044
# Largest sine of angles of incidence; least element of the diagonal that damping is relative to.
GRAZING, FLOOR = 0.8, 5e-9
# Least and largest damping that aspheres carry on from run to run.
DAMPING = (1e-5, 1e-1)


class Stage(NamedTuple):
    """A stage of the curriculum.

    Attributes
    ----------
    aperture, field : float
        Shares of the aperture and of the field.
    rms : float
        Root mean square of the spots of the best design, over its fields, of the rays that arrive.
    system : optical_system
        A copy of it, with the aperture and the fields of the stage.

    Examples
    --------
    >>> from odak.learn.raytracing.system import automatic_design
    >>> found = automatic_design(["stop", "N-BK7"], 100.0, 10.0, 1.0, starts=2, stages=1, iterations=2, polish=0)
    >>> stage = found.stages[-1]
    >>> stage.aperture, stage.field, bool(stage.rms > 0)
    (1.0, 1.0, True)
    """

    aperture: float
    field: float
    rms: float
    system: optical_system


class AutomaticResult(NamedTuple):
    """An automatic design.

    Attributes
    ----------
    system : optical_system
        The lens.
    stages : tuple of Stage
        Of the curriculum, the last one being the lens.
    start : optical_system
        The plates that it began with.

    Examples
    --------
    >>> from odak.learn.raytracing.system import automatic_design, rms_spot
    >>> found = automatic_design(["stop", "N-BK7"], 100.0, 10.0, 1.0, starts=2, stages=1, iterations=2, polish=0)
    >>> bool(rms_spot(found.system).mean() < rms_spot(found.start).mean())
    True
    """

    system: optical_system
    stages: tuple[Stage, ...]
    start: optical_system


def automatic_design(
    elements: Sequence[Any],
    focal_length: float,
    f_number: float,
    half_field: float,
    *,
    aspheric_terms: int = 0,
    wavelengths: Sequence[float] = (486.1327e-6, 587.5618e-6, 656.2725e-6),
    glass: Sequence[float] | None = None,
    air: Sequence[float] | None = None,
    edge: float | None = None,
    back: float | None = None,
    track: float | None = None,
    distortion: float = 0.02,
    chief_ray_angle: float | None = None,
    cover: tuple[Any, float] | None = None,
    starts: int | None = None,
    stages: int = 6,
    iterations: int | None = None,
    polish: int = 6,
    seed: int = 0,
    unit: str = "mm",
    callback: Callable[[Stage], Any] | None = None,
) -> AutomaticResult:
    """Design a lens from flat plates.

    Parameters
    ----------
    elements : sequence
        Materials of the elements in the order in which light passes them, and "stop" where the stop is: in front of an
        element, which may be the first.
    focal_length : float
        Focal length of the lens.
    f_number : float
        Focal length over the diameter of the entrance pupil, for an object at infinity.
    half_field : float
        Largest field angle in degrees.
    aspheric_terms : int
        Number of coefficients of r⁴, r⁶, … that each surface has on a paraboloid.
    wavelengths : sequence of float
        Vacuum wavelengths, in `unit`.
    glass : pair of float, optional
        Least and largest thickness of elements on the axis; by default from 0.02 to 0.2 focal lengths.
    air : pair of float, optional
        Least and largest thickness of gaps on the axis; by default from 0.002 to 0.3 focal lengths.
    edge : float, optional
        Least thickness of elements and gaps at the edge of the beam and half-way to it; by default the least of `air`.
    back : float, optional
        Least distance from the last vertex to the image; by default a tenth of the focal length.
    track : float, optional
        Largest distance from the first vertex to the image.
    distortion : float
        Largest distortion.
    chief_ray_angle : float, optional
        Largest angle of the chief rays in the image in degrees.
    cover : pair, optional
        Material and thickness of a plane plate in front of the image.
    starts : int, optional
        Number of random bendings that the first stage begins with; by default 16, of aspheres 12.
    stages : int
        Number of steps in which aperture and field grow, 1 to 6; 1 begins with all of both. The way of aspheres from
        the beginning of the same stage is divided into shorter steps of its own.
    iterations : int, optional
        Steps of Levenberg and Marquardt's method in each stage; by default 15, in each step of aspheres 6.
    polish : int
        Runs at the end in which the fields with the larger spots are given more weight.
    seed : int
        Seed of the random numbers: the same seed gives the same lens.
    unit : str
        Unit of all lengths.
    callback : callable, optional
        Called with each :class:`Stage`.

    Returns
    -------
    AutomaticResult
        The lens, its surfaces with the semi-diameters of the beam.

    Raises
    ------
    ValueError
        If an argument is out of range, or rays are lost in all designs of a stage.

    Notes
    -----
    The curriculum of Yang et al., Nature Communications 15, 6568 (2024), doi 10.1038/s41467-024-50835-7: aperture and
    field grow to their full size. Here each stage is solved by least squares rather than by gradient
    descent, several designs side by side, the best of which go on.

    Aspheres are paraboloids with a polynomial, which are defined at any distance from the axis. Their field grows
    first, so that chief rays fill the rear surfaces, then the aperture, in steps that become shorter where the spots
    become larger. The variables of the least squares are coefficients of combinations whose slopes are orthonormal over
    the beam, as Forbes proposed, Optics Express 15, 5218 (2007), doi 10.1364/OE.15.005218; they are set free one after
    the other. Each design keeps its damping from step to step. Slopes above 1.2 within 1.1 times the radius of the
    beam and sines of angles of incidence above 0.8 are penalised. Rays that are lost when aspheres grow count as if
    they were at a tenth of the focal length, until they return; rays that are lost at the end raise ValueError.

    Examples
    --------
    >>> from odak.learn.raytracing.system import automatic_design, first_order
    >>> found = automatic_design(["stop", "N-BK7"], 100.0, 10.0, 1.0, starts=2, stages=1, iterations=2, polish=0)
    >>> abs(float(first_order(found.system).focal_length) - 100) < 1
    True
    """
    f = _validate.constant("focal_length", focal_length, positive=True)
    speed = _validate.constant("f_number", f_number, positive=True)
    angle = _validate.constant("half_field", half_field, least=0)
    if angle >= 80:
        raise ValueError(f"half_field must be below 80 degrees, got {half_field}")
    terms = _validate.integer("aspheric_terms", aspheric_terms)
    starts = _validate.integer("starts", (12 if terms else 16) if starts is None else starts, minimum=1)
    iterations = (6 if terms else 15) if iterations is None else iterations
    seed = _validate.integer("seed", seed)
    stages = _validate.integer("stages", stages, minimum=1)
    if stages > len(CURRICULUM):
        raise ValueError(f"stages must be at most {len(CURRICULUM)}, got {stages}")
    iterations = _validate.integer("iterations", iterations, minimum=1)
    polish = _validate.integer("polish", polish)
    if isinstance(elements, str) or not isinstance(elements, Sequence) or not len(elements):
        raise TypeError(f'elements must be a sequence of materials and "stop", got {elements!r:.80}')
    wavelengths = _validate.several("wavelengths", wavelengths, positive=True)
    distortion = _validate.constant("distortion", distortion, positive=True)
    if chief_ray_angle is not None:
        chief_ray_angle = _validate.constant("chief_ray_angle", chief_ray_angle, positive=True)
    if cover is not None:
        if not isinstance(cover, Sequence) or isinstance(cover, str) or len(cover) != 2:
            raise TypeError(f"cover must be a pair of a material and a thickness, got {cover!r:.80}")
        cover = (cover[0], _validate.constant("cover[1]", cover[1], positive=True))
    _validate.function_or_none("callback", callback)
    glass = (0.02 * f, 0.2 * f) if glass is None else tuple(_validate.several("glass", glass, 2))
    air = (0.002 * f, 0.3 * f) if air is None else tuple(_validate.several("air", air, 2))
    edge = air[0] if edge is None else _validate.constant("edge", edge, least=0)
    back = 0.1 * f if back is None else _validate.constant("back", back, least=0)
    system, bent, gaps = _plates(elements, terms, glass, air, cover, wavelengths, unit, f)
    start = _plates(elements, terms, glass, air, cover, wavelengths, unit, f)[0]
    asked = _Asked(
        f, speed, angle, terms, glass, air, edge, back, track, distortion, chief_ray_angle, cover is not None
    )
    task = _Task(asked, system, bent, gaps, callback)
    generator = torch.Generator().manual_seed(seed)
    grown = _grown_aspheres if terms else _grown_spheres
    design = grown(task, starts, stages, iterations, polish, generator)
    if not bool(trace_fields(system, "rings", 8, vignetting=False).arrived.all()):
        raise ValueError("rays are lost at the full aperture and field: try another seed")
    heights: Any = design.heights  # never None, since the operands limit the thickness of edges
    for item, size in zip(system.surfaces, heights, strict=True):
        item.semi_diameter = 1.001 * float(size)
    return AutomaticResult(system, tuple(task.stages), start)


class _Asked(NamedTuple):
    """What is asked of a lens: the checked arguments of :func:`automatic_design`."""

    focal_length: float
    f_number: float
    half_field: float
    terms: int
    glass: Sequence[float]
    air: Sequence[float]
    edge: float
    back: float
    track: float | None
    distortion: float
    chief_ray_angle: float | None
    covered: bool


class _Task:
    """A lens that grows: what is asked of it, its system and surfaces that may bend, and the stages so far."""

    def __init__(self, asked: _Asked, system, bent: list[int], gaps: list[int], callback):
        self.asked, self.system, self.bent, self.callback = asked, system, bent, callback
        self.last = len(system.surfaces) - 1
        self.first = 0 if 0 in bent else min(bent)
        self.stages: list[Stage] = []
        self.thicknesses = [
            Variable("thickness", [i for i in gaps if i in bent[::2]], *asked.glass),
            Variable("thickness", [i for i in gaps if i not in bent[::2]], *asked.air),
        ]

    def set_stage(self, aperture: float, field: float, shares) -> None:
        """Set the aperture and, to some shares of the largest one, the fields."""
        self.system.aperture = aperture * self.asked.focal_length / self.asked.f_number
        largest = math.tan(math.radians(self.asked.half_field)) * field
        shares = shares if self.asked.half_field else [0.0]
        self.system.fields = tuple((0.0, math.degrees(math.atan(largest * s))) for s in shares)

    def note(self, aperture: float, field: float) -> None:
        """Append the system as it is to the stages, and call back."""
        rms = rms_spot(self.system, "rings", 6, vignetting=False).detach()
        self.stages.append(Stage(aperture, field, float(rms.square().mean().sqrt()), copy.deepcopy(self.system)))
        if self.callback is not None:
            self.callback(self.stages[-1])

    def limits(self, shares: Sequence[float], edges: float = 1.0, bent: float | None = None) -> list[Operand]:
        """Return the operands that keep the lens within its limits.

        Parameters
        ----------
        shares : sequence of float
            Shares of the beam's radius at which edges are limited.
        edges : float
            Weight of edges.
        bent : float, optional
            Weight of the distortion.
        """
        asked, f = self.asked, self.asked.focal_length
        between = list(range(self.first, self.last))
        image = asked.back * (0.3 if asked.covered else 1.0)
        found = [
            Operand("edge_thickness", weight=edges, lower=asked.edge, options={"surfaces": between, "shares": shares}),
            Operand("thickness", weight=edges, lower=image, options={"surfaces": [self.last]}),
        ]
        if asked.half_field:
            weight = 0.5 * f * math.tan(math.radians(asked.half_field)) if bent is None else bent
            found.append(
                Operand("distortion", weight=weight, lower=-0.9 * asked.distortion, upper=0.9 * asked.distortion)
            )
        if asked.track is not None:
            track = _validate.constant("track", asked.track)
            found.append(Operand("total_track", weight=edges, upper=track, options={"first": self.first}))
        if asked.chief_ray_angle is not None:
            found.append(Operand("chief_ray_angle", weight=0.002 * f, upper=asked.chief_ray_angle))
        return found


def _grown_spheres(task: _Task, starts: int, stages: int, iterations: int, polish: int, generator) -> lens_design:
    """Return the last design of spheres, whose aperture and field grew together."""
    asked, system, bent, last = task.asked, task.system, task.bent, task.last
    f = asked.focal_length
    limit = 1 / (0.15 * f)
    variables = [
        Variable("curvature", bent[1:], -limit, limit),
        *task.thicknesses,
        Variable("thickness", last, -0.1 * f, 0.1 * f),
    ]
    solves = [Solve("focal_length", bent[0], f), Solve("marginal_height", last)]
    fixed = [
        # The curvature that the focal length is solved by, in units of 1/f.
        Operand(lambda _, p: f * p.curvature[..., bent[0]], weight=0.1 * f, lower=-limit * f, upper=limit * f),
        *task.limits((0.5, 0.75, 1.0)),
    ]

    def describe(weights, rings: int) -> lens_design:
        spot = Operand("spot", options={"fields": weights})
        return lens_design(system, [spot, *fixed], variables, solves=solves, pupil="rings", count=rings)

    values: Any = None
    reached = (0.0, 0.0)
    for aperture, field, share, rings, count in CURRICULUM[-stages:]:
        shares = [math.sqrt(k / (count - 1)) for k in range(count)]
        while reached != (aperture, field):
            reached = _nearer(task, describe, values, reached, (aperture, field), rings, shares)
            design = describe(None, rings)
            if values is None:
                values = _random_starts(design, starts, SPREAD[0] / f, generator)
            values, loss, _ = _run(design, values, iterations)
            design.apply(values[loss.argmin()])
            task.note(*reached)
        values = values[loss.argsort()[: max(1, math.ceil(share * starts))]]

    def run(design, values):
        return _run(design, values, 2 * iterations)

    return _polished(task, lambda weights, _: describe(weights, rings), design, run, values, polish)


def _polished(task: _Task, describe, design: lens_design, run, values, polish: int) -> lens_design:
    """Return the design after runs in which the fields with the larger spots are given more weight.

    Parameters
    ----------
    task : _Task
        The lens.
    describe : callable
        Takes the weights of the fields and how far the runs have come, at most 1; returns a design.
    design : lens_design
        What is returned without a run.
    run : callable
        Takes a design and values; returns their improvement and merits.
    values : torch.Tensor or None
        Values of several designs, of one by default that of the system.
    polish : int
        Number of runs.
    """
    weights = torch.ones(len(task.system.fields), dtype=torch.float64)
    for k in range(polish):
        design = describe(weights.tolist(), (k + 1) / polish)
        values, loss, *_ = run(design, design.values[None] if values is None else values)
        design.apply(values[loss.argmin()])
        sizes = rms_spot(task.system, "rings", 8, vignetting=False).detach()
        values = design.values[None]
        weights = weights * (sizes / sizes.square().mean().sqrt()) ** 0.5
        weights = weights / weights.square().mean().sqrt()
    if polish:
        task.note(1.0, 1.0)
    return design


def _grown_aspheres(task: _Task, starts: int, stages: int, iterations: int, polish: int, generator) -> lens_design:
    """Return the last design of aspheres: the field grows first, then the aperture, in steps of adaptive length."""
    asked, system, bent, last = task.asked, task.system, task.bent, task.last
    f, terms = asked.focal_length, asked.terms
    nearest = asked.back * (0.3 if asked.covered else 1.0)
    behind = Variable("thickness", last, nearest, f)

    power = Operand(_relative_power(f), target=1.0, weight=0.22 * f)
    shares = [(k / 8) ** 0.7 for k in range(9)]
    firm_distortion = 0.5 * f * math.tan(math.radians(asked.half_field))

    def describe(weights, rings: int, free: int = terms, firmness: float = 0.0) -> lens_design:
        # Limits are soft while the lens grows, and become firm at the end.
        exact = firmness > 0
        operands = [
            Operand("spot", options={"fields": weights, "lost": LOST * f}),
            *task.limits(
                (0.3, *BEAM),
                edges=SOFT_EDGES ** (1 - firmness) * FIRM_EDGES**firmness,
                bent=(SOFT_DISTORTION * f) ** (1 - firmness) * firm_distortion**firmness,
            ),
            Operand("slope", None, 0.044 * f, -STEEPEST, STEEPEST, {"surfaces": bent, "shares": BEAM}),
            Operand("incidence", weight=0.006 * f, upper=GRAZING, options={"count": 2}),
        ]
        if not exact:
            operands.insert(1, power)
        # Coefficients last, the higher ones behind the lower ones: a design with fewer of them has the first values.
        variables = [Variable("curvature", bent[1:] if exact else bent), *task.thicknesses, behind]
        variables += [Variable("coefficients", bent, terms=[term]) for term in range(1, free + 1)]
        solves = [Solve("focal_length", bent[0], f)] if exact else []
        return lens_design(system, operands, variables, solves=solves, pupil=_own_pupils(len(system.fields), rings))

    def stage_at(way: float) -> tuple[float, float]:
        """Return the shares of aperture and field."""
        first, second = min(way / TURN, 1.0), max(way - TURN, 0.0) / (1 - TURN)
        return LEAST[0] + (1 - LEAST[0]) * second, LEAST[1] + (1 - LEAST[1]) * first

    def improved(values, damping, way: float, count: int):
        """Return designs at a point of the way, their merits and dampings; None if rays are lost in all of them."""
        task.set_stage(*stage_at(way), shares)
        free = terms if way > TURN else min(terms, 1 + int(0.8 * terms * way / TURN))
        design = describe(None, 4, free)
        if values is None:
            values = _random_starts(design, starts, SPREAD[1] / f, generator)
        values = torch.nn.functional.pad(values, (0, len(design.values) - values.shape[-1]))
        return design, _run(design, values, count, damping, FLOOR * f**2)

    way, step = 1 - (stages - 1) / 5, STEP
    design, found = improved(None, 0.1, way, 3 * iterations)
    if found is None:
        raise ValueError("rays are lost in all designs of the first stage: try another seed")
    rough = 0.5 * len(system.fields) * (ROUGH * f) ** 2
    rows = list(CULLS)
    while True:
        values, loss, damping = found
        order = loss.argsort()
        order = order[loss[order] <= max(rough, 20 * float(loss.min()))]
        while rows and way >= rows[0][0]:
            order = order[: max(1, math.ceil(rows.pop(0)[1] * starts))]
        values, damping = values[order], damping[order].clamp(*DAMPING)
        task.set_stage(*stage_at(way), shares)
        design.apply(values[0])
        task.note(*stage_at(way))
        if way >= 1:
            break
        best = None
        for attempt in range(HALVINGS + 1):
            ahead = min(1.0, way + step / 2**attempt)
            design, found = improved(values, damping, ahead, iterations)
            if found is not None and not found[1].min() < rough:
                design, found = improved(found[0], found[2], ahead, 2 * iterations)
            if found is not None:
                best = (ahead, design, found)
                if found[1].min() < WORST * rough:
                    break
        if best is None:
            raise ValueError(
                f"rays are lost in all designs beyond shares {stage_at(way)} of aperture and field: try another seed"
            )
        way, design, found = best
        merit = float(found[1].min())
        step = min(STEP, 1.6 * step) if merit < rough and attempt == 0 else max(step / 2 ** (attempt + 1), STEP / 4)
        # What was reached by the shortest step is all that is asked of the next ones.
        rough = max(rough, merit / WORST)
    # With soft limits first, which the best design settles in.
    _, found = improved(values[:1], damping[:1], 1.0, 3 * iterations)
    if found is not None:
        design.apply(found[0][0])
        damping = found[2]

    def run(design, values):
        nonlocal damping
        found = _run(design, values, 2 * iterations, damping.clamp(*DAMPING), FLOOR * f**2)
        if found is None:
            raise ValueError("rays are lost at the full aperture and field: try another seed")
        values, loss, damping = found
        return values, loss

    return _polished(
        task, lambda weights, firmness: describe(weights, 5, terms, firmness), design, run, None, max(1, polish)
    )


def _relative_power(f: float) -> Callable:
    """Return the operand of a system's power times a focal length."""

    def power(system, prescription) -> torch.Tensor:
        p = prescription.at(reference_of(system, prescription))
        return -f * matrix(p, signed_indices(system, p), 0, len(system.surfaces)).c

    return power


def _own_pupils(fields: int, rings: int) -> torch.Tensor:
    """Return points ``[F, P, 2]`` of a pupil for each field, in rings whose radii differ from field to field.

    Rays of different fields then meet a surface at different heights, so that it cannot wave between them. The rim has
    the two rays that are refracted most. No two points are mirror images, whose rays would be mirror images too.
    """
    arms = 5
    ring, arm = torch.arange(1.0, rings + 1, dtype=torch.float64)[:, None], torch.arange(arms, dtype=torch.float64)
    # Evenly filled for the last, largest field.
    offset = (0.618034 * torch.arange(fields - 1, -1, -1, dtype=torch.float64))[:, None, None] % 1
    radius = ((ring - 0.95 * offset) / rings).sqrt()
    radius[:, -1] = 1.0
    inner = (rings - ring) % 2
    turn = math.pi * ((1 - inner) * arm / (arms - 1) + inner * (arm + 0.5) / arms)
    side = 1 - 2 * ((ring + arm) % 2)
    return torch.stack([radius * side * turn.sin(), radius * turn.cos()], -1).flatten(1, 2)


def _plates(elements, terms, glass, air, cover, wavelengths, unit, f):
    """Return flat plates and a stop, the surfaces that may bend, and the surfaces in front of variable thicknesses."""
    if isinstance(elements, str) or not any(isinstance(item, str) and item == "stop" for item in elements):
        raise ValueError('elements must be materials and one "stop"')
    elements = list(elements)
    if elements.count("stop") > 1 or elements[-1] == "stop":
        raise ValueError('elements must contain one "stop", in front of a material')
    thick = (glass[0] * glass[1]) ** 0.5
    gap = min(max(air[0], 0.05 * f), air[1])
    bowl = {"curvature": 0.0, "conic": -1.0 if terms else 0.0, "coefficients": [0.0] * (terms + 1 if terms else 0)}
    row: list[surface] = []
    bent: list[int] = []
    for item in elements:
        if isinstance(item, str) and item == "stop":
            row.append(surface(thickness=air[0] if not row else gap, stop=True))
            continue
        bent += [len(row), len(row) + 1]
        row.append(surface(**bowl, thickness=thick, material=item))
        row.append(surface(**bowl, thickness=gap))
    gaps = list(range(len(row) - 1))
    if cover is not None:
        gaps.append(len(row) - 1)
        row += [surface(thickness=float(cover[1]), material=cover[0]), surface(thickness=f)]
    row[-1].thickness.fill_(f / 4 if terms else f)
    system = optical_system(row, 1.0, wavelengths=list(wavelengths), fields=[0.0], unit=unit)
    return system, bent, gaps


def _nearer(task: _Task, describe, values, here, goal, rings: int, shares) -> tuple[float, float]:
    """Set and return the fractions of aperture and field towards a goal at which a design loses no ray."""
    if values is None:
        task.set_stage(goal[0], goal[1], shares)
        return goal
    way = 1.0
    for _ in range(6):
        tried = goal if way == 1.0 else (here[0] + way * (goal[0] - here[0]), here[1] + way * (goal[1] - here[1]))
        task.set_stage(tried[0], tried[1], shares)
        design = describe(None, rings)
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            if bool(torch.isfinite(design.residuals(values)).all(-1).any()):
                return tried
        way /= 2
    raise ValueError(f"rays are lost in all designs beyond shares {here} of aperture and field: try another seed")


def _random_starts(design: lens_design, count: int, spread: float, generator) -> torch.Tensor:
    """Return starts ``[N, V]`` with random curvatures that lose no ray, decreased until there are enough starts."""
    found: list[torch.Tensor] = []
    columns = design.columns["curvature"]
    while sum(len(part) for part in found) < count:
        values = design.values.expand(4 * count, -1).clone()
        drawn = torch.randn(4 * count, len(columns), dtype=torch.float64, generator=generator)
        values[:, columns] = spread * drawn
        values = values.clamp(design.lower, design.upper)
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            found.append(values[torch.isfinite(design.residuals(values)).all(-1)])
        spread *= 0.8
    return torch.cat(found)[:count]


def _run(design: lens_design, values: torch.Tensor, iterations: int, damping: Any = 1e-2, floor: float = 0.0):
    """Return the ends of a run from several starts, their merits and dampings; edges are judged where the beam is."""
    aspheres = "coefficients" in design.places
    rounds = max(1, iterations // 3) if aspheres else 2
    for _ in range(rounds):
        with torch.no_grad():
            design.heights = design.clear_heights(values)
            if aspheres:
                # Designs that no ray passes are dropped.
                kept = torch.isfinite(design.heights).all(-1)
                values, design.heights = values[kept], design.heights[kept]
                damping = damping[kept] if isinstance(damping, torch.Tensor) else damping
                if not len(values) or not bool(torch.isfinite(design.residuals(values)).all(-1).any()):
                    return None
        basis = _slope_basis(design) if aspheres else None
        found = design._minimised(values, max(1, iterations // rounds), damping=damping, basis=basis, floor=floor)
        values, damping = found.x, found.damping if aspheres else damping
    return values, found.loss, found.damping


def _slope_basis(design: lens_design) -> torch.Tensor:
    """Return matrices ``[N, V, V]`` to the variables of N designs from coefficients of functions orthonormal in slope.

    On each paraboloid with coefficients these functions are combinations of r², r⁴, … up to their own power; the mean
    of the product of the slopes of two over the beam is 1 or 0. Other variables are their own coefficients.
    """
    heights: Any = design.heights
    count = len(design.values)
    found = torch.eye(count, dtype=torch.float64).expand(len(heights), count, count).clone()
    held: dict[int, list[tuple[int, int]]] = {}
    for name in ("curvature", "coefficients"):
        for (place, term), column in zip(design.places[name], design.columns[name], strict=True):
            held.setdefault(place, []).append((0 if name == "curvature" else term, column))
    for place, entries in held.items():
        terms, columns = (torch.tensor(value) for value in zip(*entries, strict=True))
        powers = 2.0 * (terms.double() + 1)
        gram = 2 * powers[:, None] * powers / (powers[:, None] + powers)
        functions = torch.linalg.inv(torch.linalg.cholesky(gram)).mT
        # The paraboloid is c·r²/2.
        scale = heights[:, place, None] ** (1 - powers) * torch.where(terms == 0, 2.0, 1.0)
        found[:, columns[:, None], columns] = scale[..., None] * functions
    return found
