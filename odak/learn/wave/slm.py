"""Models of spatial light modulators, of phase or of amplitude: levels, crosstalk, gaps, unmodulated light."""

import cmath
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _array, _show, _validate
from odak._attributes import Prepared
from odak._torch_private import in_own_precision
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import floating
from odak.learn.wave.fields import unit_phasor
from odak.wave.fields import within_range
from odak.wave.linear_kernels import checked_pixel_fill

TURN = 2 * math.pi


def even_levels(phase: torch.Tensor, count: int) -> torch.Tensor:
    """Return the nearest of `count` levels spread evenly over 2π, as whole numbers in the phase's own dtype.

    The search of :func:`nearest_levels`, which finds the same, takes ten times as long.
    """
    return torch.remainder(torch.round(phase * (count / TURN)), count)


def nearest_levels(phase: torch.Tensor, lut: torch.Tensor) -> torch.Tensor:
    """Return the level whose phase is nearest around the circle.

    Parameters
    ----------
    phase : torch.Tensor
        Phase in radians, of any shape.
    lut : torch.Tensor
        Phase of each level in radians, ``[levels]``, in any order. Where it spans more than 2π, a phase inside its
        span is shown unchanged, and one outside is moved into it by multiples of 2π.

    Returns
    -------
    torch.Tensor
        int64 levels of the phase's shape.
    """
    phase, lut = phase.detach(), lut.detach()
    low = lut.min()
    period = TURN * torch.ceil((lut.max() - low) / TURN).clamp_min(1)
    rising, order = torch.sort(torch.remainder(lut - low, period))
    offset = torch.remainder(phase - low.to(phase.dtype), period.to(phase.dtype))
    # Half a step beyond the last level a level 2π below is nearer, if the table reaches that far.
    top = torch.where(period > 1.5 * TURN, 1.5 * rising[-1] - 0.5 * rising[-2], period)
    offset = torch.where(offset > top.to(phase.dtype), offset - TURN, offset)
    # Beyond the last boundary follows the first level of the next period.
    boundaries = torch.cat([(rising[1:] + rising[:-1]) / 2, (rising[-1:] + period) / 2]).to(phase.dtype)
    return torch.cat([order, order[:1]])[torch.bucketize(offset, boundaries)]


def turns_of(lut: torch.Tensor) -> int:
    """Return how many turns of 2π the phases of levels span, rounded up."""
    return math.ceil(float(lut.max() - lut.min()) / TURN)


def nearest_levels_by_factors(
    phase: torch.Tensor, lut: torch.Tensor, factors: torch.Tensor | float, turns: int
) -> torch.Tensor:
    """Return the level whose phase, times a factor of each pixel, is nearest around the circle.

    Parameters
    ----------
    phase : torch.Tensor
        Phase in radians ``[..., m, n]``.
    lut : torch.Tensor
        Phase of each level in radians, ``[levels]``, in any order.
    factors : torch.Tensor or float
        Factors ``[m, n]``, positive.
    turns : int
        Turns of 2π that the levels span, from :func:`turns_of`, which reads them from their device.

    Returns
    -------
    torch.Tensor
        int64 levels of the phase's shape.
    """
    best, least = torch.zeros_like(phase, dtype=torch.int64), torch.full_like(phase, torch.inf)
    rising, order = torch.sort(lut)
    between = (rising[1:] + rising[:-1]) / 2
    first = torch.floor((phase - factors * rising[0]) / TURN)
    # Whole turns below, within and above the span of the levels.
    for turn in range(-1, 2 + turns):
        wanted = phase + (turn - first) * TURN
        place = torch.bucketize(wanted / factors, between)
        apart = (rising[place] * factors - wanted).abs()
        best, least = torch.where(apart < least, order[place], best), torch.minimum(apart, least)
    return best


