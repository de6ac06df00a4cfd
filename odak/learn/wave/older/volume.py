"""Transfer functions from a modulator to the planes of a volume, the base class of displays, and one without relay."""

import math
from collections.abc import Iterable, Sequence
from contextlib import nullcontext
from typing import Any

import torch

from odak import _array, _show, _torch_private, _validate
from odak._attributes import Prepared
from odak._warnings import AccuracyWarning, warn
from odak.learn._tensors import checked_device, floating, floating_tensor, tensor
from odak.learn.tools.matrix import circular_binary_mask
from odak.learn.wave.fields import intensity, unit_phasor
from odak.learn.wave.propagation import propagate_beam
from odak.learn.wave.slm import iris_cutoff
from odak.learn.wave.training import fingerprint, generator_from
from odak.tools.matrix import zero_pad
from odak.wave.methods import WITH_TRANSFER_FUNCTION, linear_kernel_of, linear_method, method_named, spread
from odak.wave.propagation import sample_counts
from odak.wave.torch_convolution import convolve
from odak.wave.transfer_functions import Request, aperture_points, checked_pitch, divided_pitch, pitches

PROPAGATOR_TYPES = ("forward", "back and forth")


def plane_distances(
    distances: torch.Tensor | Sequence[float] | None, volume_depth: float, count: int, offset: float
) -> torch.Tensor:
    """Return the given distances, or the distances of `count` planes that divide a volume evenly about its centre.

    Parameters
    ----------
    distances : torch.Tensor or sequence of float, optional
        Distances in metres.
    volume_depth : float
        Distance from the first plane to the last.
    count : int
        Number of planes.
    offset : float
        Distance of the volume's centre, where a single plane lies.

    Returns
    -------
    torch.Tensor
        float64 ``[planes]``.
    """
    count = _validate.integer("number_of_depth_layers", count, minimum=1)
    if distances is not None:
        given = tensor("distances", distances, torch.float64).reshape(-1)
        _validate.real("distances", given)
        if not len(given):
            raise ValueError("distances must contain at least one distance, got none")
        return given
    _validate.real("volume_depth", volume_depth)
    _validate.real("image_location_offset", offset)
    half = volume_depth / 2 if count > 1 else 0.0
    return torch.linspace(-half, half, count, dtype=torch.float64) + offset


