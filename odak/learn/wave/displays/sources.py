"""Light sources of displays that are more than one plane wave along the axis: directions, sizes and line widths."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import floating, tensor
from odak.learn.wave.fields import unit_phasor
from odak.wave.coherence import gaussian_spectrum


@_validate.takes_units("width")
@dataclass(frozen=True, eq=False)
class Source:
    """Points of light that illuminate the panel of a display, each by a plane wave from its direction.

    Use it as `profile` of a :class:`Display` for several lasers at angles, at once or one after another, and for an
    LED: the directions and weights of :func:`odak.learn.wave.disk_source`, and a line width. Unless the points are
    `coherent`, their intensities are added up, in images, gradients and the judge alike.

    Parameters
    ----------
    directions : torch.Tensor or sequence
        Sines of the angles along rows and along columns from which the S points illuminate the panel, ``[S, 2]``.
    weights : torch.Tensor or sequence, optional
        Share of the light of each point, ``[S]``, or ``[F, S]`` for each of the F frames of a display; equal shares by
        default. ``torch.eye(S)`` lights the points one after another, one in each frame. The points share out all
        light of a frame.
    width : float
        Full width at half maximum of the line of each colour in metres of wavelength.
    lines : int
        Number of wavelengths that stand for such a line, see :func:`odak.learn.wave.gaussian_spectrum`. Each has
        transfer functions of its own, and an image takes as many propagations as there are points times lines.
    coherent : bool
        Whether amplitudes are added up, with no difference of phase between the points in the middle of the panel.
    amplitude : torch.Tensor, optional
        Amplitude of the light of each point on the panel, as `profile` of a :class:`Display`; one by default.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Pixels of the panel a distance d apart are coherent to the degree Σ w·exp(2πi·s·d/λ), s the sine along d (van
    Cittert and Zernike; Born and Wolf, Principles of Optics (1999), 10.4.2). Over a pixel, light is taken to be as it
    is in the middle; a display warns where it turns by more than a tenth of a wave there.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Modulator, Source, disk_source
    >>> led = Source(*disk_source(1e-3, 2, 6), width=20e-9)
    >>> display = Display(Modulator((32, 48), 8e-6), 532e-9, 3e-3, profile=led)
    >>> display(torch.zeros(32, 48)).shape
    torch.Size([1, 1, 32, 48])
    """

    directions: torch.Tensor | Sequence[Sequence[float]] = ((0.0, 0.0),)
    weights: torch.Tensor | Sequence[float] | None = None
    width: float = 0.0
    lines: int = 3
    coherent: bool = False
    amplitude: torch.Tensor | None = None

    def __post_init__(self) -> None:
        (given,) = _validate.constants(directions=self.directions)
        directions = tensor("directions", given, torch.float64)
        _validate.shaped("directions", directions, "[S, 2], not empty")
        if not bool((directions.abs() < 1).all()):
            raise ValueError(f"directions must be sines within ±1, got up to {float(directions.abs().max()):.4g}")
        count = len(directions)
        shares: Any = torch.ones(count) if self.weights is None else self.weights
        weights = floating("weights", shares).detach().double()
        _validate.shaped("weights", weights, f"[{count}] or [frames, {count}]")
        if bool((weights < 0).any()) or not bool(((sums := weights.sum(-1)) > 0).all() and sums.isfinite().all()):
            raise ValueError(
                f"weights must be at least 0 and finite, with some light in each frame, got {weights.tolist()!r:.80}"
            )
        width = float(_validate.number("width", self.width, least=0))
        _validate.integer("lines", self.lines, minimum=1)
        if _validate.flag("coherent", self.coherent) and (weights.ndim > 1 or width):
            raise ValueError("coherent must be False with a width, or other weights in each frame")
        kept = {"directions": directions, "weights": weights / weights.sum(-1, keepdim=True), "width": width}
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        directions = torch.as_tensor(self.directions)
        kind = "coherent " * self.coherent + "point" + "s" * (len(directions) > 1)
        line = f", lines of {1e9 * self.width:.3g} nm" if self.width else ""
        return f"Source of {len(directions)} {kind} within {1e3 * float(directions.norm(dim=1).max()):.3g} mrad{line}"

    def spectrum(self, wavelength: float) -> tuple[list[float], list[float]]:
        """Return the wavelengths that stand for the line of a colour, of a middle `wavelength`, and their weights."""
        if not self.width:
            return [wavelength], [1.0]
        found, weights = gaussian_spectrum(wavelength, self.width, self.lines)
        return [float(one) for one in found], [float(one) for one in weights]

    def tilts(self, wavelength: float, sizes: Sequence[int], pitches: Sequence[float]) -> list[torch.Tensor]:
        """Return the phases of light of a `wavelength` along a panel, ``[S, rows]`` and ``[S, columns]``.

        `sizes` are the rows and columns of the panel, `pitches` their distances in metres.
        """
        along = zip(torch.as_tensor(self.directions).unbind(1), sizes, pitches, strict=True)
        cycles = [s[:, None] * (p / wavelength) * (torch.arange(n, dtype=torch.float64) - n // 2) for s, n, p in along]
        return [2 * math.pi * torch.remainder(one, 1) for one in cycles]

    def sum(self, wavelength: float, sizes: Sequence[int], pitches: Sequence[float]) -> torch.Tensor:
        """Return the light of coherent points on a panel, complex128 ``[rows, columns]``.

        `wavelength`, `sizes` and `pitches` are those of :meth:`tilts`.
        """
        down, across = (unit_phasor(turn) for turn in self.tilts(wavelength, sizes, pitches))
        return torch.einsum("s,sr,sc->rc", torch.as_tensor(self.weights).sqrt().to(down.dtype), down, across)
