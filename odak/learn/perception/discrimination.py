"""Pictures that a differentiable model cannot tell apart, or tells apart best and least: metamers and distortions."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigsh

from odak import _torch_private, _validate
from odak._warnings import ConvergenceWarning, warn
from odak.learn._tensors import check_values, floating_tensor, in_float32, takes_constants
from odak.learn.perception.joint_statistics import CONVERGED, descended

Model = Callable[[torch.Tensor], Any]
# Relative error of the largest eigenvalue where the least ones are asked for.
ROUGHLY = 1e-3
# Steps back to the level of a measure that is held, and the relative error at which they end.
RETURNS, LEVEL_ERROR = 8, 1e-6
# First step along a measure as a fraction of the distance of the start; factors after a better and a worse picture.
FIRST_STEP, LONGER, SHORTER = 0.2, 1.5, 0.5


@takes_constants("bounds")
def metamer(
    model: Model,
    picture: torch.Tensor,
    start: torch.Tensor | None = None,
    iterations: int = 200,
    bounds: tuple[float, float] | None = (0.0, 1.0),
    seed: int = 0,
    progress: Callable[[], object] | None = None,
) -> torch.Tensor:
    """Return another picture to which a model responds as to a given one.

    Parameters
    ----------
    model : callable
        Any differentiable function of a picture, such as the statistics of a metameric loss, a display, a hologram with
        the eye that sees it, or a lens with its sensor. Returns a tensor, real or complex, or a list of them.
    picture : torch.Tensor
        Real floats ``[..., H, W]``, as the model takes it.
    start : torch.Tensor, optional
        Where the descent starts, in the shape of the picture; white noise between the bounds, or 0 and 1, by default.
    iterations : int
        Evaluations of the model, with which L-BFGS lowers the squared difference of the responses.
    bounds : tuple of float, optional
        Least and largest value of the result; None for none.
    seed : int
        Of the noise.
    progress : callable, optional
        Called without arguments at each evaluation.

    Returns
    -------
    torch.Tensor
        In the shape of the picture.

    Raises
    ------
    ValueError, TypeError
        If the picture, the start or the bounds are none, or the response of the model is no tensor.

    Warns
    -----
    ConvergenceWarning
        If the responses differ by more than a tenth of what those to the start differ by.

    Notes
    -----
    Of a linear model and without bounds it is the start, projected onto the pictures with the given response. Freeman
    and Simoncelli, Nat. Neurosci. 14, 1195 (2011).

    Examples
    --------
    A sensor whose pixels are four of the picture's:

    >>> import torch
    >>> from odak.learn.perception import metamer
    >>> sensor = torch.nn.AvgPool2d(2)
    >>> picture = torch.rand(1, 1, 16, 16, generator=torch.Generator().manual_seed(1))
    >>> other = metamer(sensor, picture)
    >>> torch.allclose(sensor(other), sensor(picture), atol=1e-4), torch.allclose(other, picture, atol=0.1)
    (True, False)
    """
    model, kind = _validate.function("model", model), getattr(picture, "dtype", None)
    progress, picture = _validate.function_or_none("progress", progress), _checked("picture", picture)
    low, high = (0.0, 1.0) if bounds is None else _validate.several("bounds", bounds, 2)
    if not low < high:
        raise ValueError(f"bounds must be two numbers, the smaller one first, got {bounds!r}")
    iterations = _validate.integer("iterations", iterations)
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    with _torch_private.keeping(), torch.no_grad():
        if start is None:
            noise = torch.rand(picture.shape, dtype=torch.float64, generator=generator).to(picture)
            start = low + (high - low) * noise
        start = _checked("start", start, picture.shape)
        wanted = _response(model, picture.clone())

        def distance(one):
            return (_response(model, one) - wanted).square().mean()

        def held(one):
            return one if bounds is None else one.clamp(low, high)

        made = descended(start.to(picture), held, distance, iterations, progress, steepness=0.0, told=CONVERGED)
        return made.to(kind)


def eigendistortions(
    model: Model,
    picture: torch.Tensor,
    count: int = 1,
    least: bool = False,
    tolerance: float = 1e-6,
    seed: int = 0,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the distortions of a picture that change the response of a model most, or least.

    Parameters
    ----------
    model : callable
        Any function of a picture that can be differentiated twice and returns a tensor or a list of tensors. A loss has
        no slope at its minimum: take its statistics.
    picture : torch.Tensor
        Real floats ``[..., H, W]``.
    count : int
        Number of distortions, less than the number of pixels.
    least : bool
        The least visible ones, which converge more slowly, instead of the most visible ones.
    tolerance : float
        Error of the eigenvalues relative to the largest one.
    seed : int
        Of the vector that the iteration starts from.

    Returns
    -------
    tuple of torch.Tensor
        Squared change of the response per squared distortion ``[count]``, and distortions ``[count, ..., H, W]`` of
        norm 1, orthogonal to one another; the most visible one first, with `least` the least visible one.

    Raises
    ------
    ValueError, TypeError
        If the picture or an argument is none.

    Warns
    -----
    ConvergenceWarning
        If not all were found to the tolerance; those that were are returned.

    Notes
    -----
    Eigenvectors of JᵀJ, J being the Jacobian of the response, by Lanczos iteration (SciPy's ``eigsh``): Berardino et
    al., NeurIPS 30 (2017). Of a linear model they are its right singular vectors, and the values are the squares of its
    singular values.

    Examples
    --------
    A sensor of large pixels sees a change of all of its values best:

    >>> import torch
    >>> from odak.learn.perception import eigendistortions
    >>> values, distortions = eigendistortions(torch.nn.AvgPool2d(8), torch.rand(1, 1, 8, 8))
    >>> round(float(values[0]), 5), bool(distortions.std() < 1e-5)
    (0.01562, True)
    """
    model, kind = _validate.function("model", model), getattr(picture, "dtype", None)
    picture = _checked("picture", picture)
    count = _validate.integer("count", count, minimum=1)
    size = picture.numel()
    if count >= size:
        raise ValueError(f"count must be less than the {size} values of the picture, got {count}")
    least = _validate.flag("least", least)
    tolerance = _validate.constant("tolerance", tolerance, positive=True)
    start = np.random.default_rng(_validate.integer("seed", seed)).standard_normal(size)
    with _torch_private.keeping(), torch.enable_grad():
        free = picture.clone().requires_grad_()
        response = _response(model, free)
        # The gradient is linear in `weights`, and its derivative in them is the product with the Jacobian.
        weights = torch.zeros_like(response, requires_grad=True)
        (slope,) = torch.autograd.grad(response, free, weights, create_graph=True)

        def twice(values):
            direction = torch.from_numpy(values.reshape(picture.shape)).to(free)
            (change,) = torch.autograd.grad(slope, weights, direction, retain_graph=True)
            (found,) = torch.autograd.grad(response, free, change, retain_graph=True)
            return found.detach().cpu().double().numpy().ravel()

        def largest(product, number, precision):
            operator = LinearOperator((size, size), matvec=product, dtype=np.float64)
            try:
                return eigsh(operator, number, which="LA", tol=precision, v0=start)
            except ArpackNoConvergence as error:
                warn(
                    f"{len(error.eigenvalues)} of {number} distortions converged to {precision:g}: take fewer, a "
                    "larger tolerance or a smaller picture",
                    ConvergenceWarning,
                )
                return error.eigenvalues, error.eigenvectors
            except ArpackError as error:
                raise ValueError(
                    "the response of model must change with the picture, got none to first order at this picture"
                ) from error

        if least:
            # Values near 0 are not resolved relative to themselves: these are the largest ones of a difference.
            top = 1.01 * largest(twice, 1, ROUGHLY)[0].max(initial=0.0)
            values, vectors = largest(lambda one: top * one.ravel() - twice(one), count, tolerance)
            values = top - values
        else:
            values, vectors = largest(twice, count, tolerance)
    order = np.argsort(values if least else -values)
    found = torch.from_numpy(np.ascontiguousarray(vectors[:, order].T)).to(picture.device, kind)
    return torch.from_numpy(values[order]).to(picture.device, kind), found.reshape(-1, *picture.shape)


