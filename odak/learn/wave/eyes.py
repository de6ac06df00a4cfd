"""Eyes that look at a display, and the way of light from its pixels to their retinas."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from scipy import fft, special

from odak import _array, _validate
from odak.instruments import Lens
from odak.learn._tensors import tensor
from odak.wave.viewing import ROTATION_RADIUS

# Points along the diameter of a pupil, at least, and on each side beyond its rim, where what stands for the rim ends.
_POINTS, _BESIDE = 32, 6
# Times the width of an image that its points resolve, and pixels of this width at the rims of the panel.
_FINER, _RIMS = 1.25, 8
# Steps along rows and columns of a sequence that fills a square evenly: 1/g and 1/g² with g³ = g + 1.
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
# Share of what points resolve that is whole.
_WHOLE = 0.6


@runtime_checkable
class Eyepiece(Protocol):
    """A lens system by rays from a panel to pupils: :class:`odak.learn.raytracing.system.TracedSystem`."""

    @property
    def path_length(self) -> Any:
        """Length of its axis in metres."""

    def matrix(self) -> list[Any]:
        """Return its ray matrix, lengths in metres."""

    def passage(self, shape: Sequence[int], pitch: Any, wavelength: float) -> Any:
        """Return what it does to fields of a shape."""


@_validate.takes_units("distance", "positions", "diameter", "focus", degrees=("rotation",))
@dataclass(frozen=True)
class Eyes:
    """Eyes that look at a display: what :class:`Display` takes in place of distances of planes.

    Use them for near-eye displays and for eyeboxes: the images are those on the retinas of K eyes, or of one eye at K
    places. With an eyepiece, give the :class:`odak.instruments.Lens` between the panel and the pupil, whose distance
    from the lens is `after`. Light is followed from the pixels to the pupil by direct sums of Fresnel's integral. Or
    give a :class:`odak.learn.raytracing.system.TracedSystem` from the panel to the plane of the pupils: images then
    have the aberrations, distortion and colours of the eyepiece. Such eyes are not rotated, their display has the stop
    "order" and no mask, and `torch.compile` does not take it.

    Parameters
    ----------
    distance : float, odak.instruments.Lens or odak.learn.raytracing.system.TracedSystem
        Distance from the panel, or from its image by a relay, to the pupils in metres; or the eyepiece before them. Of
        a traced system the size and place of the result follow from the pupils, and images have the scale of its first
        order at its reference wavelength when the eyes are made; its numbers may require gradients.
    positions : sequence of sequence of float
        Middles of the pupils (y, x) in metres, ``[K, 2]``; the axis by default.
    diameter : float or sequence of float
        Diameter of the pupil in metres, one or ``[K]``.
    focus : float or sequence of float, optional
        Distance in metres on which the eye is focused, infinity included, one or ``[K]``; by default the panel, as it
        is seen through the eyepiece.
    rotation : sequence
        Angles in degrees (rows, columns) by which the eye is rotated about its centre, ``[2]`` or ``[K, 2]``: the pupil
        moves to the side and back, and appears narrower, as in :func:`odak.learn.wave.eye_image`.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    A sample of the image is the direction in which its pixel of the panel is seen from the middle of the pupil.

    Examples
    --------
    >>> from odak.instruments import Lens
    >>> from odak.learn.wave import Eyes
    >>> len(Eyes(Lens("40mm", after="25mm"), [[0.0, -1e-3], [0.0, 1e-3]], "3mm"))
    2
    """

    distance: float | Lens | Eyepiece
    positions: Sequence[Any] = ((0.0, 0.0),)
    diameter: float | Sequence[float] = 4e-3
    focus: float | Sequence[float] | None = None
    rotation: Sequence[Any] = (0.0, 0.0)

    def __post_init__(self) -> None:
        def keep(name, values):
            object.__setattr__(self, name, values)

        given = {name: getattr(self, name) for name in ("positions", "diameter", "focus", "rotation")}
        positions, diameter, focus, rotation = _validate.constants(**given)
        if isinstance(self.distance, Eyepiece):
            with torch.no_grad():
                (a, b), (_, d) = self.distance.matrix()
            keep("_first_order", (float(a), float(b), float(d)))
        elif not isinstance(self.distance, Lens):
            keep("distance", _validate.constant("distance", self.distance, positive=True))
        elif self.distance.block:
            raise ValueError(f"distance must be a lens without a block before an eye, got {self.distance!r:.80}")
        places = tensor("positions", positions, torch.float64)
        _validate.shaped("positions", places, "[K, 2], not empty")
        keep("positions", tuple(map(tuple, _validate.real("positions", places).tolist())))
        keep("diameter", tuple(of_each("diameter", diameter, places).tolist()))
        if self.focus is not None:
            keep("focus", tuple(of_each("focus", focus, places).tolist()))
        keep("rotation", tuple(map(tuple, angles_of_each(rotation, len(places)).tolist())))
        if isinstance(self.distance, Eyepiece) and any(map(any, self.rotation)):
            raise ValueError(f"rotation must be 0 behind a traced eyepiece, got {self.rotation!r:.80}")

    @classmethod
    @_validate.takes_units("distance", "box", "diameter", "focus")
    def within(
        cls,
        distance: float | Lens | Eyepiece,
        box: float | Sequence[float],
        count: int,
        diameter: float | Sequence[float] = (2e-3, 6e-3),
        focus: float | Sequence[float] | None = None,
        seed: int = 0,
    ) -> "Eyes":
        """Return pupils drawn at random in an eyebox: what a hologram is to be optimised for, or judged by.

        Parameters
        ----------
        distance : float, odak.instruments.Lens or odak.learn.raytracing.system.TracedSystem
            Distance from the panel to the pupils in metres, or the eyepiece before them.
        box : float or sequence of float
            Height and width in metres of the area of the pupils' middles, about the axis.
        count : int
            Number of pupils.
        diameter : float or sequence of float
            Diameter of the pupils in metres, or the least and the largest.
        focus : float or sequence of float, optional
            Distance in metres on which the eyes are focused, or the nearest and the furthest, infinity included,
            between which it is drawn evenly in dioptres; by default the panel.
        seed : int
            Seed of the random numbers. All are spread evenly: the middles over the area, and diameters and focuses one
            in each of `count` equal intervals.

        Returns
        -------
        Eyes
            The pupils.

        Examples
        --------
        >>> from odak.learn.wave import Eyes
        >>> eyes = Eyes.within(0.1, (2e-3, 4e-3), 16, focus=(0.25, float("inf")))
        >>> len(eyes), min(eyes.diameter) < 2.5e-3 < 5.5e-3 < max(eyes.diameter)
        (16, True)
        """
        count = _validate.integer("count", count, minimum=1)
        draw = np.random.default_rng(_validate.integer("seed", seed, minimum=0))
        even = [(draw.permutation(count) + draw.random(count)) / count for _ in range(2)]
        # Roberts' sequence, which fills an area evenly, from a random place on.
        places = (draw.random(2) + np.arange(count)[:, None] * _STEPS) % 1 - 0.5
        sides = np.array(_validate.pair("box", box))
        least, most = _validate.pair("diameter", diameter, positive=True)
        foci = None
        if focus is not None:
            near, far = np.broadcast_to(np.asarray(focus, float), 2)
            if not min(near, far) > 0:
                raise ValueError(f"focus must be positive distances, infinity included; got {focus!r:.80}")
            dioptres = 1 / near + (1 / far - 1 / near) * even[1]
            foci = [1 / one if one > 0 else math.inf for one in dioptres.tolist()]
        positions = (places * sides).tolist()
        return cls(distance, positions, (least + (most - least) * even[0]).tolist(), foci)

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class Sight:
    """The way of the light of one wavelength from the pixels of a panel through one pupil to a retina.

    Fresnel's integral over a small square pixel is its value at the middle times the sinc function of the angle. Both
    are products of a function of rows and one of columns: two matrix products lead to the points of a pupil, and two to
    those of an image, without the transforms of the whole plane (Soummer et al., Opt. Express 15, 15935 (2007)).

    Attributes
    ----------
    eyes : Eyes
        The eyes.
    eye : int
        Which of them.
    sizes, pitches : tuple
        Pixels of the panel along rows and columns, and their distances in metres.
    wavelength : float
        Wavelength in metres.
    width : float
        Width of what emits of a pixel, as a share of its pitch.
    one_order : bool
        Whether a stop passes one diffraction order alone.
    cells : int
        Cells along each axis of a pixel, of a mask in contact with the panel that lets all orders pass.
    """

    eyes: Eyes
    eye: int
    sizes: tuple[int, int]
    pitches: tuple[float, float]
    wavelength: float
    width: float
    one_order: bool
    cells: int = 1

    def ray_matrix(self) -> tuple[float, float, float]:
        """Return A, B and D of the ray matrix from the panel to the pupil, which recedes as the eye turns."""
        down, across = map(math.radians, self.eyes.rotation[self.eye])
        receded, path = ROTATION_RADIUS * (1 - math.cos(down) * math.cos(across)), self.eyes.distance
        if isinstance(path, Eyepiece):
            return self.eyes._first_order  # type: ignore[attr-defined,no-any-return]
        if not isinstance(path, Lens):
            return 1.0, path + receded, 1.0
        return *path.moved(receded).ray_matrix, 1 - float(path.before or 0.0) / path.focal_length

    def pupil(self) -> tuple[list[float], list[float]]:
        """Return the middle and the half widths of the pupil along rows and columns in metres."""
        turns, place = [math.radians(angle) for angle in self.eyes.rotation[self.eye]], self.eyes.positions[self.eye]
        middle = [p + ROTATION_RADIUS * math.sin(t) for p, t in zip(place, turns, strict=True)]
        return middle, [self.eyes.diameter[self.eye] / 2 * math.cos(t) for t in turns]  # type: ignore[index]

    def defocus(self) -> float:
        """Return the curvature in 1/m that the light of a pixel has in the pupil beyond what the eye focuses."""
        (_, b, d), focus = self.ray_matrix(), self.eyes.focus
        return 0.0 if focus is None else d / b - 1 / focus[self.eye]  # type: ignore[index]

    def blur(self) -> float:
        """Return how wide the image of a point is by the defocus, in metres on the panel."""
        return abs(self.defocus() * self.ray_matrix()[1]) * 2 * max(self.pupil()[1])

    def box(self, axis: int) -> float:
        """Return how wide one diffraction order of a pixel is in the plane of the pupil, in metres."""
        return self.wavelength * abs(self.ray_matrix()[1]) / self.pitches[axis]

    def samples(self) -> int:
        """Return how many points of each pixel describe the intensity of the image."""
        widths = [2 * half / self.box(axis) for axis, half in enumerate(self.pupil()[1])]
        widths = [min(1.0, width) for width in widths] if self.one_order else widths
        return max(1, math.ceil(2 * max(widths) - 1e-9))

    def seen(self) -> float:
        """Return the least share of the rows or columns whose light, of the order in the middle, reaches the pupil."""
        a, shares = self.ray_matrix()[0], []
        for axis, (middle, half) in enumerate(zip(*self.pupil(), strict=True)):
            reached = abs(middle - a * self._places(axis)) < self.box(axis) / 2 + half
            shares.append(float(reached.mean()))
        return min(shares)

    def to_pupil(self, axis: int) -> np.ndarray:
        """Return the matrix from the cells of pixels to points of the pupil along an axis, ``[points, cells]``."""
        a, b, _ = self.ray_matrix()
        there, x = self.points(axis)[0][:, None] + self.pupil()[0][axis], self._places(axis)
        # Of each cell, the part within what emits of the pixel.
        rims = np.clip(np.arange(self.cells + 1) / self.cells - 0.5, -self.width / 2, self.width / 2)
        x = (x[:, None] + (rims[1:] + rims[:-1]) / 2 * self.pitches[axis]).ravel()
        widths = np.tile(np.diff(rims), self.sizes[axis])
        # Of the order of a pixel: ±1/2 at its edges.
        order = (there - a * x) / self.box(axis)
        if self.one_order:
            envelope = _through_stop(
                order, a * self.pitches[axis] ** 2 / (self.wavelength * b), self.width, self._band(axis)
            )
        else:
            envelope = np.sinc(widths * order) * (widths / self.width)
        return envelope * _array.phasor_of_cycles((a * x - 2 * there) * x / (2 * self.wavelength * b))

    def through_pupil(self) -> np.ndarray:
        """Return what the pupil passes, with the phase that the eye does not focus, complex128 ``[points, points]``."""
        (down, fine), (across, more) = self.points(0), self.points(1)
        halves = self.pupil()[1]
        frequencies = np.fft.fftfreq(len(down), fine)[:, None], np.fft.fftfreq(len(across), more)
        # The spectrum of an ellipse, without what is faster than the points resolve.
        rho = 2 * np.pi * np.hypot(*(f * half for f, half in zip(frequencies, halves, strict=True)))
        spectrum = np.where(rho == 0, 1, 2 * special.j1(rho) / np.where(rho == 0, 1, rho)) * math.pi * math.prod(halves)
        for f, step in zip(frequencies, (fine, more), strict=True):
            spectrum = spectrum * _fading(2 * step * f) / step
        passed = np.fft.fftshift(np.fft.ifft2(spectrum)).real
        return passed * _array.phasor_of_cycles(
            self.defocus() / (2 * self.wavelength) * (down[:, None] ** 2 + across**2)
        )

    def to_retina(self, axis: int, samples: int, beyond: int) -> np.ndarray:
        """Return the matrix from the pupil to points of an image along an axis, ``[pixels · samples, points]``.

        Some pixels more lie beyond each rim of the image.
        """
        b, (points, step) = self.ray_matrix()[1], self.points(axis)
        there = points + self.pupil()[0][axis]
        turn = _array.phasor_of_cycles(self._places(axis, samples, beyond)[:, None] * there / (self.wavelength * b))
        return turn * (step / self.box(axis))

    def part(self, which: int, samples: int, beyond: int) -> np.ndarray:
        """Return one of five parts: two matrices to the pupil, what it passes, and two matrices to the retina."""
        if which == 2:
            return self.through_pupil()
        return self.to_pupil(which) if which < 2 else self.to_retina(which - 3, samples, beyond)

    def _places(self, axis: int, samples: int = 1, beyond: int = 0) -> np.ndarray:
        n, pitch = self.sizes[axis], self.pitches[axis]
        return (np.arange(-beyond * samples, (n + beyond) * samples) / samples - n // 2) * pitch

    def _band(self, axis: int) -> float:
        """Return how far from a pixel, in pixels, its light is followed: over the image, its rims and its blur."""
        return _FINER * (self.sizes[axis] + _RIMS + self.blur() / self.pitches[axis])

    def points(self, axis: int) -> tuple[np.ndarray, float]:
        """Return points from the middle of the pupil, and some beyond its rim, and how far apart they are."""
        width = 2 * self.pupil()[1][axis]
        step = width / max(_POINTS, 2 * self._band(axis) * width / self.box(axis))
        count = math.ceil(width / (2 * step)) + _BESIDE
        return np.arange(-count, count + 1) * step, step


def _through_stop(order: np.ndarray, fresnel_number: float, width: float, band: float) -> np.ndarray:
    """Return the light of a pixel behind a stop of one order, at places in units of the order from its middle.

    The stop turns a pixel, a square of some width, into sinc functions about all its points. The transform of these
    over so many pixels, with Fresnel's phase, is the light (Goodman, Introduction to Fourier Optics (2005), 4.2).
    """
    rate = 4 * math.ceil(1 + abs(fresnel_number) * band)
    y = np.arange(-math.ceil(band * rate), math.ceil(band * rate) + 1) / rate
    nodes, weights = np.polynomial.legendre.leggauss(8)
    pixel = np.sinc(y[:, None] - width / 2 * nodes) @ (weights / 2) * _fading(y / band)
    # As many frequencies that values between them follow.
    count = fft.next_fast_len(64 * len(y))
    turned = np.zeros(count, complex)
    turned[: len(y)] = pixel * _array.phasor_of_cycles(fresnel_number / 2 * y**2) / rate
    values = np.fft.fftshift(np.fft.fft(np.roll(turned, -(len(y) // 2))))
    return np.interp(order, np.fft.fftshift(np.fft.fftfreq(count, 1 / rate)), values, 0, 0)


def _fading(places: np.ndarray) -> np.ndarray:
    """Return 1 in the middle of ±1, and half a cosine's fall to 0 at its ends."""
    return 0.5 + 0.5 * np.cos(np.pi * np.clip((abs(places) - _WHOLE) / (1 - _WHOLE), 0, 1))


def of_each(name: Any, value: Any, places: Any) -> Any:
    """Return a length for each place, ``[K]``; None for None."""
    if value is None:
        return None
    if name == "focus":
        lengths = tensor(name, value, torch.float64).to(places.device)
        if not bool((lengths > 0).all()):
            raise ValueError(f"focus must be positive distances, infinity included; got {value!r:.80}")
    else:
        lengths = tensor(name, _validate.real(name, value, positive=True), torch.float64).to(places.device)
    _validate.shaped(name, lengths, f"one number or [{len(places)}]")
    return lengths.expand(len(places))


def angles_of_each(rotation: Any, count: Any) -> Any:
    """Return the angles of each place in degrees, ``[K, 2]``."""
    turns = tensor("rotation", rotation, torch.float64, torch.device("cpu"))
    _validate.shaped("rotation", turns, f"[2] or [{count}, 2]")
    if bool((turns.abs() >= 90).any()):
        raise ValueError(f"rotation must be within ±90 degrees, got {turns.tolist()}")
    return turns.detach().expand(count, 2)
