"""Sums of Gaussians whose positions, sizes and heights are learned: images in two dimensions, densities in three."""

import itertools
import logging
import math
import os
from collections.abc import Callable, Mapping
from numbers import Integral
from types import MappingProxyType
from typing import Any

import torch
from torch import nn
from torch.utils.checkpoint import checkpoint

from odak import _validate
from odak._torch_private import differentiates
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import checked_device, takes_constants, tensor, trainable
from odak.learn.models.layers import features
from odak.learn.models.training import EXTENSIONS, load_weights, save_weights, train
from odak.learn.tools.function import evaluate_3d_gaussians
from odak.log import logger as _log
from odak.tools.paths import validate_path

# Number of Gaussians up to which the default widths are used as they are; more of them are narrower, so that together
# they cover the same area.
_FEW = 10
# Samples of an image per Gaussian that a fit by least squares uses at most.
_SAMPLES = 32
# Width of the first Gaussians over the distance of their centres.
_WIDTH = 1.3
# First damping of a fit, relative to the curvature along each parameter, and its products with the Jacobian per step.
_DAMPING, _PRODUCTS = 0.03, 8
_RANGES = {"widths": (0.1, 0.5), "offsets": (-1.0, 1.0), "rotations": (0.0, 2 * math.pi), "alphas": (0.1, 0.2)}


