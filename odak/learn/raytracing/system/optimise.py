"""Optimisation by Levenberg and Marquardt's method, and Monte Carlo tolerances."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.analysis import rms_spot
from odak.learn.raytracing.system.surfaces import Prescription, checked_system

NAMES = ("curvature", "radius", "conic", "thickness", "index", "shift", "tilt")
DISTRIBUTIONS = ("normal", "uniform")


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
        Takes nothing and returns the residuals ``[R]`` at the parameters as they are. NaN counts as a failed step.
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
    _validate.function("residuals", residuals)
    _validate.function_or_none("callback", callback)
    _validate.number("damping", damping, positive=True)
    _validate.number("tolerance", tolerance, least=0)
    if not isinstance(parameters, Iterable):
        raise TypeError(f"parameters must be a sequence of tensors, got {type(parameters).__name__}")
    parameters = list(parameters)
    if not parameters or not all(isinstance(p, torch.Tensor) and p.is_leaf and p.requires_grad for p in parameters):
        raise ValueError("parameters must be leaf tensors that require grad, at least one")
    _validate.integer("iterations", iterations, minimum=1)
    value, jacobian = _linearised(residuals, parameters)
    loss = 0.5 * float(value @ value)
    if not loss < float("inf"):
        raise ValueError("residuals must be finite at the start; are rays lost?")
    history, converged = [loss], False
    for number in range(1, iterations + 1):
        normal, slope = jacobian.T @ jacobian, jacobian.T @ value
        scale = normal.diagonal().clamp(min=1e-12 * float(normal.diagonal().amax()) or 1e-300)
        step, loss, damping = _step(residuals, parameters, normal, slope, scale, loss, damping)
        if step is None:
            converged = True
            break
        history.append(loss)
        size = float(torch.cat([p.detach().reshape(-1) for p in parameters]).norm())
        small = float(step.norm()) <= tolerance * (size + tolerance)
        if (callback is not None and callback(number, loss)) or small or history[-2] - loss <= tolerance * history[-2]:
            converged = small or history[-2] - loss <= tolerance * history[-2]
            break
        value, jacobian = _linearised(residuals, parameters)
    return LevenbergMarquardtResult(loss, tuple(history), converged)


def _step(residuals, parameters, normal, slope, scale, loss, damping):
    """Take the first step that lowers the loss, with rising damping; return it (or None), loss and damping."""
    before = [p.detach().clone() for p in parameters]
    for _ in range(24):
        step = -torch.linalg.solve(normal + torch.diag(damping * scale), slope)
        with torch.no_grad():
            places = step.split([p.numel() for p in parameters])
            for p, old, change in zip(parameters, before, places, strict=True):
                p.copy_(old + change.reshape(p.shape).to(p))
            value = residuals().reshape(-1).double()
            new = 0.5 * float(value @ value)
        if new < loss:
            return step, new, max(damping / 5, 1e-15)
        damping *= 4
    with torch.no_grad():
        for p, old in zip(parameters, before, strict=True):
            p.copy_(old)
    return None, loss, damping


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


class Perturbation(NamedTuple):
    """Statistical deviation of a number of a system.

    Attributes
    ----------
    name : str
        "curvature", "radius", "conic", "thickness", "index" (of what is behind the surface), "shift" or "tilt" (in
        degrees; both of x and y alike).
    surfaces : int or sequence of int
        Of which surfaces, each drawn on its own.
    size : float
        Standard deviation, or half the width of a uniform distribution; in the unit of the number.
    relative : bool
        Whether `size` is a share of the number itself.
    distribution : str
        "normal" or "uniform".
    together : bool
        Draw once for all the surfaces: a lens that is shifted as a whole.

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


def tolerance(
    system: Any,
    perturbations: Sequence[Perturbation],
    samples: int = 200,
    seed: int = 0,
    *,
    merit: Callable | None = None,
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
        ``merit(system, prescription=…)``, returns ``[samples, …]``; :func:`rms_spot` by default.

    Returns
    -------
    ToleranceResult
        Its merits are differentiable in the system's parameters if these are.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, load_system, tolerance
    >>> off = [Perturbation("radius", [0, 1], 1e-3, relative=True), Perturbation("tilt", 2, 0.02)]
    >>> tuple(tolerance(load_system("cooke_triplet"), off, samples=10).merit.shape)
    (10, 3)
    """
    samples = _validate.integer("samples", samples, minimum=1)
    nominal = checked_system(system).prescription()
    merit = rms_spot if merit is None else _validate.function("merit", merit)
    numbers = perturbed(system, nominal, perturbations, samples, seed)
    return ToleranceResult(merit(system, prescription=numbers), merit(system, prescription=nominal), numbers)


def perturbed(system, nominal: Prescription, perturbations, samples: int, seed: int) -> Prescription:
    """Return a batch of prescriptions with random numbers added."""
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    perturbations = list(perturbations) if isinstance(perturbations, Iterable) else [perturbations]
    if not all(isinstance(item, Perturbation) for item in perturbations):
        raise TypeError(f"perturbations must be a sequence of Perturbation, got {perturbations!r:.80}")
    count = len(system.surfaces)
    values = nominal._asdict()
    apart = {name: values.pop(name) for name in ("shapes", "phases", "wavelengths", "gradients")}
    for name in ("shift", "tilt"):
        if values[name] is None:
            values[name] = torch.zeros(count, 2, dtype=torch.float64, device=nominal.thickness.device)
    values = {name: value.expand(samples, *value.shape) for name, value in values.items()}
    for item in perturbations:
        name = _validate.one_of("name of a perturbation", item.name, NAMES)
        places = list(item.surfaces) if isinstance(item.surfaces, Iterable) else [item.surfaces]
        places = [_validate.place_in("surfaces of a perturbation", place, count) for place in places]
        shaped = [i for i in places if nominal.shapes is not None and nominal.shapes[i] is not None]
        if shaped and name in ("curvature", "radius", "conic"):
            raise ValueError(f"{name} of surfaces {shaped} cannot be perturbed: their shapes have other numbers")
        axes = values[name].shape[-1] if name in ("shift", "tilt") else 1
        drawn = _draw(item, samples, len(places), min(axes, 2), generator)
        drawn = torch.nn.functional.pad(drawn, (0, max(axes - 2, 0)))
        target = "curvature" if name == "radius" else name
        change = torch.zeros(samples, count, drawn.shape[-1], dtype=torch.float64)
        for column, place in enumerate(places):
            change[:, place] += drawn[:, column]
        values[target] = _changed(name, values[target], change.to(values[target].device), item.relative)
    # Without shifts and tilts the fused kernel is used.
    for name in ("shift", "tilt"):
        if not bool(values[name].any()):
            values[name] = None
    return Prescription(**values, **apart)


def _draw(item: Perturbation, samples: int, places: int, axes: int, generator) -> torch.Tensor:
    kind = _validate.one_of("distribution", item.distribution, DISTRIBUTIONS)
    _validate.real("size of a perturbation", item.size)
    shape = (samples, 1 if item.together else places, axes)
    if kind == "normal":
        drawn = torch.randn(shape, generator=generator, dtype=torch.float64)
    else:
        drawn = 2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1
    return (item.size * drawn).expand(samples, places, axes)


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