class display_volume(Prepared, torch.nn.Module):
    """Propagation of a field on a modulator to the planes of a volume in several colours; base of all displays.

    Parameters
    ----------
    resolution : sequence of int
        Rows m and columns n of the modulator.
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres.
    pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    distances : torch.Tensor
        Distances of the D planes in metres, see :func:`odak.learn.wave.older.volume.plane_distances`.
    propagation_type : str
        A propagation type, see :func:`odak.learn.wave.propagate_beam`, or "auto"; not "custom".
    relay : float, optional
        Distance in metres of a relay, to which light propagates and back. What both ways have in common cancels, so
        that only the net distance is left.
    offset : float
        With a relay, the distance that is imaged onto the modulator, in metres.
    resolution_factor : int
        Samples s per pixel along each axis, for the impulse-response methods; 1 for the others.
    samples_per_pixel : int
        Samples per pixel that the modulator's model gives.
    aperture_samples : sequence of int
        Points across source and target apertures of the impulse-response methods. Averages over the source are over
        square pixels without gaps, up to the edge of the band. Averages over the target are of the field, not of the
        intensity that a camera sees: an AccuracyWarning says how much of the light they lose.
    padding : int
        Factor from the size of the field to the size of the grid on which it is propagated.
    linear : bool
        With a padding of two, use transfer functions of linear convolution, so that nothing wraps around.
    pixel_fill : float, optional
        Share of a square pixel's area that emits, whose spectrum multiplies the transfer functions; fields are point
        samples by default.

    Attributes
    ----------
    vaccination : bool
        Whether an error is added to the distances, drawn anew on each call.
    vaccination_scale : float
        Its standard deviation in metres.
    memory_budget : int, optional
        Bytes above which transfer functions are built anew for each use instead of kept.
    """

    _fixed: tuple[str, ...] = (
        *("resolution", "wavelengths", "number_of_channels", "pixel_pitch", "propagation_type", "resolution_factor"),
        *("aperture_samples", "field_shape", "padded_shape"),
    )
    _follow = dict.fromkeys(("volume_depth", "number_of_depth_layers", "image_location_offset"), "init_distances")
    vaccination: bool = False
    vaccination_scale: float = 0.0
    memory_budget: int | None = None
    volume_depth: float
    aperture: torch.Tensor
    _generator: torch.Generator | None = None
    # Transfer functions ``[D, C, 2ms, 2ns]`` with the stop, and which planes of them are built.
    _transfer: tuple[torch.Tensor, list[bool]] | None
    _kernels: torch.Tensor | None

    def __init__(
        self,
        resolution: Sequence[int],
        wavelengths: Sequence[float],
        pixel_pitch: float | Sequence[float],
        distances: torch.Tensor,
        propagation_type: str,
        *,
        relay: float | None = None,
        offset: float = 0.0,
        resolution_factor: int = 1,
        samples_per_pixel: int = 1,
        aperture_samples: Sequence[int] = (20, 20, 5, 5),
        padding: int = 2,
        linear: bool = True,
        pixel_fill: float | None = None,
    ):
        super().__init__()
        self.resolution: list[int] = list(_validate.size("resolution", resolution))
        self.wavelengths: list[float | torch.Tensor] = _checked_wavelengths(wavelengths)
        self.number_of_channels: int = len(self.wavelengths)
        self.pixel_pitch: float = checked_pitch("pixel_pitch", pixel_pitch)
        self.number_of_depth_layers: int = len(distances)
        self.image_location_offset = offset
        # No buffer: `.to(dtype)` would round distances that phases of 10⁶ rad depend on.
        self._distances, self._relay = distances, relay
        shape = tuple(n * samples_per_pixel for n in self.resolution)
        pitch = divided_pitch(self.pixel_pitch, samples_per_pixel)
        lengths = _validate.numbers(self.wavelengths), _validate.numbers(self._net_distances())
        self.propagation_type: str = linear_method(propagation_type, shape, pitch, *lengths)
        factor = _validate.integer("resolution_factor", resolution_factor, minimum=1)
        self.resolution_factor: int = factor if method_named(self.propagation_type).scalable else 1
        self.aperture_samples: tuple[int, int, int, int] = sample_counts(aperture_samples, "aperture_samples")
        if method_named(self.propagation_type).scalable:
            _warn_of_averaged_fields(self.propagation_type, self.aperture_samples, self.resolution_factor)
        # Of the samples on the modulator, a pair where rows and columns differ.
        self._pitch = pitch
        # Transfer functions of linear convolution, of pixels of some size, see :mod:`odak.wave.linear_kernels`.
        self._linear, self._pixel_fill = linear and padding == 2, pixel_fill
        self.field_shape: tuple[int, ...] = tuple(n * self.resolution_factor for n in shape)
        self.padded_shape: tuple[int, ...] = tuple(padding * n for n in self.field_shape)
        self._has_kernels = self.propagation_type in WITH_TRANSFER_FUNCTION
        self.init_kernels()

    def init_kernels(self) -> None:
        """Drop the transfer functions; they are built again when they are needed."""
        self._transfer = self._kernels = None

    def init_distances(self, distances: torch.Tensor | Sequence[float] | None = None) -> None:
        """Set the distances of the planes: those given, or an even division of the volume."""
        self._distances = plane_distances(
            distances, self.volume_depth, self.number_of_depth_layers, self.image_location_offset
        )
        vars(self)["number_of_depth_layers"] = len(self._distances)
        self.init_kernels()

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "distances":
            self.init_distances(value)
            return
        super().__setattr__(name, value)
        if name == "aperture":
            # A mask in place of the stop that was set.
            self._stop = self._stop_in_words = "mask"
            self._cutoffs = [None] * self.number_of_channels
            self.init_kernels()

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

    @property
    def stop(self) -> str:
        """The stop in the Fourier plane in words, see :meth:`set_aperture`."""
        return self._stop_in_words

    def extra_repr(self) -> str:
        """Return what the description of the object has between its brackets."""
        return _show.numbers_of(self, stop=self.stop)

    def generator(self) -> torch.Generator | None:
        """Return what the errors of the distances are drawn from; None where there are no errors."""
        if self.vaccination and self._generator is None:
            self._generator = generator_from(None)
        return self._generator if self.vaccination else None

    def _net_distances(self) -> torch.Tensor:
        return self._distances if self._relay is None else self._distances - self.image_location_offset

    def set_aperture(
        self,
        aperture: torch.Tensor | str | None = None,
        aperture_size: float | None = None,
        *,
        iris_radius: float | None = None,
        iris_focal_length: float | None = None,
    ) -> None:
        """Set the stop in the Fourier plane; without arguments it is the round one of earlier releases.

        Parameters
        ----------
        aperture : torch.Tensor or str, optional
            Mask ``[m, n]``, surrounded by zeros, or ``[2ms, 2ns]``; the centre is zero frequency. It multiplies the
            sampled transfer functions. "open" is no stop.
        aperture_size : float, optional
            Without a mask: radius of a round stop in samples of the padded spectrum, the same along both axes, by
            :func:`odak.learn.tools.circular_binary_mask`; by default the longer side of a field, which leaves out the
            corners of the spectrum. Methods that keep no transfer functions are open by default.
        iris_radius : float, optional
            Radius in metres of an iris in the focal plane of a lens. Its cut-off is iris_radius/(λ·iris_focal_length).
        iris_focal_length : float, optional
            Focal length of that lens in metres.

        Raises
        ------
        ValueError, TypeError
            If the mask does not fit, a length is not positive, or an iris is given beside another stop.
        """
        (aperture_size,) = _validate.constants(aperture_size=aperture_size)
        padded = self.padded_shape
        cutoffs = [iris_cutoff(w, iris_radius, iris_focal_length) for w in _validate.numbers(self.wavelengths)]
        if iris_radius is not None and not (aperture is None and aperture_size is None):
            raise ValueError("iris_radius excludes aperture and aperture_size, got more than one of them")
        if aperture_size is not None:
            _validate.real("aperture_size", aperture_size, positive=True)
        if isinstance(aperture, str):
            if _validate.one_of("aperture", aperture, ("open",)) and aperture_size is not None:
                raise ValueError(f"aperture='open' excludes aperture_size, got {aperture_size}")
            self._put_stop("open", "open", torch.ones(padded))
        elif aperture is not None:
            aperture = _validate.image("aperture", tensor("aperture", aperture))
            if any(have > want for have, want in zip(aperture.shape[-2:], padded, strict=True)):
                raise ValueError(f"aperture must fit the padded grid {padded}, got {tuple(aperture.shape)}")
            self._put_stop("mask", "mask", zero_pad(aperture, padded).reshape(padded))
        elif aperture_size is not None:
            self._put_disc(aperture_size)
        elif iris_radius is not None and iris_focal_length is not None:
            self._put_round(f"iris, radius {iris_radius:g} m at {iris_focal_length:g} m", cutoffs)
        else:
            self._put_released()

    def _put_stop(self, kind: str, words: str, aperture, cutoffs=None) -> None:
        device = self.aperture.device if "aperture" in self._buffers else None
        self._stop, self._stop_in_words = kind, words
        self._cutoffs = [None] * self.number_of_channels if cutoffs is None else cutoffs
        self.register_buffer("aperture", aperture.to(device), persistent=False)
        self.init_kernels()

    def _put_disc(self, radius: float) -> None:
        rows, columns = self.padded_shape
        mask = circular_binary_mask(rows, columns, radius)[0, 0]
        self._put_stop("mask", f"round, radius {radius:g} samples", mask)

    def _put_round(self, words: str, cutoffs: list) -> None:
        pitch = divided_pitch(self._pitch, self.resolution_factor)
        masks = [torch.fft.fftshift(disc_of_frequencies(self.padded_shape, pitch, cutoff)) for cutoff in cutoffs]
        alike = len(set(cutoffs)) == 1
        self._put_stop("round", words, masks[0] if alike else torch.stack(masks), cutoffs)

    def _put_released(self) -> None:
        """Put the stop that earlier releases had where none was given."""
        if self._has_kernels:
            self._put_disc(max(self.field_shape))
        else:
            self.set_aperture("open")

    @property
    def kernels(self) -> torch.Tensor:
        """Transfer functions without the aperture, complex64 ``[D, C, 2ms, 2ns]``, centred.

        They are kept between calls, as :meth:`transfer` keeps its own.
        """
        if self._kernels is not None:
            return self._kernels
        self._need_kernels()
        with nullcontext() if self._is_traced(self._distances) else _torch_private.keeping():
            kernels = self._stacked(self._net_distances(), torch.complex64, stopped=False)
            kernels = torch.fft.fftshift(kernels, dim=(-2, -1))
        if self._may_keep(torch.complex64) and not self._is_traced(self._distances):
            self._kernels = kernels
        return kernels

    @property
    def generated_kernels(self) -> torch.Tensor:
        """Whether the transfer function of each plane and colour has been built, ``[D, C]``."""
        built = [False] * self.number_of_depth_layers if self._transfer is None else self._transfer[1]
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
        _validate.instance("planes", planes, slice, "a slice")
        self._need_kernels()
        if dtype not in (torch.complex64, torch.complex128):
            raise TypeError(f"dtype must be torch.complex64 or torch.complex128, got {dtype!r:.80}")
        distances = self._drawn_distances()
        if self._is_traced(distances):
            return self._stacked(distances[planes], dtype)
        if self.vaccination or not self._may_keep(dtype):
            return self._fill(self._empty(len(distances[planes]), dtype), distances[planes])
        if self._transfer is None or self._transfer[0].dtype != dtype:
            self._transfer = self._empty(len(distances), dtype), [False] * len(distances)
        kernels, built = self._transfer
        for plane in range(len(distances))[planes]:
            if not built[plane]:
                self._fill(kernels[plane : plane + 1], distances[plane : plane + 1])
                built[plane] = True
        return kernels[planes]

    def _stacked(self, distances, dtype, *, stopped: bool = True) -> torch.Tensor:
        """Return transfer functions ``[planes, C, 2ms, 2ns]`` that are differentiable in distances and wavelengths."""
        colours = range(self.number_of_channels)
        planes = [[self._kernel(c, distance, dtype, stopped=stopped) for c in colours] for distance in distances]
        return torch.stack([torch.stack(plane) for plane in planes])

    def _kernel(self, colour: int, distance, dtype, size: Any = None, *, stopped: bool = True):
        """Return the transfer function of one plane and colour with its stop, in FFT order.

        It is sampled on the padded grid, or on one of another size, of which the window of linear kernels is not half.
        Over a relay it is never sampled as an impulse response, which net distances of millimetres do not allow; linear
        kernels never are.
        """
        shape: Any = self.padded_shape if size is None else size
        linear = self._linear and size is None
        cutoff = self._cutoffs[colour] if stopped else None
        name, pitch, scale = self.propagation_type, self._pitch, self.resolution_factor
        averaged = method_named(name).scalable and (linear or self._relay is not None)
        if averaged:
            name, pitch, scale = "Transfer Function Fresnel", divided_pitch(pitch, scale), 1
        request = Request(pitch, self.wavelengths[colour], distance, scale=scale, samples=self.aperture_samples)
        grid = request.grid(shape, _array.namespace(torch.empty(0)), self.device, dtype)
        if linear:
            # How its integral is summed follows from the lengths as numbers.
            kernel = _array.outside_graphs(_linear_kernel, name, cutoff, self._pixel_fill, grid)
        else:
            kernel = method_named(name).kernel(grid)  # type: ignore[misc]
            if cutoff is not None:
                kernel = kernel * disc_of_frequencies(shape, divided_pitch(pitch, scale), cutoff).to(self.device)
        if averaged:
            kernel = kernel * self._averaging(grid)
        if not stopped or self._stop != "mask":
            return kernel
        mask = self.aperture
        if size is not None:
            mask = torch.nn.functional.interpolate(mask[None, None], size)[0, 0]
        return kernel * torch.fft.ifftshift(mask)

    def _averaging(self, grid) -> torch.Tensor:
        """Return the spectrum of the averages over source and target apertures, for scale² samples per pixel."""
        factors, scale = [], self.resolution_factor
        for axis, n in enumerate(grid.shape):
            frequency = torch.fft.fftfreq(n, 1 / n, dtype=torch.float64, device=grid.device) / (
                n * grid.pitch[axis]
            ).reshape(())
            factor = torch.full_like(frequency, scale)
            pitch = pitches(self._pitch)[axis]
            for count, extent in zip(self.aperture_samples[axis::2], (pitch, pitch / scale), strict=True):
                points: Any = aperture_points(grid, count) * extent
                factor = factor * torch.cos(2 * torch.pi * points[:, None] * frequency).mean(0)
            factors.append(factor)
        return (factors[0][:, None] * factors[1]).to(grid.dtype)

    def _need_kernels(self):
        if not self._has_kernels:
            raise ValueError(f"propagation_type {self.propagation_type!r} has no transfer function to return")

    def _drawn_distances(self):
        distances = self._net_distances()
        if self.vaccination:
            error = torch.randn(distances.shape, generator=self.generator(), dtype=torch.float64)
            distances = distances + self.vaccination_scale * error.to(distances.device)
        return distances

    def _propagated_without_kernels(self, field, planes: slice, wavelengths):
        """Return ``field [..., 1, C, m, n]`` propagated to some planes by a method that has no transfer function."""
        result = propagate_beam(
            field,
            None,
            self._drawn_distances()[planes][:, None],
            self._pitch,
            wavelengths,
            self.propagation_type,
            aperture=1.0 if self._stop == "open" else self.aperture,
        )
        return _array.to_complex(result)

    def fingerprint(self) -> str:
        """Return a short text that a display of other lengths, planes, colours or another aperture does not have."""
        lengths = [self.wavelengths, self.pixel_pitch, self.distances, self.image_location_offset, self._relay or 0.0]
        lengths += [cutoff for cutoff in self._cutoffs if cutoff is not None]
        lengths += [] if self._pixel_fill is None else [self._pixel_fill]
        numbers = [number for length in lengths for number in _validate.numbers(length)]
        name = torch.tensor(list(self.propagation_type.encode()))
        return fingerprint(torch.tensor(numbers, dtype=torch.float64), name, self.aperture)

    def _is_traced(self, distances) -> bool:
        return any(_array.is_traced(value) for value in (distances, *pitches(self.pixel_pitch), *self.wavelengths))

    def _may_keep(self, dtype) -> bool:
        samples = self.number_of_depth_layers * self.number_of_channels * self.padded_shape[0] * self.padded_shape[1]
        return self.memory_budget is None or samples * dtype.itemsize <= self.memory_budget

    def _empty(self, planes: int, dtype) -> torch.Tensor:
        rows, columns = self.padded_shape
        with _torch_private.keeping():
            # Column by column, which is the order that the propagation reads them in.
            return torch.empty((planes, self.number_of_channels, columns, rows), dtype=dtype, device=self.device).mT

    def _fill(self, kernels, distances) -> torch.Tensor:
        with _torch_private.keeping(), torch.no_grad():
            for kernel, distance in zip(kernels, _validate.numbers(distances), strict=True):
                # Complete, for another thread may build the same plane.
                kernel.copy_(self._stacked([distance], kernels.dtype)[0])
        return kernels

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
            Rows and columns to pad to; twice the size of the field by default.

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
        colour = _validate.integer("channel_id", channel_id, most=self.number_of_channels - 1)
        plane = _validate.integer("depth_id", depth_id, most=self.number_of_depth_layers - 1)
        if not self._has_kernels:
            planes = slice(plane, plane + 1)
            field = field[..., None, None, :, :]
            return self._propagated_without_kernels(field, planes, self.wavelengths[colour])[..., 0, 0, :, :]
        size = self.padded_shape
        if zero_padding_size is not None:
            size = _validate.size("zero_padding_size", zero_padding_size)
        if size == self.padded_shape:
            return convolve(field, self.transfer(slice(plane, plane + 1), field.dtype)[0, colour])
        if any(pad < n for pad, n in zip(size, self.field_shape, strict=True)):
            raise ValueError(f"zero_padding_size must be at least the field's {self.field_shape}, got {size}")
        kernel = self._kernel(colour, self._net_distances()[plane], field.dtype, size)
        return convolve(field, kernel)

    def propagate(self, field: torch.Tensor, H: torch.Tensor) -> torch.Tensor:
        """Return a field filtered by a transfer function ``[2ms, 2ns]`` (centred) and the aperture."""
        H = _validate.image("H", tensor("H", H))
        _validate.shaped("H", H, f"[..., {self.padded_shape[0]}, {self.padded_shape[1]}]")
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


