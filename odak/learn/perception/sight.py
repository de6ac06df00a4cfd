"""Conditions of viewing: the geometry and luminances of a display, where the eye looks, and whose eye it is.

What numbers or a :class:`Viewing` describe is read and checked here, for all maps, blurs, losses and measures.
"""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Union

import torch
from torch import nn

from odak import _array, _validate
from odak._warnings import ArgumentWarning, warn

# A gaze farther from the picture, in its widths and heights or in radians, is one in pixels or degrees.
_FARTHEST = 10.0
# Pictures of other angles, in degrees, are seen by no eye: their width and distance have two units.
_NARROWEST, _WIDEST = 0.5, 170.0

Gaze = Union[Sequence[float], Sequence[Sequence[float]], torch.Tensor]


@_validate.takes_units("real_image_width", "real_viewing_distance")
@dataclass(frozen=True, repr=False)
class Viewing:
    """How pictures are seen: size and distance of the display, its luminances, the light around it, and the gaze.

    Pictures fill the width of the display, whatever the number of their pixels, which are square.

    Parameters
    ----------
    real_image_width : float
        Width of the display.
    real_viewing_distance : float
        Distance of the eye from its centre, in the same unit.
    resolution : tuple of int, optional
        Rows and columns of the display, for which `pixels_per_degree` is stated.
    gaze : sequence of float
        (x, y), 0 to 1 from the top-left corner; or a track ``[B, 2]``, one for each picture of a batch or each frame.
        Losses and measures take it where they are called without one.
    peak_luminance : float
        Of white, in cd/m².
    black_luminance : float
        Of black in the dark, in cd/m².
    ambient_light : float
        Illuminance of the display by the light around it, in lux.
    reflectivity : float
        Share of that light which the display reflects, in all directions alike.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.

    Examples
    --------
    >>> from odak.learn.perception import Viewing
    >>> Viewing(0.7, 0.7, (2160, 3840), peak_luminance=200, black_luminance=0.2)
    Viewing: 53.1° wide, 67 pixels per degree, 0.2 to 200 cd/m², gaze (0.5, 0.5)
    """

    real_image_width: float = 0.2
    real_viewing_distance: float = 0.7
    resolution: tuple[int, int] | None = None
    gaze: Gaze = (0.5, 0.5)
    peak_luminance: float = 100.0
    black_luminance: float = 0.1
    ambient_light: float = 0.0
    reflectivity: float = 0.005

    def __post_init__(self) -> None:
        width, distance = _validate.constants(
            real_image_width=self.real_image_width, real_viewing_distance=self.real_viewing_distance
        )
        width, distance = checked_view(width, distance)
        peak, black = (
            _validate.constant(name, getattr(self, name), positive=True)
            for name in ("peak_luminance", "black_luminance")
        )
        if black >= peak:
            raise ValueError(f"black_luminance must be less than the peak {peak:g}, got {black:g}")
        ambient = _validate.constant("ambient_light", self.ambient_light, least=0)
        reflectivity = _validate.constant("reflectivity", self.reflectivity, least=0, most=1)
        size = None if self.resolution is None else _validate.size("resolution", self.resolution)
        values = float(width), float(distance), size, gaze_of("gaze", self.gaze), peak, black, ambient, reflectivity
        for one, value in zip(fields(self), values, strict=True):
            object.__setattr__(self, one.name, value)

    @classmethod
    def head_mounted(
        cls,
        resolution: tuple[int, int],
        field_of_view: float | None = None,
        pixels_per_degree: float | None = None,
        gaze: Gaze = (0.5, 0.5),
        peak_luminance: float = 100.0,
        black_luminance: float = 0.1,
    ) -> "Viewing":
        """Return the viewing of a head-mounted display, whose image is flat and one unit of length away.

        Parameters
        ----------
        resolution : tuple of int
            Rows and columns for one eye.
        field_of_view : float, optional
            Angle that the image is wide, in degrees.
        pixels_per_degree : float, optional
            Pixels per degree in the middle of the image; one of the two is given.
        gaze : sequence of float
            (x, y) of the gaze or a track, as for :class:`Viewing`.
        peak_luminance : float
            Of white, in cd/m².
        black_luminance : float
            Of black, in cd/m².

        Examples
        --------
        >>> from odak.learn.perception import Viewing
        >>> Viewing.head_mounted((2000, 2000), field_of_view=100)
        Viewing: 100° wide, 14.6 pixels per degree, 0.1 to 100 cd/m², gaze (0.5, 0.5)
        """
        _, columns = _validate.size("resolution", resolution)
        if (field_of_view is None) == (pixels_per_degree is None):
            raise ValueError(
                f"field_of_view or pixels_per_degree must be given, not both, got {field_of_view} and "
                f"{pixels_per_degree}"
            )
        if field_of_view is None:
            width = columns / math.degrees(1) / _validate.constant("pixels_per_degree", pixels_per_degree)
        else:
            angle = _validate.constant("field_of_view", field_of_view, positive=True, below=180, unit="degrees")
            width = 2 * math.tan(math.radians(angle) / 2)
        return cls(width, 1.0, resolution, gaze, peak_luminance, black_luminance)

    @property
    def field_of_view(self) -> float:
        """Angle that the display is wide, in degrees."""
        return angle_of(self.real_image_width, self.real_viewing_distance)

    @property
    def area(self) -> float:
        """Area of the display in square degrees; that of a square one where its resolution is not known."""
        rows, columns = self.resolution or (1, 1)
        height = angle_of(self.real_image_width * rows / columns, self.real_viewing_distance)
        return self.field_of_view * height

    @property
    def pixels_per_degree(self) -> float:
        """Pixels of the display per degree, in its middle."""
        if self.resolution is None:
            raise ValueError("resolution must be given for pixels_per_degree, got None")
        return self.density(self.resolution[1])

    def density(self, columns: int) -> float:
        """Return the pixels per degree, in its middle, of a picture of so many columns."""
        return columns * self.real_viewing_distance / self.real_image_width / math.degrees(1)

    @property
    def reflected(self) -> float:
        """Luminance of the light around the display that it reflects, in cd/m²."""
        return self.ambient_light * self.reflectivity / math.pi

    @property
    def darkest(self) -> float:
        """Luminance of black with the light that is reflected, in cd/m²."""
        return self.black_luminance + self.reflected

    def luminance(self, light: torch.Tensor) -> torch.Tensor:
        """Return the luminance in cd/m² of light that is 0 for black and 1 for white."""
        return self.darkest + (self.peak_luminance - self.black_luminance) * light

    def __repr__(self) -> str:
        words = [f"{self.field_of_view:.3g}° wide"]
        words += [] if self.resolution is None else [f"{self.pixels_per_degree:.3g} pixels per degree"]
        words.append(f"{self.darkest:.3g} to {self.peak_luminance + self.reflected:.4g} cd/m²")
        single = isinstance(self.gaze, Point)
        words.append("gaze ({:g}, {:g})".format(*self.gaze) if single else f"a track of {len(self.gaze)} gazes")
        return f"Viewing: {', '.join(words)}"


