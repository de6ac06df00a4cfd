"""Light from a panel to planes in free space or a medium. Touches transfer functions and the light it is given."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import torch
from scipy.fft import next_fast_len

from odak import _array, _validate
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import tensor
from odak.learn.wave.displays.observers import REACH
from odak.learn.wave.displays.panels import Iris, Modulator
from odak.learn.wave.displays.paths.base import Kept, Lights, Path, checked_numbers, keep, listed
from odak.learn.wave.training import generator_from
from odak.tools.matrix import zero_pad
from odak.wave.linear_kernels import linear_kernel
from odak.wave.methods import check_has_kernel, linear_kernel_of, linear_method
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import Grid, Request, angular_spectrum, divided_pitch

# Where an iris passes fewer periods across the panel, its spot is wider than all that is computed.
_FEWEST_PERIODS = 0.5
# Pixels along an axis from which on points beyond the rim may lack the light of as many pixels at the other rim.
_LARGE = 128


@_validate.takes_units("distances", "relay", "jitter")
@dataclass(frozen=True, eq=False)
class Free:
    """Free space between a panel and planes, with more to say than distances: what a display takes in place of them.

    Use it as `distances` of a :class:`Display` for a mask in the Fourier plane, for distances that are learned, or to
    see what an approximate propagation method does.

    Parameters
    ----------
    distances : float, sequence of float or torch.Tensor
        Distances of the D planes from the panel in metres. A tensor that requires gradients gets them from images.
    relay : float
        Distance from the panel of its image by a relay, from which the light travels on to the planes.
    method : str
        Propagation type with a transfer function, see :func:`odak.learn.wave.propagate_beam`. Light is propagated
        without wrap-around, where all exact methods are the same.
    mask : torch.Tensor, optional
        Amplitudes that a filter in the Fourier plane of a relay passes, real or complex, ``[2·rows, 2·columns]``, or
        ``[rows, columns]``, surrounded by zeros; zero frequency is in the middle. The iris must pass one order.

    jitter : float
        Standard deviation in metres of an error of each distance, which is drawn anew each time that images are
        computed, so that a hologram optimised through it bears misplacement. Optimise by the solver "adam": the loss of
        L-BFGS must not change from one step to the next.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    :meth:`Display.judge` computes with the exact method, whatever `method` is, at the distances without an error.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Free, Modulator
    >>> distances = torch.tensor([2e-3, 3e-3], dtype=torch.float64, requires_grad=True)
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, Free(distances))
    >>> phases = torch.rand(32, 48, generator=torch.Generator().manual_seed(0))
    >>> display(phases).square().mean().backward()
    >>> distances.grad.shape
    torch.Size([2])
    """

    distances: float | Sequence[float] | torch.Tensor
    relay: float = 0.0
    method: str = "auto"
    mask: torch.Tensor | None = None
    jitter: float = 0.0

    def __post_init__(self) -> None:
        keep(self, jitter=float(_validate.number("jitter", self.jitter, least=0)))
        keep(self, relay=_validate.constant("relay", self.relay))
        check_has_kernel(self.method)
        given: Any = self.distances
        if not _array.is_traced(given):
            (distances,) = _validate.constants(distances=self.distances)
            keep(self, distances=checked_numbers("distances", distances))
        elif given.ndim != 1:
            raise ValueError(f"distances must be [planes] where it is a tensor, got {list(given.shape)}")
        if self.mask is not None:
            keep(self, mask=_validate.image("mask", tensor("mask", self.mask)).detach())


@dataclass(frozen=True)
class FreePath(Path):
    """Light that travels freely from a panel, or from its image by a relay, to planes.

    Attributes
    ----------
    window : tuple of int
        Rows and columns in which light is followed.
    finer : int
        Samples along each axis of a pixel of what transfer functions filter.
    method : str
        Name of the propagation method.
    mask : torch.Tensor, optional
        What passes of the frequencies of a grid of twice the size of the panel, zero frequency in the middle.
    """

    window: tuple[int, int] = field(init=False)
    finer: int = field(init=False, default=1)
    method: str = field(init=False, default="Angular Spectrum")
    mask: torch.Tensor | None = field(init=False, default=None)
    jitter: float = field(init=False, default=0.0)  # type: ignore[misc]

    starts: ClassVar[tuple[str, ...]] = ("quadratic", "flat", "random", "double phase", "gs", "network")

    def __post_init__(self) -> None:
        space = self.ends if isinstance(self.ends, Free) else Free(self.ends)
        net = tuple(float(z) - space.relay for z in _validate.numbers(space.distances))
        keep(self, distances=net, window=self.sizes, samples=2 * self.passing(self.iris))
        if space.mask is None:
            wider = (4 * next_fast_len(-(-(n + REACH) // 4), True) for n in self.sizes)
            keep(self, window=tuple(n if n >= _LARGE else more for n, more in zip(self.sizes, wider, strict=True)))
        if isinstance(self.iris, Iris):
            across = min(n * p for n, p in zip(self.sizes, self.pitches, strict=True))
            periods = across * min(self.iris.cutoff(wavelength) for wavelength in self.wavelengths)
            if periods < _FEWEST_PERIODS:
                warn(
                    f"iris passes {periods:.2g} periods across the modulator, whose light it spreads far beyond "
                    f"the images: is its radius of {self.iris.radius:g} m right?",
                    AccuracyWarning,
                )
        keep(self, jitter=space.jitter)
        if space.method != "auto":
            lengths = [wavelength / self.medium for wavelength in self.wavelengths], list(net)
            keep(self, method=linear_method(space.method, self.sizes, self.pitches, *lengths))
        if self.samples > 2 and (space.mask is not None or self.method != "Angular Spectrum"):
            raise ValueError("distances must be without a mask or method where more than one order passes the iris")
        if space.mask is not None:
            whole = tuple(2 * n for n in self.sizes)
            small = min(self.sizes) < 2 * REACH
            if self.first is not None or small or tuple(space.mask.shape) not in (self.sizes, whole):
                got = "two panels" if self.first is not None else list(space.mask.shape)
                sizes = f"{list(self.sizes)} or {list(whole)}, at least {2 * REACH} along each axis"
                raise ValueError(f"mask must be {sizes}, for one panel, got {got}")
            keep(self, mask=zero_pad(space.mask, whole).reshape(whole))

    @classmethod
    def leads(cls, modulator: Modulator, ends: Any) -> bool:
        """Say whether the light of a modulator takes this kind of path to the images."""
        return isinstance(ends, (tuple, Free))

    def points(self, kept: Kept, lights: Lights, colour: int, planes: Sequence[int]) -> torch.Tensor:
        """Return the fields of some images at the points of pixels."""
        (light,) = lights
        # One kernel for each plane and point of a pixel takes one transform back, but a single forward one.
        light = torch.nn.functional.pad(light.unsqueeze(-3), (REACH,) * 4)
        return convolve(light, self.kernels(kept, colour, light.dtype, planes))

    def middles(self, kept: Kept, lights: Lights, colour: int) -> torch.Tensor:
        """Return the fields of all images at the middles of pixels."""
        (light,) = lights
        planes = range(len(self.distances))
        return convolve(light.unsqueeze(-3), self.kernels(kept, colour, light.dtype, planes)[:: self.samples**2])

    def in_words(self) -> str:
        """Return where the images are, in words."""
        return f"plane{'s' * (len(self.distances) > 1)} at {listed(self.distances, 1e3)} mm"

    def band(self, colour: int, image: int) -> tuple[float, float] | None:
        """Return the half axes of the ellipse that holds the frequencies of an image, in cycles per pixel of it."""
        cutoff = self.cutoff(colour)
        return None if cutoff is None else (2 * cutoff * self.pitches[0], 2 * cutoff * self.pitches[1])

    def kernels(self, kept: Kept, colour: int, dtype: torch.dtype, planes: Sequence[int]) -> torch.Tensor:
        """Return the transfer functions to all points of a pixel on some planes, ``[planes·samples², 2m, 2n]``."""
        if self.jitter or (isinstance(self.ends, Free) and _array.is_traced(self.ends.distances)):
            errors = kept.errors or (0.0,) * len(self.distances)
            given = kept.device, colour
            each = [kernel for plane in planes for kernel in self._of_plane(*given, plane, dtype, errors[plane])]
            return torch.stack(each)
        return kept(type(self)._of_planes, self, colour, dtype, tuple(planes))

    def _of_planes(self, device, colour, dtype, planes):
        rows, columns = (2 * n * self.finer for n in self.window)
        # Column by column, which is the order that the propagation reads them in on a CPU.
        shape = len(planes) * (1 if self.finer > 1 else self.samples**2), columns, rows
        kept = torch.empty(shape, dtype=dtype, device=device).mT
        kept = kept if kept.is_cpu else kept.contiguous()
        each = (kernel for plane in planes for kernel in self._of_plane(device, colour, plane, dtype))
        for place, kernel in zip(kept, each, strict=True):
            place.copy_(kernel)
        return kept

    def renew(self, kept: Kept) -> None:
        """Draw the errors of the distances anew, for a call of a display."""
        if self.jitter:
            kept.generator = generator_from(None) if kept.generator is None else kept.generator
            drawn = torch.randn(len(self.distances), generator=kept.generator, dtype=torch.float64)
            kept.errors = tuple((self.jitter * drawn).tolist())

    def _of_plane(self, device, colour, plane, dtype, error=0.0):
        orders, cutoff = self.samples // 2, self.cutoff(colour)
        if orders == 1:
            grid = self._grid(device, colour, plane, dtype, error)
            mask = 1.0 if self.mask is None else torch.fft.ifftshift(self.mask).to(device)
            for halves in itertools.product((False, True), repeat=2):
                linear = linear_kernel_of(self.method, cutoff, self.fill)
                kernel = replace(linear, halves=halves, named=self.sizes)(grid)
                yield kernel if self.mask is None else (kernel * mask).to(dtype)
        else:
            # The response at all points of the pixels of the image. Each point takes its own lags, every so many of
            # them, and with them the repetitions of the spectrum.
            count = self.samples
            transfer = PixelTransfer.of(self.pitches, self.fill, orders)
            linear = linear_kernel(transfer, math.inf if cutoff is None else cutoff)
            response = torch.fft.ifft2(linear(self._grid(device, colour, plane, dtype, error, count))) * count**2
            points = itertools.product(range(count), repeat=2)
            yield from (torch.fft.fft2(response[down::count, across::count]) for down, across in points)

    def _grid(self, device, colour, plane, dtype, error=0.0, samples=1):
        """Return the grid of twice the window on the way to a plane, with some samples in each pixel."""
        distance: Any = self.distances[plane] + error
        if isinstance(self.ends, Free) and _array.is_traced(self.ends.distances):
            distance = self.ends.distances[plane].to(device) - self.ends.relay + error
        request = Request(divided_pitch(self.pitches, samples), self.wavelengths[colour] / self.medium, distance)
        shape = 2 * self.window[0] * samples, 2 * self.window[1] * samples
        return request.grid(shape, _array.namespace(torch.empty(0)), device, dtype)


@dataclass(frozen=True)
class PixelTransfer:
    """Transfer function of free space for square pixels of some width, in a band that a square stop passes.

    Attributes
    ----------
    width : tuple of float
        Of a pixel along rows and columns in metres; 0 for points.
    band : tuple of float
        Highest frequencies that pass along rows and columns, in cycles per metre.
    transfer : callable
        Transfer function of the way.
    """

    width: tuple[float, float]
    band: tuple[float, float]
    transfer: Callable[..., Any] = angular_spectrum

    @classmethod
    def of(cls, pitches: tuple[float, float], fill: float, orders: int) -> "PixelTransfer":
        """Return the one of pixels that emit in a share of their area, with some orders along each axis."""
        width = math.sqrt(fill)
        return cls((width * pitches[0], width * pitches[1]), (orders / (2 * pitches[0]), orders / (2 * pitches[1])))

    def __call__(self, grid: Grid) -> torch.Tensor:
        """Return the transfer function on a grid of frequencies."""
        return self.transfer(_Passing(grid, self.width, self.band))


class _Passing:
    """A grid on which a transfer function is multiplied by the spectrum of pixels in a band."""

    def __init__(self, grid: Grid, width: Sequence[float], band: Sequence[float]):
        self._grid, self._width, self._band = grid, width, band

    def __getattr__(self, name: str) -> Any:
        return getattr(self._grid, name)

    def evaluate(self, kernel: Callable[..., torch.Tensor]) -> torch.Tensor:
        """Return the transfer function with frequencies ``kernel(fy, fx)`` in the band."""

        def passing(fy, fx):
            spectrum = kernel(fy, fx)
            for frequency, width, limit in zip((fy, fx), self._width, self._band, strict=True):
                # Half of the last frequency, which is rounded.
                inside = sum(0.5 * (frequency < (1 + more) * limit) for more in (-1e-9, 1e-9))
                spectrum = spectrum * (torch.sinc(width * frequency) * inside).to(spectrum.dtype)
            return spectrum

        return self._grid.evaluate(passing)
