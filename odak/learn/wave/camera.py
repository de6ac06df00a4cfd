"""Simulation of a display with a camera in front of it, for camera-in-the-loop optimization."""

from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _show, _validate
from odak._attributes import Prepared
from odak.learn._tensors import kind_of, tensor
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.slm import checked_bits, checked_fill, checked_phase, iris_cutoff, on_samples, panel_map
from odak.wave.methods import check_has_kernel
from odak.wave.propagation import propagate_within_window
from odak.wave.transfer_functions import checked_pitch, divided_pitch


def captured_by(camera: Callable[..., Any], phase: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
    """Return the intensity that a camera captures of a phase.

    Parameters
    ----------
    camera : callable
        ``camera(phase)`` shows a phase and returns the captured intensity.
    phase : torch.Tensor
        What to show.
    shape : tuple of int
        Shape that the captured intensity must have.

    Returns
    -------
    torch.Tensor
        Captured intensity, without a graph.

    Raises
    ------
    ValueError, TypeError
        If the camera does not return an intensity of that shape.
    """
    with torch.no_grad():
        captured = camera(phase.detach())
    if not isinstance(captured, torch.Tensor) or captured.is_complex():
        raise TypeError(f"camera must return a real tensor, got {kind_of(captured)}")
    if tuple(captured.shape) != tuple(shape):
        raise ValueError(f"camera must return an image of {tuple(shape)}, got {tuple(captured.shape)}")
    return captured.detach()


def with_model_gradient(image: torch.Tensor, captured: torch.Tensor) -> torch.Tensor:
    """Return the captured intensity with the gradient of the model's intensity `image` (Peng et al. 2020, eq. 8)."""
    return image + (captured.to(image) - image).detach()


# Fractions of the full well above which it is saturated; torch draws no electrons at all at an infinite rate.
_FULL = 1e4


class simulated_camera(Prepared, torch.nn.Module):
    """Simulated display with deviations from its model, and the camera that captures its intensity.

    The light of the modulator, times illumination and aberration, is propagated; each pixel of the sensor collects
    the light of one pixel of the hologram. An intensity I becomes I·exposure·full_well electrons on average, drawn by
    Poisson's law; the amplifier adds normal noise; values outside 0 … full_well are clipped, then rounded to the
    levels of the converter, and divided by the gain again. A captured image is therefore on the scale of the model's
    intensity, of mean I and variance I/(exposure·full_well) + (read_noise/(exposure·full_well))², within
    0 … 1/exposure.

    Give it as ``camera=`` to :func:`odak.learn.wave.stochastic_gradient_descent`. What the camera shows the model only
    has to know roughly, but its slopes must point the right way: faults that move the image by half a pixel or more,
    such as strong aberration over a long distance, have to be put into the model first, by registering the image.

    Parameters
    ----------
    wavelength : float
        Wavelength in metres.
    distance : float
        Distance from hologram to sensor in metres: the real one, which may differ from the model's.
    pixel_pitch : float or sequence of float
        Pixel pitch of the hologram in metres, one number or a pair (rows, columns).
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`; computed without wrap-around.
    slm : callable, optional
        ``slm(phase)`` is the field that the modulator sends out, such as
        :class:`odak.learn.wave.spatial_light_modulator`; an ideal one by default. If it draws several samples per
        pixel, the sensor adds up their light.
    aberration : torch.Tensor, optional
        Phase error of the light on the hologram in radians, ``[m, n]``, such as
        :func:`odak.learn.wave.zernike_phase`.
    illumination : torch.Tensor, optional
        Amplitude of the light on the hologram, real ``[m, n]``; one by default.
    exposure : float
        Share of the full well that an intensity of 1 fills: the sensor saturates at an intensity of 1/exposure.
    full_well : float, optional
        Electrons that a pixel of the sensor holds. None for a sensor without shot noise.
    read_noise : float
        Standard deviation of the amplifier's noise in electrons; needs `full_well`.
    bits : int, optional
        Bits of the converter, 1 to 16; None for one without levels.
    seed : int, optional
        Makes the noise reproducible, on one device.
    iris_radius : float, optional
        Radius in metres of a round iris in the focal plane of a lens; open by default.
    iris_focal_length : float, optional
        Focal length in metres of that lens.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1, as in
        :func:`odak.learn.wave.stochastic_gradient_descent`; by default pixels are points, unless there is an iris and
        `slm` has a fill factor.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Notes
    -----
    Sensor: EMVA standard 1288, release 4.0 (2021), section 2, without dark current. Camera in the loop: Peng et al.,
    ACM Trans. Graph. 39, 185 (2020).

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import simulated_camera, zernike_phase
    >>> camera = simulated_camera(532e-9, 1e-3, 8e-6, aberration=zernike_phase(16, 16, {(2, 0): 0.5}), bits=8, seed=0)
    >>> captured = camera(torch.zeros(16, 16))
    >>> captured.shape, bool((captured >= 0).all()), bool((captured <= 4).all())
    (torch.Size([16, 16]), True, True)
    """

    full_well: float | None

    _fixed = ("wavelength", "slm")
    aberration: torch.Tensor
    illumination: torch.Tensor

    extra_repr: Callable[..., str] = _show.numbers_of

    @_validate.takes_units("wavelength", "distance", "pixel_pitch", "iris_radius", "iris_focal_length")
    def __init__(
        self,
        wavelength: float,
        distance: float,
        pixel_pitch: float | Sequence[float],
        propagation_type: str = "Bandlimited Angular Spectrum",
        *,
        slm: Callable[..., Any] | None = None,
        aberration: torch.Tensor | None = None,
        illumination: torch.Tensor | None = None,
        exposure: float = 0.25,
        full_well: float | None = 10000.0,
        read_noise: float = 0.0,
        bits: int | None = None,
        seed: int | None = None,
        iris_radius: float | None = None,
        iris_focal_length: float | None = None,
        pixel_fill: float | None = None,
    ):
        super().__init__()
        self.wavelength: float | torch.Tensor = _validate.real("wavelength", wavelength, positive=True)
        self.distance: float | torch.Tensor = _validate.real("distance", distance)
        self.pixel_pitch: float = checked_pitch("pixel_pitch", pixel_pitch)
        check_has_kernel(propagation_type)
        self.propagation_type: str = propagation_type
        self.slm: Callable[..., Any] | None = _validate.function_or_none("slm", slm)
        self.register_buffer("aberration", panel_map("aberration", aberration))
        self.register_buffer("illumination", panel_map("illumination", illumination))
        self.exposure: float = _validate.constant("exposure", exposure, positive=True)
        self.full_well = None if full_well is None else _validate.constant("full_well", full_well, positive=True)
        self.read_noise: float = _validate.constant("read_noise", read_noise)
        if self.read_noise < 0 or (self.read_noise > 0 and full_well is None):
            raise ValueError(f"read_noise must be at least 0, and 0 without full_well, got {read_noise!r}")
        self.bits: int | None = checked_bits(bits)
        self.cutoff: float | None = iris_cutoff(self.wavelength, iris_radius, iris_focal_length)
        self.pixel_fill: float | None = None
        if pixel_fill is not None or self.cutoff is not None:
            self.pixel_fill = checked_fill(pixel_fill, self.slm, self.cutoff is not None)
        self._generator = None
        self.seed: int | None = None if seed is None else _validate.integer("seed", seed)

    def light(self, phase: torch.Tensor) -> torch.Tensor:
        """Return the intensity on the sensor, without its noise and limits: the mean of captures.

        Parameters
        ----------
        phase : torch.Tensor
            Phase shown, in radians, ``[..., m, n]``, float32 or float64.

        Returns
        -------
        torch.Tensor
            Real ``[..., m, n]``, in the phase's precision; differentiable.
        """
        phase = _validate.image("phase", tensor("phase", phase))
        field = unit_phasor(phase) if self.slm is None else self.slm(phase)
        s = field.shape[-1] // phase.shape[-1]
        if self.illumination is not None:
            field = field * on_samples("illumination", self.illumination.to(phase), field.shape, s)
        if self.aberration is not None:
            field = field * on_samples("aberration", unit_phasor(self.aberration).to(field), field.shape, s)
        there: Any = propagate_within_window(
            field,
            self.distance,
            divided_pitch(self.pixel_pitch, s),
            self.wavelength,
            self.propagation_type,
            self.cutoff,
            self.pixel_fill if s == 1 else None,
        )
        light = intensity(there)
        return light if s == 1 else light.unflatten(-2, (-1, s)).unflatten(-1, (-1, s)).mean((-3, -1))

    @torch.no_grad()
    def forward(self, phase: torch.Tensor) -> torch.Tensor:
        """Return a captured image.

        Parameters
        ----------
        phase : torch.Tensor
            Phase to show, in radians, ``[..., m, n]``, float32 or float64.

        Returns
        -------
        torch.Tensor
            Real ``[..., m, n]``, 0 … 1/exposure, in the phase's precision, without a graph.
        """
        return self.captured(self.light(checked_phase(phase)))

    @torch.no_grad()
    def captured(self, light: torch.Tensor) -> torch.Tensor:
        """Return the levels that the sensor captures of an intensity, with noise and saturation.

        Parameters
        ----------
        light : torch.Tensor
            Intensity, real, not negative.

        Returns
        -------
        torch.Tensor
            Of its shape, 0 … 1/exposure.
        """
        if not isinstance(light, torch.Tensor) or light.dtype not in (torch.float32, torch.float64):
            kind = light.dtype if isinstance(light, torch.Tensor) else type(light).__name__
            raise TypeError(f"light must be a float32 or float64 tensor, got {kind}")
        share = (light * self.exposure).clamp(max=_FULL)
        if self.full_well is not None:
            random = self._random(light.device)
            # On a GPU, drawing at a negative rate or NaN would end the process.
            known = share >= 0
            electrons = torch.poisson(share.where(known, 0.0) * self.full_well, generator=random)
            if self.read_noise:
                noise = torch.empty_like(electrons).normal_(generator=random)
                electrons = electrons + self.read_noise * noise
            share = (electrons / self.full_well).where(known, torch.nan)
        share = share.clamp(0, 1)
        if self.bits is not None:
            steps = 2**self.bits - 1
            share = torch.round(share * steps) / steps
        return share / self.exposure

    def _random(self, device):
        if self._generator is None or self._generator.device != device:
            self._generator = torch.Generator(device)
            if self.seed is None:
                self._generator.seed()
            else:
                self._generator.manual_seed(self.seed)
        return self._generator
