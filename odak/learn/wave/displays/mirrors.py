"""Arrays of tilting mirrors: the diffraction order that their blaze lights. Touches no path of light."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from odak import _validate
from odak.wave.linear_kernels import checked_pixel_fill


@_validate.takes_units("pitch", "wavelength")
@dataclass(frozen=True)
class TiltingMirrors:
    """An array of square mirrors that tilt about their diagonals, as digital micromirror devices are, in laser light.

    The mirrors are a grating, whose orders lie where pitch and wavelength put them. What each mirror reflects is
    strongest where a single mirror sends the light, its blaze. Use this class to find the order to look at, its share
    of the light and its contrast, and give its `mask` to the path of a :class:`Display`, where the blaze lies beside
    that order. Light comes in the plane in which the mirrors tilt, from the side to which those that are on turn.

    Parameters
    ----------
    pitch : float
        Distance of neighbouring mirrors in metres, along their sides. An array whose mirrors stand on a corner is this
        one, turned by 45°; its pitch along the sides is that along a row divided by √2.
    wavelength : float
        Wavelength in metres.
    tilt : float
        Angle by which mirrors that are on tilt, in degrees; those that are off tilt by as much to the other side.
    incidence : float, optional
        Angle of the incident light from the normal of the array in degrees; twice the tilt by default, so that mirrors
        that are on send it along the normal.
    fill : float
        Share of the area of the array that is mirrors.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Scalar Fraunhofer diffraction of perfect mirrors: over a tilted square, light that comes along a and leaves along b
    has the mean phase factor sinc(w·q·u)·sinc(w·q·v), with q = (b - a)/λ, the side w of a mirror and the directions u
    and v of its sides. It is one for b at the mirror's own reflection. That mirrors hide parts of each other, and the
    gaps between them, are not in it. See P. T. Brown, R. Kruithoff, G. J. Seedorf and D. P. Shepherd, Biomed. Opt.
    Express 12, 3700 (2021), doi:10.1364/BOE.423461.

    Examples
    --------
    >>> from odak.learn.wave import TiltingMirrors
    >>> mirrors = TiltingMirrors(7.56e-6, 532e-9)
    >>> mirrors.order, round(mirrors.blaze, 2), round(mirrors.efficiency(), 2)
    ((-4, -4), -4.09, 0.78)
    """

    pitch: float
    wavelength: float
    tilt: float = 12.0
    incidence: float | None = None
    fill: float = 0.9

    def __post_init__(self) -> None:
        object.__setattr__(self, "pitch", _validate.constant("pitch", self.pitch, positive=True))
        object.__setattr__(self, "wavelength", _validate.constant("wavelength", self.wavelength, positive=True))
        object.__setattr__(self, "tilt", _validate.constant("tilt", self.tilt, least=0, below=45, unit="°"))
        given = 2 * self.tilt if self.incidence is None else self.incidence
        object.__setattr__(self, "incidence", _validate.constant("incidence", given, least=-89, most=89, unit="°"))
        checked_pixel_fill(self.fill, "fill")

    @property
    def blaze(self) -> float:
        """Where mirrors that are on send the light, along rows and columns alike, in orders."""
        incidence, tilt = math.radians(self.incidence or 0.0), math.radians(self.tilt)
        return (math.sin(incidence - 2 * tilt) - math.sin(incidence)) * self.pitch / (math.sqrt(2) * self.wavelength)

    @property
    def order(self) -> tuple[int, int]:
        """Return the order next to the blaze, along rows and columns."""
        return round(self.blaze), round(self.blaze)

    def direction(self, order: Sequence[int] | None = None) -> tuple[float, float, float]:
        """Return the direction in which the light of an order leaves: cosines along rows, columns and the normal.

        Parameters
        ----------
        order : sequence of int, optional
            The order along rows and columns; the one next to the blaze by default.

        Raises
        ------
        ValueError
            If the order does not leave the array.
        """
        down, across, axial = (float(part) for part in self._leaving(order, np.zeros(2)))
        if axial == 0:
            raise ValueError(f"order must be one that leaves the array, got {order}, beyond 90°")
        return down, across, axial

    def efficiency(self, order: Sequence[int] | None = None, on: bool = True) -> float:
        """Return the share of the incident light in an order, where all mirrors are on, or all off.

        Parameters
        ----------
        order : sequence of int, optional
            The order along rows and columns; the one next to the blaze by default.
        on : bool
            Whether the mirrors are on. The share of those on, divided by that of those off, is the `contrast` for
            :meth:`Modulator.amplitude_only`.

        Raises
        ------
        ValueError
            If the order does not leave the array.

        Examples
        --------
        >>> from odak.learn.wave import TiltingMirrors
        >>> mirrors = TiltingMirrors(7.56e-6, 532e-9)
        >>> round(mirrors.efficiency((-3, -4)), 4), mirrors.efficiency() / mirrors.efficiency(on=False) > 1000
        (0.0001, True)
        """
        return float((self.fill * self._mean_over_mirror(np.array(self.direction(order)), on)) ** 2)

    def mask(self, resolution: Sequence[int], order: Sequence[int] | None = None) -> torch.Tensor:
        """Return what the blaze makes of the light in an order, compared with flat pixels, as a mask for :class:`Free`.

        Where the ends of the order differ much, the mask is coarse for panels of few pixels: with a blaze half an order
        away the field of 32 × 32 pixels is 2 % off, that of 96 × 96 0.8 %.

        Parameters
        ----------
        resolution : sequence of int
            Rows and columns of the panel.
        order : sequence of int, optional
            The order along rows and columns; the one next to the blaze by default.

        Returns
        -------
        torch.Tensor
            Amplitudes ``[2·rows, 2·columns]`` over the frequencies of an order, the middle of it in the middle.

        Raises
        ------
        ValueError
            If part of the order does not leave the array.

        Examples
        --------
        >>> from odak.learn.wave import Display, Free, Modulator, TiltingMirrors
        >>> mirrors = TiltingMirrors(7.56e-6, 532e-9)
        >>> panel = Modulator.amplitude_only((32, 48), mirrors.pitch, fill=mirrors.fill)
        >>> display = Display(panel, mirrors.wavelength, Free(3e-3, mask=mirrors.mask((32, 48))))
        """
        sides = _validate.size("resolution", resolution)
        aside = np.stack(np.meshgrid(*((np.arange(2 * n + 1) - n) / (2 * n) for n in sides), indexing="ij"), -1)
        leaving = self._leaving(order, aside)
        flattest = float(np.min(leaving[..., 2]))
        if flattest == 0:
            raise ValueError(f"order must be one that leaves the array with all its light, got {order}, beyond 90°")
        mask = self._mean_over_mirror(leaving, True) / np.sinc(math.sqrt(self.fill) * aside).prod(-1)
        # The first frequency along each axis stands for the last one too, which has another amplitude.
        mask[0] = (mask[0] + mask[-1]) / 2
        mask[:, 0] = (mask[:, 0] + mask[:, -1]) / 2
        return torch.from_numpy(mask[:-1, :-1]).float()

    def _leaving(self, order: Sequence[int] | None, aside: np.ndarray) -> np.ndarray:
        """Return directions of light some cycles per mirror beside an order; the normal's part is 0 from 90° on."""
        given = self.order if order is None else _validate.several("order", order, 2)
        whole = [_validate.integer("order", one, minimum=-math.inf) for one in given]
        flat = math.sin(math.radians(self.incidence or 0.0)) / math.sqrt(2)
        sideways = flat + self.wavelength / self.pitch * (np.array(whole) + aside)
        axial = np.sqrt(np.maximum(1 - (sideways**2).sum(-1, keepdims=True), 0.0))
        return np.concatenate((sideways, axial), -1)

    def _mean_over_mirror(self, leaving: np.ndarray, on: bool) -> np.ndarray:
        """Return the mean phase factor of light that leaves a mirror, which is on or off, in some directions."""
        incidence, tilt = math.radians(self.incidence or 0.0), math.radians(self.tilt if on else -self.tilt)
        flat = math.sin(incidence) / math.sqrt(2)
        changed = (leaving - [flat, flat, -math.cos(incidence)]) / self.wavelength
        # The sides of a mirror, which turn about the diagonal (1, -1, 0).
        along, across, up = (math.cos(tilt) + 1) / 2, (math.cos(tilt) - 1) / 2, math.sin(tilt) / math.sqrt(2)
        sides = np.array([[along, across, up], [across, along, up]])
        return np.sinc(math.sqrt(self.fill) * self.pitch * changed @ sides.T).prod(-1)
