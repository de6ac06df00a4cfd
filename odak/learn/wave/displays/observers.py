"""Observers of a display: cameras and eyes, what they record of an intensity, and of a picture of squares.

The intensity of a field has twice the band of the field. Its means over the areas of the panel's pixels, one for each,
do not determine it: they tell what one camera sees, whose pixels coincide with the panel's. Means on four grids half a
pixel apart do, so that what is good on these is good for a camera at any place.
"""

import functools
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from odak import _array, _torch_private, _validate
from odak._torch_private import in_own_precision
from odak.learn.perception import Viewer, Viewing
from odak.learn.wave.fields import intensity

# Pixels on either side, beside half the camera's, that a mean is computed from; see _taps. Paths of light give the
# points of as many beyond each rim.
REACH = 4
# Pixels whose means are one product of matrices.
_BLOCK = 16
# Places in a pixel of the panel, along each axis, at which a camera is judged.
PLACES = 4
# Pixels at each rim that are not judged by a camera at any place.
_RING = 1
# Degrees about a point over which an eye spreads nearly all of its light, and cycles per degree that it hardly passes.
_SPREAD, _FINEST = 0.1, 60.0
# Points along each axis of a turned pixel, by which its shares of the pixels of a picture are counted.
_POINTS = 256


@_validate.takes_units("pitch")
@dataclass(frozen=True)
class Observer:
    """Who looks at a display: a camera of square pixels at any place or at one, or an eye.

    Make one by :meth:`camera`, which is the default everywhere, :meth:`eye` or :meth:`points`. The stated quality is
    the least over the places of a camera's pixels by quarters of a pixel of the panel along both axes, without the
    outermost pixels.

    Parameters
    ----------
    pitch : float, optional
        Distance of neighbouring pixels of the camera in metres; by default that of the image, one pixel of the panel.
    fill : float
        Share of the area of a camera's pixel that is sensitive; 0 for points.
    magnification : float
        Size of the image on the camera over that on the plane of the display.
    registered : bool
        Whether the camera's pixels coincide with those of the image, which no camera does by itself.
    turned : float
        Angle of the camera's rows to those of the image, in degrees.

    Examples
    --------
    >>> from odak.learn.wave import Observer
    >>> Observer.camera()
    Observer: a camera of the image's pitch, at any place
    >>> Observer.camera(3.45e-6, magnification=0.5)
    Observer: a camera of 6.9 µm on the image, at any place
    """

    pitch: float | None = None
    fill: float = 1.0
    magnification: float = 1.0
    registered: bool = False
    turned: float = 0.0

    def __post_init__(self) -> None:
        if self.pitch is not None:
            object.__setattr__(self, "pitch", _validate.constant("pitch", self.pitch, positive=True))
        _validate.number("fill", self.fill, least=0, most=1)
        _validate.real("magnification", self.magnification, positive=True)
        _validate.flag("registered", self.registered)
        _validate.constant("turned", self.turned, least=-45, most=45, unit="degrees")
        if self.registered and not (self.pitch is None and self.magnification == 1 and self.turned == 0):
            raise ValueError(
                "pitch must be None, magnification 1 and turned 0 for a registered camera, whose pixels are those of "
                f"the image; got {self.pitch!r:.80}, {self.magnification!r:.80} and {self.turned!r:.80}"
            )

    @classmethod
    def camera(
        cls,
        pitch: float | None = None,
        fill: float = 1.0,
        magnification: float = 1.0,
        registered: bool = False,
        turned: float = 0.0,
    ) -> "Observer":
        """Return a camera of a `pitch` and `fill`, whose `magnification` and whether it is `registered` is known.

        See :class:`Observer` for each of them, and for the angle by which it is `turned`.
        """
        return cls(pitch, fill, magnification, registered, turned)

    @classmethod
    def cameras(cls) -> tuple["Observer", ...]:
        """Return cameras whose pixels are 1, 1.25, 1.5, 2 and 3 of the image's wide, and one that is turned by 3°.

        What is good for all of them is good for cameras of the image's pitch and of larger pixels: coarse pixels that
        are no multiple of the image's can pass errors that finer ones average away.
        """
        return *(cls.camera(magnification=1 / wide) for wide in (1.0, 1.25, 1.5, 2.0, 3.0)), cls.camera(turned=3.0)

    @classmethod
    def eye(cls, viewing: Viewing | None = None, viewer: Viewer | None = None) -> "Observer":
        """Return an eye, whose pupil and aberrations blur an image that fills the width of the display.

        Parameters
        ----------
        viewing : Viewing, optional
            Size and distance at which the image is seen, and light that sets the pupil; the usual one by default.
        viewer : Viewer, optional
            Whose eye it is; the usual one by default.

        Notes
        -----
        The image is blurred by the mean transfer of eyes with this pupil (Watson 2013,
        :func:`odak.learn.perception.ocular_modulation_transfer`), and compared with the picture blurred alike, at every
        quarter of a pixel but those within 0.1° of the rim. For the path of light to a retina, see
        :class:`odak.learn.wave.Eyes`.

        Examples
        --------
        >>> from odak.learn.perception import Viewer, Viewing
        >>> from odak.learn.wave import Observer
        >>> Observer.eye(Viewing.head_mounted((1080, 1920), 40), Viewer(pupil=4))
        Observer: an eye with a pupil of 4 mm that sees the image 40° wide
        """
        return Eye(viewing=viewing or Viewing(), viewer=viewer or Viewer())

    @classmethod
    def points(cls) -> "Observer":
        """Return an observer of the intensity at the middles of pixels, which no sensor sees: for theory."""
        return cls(fill=0.0, registered=True)

    def __repr__(self) -> str:
        return f"Observer: {self.in_words()}"

    def in_words(self) -> str:
        """Return who looks, in words."""
        if self.fill == 0 and self.registered:
            return "points in the middles of pixels"
        wide = (
            "the image's pitch"
            if self.pitch is None
            else f"{1e6 * self.pitch / self.magnification:.4g} µm on the image"
        )
        wide += "" if self.fill == 1 else f" (fill {self.fill:g})"
        turned = "" if self.turned == 0 else f", turned by {self.turned:g}°"
        place = "whose pixels are those of the image" if self.registered else "at any place"
        return f"a camera of {wide}{turned}, {place}"

    @property
    def grids(self) -> int:
        """How many grids :meth:`recorded` returns."""
        return 1 if self.registered else 4

    def steps(self, pitches: Sequence[float]) -> tuple[float, float]:
        """Return the distances of the camera's pixels along rows and columns, in pixels of an image.

        Parameters
        ----------
        pitches : sequence of float
            Distances of the image's pixels along rows and columns in metres.
        """
        own = [p if self.pitch is None else self.pitch for p in pitches]
        down, across = (o / (self.magnification * p) for o, p in zip(own, pitches, strict=True))
        return down, across

    def sides(self, pitches: Sequence[float]) -> tuple[float, float]:
        """Return the sides of what is sensitive of the camera's pixels, in pixels of an image of some `pitches`."""
        down, across = (math.sqrt(self.fill) * step for step in self.steps(pitches))
        return down, across

    @in_own_precision
    def recorded(self, points: torch.Tensor, pitches: Sequence[float], beyond: int = 0) -> torch.Tensor:
        """Return means over the camera's pixels about all pixels of an image, on one grid or on four.

        Parameters
        ----------
        points : torch.Tensor
            Intensities at the points of each pixel ``[planes, samples, samples, rows, columns]``, the first of which is
            its middle.
        pitches : sequence of float
            Distances of the image's pixels along rows and columns in metres.
        beyond : int
            Pixels of these that lie beyond each rim of the image, which means about its outermost pixels need: four
            for a camera of the image's pitch.

        Returns
        -------
        torch.Tensor
            Means ``[grids, planes, rows, columns]``, on grids that are displaced by half a pixel along columns, along
            rows and along both. Instead of what lies beyond the last pixel they hold the mean about it again.
        """
        planes, samples, _, rows, columns = points.shape
        values = points.permute(0, 3, 1, 4, 2).reshape(planes, rows * samples, columns * samples)
        if self._blurs:
            return self._recorded_between(values, samples, (rows - 2 * beyond, columns - 2 * beyond), pitches, beyond)
        grids = 1 if self.registered else 2
        for axis, side in zip((-1, -2), self.sides(pitches)[::-1], strict=True):
            values = _filtered(values, samples, side, grids, axis, beyond)
        return torch.stack([values[:, y::grids, x::grids] for y in range(grids) for x in range(grids)])

    def wanted(self, target: torch.Tensor, pitches: Sequence[float]) -> torch.Tensor:
        """Return what :meth:`recorded` is for a `target` of squares ``[..., rows, columns]`` of `pitches` in metres.

        The result is ``[grids, ..., rows, columns]``.
        """
        grids = 1 if self.registered else 2
        whole = self._picture(target, pitches, grids, within=True)
        return torch.stack([whole[..., y::grids, x::grids] for y in range(grids) for x in range(grids)])

    def places(self, shape: Sequence[int], pitches: Sequence[float]) -> list[list[slice]]:
        """Return along rows and along columns which of the places 0, ¼, ½ … of an image each place of the camera takes.

        Parameters
        ----------
        shape : sequence of int
            Rows and columns of the image.
        pitches : sequence of float
            Distances of its pixels along rows and columns in metres.

        Raises
        ------
        ValueError
            If no pixel of the camera lies within the image without its outermost pixels.
        """
        found = []
        for n, step, side in zip(shape, self.steps(pitches), self.sides(pitches), strict=True):
            if self.registered:
                found.append([slice(0, n * PLACES, PLACES)])
                continue
            first = math.ceil(PLACES * (_RING - 0.5 + side / 2) - 1e-6)
            last = math.floor(PLACES * (n - _RING - 0.5 - side / 2) + 1e-6)
            # As is one whose rows are not those of the image.
            quarters = PLACES * step if self.turned == 0 else 1.0
            # A camera whose pixels are no whole number of quarters apart is at all places at once.
            whole = round(quarters) if abs(quarters - round(quarters)) < 1e-3 else 1
            if last < first:
                raise ValueError(
                    f"observer must have pixels within an image of {n} pixels without the outermost, got {side:.4g} of "
                    "them wide"
                )
            stop = last + 1
            found.append([slice(first + k, stop, whole) for k in range(min(whole, stop - first))])
        return found

    def image(self, light: torch.Tensor, samples: int, shape: Sequence[int], pitches: Sequence[float]) -> torch.Tensor:
        """Return means over the camera's pixels about all quarters of the pixels of an image.

        Parameters
        ----------
        light : torch.Tensor
            Intensity around the image; see :func:`resolved`.
        samples : int
            Samples for each pixel of the image along each axis.
        shape : sequence of int
            Rows and columns of the image.
        pitches : sequence of float
            Distances of its pixels along rows and columns in metres.

        Returns
        -------
        torch.Tensor
            Means ``[4·rows, 4·columns]``, the first about the middle of the first pixel.
        """
        if self._blurs:
            light = _times(light, self._passed(light.shape, 1 / samples, shape, pitches))
            return resolved(light, samples, shape, (0.0, 0.0))
        return resolved(light, samples, shape, self.sides(pitches))

    def picture(self, target: torch.Tensor, pitches: Sequence[float]) -> torch.Tensor:
        """Return what :meth:`image` is for a `target` of squares ``[rows, columns]`` of some `pitches` in metres."""
        return self._picture(target, pitches, PLACES)

    @property
    def _blurs(self) -> bool:
        """Whether the resolution is no product of one along rows and one along columns."""
        return self.turned != 0

    def _passed(self, size: Sequence[int], step: float, shape: Sequence[int], pitches: Sequence[float]) -> torch.Tensor:
        """Return what is passed of the frequencies of a grid of some `size` and `step` in pixels of an image."""
        down, across = _frequencies(size, step)
        angle = math.radians(self.turned)
        # Along the sides of the camera's pixels, in lengths of a pixel of the image along each of them.
        one, other = (side * p for side, p in zip(self.sides(pitches), pitches, strict=True))
        y, x = down / pitches[0], across / pitches[1]
        first, second = math.cos(angle) * y - math.sin(angle) * x, math.sin(angle) * y + math.cos(angle) * x
        return torch.sinc(one * first) * torch.sinc(other * second)

    def _picture(
        self, target: torch.Tensor, pitches: Sequence[float], places: int, within: bool = False
    ) -> torch.Tensor:
        """Return what is seen of a picture of squares at places of each pixel, none beyond the last if `within`."""
        if not self._blurs:
            ends = [np.arange(n * places) / places for n in target.shape[-2:]]
            ends = [np.minimum(e, n - 1) if within else e for e, n in zip(ends, target.shape[-2:], strict=True)]
            return means_of_squares(target, ends, self.sides(pitches))
        whole = self._seen_of(target.reshape(-1, 1, *target.shape[-2:]), pitches, places)
        whole = whole.reshape(*target.shape[:-2], *whole.shape[-2:])
        return _repeated(whole, places) if within else whole

    def _seen_of(self, target: torch.Tensor, pitches: Sequence[float], places: int) -> torch.Tensor:
        """Return what is seen of pictures ``[N, 1, rows, columns]`` at places of each pixel, by shares of squares."""
        shares = _turned_shares(self.sides(pitches), tuple(pitches), self.turned, places).to(target)
        around = shares.shape[-1] // 2
        wide = torch.nn.functional.pad(target, (around,) * 4, mode="replicate")
        return torch.nn.functional.pixel_shuffle(torch.nn.functional.conv2d(wide, shares), places)[:, 0]

    def _recorded_between(self, values, samples, shape, pitches, beyond):
        """Return :meth:`recorded` for values of planes, by products of spectra of what is continued beyond its ends."""
        around = samples * max(REACH, self._rim(shape, pitches))
        more = around - samples * beyond
        wide = _continued(_continued(values, more, more, -1), more, more, -2)
        size = wide.shape[-2:]
        spectrum = torch.fft.rfft2(wide) * self._passed(size, 1 / samples, shape, pitches).to(wide)
        down, across = _frequencies(size, 1 / samples)
        found = []
        for y, x in itertools.product((0.0, 0.5), repeat=2):
            turn = torch.polar(torch.ones((), dtype=torch.float64), 2 * math.pi * (y * down + x * across))
            moved = torch.fft.irfft2(spectrum * turn.to(spectrum), size)
            rows, columns = (slice(around, around + n * samples, samples) for n in shape)
            found.append(moved[:, rows, columns])
        whole = torch.stack(found).unflatten(0, (2, 2)).permute(2, 3, 0, 4, 1).flatten(3, 4).flatten(1, 2)
        whole = _repeated(whole, 2)
        return torch.stack([whole[:, y::2, x::2] for y in range(2) for x in range(2)])

    def _rim(self, shape: Sequence[int], pitches: Sequence[float]) -> int:
        """Return how many pixels at each rim of an image are not seen as they are within it."""
        return _RING

    def compared(self, image: torch.Tensor, wanted: torch.Tensor, pitches: Sequence[float]) -> torch.Tensor:
        """Return how what is recorded at each place compares with what is wanted.

        Parameters
        ----------
        image, wanted : torch.Tensor
            Means about all quarters of pixels, by :meth:`image` and :meth:`picture`.
        pitches : sequence of float
            Distances of the image's pixels along rows and columns in metres.

        Returns
        -------
        torch.Tensor
            Means of image², image · wanted and wanted² over the pixels of the camera at each place, ``[places, 3]``.
        """
        down, across = self.places([n // PLACES for n in image.shape], pitches)
        pairs = (image, image), (image, wanted), (wanted, wanted)
        means = [
            torch.stack([(a[y, x] * b[y, x]).mean(dtype=torch.float64) for a, b in pairs]) for y in down for x in across
        ]
        return torch.stack(means)


@dataclass(frozen=True, repr=False)
class Eye(Observer):
    """An eye before a display; see :meth:`Observer.eye`.

    Attributes
    ----------
    viewing : Viewing
        Size, distance and light of the display.
    viewer : Viewer
        Whose eye it is.
    """

    viewing: Viewing = field(default_factory=Viewing)
    viewer: Viewer = field(default_factory=Viewer)

    def in_words(self) -> str:
        """Return who looks, in words."""
        pupil = self.viewer.pupil_diameter(self.viewing)
        return f"an eye with a pupil of {pupil:.2g} mm that sees the image {self.viewing.field_of_view:.3g}° wide"

    def places(self, shape: Sequence[int], pitches: Sequence[float]) -> list[list[slice]]:
        """Return all quarters of pixels within the rim, as one place; see :meth:`Observer.places`."""
        rim = self._rim(shape, pitches)
        if 2 * rim >= min(shape):
            raise ValueError(
                f"observer must see {_SPREAD:g} degrees of the image at each rim, and more between: got an image of "
                f"{tuple(shape)} pixels, {self._density(shape, pitches)[1]:.3g} per degree"
            )
        return [[slice(PLACES * rim, PLACES * (n - rim - 1) + 1)] for n in shape]

    @property
    def _blurs(self) -> bool:
        return True

    def _density(self, shape, pitches):
        """Return the pixels per degree of an image along rows and along columns."""
        across = self.viewing.density(shape[1])
        return across * pitches[1] / pitches[0], across

    def _passed(self, size: Sequence[int], step: float, shape: Sequence[int], pitches: Sequence[float]) -> torch.Tensor:
        axes = zip(_frequencies(size, step), self._density(shape, pitches), strict=True)
        return self.viewer.transfer(torch.hypot(*(cycles * density for cycles, density in axes)), self.viewing)

    def _seen_of(self, target: torch.Tensor, pitches: Sequence[float], places: int) -> torch.Tensor:
        # As fine as the eye resolves: squares have all frequencies.
        shape, density = target.shape[-2:], min(self._density(target.shape[-2:], pitches))
        finer = places * max(1, math.ceil(2 * _FINEST / (density * places)))
        around = 2 * self._rim(shape, pitches)
        wide = torch.nn.functional.pad(target, (around,) * 4, mode="replicate")[:, 0]
        comb = wide.new_zeros(len(wide), *(n * finer for n in wide.shape[-2:]))
        comb[:, ::finer, ::finer] = wide
        size = comb.shape[-2:]
        square = math.prod(torch.sinc(f) * finer for f in _frequencies(size, 1 / finer))
        seen = _times(comb, square * self._passed(size, 1 / finer, shape, pitches))
        rows, columns = (slice(around * finer, (around + n) * finer, finer // places) for n in shape)
        return seen[:, rows, columns]

    def _rim(self, shape: Sequence[int], pitches: Sequence[float]) -> int:
        return max(_RING, math.ceil(_SPREAD * max(self._density(shape, pitches))))


# The default of all that takes an observer, and the one of means over the areas of the image's pixels.
ANYWHERE, REGISTERED = Observer.camera(), Observer.camera(registered=True)


def brightest(compared: torch.Tensor) -> torch.Tensor:
    """Return the factor of each colour at which images are closest to a target at all places of all planes, ``[C]``.

    `compared` is ``[D, C, places, 3]`` by :meth:`Observer.compared`.
    """
    squares, products, _ = compared.sum((0, 2)).unbind(-1)
    return products / squares.clamp_min(torch.finfo(squares.dtype).tiny)


def squared_errors(compared: torch.Tensor, brightness: torch.Tensor) -> torch.Tensor:
    """Return the largest mean squared error over the places of an observer, ``[D, C]``; see :func:`brightest`."""
    squares, products, wanted = compared.unbind(-1)
    factor = brightness[:, None]
    return (factor**2 * squares - 2 * factor * products + wanted).amax(-1)


def decibels(errors: torch.Tensor) -> torch.Tensor:
    """Return peak signal-to-noise ratios of mean squared errors of intensities 0 … 1."""
    return -10 * torch.log10(errors.clamp_min(1e-30))


def fine_intensity(shown: torch.Tensor, shape: Sequence[int] | None = None) -> torch.Tensor:
    """Return the intensity of a periodic field ``[rows, columns]`` at twice as many points along each axis.

    These describe it, since it has twice the band of the field. They are computed one shift of the field after another,
    of some rows and columns in the middle; of all by default.
    """
    spectrum, shape = torch.fft.fft2(shown), shown.shape if shape is None else shape
    light = torch.empty([2 * n for n in shape], dtype=shown.real.dtype, device=shown.device)
    down, across = (_half_step(n, shown) for n in shown.shape)
    middle = tuple(slice((m - n) // 2, (m + n) // 2) for m, n in zip(shown.shape, shape, strict=True))
    for y, x in itertools.product(range(2), repeat=2):
        light[y::2, x::2] = intensity(torch.fft.ifft2(spectrum * down[y][:, None] * across[x])[middle])
    return light


def _half_step(n: int, like: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the factors of a spectrum that shift a field by nothing and by half a sample."""
    turn = torch.polar(torch.ones(n, dtype=torch.float64), math.pi * torch.fft.fftfreq(n, dtype=torch.float64))
    if n % 2 == 0:
        # The highest frequency is one with its negative: half of it turns each way.
        turn[n // 2] = 0
    return torch.ones_like(turn).to(like), turn.to(like)


def resolved(
    light: torch.Tensor, samples: int, shape: Sequence[int], sides: Sequence[float], places: int = PLACES
) -> torch.Tensor:
    """Return the means of an intensity over squares about some places of each pixel: products of spectra.

    Parameters
    ----------
    light : torch.Tensor
        Periodic intensity, in whose middle pixel n // 2 of an image of n pixels lies along each axis.
    samples : int
        Samples for each pixel of the image along each axis, which describe the intensity.
    shape : sequence of int
        Rows and columns of the image.
    sides : sequence of float
        Sides of the squares along rows and columns, in pixels.
    places : int
        Places in each pixel along each axis, of which the first is its middle.

    Returns
    -------
    torch.Tensor
        Means ``[rows · places, columns · places]``.
    """
    finer = places * math.ceil(samples / places)
    for axis, n, side in zip((-1, -2), shape[::-1], sides[::-1], strict=True):
        cycles = torch.fft.rfftfreq(light.shape[axis], 1 / samples, dtype=torch.float64)
        passed = torch.sinc(side * cycles) * finer / samples
        if finer > samples and light.shape[axis] % 2 == 0:
            # The highest frequency is one with its negative, which are two on a finer grid.
            passed[-1] /= 2
        passed = passed.to(light)
        spectrum = torch.fft.rfft(light, dim=axis) * (passed if axis == -1 else passed[:, None])
        light = torch.fft.irfft(spectrum, light.shape[axis] * finer // samples, axis)
        first = (light.shape[axis] // (2 * finer) - n // 2) * finer
        chosen = slice(first, first + n * finer, finer // places)
        light = light[:, chosen] if axis == -1 else light[chosen]
    return light


def _frequencies(size: Sequence[int], step: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the frequencies along rows ``[rows, 1]`` and columns of half the spectrum of a grid."""
    down = torch.fft.fftfreq(size[-2], step, dtype=torch.float64)
    return down[:, None], torch.fft.rfftfreq(size[-1], step, dtype=torch.float64)


def _times(light: torch.Tensor, passed: torch.Tensor) -> torch.Tensor:
    """Return periodic intensities whose frequencies are passed by some shares."""
    return torch.fft.irfft2(torch.fft.rfft2(light) * passed.to(light), light.shape[-2:])


def _repeated(values: torch.Tensor, places: int) -> torch.Tensor:
    """Return means at places of pixels, with that about the last pixel in place of those beyond it."""
    for axis in (-1, -2):
        kept = values.shape[axis] - places + 1
        last = values.narrow(axis, kept - 1, 1)
        values = torch.cat([values.narrow(axis, 0, kept), *[last] * (places - 1)], axis)
    return values


@functools.lru_cache(16)
def _turned_shares(
    sides: tuple[float, float], pitches: tuple[float, float], turned: float, places: int
) -> torch.Tensor:
    """Return the share that each pixel about it has of a turned square at places of a pixel ``[places², 1, n, n]``."""
    angle, line = math.radians(turned), (np.arange(_POINTS) + 0.5) / _POINTS - 0.5
    parts = np.meshgrid(line, line, indexing="ij")
    y, x = (side * p * part for side, p, part in zip(sides, pitches, parts, strict=True))
    down = (math.cos(angle) * y + math.sin(angle) * x) / pitches[0]
    across = (math.cos(angle) * x - math.sin(angle) * y) / pitches[1]
    around = math.ceil(max(abs(down).max(), abs(across).max()) + 0.5)
    edges = np.arange(2 * around + 2) - around - 0.5
    whole = [
        np.histogram2d((down + i / places).ravel(), (across + j / places).ravel(), (edges, edges))[0]
        for i in range(places)
        for j in range(places)
    ]
    return torch.from_numpy(np.stack(whole)[:, None] / line.size**2)


def pixels_of(light: torch.Tensor, samples: int, shape: Sequence[int]) -> tuple[slice, ...]:
    """Return which samples of an intensity are the middles of the pixels of an image; see :func:`resolved`."""
    first = [m // 2 - n // 2 * samples for m, n in zip(light.shape, shape, strict=True)]
    return tuple(slice(a, a + n * samples, samples) for a, n in zip(first, shape, strict=True))


def means_of_squares(target: torch.Tensor, places: Sequence[np.ndarray], sides: Sequence[float]) -> torch.Tensor:
    """Return the means of a picture of squares over squares about places of rows and of columns, in pixels.

    Of squares that reach beyond the picture, the mean of what lies within it.
    """
    down, across = (
        torch.from_numpy(_shares(n, np.asarray(p, float), side)).to(target)
        for n, p, side in zip(target.shape[-2:], places, sides, strict=True)
    )
    return down @ target @ across.mT


def _shares(count: int, places: np.ndarray, side: float) -> np.ndarray:
    """Return which share of squares about places each of some pixels has along an axis, ``[places, count]``."""
    half, pixels, places = max(side / 2, 1e-6), np.arange(count), np.minimum(places, count - 0.5)
    low, high = places[:, None] - half, places[:, None] + half
    covered = np.clip(np.minimum(high, pixels + 0.5) - np.maximum(low, pixels - 0.5), 0, None)
    return covered / covered.sum(1, keepdims=True)


def _filtered(values: torch.Tensor, samples: int, side: float, grids: int, axis: int, beyond: int) -> torch.Tensor:
    """Return means of some side about pixels along an axis of ``[planes, ..., ...]``, `grids` for each pixel.

    Values have some pixels more beyond each end.
    """
    # A tensor without values has no copy of them either.
    device = torch.device("cpu") if values.is_meta else values.device
    here, after = (part.to(values) for part in _weights(samples, side, grids, values.dtype, device))
    reach, step, count = _reach(samples, side), len(here), values.shape[axis] // samples - 2 * beyond
    blocks = -(-count * samples // step)
    before = reach - beyond * samples
    values = _continued(values, before, (blocks + 1) * step - values.shape[axis] - before, axis)
    values = values.unflatten(axis, (blocks + 1, step))
    # A block of means depends on the points of its own block and on the first ones of the next.
    if axis == -2:
        means = here.mT @ values[:, :-1] + after.mT @ values[:, 1:, : len(after)]
        whole = means.flatten(1, 2)[:, : count * grids]
    else:
        means = values[..., :-1, :] @ here + values[..., 1:, : len(after)] @ after
        whole = means.flatten(-2)[..., : count * grids]
    if grids == 1:
        return whole
    # The last lies half beyond the picture.
    return torch.cat([whole.narrow(axis, 0, 2 * count - 1), whole.narrow(axis, 2 * count - 2, 1)], axis)


def _continued(values, before, after, axis):
    """Return values that are continued at the ends of an axis by their last ones."""
    ends = []
    for place, count in ((0, before), (values.shape[axis] - 1, after)):
        shape = list(values.shape)
        shape[axis] = count
        ends.append(values.narrow(axis, place, 1).expand(shape))
    return torch.cat([ends[0], values, ends[1]], axis)


def _reach(samples: int, side: float) -> int:
    return samples * (REACH + math.ceil(max(0.0, side - 1) / 2))


@_array.constant_in_graphs
def _weights(
    samples: int, side: float, grids: int, dtype: torch.dtype, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return :func:`_matrices`, for a graph of torch.compile to hold."""
    return _matrices(samples, side, grids, dtype, device)


@functools.lru_cache(256)
def _matrices(
    samples: int, side: float, grids: int, dtype: torch.dtype, device: torch.device
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the matrices from the points of a block of pixels, and of the next, to `grids` means for each pixel.

    They are kept for each device: a copy in every call would wait for the work that is queued there.
    """
    reach = _reach(samples, side)
    pixels = max(_BLOCK, 2 * reach // samples + 1)
    whole = np.zeros((pixels * samples + 2 * reach + samples, pixels * grids))
    for grid in range(grids):
        taps, first = _taps(samples, side, grid / grids, reach)
        for pixel in range(pixels):
            start = pixel * samples + first
            whole[start : start + len(taps), pixel * grids + grid] = taps
    with _torch_private.outside_functional_transforms(), _torch_private.keeping():
        matrix = torch.from_numpy(whole).to(device, dtype)
        here, beyond = matrix.split([pixels * samples, 2 * reach + samples])
    return here, beyond


def _taps(samples: int, side: float, place: float, reach: int) -> tuple[np.ndarray, int]:
    """Return the weights of a mean about a place of a pixel, of an intensity that is known at points of each pixel.

    The intensity has frequencies up to samples/2 cycles per pixel, at which its spectrum, an autocorrelation, falls to
    zero. The spectrum of the weights is the nearest one to the mean's sin(πsf)/(πsf), by least squares with a weight
    that falls alike. The second result is the first point that has a weight, `reach` points before the middle of the
    pixel.
    """
    cycles = np.linspace(0, samples / 2, 64 * samples)
    middle = place * samples
    # Distances from the place of the points on one side of it, which lie alike on the other.
    lags = np.arange(reach + 1) if middle == int(middle) else np.arange(reach) + 0.5
    columns = np.cos(2 * np.pi * cycles[:, None] * lags / samples) * np.where(lags == 0, 1, 2)
    weight = (1 - cycles / (samples / 2))[:, None] ** 1.5 + 3e-3
    half = np.linalg.lstsq(columns * weight, np.sinc(side * cycles)[:, None] * weight, rcond=None)[0][:, 0]
    whole = np.concatenate([half[:0:-1] if lags[0] == 0 else half[::-1], half])
    return whole / whole.sum(), round(middle - lags[-1]) + reach
