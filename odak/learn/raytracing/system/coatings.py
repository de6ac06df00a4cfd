"""Thin-film coatings of surfaces, and their amplitude coefficients for rays."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from numbers import Number
from typing import Any, NamedTuple, SupportsComplex, cast

from odak import _validate
from odak._array import Array, complex_dtype, namespace
from odak.catalog.materials import MICROMETRES, Material, material, refractive_index
from odak.jones.thin_films import stack_response
from odak.raytracing.components import terms


class Amplitudes(NamedTuple):
    """Amplitude coefficients whose squared moduli are fractions of the power of a ray.

    Attributes
    ----------
    reflected_s, reflected_p, transmitted_s, transmitted_p : array
        Complex ``[...]``. Those of transmission are the coefficients of the electric field times
        √(n₂·cos θ₂/(n₁·cos θ₁)).
    """

    reflected_s: Any
    reflected_p: Any
    transmitted_s: Any
    transmitted_p: Any


@dataclass(frozen=True)
class Coating:
    """A stack of thin films on a surface; without any film, the bare interface.

    Parameters
    ----------
    media : sequence
        Films in the order in which light passes them: names of the catalogue, Materials, or indices valid for all
        wavelengths, complex for absorbing films (n + iκ, κ ≥ 0).
    thicknesses : sequence or array
        Thickness of each film, in the unit of the system.
    substrate : str, Material or number, optional
        What is behind the films of a mirror: a metal's complex index, or the medium on the other side where light is
        reflected totally or in part. Of refracting surfaces it is the medium behind, and this must be left out.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Coating
    >>> Coating.quarter_waves([1.38], 550e-6).thicknesses[0] > 99e-6
    True
    """

    media: Sequence = ()
    thicknesses: Any = ()
    substrate: Any = None

    def __post_init__(self):
        media = self.media
        if isinstance(media, (str, bytes)) or not isinstance(media, Sequence):
            raise TypeError(f"media must be a sequence of names, materials or indices, got {type(media).__name__}")
        substrate = None if self.substrate is None else _medium("substrate", self.substrate)
        object.__setattr__(self, "media", tuple(_medium(f"media[{i}]", value) for i, value in enumerate(media)))
        object.__setattr__(self, "substrate", substrate)
        count = len(terms(self.thicknesses))
        if count != len(self.media):
            raise ValueError(f"thicknesses must have one entry for each of {len(self.media)} media, got {count}")

    @classmethod
    def quarter_waves(cls, media: Sequence, wavelength: float, unit: str = "mm") -> "Coating":
        """Return a stack of films a quarter of a wave thick at normal incidence.

        Parameters
        ----------
        media : sequence
            Films in the order in which light passes them: names of the catalogue, Materials or indices.
        wavelength : float
            Design wavelength.
        unit : str
            Unit of it and of the thicknesses.

        Returns
        -------
        Coating
            λ/(4n) thick each, n the real part of the index.
        """
        wavelength = _validate.number("wavelength", wavelength, positive=True)
        found = cls(media, [0.0] * len(media))
        indices = [_index(value, wavelength, unit) for value in found.media]
        return replace(found, thicknesses=[float(wavelength / 4 / complex(index).real) for index in indices])

    def reversed(self) -> "Coating":
        """Return the stack for light from the other side."""
        if self.substrate is not None:
            raise ValueError("substrate is the end of the stack, from which no light is incident")
        return Coating(self.media[::-1], list(terms(self.thicknesses))[::-1])

    def amplitudes(
        self, n1: Any, n2: Any, cosine: Any, cosine_behind: Any, wavelength: Any, unit: str = "mm"
    ) -> Amplitudes:
        """Return the amplitude coefficients of rays.

        Parameters
        ----------
        n1, n2 : array
            Indices in front and behind, `n2` without effect where there is a substrate.
        cosine, cosine_behind : array
            Cosines of the angles of incidence and refraction, positive.
        wavelength : array
            In vacuum.
        unit : str
            Of the wavelength.

        Returns
        -------
        Amplitudes
            complex128, of the shape of `cosine`.

        Notes
        -----
        :func:`odak.jones.thin_film_stack`, whose signs are those of Born and Wolf: r_p = −r_s at normal incidence.
        """
        xp = namespace(cosine)
        n1, n2, cosine, wavelength = (
            xp.astype(value + 0 * cosine, xp.float64) for value in (n1, n2, cosine, wavelength)
        )
        behind = n2 if self.substrate is None else _index(self.substrate, wavelength, unit)
        films = [_index(value, wavelength, unit) for value in self.media]
        indices = [n1, *(value + 0 * cosine for value in (*films, behind))]
        transverse = n1 * xp.where(cosine < 1, 1 - cosine * cosine, 0.0) ** 0.5
        thicknesses = [value + 0 * cosine for value in terms(self.thicknesses)]
        found = [stack_response(xp, wavelength, indices, thicknesses, transverse, cosine, p) for p in ("s", "p")]
        dtype = complex_dtype(cosine)
        scale = xp.astype((n2 * cosine_behind / (n1 * cosine)) ** 0.5, dtype)
        return Amplitudes(found[0].r, found[1].r, found[0].t * scale, found[1].t * scale)


def _medium(name: str, value):
    """Return a catalogue's material, or an index as a number."""
    if isinstance(value, Material):
        return value
    if isinstance(value, str):
        return 1.0 if value.casefold() == "air" else material(value)
    if isinstance(value, (list, tuple)) and len(value) == 2:
        value = complex(*value)
    if isinstance(value, bool) or not isinstance(value, Number):
        raise TypeError(f"{name} must be a name, a Material or an index, got {type(value).__name__}")
    number = complex(cast(SupportsComplex, value))  # Number itself promises no conversion
    if not (0 < abs(number) < float("inf")) or number.imag < 0 or number.real < 0:
        raise ValueError(f"{name} must be an index n + iκ with n, κ ≥ 0, not 0, got {value}")
    return number if number.imag else number.real


def _index(medium, wavelength: Array | float, unit: str):
    """Return the index of a medium at wavelengths, relative to air."""
    if not isinstance(medium, Material):
        return medium
    _validate.one_of("unit", unit, MICROMETRES)
    return refractive_index(medium, wavelength, unit, medium="air")
