"""Propagation from a phase-only modulator, in frames and colours, to the planes of a volume."""

from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import torch

from odak import _array, _torch_private, _validate
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import ValuesRead, checked_device, complex_tensor, floating, real_tensor, tensor
from odak.learn.wave.fields import exposure, intensity, unit_phasor
from odak.learn.wave.older.volume import PROPAGATOR_TYPES, display_volume, plane_distances
from odak.learn.wave.slm import checked_fill
from odak.learn.wave.training import generator_from
from odak.wave.methods import method_named
from odak.wave.torch_convolution import Workspace, convolve

METHODS = ("conventional", "multi-color", "full complex conventional", "full complex multi-color")


def power_method(method: str) -> str:
    """Return the full name of what channel powers mean, given with spaces, underscores or hyphens."""
    words = {known.replace("-", " "): known for known in METHODS}
    found = words.get(_validate.text("method", method).replace("_", " ").replace("-", " ").lower())
    return found or _validate.one_of("method", method, METHODS)


def is_diagonal(power: torch.Tensor) -> bool:
    """Return whether frame f is lit by source f alone, powers being ``[frames, wavelengths]``."""
    return bool((power == torch.zeros_like(power).diagonal_scatter(power.diagonal())).all())


def checked_phases(phases: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
    """Return the phases of all frames after checking them.

    Parameters
    ----------
    phases : torch.Tensor
        What came: ``[F, m, n]``, ``[1, F, m, n]``, or ``[m, n]`` for a single frame.
    shape : tuple of int
        Frames F, rows m and columns n.

    Returns
    -------
    torch.Tensor
        Real floating ``[F, m, n]``.

    Raises
    ------
    ValueError, TypeError
        If they are not real, or of another shape.
    """
    real_tensor("hologram_phases", phases)
    came = tuple(phases.shape)
    if came not in (shape, (1, *shape)) and not (shape[0] == 1 and came == shape[1:]):
        raise ValueError(f"hologram_phases must be [frames, rows, columns] = {shape}, got {came}")
    return (phases if phases.is_floating_point() else phases.float()).reshape(shape)


def checked_amplitude(amplitude: torch.Tensor, colours: int) -> torch.Tensor:
    """Return the amplitude of the light on a modulator, ``[m, n]`` or ``[C, m, n]``, after checking its axes."""
    amplitude = _validate.image("amplitude", tensor("amplitude", amplitude))
    came = tuple(amplitude.shape)
    if len(came) > 2 and came[-3] not in (1, colours):
        raise ValueError(f"amplitude must have {colours} colours, got {came}")
    if len(came) > 5 or any(n != 1 for n in came[-4:-3]):
        raise ValueError(f"amplitude must be [rows, columns] or [colours, rows, columns], got {came}")
    return amplitude


_RELEASED_STOP = (
    "propagator has the round stop of earlier releases in the Fourier plane, circular_binary_mask(2m·s, 2n·s, "
    'max(m, n)·s), as no other is given: aperture="open" is a display without a stop, aperture_size or iris_radius one '
    "with another"
)
# A complex64 field, the transforms of its rows, its intensity, and the slopes of field and intensity.
_BYTES_PER_SAMPLE = 40


class propagator(display_volume):
    """Light of a phase-only modulator on the planes of a volume: frames × planes × colours in one call.

    Parameters
    ----------
    resolution : sequence of int
        Rows m and columns n of the modulator.
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres.
    pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    resolution_factor : int
        Samples s per pixel along each axis, for the impulse-response methods; 1 for the others.
    number_of_frames : int
        Frames F shown one after another.
    number_of_depth_layers : int
        Planes D.
    volume_depth : float
        Distance from the first plane to the last in metres.
    image_location_offset : float
        Distance of the volume's centre, where a single plane lies, in metres.
    propagation_type : str
        A propagation type, see :func:`odak.learn.wave.propagate_beam`, or "auto"; not "custom". Light
        is propagated without wrap-around, where all exact methods are the same, and so are those after Fresnel. The
        Fraunhofer methods and "Incoherent Angular Spectrum" keep no kernels. With "Incoherent Angular Spectrum" the
        intensity of the modulator is what spreads, and the fields returned are its roots.
    propagator_type : str
        "forward", or "back and forth": to a relay and back, so that a plane is distance − `image_location_offset` away.
        Only the net distance matters: the relay limits nothing.
    back_and_forth_distance : float
        Distance of the relay in metres.
    laser_channel_power : torch.Tensor, optional
        ``[F, C]``, see :meth:`get_laser_powers`; one source per frame by default; frames beyond the sources are dark.
    aperture : torch.Tensor or str, optional
        Mask ``[m, n]`` (padded by zeros) or ``[2ms, 2ns]`` in the Fourier plane, or "open" for none, see
        :meth:`set_aperture`. Without any stop given it is that of earlier releases: round, its radius the longer side
        of the field in samples of the padded spectrum, ``circular_binary_mask(2ms, 2ns, max(m, n)·s)``, and an
        ArgumentWarning says so once in a process.
    aperture_size : float, optional
        Radius of a round stop in the Fourier plane, in samples of the padded spectrum along both axes.
    distances : torch.Tensor or sequence of float, optional
        Distances of the planes in metres, instead of the even division of the volume. Differentiable.
    aperture_samples : sequence of int
        Points across source and target apertures of the impulse-response methods. Averages over the source describe
        square pixels without gaps, up to the edge of the band. Averages over the target are of the field, not of the
        intensity that a camera sees: an AccuracyWarning says how much of the light they lose.
    method : str
        What the channel powers mean: "conventional" or "multi-color", "full complex" before it or not.
    device : torch.device, optional
        Where to compute.
    vaccination_scale : float
        Standard deviation in metres of the error added to the distances.
    vaccination : bool
        Draw that error anew on each call, so that a hologram optimised through it bears misplacement.
    slm : torch.nn.Module, optional
        ``slm(phase, scale)`` returns the field of a phase pattern, such as
        :class:`odak.learn.wave.spatial_light_modulator`; an ideal modulator by default.
    memory_budget : int, optional
        Bytes that the fields in work may take. With it planes and frames are streamed in chunks, and kernels that
        would take more than it are built anew for each chunk instead of kept.
    seed : int, optional
        Makes the draws of `vaccination` reproducible.
    iris_radius : float, optional
        Radius in metres of a round iris in the Fourier plane, see :meth:`set_aperture`.
    iris_focal_length : float, optional
        Focal length in metres of the lens in front of the iris.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits. Fields then have the spectrum of pixels of that size up to
        1/(2·pixel_pitch); an iris has to keep the orders beyond it away. Without it pixels are points, unless `slm` has
        a fill factor.

    Attributes
    ----------
    distances : torch.Tensor
        float64 ``[D]``.
    wavelengths : list of float
        C of them.
    channel_power : torch.Tensor
        ``[F, C]``.
    phase_scale : torch.Tensor
        ``[C]``: the phase shown at colour c is phase_scale[c] times the pattern's.
    aperture : torch.Tensor
        ``[2ms, 2ns]``, centred.
    kernels : torch.Tensor
        Transfer functions without the aperture, complex64 ``[D, C, 2ms, 2ns]``, centred.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.Display : The successor, which shows means over the areas of pixels; with a relay, a mask, another
        method or learned distances by :class:`odak.learn.wave.Free`.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import propagator
    >>> colours = [639e-9, 515e-9, 473e-9]
    >>> display = propagator([16, 24], colours, number_of_frames=3, number_of_depth_layers=2, aperture="open")
    >>> display.reconstruct(torch.zeros(3, 16, 24)).shape
    torch.Size([3, 2, 3, 16, 24])
    """

    _fixed = (*display_volume._fixed, "propagator_type", "zero_mode_distance", "number_of_frames", "slm")
    phase_scale: torch.Tensor
    channel_power: torch.Tensor

    @_validate.takes_units(
        "wavelengths",
        "pixel_pitch",
        "volume_depth",
        "image_location_offset",
        "back_and_forth_distance",
        "distances",
        "vaccination_scale",
        "iris_radius",
        "iris_focal_length",
    )
    def __init__(
        self,
        resolution: Sequence[int] = (1920, 1080),
        wavelengths: Sequence[float] = (515e-9,),
        pixel_pitch: float | Sequence[float] = 8e-6,
        resolution_factor: int = 1,
        number_of_frames: int = 1,
        number_of_depth_layers: int = 1,
        volume_depth: float = 1e-2,
        image_location_offset: float = 5e-3,
        propagation_type: str = "Bandlimited Angular Spectrum",
        propagator_type: str = "back and forth",
        back_and_forth_distance: float = 0.3,
        laser_channel_power: torch.Tensor | None = None,
        aperture: torch.Tensor | str | None = None,
        aperture_size: float | None = None,
        distances: torch.Tensor | Sequence[float] | None = None,
        aperture_samples: Sequence[int] = (20, 20, 5, 5),
        method: str = "conventional",
        device: torch.device | None = None,
        vaccination_scale: float = 1e-4,
        vaccination: bool = False,
        *,
        slm: torch.nn.Module | None = None,
        memory_budget: int | None = None,
        seed: int | None = None,
        iris_radius: float | None = None,
        iris_focal_length: float | None = None,
        pixel_fill: float | None = None,
    ):
        kind = _validate.one_of("propagator_type", propagator_type, PROPAGATOR_TYPES)
        for name, length in (
            *(("back_and_forth_distance", back_and_forth_distance), ("volume_depth", volume_depth)),
            ("image_location_offset", image_location_offset),
        ):
            _validate.real(name, length)
        device = checked_device("device", device)
        _validate.function_or_none("slm", slm)
        if getattr(slm, "time_samples", 1) != 1:
            raise ValueError(f"slm must show one field for each frame here, got {slm.time_samples} instants per frame")  # type: ignore[union-attr]
        samples_per_pixel = int(getattr(slm, "samples_per_pixel", 1))
        if pixel_fill is not None and samples_per_pixel > 1:
            raise ValueError(f"pixel_fill must be None for an slm of {samples_per_pixel} samples per pixel")
        has_stop = not (aperture is None and aperture_size is None and iris_radius is None)
        pixel_fill = checked_fill(pixel_fill, slm, has_stop and not isinstance(aperture, str))
        super().__init__(
            resolution,
            wavelengths,
            pixel_pitch,
            plane_distances(distances, volume_depth, number_of_depth_layers, image_location_offset),
            propagation_type,
            relay=back_and_forth_distance if kind == "back and forth" else None,
            offset=image_location_offset,
            resolution_factor=resolution_factor,
            samples_per_pixel=samples_per_pixel,
            pixel_fill=pixel_fill,
            aperture_samples=aperture_samples,
        )
        self.memory_budget = None if memory_budget is None else _validate.integer("memory_budget", memory_budget)
        self.vaccination: bool = _validate.flag("vaccination", vaccination)
        self.vaccination_scale: float = _validate.real("vaccination_scale", vaccination_scale)
        self._generator = None if seed is None else generator_from(seed)
        self.propagator_type: str = kind
        self.zero_mode_distance: float = back_and_forth_distance
        self.volume_depth = volume_depth
        self.number_of_frames: int = _validate.integer("number_of_frames", number_of_frames, minimum=1)
        self.method: str = power_method(method)
        self.slm: torch.nn.Module | None = slm
        if not has_stop and self._has_kernels:
            warn(_RELEASED_STOP, ArgumentWarning, once=True)
        self.set_aperture(aperture, aperture_size, iris_radius=iris_radius, iris_focal_length=iris_focal_length)
        self.init_phase_scale()
        self._hold_powers(laser_channel_power, "laser_channel_power")
        if device is not None:
            self.to(device)

    def init_phase_scale(self) -> None:
        """Set the phase scale of every colour to one."""
        self.register_buffer("phase_scale", torch.ones(self.number_of_channels, device=self.device))

    def init_channel_power(self, channel_power: torch.Tensor | None = None) -> None:
        """Set the powers of the channels in each frame, ``[F, C]``.

        Parameters
        ----------
        channel_power : torch.Tensor, optional
            Powers ``[F, C]``; by default frame f is lit by source f alone, with power 1.
        """
        self._hold_powers(channel_power, "channel_power")

    def _hold_powers(self, power, name):
        if power is None:
            power = torch.eye(self.number_of_frames, self.number_of_channels)
        self.register_buffer("channel_power", None)
        self._powers_read = ValuesRead(is_diagonal)
        self._set_powers(power, name)

    def get_laser_powers(self) -> torch.Tensor:
        """Return the amplitudes of the sources ``[F, C]``: the channel powers, or |cos| of them for "multi-color"."""
        return self.channel_power.cos().abs() if self._learns_powers() else self.channel_power

    def _learns_powers(self) -> bool:
        return power_method(self.method).endswith("multi-color")

    def set_laser_powers(self, laser_power: torch.Tensor) -> None:
        """Set the channel powers ``[F, C]``, from which :meth:`get_laser_powers` makes the amplitudes of the sources.

        Parameters
        ----------
        laser_power : torch.Tensor
            Channel powers ``[F, C]``.

        Raises
        ------
        ValueError, TypeError
            If their shape is another, or they are not finite, or negative where they are amplitudes.
        """
        self._set_powers(laser_power, "laser_power")

    def _set_powers(self, power, name):
        power = floating(name, power)
        shape = [self.number_of_frames, self.number_of_channels]
        _validate.shaped(name, power, f"{shape}, frames and wavelengths")
        if not _torch_private.is_wrapped(power):
            values = _validate.real(name, power.detach().cpu())
            # Of amplitudes of sources; their cosines are where powers are learned.
            if not self._learns_powers() and bool((values < 0).any()):
                raise ValueError(f"{name} must not be negative, got {values.min().item()}")
        self.channel_power = power.to(self.device)
        if not power.requires_grad:
            self._powers_read(self.channel_power)

    def _apply(self, function, recurse: bool = True):
        super()._apply(function, recurse)
        self._powers_read.moved(self.channel_power)
        return self

    def _load_from_state_dict(self, *arguments) -> None:
        super()._load_from_state_dict(*arguments)
        self._powers_read(self.channel_power)

    @property
    def _one_source_per_frame(self) -> bool:
        if self._learns_powers() or self.channel_power.requires_grad:
            return False
        if not torch.compiler.is_compiling() and _torch_private.is_wrapped(self.channel_power):
            return False
        return self._powers_read(self.channel_power)

    def holograms(self, hologram_phases: torch.Tensor, amplitude: torch.Tensor | None = None) -> torch.Tensor:
        """Return the fields that leave the modulator, of unit source power.

        Parameters
        ----------
        hologram_phases : torch.Tensor
            Phases ``[F, m, n]``, ``[1, F, m, n]``, or ``[m, n]`` for a single frame, in radians.
        amplitude : torch.Tensor, optional
            Amplitude of the light on the modulator, ``[m, n]``, ``[C, m, n]`` or ``[C, ms, ns]``; one by default.

        Returns
        -------
        torch.Tensor
            Complex ``[F, 1, C, ms, ns]``, or ``[F, 1, 1, ms, ns]`` where all colours leave alike.
        """
        phases = checked_phases(hologram_phases, (self.number_of_frames, *self.resolution))
        phases = phases.to(self.device)[:, None, None]
        alike = self.phase_scale.device.type == "cpu" and bool((self.phase_scale == 1).all())
        if self.slm is not None:
            field = self.slm(phases, 1.0 if alike else self.phase_scale[:, None, None])
        else:
            field = unit_phasor(phases if alike else phases * self.phase_scale[:, None, None])
        if amplitude is None:
            return self._on_grid(field)
        amplitude = checked_amplitude(amplitude, self.number_of_channels)
        return self._on_grid(amplitude.to(self.device), "amplitude") * self._on_grid(field)

    def _fields_on(self, planes: slice, holograms, frames: slice, alone: bool, kernels=None, workspace=None):
        """Return the fields of some frames on some planes by the available method, each in its one colour if alone."""
        holograms = (_in_one_colour(holograms) if alone and holograms.shape[2] > 1 else holograms)[frames]
        if self._has_kernels:
            kernels = self.transfer(planes, holograms.dtype) if kernels is None else kernels
            if alone:
                kernels = kernels[:, frames].transpose(0, 1)[:, :, None]
            return convolve(holograms, kernels, workspace)
        wavelengths = torch.stack([torch.as_tensor(w, dtype=torch.float64) for w in self.wavelengths])
        if alone:
            wavelengths = wavelengths[frames, None, None]
        if not method_named(self.propagation_type).of_intensities:
            return self._propagated_without_kernels(holograms, planes, wavelengths)
        # The intensity is propagated: its root represents a field of that intensity.
        spread = self._propagated_without_kernels(intensity(holograms), planes, wavelengths).abs()
        return _array.to_complex(spread.clamp_min(torch.finfo(spread.dtype).tiny).sqrt())

    def exposures(
        self,
        holograms: torch.Tensor,
        planes: slice,
        powers: torch.Tensor | None = None,
        *,
        workspace: Workspace | None = None,
    ) -> torch.Tensor:
        """Return the intensities that all frames together leave on some planes.

        Parameters
        ----------
        holograms : torch.Tensor
            From :meth:`holograms`.
        planes : slice
            Which planes.
        powers : torch.Tensor, optional
            Amplitudes of the sources ``[F, C]``; :meth:`get_laser_powers` by default.
        workspace : odak.wave.torch_convolution.Workspace, optional
            Memory to keep the fields, their gradient and the result in. The backward pass can then be run once, before
            the workspace is used again, and not be differentiated.

        Returns
        -------
        torch.Tensor
            Real ``[planes, C, ms, ns]``.
        """
        frames, colours, (rows, columns) = self.number_of_frames, self.number_of_channels, self.field_shape
        complex_tensor("holograms", holograms)
        _validate.shaped("holograms", holograms, f"[{frames}, 1, 1 or {colours}, {rows}, {columns}]")
        powers = self.get_laser_powers() if powers is None else floating("powers", powers)
        _validate.shaped("powers", powers, f"[{frames}, {colours}], frames and wavelengths")
        _validate.one_device(holograms=holograms, powers=powers, aperture=self.aperture)
        # Other powers than the display's may light a frame by several sources.
        alone = powers is self.channel_power and self._one_source_per_frame
        lit = slice(self._lit_frames() if alone else None)
        fields = self._fields_on(planes, holograms, lit, alone, workspace=workspace)
        powers = powers.to(fields.real.dtype)
        if not alone:
            return exposure(fields, powers, workspace=workspace)
        light = exposure(fields, powers.diagonal()[:, None], one_each=True, workspace=workspace)
        dark = light.new_zeros(len(light), colours - light.shape[1], *light.shape[2:])
        return torch.cat([light, dark], 1) if dark.numel() else light

    def reconstruct(
        self,
        hologram_phases: torch.Tensor,
        amplitude: torch.Tensor | None = None,
        no_grad: bool = True,
        get_complex: bool = False,
    ) -> torch.Tensor:
        """Return the intensity of each frame on each plane in each colour.

        Parameters
        ----------
        hologram_phases : torch.Tensor
            Phases ``[F, m, n]``, ``[1, F, m, n]``, or ``[m, n]`` for a single frame, in radians.
        amplitude : torch.Tensor, optional
            Amplitude of the light on the modulator, ``[m, n]``, ``[C, m, n]`` or ``[C, ms, ns]``; one by default.
        no_grad : bool
            Keep no graph for gradients.
        get_complex : bool
            Return fields instead of intensities.

        Returns
        -------
        torch.Tensor
            Intensities, or complex fields, ``[F, D, C, ms, ns]``.

        Raises
        ------
        ValueError, TypeError
            If phases or amplitude do not fit.
        """
        no_grad, get_complex = _validate.flag("no_grad", no_grad), _validate.flag("get_complex", get_complex)
        with torch.no_grad() if no_grad else nullcontext():
            holograms = self.holograms(hologram_phases, amplitude)
            powers = self.get_laser_powers().to(holograms.real.dtype)
            powers = (powers if get_complex else powers.square())[:, None, :, None, None]
            result: Any = None
            written: Any = None
            alone = self._one_source_per_frame
            lit_by = _in_one_colour(powers) if alone else powers
            shape = (self.number_of_frames, self.number_of_depth_layers, self.number_of_channels, *self.field_shape)
            for planes in self.plane_chunks():
                kernels = self.transfer(planes, holograms.dtype) if self._has_kernels else None
                for frames in _parts(self._lit_frames(), self._pairs_at_once()):
                    fields = self._fields_on(planes, holograms, frames, alone, kernels)
                    light = (fields if get_complex else intensity(fields)) * lit_by[frames]
                    if result is None:
                        # Of the light itself, so that torch.func.vmap may write it.
                        result = light.new_zeros(shape)
                        written = _in_one_colour(result) if alone else result
                    written[frames, planes] = light
        return result

    def plane_chunks(self) -> list[slice]:
        """Return the planes in parts whose fields, of all frames and colours, fit the memory budget."""
        return _parts(self.number_of_depth_layers, self._pairs_at_once() // self.number_of_frames)

    def _lit_frames(self) -> int:
        return (
            min(self.number_of_frames, self.number_of_channels) if self._one_source_per_frame else self.number_of_frames
        )

    def _pairs_at_once(self) -> int:
        """Return for how many pairs of frame and plane the fields and their intensities fit the memory budget."""
        pairs = self.number_of_frames * self.number_of_depth_layers
        if self.memory_budget is None:
            return pairs
        samples = self.number_of_channels * self.field_shape[0] * self.field_shape[1]
        return min(pairs, self.memory_budget // (samples * _BYTES_PER_SAMPLE))


def _in_one_colour(values: torch.Tensor) -> torch.Tensor:
    """Return values ``[F, D, C, …]`` of frame f in colour f alone, ``[min(F, C), D, 1, …]``, in the same memory."""
    return values.diagonal(dim1=0, dim2=2).movedim(-1, 0)[:, :, None]


def _parts(count: int, at_once: int) -> list[slice]:
    step = max(1, at_once)
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]
