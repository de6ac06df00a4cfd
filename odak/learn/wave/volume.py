"""The planes of a volume in front of a modulator, and the light that gets to them."""

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass

import torch

from odak import _array, _validate
from odak.learn._tensors import tensor
from odak.learn.wave.light_path import LightPath, fill, stack, suited_method
from odak.learn.wave.masks import disc
from odak.learn.wave.spectral import convolve
from odak.learn.wave.training import fingerprint
from odak.tools.matrix import zero_pad
from odak.wave.methods import spread
from odak.wave.propagation import sample_counts


class display_volume(torch.nn.Module):
    """Planes and colours that a field on a modulator is propagated to; the ground of every display model.

    Parameters
    ----------
    resolution : sequence of int
        Rows m and columns n of the modulator.
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres.
    pixel_pitch : float
        Pixel pitch in metres.
    distances : torch.Tensor
        Distances of the D planes in metres, see :func:`odak.learn.wave.light_path.plane_distances`.
    propagation_type : str
        A propagation type that has a transfer function, or "auto".
    relay : float, optional
        Distance in metres of a relay that light goes to and comes back from.
    offset : float
        With a relay, the distance that is imaged onto the modulator.
    resolution_factor : int
        Samples s per pixel along each axis, for the impulse-response methods; 1 for the others.
    samples_per_pixel : int
        Samples per pixel that the modulator's model gives.
    aperture_samples : sequence of int
        Points across source and target apertures of the impulse-response methods.
    padding : int
        Factor from the field's size to that of the grid on which light is propagated.
    vaccination : bool
        Add an error to the distances, drawn anew on each call.
    vaccination_scale : float
        Its standard deviation in metres.
    seed : int, optional
        Makes those draws reproducible.
    memory_budget : int, optional
        Bytes above which transfer functions are built anew for each use instead of kept.
    """

    aperture: torch.Tensor
    _transfer: "_Kept | None"
    _kernels: torch.Tensor | None

    def __init__(
        self,
        resolution: Sequence[int],
        wavelengths: Sequence[float],
        pixel_pitch: float,
        distances: torch.Tensor,
        propagation_type: str,
        *,
        relay: float | None = None,
        offset: float = 0.0,
        resolution_factor: int = 1,
        samples_per_pixel: int = 1,
        aperture_samples: Sequence[int] = (20, 20, 5, 5),
        padding: int = 2,
        vaccination: bool = False,
        vaccination_scale: float = 0.0,
        seed: int | None = None,
        memory_budget: int | None = None,
    ):
        super().__init__()
        self.resolution = list(_validate.size("resolution", resolution))
        self.wavelengths = _checked_wavelengths(wavelengths)
        self.number_of_channels = len(self.wavelengths)
        self.pixel_pitch = _validate.real("pixel_pitch", pixel_pitch, positive=True)
        self.number_of_depth_layers = len(distances)
        self.image_location_offset = offset
        self.memory_budget = None if memory_budget is None else _validate.integer("memory_budget", memory_budget)
        self.vaccination = _validate.flag("vaccination", vaccination)
        self.vaccination_scale = _validate.real("vaccination_scale", vaccination_scale)
        self._generator = None
        if seed is not None:
            self._generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
        # No buffer: `.to(dtype)` would round distances that phases of 10⁶ rad hang on.
        self._distances, self._relay = distances, relay
        shape, pitch = tuple(n * samples_per_pixel for n in self.resolution), self.pixel_pitch / samples_per_pixel
        self.propagation_type = suited_method(
            propagation_type,
            shape,
            pitch,
            _validate.numbers(self.wavelengths),
            _validate.numbers(self._net_distances()),
        )
        factor = _validate.integer("resolution_factor", resolution_factor, minimum=1)
        self.resolution_factor = factor if "Impulse Response" in self.propagation_type else 1
        self.aperture_samples = sample_counts(aperture_samples, "aperture_samples")
        self._path = LightPath(pitch, self.propagation_type, relay, self.resolution_factor, self.aperture_samples)
        self.field_shape = tuple(n * self.resolution_factor for n in shape)
        self.padded_shape = tuple(padding * n for n in self.field_shape)
        self.init_kernels()

    def init_kernels(self) -> None:
        """Forget the transfer functions; they are built again when they are needed."""
        self._transfer = self._kernels = None

    def _apply(self, function, recurse: bool = True):
        self.init_kernels()
        return super()._apply(function, recurse)

    @property
    def device(self) -> torch.device:
        """Where the propagator computes."""
        return self.aperture.device

    @property
    def distances(self) -> torch.Tensor:
        """Distances of the planes in metres, float64 ``[D]``."""
        return self._distances.to(self.device)

    def _net_distances(self) -> torch.Tensor:
        return self._distances if self._relay is None else self._distances - self.image_location_offset

    def set_aperture(self, aperture: torch.Tensor | None = None, aperture_size: float | None = None) -> None:
        """Set the mask in the Fourier plane.

        Parameters
        ----------
        aperture : torch.Tensor, optional
            ``[m, n]``, surrounded by zeros, or ``[2ms, 2ns]``; the centre is zero frequency.
        aperture_size : float, optional
            Without a mask: radius of a circular one in samples of the padded spectrum, max(m, n)·s by default.

        Raises
        ------
        ValueError, TypeError
            If the mask does not fit or the radius is not positive.
        """
        padded = self.padded_shape
        device = self.aperture.device if "aperture" in self._buffers else None
        radius = max(padded) / 2 if aperture_size is None else aperture_size
        _validate.real("aperture_size", radius, positive=True)
        aperture = disc(padded, radius) if aperture is None else tensor("aperture", aperture)
        _validate.image("aperture", aperture)
        if any(have > want for have, want in zip(aperture.shape[-2:], padded, strict=True)):
            raise ValueError(f"aperture must fit the padded grid {padded}, got {tuple(aperture.shape)}")
        aperture = zero_pad(aperture, padded).reshape(padded)
        self.register_buffer("aperture", aperture.to(device), persistent=False)
        self.init_kernels()

    @property
    def kernels(self) -> torch.Tensor:
        """Transfer functions without the aperture, complex64 ``[D, C, 2ms, 2ns]``, centred.

        They are kept as those of :meth:`transfer` are.
        """
        if self._kernels is not None:
            return self._kernels
        with nullcontext() if self._is_traced(self._distances) else torch.inference_mode(False):
            kernels = stack(
                self._path, self.padded_shape, self.wavelengths, self._net_distances(), self.device, torch.complex64
            )
            kernels = torch.fft.fftshift(kernels, dim=(-2, -1))
        if self._may_keep(torch.complex64) and not self._is_traced(self._distances):
            self._kernels = kernels
        return kernels

    @property
    def generated_kernels(self) -> torch.Tensor:
        """Whether the transfer function of each plane and colour is at hand, ``[D, C]``."""
        built = [False] * self.number_of_depth_layers if self._transfer is None else self._transfer.built
        return torch.tensor(built, device=self.device)[:, None].repeat(1, self.number_of_channels)

    def get_kernels(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return amplitude and phase of the impulse responses: the centred inverse transforms of :attr:`kernels`."""
        axes = (-2, -1)
        response = torch.fft.fftshift(torch.fft.ifft2(torch.fft.ifftshift(self.kernels, dim=axes)), dim=axes)
        return response.abs(), response.angle()

    def transfer(self, planes: slice, dtype: torch.dtype = torch.complex64) -> torch.Tensor:
        """Return the transfer functions of some planes, the aperture included.

        Parameters
        ----------
        planes : slice
            Which planes.
        dtype : torch.dtype
            complex64 or complex128.

        Returns
        -------
        torch.Tensor
            ``[planes, C, 2ms, 2ns]`` in FFT order: kept from call to call, or built anew where they would take more
            than the memory budget, where the distances are drawn on each call, or where gradients are asked of them.
        """
        checked_slice("planes", planes)
        if dtype not in (torch.complex64, torch.complex128):
            raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype!r:.80}")
        distances = self._net_distances()
        if self.vaccination:
            error = torch.randn(distances.shape, generator=self._generator, dtype=torch.float64)
            distances = distances + self.vaccination_scale * error
        if self._is_traced(distances):
            kernels = stack(self._path, self.padded_shape, self.wavelengths, distances[planes], self.device, dtype)
            return torch.fft.ifftshift(self.aperture) * kernels
        if self.vaccination or not self._may_keep(dtype):
            return self._fill(self._empty(len(distances[planes]), dtype), distances[planes])
        return self._kept(planes, distances, dtype)

    def fingerprint(self) -> str:
        """Return a short text that a display of other lengths, planes, colours or another aperture does not have."""
        lengths = [self.wavelengths, self.pixel_pitch, self.distances, self.image_location_offset, self._relay or 0.0]
        numbers = [number for length in lengths for number in _validate.numbers(length)]
        name = torch.tensor(list(self.propagation_type.encode()))
        return fingerprint(torch.tensor(numbers, dtype=torch.float64), name, self.aperture)

    def _is_traced(self, distances) -> bool:
        return any(_array.is_traced(value) for value in (distances, self.pixel_pitch, *self.wavelengths))

    def _kept(self, planes: slice, distances, dtype) -> torch.Tensor:
        """Return the transfer functions of some planes, those built that were not yet."""
        kept = self._transfer
        if kept is None or kept.kernels.dtype != dtype or kept.aperture is not self.aperture:
            count = self.number_of_depth_layers
            kept = self._transfer = _Kept(self.aperture, self._empty(count, dtype), [False] * count)
        for plane in range(self.number_of_depth_layers)[planes]:
            if not kept.built[plane]:
                # Whole, as another thread may be about the same plane.
                kept.kernels[plane] = self._fill(self._empty(1, dtype), distances[plane : plane + 1])[0]
                kept.built[plane] = True
        return kept.kernels[planes]

    def _may_keep(self, dtype) -> bool:
        samples = self.number_of_depth_layers * self.number_of_channels * self.padded_shape[0] * self.padded_shape[1]
        return self.memory_budget is None or samples * dtype.itemsize <= self.memory_budget

    def _empty(self, planes: int, dtype) -> torch.Tensor:
        rows, columns = self.padded_shape
        with torch.inference_mode(False):
            # Column by column, which is the order that the propagation reads them in.
            return torch.empty((planes, self.number_of_channels, columns, rows), dtype=dtype, device=self.device).mT

    def _fill(self, kernels, distances) -> torch.Tensor:
        with torch.inference_mode(False), torch.no_grad():
            fill(kernels, self._path, *map(_validate.numbers, (self.wavelengths, distances)))
            return kernels.mul_(torch.fft.ifftshift(self.aperture))

    def forward(
        self,
        input_field: torch.Tensor,
        channel_id: int,
        depth_id: int,
        zero_padding_size: Sequence[int] | None = None,
    ) -> torch.Tensor:
        """Return a field propagated to one plane in one colour.

        Parameters
        ----------
        input_field : torch.Tensor
            Complex ``[..., m, n]`` or ``[..., ms, ns]``.
        channel_id, depth_id : int
            Colour and plane.
        zero_padding_size : sequence of int, optional
            Rows and columns to pad to; twice those of the field by default.

        Returns
        -------
        torch.Tensor
            Complex ``[..., ms, ns]``, in the field's precision.

        Raises
        ------
        ValueError, TypeError
            If the field does not fit, or there is no such colour or plane.
        """
        field = self._on_grid(input_field)
        colour = index("channel_id", channel_id, self.number_of_channels)
        plane = index("depth_id", depth_id, self.number_of_depth_layers)
        size = self.padded_shape
        if zero_padding_size is not None:
            size = _validate.size("zero_padding_size", zero_padding_size)
        if size == self.padded_shape:
            return convolve(field, self.transfer(slice(plane, plane + 1), field.dtype)[0, colour])
        if any(pad < n for pad, n in zip(size, self.field_shape, strict=True)):
            raise ValueError(f"zero_padding_size must be at least the field's {self.field_shape}, got {size}")
        kernel = self._path.kernel(
            size, self.wavelengths[colour], self._net_distances()[plane], self.device, field.dtype
        )
        aperture = torch.nn.functional.interpolate(self.aperture[None, None], size)[0, 0]
        return convolve(field, kernel * torch.fft.ifftshift(aperture))

    def propagate(self, field: torch.Tensor, H: torch.Tensor) -> torch.Tensor:
        """Return a field filtered by a transfer function ``[2ms, 2ns]`` (centred) and the aperture."""
        H = _validate.image("H", tensor("H", H))
        if tuple(H.shape[-2:]) != self.padded_shape:
            raise ValueError(f"H must be [..., {self.padded_shape[0]}, {self.padded_shape[1]}], got {tuple(H.shape)}")
        field = self._on_grid(field, "field")
        _validate.one_device(field=field, H=H)
        _validate.fitting(field=field[..., 0, 0], H=H[..., 0, 0])
        return convolve(field, torch.fft.ifftshift((H * self.aperture).to(field.dtype), dim=(-2, -1)))

    def _on_grid(self, field, name: str = "input_field") -> torch.Tensor:
        """Return a complex field on the grid of the fields, zeros between its samples if it has one per pixel."""
        field = _array.to_complex(_validate.image(name, field))
        if field.device != self.device:
            raise ValueError(f"{name} must be on the display's device, {self.device}; got {field.device}")
        shape = tuple(field.shape[-2:])
        if shape == self.field_shape:
            return field
        if tuple(n * self.resolution_factor for n in shape) == self.field_shape:
            return spread(field, self.resolution_factor)
        raise ValueError(f"{name} must be [..., {self.field_shape[0]}, {self.field_shape[1]}], got {shape}")


@dataclass
class _Kept:
    """Transfer functions ``[D, C, 2ms, 2ns]`` with an aperture, and which planes of them are built."""

    aperture: torch.Tensor
    kernels: torch.Tensor
    built: list[bool]


def checked_slice(name: str, value) -> slice:
    """Return a slice after checking that it is one."""
    if not isinstance(value, slice):
        raise TypeError(f"{name} must be a slice, got {value!r:.80}")
    return value


def index(name: str, value: int, count: int) -> int:
    """Return `value` after checking that it counts one of `count` things, from zero."""
    if _validate.integer(name, value) >= count:
        raise ValueError(f"{name} must be from 0 to {count - 1}, got {value}")
    return int(value)


def _checked_wavelengths(wavelengths) -> list:
    listed = list(wavelengths) if _array.is_array(wavelengths) or isinstance(wavelengths, Sequence) else [wavelengths]
    for wavelength in listed:
        _validate.real("wavelengths", wavelength, positive=True)
    if not listed:
        raise ValueError("wavelengths must hold at least one wavelength, got none")
    return [value if _array.is_traced(value) else float(value) for value in listed]
