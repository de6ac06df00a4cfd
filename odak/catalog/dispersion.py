"""Dispersion formulas, and the record of a material that uses one; wavelengths in micrometres throughout."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from odak import _array

LINE_D, LINE_F, LINE_C = 0.5875618, 0.4861327, 0.6562725
MEDIA = ("air", "vacuum")


@dataclass(frozen=True)
class Material:
    """A material whose refractive index is known.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    formula : str
        "sellmeier", "cauchy" or "gas"; see :data:`FORMULAS`.
    coefficients : mapping
        What the formula takes, for wavelengths in micrometres.
    range : tuple of float
        Shortest and longest wavelength of validity, in micrometres.
    relative_to : str
        "air" or "vacuum": in what the published index is counted.
    source : str
        Where the coefficients come from.
    nd, vd : float, optional
        Published index at the helium d line (587.6 nm) and Abbe number (n_d − 1)/(n_F − n_C).
    """

    name: str
    formula: str
    coefficients: Mapping
    range: tuple[float, float]
    relative_to: str
    source: str
    nd: float | None = None
    vd: float | None = None

    def index(self, wavelength):
        """Return the index as published at `wavelength` micrometres (an array in double precision or a number)."""
        return FORMULAS[self.formula].compute(wavelength**2, self.coefficients)

    def abbe_number(self) -> float:
        """Return (n_d − 1)/(n_F − n_C) from the formula; infinite without dispersion."""
        spread = self.index(LINE_F) - self.index(LINE_C)
        return (self.index(LINE_D) - 1) / spread if spread else math.inf


@dataclass(frozen=True)
class Formula:
    """A dispersion formula: its function of the squared wavelength, and the lists of coefficients it takes."""

    compute: Callable
    lists: tuple[str, ...]
    numbers: tuple[str, ...] = ()


def sellmeier(squared, coefficients):
    """Return sqrt(A + Σ B·λ²/(λ² − C)), A = 1 unless given (W. Sellmeier, Ann. Phys. 219, 272 (1871))."""
    terms = zip(coefficients["B"], coefficients["C"], strict=True)
    total = coefficients.get("A", 1.0) + sum(b * squared / (squared - c) for b, c in terms)
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def cauchy(squared, coefficients):
    """Return A₀ + A₁/λ² + A₂/λ⁴ and so on, as far as A goes."""
    return sum((a / squared**k for k, a in enumerate(coefficients["A"])), 0 * squared)


def gas(squared, coefficients):
    """Return 1 + Σ B/(C − 1/λ²), the form of Edlén and Ciddor."""
    return 1 + sum(b / (c - 1 / squared) for b, c in zip(coefficients["B"], coefficients["C"], strict=True))


FORMULAS = {
    "sellmeier": Formula(sellmeier, ("B", "C"), ("A",)),
    "cauchy": Formula(cauchy, ("A",)),
    "gas": Formula(gas, ("B", "C")),
}
