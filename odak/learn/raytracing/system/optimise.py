"""Optimisation by Levenberg and Marquardt's method, and tolerances: Monte Carlo, sensitivities, yields, ISO 10110."""

from collections.abc import Callable, Iterable, Sequence
from math import inf
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak._torch_private import differentiates, forward_derivative
from odak._warnings import AccuracyWarning, warn
from odak.catalog.materials import MICROMETRES, OpticalMaterial
from odak.learn._tensors import takes_constants
from odak.learn.raytracing.system.analysis import rms_spot
from odak.learn.raytracing.system.operands import clear_heights
from odak.learn.raytracing.system.pupils import trace_fields
from odak.learn.raytracing.system.sequence import placement
from odak.learn.raytracing.system.surfaces import (
    Prescription,
    checked_system,
    is_break,
    is_glass,
    optical_system,
    wavelength_shares,
)
from odak.learn.raytracing.system.zemax import _zernike_terms
from odak.raytracing.surfaces import ZernikeFreeform

NAMES = (
    "curvature", "radius", "conic", "thickness", "spacing", "index", "abbe", "shift", "decentre", "tilt", "wedge",
    "roll", "irregularity",
)  # fmt: skip
# Other names of the same numbers, and how many numbers a deviation has beside one.
SAME = {"spacing": "thickness", "decentre": "shift", "wedge": "tilt"}
AXES = {"shift": ("along x", "along y"), "tilt": ("about x", "about y")}
# Zernike polynomials of an irregularity in Noll's order: astigmatism, coma, trefoil, spherical.
IRREGULAR = tuple(range(5, 12))
# Share of the squares of a merit that another linear step of the compensators may still gain.
LINEAR = 1e-3
DISTRIBUTIONS = ("normal", "uniform")
COMPENSATORS = ("curvature", "conic", "thickness", "shift", "tilt")


@_show.shown
class LevenbergMarquardtResult(NamedTuple):
    """Result of a Levenberg–Marquardt optimization.

    Attributes
    ----------
    loss : float
        Half the sum of squares at the end.
    history : tuple of float
        The same at the start and after each step taken.
    converged : bool
        Whether it ended because nothing changed any more.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import LevenbergMarquardtResult, levenberg_marquardt
    >>> x = torch.tensor([3.0], dtype=torch.float64, requires_grad=True)
    >>> result = levenberg_marquardt(lambda: x - 1, [x])
    >>> result.converged, round(result.loss, 9), round(x.item(), 6)
    (True, 0.0, 1.0)
    """

    loss: float
    history: tuple[float, ...]
    converged: bool


@differentiates
def levenberg_marquardt(
    residuals: Callable[[], torch.Tensor],
    parameters: Sequence[torch.Tensor],
    *,
    iterations: int = 50,
    damping: float = 1e-3,
    tolerance: float = 1e-10,
    callback: Callable[[int, float], bool | None] | None = None,
) -> LevenbergMarquardtResult:
    """Minimise half the sum of squares of residuals, changing the parameters in place.

    Parameters
    ----------
    residuals : callable
        Takes nothing and returns the residuals ``[R]`` at the present parameters. NaN means a failed step.
    parameters : sequence of torch.Tensor
        Leaf tensors that require grad.
    iterations : int
        Steps at most.
    damping : float
        Of the first step, relative to the diagonal of JᵀJ; it falls after steps that help and rises after others.
    tolerance : float
        Ends when the loss or the parameters change by less than this, relatively.
    callback : callable, optional
        Told of each step taken, `callback(number, loss)`; ends the run by returning True.

    Returns
    -------
    LevenbergMarquardtResult
        The end. The loss never rises.

    Raises
    ------
    ValueError, TypeError
        If the residuals at the start are not finite or do not depend on the parameters, or an argument is out of range.

    Notes
    -----
    Marquardt, J. Soc. Ind. Appl. Math. 11, 431 (1963): (JᵀJ + λ·diag JᵀJ)δ = −Jᵀr. The Jacobian is exact: column by
    column as the derivative of Jᵀw by w, or row by row where there are fewer residuals than parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.raytracing.system import levenberg_marquardt
    >>> p = torch.tensor([-1.2, 1.0], dtype=torch.float64, requires_grad=True)
    >>> result = levenberg_marquardt(lambda: torch.stack([10 * (p[1] - p[0] ** 2), 1 - p[0]]), [p])
    >>> [round(v, 6) for v in p.tolist()]
    [1.0, 1.0]
    """
    damping, tolerance = _validate.constants(damping=damping, tolerance=tolerance)
    _validate.function("residuals", residuals)
    _validate.function_or_none("callback", callback)
    _validate.number("damping", damping, positive=True)
    _validate.number("tolerance", tolerance, least=0)
    _validate.instance("parameters", parameters, Iterable, "a sequence of tensors")
    parameters = list(parameters)
    if not parameters or not all(isinstance(p, torch.Tensor) and p.is_leaf and p.requires_grad for p in parameters):
        raise ValueError(f"parameters must be leaf tensors that require grad, at least one; got {parameters!r:.80}")
    _validate.integer("iterations", iterations, minimum=1)
    sizes = [p.numel() for p in parameters]

    def put(x: torch.Tensor) -> None:
        with torch.no_grad():
            for p, part in zip(parameters, x[0].split(sizes), strict=True):
                p.copy_(part.reshape(p.shape).to(p))

    def linearised(x: torch.Tensor):
        put(x)
        return tuple(value[None] for value in _linearised(residuals, parameters))

    def losses(candidates: torch.Tensor) -> torch.Tensor:
        put(candidates[:, 0])
        with torch.no_grad():
            value = residuals().reshape(-1).double()
        return 0.5 * (value @ value).reshape(1, 1)

    start = torch.cat([p.detach().reshape(-1).double() for p in parameters])[None]
    try:
        found = least_squares(
            linearised,
            losses,
            start,
            iterations=iterations,
            damping=damping,
            tolerance=tolerance,
            callback=None if callback is None else lambda number, loss: callback(number, float(loss[0])),
        )
    except BaseException:
        put(start)
        raise
    put(found.x)
    return LevenbergMarquardtResult(float(found.loss[0]), tuple(float(v[0]) for v in found.history), found.converged)


