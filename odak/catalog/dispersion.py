"""Dispersion formulas, and the record of a material that uses one; wavelengths in micrometres throughout."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from odak import _array, _validate

LINE_D, LINE_F, LINE_C, LINE_G = 0.5875618, 0.4861327, 0.6562725, 0.4358343
MEDIA = ("air", "vacuum")
HERZBERGER_POLE = 0.1673**2


@dataclass(frozen=True)
class Material:
    """A material with its dispersion formula.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    formula : str
        "sellmeier", "cauchy", "gas", "polynomial", "conrady", "handbook" or "herzberger"; see :data:`FORMULAS`.
    coefficients : mapping
        What the formula takes, for wavelengths in micrometres.
    range : tuple of float
        Shortest and longest wavelength of validity, in micrometres.
    relative_to : str
        "air" or "vacuum": in what the published index is counted.
    source : str
        Source of the coefficients.
    nd : float, optional
        Published index at the helium d line (587.6 nm).
    vd : float, optional
        Published Abbe number (n_d − 1)/(n_F − n_C).
    extinction : pair of tuple of float, optional
        Wavelengths in micrometres, and extinction coefficients κ at them.

    Examples
    --------
    >>> from odak.catalog import Material
    >>> glass = Material("own", "cauchy", {"A": [1.5, 0.004]}, (0.4, 0.8), "air", "measured")
    >>> glass.range
    (0.4, 0.8)
    """

    name: str
    formula: str
    coefficients: Mapping
    range: tuple[float, float]
    relative_to: str
    source: str
    nd: float | None = None
    vd: float | None = None
    extinction: tuple[tuple[float, ...], tuple[float, ...]] | None = None

    def index(self, wavelength: Any) -> Any:
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
    """Return A₀ + A₁/λ² + A₂/λ⁴ + …, for all coefficients A."""
    return sum((a / squared**k for k, a in enumerate(coefficients["A"])), 0 * squared)


def gas(squared, coefficients):
    """Return 1 + Σ B/(C − 1/λ²), the form of Edlén and Ciddor."""
    return 1 + sum(b / (c - 1 / squared) for b, c in zip(coefficients["B"], coefficients["C"], strict=True))


def polynomial(squared, coefficients):
    """Return sqrt(Σ A·λ^P): the formula of Schott's older catalogues and its extensions."""
    total = conrady(squared, coefficients)
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def conrady(squared, coefficients):
    """Return Σ A·λ^P, n itself, as in Conrady's n = A + B/λ + C/λ^3.5."""
    return sum(a * squared ** (p / 2) for a, p in zip(coefficients["A"], coefficients["P"], strict=True))


def handbook(squared, coefficients):
    """Return sqrt(Σ A·λ^P + Σ B/(λ² − C)), the form of the Handbook of Optics."""
    poles = sum(b / (squared - c) for b, c in zip(coefficients["B"], coefficients["C"], strict=True))
    total = conrady(squared, coefficients) + poles
    return _array.namespace(total).sqrt(total) if _array.is_array(total) else total**0.5


def herzberger(squared, coefficients):
    """Return Σ A·λ^P + B₀·L + B₁·L² and so on, L = 1/(λ² − 0.028): M. Herzberger, Opt. Acta 6, 197 (1959)."""
    pole = 1 / (squared - HERZBERGER_POLE)
    return conrady(squared, coefficients) + sum(b * pole ** (k + 1) for k, b in enumerate(coefficients["B"]))


def model_glass(nd: float, vd: float, dpgf: float = 0.0) -> Material:
    """Return a model glass of given index and dispersion, as patents and lens files state them.

    Parameters
    ----------
    nd : float
        Index at the d line, 587.6 nm.
    vd : float
        Abbe number (n_d − 1)/(n_F − n_C).
    dpgf : float
        Deviation of the relative partial dispersion (n_g − n_F)/(n_F − n_C) from the normal line
        0.6438 − 0.001682·vd of Schott's glasses.

    Returns
    -------
    Material
        n = A + B/λ² + C/λ⁴ through the three statements, for 0.35 to 1.1 micrometres.

    Raises
    ------
    ValueError
        If nd is not above 1 or vd not positive.

    Examples
    --------
    >>> from odak.catalog import model_glass, refractive_index
    >>> round(refractive_index(model_glass(1.5168, 64.17), 656.2725e-9), 4)
    1.5144
    """
    nd = _validate.constant("nd", nd, positive=True)
    vd, dpgf = _validate.constant("vd", vd, positive=True), _validate.constant("dpgf", dpgf)
    if nd <= 1:
        raise ValueError(f"nd must be above 1, got {nd}")
    coefficients = {"A": cauchy_through(nd, vd, dpgf)}
    name = f"model {nd:g} {vd:g}" + (f" {dpgf:g}" if dpgf else "")
    return Material(name, "cauchy", coefficients, (0.35, 1.1), "air", "index and Abbe number", nd, vd)


def cauchy_through(nd: Any, vd: Any, dpgf: Any = 0.0) -> tuple:
    """Return A, B, C of n = A + B/λ² + C/λ⁴ with the stated index and dispersion, numbers or arrays."""
    spread = (nd - 1) / vd
    partial = (0.6438 - 0.001682 * vd + dpgf) * spread
    # Two differences of the series give B and C, the d line gives A.
    d, f, c, g = (1 / line**2 for line in (LINE_D, LINE_F, LINE_C, LINE_G))
    matrix = (f - c, f * f - c * c), (g - f, g * g - f * f)
    determinant = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]
    first = (spread * matrix[1][1] - partial * matrix[0][1]) / determinant
    second = (partial * matrix[0][0] - spread * matrix[1][0]) / determinant
    return nd - first * d - second * d * d, first, second


FORMULAS = {
    "sellmeier": Formula(sellmeier, ("B", "C"), ("A",)),
    "cauchy": Formula(cauchy, ("A",)),
    "gas": Formula(gas, ("B", "C")),
    "polynomial": Formula(polynomial, ("A", "P")),
    "conrady": Formula(conrady, ("A", "P")),
}
# Read from glass catalogues, not from JSON.
FORMULAS["handbook"] = Formula(handbook, ("A", "P", "B", "C"))
FORMULAS["herzberger"] = Formula(herzberger, ("A", "P", "B"))
