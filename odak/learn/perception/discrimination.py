"""Pictures that a differentiable model cannot tell apart, or tells apart best and least: metamers and distortions."""

import bisect
import itertools
import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigsh

from odak import _torch_private, _validate
from odak._warnings import ConvergenceWarning, warn
from odak.learn._tensors import check_values, floating_tensor, in_float32, takes_constants
from odak.learn.perception.joint_statistics import CONVERGED, OUTSIDE_WEIGHT, STEEPNESS, descended
from odak.learn.tools.file import read_torch_file, save_torch_tensor
from odak.tools.paths import validate_path

Model = Callable[[torch.Tensor], Any]
# Relative error of the largest eigenvalue where the least ones are asked for.
ROUGHLY = 1e-3
# Steps back to the level of a measure that is held, and the relative error at which they end.
RETURNS, LEVEL_ERROR = 8, 1e-6
# First step along a measure as a fraction of the distance of the start; factors after a better and a worse picture.
FIRST_STEP, LONGER, SHORTER = 0.2, 1.5, 0.5
# Evaluations after which the first stages of a descent end, the highest frequencies in cycles per pixel that change in
# them, and the length of later stages.
_STAGE_ENDS, _CUTS, _LONG = (25, 50, 100), (1 / 16, 1 / 8, 1 / 4), 100


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
    model = _validate.function("model", model)
    start = "noise" if start is None else start
    # As one vector, each of whose values counts alike.
    bench = Metamer(lambda one: _response(model, one), picture, start, bounds=bounds, seed=seed, by_scales=False)
    bench.limit = CONVERGED
    return bench.run(iterations, progress).pictures[0]