def _linear_kernel(name: str, cutoff: float | None, pixel_fill: float | None, grid) -> torch.Tensor:
    return linear_kernel_of(name, cutoff, pixel_fill)(grid)


def _warn_of_averaged_fields(name: str, samples: tuple[int, int, int, int], scale: int) -> None:
    """Issue an AccuracyWarning where a display averages fields over each sample of the image, as no camera does."""
    # At half a cycle per pixel, the edge of the band.
    edge = 1.0
    for count in samples[2:]:
        edge *= sum(math.cos(math.pi * ((k + 0.5) / count - 0.5) / scale) for k in range(count)) / count
    if edge < 0.99:
        warn(
            f"{name} averages the field, not its intensity, over each sample of the image: waves at the edge of the "
            f"band have {edge:.0%} of their amplitude, and the image has less speckle than a camera sees. "
            f"aperture_samples=({samples[0]}, {samples[1]}, 1, 1) gives the light at the middle of each sample",
            AccuracyWarning,
        )


def _checked_wavelengths(wavelengths) -> list[float | torch.Tensor]:
    listed = list(wavelengths) if _array.is_array(wavelengths) or isinstance(wavelengths, Sequence) else [wavelengths]
    for wavelength in listed:
        _validate.real("wavelengths", wavelength, positive=True)
    if not listed:
        raise ValueError("wavelengths must contain at least one wavelength, got none")
    return [value if _array.is_traced(value) else float(value) for value in listed]