class LeastSquares(NamedTuple):
    """How :func:`least_squares` ended.

    Attributes
    ----------
    x, loss, damping : torch.Tensor
        Numbers ``[N, V]``, losses and dampings ``[N]``.
    history : list of torch.Tensor
        Losses at the start and after each step.
    converged : bool
        Whether nothing changed any more.
    """

    x: torch.Tensor
    loss: torch.Tensor
    history: list[torch.Tensor]
    converged: bool
    damping: torch.Tensor


# Dampings tried at once, and the factors of the next one after steps that help and after steps that do not.
ONE = ((1.0,), 1 / 5, 4.0, 24)
# How often limits that a step would exceed are added to its linear model.
LIMIT_ROUNDS = 4
LADDER = ((0.03, 0.3, 3.0, 30.0, 300.0), 1.0, 3e4, 4)


def least_squares(
    linearised: Callable[..., Any],
    losses: Callable[..., Any],
    x: torch.Tensor,
    *,
    lower: Any = None,
    upper: Any = None,
    iterations: int,
    damping: float | torch.Tensor = 1e-3,
    tolerance: float = 1e-10,
    callback: Callable[..., Any] | None = None,
    ladder: tuple[Any, ...] = ONE,
    floor: float = 0.0,
) -> LeastSquares:
    """Minimise half the sums of squares of N independent problems side by side, within bounds.

    Parameters
    ----------
    linearised : callable
        Takes numbers ``[N, V]``, returns residuals ``[N, R]`` and Jacobians ``[N, R, V]``; perhaps also which residuals
        are limits ``[R]``, that count only where they are positive. A step is computed with those that it would exceed.
    losses : callable
        Takes numbers ``[N, M, V]``, returns losses ``[N, M]``; what is not finite counts as a failed step.
    x : torch.Tensor
        Numbers at the start, float64.
    lower, upper : torch.Tensor, optional
        Bounds ``[V]``. A number at its bound, which the gradient drives across it, is left out of the step; steps are
        cut off at the bounds.
    iterations : int
        Steps at most.
    damping : float or torch.Tensor
        Damping of the first step, relative to the diagonal of JᵀJ; one or one for each problem ``[N]``.
    tolerance : float
        A problem ends when its loss or its numbers change by less than this, relatively.
    callback : callable, optional
        ``callback(number, losses)``; ends the run by returning True.
    ladder : tuple
        Factors of the damping that are tried in one call of `losses`, the factors of the damping afterwards if a step
        was taken and if none was, and how often to try again.

    Raises
    ------
    ValueError
        If no problem has finite residuals at the start.
    """
    factors, relief, growth, rounds = ladder
    scales = torch.tensor(factors, dtype=x.dtype, device=x.device)
    size = torch.as_tensor(damping, dtype=x.dtype, device=x.device).expand(len(x)).clone()
    low, high = (
        torch.full_like(x[0], side) if bound is None else bound for bound, side in ((lower, -inf), (upper, inf))
    )
    x = x.clamp(low, high)
    value, jacobian, limits = _with_limits(*linearised(x))
    loss = 0.5 * _counted(value, limits).square().sum(-1)
    loss = torch.where(torch.isfinite(loss), loss, inf)
    if not bool((loss < inf).any()):
        raise ValueError("residuals must be finite at the start; are rays lost?")
    history, converged = [loss], False
    for number in range(1, iterations + 1):
        # Problems without finite residuals and derivatives stay where they are.
        regular = (loss < inf) & torch.isfinite(jacobian).all(-1).all(-1)
        jacobian = torch.where(regular[:, None, None], jacobian, 0.0)
        apart = limits & ~(value > 0)
        ahead, jacobian = jacobian[:, limits], jacobian * ~apart[..., None]
        slope = (jacobian.mT @ torch.where(regular[:, None], _counted(value, limits), 0.0)[..., None])[..., 0]
        free = ~((x <= low) & (slope > 0) | (x >= high) & (slope < 0))
        jacobian = jacobian * free[:, None]
        normal = jacobian.mT @ jacobian
        diagonal = normal.diagonal(dim1=-2, dim2=-1)
        least = (1e-12 * diagonal.amax(-1, keepdim=True)).clamp_min(max(floor, 1e-300))
        scale = torch.maximum(diagonal, least).rsqrt()
        scaled = normal * scale[:, :, None] * scale[:, None]
        ahead = ahead * (scale * free)[:, None]
        # Limits that count already are none that a step could meet.
        away = torch.where(apart, value, -inf)[:, limits]
        levels, axes = torch.linalg.eigh(scaled)
        turned = (axes.mT @ (scale * slope * free)[..., None])[..., 0]
        before, taken = x, torch.zeros_like(loss, dtype=torch.bool)
        for _ in range(rounds):
            shares = turned[:, None] / (levels.clamp_min(0)[:, None] + (size[:, None] * scales)[..., None])
            step = -shares @ axes.mT
            if bool(limits.any()):
                damped = scaled[:, None] + torch.diag_embed((size[:, None] * scales)[..., None].expand_as(step))
                step = _seeing_limits(step, damped, scale * slope * free, away, ahead)
            candidates = before[:, None] + step * scale[:, None]
            candidates = torch.where(torch.isfinite(candidates), candidates, before[:, None]).clamp(low, high)
            tried = losses(candidates)
            best, place = torch.where(torch.isfinite(tried), tried, inf).min(-1)
            better = ~taken & (best < loss)
            x = torch.where(
                better[:, None], candidates.gather(1, place[:, None, None].expand(-1, -1, x.shape[1]))[:, 0], x
            )
            loss, taken = torch.where(better, best, loss), taken | better
            size = torch.where(better, (size * scales[place] * relief).clamp_min(1e-15), size)
            if bool(taken.all() | ((loss == inf) | taken).all()):
                break
            size = torch.where(taken, size, size * growth)
        if not bool(taken.any()):
            converged = True
            break
        size = torch.where(taken, size, size.clamp(max=1e3))
        history.append(loss)
        small = (x - before).norm(dim=-1) <= tolerance * (x.norm(dim=-1) + tolerance)
        settled = small | (history[-2] - loss <= tolerance * history[-2]) | ~(loss < inf)
        converged = bool(settled.all())
        if (callback is not None and callback(number, loss)) or converged or number == iterations:
            break
        value, jacobian, limits = _with_limits(*linearised(x))
    return LeastSquares(x, loss, history, converged, size)