class Metamer:
    """Pictures to which a model responds as to a given one: several samples, whose descent can be followed and resumed.

    Parameters
    ----------
    model : callable
        Any differentiable function of a picture that returns a tensor or a list of them, each of which counts alike,
        such as a :class:`PooledModel`.
    picture : torch.Tensor
        Real floats ``[..., H, W]``, as the model takes it.
    start : "noise", "picture" or torch.Tensor
        Where each descent starts: white noise between the bounds, the picture with a tenth of such noise, or another
        picture in the same shape. Pairs of samples that start from natural pictures are told apart at smaller scalings
        than pairs from noise.
    samples : int
        Number of pictures, each with noise of its own.
    bounds : tuple of float, optional
        Least and largest value; None for none.
    limit : float
        Distance below which a sample counts as a metamer, as a share of the distance of its start.
    seed : int
        Of the noise of the first sample; the next ones take the numbers that follow.
    by_scales : bool
        Change coarse structures first, then finer ones.

    Attributes
    ----------
    pictures : torch.Tensor
        The samples ``[N, ..., H, W]``.
    curves : list of list of float
        For each sample the least distance after each evaluation, as a share of that of its start.

    Raises
    ------
    ValueError, TypeError
        If an argument is none of these.

    Notes
    -----
    Distance: root of the mean over tensors of the mean squared difference. It goes down by L-BFGS in stages of 25, 25,
    50 and then 100 evaluations, of which the first three change frequencies up to 1/16, 1/8 and 1/4 cycle per pixel;
    without `by_scales` each run is one stage. How the start counts was measured by Broderick et al., eLife 12, RP90554
    (2023).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import Metamer
    >>> picture = torch.rand(1, 1, 16, 16, generator=torch.Generator().manual_seed(1))
    >>> Metamer(torch.nn.AvgPool2d(4), picture, samples=2).run(150)
    Metamer: 2 samples after 150 evaluations, converged within 1 %
    """

    @takes_constants("bounds")
    def __init__(
        self,
        model: Model,
        picture: torch.Tensor,
        start: str | torch.Tensor = "noise",
        *,
        samples: int = 1,
        bounds: tuple[float, float] | None = (0.0, 1.0),
        limit: float = 0.01,
        seed: int = 0,
        by_scales: bool = True,
    ) -> None:
        self.model: Model = _validate.function("model", model)
        self.picture: torch.Tensor = _checked("picture", picture).clone()
        self._kind = picture.dtype
        low, high = (0.0, 1.0) if bounds is None else _validate.few("bounds", bounds, 2, rising=True)
        self._bounds = None if bounds is None else (low, high)
        count, seed = _validate.integer("samples", samples, minimum=1), _validate.integer("seed", seed)
        self.limit: float = _validate.constant("limit", limit, positive=True, below=1)
        self._by_scales: bool = _validate.flag("by_scales", by_scales)
        drawn = []
        for number in range(seed, seed + count):
            generator = torch.Generator().manual_seed(number)
            noise = torch.rand(self.picture.shape, dtype=torch.float64, generator=generator).to(self.picture)
            drawn.append(low + (high - low) * noise)
        if isinstance(start, torch.Tensor):
            drawn = [_checked("start", start, self.picture.shape).to(self.picture)] * count
            if count > 1:
                raise ValueError(f"samples must be 1 from one picture, whose samples would be equal, got {count}")
        elif _validate.one_of("start", start, ("noise", "picture")) == "picture":
            drawn = [0.9 * self.picture + 0.1 * one for one in drawn]
        with _torch_private.keeping(), torch.no_grad():
            self._drawn = [self._held(one) for one in drawn]
            self._wanted = _parts(self.model, self.picture.clone())
            self._units = [float(self._squared(one)) for one in self._drawn]
        self.curves: list[list[float]] = [[] for _ in drawn]

    @property
    def pictures(self) -> torch.Tensor:
        """The samples."""
        return torch.stack(self._drawn).to(self._kind)

    @property
    def distances(self) -> list[float]:
        """Distance of each sample, as a share of that of its start."""
        return [curve[-1] if curve else 1.0 for curve in self.curves]

    @property
    def evaluations(self) -> int:
        """Evaluations that each sample has had."""
        return len(self.curves[-1])

    def run(
        self,
        iterations: int = 400,
        progress: Callable[[], object] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
    ) -> "Metamer":
        """Lower the distances.

        Parameters
        ----------
        iterations : int
            Evaluations of the model for each sample, beside those that it has had.
        progress : callable, optional
            Called without arguments at each evaluation.
        checkpoint : str or os.PathLike, optional
            A ``.pt`` file that is written after each stage of each sample; see :meth:`resume`.

        Returns
        -------
        Metamer
            This object.

        Warns
        -----
        ConvergenceWarning
            If a sample is farther from the picture than the limit.
        """
        aim = self.evaluations + _validate.integer("iterations", iterations)
        _validate.function_or_none("progress", progress)
        if checkpoint is not None:
            checkpoint = validate_path(checkpoint, [".pt"], name="checkpoint")
        with _torch_private.keeping(), torch.no_grad():
            for index, curve in enumerate(self.curves):
                while len(curve) < aim:
                    self._stage(index, aim, progress)
                    if checkpoint is not None:
                        self.save(checkpoint)
        if (apart := max(self.distances)) > self.limit:
            warn(
                f"not converged after {self.evaluations} evaluations: the statistics are {100 * apart:.2g} % as far "
                "apart as at the start; give more iterations, or a start that is nearer",
                ConvergenceWarning,
            )
        return self

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the samples and their curves to a ``.pt`` file.

        Parameters
        ----------
        path : str or os.PathLike
            The file; an older one stays as it was until the new one is complete.
        """
        save_torch_tensor(path, {"pictures": self._drawn, "curves": self.curves, "units": self._units})

    def resume(self, path: str | os.PathLike[str]) -> "Metamer":
        """Take the samples of a file of :meth:`save`, and return this object.

        A run that was ended goes on after its last complete stage, to the same bits as one that was not.

        Parameters
        ----------
        path : str or os.PathLike
            File of an object that was made with the same arguments.

        Raises
        ------
        ValueError
            If the file is none of these, or of another model, picture or start.
        """
        found = read_torch_file(validate_path(path, [".pt"]), torch.device("cpu"))
        if not isinstance(found, dict) or not {"pictures", "curves", "units"} <= found.keys():
            raise ValueError(f"path must be a file of Metamer.save, got {os.fspath(path)!r}")
        kept = found["pictures"]
        same = len(kept) == len(self._drawn) and all(one.shape == self.picture.shape for one in kept)
        if not same or not np.allclose(found["units"], self._units, rtol=1e-4):
            raise ValueError(f"path must be of the same model, picture, start and seeds, got {os.fspath(path)!r}")
        self._drawn, self.curves, self._units = [one.to(self.picture) for one in kept], found["curves"], found["units"]
        return self

    def pairs(self, original: bool = False) -> list[tuple[torch.Tensor, torch.Tensor]]:
        """Return all pairs of two samples, or of the picture and a sample.

        Parameters
        ----------
        original : bool
            Pair each sample with the picture.
        """
        samples = list(self.pictures)
        if _validate.flag("original", original):
            return [(self.picture.to(self._kind), one) for one in samples]
        return list(itertools.combinations(samples, 2))

    def __repr__(self) -> str:
        count, apart = len(self._drawn), max(self.distances)
        words = f"Metamer: {count} sample{'s' * (count > 1)} after {self.evaluations} evaluations, "
        if apart <= self.limit:
            return words + f"converged within {100 * self.limit:g} %"
        return words + f"did not converge: statistics {100 * apart:.2g} % apart"

    def _held(self, picture):
        return picture if self._bounds is None else picture.clamp(*self._bounds)

    def _squared(self, picture):
        found = _parts(self.model, picture)
        errors = [(one - two).square().mean() for one, two in zip(found, self._wanted, strict=True) if one.numel()]
        return torch.stack(errors).mean()

    def _stage(self, index, aim, progress):
        """Make the evaluations of the next stage of a sample, or those of it that are left."""
        curve, picture = self.curves[index], self._drawn[index]
        number = bisect.bisect_right(_STAGE_ENDS, len(curve))
        if not self._by_scales:
            end = aim
        else:
            end = _STAGE_ENDS[number] if number < len(_STAGE_ENDS) else len(curve) + _LONG - len(curve) % _LONG
        count, best = min(end, aim) - len(curve), curve[-1] if curve else 1.0
        values: list[torch.Tensor] = []

        def distance(one):
            values.append(self._squared(one))
            return values[-1]

        if self._by_scales and number < len(_CUTS):
            rows, columns = picture.shape[-2:]
            along = (torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns))
            passed = (torch.hypot(*torch.broadcast_tensors(*along)) <= _CUTS[number]).to(picture)

            def held(free):
                change = torch.fft.irfft2(torch.fft.rfft2(free - picture) * passed, (rows, columns))
                return self._held(picture + change)

        else:
            held = self._held
        steepness = STEEPNESS if self._by_scales else 0.0
        made = descended(
            picture, held, distance, count, progress, steepness, OUTSIDE_WEIGHT if held == self._held else 0.0
        )
        for value in values[1 : count + 1]:
            best = min(best, math.sqrt(float(value) / self._units[index])) if self._units[index] else 0.0
            curve.append(best)
        curve += [best] * (count - len(values) + 1)
        self._drawn[index] = made


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
    return torch.cat([one.flatten() for one in _parts(model, picture)])


def _parts(model, picture):
    """Return the responses of a model as reals."""
    found = model(picture)
    parts = found if isinstance(found, (list, tuple)) else [found]
    if not parts or not all(isinstance(part, torch.Tensor) for part in parts):
        raise TypeError(f"model must return a tensor or a list of tensors, got {type(found).__name__}")
    return [torch.stack([part.real, part.imag]) if part.is_complex() else part for part in parts]