def viewing_of(
    viewing: Viewing | None, width: float, distance: float, peak: float = 100.0, black: float = 0.1
) -> Viewing:
    """Return the viewing that is given, or else that of a width, a distance and the luminances of white and black."""
    if viewing is None:
        return Viewing(width, distance, peak_luminance=peak, black_luminance=black)
    return checked_viewing(viewing)


def checked_viewing(viewing: Viewing) -> Viewing:
    """Return a viewing after checking that it is one."""
    return _validate.instance("viewing", viewing, Viewing, "an odak.learn.perception.Viewing")


def geometry(
    viewing: Viewing | None, real_image_width: float | torch.Tensor, real_viewing_distance: float | torch.Tensor
) -> tuple[Any, Any]:
    """Return the width of a picture and the distance of the eye; tensors that require a gradient are kept."""
    if viewing is not None:
        return checked_viewing(viewing).real_image_width, viewing.real_viewing_distance
    width, distance = checked_view(real_image_width, real_viewing_distance)
    return _number(width), _number(distance)


def gaze_at(viewing: Viewing | None, gaze: Gaze | None) -> Any:
    """Return a gaze, or that of a viewing where there is none."""
    return checked_viewing(viewing).gaze if gaze is None and viewing is not None else gaze


def checked_view(
    real_image_width: float | torch.Tensor, real_viewing_distance: float | torch.Tensor
) -> tuple[float | torch.Tensor, float | torch.Tensor]:
    """Return the width of a picture and the distance of the eye, after warning of an angle that no display has."""
    width = _validate.number("real_image_width", real_image_width, positive=True)
    distance = _validate.number("real_viewing_distance", real_viewing_distance, positive=True)
    if _array.is_readable(width) and _array.is_readable(distance):
        wide, far = _validate.numbers((width, distance))
        angle = angle_of(wide, far)
        if not _NARROWEST <= angle <= _WIDEST:
            warn(
                f"real_image_width {wide:g} at real_viewing_distance {far:g} is a picture of {angle:.2g} degrees: both "
                "are lengths in one unit",
                ArgumentWarning,
            )
    return width, distance


def angle_of(length: float, distance: float) -> float:
    """Return the angle in degrees of a length that stands upright at a distance, its middle on the axis."""
    return 2 * math.degrees(math.atan(length / 2 / distance))


def _number(value):
    """Return a tensor that requires a gradient as one of float64 without axes, any other number as a float."""
    return value.to(torch.float64).reshape(()) if _array.is_traced(value) else float(value)


class Point(tuple):
    """Two floats that have been checked, so that nothing is told of them again under another name."""


class Track(tuple):
    """Points that have been checked, one for each picture of a batch."""