def disc_of_frequencies(shape: Sequence[int], pitch: Any, cutoff: float) -> torch.Tensor:
    """Return ones at frequencies up to a cut-off in cycles per metre, float32 ``[rows, columns]`` in FFT order."""
    rows, columns = (
        torch.fft.fftfreq(n, step, dtype=torch.float64) for n, step in zip(shape, pitches(pitch), strict=True)
    )
    return (rows[:, None] ** 2 + columns**2 <= cutoff**2).float()


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
    odak.learn.wave.Display : The successor, which shows means over the areas of pixels.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import holographic_display
    >>> display = holographic_display([515e-9], resolution=[16, 24], number_of_depth_layers=2)
    >>> display.reconstruct(torch.zeros(1, 16, 24), torch.ones(1, 1)).shape
    torch.Size([1, 2, 1, 16, 24])
    """

    _fixed = (*display_volume._fixed, "pad")
    _follow = display_volume._follow | {"pinhole_size": "init_aperture"}

    @_validate.takes_units("wavelengths", "pixel_pitch", "volume_depth", "image_location_offset")
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
        if isinstance(pad, str) or not isinstance(pad, Iterable) or len(pad := list(pad)) != 2:
            raise ValueError(f"pad must be two booleans, got {pad!r}")
        pad, device = [_validate.flag("pad", flag) for flag in pad], checked_device("device", device)
        _validate.real("pinhole_size", pinhole_size, positive=True)
        super().__init__(
            resolution,
            wavelengths,
            pixel_pitch,
            plane_distances(None, volume_depth, number_of_depth_layers, image_location_offset),
            propagation_type,
            offset=image_location_offset,
            padding=2 if pad[0] else 1,
            linear=pad[1],
        )
        self._need_kernels()
        self.volume_depth: float = volume_depth
        self.pinhole_size: float = pinhole_size
        self.pad: list[bool] = pad
        self.init_aperture()
        self.init_amplitude(illumination)
        if device is not None:
            self.to(device)

    def init_aperture(self) -> None:
        """Set the pinhole: a disc of ones of radius `pinhole_size` about zero frequency."""
        self.set_aperture()

    def _put_released(self) -> None:
        pitch, longer = pitches(self._pitch), self.padded_shape.index(max(self.padded_shape))
        cutoff = self.pinhole_size / (self.padded_shape[longer] * pitch[longer])
        words = f"round, radius {self.pinhole_size:g} samples of the longer axis"
        self._put_round(words, [float(cutoff)] * self.number_of_channels)

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
        _validate.shaped("illumination", illumination, f"{self.resolution}")
        self.register_buffer("amplitude", illumination.to(self.device), persistent=False)

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
        colour = _validate.integer("wavelength_id", wavelength_id, most=self.number_of_channels - 1)
        plane = _validate.integer("depth_id", depth_id, most=self.number_of_depth_layers - 1)
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
        floating_tensor("hologram_phases", hologram_phases, "a real tensor")
        _validate.shaped(
            "hologram_phases",
            hologram_phases,
            f"[1 or more, {self.resolution[0]}, {self.resolution[1]}], frames of the resolution",
        )
        laser_powers = floating("laser_powers", laser_powers)
        _validate.shaped(
            "laser_powers", laser_powers, f"[{len(hologram_phases)}, {self.number_of_channels}], frames and colours"
        )
        hologram_phases = hologram_phases.to(self.device)
        field = self._on_grid(_array.cast(self.amplitude, hologram_phases) * unit_phasor(hologram_phases))
        light = intensity(self._propagated(field[:, None, None], self.transfer(slice(None), field.dtype)))
        return light * _array.cast(laser_powers, light).square()[:, None, :, None, None]
