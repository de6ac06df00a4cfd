"""Levenberg and Marquardt's method for any residuals that torch can differentiate."""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import torch

from odak import _validate


class LevenbergMarquardtResult(NamedTuple):
    """How a run ended.

    Attributes
    ----------
    loss : float
        Half the sum of squares at the end.
    history : tuple of float
        The same at the start and after each step taken.
    converged : bool
        Whether it ended because nothing changed any more.
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
    """Take the first step that helps, damping it more and more; return it (None if none does), the loss and damping."""
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