def _with_limits(value, jacobian, limits=None):
    """Return residuals, Jacobians and which of them are limits; none by default."""
    return value, jacobian, torch.zeros_like(value[0], dtype=torch.bool) if limits is None else limits


def _counted(value: torch.Tensor, limits: torch.Tensor) -> torch.Tensor:
    """Return residuals; where a limit is kept, its residual is 0."""
    return torch.where(limits, value.clamp_min(0.0), value)


def _seeing_limits(step, matrix, slope, value, jacobian):
    """Return steps ``[N, M, V]`` that minimise the linear model together with the limits that they would exceed.

    A limit that is kept has neither residual nor slope, so that a step that disregards it can end far beyond it.
    """
    seen = torch.zeros(*step.shape[:2], value.shape[-1], dtype=torch.bool, device=step.device)
    for _ in range(LIMIT_ROUNDS):
        exceeded = (value[:, None] + step @ jacobian.mT > 0) & ~seen
        if not bool(exceeded.any()):
            break
        seen = seen | exceeded
        some = seen.any(0).any(0)
        ahead, short = jacobian[:, None, some], value[:, None, some, None].clamp_min(-1e300)
        rows = torch.where(seen[..., some, None], ahead, 0.0)
        right = slope[:, None] + (rows.mT @ short)[..., 0]
        found, _ = torch.linalg.solve_ex(matrix + rows.mT @ ahead, -right[..., None])
        step = torch.where(exceeded.any(-1, keepdim=True), found[..., 0], step)
    return step


def _linearised(residuals, parameters):
    """Return the residuals and their Jacobian ``[R, P]``, in float64."""
    with torch.enable_grad():
        value = residuals().reshape(-1)
        if not value.requires_grad:
            raise ValueError("residuals must depend on the parameters")
        count = sum(p.numel() for p in parameters)
        jacobian = (_by_rows if len(value) < count else _by_columns)(value, parameters)
    return value.detach().double(), jacobian.detach().double()


def _by_rows(value, parameters):
    rows = []
    for entry in value:
        parts = torch.autograd.grad(entry, parameters, retain_graph=True, allow_unused=True, materialize_grads=True)
        rows.append(torch.cat([part.reshape(-1) for part in parts]))
    return torch.stack(rows)


def _by_columns(value, parameters):
    """Return the columns of J: Jᵀw is linear in w, and its derivative by w is J, whatever w is."""
    weight = torch.zeros_like(value, requires_grad=True)
    parts = torch.autograd.grad(value, parameters, weight, create_graph=True, allow_unused=True, materialize_grads=True)
    flat = torch.cat([part.reshape(-1) for part in parts])
    if not flat.requires_grad:
        return torch.zeros(len(value), len(flat), dtype=value.dtype, device=value.device)
    columns = [
        torch.autograd.grad(entry, weight, retain_graph=True, allow_unused=True, materialize_grads=True)[0]
        for entry in flat
    ]
    return torch.stack(columns, -1)


