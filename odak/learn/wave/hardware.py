"""A holographic display without a relay: a modulator, a pinhole and the planes in front of them."""

from collections.abc import Iterable, Sequence

import torch

from odak import _array, _validate
from odak.learn._tensors import checked_device, floating, tensor
from odak.learn.wave.convolution import convolve
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.volume import display_volume, index, plane_distances
from odak.tools.matrix import zero_pad

__all__ = ["holographic_display"]


class holographic_display(display_volume):
    """A phase-only display whose light propagates directly to the planes of a volume.

    Parameters
    ----------
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres.
    pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    resolution : sequence of int
        Rows m and columns n of the modulator.
    volume_depth : float
        Distance from the first plane to the last in metres.
    number_of_depth_layers : int
        Planes D, spread evenly over the volume.
    image_location_offset : float
        Distance of the volume's centre, where a single plane lies, in metres.
    pinhole_size : float
        Radius of the round pinhole in the Fourier plane, in samples of the padded spectrum along its longer axis.
    pad : sequence of bool
        Surround fields by as many zeros again before they are propagated, and cut the result back to ``[m, n]``.
    illumination : torch.Tensor, optional
        Amplitude of the light on the modulator, ``[m, n]``; one by default.
    propagation_type : str
        A propagation type that has a transfer function on the grid of the modulator, or "auto".
    device : torch.device, optional
        Where to compute.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.propagator : With a relay, sources whose powers are learned, and a model of the modulator.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import holographic_display
    >>> display = holographic_display([515e-9], resolution=[16, 24], number_of_depth_layers=2)
    >>> display.reconstruct(torch.zeros(1, 16, 24), torch.ones(1, 1)).shape
    torch.Size([1, 2, 1, 16, 24])
    """

    def __init__(
        self,
        wavelengths: Sequence[float],
        pixel_pitch: float | Sequence[float] = 3.74e-6,
        resolution: Sequence[int] = (1920, 1080),
        volume_depth: float = 0.01,
        number_of_depth_layers: int = 10,
        image_location_offset: float = 0.005,
        pinhole_size: float = 1500,
        pad: Sequence[bool] = (True, True),
        illumination: torch.Tensor | None = None,
        propagation_type: str = "Bandlimited Angular Spectrum",
        device: torch.device | None = None,
    ):
        layers = _validate.integer("number_of_depth_layers", number_of_depth_layers, minimum=1)
        if isinstance(pad, str) or not isinstance(pad, Iterable) or len(pad := list(pad)) != 2:
            raise ValueError(f"pad must be two booleans, got {pad!r}")
        pad, device = [_validate.flag("pad", flag) for flag in pad], checked_device("device", device)
        _validate.real("pinhole_size", pinhole_size, positive=True)
        _validate.real("volume_depth", volume_depth)
        _validate.real("image_location_offset", image_location_offset)
        super().__init__(
            resolution,
            wavelengths,
            pixel_pitch,
            plane_distances(None, volume_depth, layers, image_location_offset),
            propagation_type,
            offset=image_location_offset,
            padding=2 if pad[0] else 1,
            linear=pad[1],
        )
        self._need_kernels()
        self.volume_depth, self.pinhole_size, self.pad = volume_depth, pinhole_size, pad
        self.init_aperture()
        self.init_amplitude(illumination)
        if device is not None:
            self.to(device)

    def init_aperture(self) -> None:
        """Set the pinhole: a disc of ones of radius `pinhole_size` about zero frequency."""
        self.set_aperture(aperture_size=self.pinhole_size)

    def init_amplitude(self, illumination: torch.Tensor | None = None) -> None:
        """Set the amplitude of the illumination on the modulator, ``[m, n]``.

        Parameters
        ----------
        illumination : torch.Tensor, optional
            Amplitude of the illumination ``[m, n]``; by default 1 everywhere.
        """
        if illumination is None:
            illumination = torch.ones(self.resolution)
        illumination = _validate.image("illumination", tensor("illumination", illumination))
        if tuple(illumination.shape) != tuple(self.resolution):
            raise ValueError(f"illumination must be {self.resolution}, got {tuple(illumination.shape)}")
        self.register_buffer("amplitude", illumination.to(self.device), persistent=False)

    def init_distances(self) -> None:
        """Set the distances of the planes: an even division of the volume."""
        self._distances = plane_distances(
            None, self.volume_depth, self.number_of_depth_layers, self.image_location_offset
        )
        self.init_kernels()

    def generate_kernels(self) -> None:
        """Compute the transfer functions of all planes and colours now rather than on first use."""
        self.transfer(slice(None))

    # Older signature: no padding, and another name of the colour.
    def forward(  # type: ignore[override]
        self, input_field: torch.Tensor, wavelength_id: int, depth_id: int
    ) -> torch.Tensor:
        """Return a field propagated to one plane in one colour.

        Parameters
        ----------
        input_field : torch.Tensor
            Complex ``[..., m, n]``.
        wavelength_id, depth_id : int
            Colour and plane.

        Returns
        -------
        torch.Tensor
            Complex ``[..., m, n]``; ``[..., 2m, 2n]`` if padding is not cut off.

        Raises
        ------
        ValueError, TypeError
            If the field does not fit, or there is no such colour or plane.
        """
        field = self._on_grid(input_field)
        colour = index("wavelength_id", wavelength_id, self.number_of_channels)
        plane = index("depth_id", depth_id, self.number_of_depth_layers)
        return self._propagated(field, self.transfer(slice(plane, plane + 1), field.dtype)[0, colour])

    def _propagated(self, field, kernels):
        return convolve(field if self.pad[1] else zero_pad(field, self.padded_shape), kernels)

    def reconstruct(self, hologram_phases: torch.Tensor, laser_powers: torch.Tensor) -> torch.Tensor:
        """Return the intensity of each frame on each plane in each colour; differentiable.

        Parameters
        ----------
        hologram_phases : torch.Tensor
            Phases ``[F, m, n]`` in radians.
        laser_powers : torch.Tensor
            Amplitude of each source in each frame ``[F, C]``.

        Returns
        -------
        torch.Tensor
            Intensities ``[F, D, C, m, n]``.

        Raises
        ------
        ValueError, TypeError
            If phases or powers do not fit.
        """
        if not isinstance(hologram_phases, torch.Tensor) or not hologram_phases.is_floating_point():
            kind = getattr(hologram_phases, "dtype", type(hologram_phases).__name__)
            raise TypeError(f"hologram_phases must be a real tensor, got {kind}")
        if (
            hologram_phases.ndim != 3
            or not len(hologram_phases)
            or tuple(hologram_phases.shape[1:]) != tuple(self.resolution)
        ):
            raise ValueError(
                f"hologram_phases must be [frames, {self.resolution[0]}, {self.resolution[1]}], "
                f"got {tuple(hologram_phases.shape)}"
            )
        laser_powers = floating("laser_powers", laser_powers)
        expected = (len(hologram_phases), self.number_of_channels)
        if tuple(laser_powers.shape) != expected:
            raise ValueError(f"laser_powers must be [frames, colours] = {expected}, got {tuple(laser_powers.shape)}")
        hologram_phases = hologram_phases.to(self.device)
        field = self._on_grid(_array.cast(self.amplitude, hologram_phases) * unit_phasor(hologram_phases))
        light = intensity(self._propagated(field[:, None, None], self.transfer(slice(None), field.dtype)))
        return light * _array.cast(laser_powers, light).square()[:, None, :, None, None]
