"""Extraordinary waves in uniaxial crystals behind a surface of a system."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from odak import _validate
from odak._array import Array, Numbers, namespace
from odak.catalog.materials import refractive_index
from odak.raytracing import components as vec
from odak.raytracing.gradients import Gradient


@dataclass(frozen=True)
class UniaxialMedium(Gradient):
    """The extraordinary wave in a uniaxial crystal behind a surface, whose material is that of the ordinary wave.

    Give it as ``gradient`` of a :class:`surface` with the ordinary index as its material; without it, the surface
    passes the ordinary wave on. Rays and wave normals differ in the crystal: refraction follows the wave normals, and
    the rays walk off.

    Parameters
    ----------
    axis : sequence or array
        Optic axis, of any length, in the frame of the system's axis at the surface.
    extraordinary : sequence or array
        Coefficients c₀, c₁, … of the principal extraordinary index as a polynomial of the ordinary one, Σ c_k·n_oᵏ: the
        index alone for one wavelength, see :meth:`of` for others.

    Notes
    -----
    A wave vector p in units of that in vacuum satisfies p·Mp = 1 with M = 1/n_e² + (1/n_o² − 1/n_e²)·a·aᵀ and the unit
    vector a along the optic axis; the ray runs along Mp, and the optical path of a ray s is p·s (M. Born and E. Wolf,
    Principles of Optics, 7th edition (1999), sections 15.2 and 15.3). Along the optic axis both waves are one: the
    extraordinary one is traced there as everywhere, with finite derivatives; :meth:`retardance` says how far the two
    are apart. Polarised rays, and mirrors within the crystal, raise ValueError. A trace that ends in the crystal
    returns wave normals.

    Examples
    --------
    Walk-off of calcite at 589.3 nm, whose optic axis is at 45° to the rays, over 10 mm:

    >>> from odak.learn.raytracing.system import UniaxialMedium, launch, optical_system, surface, trace
    >>> crystal = UniaxialMedium((0.0, 1.0, 1.0), [1.48641])
    >>> plate = optical_system([surface(thickness=10.0, material=1.65835, gradient=crystal), surface()], 1.0)
    >>> found = trace(plate, launch(plate, "y", 1), until=1)
    >>> round(abs(float(found.y)), 3)
    1.09
    """

    axis: Numbers = (0.0, 0.0, 1.0)
    extraordinary: Numbers = (1.5,)
    ranks: ClassVar[Mapping[str, int]] = {"axis": 1, "extraordinary": 1}

    @classmethod
    def of(cls, crystal: str, axis: Sequence[float], wavelengths: Sequence[float] = (0.4, 0.7)) -> "UniaxialMedium":
        """Return the medium of a crystal of the catalogue, which has an ordinary and an extraordinary index there.

        Parameters
        ----------
        crystal : str
            Name without "(ordinary)", as "calcite", whose ordinary index must be the surface's material.
        axis : sequence of float
            Optic axis.
        wavelengths : pair of float
            Range of wavelengths in micrometres, in which the extraordinary index is that of the catalogue within
            3·10⁻⁶ for calcite from 0.4 to 0.7 µm.

        Returns
        -------
        UniaxialMedium
            With a polynomial of fifth order through the indices at six wavelengths.
        """
        low, high = (_validate.constant("wavelengths", value, positive=True) for value in wavelengths)
        # Chebyshev's points of the squared frequency, in which both indices are nearly straight.
        places = (low**-2 + high**-2) / 2 + (low**-2 - high**-2) / 2 * np.cos(np.pi * (np.arange(6) + 0.5) / 6)
        ordinary, other = (
            np.asarray(refractive_index(f"{crystal} ({kind})", places**-0.5, "um"))
            for kind in ("ordinary", "extraordinary")
        )
        return cls(tuple(axis), tuple(np.linalg.solve(np.vander(ordinary, increasing=True), other).tolist()))

    def squared(self, x: Array, y: Array, z: Array, base: Array) -> tuple[Array, ...]:
        """Return the square of the ordinary index, and zeros: the crystal is the same everywhere.

        Parameters
        ----------
        x, y, z : array
            Points.
        base : array
            Ordinary index.
        """
        zero = 0 * (x + y + z)
        return base * base + zero, zero, zero, zero

    def _constants(self, base: Array) -> tuple[Any, Any, Any]:
        """Return the optic axis, 1/n_e², and what 1/n_o² exceeds it by."""
        axis = vec.terms(self.axis)
        length = vec.dot(axis, axis) ** 0.5
        other: Any = 0 * base
        for coefficient in reversed(vec.terms(self.extraordinary)):
            other = other * base + coefficient
        return tuple(part / length for part in axis), other**-2, base**-2 - other**-2

    def ray(self, wave: tuple[Array, ...], base: Array) -> tuple[tuple[Array, ...], Array, Array]:
        """Return the unit rays of unit wave normals, the optical path per length of the ray, and the index of the wave.

        Parameters
        ----------
        wave : tuple of array
            Components of the wave normals.
        base : array
            Ordinary index.
        """
        along = _times(self._constants(base), wave)
        index = vec.dot(wave, along) ** -0.5
        length = vec.dot(along, along) ** 0.5
        return tuple(part / length for part in along), 1 / (index * length), index

    def retardance(self, wave: tuple[Array, ...], base: Array) -> Array:
        """Return by how much the index of the extraordinary wave exceeds that of the ordinary one, along a wave normal.

        Both waves are one along the optic axis: a plate of thickness d does not part them where d times this is much
        less than a wavelength, and has no defined polarisation of the modes there.

        Parameters
        ----------
        wave : tuple of array
            Components of the wave normals.
        base : array
            Ordinary index.
        """
        return self.ray(wave, base)[2] - base

    def refracted(
        self, direction: tuple[Array, ...], normal: tuple[Array, ...], before: Array, base: Array
    ) -> tuple[tuple[Array, ...], Array, Array]:
        """Return the wave normals behind a surface, which waves are transmitted, and their indices.

        Parameters
        ----------
        direction, normal : tuple of array
            Unit wave normals in front, and unit normals of the surface.
        before, base : array
            Index in front, and the ordinary one behind.
        """
        xp, held = namespace(before, *direction), self._constants(base)
        cosine = vec.dot(direction, normal)
        tangential = vec.scaled(vec.along(direction, -cosine, normal), before)
        along = _times(held, normal)
        across, mixed = vec.dot(normal, along), vec.dot(tangential, along)
        inside = mixed * mixed - across * (vec.dot(tangential, _times(held, tangential)) - 1)
        through = inside > 0
        root = xp.copysign(xp.where(through, inside, 1.0) ** 0.5, cosine)
        wave = vec.along(tangential, (root - mixed) / across, normal)
        index = vec.dot(wave, wave) ** 0.5
        return tuple(part / index for part in wave), through, index

    def paraxial(self, base: Array, thickness: Array) -> tuple[Array | list[Array], ...]:
        """Return the ABCD matrix on (y, n·u) in the y–z plane, about the ray that walks off, and the two end indices.

        Parameters
        ----------
        base, thickness : array
            Ordinary index, and length along the axis.
        """
        held, one = self._constants(base), 1 + 0 * (base + thickness)
        (_, yy, yz), (_, _, zz) = (_times(held, unit) for unit in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
        index = zz**-0.5 * one
        return one, thickness * (yy * zz - yz * yz) * zz**-1.5, 0 * one, one, [index, index]

    def turned(self) -> "UniaxialMedium":
        """Return the medium with x and y exchanged, for first-order properties in the section along x."""
        x, y, z = vec.terms(self.axis)
        return replace(self, axis=(y, x, z))


def _times(held: tuple[Any, Any, Any], vector: Any) -> tuple[Array, ...]:
    axis, isotropic, excess = held
    share = excess * vec.dot(axis, vector)
    return tuple(isotropic * v + share * a for v, a in zip(vector, axis, strict=True))