def maximum_differentiation(
    held: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
    driven: Callable[[torch.Tensor, torch.Tensor], torch.Tensor],
    picture: torch.Tensor,
    start: torch.Tensor,
    largest: bool = True,
    iterations: int = 200,
    progress: Callable[[], object] | None = None,
) -> torch.Tensor:
    """Return a picture that one measure takes for as good as another picture, and a second one for the worst or best.

    Parameters
    ----------
    held : callable
        Measure of the difference of two pictures that stays as it is: a tensor without axes, such as the value of a
        loss, differentiable in the first picture.
    driven : callable
        Measure of the same kind that is made large or small.
    picture : torch.Tensor
        The reference ``[..., H, W]``, the second argument of both.
    start : torch.Tensor
        A distorted picture in the same shape, whose value of `held` is kept.
    largest : bool
        Drive the second measure up; down otherwise.
    iterations : int
        Steps along the gradient of the second measure; each evaluates both a few times.
    progress : callable, optional
        Called without arguments at each step.

    Returns
    -------
    torch.Tensor
        In the shape of the picture, not clipped.

    Raises
    ------
    ValueError, TypeError
        If a picture is none, or a measure returns more than a number.

    Notes
    -----
    Wang and Simoncelli, J. Vis. 8(12):8 (2008): a pair of such pictures, one with the largest and one with the smallest
    value, shows where two measures disagree, and an observer decides which of them is right. Each step goes along the
    part of one gradient that is orthogonal to the other, and back to the level by Newton steps.

    Examples
    --------
    Of all distortions of one squared error, the difference of neighbours is largest for the finest checkerboard:

    >>> import torch
    >>> from odak.learn.perception import maximum_differentiation
    >>> flat = torch.full((1, 1, 4, 4), 0.5)
    >>> noisy = flat + 0.1 * torch.randn(flat.shape, generator=torch.Generator().manual_seed(0))
    >>> error = torch.nn.MSELoss()
    >>> def roughness(one, two):
    ...     return (one - two).diff(dim=-1).square().sum() + (one - two).diff(dim=-2).square().sum()
    >>> found = maximum_differentiation(error, roughness, flat, noisy)
    >>> bool((error(found, flat) / error(noisy, flat) - 1).abs() < 1e-5)
    True
    >>> (found - flat)[0, 0, 1, :2].sign().abs().tolist(), bool((found - flat)[0, 0, 1, :2].prod() < 0)
    ([1.0, 1.0], True)
    """
    held, driven = _validate.function("held", held), _validate.function("driven", driven)
    progress, kind = _validate.function_or_none("progress", progress), getattr(picture, "dtype", None)
    picture = _checked("picture", picture)
    found = _checked("start", start, picture.shape).to(picture)
    sign = 1.0 if _validate.flag("largest", largest) else -1.0
    iterations = _validate.integer("iterations", iterations)

    def slope(measure, name, one):
        with torch.enable_grad():
            free = one.detach().requires_grad_()
            value = measure(free, picture)
            if not isinstance(value, torch.Tensor) or value.numel() != 1:
                raise TypeError(f"{name} must return a tensor of one number, got {value!r:.80}")
            return value.detach(), torch.autograd.grad(value.sum(), free)[0]

    with _torch_private.keeping(), torch.no_grad():
        picture, found = picture.clone(), found.clone()
        level, normal = slope(held, "held", found)
        value, along = slope(driven, "driven", found)
        step = FIRST_STEP * float(torch.linalg.vector_norm(found - picture))
        for _ in range(iterations):
            power = normal.square().sum()
            tangent = sign * (along - (along * normal).sum() / power.clamp_min(torch.finfo(power.dtype).tiny) * normal)
            length = float(torch.linalg.vector_norm(tangent))
            if not length:
                break
            trial = found + step / length * tangent
            for _ in range(RETURNS):
                reached, direction = slope(held, "held", trial)
                if (reached - level).abs() <= LEVEL_ERROR * level.abs():
                    break
                trial = trial - (reached - level) / direction.square().sum() * direction
            better = bool((reached - level).abs() <= LEVEL_ERROR * level.abs())
            if better:
                trial_value, trial_along = slope(driven, "driven", trial)
                better = bool(sign * (trial_value - value) > 0)
            if better:
                found, value, along, normal = trial, trial_value, trial_along, direction
            step *= LONGER if better else SHORTER
            if progress is not None:
                progress()
    return found.to(kind)


def _checked(name, picture, shape=None):
    """Return a picture ``[..., H, W]`` without its graph after checking it."""
    floating_tensor(name, picture, "a tensor of real floats [..., H, W]")
    _validate.shaped(name, picture, "[..., H, W], none empty")
    if shape is not None and picture.shape != shape:
        raise ValueError(f"{name} must be of the picture's shape {tuple(shape)}, got {tuple(picture.shape)}")
    check_values(**{name: picture})
    return in_float32(picture.detach())


def _response(model, picture):
    """Return all responses of a model as one vector of reals."""
    found = model(picture)
    parts = found if isinstance(found, (list, tuple)) else [found]
    if not parts or not all(isinstance(part, torch.Tensor) for part in parts):
        raise TypeError(f"model must return a tensor or a list of tensors, got {type(found).__name__}")
    real = [one for part in parts for one in ((part.real, part.imag) if part.is_complex() else (part,))]
    return torch.cat([one.flatten() for one in real])