class gaussian_2d(nn.Module):
    """Two-dimensional Gaussians of limited height: tanh(α·exp(−(u/w₀)² − (v/w₁)²)).

    A point is first rotated by ρ, then shifted: u = x·cos ρ − y·sin ρ + o₀ and v = x·sin ρ + y·cos ρ + o₁.

    Parameters
    ----------
    number_of_elements : int
        Number N of Gaussians.

    Attributes
    ----------
    widths : torch.nn.Parameter
        Widths w, ``[2, 1, N]``.
    offsets : torch.nn.Parameter
        Offsets o, ``[2, 1, N]``.
    rotations : torch.nn.Parameter
        Rotations ρ in radians, ``[1, N]``.
    alphas : torch.nn.Parameter
        Heights α before the hyperbolic tangent, ``[1, N]``.

    Raises
    ------
    ValueError
        If the number is not a positive integer.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussian_2d
    >>> gaussian_2d(4)(torch.zeros(5, 1), torch.zeros(5, 1)).shape
    torch.Size([5, 4])
    """

    widths: nn.Parameter
    offsets: nn.Parameter
    rotations: nn.Parameter
    alphas: nn.Parameter

    def __init__(self, number_of_elements: int = 10):
        super().__init__()
        self.number_of_elements: int = _positive_integer("number_of_elements", number_of_elements)
        shapes = {"widths": (2, 1), "offsets": (2, 1), "rotations": (1,), "alphas": (1,)}
        for name, shape in shapes.items():
            self.register_parameter(name, nn.Parameter(torch.empty(*shape, self.number_of_elements)))
        self.initialize_parameters_uniformly()

    @torch.no_grad()
    def initialize_parameters_uniformly(self, ranges: Mapping[str, tuple[float, float]] | None = None) -> None:
        """Draw new parameters; despite the name of the method, from normal distributions.

        For an image use :meth:`initialize_from_image`.

        Parameters
        ----------
        ranges : dict, optional
            Range (a, b) of "widths", "offsets", "rotations" and "alphas", of mean (a + b)/2 and standard deviation
            (b − a)/4; the defaults are (0.1, 0.5), (−1, 1), (0, 2π) and (0.1, 0.2). The default of the widths is
            multiplied by √(10/N) for N above 10, so that the sum of the Gaussians does not grow with N.

        Raises
        ------
        ValueError
            If a name is unknown or a range is not ascending.
        """
        _validate.instance("ranges", ranges, (Mapping, type(None)), "a dict")
        ranges = {} if ranges is None else dict(ranges)
        _validate.known("ranges", ranges, _RANGES)
        narrower = min(1.0, math.sqrt(_FEW / self.number_of_elements))
        default = _RANGES | {"widths": tuple(narrower * end for end in _RANGES["widths"])}
        for name, (low, high) in {**default, **ranges}.items():
            for end in (low, high):
                _validate.real(f"ranges[{name!r}]", end)
            if not low <= high:
                raise ValueError(f"ranges[{name!r}] must ascend, got {(low, high)}")
            getattr(self, name).normal_((low + high) / 2, (high - low) / 4)

    @torch.no_grad()
    def initialize_from_image(
        self,
        image: torch.Tensor,
        x: torch.Tensor | None = None,
        y: torch.Tensor | None = None,
        *,
        seed: int | None = None,
    ) -> None:
        """Set the parameters so that the sum of the Gaussians approximates an image.

        Centres are spread by strata with a density that grows with the gradient of the image. Widths follow from this
        density, rotations from the structure tensor, and the heights are the least-squares solution. A density that
        follows the gradient is due to Y. Zhang et al., *Image-GS*, SIGGRAPH (2025).

        Parameters
        ----------
        image : torch.Tensor
            Intensities ``[H, W]``.
        x : torch.Tensor, optional
            Abscissae of the pixels ``[H, W]``; by default −1 to 1 along the columns.
        y : torch.Tensor, optional
            Ordinates of the pixels ``[H, W]``; by default −1 to 1 along the rows.
        seed : int, optional
            Seed of the centres; drawn from torch's generator by default.

        Raises
        ------
        ValueError
            If the shapes differ or the image has fewer than two rows or columns.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.models import gaussian_2d
        >>> y, x = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 40), indexing="ij")
        >>> image = 0.8 * torch.exp(-((x - 0.2) ** 2 + y**2) / 0.1)
        >>> gaussians = gaussian_2d(100)
        >>> gaussians.initialize_from_image(image, seed=0)
        >>> bool((gaussians.total(x, y)[..., 0] - image).square().mean() < 1e-3)
        True
        """
        image, x, y = self._sampled(image, x, y)
        generator = torch.Generator()
        generator.manual_seed(int(torch.randint(2**62, ())) if seed is None else _validate.integer("seed", seed))
        down, across = torch.gradient(image)
        # The constant covers even parts of the image.
        weight = _smooth(torch.hypot(down, across))
        weight = weight + 0.5 * weight.mean() + torch.finfo(weight.dtype).tiny
        # One centre in each of N parts of equal weight along a Z-shaped curve.
        rows, columns = (torch.arange(size, device=image.device) for size in image.shape)
        order = (_interleaved(rows)[:, None] * 2 + _interleaved(columns)).flatten().argsort()
        heaps = weight.flatten()[order].double().cumsum(0)
        count = self.number_of_elements
        parts = torch.arange(count) + torch.rand(count, generator=generator, dtype=torch.float64)
        chosen = order[torch.searchsorted(heaps, parts.to(heaps) / count * heaps[-1]).clamp(max=image.numel() - 1)]
        # Squared widths in pixels: of the area of one centre, longer along edges than across.
        area = (_WIDTH**2 * weight.sum() / count / weight).flatten()[chosen]
        xx, xy, yy = (_smooth(part).flatten()[chosen] for part in (across * across, across * down, down * down))
        coherence = torch.hypot(xx - yy, 2 * xy) / (xx + yy + torch.finfo(xx.dtype).eps)
        ratio, angle = 1 + 2 * coherence, torch.atan2(2 * xy, xx - yy) / 2
        axes = torch.stack([angle.cos(), angle.sin(), -angle.sin(), angle.cos()], dim=-1).view(-1, 2, 2)
        axes = axes * torch.stack([area / ratio, area * ratio], dim=-1).sqrt()[..., None]
        # From pixels to coordinates.
        slopes = torch.stack([part.flatten()[chosen] for z in (x, y) for part in torch.gradient(z)[::-1]], dim=-1)
        axes = axes @ slopes.view(-1, 2, 2).mT
        sizes, vectors = torch.linalg.eigh(axes.mT @ axes)
        self.widths.copy_(sizes.clamp_min(torch.finfo(sizes.dtype).eps).sqrt().T[:, None])
        self.rotations.copy_(torch.atan2(-vectors[:, 1, 0], vectors[:, 0, 0]))
        self._centre(slice(None), x.flatten()[chosen], y.flatten()[chosen])
        self.alphas.zero_()
        image, x, y = _reduced(image, x, y, count)
        self._improve(image, x, y, steps=2, heights_only=True)

    @takes_constants("moved")
    @torch.no_grad()
    def refine(
        self,
        image: torch.Tensor,
        x: torch.Tensor | None = None,
        y: torch.Tensor | None = None,
        *,
        steps: int = 30,
        moved: float = 0.1,
    ) -> None:
        """Bring the sum of the Gaussians closer to an image by damped least squares.

        Each step solves the linearised problem for all parameters by conjugate gradients (Höllein et al. 2025). Before
        every fourth step of the first three quarters, the weakest Gaussians move to where the image is approximated
        worst, so that their number stays (Kerbl et al. 2023; Kheradmand et al. 2024), until that no longer helps.

        Parameters
        ----------
        image : torch.Tensor
            Intensities ``[H, W]``. An image of many more pixels than the Gaussians can represent is reduced first.
        x : torch.Tensor, optional
            Abscissae of the pixels ``[H, W]``; by default −1 to 1 along the columns.
        y : torch.Tensor, optional
            Ordinates of the pixels ``[H, W]``; by default −1 to 1 along the rows.
        steps : int
            Number of steps.
        moved : float
            Share of the Gaussians that move at a time, 0 to 1.

        Raises
        ------
        ValueError
            If the shapes differ, the image has fewer than two rows or columns, or a number is outside its range.

        References
        ----------
        - B. Kerbl et al., *3D Gaussian splatting for real-time radiance field rendering*, ACM TOG 42 (2023).
        - S. Kheradmand et al., *3D Gaussian splatting as Markov chain Monte Carlo*, NeurIPS (2024).
        - X. Zhang et al., *GaussianImage*, ECCV (2024).
        - L. Höllein et al., *3DGS-LM: faster Gaussian-splatting optimization with Levenberg-Marquardt*, ICCV (2025).

        Examples
        --------
        >>> import torch
        >>> from odak.learn.models import gaussian_2d
        >>> y, x = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 40), indexing="ij")
        >>> image = 0.8 * torch.exp(-((x - 0.2) ** 2 + y**2) / 0.1)
        >>> gaussians = gaussian_2d(30)
        >>> gaussians.initialize_from_image(image, seed=0)
        >>> gaussians.refine(image, steps=8)
        >>> bool((gaussians.total(x, y)[..., 0] - image).square().mean() < 1e-5)
        True
        """
        steps = _validate.integer("steps", steps, minimum=0)
        moved = _validate.constant("moved", moved, least=0, most=1)
        image, x, y = self._sampled(image, x, y)
        image, x, y = _reduced(image, x, y, self.number_of_elements)
        count, error = int(moved * self.number_of_elements), self._improve(image, x, y, steps=0)
        for done in range(0, steps, 4):
            before = [parameter.clone() for parameter in self.parameters()]
            if count and done < 0.75 * steps:
                self._move(image, x, y, count)
                self._improve(image, x, y, steps=1, heights_only=True)
            reached = self._improve(image, x, y, steps=min(4, steps - done))
            if reached > error:
                count = 0
                self._restore(before)
            else:
                error = reached

    def _sampled(self, image, x, y):
        """Return an image and the coordinates of its pixels, checked."""
        image = features("image", image)
        _validate.shaped("image", image, "[2 or more, 2 or more], rows and columns")
        grid = torch.meshgrid(*(torch.linspace(-1, 1, size) for size in image.shape), indexing="ij")
        y, x = (found if given is None else given for given, found in zip((y, x), grid, strict=True))
        named = {"image": image, "x": features("x", x), "y": features("y", y)}
        _validate.alike(**named)
        for name, value in named.items():
            _validate.real(name, value)
        return [value.detach().to(self.alphas) for value in named.values()]

    def _centre(self, which, x, y):
        cosine, sine = self.rotations[0, which].cos(), self.rotations[0, which].sin()
        self.offsets[:, 0, which] = -torch.stack([x * cosine - y * sine, x * sine + y * cosine])

    def _move(self, image, x, y, count):
        """Move the `count` Gaussians of least energy to the largest residuals."""
        error = _smooth(self.total(x, y)[..., 0] - image).abs()
        largest = nn.functional.max_pool2d(error[None, None], 5, 1, 2)[0, 0]
        peaks = error.where(error == largest, 0).flatten().topk(min(count, error.numel())).indices
        weak = (self.alphas[0].tanh().abs() * self.widths.prod(0)[0].abs().sqrt()).argsort()[: len(peaks)]
        self.rotations[0, weak] = 0.0
        for width, z, size in zip(self.widths, (x, y), x.shape[::-1], strict=True):
            width[0, weak] = 2 * (z.max() - z.min()) / size
        self._centre(weak, x.flatten()[peaks], y.flatten()[peaks])
        self.alphas[0, weak] = 0.0

    def _improve(self, image, x, y, steps, heights_only=False):
        """Take Levenberg–Marquardt steps; return the sum of squared residuals."""
        points, damping = torch.stack([x.flatten(), y.flatten()], dim=-1), _DAMPING
        kept = slice(5, 6) if heights_only else slice(6)
        parts, residual = self._tangents(image, points, kept)
        for _ in range(steps):
            change = torch.zeros_like(self.alphas[0])[:, None].repeat(1, 6)
            change[:, kept] = _damped_solution(parts, residual, len(change), damping)
            before = [parameter.clone() for parameter in self.parameters()]
            self.offsets += change[:, 2:4].T[:, None] * self.widths
            self.widths *= change[:, :2].T[:, None].clamp(-0.5, 0.5).exp()
            self.rotations += change[:, 4]
            self.alphas.add_(change[:, 5]).clamp_(-3, 3)
            tried = self._tangents(image, points, kept)
            if tried[1].square().sum() < residual.square().sum():
                (parts, residual), damping = tried, max(damping / 3, _DAMPING / 30)
            else:
                damping *= 5
                self._restore(before)
        return residual.square().sum()

    def _restore(self, values):
        for parameter, value in zip(self.parameters(), values, strict=True):
            parameter.copy_(value)

    def _tangents(self, image, points, kept):
        """Return parts of the Jacobian by ln w, o/w, ρ and α, and the residuals."""
        rows, residual, parts = self._rows(), image.flatten().clone(), []
        for places, near in _runs(points, _boxes(rows, self.alphas[0], 1e-3)):
            values, u, v = points.new_empty(3, len(near), len(places))
            _exponentials(points[places], rows[near], values, v, u)
            alpha, (w0, w1), (o0, o1) = (
                z[..., near, None] for z in (self.alphas[0], self.widths[:, 0], self.offsets[:, 0])
            )
            limited = (alpha * values).tanh()
            residual[places] -= limited.sum(0)
            slope = (1 - limited.square()) * values
            along_u, along_v = -2 * alpha * slope * u, -2 * alpha * slope * v
            turned = along_v * (u * w0 - o0) / w1 - along_u * (v * w1 - o1) / w0
            columns = (-along_u * u, -along_v * v, along_u, along_v, turned, slope)[kept]
            parts.append((places, near, torch.stack(columns, dim=1)))
        return parts, residual

    def _rows(self):
        cosine, sine = self.rotations[0].cos(), self.rotations[0].sin()
        (w0, w1), (o0, o1) = self.widths[:, 0], self.offsets[:, 0]
        return torch.stack([cosine / w0, -sine / w0, o0 / w0, sine / w1, cosine / w1, o1 / w1], dim=-1)

    def forward(self, x: torch.Tensor, y: torch.Tensor, residual: float = 1e-6) -> torch.Tensor:
        """Return the value of each Gaussian at points.

        Parameters
        ----------
        x : torch.Tensor
            Abscissae ``[..., 1]``, or ``[...]`` with a last axis of another length, such as a grid ``[H, W]``.
        y : torch.Tensor
            Ordinates, of a shape that broadcasts against `x`.
        residual : float
            Without effect; accepted for compatibility.

        Returns
        -------
        torch.Tensor
            ``[..., N]``.
        """
        (residual,) = _validate.constants(residual=residual)
        x, y = _coordinates(x, y)
        cosine, sine = self.rotations.cos(), self.rotations.sin()
        u = (x * cosine - y * sine + self.offsets[0]) / self.widths[0]
        v = (x * sine + y * cosine + self.offsets[1]) / self.widths[1]
        return torch.tanh(self.alphas * torch.exp(-u.square() - v.square()))

    def total(self, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Return the sum of :meth:`forward` over the Gaussians ``[..., 1]``, in memory independent of N.

        Gaussians below rounding error are left out. Differentiable once, in the parameters and the coordinates.

        Parameters
        ----------
        x : torch.Tensor
            Abscissae ``[..., 1]``, or ``[...]`` with a last axis of another length, such as a grid ``[H, W]``.
        y : torch.Tensor
            Ordinates, of a shape that broadcasts against `x`.

        Returns
        -------
        torch.Tensor
            ``[..., 1]``.
        """
        x, y = torch.broadcast_tensors(*_coordinates(x, y))
        points = torch.stack([x.flatten(), y.flatten()], dim=-1)
        return sum_of_soft_gaussians(points, self._rows(), self.alphas[0]).view(x.shape)


class gaussians_2d(nn.Module):
    """An image as a sum of two-dimensional Gaussians, see :class:`gaussian_2d`.

    Parameters
    ----------
    number_of_elements : int
        Number of Gaussians.
    logger : logging.Logger, optional
        Logger for messages; the package's own by default.

    Attributes
    ----------
    model : gaussian_2d
        The Gaussians.
    number_of_elements : int
        Number of Gaussians.
    total_params : int
        Number of their parameters.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussians_2d
    >>> y, x = torch.meshgrid(torch.linspace(-1, 1, 8), torch.linspace(-1, 1, 12), indexing="ij")
    >>> gaussians_2d(100)(x, y).shape
    torch.Size([8, 12, 1])
    """

    def __init__(self, number_of_elements: int = 10, logger: logging.Logger | None = None):
        super().__init__()
        self.model: gaussian_2d = gaussian_2d(number_of_elements)
        self.number_of_elements: int = self.model.number_of_elements
        self.total_params: int = sum(parameter.numel() for parameter in self.parameters())
        if not (logger is None or hasattr(logger, "debug")):
            raise TypeError(f"logger must be a logging.Logger, got {type(logger).__name__}")
        self.logger: logging.Logger = _log if logger is None else logger
        self.logger.debug("%d Gaussians with %d parameters", self.number_of_elements, self.total_params)

    def forward(self, x: torch.Tensor, y: torch.Tensor, test: bool = False) -> torch.Tensor:
        """Return the sum of the Gaussians at points.

        Parameters
        ----------
        x : torch.Tensor
            Abscissae ``[..., 1]``, or ``[...]`` with a last axis of another length, such as a grid ``[H, W]``.
        y : torch.Tensor
            Ordinates, of a shape that broadcasts against `x`.
        test : bool
            Compute without gradients.

        Returns
        -------
        torch.Tensor
            ``[..., 1]``.
        """
        with torch.set_grad_enabled(torch.is_grad_enabled() and not _validate.flag("test", test)):
            return self.model.total(x, y)

    def initialize_from_image(
        self,
        image: torch.Tensor,
        x: torch.Tensor | None = None,
        y: torch.Tensor | None = None,
        *,
        seed: int | None = None,
    ) -> None:
        """Set the parameters so that the sum approximates an image, see :meth:`gaussian_2d.initialize_from_image`.

        Parameters
        ----------
        image : torch.Tensor
            Intensities ``[H, W]``.
        x : torch.Tensor, optional
            Abscissae of the pixels ``[H, W]``; by default −1 to 1 along the columns.
        y : torch.Tensor, optional
            Ordinates of the pixels ``[H, W]``; by default −1 to 1 along the rows.
        seed : int, optional
            Seed of the centres; drawn from torch's generator by default.
        """
        self.model.initialize_from_image(image, x, y, seed=seed)

    def refine(
        self,
        image: torch.Tensor,
        x: torch.Tensor | None = None,
        y: torch.Tensor | None = None,
        *,
        steps: int = 30,
        moved: float = 0.1,
    ) -> None:
        """Bring the sum closer to an image by damped least squares, see :meth:`gaussian_2d.refine`.

        Parameters
        ----------
        image : torch.Tensor
            Intensities ``[H, W]``.
        x : torch.Tensor, optional
            Abscissae of the pixels ``[H, W]``; by default −1 to 1 along the columns.
        y : torch.Tensor, optional
            Ordinates of the pixels ``[H, W]``; by default −1 to 1 along the rows.
        steps : int
            Number of steps.
        moved : float
            Share of the Gaussians that move at a time, 0 to 1.
        """
        self.model.refine(image, x, y, steps=steps, moved=moved)

    def save_weights(self, weights_filename: str | os.PathLike[str]) -> None:
        """Write the parameters to a ``.pt`` or ``.pth`` file, atomically.

        Parameters
        ----------
        weights_filename : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        validate_path(weights_filename, EXTENSIONS, name="weights_filename")
        save_weights(self, weights_filename)
        self.logger.info("Gaussians saved to %s", weights_filename)

    def load_weights(
        self,
        weights_filename: str | os.PathLike[str] | None = None,
        device: torch.device | str | None = "cpu",
    ) -> None:
        """Read the parameters from a file of :meth:`save_weights`, and switch to evaluation.

        Parameters
        ----------
        weights_filename : str or os.PathLike, optional
            ``.pt`` or ``.pth`` file; None does nothing.
        device : torch.device or str
            Device that the file is read to; the parameters stay on their own device.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the path is not acceptable, or the file is broken, would run code or holds other parameters.
        """
        if weights_filename is not None:
            validate_path(weights_filename, EXTENSIONS, name="weights_filename")
            load_weights(self, weights_filename, device=device)
            self.logger.info("Gaussians loaded from %s", weights_filename)


def _coordinates(x, y):
    for name, coordinate in (("x", x), ("y", y)):
        if not isinstance(coordinate, torch.Tensor) or coordinate.is_complex():
            raise TypeError(f"x and y must be real tensors, got {type(coordinate).__name__} for {name}")
    x, y = (
        coordinate if coordinate.ndim and coordinate.shape[-1] == 1 else coordinate.unsqueeze(-1)
        for coordinate in (trainable(x), trainable(y))
    )
    _validate.fitting(x=x, y=y)
    return x, y


# Neighbouring points that share one list of the Gaussians near them.
_RUN = 512
# Values computed at once: on a CPU they fit in the cache of a core, on a GPU they occupy it.
_PART = {"cpu": 1 << 18, "cuda": 1 << 25}
_CELLS = 1024


def sum_of_soft_gaussians(points: torch.Tensor, rows: torch.Tensor, alphas: torch.Tensor) -> torch.Tensor:
    """Return Σ tanh(α·exp(−u² − v²)) at points, u = A·x + B·y + C and v = D·x + E·y + F.

    Memory grows neither with the product of the numbers of points and Gaussians nor in the backward pass, which
    computes the values again, part by part.

    Parameters
    ----------
    points : torch.Tensor
        ``[p, 2]``.
    rows : torch.Tensor
        A, B, C, D, E and F of each Gaussian ``[n, 6]``.
    alphas : torch.Tensor
        ``[n]``.

    Returns
    -------
    torch.Tensor
        ``[p]``; differentiable in all three. Terms below the dtype's rounding error are left out. Second derivatives
        take memory for every pair of a point and a Gaussian.
    """
    dtype = torch.promote_types(points.dtype, torch.promote_types(rows.dtype, torch.float32))
    with torch.autocast(rows.device.type, enabled=False):
        return _Sum.apply(points.to(dtype), rows.to(dtype), alphas.to(dtype))


class _Sum(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, rows, alphas):
        ctx.save_for_backward(points, rows, alphas)
        result = points.new_zeros(len(points))
        for places, near, (values, v) in _parts(points, rows, alphas, 2):
            _exponentials(points[places], rows[near], values, v)
            total = values.mul_(alphas[near, None]).tanh_().sum(0)
            result.index_add_(0, places, total)
        return result

    @staticmethod
    def backward(ctx, gradient):
        points, rows, alphas = ctx.saved_tensors
        if torch.is_grad_enabled():
            needed = [tensor for tensor, need in zip(ctx.saved_tensors, ctx.needs_input_grad, strict=True) if need]
            whole = _all_terms(points, rows, alphas)
            slopes = iter(torch.autograd.grad(whole, needed, gradient, create_graph=True))
            return tuple(next(slopes) if need else None for need in ctx.needs_input_grad)
        gradients = [torch.zeros_like(tensor) for tensor in (points, rows, alphas)]
        for places, near, (values, u, v) in _parts(points, rows, alphas, 3):
            at, six, alpha = points[places], rows[near], alphas[near, None]
            _exponentials(at, six, values, v, u)
            factor = (1 - (alpha * values).tanh_().square_()).mul_(gradient[places]).mul_(values)
            gradients[2].index_add_(0, near, factor.sum(1))
            factor.mul_(-2 * alpha)
            coordinates = torch.cat([at, torch.ones_like(at[:, :1])], dim=1).T
            products = (u.mul_(factor), v.mul_(factor))
            gradients[1].index_add_(0, near, torch.cat([coordinates @ product.T for product in products]).T)
            if ctx.needs_input_grad[0]:
                gradients[0].index_add_(0, places, products[0].T @ six[:, :2] + products[1].T @ six[:, 3:5])
        return tuple(gradients)


def _all_terms(points, rows, alphas):
    """Return the sum from operations that torch differentiates any number of times."""
    places = torch.cat([points, torch.ones_like(points[:, :1])], dim=1)
    u, v = places @ rows[:, :3].T, places @ rows[:, 3:].T
    return torch.tanh(alphas * torch.exp(-u.square() - v.square())).sum(-1)


def _exponentials(points, rows, out, v, u=None):
    """Write exp(−u² − v²) ``[n, p]`` to `out`, v to `v`, and u to `u` if that is given."""
    x, y = points.unbind(-1)
    u = out if u is None else u
    for target, (along_x, along_y, offset) in ((u, rows[:, :3].T[..., None]), (v, rows[:, 3:].T[..., None])):
        torch.addcmul(offset, along_x, x, out=target).addcmul_(along_y, y)
    torch.mul(u, u, out=out).neg_().addcmul_(v, v, value=-1)
    # Exponentials that underflow take ten times as long as others.
    out.clamp_(min=math.log(torch.finfo(out.dtype).tiny)).exp_()


def _parts(points, rows, alphas, count):
    """Yield indices of some points and of the Gaussians near them, and `count` buffers ``[Gaussians, points]``."""
    at_once = max(1, _PART.get(points.device.type, _PART["cuda"]) // _RUN)
    memory = points.new_empty(count, at_once * _RUN)
    for places, close in _runs(points, _boxes(rows, alphas, torch.finfo(rows.dtype).eps)):
        for near in close.split(at_once):
            if len(near):
                shape = len(near), len(places)
                yield places, near, [part[: shape[0] * shape[1]].view(shape) for part in memory]


def _runs(points, boxes):
    """Yield indices of some points and of the Gaussians near them."""
    for places in _compact_runs(points, boxes):
        low, high = points[places].aminmax(dim=0)
        # With these comparisons a Gaussian with NaN is kept.
        far = ((boxes[0] > high) | (boxes[1] < low)).any(-1)
        yield places, (~far).nonzero()[:, 0]


def _boxes(rows, alphas, least):
    """Return the lower and upper corners ``[n, 2]`` of the boxes outside which terms are below `least`."""
    six, size = rows.double(), alphas.double().abs()
    reach = (size.clamp_min(1).log() - math.log(least)).sqrt()
    inverse = torch.linalg.inv_ex(torch.stack([six[:, :2], six[:, 3:5]], dim=1)).inverse
    centre = -(inverse @ six[:, [2, 5], None])[..., 0]
    half = inverse.square().sum(-1).sqrt() * reach[:, None]
    return centre - half, centre + half


def _compact_runs(points, boxes):
    """Return indices of points in runs, ordered along a Z-shaped curve unless most Gaussians cover most points."""
    order = torch.arange(len(points), device=points.device)
    if len(points) <= _RUN:
        return (order,) if len(points) else ()
    low, high = points.double().aminmax(dim=0)
    width = (high - low).clamp_min(torch.finfo(torch.float64).tiny)
    covered = (torch.minimum(boxes[1], high) - torch.maximum(boxes[0], low)).clamp_min(0) / width
    if bool(covered.prod(-1).mean() < 0.5):
        cells = ((points - low) / width.max() * (_CELLS - 1)).nan_to_num(0.0).long()
        order = torch.argsort(_interleaved(cells[:, 0]) | (_interleaved(cells[:, 1]) << 1))
    return order.split(_RUN)


def _interleaved(number):
    """Return integers below 2¹⁶ with a zero between each two of their bits (Morton 1966)."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        number = (number | (number << shift)) & mask
    return number


def _smooth(image):
    """Return means over 5 × 5 pixels."""
    return nn.functional.avg_pool2d(image[None, None], 5, 1, 2, count_include_pad=False)[0, 0]


def _reduced(image, x, y, count):
    """Return the three with at most so many pixels as a fit of `count` Gaussians uses."""
    factor = math.sqrt(_SAMPLES * count / image.numel())
    if factor >= 1:
        return image, x, y
    size = [max(2, round(factor * length)) for length in image.shape]
    return nn.functional.interpolate(torch.stack([image, x, y])[None], size, mode="area")[0]


def _damped_solution(parts, residual, count, damping):
    """Return the step ``[count, columns]`` of damped least squares by preconditioned conjugate gradients."""
    columns = parts[0][2].shape[1]
    right = residual.new_zeros(count, columns)
    blocks = residual.new_zeros(count, columns, columns)
    for places, near, part in parts:
        right.index_add_(0, near, (part.flatten(0, 1) @ residual[places, None]).view(-1, columns))
        blocks.index_add_(0, near, part @ part.mT)
    diagonal = blocks.diagonal(dim1=1, dim2=2)
    damped = damping * (diagonal + 0.01 * diagonal.mean(0)) + torch.finfo(right.dtype).tiny
    factors = torch.linalg.cholesky_ex(blocks + torch.diag_embed(damped)).L

    def preconditioned(vector):
        return torch.cholesky_solve(vector[..., None], factors)[..., 0]

    step, left = torch.zeros_like(right), right
    direction = aligned = preconditioned(left)
    power = (left * aligned).sum()
    for _ in range(_PRODUCTS * 6 // columns):
        image = damped * direction
        for _, near, part in parts:
            flat = part.flatten(0, 1)
            image.index_add_(0, near, (flat @ (direction[near].view(1, -1) @ flat).T).view(-1, columns))
        length = power / (direction * image).sum().clamp_min(torch.finfo(power.dtype).tiny)
        step, left = step + length * direction, left - length * image
        aligned = preconditioned(left)
        before, power = power, (left * aligned).sum()
        direction = aligned + power / before.clamp_min(torch.finfo(power.dtype).tiny) * direction
    return step


# Read-only, for it is a default argument.
DEFAULT_WEIGHTS = MappingProxyType(
    {
        "content": MappingProxyType({"l2": 1.0, "l1": 0.0}),
        "alpha": MappingProxyType({"smaller": 0.0, "larger": 0.0, "threshold": (0.0, 1.0)}),
        "scale": MappingProxyType({"smaller": 0.0, "larger": 0.0, "threshold": (0.0, 1.0)}),
        "angle": 0.0,
        "center": 0.0,
        "utilization": MappingProxyType({"l2": 0.0, "percentile": 0}),
    }
)


def volume_loss(
    model: "gaussian_3d_volume",
    estimate: torch.Tensor,
    ground_truth: torch.Tensor,
    epoch_id: int,
    epoch_count: int,
    weights: Mapping[str, Any],
) -> torch.Tensor:
    """Return the weighted sum of the terms whose weight is not zero.

    - content: l2·(mean squared difference) + l1·(mean absolute difference);
    - scale, alpha: smaller·Σ|p| over p < threshold[0], larger·Σp over p > threshold[1];
    - angle, center: Σ|p| over |p| > 1;
    - utilization: l2·(epoch_id/epoch_count)·(spread + gap). The spread is the sum of the standard deviations of the
      columns of the centres, of the scales, and of the alphas. The gap is the sum of the differences between the
      standard deviations, and between the means, of the `percentile` per cent of Gaussians of lowest and highest
      |alpha|, over the same seven; with fewer than two Gaussians on each side it is left out.

    Parameters
    ----------
    model : gaussian_3d_volume
        The Gaussians.
    estimate, ground_truth : torch.Tensor
        Densities ``[n]``.
    epoch_id, epoch_count : int
        Index of the epoch and number of epochs; the weight of "utilization" grows with their ratio.
    weights : dict
        Weights as in :data:`DEFAULT_WEIGHTS`, which complete those left out.

    Raises
    ------
    ValueError
        If a weight has an unknown name, or the percentile is not from 0 to 100.
    """
    weights = complete_weights(weights)
    progress = epoch_id / _validate.integer("epoch_count", epoch_count, minimum=1)
    content, use = weights["content"], weights["utilization"]
    terms: list[tuple[float, Callable[..., torch.Tensor]]] = [
        (content["l2"], lambda: model.l2_loss(estimate, ground_truth)),
        (content["l1"], lambda: model.l1_loss(estimate, ground_truth)),
        (weights["angle"], lambda: _outside(model.angles)),
        (weights["center"], lambda: _outside(model.centers)),
        (use["l2"], lambda: progress * _utilization(model, use["percentile"])),
    ]
    for name, values in (("scale", model.scales), ("alpha", model.alphas)):
        low, high = weights[name]["threshold"]
        terms.append((weights[name]["smaller"], lambda v=values, at=low: v.abs().where(v < at, 0).sum()))
        terms.append((weights[name]["larger"], lambda v=values, at=high: v.where(v > at, 0).sum()))
    # A function of the parameters, so that a loss without terms has the gradient zero.
    loss = 0 * model.alphas.sum()
    for weight, term in terms:
        if weight != 0:
            loss = loss + weight * term()
    return loss


def complete_weights(weights: Mapping[Any, Any], argument: str = "weights") -> dict[Any, Any]:
    """Return the weights with the defaults for those left out; raise TypeError or ValueError that names `argument`."""
    _validate.instance(argument, weights, Mapping, f"a dict of {', '.join(DEFAULT_WEIGHTS)}")
    _validate.known(argument, weights, DEFAULT_WEIGHTS)
    whole = dict(DEFAULT_WEIGHTS)
    for name, value in weights.items():
        default = DEFAULT_WEIGHTS[name]
        if isinstance(default, Mapping):
            if not isinstance(value, Mapping):
                raise ValueError(f"{argument}[{name!r}] must be a dict of {', '.join(default)}; got {value!r}")
            _validate.known(f"{argument}[{name!r}]", value, default)
            value = {**default, **value}
        whole[name] = value
    return whole


def _outside(values):
    return values.abs().where(values.abs() > 1, 0).sum()


def _utilization(model, percentile):
    _validate.within("weights['utilization']['percentile']", percentile, least=0, most=100)
    columns = torch.cat([model.centers, model.scales, model.alphas], dim=1)
    count = len(columns)
    total = columns.std(dim=0).sum() if count > 1 else columns.sum() * 0
    some = int(percentile / 100 * count)
    if some < 2:
        return total
    order = model.alphas.detach().abs()[:, 0].argsort()
    low, high = columns[order[:some]], columns[order[-some:]]
    return total + (low.std(0) - high.std(0)).abs().sum() + (low.mean(0) - high.mean(0)).abs().sum()


_EXTENSIONS = (".pth", ".pt", ".bin")
_COLUMNS = {"centers": 3, "angles": 3, "scales": 3, "alphas": 1}
# Pairs of a point and a Gaussian computed at once.
_PAIRS = 1 << 20


def _positive_integer(name: str, value) -> int:
    """Return a positive integer; raise ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
        raise ValueError(f"{name} must be a positive integer, got {value!r}")
    return int(value)


class gaussian_3d_volume(nn.Module):
    """A density in space as a mean of Gaussians, see :func:`odak.learn.tools.evaluate_3d_gaussians`.

    Parameters
    ----------
    number_of_elements : int
        Number N of Gaussians.
    initial_centers : torch.Tensor, optional
        Centres to start from, see :meth:`initialize_parameters`.
    initial_angles : torch.Tensor, optional
        Rotations to start from.
    initial_scales : torch.Tensor, optional
        Standard deviations to start from.
    initial_alphas : torch.Tensor, optional
        Weights to start from.

    Attributes
    ----------
    centers : torch.nn.Parameter
        Centres ``[N, 3]``.
    scales : torch.nn.Parameter
        Standard deviations along the Gaussians' own axes, ``[N, 3]``.
    angles : torch.nn.Parameter
        Rotations about x, y and z in units of 180° ``[N, 3]``.
    alphas : torch.nn.Parameter
        Weights ``[N, 1]``.
    l1_loss : torch.nn.Module
        Mean absolute difference.
    l2_loss : torch.nn.Module
        Mean squared difference.

    Raises
    ------
    ValueError
        If the number is not a positive integer, or a shape is wrong.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.models import gaussian_3d_volume
    >>> gaussian_3d_volume(10)(torch.zeros(5, 3)).shape
    torch.Size([5])
    """

    centers: nn.Parameter
    scales: nn.Parameter
    angles: nn.Parameter
    alphas: nn.Parameter

    def __init__(
        self,
        number_of_elements: int = 10,
        initial_centers: torch.Tensor | None = None,
        initial_angles: torch.Tensor | None = None,
        initial_scales: torch.Tensor | None = None,
        initial_alphas: torch.Tensor | None = None,
    ):
        super().__init__()
        self.number_of_elements: int = _positive_integer("number_of_elements", number_of_elements)
        given = (initial_centers, initial_angles, initial_scales, initial_alphas)
        self._take(dict(zip(_COLUMNS, given, strict=True)), prefix="initial_")
        self.l2_loss: nn.MSELoss = nn.MSELoss()
        self.l1_loss: nn.L1Loss = nn.L1Loss()

    def initialize_parameters(
        self,
        centers: torch.Tensor | None = None,
        angles: torch.Tensor | None = None,
        scales: torch.Tensor | None = None,
        alphas: torch.Tensor | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        """Replace all parameters, by the given ones or by random ones.

        Parameters
        ----------
        centers, angles : torch.Tensor, optional
            ``[N, 3]``; drawn from a standard normal distribution by default.
        scales : torch.Tensor, optional
            ``[N, 3]``; drawn uniformly from 0 to 1 by default.
        alphas : torch.Tensor, optional
            ``[N, 1]`` or ``[N]``; drawn uniformly from 0 to 1 by default.
        device : torch.device or str
            Device of the parameters.

        Raises
        ------
        ValueError
            If a shape is wrong.
        """
        self._take({"centers": centers, "angles": angles, "scales": scales, "alphas": alphas}, device)

    def _take(self, given, device="cpu", prefix: str = ""):
        device = checked_device("device", device)
        for name, value in given.items():
            shape = (self.number_of_elements, _COLUMNS[name])
            if value is None:
                value = torch.randn(shape) if name in ("centers", "angles") else torch.rand(shape)
            value = tensor(prefix + name, value).detach().clone()
            value = value if value.is_floating_point() else value.float()
            if name == "alphas" and value.shape == shape[:1]:
                value = value[:, None]
            if tuple(value.shape) != shape:
                raise ValueError(f"{prefix}{name} must be {list(shape)}, got {list(value.shape)}")
            self.register_parameter(name, nn.Parameter(value.to(device)))

    def forward(self, points: torch.Tensor, test: bool = False) -> torch.Tensor:
        """Return the density at points.

        Parameters
        ----------
        points : torch.Tensor
            ``[n, 3]``.
        test : bool
            Compute without gradients.

        Returns
        -------
        torch.Tensor
            ``[n]``. Large numbers of points are computed in parts, and again in the backward pass.
        """
        at_once = max(1, _PAIRS // self.number_of_elements)
        points = features("points", points, 3)
        with torch.set_grad_enabled(torch.is_grad_enabled() and not _validate.flag("test", test)):
            if len(points) <= at_once:
                return self._density(points)
            parts = points.split(at_once)
            options: dict[str, Any] = {"use_reentrant": False, "preserve_rng_state": False}
            return torch.cat([checkpoint(self._density, part, **options) for part in parts])

    def _density(self, points):
        return evaluate_3d_gaussians(points, self.centers, self.scales, 180 * self.angles, self.alphas).mean(dim=1)

    def evaluate(
        self,
        estimate: torch.Tensor,
        ground_truth: torch.Tensor,
        epoch_id: int = 0,
        epoch_count: int = 1,
        weights: Mapping[Any, Any] = DEFAULT_WEIGHTS,
    ) -> torch.Tensor:
        """Return the loss of an estimate, with penalties on the parameters.

        Parameters
        ----------
        estimate, ground_truth : torch.Tensor
            Densities ``[n]``.
        epoch_id, epoch_count : int
            The weight of "utilization" grows with epoch_id/epoch_count.
        weights : dict
            Weights of the terms, see :func:`odak.learn.models.gaussians.volume_loss`; the defaults
            complete those left out.

        Returns
        -------
        torch.Tensor
            A number.

        Raises
        ------
        ValueError
            If a weight has an unknown name, or the percentile is not one.
        """
        _check_same_samples("estimate", estimate, ground_truth)
        _validate.integer("epoch_id", epoch_id)
        _validate.integer("epoch_count", epoch_count, minimum=1)
        return volume_loss(self, estimate, ground_truth, epoch_id, epoch_count, weights)

    @differentiates
    def optimize(
        self,
        points: torch.Tensor,
        ground_truth: torch.Tensor,
        loss_weights: Mapping[Any, Any],
        learning_rate: float = 1e-2,
        number_of_epochs: int = 10,
        scheduler_power: float = 1,
        save_at_every: int = 1,
        max_norm: float | None = None,
        weights_filename: str | os.PathLike[str] | None = None,
        *,
        verbose: bool = True,
    ) -> None:
        """Fit the density to samples by AdamW, the learning rate falling to zero.

        Parameters
        ----------
        points : torch.Tensor
            Positions of the samples ``[n, 3]``.
        ground_truth : torch.Tensor
            Densities at these positions ``[n]``.
        loss_weights : dict
            Weights of the terms of the loss, see :func:`odak.learn.models.gaussians.volume_loss`.
        learning_rate : float
            Learning rate at the start.
        number_of_epochs : int
            Number of steps.
        scheduler_power : float
            The rate falls as (1 − epoch/epochs)^power.
        save_at_every : int
            Epochs between two writings of the file.
        max_norm : float, optional
            Largest norm of the gradient.
        weights_filename : str or os.PathLike, optional
            File to write the parameters to; without one nothing is written.
        verbose : bool
            Show a progress bar.

        Raises
        ------
        ValueError, TypeError
            If an argument is outside its range.
        FloatingPointError
            If the loss is not finite.
        """
        scheduler_power, max_norm = _validate.constants(scheduler_power=scheduler_power, max_norm=max_norm)
        epochs = _validate.integer("number_of_epochs", number_of_epochs)
        every = _validate.integer("save_at_every", save_at_every, minimum=1)
        _validate.real("learning_rate", learning_rate, positive=True)
        _validate.number("scheduler_power", scheduler_power, least=0)
        if weights_filename is not None:
            validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        complete_weights(loss_weights, "loss_weights")
        points = features("points", points, 3).to(self.centers.device)
        _check_same_samples("points", points[..., 0], ground_truth)
        ground_truth = trainable(ground_truth.to(self.centers.device))
        steps = itertools.count()

        def loss(model, batch):
            return model.evaluate(model(batch[0]), batch[1], next(steps), epochs, loss_weights)

        def save(epoch, history):
            if weights_filename is not None and epoch % every == 0:
                self.save_weights(weights_filename)

        train(
            self,
            loss,
            [(points, ground_truth)],
            epochs,
            optimizer=lambda parameters: torch.optim.AdamW(parameters, lr=learning_rate),
            scheduler=lambda made: torch.optim.lr_scheduler.PolynomialLR(made, epochs, scheduler_power),
            max_norm=max_norm,
            callback=save,
            progress=_validate.flag("verbose", verbose),
            description="Gaussians",
        )

    def save_weights(self, weights_filename: str | os.PathLike[str]) -> None:
        """Write the parameters to a ``.pth``, ``.pt`` or ``.bin`` file, atomically.

        Parameters
        ----------
        weights_filename : str or path-like
            Path of the file.

        Raises
        ------
        ValueError
            If the path is not acceptable or its folder does not exist.
        """
        validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        save_weights(self, weights_filename, extensions=_EXTENSIONS)

    def load_weights(
        self,
        weights_filename: str | os.PathLike[str] | None = None,
        device: torch.device | str | None = "cpu",
    ) -> None:
        """Read the parameters from a file of :meth:`save_weights`, and switch to evaluation.

        Parameters
        ----------
        weights_filename : str or os.PathLike, optional
            ``.pth``, ``.pt`` or ``.bin`` file; None does nothing. If there is no such file the parameters stay as they
            are, with an :class:`odak.ArgumentWarning`.
        device : torch.device or str
            Device that the file is read to; the parameters stay on their own device.

        Raises
        ------
        ValueError
            If the path is not acceptable, or the file is broken, would run code or holds other parameters.
        """
        if weights_filename is None:
            return
        validate_path(weights_filename, _EXTENSIONS, name="weights_filename")
        try:
            load_weights(self, weights_filename, device=device, extensions=_EXTENSIONS)
        except FileNotFoundError:
            warn(f"there is no file {os.fspath(weights_filename)!r}: the Gaussians stay as they are", ArgumentWarning)


def _check_same_samples(name, samples, ground_truth):
    for key, value in ((name, samples), ("ground_truth", ground_truth)):
        _validate.instance(key, value, torch.Tensor, "a tensor")
    _validate.alike(**{name: samples, "ground_truth": ground_truth})
