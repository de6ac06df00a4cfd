"""Panels of pixels and round stops: what a display is made of. Touches no path of light."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from odak import _array, _show, _validate
from odak.learn._tensors import floating, kind_of
from odak.learn.wave.fields import unit_phasor
from odak.learn.wave.slm import TURN, AmplitudeResponse, checked_bits, even_levels
from odak.learn.wave.training import generator_from
from odak.wave.linear_kernels import checked_pixel_fill
from odak.wave.transfer_functions import checked_pitch, pitches

# Diffraction orders along each axis that are computed without a stop: the zeroth and its neighbours.
_ORDERS = 3


@_validate.takes_units("radius", "focal_length")
@dataclass(frozen=True)
class Iris:
    """A round stop in the focal plane of a lens, which limits the frequencies that reach an image.

    Use it for a 4f relay whose iris you know. Frequencies up to ``radius / (wavelength · focal_length)`` pass.

    Parameters
    ----------
    radius : float
        Radius in metres.
    focal_length : float
        Focal length of the lens in front of it in metres.

    Examples
    --------
    >>> from odak.learn.wave import Iris
    >>> round(Iris(2e-3, 0.2).cutoff(532e-9))
    18797
    """

    radius: float
    focal_length: float

    def __post_init__(self) -> None:
        _validate.real("radius", self.radius, positive=True)
        _validate.real("focal_length", self.focal_length, positive=True)

    def cutoff(self, wavelength: float) -> float:
        """Return the highest frequency that passes at a wavelength, in cycles per metre."""
        return self.radius / (wavelength * self.focal_length)


@_validate.takes_units("distance")
@dataclass(frozen=True)
class AmplitudePanel:
    """A panel that attenuates the light on its way to a phase modulator, with pixels of the same number and pitch.

    Use it as `lit_through` of a :class:`Modulator` for two panels in series, with which a display forms amplitude and
    phase. A relay images it onto the modulator or beside it, or the light travels freely between the two, through air.

    Parameters
    ----------
    distance : float
        Distance from the panel, or from its image by the relay, to the modulator in metres.
    bits : int, optional
        Bits of a pixel, 2^bits levels spread evenly over the amplitudes 0 … 1; None for amplitudes without levels.
    fill : float
        Share of the area of a pixel that transmits.
    iris : Iris or str, optional
        Stop of the relay: "order", a square one that passes one diffraction order, |f| ≤ 1/(2·pitch), or a round
        :class:`Iris`. None without a relay, where nine orders are computed.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import AmplitudePanel, Display, Modulator
    >>> panel = Modulator((32, 48), 8e-6, lit_through=AmplitudePanel())
    >>> display = Display(panel, 532e-9, 3e-3)
    >>> phases, amplitudes = torch.zeros(32, 48), torch.full((32, 48), 0.5)
    >>> round(float((display(phases, amplitudes=amplitudes) / display(phases)).mean()), 3)
    0.25
    """

    distance: float = 0.0
    bits: int | None = 8
    fill: float = 0.9
    iris: Iris | str | None = "order"

    def __post_init__(self) -> None:
        _validate.constant("distance", self.distance)
        checked_bits(self.bits)
        checked_pixel_fill(self.fill, "fill")
        checked_iris(self.iris)

    def shown(self, amplitudes: torch.Tensor) -> torch.Tensor:
        """Return the nearest amplitudes that the levels of the panel can show."""
        if self.bits is None:
            return amplitudes
        return self.levels(amplitudes).to(amplitudes) / (2**self.bits - 1)

    def levels(self, amplitudes: torch.Tensor) -> torch.Tensor:
        """Return the levels whose amplitudes are nearest, int32 of the shape of the amplitudes; 256 without bits."""
        return torch.round(amplitudes * (255 if self.bits is None else 2**self.bits - 1)).to(torch.int32)


@dataclass(frozen=True, eq=False)
class Expander:
    """A mask in contact with a panel, of cells finer than its pixels: they send light to angles that pixels do not.

    Use it as `expander` of a :class:`Modulator` that eyes look at, for a wider eyebox of the same panel. With k × k
    cells in each pixel the étendue is k² times that of the panel, and each pixel determines the light at k² as many
    places: quality is the price, and a mask that is learned with the patterns of many pictures costs less of it.

    Parameters
    ----------
    phases : torch.Tensor
        Phases of the cells in radians, ``[k·rows, k·columns]``, at all wavelengths. A tensor that requires gradients
        gets them from images.
    amplitudes : torch.Tensor, optional
        Amplitudes that the cells pass, 0 … 1, of the same shape; one by default. They get gradients too.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Kuo et al., High resolution étendue expansion for holographic displays, ACM Trans. Graph. 39, 66 (2020), with a
    random mask; Tseng et al., Neural étendue expander for ultra-wide-angle high-fidelity holographic display, Nat.
    Commun. 15, 2907 (2024), with one that is learned.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import Display, Expander, Eyes, Modulator
    >>> phases = Expander.random((32, 48), 2).phases.requires_grad_()
    >>> panel = Modulator((32, 48), 8e-6, expander=Expander(phases))
    >>> display = Display(panel, 532e-9, Eyes(0.1, [(0.0, 0.0), (0.0, 5e-3)]), iris=None)
    >>> display(torch.zeros(32, 48)).square().mean().backward()
    >>> phases.grad.shape
    torch.Size([64, 96])
    """

    phases: torch.Tensor
    amplitudes: torch.Tensor | None = None

    def __post_init__(self) -> None:
        phases = _validate.image("phases", floating("phases", self.phases))
        if phases.ndim != 2 or phases.is_complex():
            raise ValueError(f"phases must be real [rows, columns], got {list(phases.shape)} of {phases.dtype}")
        object.__setattr__(self, "phases", phases)
        if self.amplitudes is not None:
            amplitudes = floating("amplitudes", self.amplitudes)
            if amplitudes.shape != phases.shape:
                raise ValueError(
                    f"amplitudes must be of the shape of the phases, {list(phases.shape)}, got {list(amplitudes.shape)}"
                )
            if bool(((amplitudes < 0) | (amplitudes > 1)).any()):
                least, most = float(amplitudes.min()), float(amplitudes.max())
                raise ValueError(f"amplitudes must be 0 … 1, got {least:.4g} to {most:.4g}")
            object.__setattr__(self, "amplitudes", amplitudes)

    @classmethod
    def random(cls, resolution: Sequence[int], cells: int, levels: int = 2, seed: int = 0) -> "Expander":
        """Return a mask of random phases that are spread evenly over 2π.

        Parameters
        ----------
        resolution : sequence of int
            Rows and columns of the panel.
        cells : int
            Cells k along each axis of a pixel.
        levels : int
            Number of different phases: 2 for a binary mask, of 0 and π.
        seed : int
            Seed of the random numbers.

        Returns
        -------
        Expander
            The mask.

        Examples
        --------
        >>> from odak.learn.wave import Expander
        >>> Expander.random((32, 48), 4).phases.unique()
        tensor([0.0000, 3.1416])
        """
        cells = _validate.integer("cells", cells, minimum=1)
        levels = _validate.integer("levels", levels, minimum=2)
        generator = generator_from(seed)
        shape = [cells * n for n in _validate.size("resolution", resolution)]
        return cls(torch.randint(levels, shape, generator=generator) * (TURN / levels))

    def __repr__(self) -> str:
        rows, columns = self.phases.shape
        return f"Expander of {rows} × {columns} cells"

    def cells_of(self, resolution: Sequence[int]) -> int:
        """Return how many cells are along each axis of a pixel at a `resolution` of the panel; 0 if they do not fit."""
        rows, columns = (divmod(m, n) for m, n in zip(self.phases.shape, resolution, strict=True))
        return rows[0] if rows == columns and rows[1] == 0 else 0

    def behind(self, light: torch.Tensor, cells: int) -> torch.Tensor:
        """Return the `light` of pixels ``[..., rows, columns]`` behind each of its `cells` × `cells`."""
        return light.repeat_interleave(cells, -2).repeat_interleave(cells, -1) * self._passed(light)

    def before(self, light: torch.Tensor, cells: int) -> torch.Tensor:
        """Return the adjoint of :meth:`behind`: the sum of `light` over the `cells` × `cells` of each pixel."""
        back = light * self._passed(light).conj()
        return back.unflatten(-1, (-1, cells)).unflatten(-3, (-1, cells)).sum((-3, -1))

    def _passed(self, light):
        passed = unit_phasor(self.phases.to(light.device, light.real.dtype))
        return passed if self.amplitudes is None else passed * self.amplitudes.to(light.device, light.real.dtype)


@_validate.takes_units("pitch")
@dataclass(frozen=True)
class Modulator:
    """A spatial light modulator, of phase unless its response says otherwise: its pixels, levels and response.

    Use it to tell a :class:`Display` which panel you have. Of real panels only the inner part of each pixel, a square
    of the share `fill`, modulates light, and this is the default; ``fill=1`` is a panel without gaps.

    Parameters
    ----------
    resolution : sequence of int
        Rows and columns.
    pitch : float or sequence of float
        Distance of neighbouring pixels in metres, one number or a pair (rows, columns).
    bits : int, optional
        Bits of a pixel, 2^bits levels spread evenly over 2π; None for a phase without levels.
    fill : float
        Share of the area of a pixel that emits.
    response : callable or sequence of callable, optional
        ``response(phase)`` returns the field of a phase pattern, such as
        :class:`odak.learn.wave.spatial_light_modulator`; an ideal one by default. Its own fill factor must be 1. The
        levels are its own where it has a table of their phases, `lut`. A sequence of modules holds one for each frame,
        such as a table for each colour of a panel that shows colours in sequence.
    lit_through : AmplitudePanel, optional
        Panel that the light passes first, for two panels in series.
    phase_scale : sequence of float, optional
        Factor of the phases for each of the C wavelengths of a display, such as λ0/λ for a panel that shows the same
        path differences to all, whose phases 0 … 2π are those at λ0. A response is called as ``response(phase,
        scale)`` then. None for the same phases at all wavelengths.
    expander : Expander, optional
        Mask in contact with the panel, of cells finer than its pixels, for displays that eyes look at.

    Examples
    --------
    >>> from odak.learn.wave import Modulator
    >>> Modulator((1080, 1920), 8e-6).fill
    0.9
    """

    resolution: Sequence[int]
    pitch: float | Sequence[float]
    bits: int | None = 8
    fill: float = 0.9
    response: Callable[..., Any] | Sequence[torch.nn.Module] | None = None
    lit_through: AmplitudePanel | None = None
    phase_scale: Sequence[float] | None = None
    expander: Expander | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "resolution", _validate.size("resolution", self.resolution))
        checked_pitch("pitch", self.pitch)
        checked_bits(self.bits)
        _validate.instance("lit_through", self.lit_through, (AmplitudePanel, type(None)), "an AmplitudePanel or None")
        checked_pixel_fill(self.fill, "fill")
        if self.phase_scale is not None:
            scale = tuple(float(one) for one in _validate.several("phase_scale", self.phase_scale, positive=True))
            object.__setattr__(self, "phase_scale", scale)
        if self.expander is not None:
            _validate.instance("expander", self.expander, Expander, "an odak.learn.wave.Expander")
            if not self.expander.cells_of(self.resolution):
                rows, columns = self.resolution
                raise ValueError(
                    f"expander must have k·{rows} × k·{columns} cells, got {list(self.expander.phases.shape)}"
                )
        if isinstance(self.response, (list, tuple)) and all(isinstance(one, torch.nn.Module) for one in self.response):
            object.__setattr__(self, "response", torch.nn.ModuleList(self.response))
        for one in self.responses() or (_validate.function_or_none("response", self.response),):
            if float(getattr(one, "fill_factor", 1.0)) != 1 or getattr(one, "samples_per_pixel", 1) > 1:
                raise ValueError(
                    "response must have a fill factor of 1 and one sample per pixel; give fill here instead"
                )

    @classmethod
    def amplitude_only(
        cls,
        resolution: Sequence[int],
        pitch: float | Sequence[float],
        bits: int | None = 1,
        fill: float = 0.9,
        contrast: float | None = None,
    ) -> "Modulator":
        """Return a panel that attenuates light and does not shift its phase, such as an array of tilting mirrors.

        Its image is that of a phase hologram with the light of its conjugate and of a uniform background, which
        `optimise` makes the best of. A flat pattern, whose pixels all pass the light, is no start for solvers that
        descend along a gradient: there it is zero.

        Parameters
        ----------
        resolution : sequence of int
            Rows and columns.
        pitch : float or sequence of float
            Distance of neighbouring pixels in metres, one number or a pair (rows, columns).
        bits : int, optional
            Bits of a pixel, whose 2^bits levels are spread evenly over the amplitudes 0 … 1; None for no levels.
        fill : float
            Share of the area of a pixel that passes light.
        contrast : float, optional
            Intensity of a bright pixel over that of a dark one; None for dark pixels without light.

        Returns
        -------
        Modulator
            The panel, whose `response` is an :class:`AmplitudeResponse`.

        Examples
        --------
        >>> import torch
        >>> from odak.learn.wave import Modulator
        >>> mirrors = Modulator.amplitude_only((2, 2), 8e-6)
        >>> mirrors.light(mirrors.phases_of(torch.tensor([[0, 1], [1, 0]]))).real.round(decimals=6).abs()
        tensor([[0., 1.],
                [1., 0.]])
        """
        return cls(resolution, pitch, bits, fill, AmplitudeResponse(bits, contrast))

    def _repr_html_(self) -> str:
        rows, columns = self.resolution
        return _show.fields_html(self, f"Modulator of {rows} × {columns} pixels, lengths in metres")

    def responses(self) -> list[torch.nn.Module]:
        """Return the responses of the frames where each has its own."""
        return list(self.response) if isinstance(self.response, torch.nn.ModuleList) else []

    def _of_frames(self, method: str, phases: torch.Tensor, *given: Any) -> torch.Tensor:
        """Return what a method gives for phases ``[..., frames, rows, columns]``, each frame by its own response."""
        alone = [replace(self, response=one) for one in self.responses()]
        if phases.ndim < 3 or phases.shape[-3] != len(alone):
            raise ValueError(f"phases must be of {len(alone)} frames, one for each response, got {list(phases.shape)}")
        parts = zip(alone, phases.unbind(-3), strict=True)
        return torch.stack([getattr(one, method)(part, *given) for one, part in parts], -3)

    def light(self, phases: torch.Tensor, scale: float | None = None) -> torch.Tensor:
        """Return the field of phases ``[..., rows, columns]`` in radians, at the pixels.

        With a `scale`, one of `phase_scale`, the phases that the panel shows, 0 … 2π, are multiplied by it.
        """
        given = () if scale is None else (scale,)
        if self.responses():
            return self._of_frames("light", phases, *given)
        phases = phases if scale is None else torch.remainder(phases, TURN)
        if self.response is None:
            return unit_phasor(phases if scale is None else phases * scale)
        return self.response(phases, *given)  # type: ignore[operator]

    def asked(self, phases: torch.Tensor, color: int) -> torch.Tensor:
        """Return what to show for the light of a source, the number `color`, to have some phases, or the nearest."""
        if self.phase_scale is None:
            return phases
        scale, wanted = self.phase_scale[color], torch.remainder(phases, TURN)
        most = scale * TURN * (1 - 1e-6)
        # Beyond the largest phase of a colour the nearer end: that one, or zero, a turn above.
        return torch.where(wanted - most > TURN - wanted, 0.0, wanted.clamp(max=most)) / scale

    def shown(self, phases: torch.Tensor) -> torch.Tensor:
        """Return the nearest phases that the levels of the panel can show, 0 … 2π."""
        if self.bits is None:
            return torch.remainder(phases, TURN)
        return self.phases_of(self.levels(phases), phases.dtype)

    def phases_of(self, levels: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Return the phases 0 … 2π, of a `dtype`, of levels: integers ``[..., rows, columns]`` below 2^bits."""
        if self.responses():
            return self._of_frames("phases_of", levels, dtype)
        count = 2 ** _validate.integer("bits", self.bits)
        if not isinstance(levels, torch.Tensor) or levels.is_floating_point() or levels.is_complex():
            raise TypeError(f"levels must be a tensor of integers, got {kind_of(levels)}")
        if _array.is_readable(levels) and bool(((levels < 0) | (levels >= count)).any()):
            raise ValueError(f"levels must be 0 … {count - 1}, got {int(levels.min())} to {int(levels.max())}")
        if getattr(self.response, "lut", None) is not None:
            return self.response._phases_of(levels, dtype)  # type: ignore[union-attr]
        return levels.to(dtype) * (TURN / count)

    def levels(self, phases: torch.Tensor) -> torch.Tensor:
        """Return the levels whose phases are nearest, int32 of the shape of the phases; 256 where there are none."""
        if self.responses():
            return self._of_frames("levels", phases)
        if self.bits is not None and getattr(self.response, "lut", None) is not None:
            return self.response.levels(phases)  # type: ignore[union-attr]
        return even_levels(phases, 256 if self.bits is None else 2**self.bits).to(torch.int32)


def checked_iris(iris: Any) -> None:
    """Raise ValueError unless the argument is a stop: "order", a round one, or None."""
    if iris is not None and iris != "order" and not isinstance(iris, Iris):
        raise ValueError(f"iris must be 'order', an Iris or None, got {iris!r:.80}")


def orders_through(iris: Iris | str | None, wavelengths: Sequence[float], pitches: Sequence[float]) -> int:
    """Return how many diffraction orders along each axis a stop passes, at most those that are computed without one."""
    if not isinstance(iris, Iris):
        return _ORDERS if iris is None else 1
    widest = max(iris.cutoff(w) for w in wavelengths) * max(pitches)
    return min(_ORDERS, max(1, math.ceil(2 * widest - 1e-9)))


def pitch_pair(pitch: float | Sequence[float]) -> tuple[float, float]:
    """Return the distances of neighbouring pixels along rows and columns in metres."""
    rows, columns = (float(_validate.numbers(p)[0]) for p in pitches(pitch))
    return rows, columns
