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
from odak.learn.raytracing.system.pupils import pupil_samples, trace_fields
from odak.learn.raytracing.system.surfaces import optical_system, surface

# Standard deviations of random curvatures of spheres and of aspheres in units of 1/focal length.
SPREAD = (2.5, 1.2)
# Steepest slopes of aspheres.
STEEPEST = 1.2
# Lenses of aspheres grow within a stage in steps, and at most this share of their designs goes on to the next stage.
PARTS, KEPT = 2, 0.3
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
    starts: int = 16,
    stages: int = 6,
    iterations: int = 15,
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
    starts : int
        Number of random bendings that the first stage begins with.
    stages : int
        Number of steps in which aperture and field grow, 1 to 6; 1 begins with all of both.
    iterations : int
        Steps of Levenberg and Marquardt's method in each stage.
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

    Aspheres are paraboloids with a polynomial, which are defined at any distance from the axis. The variables of the
    least squares are coefficients of combinations whose slopes are orthonormal over the beam, as Forbes proposed,
    Optics Express 15, 5218 (2007), doi 10.1364/OE.15.005218. They are set free one after the other, and slopes above
    1.2 within 1.15 times the radius of the beam are penalised. Rays that are lost when aspheres grow count as if they
    were at a tenth of the focal length, until they return; rays that are lost at the end raise ValueError.

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
    starts, seed = _validate.integer("starts", starts, minimum=1), _validate.integer("seed", seed)
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
    limit = 1 / (0.15 * f)
    last = len(system.surfaces) - 1
    variables = [
        Variable("curvature", bent[1:], -limit, limit),
        Variable("thickness", [i for i in gaps if i in bent[::2]], *glass),
        Variable("thickness", [i for i in gaps if i not in bent[::2]], *air),
        Variable("thickness", last, -0.1 * f, 0.1 * f),
    ]
    solves = [Solve("focal_length", bent[0], f), Solve("marginal_height", last)]
    if terms:
        # Limits of slopes take the place of those of curvatures, which are not variables by themselves.
        variables[0] = Variable("curvature", bent[1:])
        variables.append(Variable("coefficients", bent, terms=range(1, terms + 1)))
    first = 0 if 0 in bent else min(bent)
    between = list(range(first, last))
    height = f * math.tan(math.radians(angle))
    # Where the beam will be as it grows, aspheres must not have run away.
    beyond = (1.15,) if terms else ()
    within = (0.25, 0.5, 0.75, 1.0, *beyond) if terms else (0.5, 0.75, 1.0)
    fixed = [
        # The curvature that the focal length is solved by, in units of 1/f.
        Operand(lambda _, p: f * p.curvature[..., bent[0]], weight=0.1 * f, lower=-limit * f, upper=limit * f),
        Operand("edge_thickness", lower=edge, options={"surfaces": between, "shares": within}),
        Operand("thickness", lower=back if cover is None else 0.3 * back, options={"surfaces": [last]}),
    ]
    if terms:
        steep = {"surfaces": bent, "shares": (0.5, 0.7, 0.85, 1.0, *beyond)}
        fixed.append(Operand("slope", weight=0.1 * f, lower=-STEEPEST, upper=STEEPEST, options=steep))
    if angle:
        fixed.append(Operand("distortion", weight=0.5 * height, lower=-0.9 * distortion, upper=0.9 * distortion))
    if track is not None:
        fixed.append(Operand("total_track", upper=_validate.constant("track", track), options={"first": first}))
    if chief_ray_angle is not None:
        fixed.append(Operand("chief_ray_angle", weight=0.002 * f, upper=chief_ray_angle))
    generator = torch.Generator().manual_seed(seed)
    values: Any = None
    taken: list[Stage] = []

    def set_stage(aperture: float, field: float, count: int) -> None:
        system.aperture = aperture * f / speed
        shares = [0.0] if not angle else [math.sqrt(k / (count - 1)) for k in range(count)]
        system.fields = tuple((0.0, math.degrees(math.atan(math.tan(math.radians(angle)) * field * s))) for s in shares)

    def describe(weights, rings: int, free: int = terms) -> lens_design:
        # Aspheres may lose some rays when they grow: these return while the others are brought together.
        spot = Operand("spot", options={"fields": weights} | ({"lost": LOST * f} if terms else {}))
        # Turned, so that each ring has the two rays that are refracted most.
        pupil = pupil_samples("rings", rings).flip(-1) if terms else "rings"
        design = lens_design(system, [spot, *fixed], variables, solves=solves, pupil=pupil, count=rings)
        for (_, term), column in zip(
            design.places.get("coefficients", ()), design.columns.get("coefficients", ()), strict=True
        ):
            if term > free:
                design.lower[column] = design.upper[column] = 0.0
        return design

    reached = (0.0, 0.0)
    for number, (aperture, field, share, rings, count) in enumerate(CURRICULUM[-stages:]):
        # Coefficients become variable one after the other, as the beam fills a larger part of the surfaces.
        free = terms if number + 1 == stages else min(terms, number + 1)
        before, parts = reached, PARTS if terms and number else 1
        for part in range(1, parts + 1):
            goal = (aperture, field)
            if part < parts:
                goal = tuple(a + part / parts * (b - a) for a, b in zip(before, goal, strict=True))
            while reached != goal:
                reached = _nearer(set_stage, describe, values, reached, goal, rings, count)
                design = describe(None, rings, free)
                if values is None:
                    values = _random_starts(design, starts, SPREAD[bool(terms)] / f, generator)
                values, loss = _run(design, values, iterations)
                design.apply(values[loss.argmin()])
                taken.append(_stage(system, *reached))
                if callback is not None:
                    callback(taken[-1])
        share = min(share, KEPT) if terms else share
        values = values[loss.argsort()[: max(1, math.ceil(share * starts))]]
    weights = torch.ones(len(system.fields), dtype=torch.float64)
    for _ in range(polish):
        design = describe(weights.tolist(), rings)
        values, loss = _run(design, values, 2 * iterations)
        design.apply(values[loss.argmin()])
        sizes = rms_spot(system, "rings", 8, vignetting=False).detach()
        values = design.values[None]
        weights = weights * (sizes / sizes.square().mean().sqrt()) ** 0.5
        weights = weights / weights.square().mean().sqrt()
    if polish:
        taken.append(_stage(system, 1.0, 1.0))
        if callback is not None:
            callback(taken[-1])
    if not bool(trace_fields(system, "rings", 8, vignetting=False).arrived.all()):
        raise ValueError("rays are lost at the full aperture and field: try another seed")
    heights: Any = design.heights  # never None, since the operands limit the thickness of edges
    for item, size in zip(system.surfaces, heights, strict=True):
        item.semi_diameter = 1.001 * float(size)
    return AutomaticResult(system, tuple(taken), start)


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
    row[-1].thickness.fill_(f)
    system = optical_system(row, 1.0, wavelengths=list(wavelengths), fields=[0.0], unit=unit)
    return system, bent, gaps


def _nearer(set_stage, describe, values, here, goal, rings: int, count: int) -> tuple[float, float]:
    """Set and return the fractions of aperture and field towards a goal at which a design loses no ray."""
    if values is None:
        set_stage(*goal, count)
        return goal
    way = 1.0
    for _ in range(6):
        tried = goal if way == 1.0 else (here[0] + way * (goal[0] - here[0]), here[1] + way * (goal[1] - here[1]))
        set_stage(*tried, count)
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


def _run(design: lens_design, values: torch.Tensor, iterations: int):
    """Return the ends of a run from several starts, and their merits; edges are judged where the beam is."""
    for _ in range(2):
        with torch.no_grad():
            design.heights = design.clear_heights(values)
        basis = _slope_basis(design) if "coefficients" in design.places else None
        found = design._minimised(values, max(1, iterations // 2), damping=1e-2, basis=basis)
        values = found.x
    return values, found.loss


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


def _stage(system, aperture: float, field: float) -> Stage:
    rms = rms_spot(system, "rings", 6, vignetting=False).detach()
    return Stage(aperture, field, float(rms.square().mean().sqrt()), copy.deepcopy(system))