def gaze_of(name: str, value: Any, count: int | None = None) -> Any:
    """Return a gaze as a :class:`Point`, or gazes ``[B, 2]`` as a :class:`Track` of `count`; without gradients."""
    if _is_plain(value):
        return Point(value)
    if not isinstance(value, (Point, Track)):
        value = Track(point(name, one) for one in value) if _several(value) else point(name, value)
    if isinstance(value, Track) and count is not None and len(value) != count:
        shape = (len(value), 2)
        raise ValueError(f"{name} must be (x, y) or [B, 2] for {count} pictures, got shape {shape}")
    return value


def _is_plain(value) -> bool:
    """Return whether a gaze is two floats near the picture, of which nothing has to be asked."""
    if type(value) not in (list, tuple) or [*map(type, value)] != [float, float]:
        return False
    x, y = value
    return -_FARTHEST <= x <= _FARTHEST and -_FARTHEST <= y <= _FARTHEST


def each_of(gaze: Point | Track) -> Sequence[Point]:
    """Return the gazes of a track, or the one gaze."""
    return gaze if isinstance(gaze, Track) else [gaze]


def parts_of(pictures: torch.Tensor, gazes: Sequence[Point]) -> list[tuple[torch.Tensor, Point]]:
    """Return each picture of a batch with its gaze, or all of them with their one gaze."""
    parts = [pictures] if len(gazes) == 1 else pictures.split(1)
    return list(zip(parts, gazes, strict=True))


def _several(value) -> bool:
    """Return whether a gaze is ``[B, 2]``; one of a single row is one for all."""
    if _array.is_array(value):
        return value.ndim == 2 and len(value) > 1
    first: Any = value[0] if isinstance(value, (list, tuple)) and value else None
    return isinstance(first, (list, tuple)) or (_array.is_array(first) and first.ndim == 1)


def point(name: str, value: Any) -> Point:
    """Return two finite floats, which carry no gradient."""
    if isinstance(value, Point):
        return value
    x, y = (_validate.constant(name, number) for number in _two(name, value))
    if max(abs(x), abs(y)) > _FARTHEST:
        warn(
            f"{name} must be shares of the picture's width and height, 0 to 1 within it; got ({x:g}, {y:g}), far "
            "outside: divide pixels by its width and height",
            ArgumentWarning,
        )
    return Point((x, y))


def places_of(name: str, value: Any, device: torch.device | None) -> tuple[Any, Any]:
    """Return x and y of a gaze, each a number or, of gazes ``[B, 2]``, a tensor ``[B, 1, 1]``; gradients are kept."""
    if not _several(value):
        return _two(name, value)
    pairs = [[torch.as_tensor(v, dtype=torch.float64, device=device) for v in _two(name, one)] for one in value]
    x, y = (torch.stack(one)[:, None, None] for one in zip(*pairs, strict=True))
    return x, y


def _two(name, value) -> tuple:
    """Return two finite numbers as a copy, so that later changes of a list have no effect."""
    try:
        x, y = _validate.several(name, value.reshape(-1) if _array.is_array(value) else value, 2)
    except ValueError as error:
        raise ValueError(f"{name} must be two finite numbers, got {value!r}") from error
    return _number(x), _number(y)


class Kept:
    """Results by what they depend on: the last one, or as many as one call asks for."""

    def __init__(self) -> None:
        self._results: dict[Hashable, Any] = {}
        self.room = 1

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """Return the result of a key, made where there is none."""
        if key in self._results:
            result = self._results.pop(key)
        else:
            result = make()
            while len(self._results) >= self.room:
                del self._results[next(iter(self._results))]
        self._results[key] = result
        return result

    def clear(self) -> None:
        """Drop all results."""
        self._results.clear()


def _of_the_viewing(name: str) -> Any:
    """Return a property that is a field of the viewing of a loss; a change makes another viewing."""
    return property(
        lambda self: getattr(self.viewing, name),
        lambda self, value: setattr(self, "viewing", replace(self.viewing, **{name: value})),
    )


class Seen(nn.Module):
    """Base of losses of pictures that are seen as a :class:`Viewing` says.

    Attributes
    ----------
    viewing : Viewing
        How pictures are seen.
    real_image_width, real_viewing_distance, peak_luminance, black_luminance
        Of the viewing; a change counts from the next call on.
    """

    viewing: Viewing
    real_image_width: float = _of_the_viewing("real_image_width")
    real_viewing_distance: float = _of_the_viewing("real_viewing_distance")
    peak_luminance: float = _of_the_viewing("peak_luminance")
    black_luminance: float = _of_the_viewing("black_luminance")

    def _gaze(self, gaze: Any, count: int | None = None) -> Any:
        """Return the gaze that a call gives, or else that of the viewing; see :func:`gaze_of`."""
        return gaze_of("gaze", self.viewing.gaze if gaze is None else gaze, count)
