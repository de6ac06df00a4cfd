"""Whose eyes see: age, pupil, adaptation and colour vision, and what the optics of an eye pass of a picture."""

import math
from dataclasses import dataclass

import torch

from odak import _array, _validate
from odak._warnings import AccuracyWarning, warn
from odak.learn.perception.color_vision_deficiency import DEFICIENCIES, simulate_color_vision_deficiency
from odak.learn.perception.csf import not_negative, positive_numbers, unified_pupil_diameter
from odak.learn.perception.sight import Viewing, checked_viewing

# Pupils in millimetres whose aberrations were measured, and the wavelength in nanometres that counts for white light.
_NARROWEST, _WIDEST, _WAVELENGTH = 2.0, 6.0, 555.0


def ocular_modulation_transfer(
    frequency: torch.Tensor | float, pupil_diameter: torch.Tensor | float = 3.0
) -> torch.Tensor:
    """Return how much of the modulation of a grating reaches the retina, for the mean of well corrected eyes.

    Parameters
    ----------
    frequency : torch.Tensor or float
        In cycles per degree, 0 or more.
    pupil_diameter : torch.Tensor or float
        In millimetres; the formula holds for 2 to 6.

    Returns
    -------
    torch.Tensor
        0 to 1 in the broadcast shape, float64 of plain numbers; 0 beyond the limit of diffraction. Differentiable.

    Raises
    ------
    ValueError, TypeError
        If a frequency is negative, or a pupil not positive.

    Notes
    -----
    Watson, J. Vis. 13(6), 18 (2013), doi 10.1167/13.6.18: of white light, by the aberrations of 200 eyes, which
    (1 + (u/u₁)²)^(−0.62) with u₁ = 21.95 − 5.512·d + 0.3922·d² describes, times the root of the transfer by diffraction
    at 555 nm.

    Examples
    --------
    >>> from odak.learn.perception import ocular_modulation_transfer
    >>> [round(ocular_modulation_transfer(u, 3.0).item(), 2) for u in (0.0, 10.0, 30.0)]
    [1.0, 0.56, 0.16]
    """
    frequency = not_negative("frequency", frequency)
    (pupil,) = positive_numbers(pupil_diameter=pupil_diameter)
    pupil = pupil.to(frequency)
    if _array.is_readable(pupil) and bool(((pupil.detach() < _NARROWEST) | (pupil.detach() > _WIDEST)).any()):
        warn(f"the transfer of eyes is known for pupils of {_NARROWEST:g} to {_WIDEST:g} mm", AccuracyWarning)
    share = frequency * 180 * _WAVELENGTH * 1e-6 / (math.pi * pupil)
    inside = share.clamp(max=1.0)
    diffraction = 2 / math.pi * (torch.acos(inside) - inside * (1 - inside**2).sqrt())
    bend = 21.95 - 5.512 * pupil + 0.3922 * pupil**2
    return (1 + (frequency / bend) ** 2) ** -0.62 * diffraction.clamp_min(0).sqrt()


@dataclass(frozen=True, repr=False)
class Viewer:
    """Whose eyes see: age, pupil, adaptation and colour vision. How they see stands in :class:`Viewing`.

    Parameters
    ----------
    age : float
        In years, 20 to 83.
    eyes : int
        Eyes that see the display, 1 or 2, which counts for the size of the pupil.
    pupil : float, optional
        Its diameter in millimetres; by default that of an eye of this age which is adapted to the display, by
        :func:`unified_pupil_diameter`.
    adaptation : float, optional
        Luminance in cd/m² that the eyes are adapted to; by default that of half of the light of white.
    deficiency : {"protan", "deutan", "tritan"}, optional
        Which cones are missing or deviate; none by default.
    severity : float
        Of the deficiency, 0 to 1.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.

    Examples
    --------
    >>> from odak.learn.perception import Viewer, Viewing
    >>> young, old = Viewer(age=25), Viewer(age=75, deficiency="deutan")
    >>> old
    Viewer: 75 years, 2 eyes, deutan
    >>> [round(viewer.pupil_diameter(Viewing()), 2) for viewer in (young, old)]
    [4.33, 3.36]
    """

    age: float = 28.58
    eyes: int = 2
    pupil: float | None = None
    adaptation: float | None = None
    deficiency: str | None = None
    severity: float = 1.0

    def __post_init__(self) -> None:
        for name in ("age", "pupil", "adaptation"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _validate.constant(name, getattr(self, name), positive=True))
        # It checks both.
        unified_pupil_diameter(1.0, age=self.age, eyes=self.eyes)
        if self.deficiency is not None:
            object.__setattr__(self, "deficiency", _validate.one_of("deficiency", self.deficiency, DEFICIENCIES))
        _validate.constant("severity", self.severity, least=0, most=1)

    def pupil_diameter(self, viewing: Viewing) -> float:
        """Return the diameter of the pupil in millimetres before a display.

        Parameters
        ----------
        viewing : Viewing
            The display; a square one if its resolution is not known.
        """
        if self.pupil is not None:
            return self.pupil
        light = checked_viewing(viewing).luminance(torch.tensor(0.5, dtype=torch.float64))
        light = light if self.adaptation is None else self.adaptation
        return float(unified_pupil_diameter(light, viewing.area, self.age, self.eyes))

    def transfer(self, frequency: torch.Tensor, viewing: Viewing) -> torch.Tensor:
        """Return what these eyes pass of gratings, in cycles per degree: :func:`ocular_modulation_transfer`.

        Parameters
        ----------
        frequency : torch.Tensor
            In cycles per degree.
        viewing : Viewing
            The display, whose light sets the pupil.
        """
        return ocular_modulation_transfer(frequency, self.pupil_diameter(viewing))

    def seen(self, picture: torch.Tensor) -> torch.Tensor:
        """Return how a picture appears with the colour vision of this viewer.

        Parameters
        ----------
        picture : torch.Tensor
            sRGB ``[..., 3, H, W]``, as :func:`simulate_color_vision_deficiency` takes it.
        """
        if self.deficiency is None:
            return picture
        return simulate_color_vision_deficiency(picture, self.deficiency, self.severity)

    def __repr__(self) -> str:
        words = [f"{self.age:g} years", f"{self.eyes} eye{'s' * (self.eyes > 1)}"]
        words += [] if self.pupil is None else [f"a pupil of {self.pupil:g} mm"]
        words += [] if self.adaptation is None else [f"adapted to {self.adaptation:g} cd/m²"]
        words += [] if self.deficiency is None else [self.deficiency]
        return f"Viewer: {', '.join(words)}"