def gaussian_kernel(sigma: float) -> torch.Tensor:
    """Return the share of a Gaussian that falls on each sample, float64 ``[2·ceil(5σ) + 1]``.

    The phase is constant over a sample, so smoothing it and reading it at the middle of a sample weighs each
    neighbour by the integral over it: exact for any σ, also one far below a sample.

    Parameters
    ----------
    sigma : float
        Standard deviation in samples, positive.

    Returns
    -------
    torch.Tensor
        Weights, of sum 1 but for the tails beyond five standard deviations.
    """
    reach = math.ceil(5 * sigma)
    edges = (torch.arange(2 * reach + 2, dtype=torch.float64) - reach - 0.5) / (sigma * math.sqrt(2))
    return torch.erf(edges).diff() / 2


@in_own_precision
def smooth(phase: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """Return the phase convolved with a kernel divided by its sum, the panel continued by its rim.

    Parameters
    ----------
    phase : torch.Tensor
        ``[..., m, n]``.
    kernel : torch.Tensor
        Of the phase's dtype and device, with odd lengths: ``[k]``, used along both axes, or ``[k, l]``.

    Returns
    -------
    torch.Tensor
        Of the phase's shape; differentiable in both.
    """
    kernel = kernel / kernel.sum()
    image = phase.reshape(-1, *phase.shape[-2:])
    if kernel.ndim == 1:
        image = _along_columns(_along_columns(image, kernel).mT.contiguous(), kernel).mT
        return image.reshape(phase.shape)
    rows, columns = (n // 2 for n in kernel.shape)
    image = torch.nn.functional.pad(image[:, None], (columns, columns, rows, rows), mode="replicate")
    return torch.nn.functional.conv2d(image, kernel.flip(0, 1)[None, None]).reshape(phase.shape)


def _along_columns(image, kernel):
    """Return ``[batch, m, n]`` convolved along its last axis, each row a channel: 20 times as fast as one channel."""
    reach, rows = kernel.shape[0] // 2, image.shape[-2]
    image = torch.nn.functional.pad(image, (reach, reach), mode="replicate")
    return torch.nn.functional.conv1d(image, kernel.flip(0).expand(rows, 1, -1), groups=rows)


class spatial_light_modulator(Prepared, torch.nn.Module):
    """Model of a phase-only modulator, which returns the field that it makes of a phase.

    The phase is wrapped, shown by the nearest level, smoothed by crosstalk, multiplied by `scale`, and mixed with the
    light of the gaps: field = amplitude·exp(i·scale·aberration)·(F·exp(i·scale·shown) + (1 − F)·dead + zero order).
    Gradients pass through the levels as if they were not there (straight-through; Bengio et al., arXiv:1308.3432). With
    4 bits or fewer that alone gains nothing: optimising with ``bits=None`` and rounding at the end is then as good.

    Arguments that may be tensors are buffers, and learnt if given as :class:`torch.nn.Parameter`.

    Parameters
    ----------
    bits : int, optional
        Bits per pixel, 1 to 16; None for a phase without levels.
    phase_range : float, optional
        Level ℓ shows ℓ·phase_range/2^bits radians; 2π by default. Without levels, phases beyond it take its nearer
        end, and by default nothing is wrapped.
    lut : torch.Tensor, optional
        Measured phase of each level in radians, ``[2^bits]``, in place of `phase_range`: of any shape and span.
    crosstalk : float or torch.Tensor
        Standard deviation, in pixels, of the Gaussian that the fringing field smooths the shown phase by; 0 for none.
        Or a kernel on the sample grid with odd lengths, ``[k]`` (along both axes) or ``[k, l]``, divided by its sum.
    fill_factor : float or torch.Tensor
        Share F of the panel's area that modulates, a centred square of each pixel.
    dead_area_phase : float or torch.Tensor
        Phase in radians of the light from the gaps.
    dead_area_amplitude : float or torch.Tensor
        Amplitude of the light from the gaps.
    zero_order : complex or torch.Tensor
        Amplitude of further unmodulated light, as from the cover glass.
    aberration : torch.Tensor, optional
        Phase of the panel's curvature in radians, on the pixels or on the samples.
    amplitude : torch.Tensor, optional
        Amplitude of the illumination, real or complex, on the pixels or on the samples.
    samples_per_pixel : int
        Samples of the field along each side of a pixel. With 1 the gaps are averaged over the pixel, with more they
        are drawn, edges by their share of a sample. For even n the axis of the finer grid, its sample n·s // 2, is
        the edge of pixel n // 2.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import spatial_light_modulator
    >>> slm = spatial_light_modulator(bits=2, fill_factor=0.9)
    >>> slm.levels(torch.tensor([[0.0, 1.5, 3.2, 6.2]])).tolist()
    [[0, 1, 2, 0]]
    >>> slm(torch.zeros(4, 4)).dtype
    torch.complex64
    """

    phase_range: float | None

    _fixed = ("bits", "phase_range", "samples_per_pixel", "crosstalk")
    amplitude: torch.Tensor | None
    bits: int | None

    extra_repr: Callable[..., str] = _show.numbers_of

    def __init__(
        self,
        *,
        bits: int | None = 8,
        phase_range: float | None = None,
        lut: torch.Tensor | None = None,
        crosstalk: float | torch.Tensor = 0.0,
        fill_factor: float | torch.Tensor = 1.0,
        dead_area_phase: float | torch.Tensor = 0.0,
        dead_area_amplitude: float | torch.Tensor = 1.0,
        zero_order: complex | torch.Tensor = 0.0,
        aberration: torch.Tensor | None = None,
        amplitude: torch.Tensor | None = None,
        samples_per_pixel: int = 1,
    ):
        super().__init__()
        self.samples_per_pixel: int = _validate.integer("samples_per_pixel", samples_per_pixel, minimum=1)
        self.bits = checked_bits(bits)
        self.phase_range = None if phase_range is None else _validate.real("phase_range", phase_range, positive=True)
        self._hold_lut(lut)
        self._hold_crosstalk(crosstalk)
        parts = {
            "fill_factor": _share("fill_factor", fill_factor),
            "dead_area_phase": _validate.real("dead_area_phase", dead_area_phase),
            "dead_area_amplitude": _validate.real("dead_area_amplitude", dead_area_amplitude),
            "zero_order": _finite("zero_order", zero_order),
            "aberration": panel_map("aberration", aberration),
            "amplitude": panel_map("amplitude", amplitude),
        }
        for name, value in parts.items():
            self._hold(name, value)

    def forward(self, phase: torch.Tensor, scale: float | torch.Tensor = 1.0) -> torch.Tensor:
        """Return the field behind the modulator.

        Parameters
        ----------
        phase : torch.Tensor
            Requested phase in radians, ``[..., m, n]``, float32 or float64.
        scale : float or torch.Tensor
            Multiplies the phase that is shown, and the aberration: λ0/λ for a panel set up at λ0 and lit at λ. A
            tensor broadcasts against the phase, as ``[colours, 1, 1]``.

        Returns
        -------
        torch.Tensor
            complex64 or complex128, ``[..., m·s, n·s]`` with s samples per pixel.
        """
        return self._light(self.displayed_phase(phase), scale)

    def _light(self, shown, scale):
        """Return the field behind the modulator of a phase that it shows, as :meth:`displayed_phase` gives it."""
        scale = scale.to(shown) if isinstance(scale, torch.Tensor) else _validate.real("scale", scale)
        light = unit_phasor(_times(shown, scale))
        if isinstance(self.fill_factor, torch.Tensor) or self.fill_factor != 1:
            light = self._with_gaps(light)
        if isinstance(self.zero_order, torch.Tensor) or self.zero_order != 0:
            light = light + _like(self.zero_order, light)
        if self.aberration is not None:
            light = light * unit_phasor(_times(self._on_samples("aberration", shown), scale))
        if self.amplitude is not None:
            light = light * self._on_samples("amplitude", light if self.amplitude.is_complex() else shown)
        return light

    def displayed_phase(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the phase that the panel shows: wrapped, of the nearest level, then smoothed by crosstalk.

        Parameters
        ----------
        phase : torch.Tensor
            Requested phase in radians, ``[..., m, n]``.

        Returns
        -------
        torch.Tensor
            Phase in radians, ``[..., m·s, n·s]``; differentiable, the levels straight through.
        """
        shown = self._quantised(checked_phase(phase))
        s = self.samples_per_pixel
        if s > 1:
            shown = shown.repeat_interleave(s, -2).repeat_interleave(s, -1)
        return shown if self.crosstalk is None else smooth(shown, _like(self.crosstalk, shown))

    def levels(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the levels to send to the device for a phase in radians: int32, 0 … 2^bits − 1, of its shape.

        Raises
        ------
        ValueError
            If the modulator has no levels.
        """
        if self.lut is None:
            raise ValueError("bits must be given for a modulator to have levels, got None")
        phase = checked_phase(phase).detach()
        # Integers cannot represent NaN.
        _validate.real("phase", phase)
        if self._even:
            return even_levels(phase, 2 ** (self.bits or 0)).to(torch.int32)
        return self._nearest(phase, _like(self.lut, phase, self.lut.dtype)).to(torch.int32)

    def _phases_of(self, levels: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Return the phases in radians, of a `dtype`, of levels: integers ``[..., m, n]`` below 2^bits."""
        if self.lut is None:
            raise ValueError("bits must be given for a modulator to have levels, got None")
        lut: Any = self.lut
        return lut.to(levels.device, dtype)[levels.long()]

    def _nearest(self, phase: torch.Tensor, lut: torch.Tensor) -> torch.Tensor:
        return nearest_levels(phase, lut)

    def _quantised(self, phase):
        if self.lut is None:
            if self.phase_range is None:
                return phase
            target = within_range(phase.detach(), self.phase_range)
        else:
            if self._even:
                target = even_levels(phase.detach(), 2**self.bits) * (TURN / 2**self.bits)
            else:
                target = self._phases_of(self.levels(phase), phase.dtype)
        # The difference is exactly zero: it contributes the gradient and no rounding error.
        return target + (phase - phase.detach())

    def _with_gaps(self, light):
        """Return the field with the light of the unmodulated area in the part of each sample that lies in a gap."""
        s = self.samples_per_pixel
        real = light.real.dtype
        fill = torch.as_tensor(self.fill_factor, dtype=real, device=light.device).clamp(0, 1)
        if s == 1:
            cover = fill
        else:
            line = _covered(fill, s)
            cover = line[:, None, None] * line  # [s, 1, s] against [..., m, s, n, s]
        *batch, rows, columns = light.shape
        pixels = light.reshape(*batch, rows // s, s, columns // s, s)
        return (pixels * cover + (1 - cover) * self._dead_light(light)).reshape(light.shape)

    def _dead_light(self, light):
        phase, amplitude = self.dead_area_phase, self.dead_area_amplitude
        if not isinstance(phase, torch.Tensor):
            phasor = cmath.rect(1.0, phase)
        else:
            phasor = unit_phasor(_like(phase, light, light.real.dtype))
        return phasor * (
            _like(amplitude, light, light.real.dtype) if isinstance(amplitude, torch.Tensor) else amplitude
        )

    def _on_samples(self, name, like):
        return on_samples(name, _like(getattr(self, name), like), like.shape, self.samples_per_pixel)

    def _hold(self, name, value, persistent=True):
        """Keep a tensor as a buffer, a Parameter as one, and a number as it is."""
        if isinstance(value, torch.Tensor) and not isinstance(value, torch.nn.Parameter):
            self.register_buffer(name, value, persistent=persistent)
        else:
            setattr(self, name, value)

    def __setattr__(self, name: Any, value: Any) -> None:
        if name == "lut" and "_even" in vars(self):
            # Phases in place of even ones.
            self._check_lut(value)
            self._even = False
        super().__setattr__(name, value)

    def _check_lut(self, lut):
        _validate.real("lut", lut)
        if self.bits is None or self.phase_range is not None:
            raise ValueError("lut needs bits and takes the place of phase_range, got bits None or a phase_range")
        if not isinstance(lut, torch.Tensor) or tuple(lut.shape) != (2**self.bits,):
            raise ValueError(f"lut must be a tensor of {2**self.bits} phases for {self.bits} bits, got {lut!r:.80}")

    def _hold_lut(self, lut):
        even = lut is None and self.bits is not None
        if even:
            span = TURN if self.phase_range is None else self.phase_range
            lut = torch.arange(2**self.bits, dtype=torch.float64) * (span / 2**self.bits)
        elif lut is not None:
            self._check_lut(lut)
        self._hold("lut", lut, not even)
        self._even = even and self.phase_range is None

    def _hold_crosstalk(self, crosstalk):
        if isinstance(crosstalk, torch.Tensor):
            if crosstalk.ndim not in (1, 2) or any(n % 2 == 0 for n in crosstalk.shape):
                raise ValueError(f"crosstalk must have one or two axes of odd length, got {tuple(crosstalk.shape)}")
            self._hold("crosstalk", crosstalk)
            return
        _validate.number("crosstalk", crosstalk, least=0)
        kernel = None if crosstalk == 0 else gaussian_kernel(crosstalk * self.samples_per_pixel)
        self._hold("crosstalk", kernel, False)


class VaryingModulator(spatial_light_modulator):
    """A modulator whose phases are those of its levels times a factor of each pixel.

    Parameters
    ----------
    factors : torch.Tensor
        Factors ``[m, n]``, positive.
    **options
        Parameters of :class:`spatial_light_modulator`, with `lut`.
    """

    factors: torch.Tensor

    def __init__(self, factors: torch.Tensor, **options: Any):
        super().__init__(**options)
        self.register_buffer("factors", factors)

    def _phases_of(self, levels: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Return the phases in radians, of a `dtype`, of levels: integers ``[..., m, n]`` below 2^bits."""
        return super()._phases_of(levels, dtype) * self.factors.to(levels.device, dtype)

    def _nearest(self, phase: torch.Tensor, lut: torch.Tensor) -> torch.Tensor:
        return nearest_levels_by_factors(phase.detach(), lut.to(phase.dtype), self.factors.to(phase), turns_of(lut))


class AmplitudeResponse(torch.nn.Module):
    """Field of a panel that attenuates light and does not shift its phase, such as an array of tilting mirrors.

    Use it as `response` of a :class:`Modulator`, or take :meth:`Modulator.amplitude_only`. What solvers find for a
    panel are phases φ; a pixel shows them by the amplitude (1 + cos φ)/2, which is the phase hologram's light with that
    of its conjugate, and a uniform background (Brown and Lohmann, Applied Optics 5, 967, 1966).

    Parameters
    ----------
    bits : int, optional
        Bits of a pixel, whose 2^bits levels are spread evenly over the amplitudes; None for amplitudes without levels.
    contrast : float, optional
        Intensity of a bright pixel over that of a dark one, whose light is in phase; None for dark pixels without
        light.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import AmplitudeResponse
    >>> mirrors = AmplitudeResponse(bits=1, contrast=400)
    >>> mirrors.levels(torch.tensor([[0.0, 1.5, 1.7, 3.1]])).tolist()
    [[1, 1, 0, 0]]
    >>> mirrors(torch.tensor([[0.0, torch.pi]])).real
    tensor([[1.0000, 0.0500]])
    """

    extra_repr: Callable[..., str] = _show.numbers_of

    def __init__(self, bits: int | None = 1, contrast: float | None = None):
        super().__init__()
        self.bits: int | None = checked_bits(bits)
        self.contrast: float | None = None if contrast is None else _validate.number("contrast", contrast, least=1)
        amplitudes = None if bits is None else torch.linspace(0, 1, 2**bits, dtype=torch.float64)
        self.register_buffer("lut", None if amplitudes is None else 2 * amplitudes.sqrt().acos(), persistent=False)

    def forward(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the field behind the panel, whose imaginary part is zero.

        Parameters
        ----------
        phase : torch.Tensor
            Phase in radians, ``[..., m, n]``, float32 or float64.

        Returns
        -------
        torch.Tensor
            complex64 or complex128, of the phase's shape.
        """
        dark = 0.0 if self.contrast is None else self.contrast**-0.5
        bright = dark + (1 - dark) * _passed(checked_phase(phase))
        return torch.complex(bright, torch.zeros_like(bright))

    def levels(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the levels whose amplitudes are nearest those of a phase in radians: int32, 0 for dark pixels."""
        # Integers cannot represent NaN.
        amplitudes = _passed(_validate.real("phase", checked_phase(phase).detach()))
        return torch.round(amplitudes * (2 ** _validate.integer("bits", self.bits) - 1)).to(torch.int32)

    def _phases_of(self, levels: torch.Tensor, dtype: torch.dtype = torch.float32) -> torch.Tensor:
        """Return the phases in radians, of a `dtype`, of levels: integers ``[..., m, n]`` below 2^bits."""
        lut: Any = self.lut
        return lut.to(levels.device, dtype)[levels.long()]


def _passed(phase):
    """Return the amplitude (1 + cos φ)/2 that stands for a phase."""
    return torch.cos(phase / 2) ** 2


class temporal_modulator(torch.nn.Module):
    """Modulator that settles exponentially while it shows frames one after another, again and again.

    When a frame is displayed, the phase approaches the requested one as exp(−t/response_time). The
    light of a frame is the mean over the instants at which it is lit. Each frame becomes several fields, at the middles
    of equal parts of that time; :func:`odak.learn.wave.stochastic_gradient_descent` takes the mean of their
    intensities, as eye and camera do.

    The phase in the steady state is a weighted mean of the requested phases, by the elapsed time. It is therefore a
    matrix product over frames.

    Parameters
    ----------
    frame_time : float
        Time between two frames in seconds.
    response_time : float
        Time in seconds in which the difference to the phase asked for falls to 1/e; it falls from 90 % to 10 % in 2.2
        times that. Liquid crystals take milliseconds, ferroelectric ones some tens of microseconds.
    slm : spatial_light_modulator, optional
        Levels, crosstalk and gaps; the ideal modulator without levels by default. Its phases are rounded before they
        settle.
    lit : sequence of float
        Start and end of the light within each frame, as shares of the frame time. A source that is switched on late
        leaves the modulator time to settle.
    time_samples : int
        Instants per frame.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    The law of first order describes a linearised nematic cell (Yang and Wu, Fundamentals of Liquid Crystal Devices,
    2014, section 5.4). Rise and fall of real cells differ; take the slower one.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import temporal_modulator
    >>> modulator = temporal_modulator(1e-3, 2e-4, time_samples=2)
    >>> modulator(torch.zeros(3, 4, 4)).shape
    torch.Size([6, 4, 4])
    """

    extra_repr: Callable[..., str] = _show.numbers_of

    @property
    def samples_per_pixel(self) -> int:
        """Samples per pixel along each axis, those of `slm`."""
        return self.slm.samples_per_pixel

    def __init__(
        self,
        frame_time: float,
        response_time: float,
        slm: "spatial_light_modulator | None" = None,
        *,
        lit: Sequence[float] = (0.0, 1.0),
        time_samples: int = 4,
    ):
        (lit,) = _validate.constants(lit=lit)
        super().__init__()
        self.frame_time: float = _validate.constant("frame_time", frame_time, positive=True)
        self.response_time: float = _validate.constant("response_time", response_time, least=0)
        _validate.instance("slm", slm, (spatial_light_modulator, type(None)), "a spatial_light_modulator or None")
        self.slm: spatial_light_modulator = spatial_light_modulator(bits=None) if slm is None else slm
        start, end = _validate.numbers(_validate.several("lit", lit, 2))
        if not 0 <= start < end <= 1:
            raise ValueError(f"lit must be the start and the end of the illumination, 0 ≤ start < end ≤ 1; got {lit!r}")
        self.lit: tuple[float, float] = (start, end)
        self.time_samples: int = _validate.integer("time_samples", time_samples, minimum=1)

    def forward(self, phase: torch.Tensor, scale: float | torch.Tensor = 1.0) -> torch.Tensor:
        """Return the fields behind the modulator at the instants at which it is lit.

        Parameters
        ----------
        phase : torch.Tensor
            Phases asked for in radians, ``[frames, ..., m, n]``, float32 or float64.
        scale : float or torch.Tensor
            Multiplies the phase that is shown, and the aberration: λ0/λ for a panel set up at λ0 and lit at λ. A
            tensor broadcasts against the phase, as ``[colours, 1, 1]``.

        Returns
        -------
        torch.Tensor
            complex64 or complex128, ``[frames·time_samples, ..., m·s, n·s]``, ordered by frames.
        """
        return self.slm._light(self.displayed_phase(phase), scale)

    @in_own_precision
    def displayed_phase(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the phase at the instants at which the modulator is lit, ``[frames·time_samples, ..., m·s, n·s]``."""
        if not isinstance(phase, torch.Tensor) or phase.ndim < 3 or not len(phase):
            got = list(phase.shape) if isinstance(phase, torch.Tensor) else type(phase).__name__
            raise ValueError(f"phase must be [frames, ..., rows, columns], got {got}")
        shown = self.slm.displayed_phase(phase)
        return torch.tensordot(self.weights(len(shown)).to(shown), shown, 1)

    def weights(self, frames: int) -> torch.Tensor:
        """Return the share of each frame's phase in the phase shown at each instant, ``[frames·time_samples, frames]``.

        Parameters
        ----------
        frames : int
            Number of frames that are repeated.

        Returns
        -------
        torch.Tensor
            float64, each row of sum 1.
        """
        frames, count = _validate.integer("frames", frames, minimum=1), self.time_samples
        start, end = self.lit
        middles = start + (end - start) * (torch.arange(count, dtype=torch.float64) + 0.5) / count
        rate = self.frame_time / self.response_time if self.response_time else math.inf
        left, kept = torch.exp(-rate * middles), math.exp(-rate)
        # At the start of a frame there is (1 − kept)·kept^k of the frame k + 1 before, over all repetitions.
        ages = torch.arange(frames, dtype=torch.float64)
        before = (1 - kept) * (kept**ages if kept else (ages == 0).double()) / (1 - kept**frames)
        place = torch.arange(frames)
        past = before[(place[:, None] - place - 1) % frames]
        shares = (
            left[:, None] * past[:, None, :] + (1 - left[:, None]) * torch.eye(frames, dtype=torch.float64)[:, None]
        )
        return shares.reshape(frames * count, frames)


def temporal_average(intensity: torch.Tensor, dim: int = -3) -> torch.Tensor:
    """Return the mean of intensities shown one after another, faster than the eye or the camera tells apart.

    Parameters
    ----------
    intensity : torch.Tensor
        Real, ``[..., frames, m, n]``.
    dim : int
        Axis of the frames.

    Returns
    -------
    torch.Tensor
        `intensity` without that axis.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import temporal_average
    >>> temporal_average(torch.tensor([[[1.0]], [[3.0]]])).tolist()
    [[2.0]]
    """
    intensity = floating("intensity", intensity)
    dim = _validate.whole("dim", dim, minimum=-(2**31))
    if not -intensity.ndim <= dim < intensity.ndim:
        raise ValueError(f"dim must be an axis of an intensity {list(intensity.shape)}, got {dim}")
    return intensity.mean(dim)


def panel_map(name: str, value: torch.Tensor | None) -> torch.Tensor | None:
    """Return a map of the panel ``[..., rows, columns]``, or None, after checking that it is one."""
    _validate.instance(name, value, (torch.Tensor, type(None)), "a torch.Tensor")
    return value if value is None else _validate.image(name, value)


def on_samples(name: str, value: torch.Tensor, shape: Sequence[int], samples_per_pixel: int) -> torch.Tensor:
    """Return a map of the panel, given on its pixels or on its samples, on the samples.

    Parameters
    ----------
    name : str
        What the map is called in an error.
    value : torch.Tensor
        ``[..., rows, columns]`` of the pixels or of the samples; an axis of length 1 holds for all.
    shape : sequence of int
        Shape whose last two axes are the rows and columns of samples.
    samples_per_pixel : int
        Samples along each side of a pixel.

    Returns
    -------
    torch.Tensor
        Broadcasts against `shape`.

    Raises
    ------
    ValueError
        If the map is of another panel.
    """
    s = samples_per_pixel
    if s > 1 and all(n * s == size for n, size in zip(value.shape[-2:], shape[-2:], strict=True)):
        value = value.repeat_interleave(s, -2).repeat_interleave(s, -1)
    for have, want in zip(value.shape[-2:], shape[-2:], strict=True):
        if have not in (1, want):
            raise ValueError(
                f"{name} must have the modulator's pixels or samples {tuple(shape[-2:])}, as the phase has; "
                f"got {tuple(value.shape)}"
            )
    return value


def _times(phase, scale):
    return phase if not isinstance(scale, torch.Tensor) and scale == 1 else phase * scale


def _like(value, like, dtype=None):
    """Return a number or a tensor on the device of `like` and in its precision (or `dtype`), for arithmetic with it."""
    if not isinstance(value, torch.Tensor):
        return value
    return _array.cast(value, like, dtype)


def _share(name, value):
    _validate.real(name, value)
    for number in _validate.numbers(value) if _array.is_readable(value) else []:
        if not 0 <= number <= 1:
            raise ValueError(f"{name} must be between 0 and 1, got {number!r}")
    return value


def _finite(name, value):
    if isinstance(value, torch.Tensor):
        return value
    if not isinstance(value, (int, float, complex)) or isinstance(value, bool):
        raise TypeError(f"{name} must be a number or a tensor, got {type(value).__name__}")
    if not cmath.isfinite(value):
        raise ValueError(f"{name} must be finite, got {value!r}")
    return value


def checked_bits(bits: int | None) -> int | None:
    """Return the bits of a pixel, 1 to 16 or None, after checking them."""
    if bits is not None and not 1 <= _validate.integer("bits", bits) <= 16:
        raise ValueError(f"bits must be 1 to 16 or None, got {bits}")
    return None if bits is None else int(bits)


def checked_phase(phase: torch.Tensor) -> torch.Tensor:
    """Return a phase ``[..., rows, columns]`` of single or double precision after checking it."""
    if not isinstance(phase, torch.Tensor) or phase.dtype not in (torch.float32, torch.float64):
        kind = phase.dtype if isinstance(phase, torch.Tensor) else type(phase).__name__
        raise TypeError(f"phase must be a float32 or float64 tensor, got {kind}")
    return _validate.image("phase", phase)


def _covered(fill, s):
    """Return the share of each of the `s` samples across a pixel that its active part of area `fill` covers."""
    # The derivative of the root is infinite at zero; where edges coincide, the derivative of the active part is used.
    side = torch.where(fill > 0, fill.where(fill > 0, 1).sqrt(), fill) * s / 2
    start = torch.arange(s, dtype=fill.dtype, device=fill.device)
    low, high = s / 2 - side, s / 2 + side
    return (torch.where(high <= start + 1, high, start + 1) - torch.where(low >= start, low, start)).clamp_min(0)


def checked_fill(pixel_fill: float | None, slm: Any, has_iris: bool) -> float | None:
    """Return the share of a pixel's area that emits: given, or of a modulator with gaps; None for points.

    A field of pixels of finite size has the spectrum of these. Its orders beyond 1/(2·pitch) are not sampled, which an
    AccuracyWarning says where no iris stops those of a modulator.
    """
    if pixel_fill is not None:
        return checked_pixel_fill(pixel_fill)
    slm = slm.slm if isinstance(slm, temporal_modulator) else slm
    if not isinstance(slm, spatial_light_modulator) or slm.samples_per_pixel > 1 or not 0 < float(slm.fill_factor) < 1:  # type: ignore[arg-type]
        return None
    if not has_iris:
        warn(
            "pixels of finite size send light into orders beyond 1/(2·pixel_pitch), which are left out: give the iris "
            "that stops them, or a modulator with several samples_per_pixel",
            AccuracyWarning,
        )
    return float(slm.fill_factor)  # type: ignore[arg-type]


def iris_cutoff(wavelength: float, iris_radius: Any, iris_focal_length: Any) -> float | None:
    """Return the cut-off of an iris in cycles per metre after checking its lengths; None without an iris."""
    if (iris_radius is None) != (iris_focal_length is None):
        raise ValueError("iris_radius and iris_focal_length must be given together")
    if iris_radius is None:
        return None
    _validate.real("iris_radius", iris_radius, positive=True)
    _validate.real("iris_focal_length", iris_focal_length, positive=True)
    _validate.number("wavelength", wavelength)
    return float(iris_radius / (wavelength * iris_focal_length))
