"""Polarising films on surfaces: polarisers, half mirrors, wave plates and tables of Jones matrices."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from types import ModuleType
from typing import Any, ClassVar, NamedTuple

import numpy as np

from odak import _validate
from odak._array import Amount, Array, is_array, is_readable, namespace, phasor_of_cycles, to_complex
from odak.catalog.materials import MICROMETRES, OpticalMaterial, refractive_index
from odak.catalog.materials import material as find_material
from odak.jones.calculus import DEGREE, stack_matrix
from odak.raytracing.surfaces import Parametric

# Square of the least cosine of a direction within a film.
GRAZING = 1e-12


class FilmMatrices(NamedTuple):
    """Jones matrices of a film for rays.

    Attributes
    ----------
    transmission, reflection : array
        Complex ``[..., 2, 2]``. Squared moduli are powers.
    """

    transmission: Any
    reflection: Any


@dataclass(frozen=True)
class PolarizingFilm(Parametric):
    """Base class of polarising films, for `coating` of :class:`surface`.

    A film is a frozen dataclass whose fields are its parameters. It must define :meth:`matrices`, the Jones matrices at
    any angle of incidence and wavelength; a class of one's own is used, varied and written to files as those here are.
    Fields that are named in the class variable ``fixed`` are no numbers to vary.

    Notes
    -----
    A film is thin: it acts where the ray meets the surface. No light is lost by Fresnel reflection at it; place another
    surface at a thickness of 0 to add such losses, or a second film. Jones matrices are in the axes x and y of the
    surface, carried along from its axis to the normal where the ray meets it, and from the normal to the ray, without a
    rotation about either. They are those of light that passes in the direction of the surface's z axis. Backwards the
    transposed matrix acts, in the same axes, as reciprocity demands.

    Examples
    --------
    A film that passes less the more oblique the light is:

    >>> from dataclasses import dataclass
    >>> import numpy as np
    >>> from odak.learn.raytracing.system import PolarizingFilm
    >>> from odak.learn.raytracing.system.films import FilmMatrices
    >>> @dataclass(frozen=True)
    ... class Dimming(PolarizingFilm):
    ...     strength: float = 1.0
    ...
    ...     def matrices(self, x, y, wavelength, unit="mm"):
    ...         passed = 1 - self.strength * (x * x + y * y)
    ...         return FilmMatrices(passed[..., None, None] * np.eye(2), 0 * passed[..., None, None] * np.eye(2))
    >>> Dimming(0.5).matrices(np.array([1.0]), np.array([0.0]), 550e-6).transmission[0, 0, 0]
    np.float64(0.5)
    """

    ranks: ClassVar[Mapping[str, int]] = {"transmitted": 1, "reflected": 1, "transmission": 2, "reflection": 2}

    def matrices(self, x: Array, y: Array, wavelength: Array | float, unit: str = "mm") -> FilmMatrices:
        """Return the Jones matrices of rays.

        Parameters
        ----------
        x, y : array
            Components of the ray's unit vector along x and y of the surface times the index of the medium it is in:
            the same on both sides of the film.
        wavelength : float or array
            In vacuum.
        unit : str
            Of the wavelength.

        Returns
        -------
        FilmMatrices
            An identity as reflection is an ideal mirror.
        """
        raise NotImplementedError(f"{type(self).__name__} must define matrices(x, y, wavelength, unit)")

    @property
    def reflects(self) -> bool:
        """Whether it reflects light, as a mirror must."""
        return True

    def reversed(self) -> "PolarizingFilm":
        """Return the film for light from the other side."""
        return self


@dataclass(frozen=True)
class PolarizerFilm(PolarizingFilm):
    """A polariser that absorbs, reflects or does both: linear and reflective polarisers, half mirrors.

    Parameters
    ----------
    angle : float or array
        Angle of the transmission axis in degrees, from x towards y of the surface.
    transmitted : pair of float or array
        Amplitudes along the transmission axis and across it, as of :func:`odak.jones.diattenuator`. Their squares are
        transmittances.
    reflected : pair of float or array
        Reflected amplitudes along and across it.
    film_index : float or array
        Index of the film, within which the direction of the ray counts; 1 for wires in air.

    Raises
    ------
    ValueError
        If an axis transmits and reflects more than all of its light.

    Notes
    -----
    The absorbing (or reflecting) axis, across the transmission axis in the plane of the film, is projected onto the
    plane across the ray; light along the projection is absorbed. It is the geometric model of Y. Fainman and J. Shamir,
    Appl. Opt. 23, 3188 (1984), for the absorbing axis, as J. Korger et al., Opt. Express 21, 27032 (2013), measured it
    at tilted polarisers.

    Examples
    --------
    A reflective polariser, and a mirror that reflects half of the light:

    >>> from odak.learn.raytracing.system import PolarizerFilm
    >>> reflective = PolarizerFilm(90.0, reflected=(0.0, 1.0))
    >>> PolarizerFilm.half_mirror().reflects
    True
    """

    angle: float | Array = 0.0
    transmitted: Sequence[float] | Array = (1.0, 0.0)
    reflected: Sequence[float] | Array = (0.0, 0.0)
    film_index: float | Array = 1.5

    def __post_init__(self) -> None:
        pairs = [_validate.several(name, getattr(self, name), 2) for name in ("transmitted", "reflected")]
        sums = [a * a + b * b for a, b in zip(*pairs, strict=True)]
        if any(_is_known(value) and float(value) > 1 + 1e-9 for value in sums):
            raise ValueError(
                "squares of transmitted and reflected must add up to at most 1 along each axis, got "
                f"{self.transmitted!r:.60} and {self.reflected!r:.60}"
            )

    @classmethod
    def half_mirror(cls, reflectance: float = 0.5) -> "PolarizerFilm":
        """Return a mirror that reflects a part of the light and passes all other.

        Parameters
        ----------
        reflectance : float
            Reflected fraction of the power, 0 … 1.
        """
        share = _validate.constant("reflectance", reflectance, least=0)
        if share > 1:
            raise ValueError(f"reflectance must be at most 1, got {reflectance}")
        return cls(0.0, ((1 - share) ** 0.5,) * 2, (share**0.5,) * 2)

    @property
    def reflects(self) -> bool:
        """Whether it reflects light, as a mirror must."""
        held: Any = self.reflected
        return any(not _is_known(value) or float(value) != 0 for value in held)

    def matrices(self, x: Array, y: Array, wavelength: Array | float, unit: str = "mm") -> FilmMatrices:
        """Return the Jones matrices of rays by x, y, wavelength and unit, see :meth:`PolarizingFilm.matrices`."""
        across = _projected(self.angle + 90.0, x, y, self.film_index)
        return FilmMatrices(*(_on_axes(across, pair[1], pair[0]) for pair in (self.transmitted, self.reflected)))


@dataclass(frozen=True)
class RetarderFilm(PolarizingFilm):
    """A wave plate of a uniaxial crystal or a stretched film, its optic axis in its plane.

    Parameters
    ----------
    retardance : float or array
        Phase by which the slow axis lags behind the fast one at normal incidence, in degrees: 90 for a quarter-wave
        plate of order 0, 450 for one of order 1.
    angle : float or array
        Angle of the fast axis in degrees, from x towards y of the surface.
    wavelength : float, optional
        Wavelength of the retardance, in the system's unit; at others it follows from the indices. By default the same
        retardance holds at all wavelengths.
    crystal : pair of str, OpticalMaterial or float
        Ordinary and extraordinary index or their names in the catalogue. Equal indices stand for a difference that is
        small beside them.

    Notes
    -----
    At oblique incidence the retardance is that of a plate between parallel faces, 2πd(√(nₑ² − x²nₑ²/nₒ² − y²) −
    √(nₒ² − x² − y²))/λ, where x and y are :math:`n·sin θ` along the optic axis and across it (A. Yariv and P. Yeh,
    Optical Waves in Crystals (1984), chapter 9). The extraordinary wave is polarised along the optic axis, projected
    across the ordinary ray. The path common to both waves is left out. The optic axis is the slow one if the
    extraordinary index is the larger or an equal one.

    Examples
    --------
    A quartz plate of order 5:

    >>> from odak.learn.raytracing.system import RetarderFilm
    >>> plate = RetarderFilm(5 * 360 + 90, 45.0, 550e-6, ("quartz (ordinary)", "quartz (extraordinary)"))
    >>> round(1e3 * plate.thickness("mm"))
    315
    """

    retardance: float | Array = 90.0
    angle: float | Array = 0.0
    wavelength: float | None = None
    crystal: Sequence[str | OpticalMaterial | float] = (1.5, 1.5)
    fixed: ClassVar[tuple[str, ...]] = ("wavelength", "crystal")

    def __post_init__(self) -> None:
        if self.wavelength is not None:
            value = _validate.constant("wavelength", self.wavelength, positive=True)
            object.__setattr__(self, "wavelength", value)
        held = _validate.listed("crystal", self.crystal, "ordinary and extraordinary index")
        if len(held) != 2:
            raise ValueError(f"crystal must be an ordinary and an extraordinary index, got {self.crystal!r:.80}")
        found = tuple(
            find_material(value)
            if isinstance(value, str)
            else value
            if isinstance(value, OpticalMaterial)
            else _validate.constant(f"crystal[{i}]", value, positive=True)
            for i, value in enumerate(held)
        )
        object.__setattr__(self, "crystal", found)

    @property
    def reflects(self) -> bool:
        """Whether it reflects light, as a mirror must."""
        return False

    def thickness(self, unit: str = "mm") -> float | Array:
        """Return the thickness of the plate, in the unit of its wavelength."""
        if self.wavelength is None:
            raise ValueError("wavelength of the retardance must be given, got None")
        ordinary, extraordinary = (float(value) for value in self._indices(self.wavelength, unit))
        if ordinary == extraordinary:
            raise ValueError(f"crystal must have two different indices, got {ordinary} twice")
        return self.retardance / 360 * self.wavelength / abs(extraordinary - ordinary)

    def matrices(self, x: Array, y: Array, wavelength: Array | float, unit: str = "mm") -> FilmMatrices:
        """Return the Jones matrices of rays by x, y, wavelength and unit, see :meth:`PolarizingFilm.matrices`."""
        ordinary, extraordinary = self._indices(wavelength, unit)
        slow = self._is_positive(unit)
        optic = self.angle + (90.0 if slow else 0.0)
        axis = _projected(optic, x, y, ordinary)
        xp = namespace(x)
        c, s = _axis(xp, optic, x)
        along, across = c * x + s * y, c * y - s * x
        # The difference of both roots is written without cancellation, and has a limit for equal indices.
        part = 1 - (along / ordinary) ** 2
        roots = [extraordinary**2 * part - across**2, ordinary**2 - along**2 - across**2]
        total = sum(xp.where(root > GRAZING, root, GRAZING) ** 0.5 for root in roots)
        cycles = self.retardance / 720 * (ordinary + extraordinary) * part / total
        if self.wavelength is not None:
            cycles = cycles * (self.wavelength / wavelength)
            first, second = self._indices(self.wavelength, unit)
            if first != second:
                cycles = cycles * ((extraordinary - ordinary) / (second - first))
        delayed = phasor_of_cycles(cycles, xp.complex128)
        ahead = xp.conj(delayed)
        matrix = _on_axes(axis, *((delayed, ahead) if slow else (ahead, delayed)))
        return FilmMatrices(matrix, 0 * matrix)

    def _indices(self, wavelength: Array | float, unit: str) -> list[Any]:
        return [
            refractive_index(value, wavelength, _validate.one_of("unit", unit, MICROMETRES), medium="air")
            if isinstance(value, OpticalMaterial)
            else value
            for value in self.crystal
        ]

    def _is_positive(self, unit: str) -> bool:
        """Whether the optic axis is the slow one."""
        middle = 0.55 / MICROMETRES[_validate.one_of("unit", unit, MICROMETRES)]
        ordinary, extraordinary = self._indices(middle if self.wavelength is None else self.wavelength, unit)
        return bool(extraordinary >= ordinary)


@dataclass(frozen=True)
class JonesFilm(PolarizingFilm):
    """A film of given Jones matrices, perhaps a table of them over wavelength and angle of incidence.

    Parameters
    ----------
    transmission : array
        Complex ``[2, 2]`` of :mod:`odak.jones`, or ``[W, A, 2, 2]`` with the two sequences below, 1 in place of the
        length of one that is left out; or real and imaginary parts along one more axis, as in files.
    reflection : array, optional
        Of the same form, the identity for an ideal mirror; by default nothing is reflected. In axes that stay where
        they are, unlike those of :func:`odak.jones.mirror`. It must be symmetric to be reciprocal, and holds from both
        sides.
    wavelengths : sequence of float
        Of the table, rising, in the system's unit, ``[W]``.
    angles : sequence of float
        Angles in air in degrees, rising, ``[A]``.

    Raises
    ------
    ValueError
        If more light comes out than goes in, or a ray lies outside the table.

    Notes
    -----
    Between its entries the table is interpolated linearly.

    Examples
    --------
    A cholesteric film reflects right circular light, whose handedness stays, and passes left circular light:

    >>> from odak.jones import circular_polarizer
    >>> from odak.learn.raytracing.system import JonesFilm
    >>> film = JonesFilm(circular_polarizer("left"), [[0.5, 0.5j], [0.5j, -0.5]])
    >>> film.reflects
    True
    """

    transmission: Sequence[Sequence[complex]] | Array
    reflection: Sequence[Sequence[complex]] | Array | None = None
    wavelengths: Sequence[float] = ()
    angles: Sequence[float] = ()
    fixed: ClassVar[tuple[str, ...]] = ("wavelengths", "angles")

    def __post_init__(self) -> None:
        sizes = _checked_grids(self)
        wanted = (*((max(size, 1) for size in sizes) if any(sizes) else ()), 2, 2)
        for name in ("transmission", "reflection"):
            value = getattr(self, name)
            if value is None:
                value = namespace(self.transmission).zeros_like(self.transmission)
            value = value if is_array(value) else np.asarray(value)
            xp = namespace(value)
            if value.ndim == len(wanted) + 1:
                value = xp.astype(value, xp.complex128)[..., 0] + 1j * value[..., 1]
            if tuple(value.shape) != wanted:
                raise ValueError(f"{name} must be complex {list(wanted)}, got {list(value.shape)}")
            object.__setattr__(self, name, xp.astype(to_complex(value), xp.complex128, copy=False))
        held = [self.transmission, self.reflection]
        if all(map(_is_known, held)):
            products = [np.swapaxes(v, -1, -2).conj() @ v for v in map(np.asarray, held)]
            most = float(np.linalg.eigvalsh(sum(products)).max())
            if most > 1 + 1e-9:
                raise ValueError(f"transmission and reflection must not gain power, got {most:.6g} times as much")

    @property
    def reflects(self) -> bool:
        """Whether it reflects light, as a mirror must."""
        held: Any = self.reflection
        return not _is_known(held) or bool((held != 0).any())

    def reversed(self) -> "JonesFilm":
        """Return the film for light from the other side."""
        turned = namespace(self.transmission).swapaxes(self.transmission, -1, -2)
        return JonesFilm(turned, self.reflection, self.wavelengths, self.angles)

    def matrices(self, x: Array, y: Array, wavelength: Array | float, unit: str = "mm") -> FilmMatrices:
        """Return the Jones matrices of rays by x, y, wavelength and unit, see :meth:`PolarizingFilm.matrices`."""
        held: list[Any] = [self.transmission, self.reflection]
        if held[0].ndim == 2:
            return FilmMatrices(*held)
        return FilmMatrices(*_interpolated(self, held, x, y, wavelength))


@dataclass(frozen=True)
class TableFilm(PolarizingFilm):
    """A coating of measured or supplied transmittances and reflectances over wavelength and angle of incidence.

    Parameters
    ----------
    transmittance : array
        Shares of the power ``[W, A]`` of any polarisation, or ``[W, A, 2]`` of light along s and along p; 1 in place of
        the length of a sequence below that is left out.
    reflectance : array, optional
        Of the same form; by default nothing is reflected. It holds from both sides.
    wavelengths : sequence of float
        Of the table, rising, in the system's unit, ``[W]``.
    angles : sequence of float
        Angles in air in degrees, rising, ``[A]``.

    Raises
    ------
    ValueError
        If a share is negative, more light comes out than goes in, or a ray lies outside the table.

    Notes
    -----
    Powers are interpolated linearly. Phases are not in such a table: s and p pass in phase, so that the retardance of
    the coating is left out. A :class:`JonesFilm` has phases.

    Examples
    --------
    A beam splitter that passes a third of s and two thirds of p at 45°:

    >>> import numpy as np
    >>> from odak.learn.raytracing.system import TableFilm
    >>> film = TableFilm([[[1 / 3, 2 / 3]]], [[[2 / 3, 1 / 3]]])
    >>> sine = np.array([0.5**0.5])
    >>> np.round(np.abs(film.matrices(sine, 0 * sine, 550e-6).transmission[0]) ** 2, 3)
    array([[0.667, 0.   ],
           [0.   , 0.333]])
    """

    transmittance: Sequence[Sequence[float]] | Array
    reflectance: Sequence[Sequence[float]] | Array | None = None
    wavelengths: Sequence[float] = ()
    angles: Sequence[float] = ()
    fixed: ClassVar[tuple[str, ...]] = ("wavelengths", "angles")
    ranks: ClassVar[Mapping[str, int]] = {"transmittance": 3, "reflectance": 3}

    def __post_init__(self) -> None:
        rows, columns = (max(size, 1) for size in _checked_grids(self))
        for name in ("transmittance", "reflectance"):
            value: Any = getattr(self, name)
            if value is None:
                value = 0 * self.transmittance  # type: ignore[operator]  # an array by now
            value = value if is_array(value) else np.asarray(value, dtype=float)
            xp = namespace(value)
            if value.ndim == 2:
                value = xp.stack([value, value], axis=-1)
            if tuple(value.shape) != (rows, columns, 2):
                raise ValueError(f"{name} must be {[rows, columns]} or {[rows, columns, 2]}, got {list(value.shape)}")
            object.__setattr__(self, name, xp.astype(value, xp.float64, copy=False))
        held = [np.asarray(value) for value in (self.transmittance, self.reflectance) if _is_known(value)]
        if any(not (value >= 0).all() for value in held):
            raise ValueError("transmittance and reflectance must be at least 0")
        most = float(np.sum(np.stack(held), axis=0).max()) if held else 0.0
        if most > 1 + 1e-9:
            raise ValueError(f"transmittance and reflectance must not gain power, got {most:.6g} times as much")

    @property
    def reflects(self) -> bool:
        """Whether it reflects light, as a mirror must."""
        held: Any = self.reflectance
        return not _is_known(held) or bool((held != 0).any())

    def matrices(self, x: Array, y: Array, wavelength: Array | float, unit: str = "mm") -> FilmMatrices:
        """Return the Jones matrices of rays by x, y, wavelength and unit, see :meth:`PolarizingFilm.matrices`."""
        xp = namespace(x)
        squared = x * x + y * y
        tilted = squared > 0
        sine = xp.where(tilted, squared, 1.0) ** 0.5
        # The plane of incidence, in which p lies; any plane for rays along the normal.
        plane = xp.where(tilted, x / sine, 1.0), xp.where(tilted, y / sine, 0.0)
        found = []
        for powers in _interpolated(self, [self.transmittance, self.reflectance], x, y, wavelength):
            bright = powers > 0
            s, p = (part for part in xp.unstack(xp.where(bright, xp.where(bright, powers, 1.0) ** 0.5, 0.0), axis=-1))
            found.append(_on_axes(plane, p, s))
        return FilmMatrices(*found)


def _checked_grids(film: Any) -> tuple[int, int]:
    """Set the wavelengths and angles of a table as tuples after checking that they rise; return their numbers."""
    for name in ("wavelengths", "angles"):
        grid = tuple(float(v) for v in _validate.several(name, getattr(film, name)))
        if any(b <= a for a, b in pairwise(grid)):
            raise ValueError(f"{name} must rise, got {grid!r:.80}")
        object.__setattr__(film, name, grid)
    return len(film.wavelengths), len(film.angles)


def _interpolated(film: Any, tables: list[Any], x: Any, y: Any, wavelength: Amount) -> list[Any]:
    """Return the entries ``[..., …]`` of tables ``[W, A, …]`` for rays."""
    xp = namespace(x)
    squared = x * x + y * y
    flat = squared > 0
    sine = xp.where(flat, xp.where(flat, squared, 1.0) ** 0.5, 0.0)
    rest = xp.where(squared < 1 - GRAZING, 1 - squared, GRAZING) ** 0.5
    rows = _between(xp, "wavelengths", film.wavelengths, wavelength + 0 * x)
    columns = _between(xp, "angles", film.angles, xp.atan2(sine, rest) / DEGREE)
    found = []
    for table in tables:
        tail = (...,) + (None,) * (table.ndim - 2)
        parts = [(a * b)[tail] * table[i, j] for i, a in rows for j, b in columns]
        found.append(sum(parts[1:], parts[0]))
    return found


def _is_known(value: Any) -> bool:
    """Whether a number can be checked; what is being optimised may leave its range on the way."""
    return is_readable(value) and not getattr(value, "requires_grad", False)


def _between(xp: ModuleType, name: str, grid: Sequence[float], value: Any) -> list[tuple[Any, Any]]:
    """Return the numbers of the neighbours of values in a rising grid, and their weights."""
    if not grid:
        return [(0, 1 + 0 * value)]
    nodes = xp.asarray(grid, dtype=xp.float64, device=getattr(value, "device", None))
    slack = 1e-9 * (abs(grid[0]) + abs(grid[-1]))
    if is_readable(value) and bool(((value < grid[0] - slack) | (value > grid[-1] + slack)).any()):
        raise ValueError(
            f"{name} of a table of a film reach from {grid[0]:g} to {grid[-1]:g}, got rays from "
            f"{float(value.min()):g} to {float(value.max()):g}"
        )
    if len(grid) == 1:
        return [(0, 1 + 0 * value)]
    place = xp.searchsorted(nodes, value) - 1
    place = xp.where(place < 0, 0, xp.where(place > len(grid) - 2, len(grid) - 2, place))
    share = (value - nodes[place]) / (nodes[place + 1] - nodes[place])
    return [(place, 1 - share), (place + 1, share)]


def _axis(xp: ModuleType, angle: Amount, like: Any) -> tuple[Any, Any]:
    """Return cosine and sine of an angle in degrees."""
    angle = DEGREE * (angle + 0 * like)
    return xp.cos(angle), xp.sin(angle)


def _projected(angle: Amount, x: Any, y: Any, index: Any) -> tuple[Any, Any]:
    """Return the components of an axis of a film, projected across the ray within it, along the axes of the ray.

    Those axes are x and y, carried along to the direction d within the film. Along them the projection of a vector c in
    the plane of the film is c − d·(c·d)/(1 + cos θ), d's component along the normal left out.
    """
    xp = namespace(x)
    c, s = _axis(xp, angle, x)
    u, v = x / index, y / index
    squared = 1 - u * u - v * v
    cosine = xp.where(squared > GRAZING, squared, GRAZING) ** 0.5
    part = (c * u + s * v) / (1 + cosine)
    first, second = c - part * u, s - part * v
    size = (first * first + second * second) ** 0.5
    return first / size, second / size


def _on_axes(axis: tuple[Any, Any], along: Any, across: Any) -> Any:
    """Return Jones matrices of amplitudes along an axis of unit components and across it, ``[..., 2, 2]``."""
    c, s = axis
    xp = namespace(c)
    along, across = (value + 0 * c for value in (along, across))
    cross = (along - across) * (c * s)
    rows = ((along * c * c + across * s * s, cross), (cross, along * s * s + across * c * c))
    return stack_matrix(xp, rows, xp.complex128)