def linearised_forward(residuals: Callable[..., Any], values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return residuals ``[..., R]`` at values ``[..., V]`` and their Jacobian ``[..., R, V]`` in one forward pass.

    Parameters
    ----------
    residuals : callable
        Takes values ``[..., V]``, returns ``[..., R]``, each row from its own values alone.
    values : torch.Tensor
        Where; the directions of all variables are carried along together.
    """
    values = values.detach()

    def along(direction):
        return forward_derivative(residuals, values, direction.expand_as(values))

    directions = torch.eye(values.shape[-1], dtype=values.dtype, device=values.device)
    out_dims: Any = (None, -1)  # None: the value, the same along all directions; the annotation of vmap lacks it
    value, change = torch.func.vmap(along, out_dims=out_dims)(directions)
    return value.detach(), change.detach()


class Perturbation(NamedTuple):
    """Statistical deviation of a number of a system.

    Attributes
    ----------
    name : str
        "curvature", "radius", "conic"; "thickness" or "spacing"; "index" of what is behind the surface; "abbe", the
        Abbe number of the same; "shift" or "decentre" along x and y; "tilt" or "wedge" about x and y in degrees; "roll"
        about z in degrees; "irregularity", the root mean square of a deviation of the surface over its clear aperture
        by astigmatism, coma, trefoil and spherical aberration in equal shares.
    surfaces : int or sequence of int
        Of which surfaces, each drawn on its own.
    size : float
        Standard deviation, or half the width of a uniform distribution; in the unit of the number.
    relative : bool
        Whether `size` is a share of the number itself.
    distribution : str
        "normal" or "uniform".
    together : bool
        Draw once for all the surfaces: an element or a group that is shifted, tilted or rolled as a rigid body. What is
        behind it stays where it is.
    pivot : float
        Distance from the vertex of the first of the surfaces along z to the point that a body is turned about.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation
    >>> off = Perturbation("thickness", 2, 0.05)
    >>> off.size, off.distribution
    (0.05, 'normal')
    """

    name: str
    surfaces: int | Sequence[int]
    size: float
    relative: bool = False
    distribution: str = "normal"
    together: bool = False
    pivot: float = 0.0


@_show.shown
class ToleranceResult(NamedTuple):
    """Result of a Monte Carlo analysis of tolerances.

    Attributes
    ----------
    merit : torch.Tensor
        What `merit` returned for each system, ``[samples, …]``.
    nominal : torch.Tensor
        The same for the system as drawn.
    prescription : Prescription
        The perturbed numbers, ``[samples, …]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, ToleranceResult, load_system, tolerance
    >>> lens = load_system("cooke_triplet")
    >>> off = [Perturbation("radius", [0, 1], 1e-3, relative=True)]
    >>> result = tolerance(lens, off, samples=4)
    >>> len(result.merit)
    4
    """

    merit: torch.Tensor
    nominal: torch.Tensor
    prescription: Prescription

    def yield_within(self, limit: float | torch.Tensor) -> torch.Tensor:
        """Return the share of the systems whose merits are all at most `limit`; lost ones, of merit NaN, are none.

        Parameters
        ----------
        limit : float or torch.Tensor
            Largest merit that is accepted, for all fields or for each.
        """
        limit = torch.as_tensor(_validate.real("limit", limit)).to(self.merit)
        good = (self.merit <= limit).reshape(len(self.merit), -1).all(-1)
        return good.double().mean()


@_show.shown
class Sensitivity(NamedTuple):
    """Merits of a system with one number off at a time.

    Attributes
    ----------
    names : tuple of str
        Which number is off: its name, surface, and axis, as "radius of surface 2".
    merit : torch.Tensor
        What `merit` returned with each number too large and too small, ``[2, names, …]``.
    nominal : torch.Tensor
        The same for the system as drawn.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, Sensitivity, load_system, sensitivity
    >>> found = sensitivity(load_system("cooke_triplet"), [Perturbation("thickness", [1, 3], 0.02)])
    >>> found.names
    ('thickness of surface 1', 'thickness of surface 3')
    """

    names: tuple[str, ...]
    merit: torch.Tensor
    nominal: torch.Tensor


def sensitivity(
    system: optical_system,
    perturbations: Sequence[Perturbation],
    *,
    merit: Callable[..., Any] | None = None,
    compensators: Sequence[tuple[str, int]] = (),
    iterations: int = 10,
) -> Sensitivity:
    """Return how a system's merit changes with each deviation alone, by its size and by as much the other way.

    Parameters
    ----------
    system : optical_system
        The system.
    perturbations : sequence of Perturbation
        What may be off; each surface and each axis on its own, except for those that are off together.
    merit : callable, optional
        ``merit(system, prescription=…)``, which returns ``[systems, …]``; :func:`rms_spot` by default.
    compensators : sequence of pairs
        Names and surfaces of what is adjusted in each of the systems before its merit is taken, as in
        :func:`tolerance`.
    iterations : int
        Steps of the search for the compensators.

    Returns
    -------
    Sensitivity
        All systems are traced in one batch.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, load_system, sensitivity
    >>> off = [Perturbation("radius", [0, 1], 1e-3, relative=True), Perturbation("tilt", 2, 0.02)]
    >>> found = sensitivity(load_system("cooke_triplet"), off)
    >>> found.names[2:], tuple(found.merit.shape)
    (('tilt of surface 2 about x', 'tilt of surface 2 about y'), (2, 4, 3))
    """
    nominal, evaluated = _evaluation(system, merit, compensators, iterations)
    items = _checked_perturbations(perturbations, len(system.surfaces))
    names, cells = [], []
    for number, (item, places) in enumerate(items):
        columns = [list(range(len(places)))] if item.together else [[j] for j in range(len(places))]
        for axis in range(_axes_of(item)):
            way = AXES.get(_kind(item), ())[axis : axis + 1]
            way = (f"by Zernike {IRREGULAR[axis]}",) if item.name == "irregularity" else way
            for held in columns:
                which = ", ".join(str(places[j]) for j in held)
                names.append(f"{item.name} of surface{'s' if len(held) > 1 else ''} {' '.join((which, *way))}")
                cells.append((number, held, axis))
    if not names:
        raise ValueError("perturbations must contain at least one, got none")
    samples = 2 * len(names)
    draws = [torch.zeros(samples, len(places), _axes_of(item), dtype=torch.float64) for item, places in items]
    for row, (number, held, axis) in enumerate(cells):
        size = float(items[number][0].size)
        draws[number][row, held, axis], draws[number][row + len(names), held, axis] = size, -size
    found, drawn, _ = evaluated(_deviated(system, nominal, items, draws, samples))
    return Sensitivity(tuple(names), found.reshape(2, len(names), *found.shape[1:]), drawn)


def tolerance(
    system: optical_system,
    perturbations: Sequence[Perturbation],
    samples: int = 200,
    seed: int = 0,
    *,
    merit: Callable[..., Any] | None = None,
    compensators: Sequence[tuple[str, int]] = (),
    iterations: int = 10,
) -> ToleranceResult:
    """Trace many systems with random deviations of their numbers, in one batch.

    Parameters
    ----------
    system : optical_system
        The system.
    perturbations : sequence of Perturbation
        What may be off, and how far.
    samples : int
        Number of systems.
    seed : int
        Of the random numbers: the same seed gives the same systems.
    merit : callable, optional
        ``merit(system, prescription=…)``, returns ``[samples, …]``; :func:`rms_spot` by default. With compensators
        it must accept two axes of systems, and be differentiable by torch.func.
    compensators : sequence of pairs
        What is adjusted when a system is put together, name and surface: ``[("thickness", -1)]`` focuses each. Names
        are "curvature", "conic", "thickness", "shift" and "tilt" (of both axes). They take the values that make the sum
        of the squares of the merit least, from the system as drawn. For spots they follow from the derivatives of the
        rays of the system as drawn: each lens is traced twice, and again only while a further step would gain more than
        1e-3 of the squares.
    iterations : int
        Most steps of the search for them.

    Returns
    -------
    ToleranceResult
        Without compensators its merits are differentiable in the system's parameters if these are. With them,
        `nominal` is compensated too.

    Examples
    --------
    A lens that is focused after it was mounted:

    >>> from odak.learn.raytracing.system import Perturbation, load_system, tolerance
    >>> focus = [Perturbation("thickness", -1, 0.1)]
    >>> triplet = load_system("cooke_triplet")
    >>> result = tolerance(triplet, focus, samples=4, compensators=[("thickness", -1)])
    >>> bool((result.merit - result.nominal).abs().max() < 1e-5)
    True

    >>> from odak.learn.raytracing.system import Perturbation, load_system, tolerance
    >>> off = [Perturbation("radius", [0, 1], 1e-3, relative=True), Perturbation("tilt", 2, 0.02)]
    >>> tuple(tolerance(load_system("cooke_triplet"), off, samples=10).merit.shape)
    (10, 3)
    """
    samples = _validate.integer("samples", samples, minimum=1)
    nominal, evaluated = _evaluation(system, merit, compensators, iterations)
    return ToleranceResult(*evaluated(perturbed(system, nominal, perturbations, samples, seed)))


@takes_constants("limit")
def tolerances_for_yield(
    system: optical_system,
    perturbations: Sequence[Perturbation],
    limit: float | torch.Tensor,
    share: float = 0.9,
    *,
    samples: int = 200,
    seed: int = 0,
    compensators: Sequence[tuple[str, int]] = (),
) -> tuple[list[Perturbation], ToleranceResult]:
    """Return the largest deviations with which a share of the lenses has spots of at most `limit`.

    Parameters
    ----------
    system : optical_system
        The system.
    perturbations : sequence of Perturbation
        What may be off; the sizes are starting values.
    limit : float or torch.Tensor
        Largest spot that is accepted (:func:`rms_spot`), for all fields or for each.
    share : float
        Wanted yield, between 0 and 1.
    samples : int
        Number of systems of the Monte Carlo analysis.
    seed : int
        Seed of its random numbers.
    compensators : sequence of pairs
        What is adjusted when a system is put together, name and surface; see :func:`tolerance`.

    Returns
    -------
    tuple
        The perturbations with new sizes, and the result of :func:`tolerance` for these.

    Raises
    ------
    ValueError
        If the system as drawn, after compensation, does not keep the limit.

    Notes
    -----
    Inverse sensitivity: from the mean square that each perturbation alone adds to the spots, sizes at which all of
    them add the same, each between a fifth and five times its starting value; then one factor of all of them, by
    bisection of the yield to 4 %.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, load_system, tolerances_for_yield
    >>> off = [Perturbation("radius", range(6), 1e-3, relative=True), Perturbation("thickness", range(5), 0.02)]
    >>> sizes, result = tolerances_for_yield(load_system("cooke_triplet"), off, 0.025, 0.8, samples=50)
    >>> float(result.yield_within(0.025)) >= 0.8
    True
    """
    items = [item for item, _ in _checked_perturbations(perturbations, len(checked_system(system).surfaces))]
    _validate.real("limit", limit)
    _validate.constant("share", share, positive=True, below=1)
    options: dict[str, Any] = {"compensators": compensators}
    added = []
    for item in items:
        alone = sensitivity(system, [item], **options)
        change = (alone.merit.square() - alone.nominal.square()).mean((0, 2)).sum() if len(alone.names) else 0.0
        added.append(float(change))
    typical = sorted(added)[len(added) // 2]
    even = [min(max((typical / value) ** 0.5, 0.2), 5.0) if value > 0 < typical else 5.0 for value in added]

    def attempt(factor: float) -> tuple[list[Perturbation], ToleranceResult]:
        sized = [item._replace(size=item.size * part * factor) for item, part in zip(items, even, strict=True)]
        return sized, tolerance(system, sized, samples, seed, **options)

    low, high = attempt(0.0), None
    if float(low[1].yield_within(limit)) < share:
        raise ValueError(
            f"limit must be one that the system as drawn keeps, {float(low[1].nominal.max()):.3g}; got {limit}"
        )
    least, factor = 0.0, 1.0
    for _ in range(16):
        found = attempt(factor)
        if float(found[1].yield_within(limit)) >= share:
            low, least = found, factor
        else:
            high = factor
        if high is not None and high - least <= 0.04 * high:
            break
        factor = 2 * factor if high is None else (least + high) / 2
    return low


def iso_10110_tolerances(system: optical_system) -> list[Perturbation]:
    """Return the deviations of ISO 10110-11, which hold for lenses whose drawings state none, and usual ones of glass.

    Parameters
    ----------
    system : optical_system
        The system, in mm.

    Returns
    -------
    list of Perturbation
        Uniform within the tolerance, for each element by its diameter (up to 10, 30, 100 and 300 mm): centre thickness
        ±0.1, 0.2, 0.4, 0.8 mm; tilt of each surface 4/30′, 4/20′, 4/10′, 4/10′; power and irregularity of the surfaces
        3/5(1), 3/10(2), 3/10(2), 3/10(2) in fringes at 546 nm, the power over at most 30 or 60 mm of the largest two;
        index ±0.001 and Abbe number ±0.8 %, usual ones of glass makers. Air spaces have the tolerance of the thickness
        of the element in front.

    Warns
    -----
    odak.AccuracyWarning
        If an element is larger than 300 mm, where the table ends: its last column is taken.

    Notes
    -----
    ISO 10110-11:1996, table 1. N fringes of power over the radius h change the curvature by N·λ/h². An irregularity of
    N fringes from peak to valley is taken to have a root mean square of N·λ/2 over 5 on the whole clear aperture,
    where the standard states it for any test area of 30 or 60 mm of the largest two classes.

    Examples
    --------
    >>> from odak.learn.raytracing.system import iso_10110_tolerances, load_system
    >>> off = iso_10110_tolerances(load_system("cooke_triplet"))
    >>> [(item.name, item.surfaces, item.size) for item in off[:2]]
    [('thickness', 0, 0.2), ('index', 0, 0.001)]
    """
    numbers = checked_system(system).prescription()
    scale, green = 1e3 / MICROMETRES[system.unit], 546.07e-6 * 1e3 / MICROMETRES[system.unit]
    reaches = clear_heights(system, numbers)
    found, largest = [], 0.0
    classes = (
        (10.0, 0.1, 30, 5, 1, inf),
        (30.0, 0.2, 20, 10, 2, inf),
        (100.0, 0.4, 10, 10, 2, 30.0),
        (inf, 0.8, 10, 10, 2, 60.0),
    )
    surfaces: list[Any] = list(system.surfaces)[: len(system.surfaces) - system.afocal]
    for i in [k for k in range(len(surfaces)) if is_glass(surfaces, k) and not is_break(surfaces[k])]:
        ends = [j for j in (i, i + 1) if j < len(surfaces) and not is_break(surfaces[j])]
        radii = [surfaces[j].semi_diameter or float(reaches[j].detach()) for j in ends]
        diameter = 2 * max(radii) / scale
        largest = max(largest, diameter)
        _, depth, centring, power, ripple, within = next(row for row in classes if diameter <= row[0])
        found.append(Perturbation("thickness", i, depth * scale, False, "uniform"))
        found.append(Perturbation("index", i, 1e-3, False, "uniform"))
        if isinstance(surfaces[i].material, OpticalMaterial):
            found.append(Perturbation("abbe", i, 8e-3, True, "uniform"))
        for j, reach in zip(ends, radii, strict=True):
            if any(item.name == "wedge" and item.surfaces == j for item in found):
                continue
            found.append(Perturbation("wedge", j, centring / 60, False, "uniform"))
            if surfaces[j].own_shape is not None:
                continue
            height = min(reach, within / 2 * scale)
            found.append(Perturbation("curvature", j, power * green / height**2, False, "uniform"))
            found.append(Perturbation("irregularity", j, ripple * green / 2 / 5))
        if i + 1 < len(surfaces) - 1 and not is_glass(surfaces, i + 1):
            found.append(Perturbation("spacing", i + 1, depth * scale, False, "uniform"))
    if largest > 300:
        warn(
            f"the table of ISO 10110-11 ends at a diameter of 300 mm; its last column is taken for {largest:.0f} mm",
            AccuracyWarning,
        )
    return found


def _evaluation(system, merit: Any, compensators: Any, iterations: int) -> tuple[Prescription, Callable[..., Any]]:
    """Return the system's numbers, and the function that evaluates deviating ones after what compensates them.

    It returns the merit of each system, that of the system as drawn, and the numbers after compensation.
    """
    nominal = checked_system(system).prescription()
    merit = rms_spot if merit is None else _validate.function("merit", merit)
    _validate.integer("iterations", iterations, minimum=1)
    _validate.listed("compensators", compensators, "a sequence of pairs (name, surface)")
    compensators = list(compensators)

    def after(numbers: Prescription) -> tuple[Any, Prescription]:
        if merit is rms_spot:
            return _linearly_compensated(system, numbers, _entries(system, compensators), iterations)
        numbers = compensated(system, numbers, compensators, merit, iterations)
        return merit(system, prescription=numbers), numbers

    def evaluated(numbers: Prescription) -> tuple[Any, Any, Prescription]:
        if not compensators:
            return merit(system, prescription=numbers), merit(system, prescription=nominal), numbers
        found, numbers = after(numbers)
        return found, after(perturbed(system, nominal, [], 1, 0))[0][0], numbers

    return nominal, evaluated


@torch.no_grad()
def _linearly_compensated(system, numbers: Prescription, entries: list[Any], iterations: int) -> tuple[Any, ...]:
    """Return spots ``[N, F]`` and prescriptions by Gauss–Newton steps with the derivatives of the system as drawn."""
    moved, held = _mover(numbers, entries)
    nominal, _ = _mover(perturbed(system, system.prescription(), [], 1, 0), entries)
    start = torch.zeros(len(held["thickness"]), len(entries), dtype=torch.float64, device=held["thickness"].device)

    def rays(p: Prescription) -> torch.Tensor:
        """Return distances from the centroids, ``[..., F, rays]``, whose squares sum to the squared spot sizes."""
        traced = trace_fields(system, "rings", 6, prescription=p)
        share = wavelength_shares(system, p, traced.x)[:, None, None] * traced.arrived
        number = share.sum((-3, -1), keepdim=True)
        parts = []
        for value in (traced.x, traced.y):
            value = torch.where(traced.arrived, value, 0.0)
            centre = (share * value).sum((-3, -1), keepdim=True) / number
            parts.append((share / number).sqrt() * torch.where(traced.arrived, value - centre, 0.0))
        return torch.cat(parts, -1).transpose(-3, -2).flatten(-2)

    found, x = rays(moved(start)), start
    if iterations:
        _, slopes = linearised_forward(lambda c: rays(nominal(c)).flatten(-2), start[:1])
        slopes = slopes[0].nan_to_num()
        inverse = torch.linalg.pinv(slopes.mT @ slopes, hermitian=True)
        best = found.square().nan_to_num().sum((-2, -1))
        open_ = torch.ones_like(best, dtype=torch.bool)
        for _ in range(iterations):
            fall = found.flatten(-2).nan_to_num() @ slopes
            step = -fall @ inverse
            # The squares fall by the projection on the slopes, if rays move as in the system as drawn.
            open_ = open_ & ((-step * fall).sum(-1) > LINEAR * best)
            if not bool(open_.any()):
                break
            trial = rays(moved(x + step))
            squares = trial.square().nan_to_num().sum((-2, -1))
            open_ = better = open_ & (squares < best)
            x = torch.where(better[:, None], x + step, x)
            found = torch.where(better[:, None, None], trial, found)
            best = torch.where(better, squares, best)
    return found.square().sum(-1).sqrt(), moved(x)


def _entries(system, compensators) -> list[tuple[str, int, int | None]]:
    """Return name, surface and axis of each number that compensates."""
    entries: list[tuple[str, int, int | None]] = []
    for given in compensators:
        pair: Any = given if isinstance(given, (tuple, list)) and len(given) == 2 else (None, None)
        name, place = pair
        name = _validate.one_of("name of compensators", name, COMPENSATORS)
        place = _validate.place_in("surface of compensators", place, len(system.surfaces))
        entries += [(name, place, axis) for axis in ((0, 1) if name in ("shift", "tilt") else (None,))]
    return entries


def compensated(
    system: optical_system,
    numbers: Prescription,
    compensators: Sequence[tuple[str, int]],
    merit: Callable[..., torch.Tensor],
    iterations: int,
) -> Prescription:
    """Return a batch of prescriptions ``[N]`` with the compensators where the sum of the squared merits is least."""
    entries = _entries(system, compensators)
    moved, held = _mover(numbers, entries)

    def residuals(x: torch.Tensor) -> torch.Tensor:
        return merit(system, prescription=moved(x)).reshape(*x.shape[:-1], -1)

    def losses(candidates: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return 0.5 * residuals(candidates).square().sum(-1)

    start = torch.zeros(len(held["thickness"]), len(entries), dtype=torch.float64, device=held["thickness"].device)
    found = least_squares(
        lambda x: linearised_forward(residuals, x), losses, start, iterations=iterations, ladder=LADDER
    )
    return moved(found.x)


def _mover(numbers: Prescription, entries: list[Any]) -> tuple[Callable[..., Any], dict[Any, Any]]:
    """Return a function that moves the compensators ``[N, V]`` or ``[N, trials, V]`` of a batch, and its numbers."""
    held = {name: getattr(numbers, name) for name in (*COMPENSATORS, "coefficients", "index")}
    for name in ("shift", "tilt"):
        if held[name] is None and any(entry[0] == name for entry in entries):
            held[name] = torch.zeros(*numbers.thickness.shape, 2, dtype=torch.float64, device=numbers.thickness.device)
    held = {name: value.detach() for name, value in held.items() if value is not None}

    def moved(x: torch.Tensor) -> Prescription:
        # Several trials of each system stand on an axis behind the axis of systems.
        values = {name: value[:, None] if x.ndim == 3 else value for name, value in held.items()}
        for j, (name, place, axis) in enumerate(entries):
            own = values[name]
            unit = torch.zeros_like(own[(0,) * (own.ndim - (1 if axis is None else 2))])
            unit[(place,) if axis is None else (place, axis)] = 1.0
            column = (..., j, *(None,) * unit.ndim)
            values[name] = own + x[column] * unit
        shapes = numbers.shapes
        if shapes is not None and x.ndim == 3:
            shapes = tuple(None if shape is None else _with_trials(shape) for shape in shapes)
        return numbers._replace(**values, shapes=shapes)

    return moved, held


def _with_trials(shape):
    """Return a shape with an axis for trials behind the axis of systems."""
    pairs = zip(map(torch.as_tensor, shape.parameters()), shape.ranks_of_parameters(), strict=True)
    return type(shape)(*(v.unsqueeze(v.ndim - own) if v.ndim > own else v for v, own in pairs))


def perturbed(
    system: optical_system, nominal: Prescription, perturbations: Sequence[Perturbation], samples: int, seed: int
) -> Prescription:
    """Return a batch of prescriptions with random numbers added."""
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    items = _checked_perturbations(perturbations, len(system.surfaces))
    drawn = [_draw(item, samples, len(places), _axes_of(item), generator) for item, places in items]
    return _deviated(system, nominal, items, drawn, samples)


def _checked_perturbations(perturbations, count: int) -> list[tuple[Perturbation, list[int]]]:
    """Return perturbations with the numbers of their surfaces."""
    # One of them is a tuple, and can be iterated.
    one = isinstance(perturbations, Perturbation) or not isinstance(perturbations, Iterable)
    perturbations = [perturbations] if one else list(perturbations)
    if not all(isinstance(item, Perturbation) for item in perturbations):
        raise TypeError(f"perturbations must be a sequence of Perturbation, got {perturbations!r:.80}")
    found = []
    for item in perturbations:
        item = item._replace(name=_validate.one_of("name of a perturbation", item.name, NAMES))
        _validate.real("size of a perturbation", item.size)
        _validate.constant("pivot of a perturbation", item.pivot)
        places = list(item.surfaces) if isinstance(item.surfaces, Iterable) else [item.surfaces]
        found.append((item, [_validate.place_in("surfaces of a perturbation", place, count) for place in places]))
    return found


def _axes_of(item: Perturbation) -> int:
    return {"shift": 2, "tilt": 2, "irregularity": len(IRREGULAR)}.get(_kind(item), 1)


def _kind(item: Perturbation) -> str:
    """Return the number of a prescription, or the deviation, that a perturbation is of."""
    return SAME.get(item.name, item.name)


def _deviated(system, nominal: Prescription, items, draws, samples: int) -> Prescription:
    """Return a batch of prescriptions whose numbers deviate by `draws`, ``[samples, places, 1 or 2]`` for each item."""
    count = len(system.surfaces)
    values = nominal._asdict()
    apart = {name: values.pop(name) for name in ("shapes", "phases", "wavelengths", "gradients")}
    for name in ("shift", "tilt"):
        if values[name] is None:
            values[name] = torch.zeros(count, 2, dtype=torch.float64, device=nominal.thickness.device)
    values = {name: value.expand(samples, *value.shape) for name, value in values.items()}
    shapes = nominal.shapes or (None,) * count
    irregular: dict[int, torch.Tensor] = {}
    for (item, places), drawn in zip(items, draws, strict=True):
        name = _kind(item)
        drawn = drawn.to(values["thickness"].device)
        shaped = [i for i in places if shapes[i] is not None]
        if shaped and name in ("curvature", "radius", "conic", "irregularity"):
            raise ValueError(f"{name} of surfaces {shaped} cannot be perturbed: their shapes have other numbers")
        if name == "irregularity":
            for column, place in enumerate(places):
                irregular[place] = irregular.get(place, 0.0) + drawn[:, column]
        elif name == "roll" or (name == "tilt" and item.together):
            for column, place in [(0, places)] if item.together else [(k, [place]) for k, place in enumerate(places)]:
                _turn(system, values, place, drawn[:, column], item)
        else:
            _shift_numbers(system, values, places, drawn, item)
    if irregular:
        apart["shapes"] = _irregular_shapes(system, nominal, values, irregular)
    # Without shifts and tilts the fused kernel is used.
    for name in ("shift", "tilt"):
        if not bool(values[name].any()):
            values[name] = None
    return Prescription(**values, **apart)


def _shift_numbers(system, values: dict[Any, Any], places: list[int], drawn: torch.Tensor, item: Perturbation) -> None:
    """Change numbers of surfaces by `drawn` ``[samples, places, 1 or 2]``, in place."""
    name = _kind(item)
    axes = values[name].shape[-1] if name in ("shift", "tilt") else 1
    drawn = torch.nn.functional.pad(drawn, (0, max(axes - 2, 0)))
    change = drawn.new_zeros(len(values["thickness"]), len(system.surfaces), drawn.shape[-1])
    for column, place in enumerate(places):
        change[:, place] += drawn[:, column]
    if name == "abbe":
        values["index"] = _dispersed(system, values["index"], change[..., 0], item.relative)
    else:
        target = "curvature" if name == "radius" else name
        values[target] = _changed(name, values[target], change, item.relative)


def _irregular_shapes(system, nominal: Prescription, values: dict, irregular: dict[int, torch.Tensor]) -> tuple:
    """Return the shapes of all surfaces, with irregularities ``[samples, terms]`` by the place of their surface."""
    shapes = list(nominal.shapes or [None] * len(system.surfaces))
    reaches = clear_heights(system, nominal)
    for place, heights in irregular.items():
        reach = system.surfaces[place].semi_diameter or float(reaches[place].detach())
        base = torch.tensor(_zernike_terms([0.0], None, nominal.coefficients[place].tolist(), reach)).to(heights)
        terms = heights.new_zeros(len(heights), max(IRREGULAR[-1], len(base)))
        terms[:, IRREGULAR[0] - 1 : IRREGULAR[-1]] = heights
        terms[:, : len(base)] += base
        curvature, conic = (values[key][:, place] for key in ("curvature", "conic"))
        shapes[place] = ZernikeFreeform(curvature, conic, terms, heights.new_tensor(reach))
    return tuple(shapes)


def _turn(system, values: dict[Any, Any], places: list[int], angles: torch.Tensor, item: Perturbation) -> None:
    """Turn surfaces as one rigid body by angles ``[samples, 1 or 2]`` in degrees, in place of their numbers.

    The vertex of each surface moves across the axis by its shift, and along it by the distances on both sides.
    """
    first, last = min(places), max(places)
    if any(is_break(system.surfaces[i]) for i in range(first, last + 1)):
        raise ValueError(f"surfaces {places} have a coordinate break among them: they cannot be turned as a body")
    if item.relative:
        raise ValueError(f"{item.name} of a body has no number of which {item.size} could be a share")
    pad = torch.nn.functional.pad
    turn = pad(angles, (2, 0)) if item.name == "roll" else pad(angles, (0, 1))
    body = _matrix(turn)
    values["tilt"] = pad(values["tilt"], (0, 3 - values["tilt"].shape[-1])).clone()
    shift, thickness = values["shift"].clone(), values["thickness"].clone()
    along, moved = values["thickness"], {}
    for i in sorted(places) if item.together else ():
        height = along[:, first:i].sum(-1) - item.pivot
        vertex = torch.cat([shift[:, i], height[:, None]], -1)
        turned = (body @ vertex[..., None])[..., 0]
        shift[:, i], moved[i] = turned[:, :2], turned[:, 2] - height
    for i in places:
        whole = body @ _matrix(values["tilt"][:, i])
        x, y = torch.asin(-whole[:, 1, 2]), torch.atan2(whole[:, 0, 2], whole[:, 2, 2])
        z = torch.atan2(whole[:, 1, 0], whole[:, 1, 1])
        values["tilt"][:, i] = torch.rad2deg(torch.stack([x, y, z], -1))
    for i, distance in moved.items():
        if i:
            thickness[:, i - 1] += distance
        thickness[:, i] -= distance
    values["shift"], values["thickness"] = shift, thickness


def _matrix(degrees: torch.Tensor) -> torch.Tensor:
    """Return the rotations of tilts ``[..., 3]`` as matrices ``[..., 3, 3]``."""
    rows = placement(torch.zeros_like(degrees[..., :2]), torch.deg2rad(degrees)).matrix
    zero = 0 * degrees[..., 0]
    return torch.stack([torch.stack([value + zero for value in row], -1) for row in rows], -2)


def _dispersed(system, index: torch.Tensor, change: torch.Tensor, relative: bool) -> torch.Tensor:
    """Return indices ``[samples, W, S + 1]`` with deviations of the Abbe numbers behind the surfaces, ``[samples, S]``.

    The index at the reference wavelength remains, differences from it are divided by the ratio of the Abbe numbers.
    """
    found = index.clone()
    for i, item in enumerate(system.surfaces):
        if not bool(change[:, i].any()):
            continue
        if not isinstance(item.material, OpticalMaterial):
            raise ValueError(f"abbe of surfaces[{i}] cannot be perturbed: the medium behind it has no dispersion")
        number = 1.0 if relative else item.material.abbe_number()
        middle = index[:, system.reference : system.reference + 1, i + 1]
        found[..., i + 1] = middle + (index[..., i + 1] - middle) / (1 + change[:, i : i + 1] / number)
    return found


def _draw(item: Perturbation, samples: int, places: int, axes: int, generator) -> torch.Tensor:
    kind = _validate.one_of("distribution", item.distribution, DISTRIBUTIONS)
    shape = (samples, 1 if item.together else places, axes)
    if kind == "normal":
        drawn = torch.randn(shape, generator=generator, dtype=torch.float64)
    else:
        drawn = 2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1
    # The squares of the parts of an irregularity add up to the square of its size.
    size = item.size / (axes**0.5 if item.name == "irregularity" else 1.0)
    return (size * drawn).expand(samples, places, axes)


def _changed(name: str, value, change, relative: bool):
    """Return the numbers with the deviation added, to the radius for curvatures."""
    if name in ("shift", "tilt"):
        return value + (value * change if relative else change)
    change = change[..., 0]
    if name == "radius":
        # c/(1 + cδ) for a radius that deviates by δ: a plane stays one.
        return value / (1 + (change if relative else value * change))
    if name == "index":
        # The first index belongs to the space in front.
        change = torch.nn.functional.pad(change, (1, 0))[:, None, :]
    return value + (value * change if relative else change)
