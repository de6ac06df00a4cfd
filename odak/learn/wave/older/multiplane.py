"""Optimizer of one phase pattern, or several shown in turn, for images on several planes at one wavelength."""

import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _show, _validate
from odak._attributes import Prepared
from odak._torch_private import differentiates
from odak._warnings import ArgumentWarning, warn
from odak.learn.tools.iterations import Run, minimise
from odak.learn.wave.fields import mean_intensity, unit_phasor
from odak.learn.wave.older.propagators import propagator
from odak.learn.wave.older.terms import checked_pattern, checked_targets, checkerboard, zero_mean
from odak.learn.wave.training import check_brightness, fingerprint, generator_from, seeded_loss, started
from odak.wave.transfer_functions import checked_pitch


class multiplane_hologram_optimizer(Prepared):
    """Optimizer of a double-phase pattern for images on P planes at one wavelength.

    Parameters
    ----------
    wavelength : float
        Wavelength in metres.
    image_location : float
        Distance of the middle of the planes in metres.
    image_spacing : float
        The planes are spread evenly over a depth of P·image_spacing.
    slm_pixel_pitch : float or sequence of float
        Pixel pitch in metres, one number or a pair (rows, columns).
    slm_resolution : sequence of int
        Rows m and columns n.
    targets : torch.Tensor
        Intensities to show, ``[P, m, n]`` or ``[P, 1, m, n]``; of more planes than P the first are used.
    propagation_type : str
        Propagation type, see :func:`odak.learn.wave.propagate_beam`.
    propagator_type : str
        "forward" (from the modulator to the planes) or "back and forth" (through a relay of `zero_mode_distance`), see
        :class:`odak.learn.wave.propagator`.
    number_of_iterations : int
        Number of iterations. Each visits all planes in order and takes a step at each.
    learning_rate : float
        Step of Adam in radians.
    phase_initial : torch.Tensor, optional
        Phase to start from in radians, ``[m, n]``, ``[frames, m, n]`` with several frames; 0 … 1 rad at random by
        default.
    amplitude_initial : torch.Tensor, optional
        Amplitude of the light on the modulator, ``[m, n]``; one by default.
    loss_function : callable, optional
        ``loss_function(image, target, plane_id)`` on masked images; the mean squared error by default. It is called
        for each plane before the first step too. If it has a parameter `generator`, it is given one with which `seed`
        determines its random numbers too.
    mask_limits : sequence of float
        First and last row, first and last column of the part of the images that counts, as shares of m and n.
    number_of_planes : int
        P.
    zero_mode_distance : float
        Distance in metres to the relay and back.
    device : torch.device, optional
        Where to compute.
    progress : bool, default: True
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each visit of a plane, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int, default: 50
        Visits of planes between two writings of that file; it is written at the end and on an interruption too.
    seed : int, optional
        Makes the random start reproducible; by default torch's own generator draws it.
    pixel_fill : float, optional
        Share of the area of a square pixel that emits, at most 1, see :class:`odak.learn.wave.propagator`; by default
        pixels are points.
    frames : int
        Number of patterns shown one after another, faster than an eye or a camera tells apart. The image on each plane
        is the mean of their intensities.
    aperture : torch.Tensor or str, optional
        Mask in the Fourier plane, or "open", see :class:`odak.learn.wave.propagator`; by default the round stop of
        earlier releases. The checkerboard of a double phase needs a stop that its orders do not pass.
    aperture_size : float, optional
        Radius of a round stop in samples of the padded spectrum.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, on several planes.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import multiplane_hologram_optimizer
    >>> optimizer = multiplane_hologram_optimizer(
    ...     515e-9, 0.0, 1e-3, 8e-6, [32, 32], torch.rand(2, 32, 32), number_of_planes=2, number_of_iterations=3,
    ...     aperture_size=24,
    ... )
    >>> phase, amplitude, images = optimizer.optimize()
    >>> images.shape
    torch.Size([2, 32, 32])
    """

    _fixed = (
        *("number_of_planes", "number_of_iterations", "propagator", "slm_resolution", "number_of_frames", "device"),
    )
    _follow = {"mask_limits": "init_mask"}  # noqa: RUF012
    targets: torch.Tensor
    amplitude: torch.Tensor
    phase: torch.Tensor

    def __repr__(self) -> str:
        return _show.one_line(self, stop=self.propagator.stop)

    @_validate.takes_units("wavelength", "image_location", "slm_pixel_pitch", "zero_mode_distance")
    def __init__(
        self,
        wavelength: float,
        image_location: float,
        image_spacing: float,
        slm_pixel_pitch: float | Sequence[float],
        slm_resolution: Sequence[int],
        targets: torch.Tensor,
        propagation_type: str = "Bandlimited Angular Spectrum",
        propagator_type: str = "back and forth",
        number_of_iterations: int = 10,
        learning_rate: float = 0.1,
        phase_initial: torch.Tensor | None = None,
        amplitude_initial: torch.Tensor | None = None,
        loss_function: Callable[..., Any] | None = None,
        mask_limits: Sequence[float] = (0.2, 0.8, 0.05, 0.95),
        number_of_planes: int = 4,
        zero_mode_distance: float = 0.15,
        device: torch.device | None = None,
        *,
        progress: bool = True,
        callback: Callable[..., Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int = 50,
        seed: int | None = None,
        pixel_fill: float | None = None,
        frames: int = 1,
        aperture: torch.Tensor | str | None = None,
        aperture_size: float | None = None,
    ):
        self.number_of_planes: int = _validate.integer("number_of_planes", number_of_planes, minimum=1)
        self.number_of_iterations: int = _validate.integer("number_of_iterations", number_of_iterations, minimum=1)
        self.learning_rate: float = _validate.real("learning_rate", learning_rate, positive=True)
        _validate.real("wavelength", wavelength, positive=True)
        checked_pitch("slm_pixel_pitch", slm_pixel_pitch)
        for name, length in (
            *(("image_location", image_location), ("image_spacing", image_spacing)),
            ("zero_mode_distance", zero_mode_distance),
        ):
            _validate.real(name, length)
        slm_resolution = _validate.size("slm_resolution", slm_resolution)
        self.number_of_frames: int = _validate.integer("frames", frames, minimum=1)
        self.propagator: propagator = propagator(
            slm_resolution,
            [wavelength],
            slm_pixel_pitch,
            number_of_frames=self.number_of_frames,
            laser_channel_power=torch.ones(self.number_of_frames, 1),
            number_of_depth_layers=self.number_of_planes,
            volume_depth=self.number_of_planes * image_spacing,
            image_location_offset=image_location,
            propagation_type=propagation_type,
            propagator_type=propagator_type,
            back_and_forth_distance=zero_mode_distance,
            device=device,
            pixel_fill=pixel_fill,
            aperture=aperture,
            aperture_size=aperture_size,
        )
        self.device: torch.device = self.propagator.device
        self.slm_resolution: list[int] = self.propagator.resolution
        shape = tuple(self.slm_resolution)
        self._pattern_shape = shape if self.number_of_frames == 1 else (self.number_of_frames, *shape)
        if isinstance(targets, torch.Tensor):
            targets = targets[:, 0] if targets.ndim == 4 and targets.shape[1] == 1 else targets
            if targets.ndim == 3 and len(targets) > self.number_of_planes:
                warn(
                    f"targets hold {len(targets)} planes, of which the first {self.number_of_planes} are used "
                    "(number_of_planes)",
                    ArgumentWarning,
                )
                targets = targets[: self.number_of_planes]
        self.targets = checked_targets(targets, (self.number_of_planes, *self.slm_resolution)).to(self.device)
        self.mask_limits = mask_limits
        steps = self.number_of_iterations * self.number_of_planes
        self.options: Run = Run(steps, progress, callback, checkpoint, checkpoint_every)
        self._generator = generator_from(seed)
        self.init_amplitude(amplitude_initial)
        self.init_phase(phase_initial)
        self.init_mask()
        check_brightness("targets", self.targets * self.mask, self.amplitude.square().mean())
        self.init_loss_function(loss_function)

    def init_amplitude(self, amplitude_initial: torch.Tensor | None) -> None:
        """Set the amplitude of the illumination on the modulator, ``[m, n]``.

        Parameters
        ----------
        amplitude_initial : torch.Tensor or None
            Amplitude ``[m, n]``; None for 1 everywhere.
        """
        self.amplitude = self._values("amplitude_initial", amplitude_initial, tuple(self.slm_resolution), torch.ones)

    def init_phase(self, phase_initial: torch.Tensor | None) -> None:
        """Set the initial phase, and draw the initial phase offset of the double-phase pattern at random.

        Parameters
        ----------
        phase_initial : torch.Tensor or None
            Phase in radians, ``[m, n]``, with several frames ``[frames, m, n]``; None for random numbers between 0 and
            1 rad.
        """
        self.phase = self._values("phase_initial", phase_initial, self._pattern_shape, self._drawn).requires_grad_()
        self.offset: torch.Tensor = self._values("offset", None, self._pattern_shape, self._drawn).requires_grad_()

    def _drawn(self, shape, dtype):
        # On the CPU, so that a seed gives the same start on every device.
        return torch.rand(shape, generator=self._generator, dtype=dtype)

    def _values(self, name, given, shape, make):
        return started(name, given, [shape], self.targets, make)

    def init_optimizer(self) -> None:
        """Collect the parameters."""
        self.parameters: dict[str, torch.Tensor] = {"phase": self.phase, "offset": self.offset}

    def init_loss_function(self, loss_function: Callable[..., Any] | None = None, reduction: str = "mean") -> None:
        """Set the loss function of a plane.

        Parameters
        ----------
        loss_function : callable, optional
            Loss of the image, the target and the index of the plane; by default the squared error.
        reduction : {"mean", "sum", "none"}
            Reduction of the squared error, default "mean".
        """
        self.loss_function: Callable[..., Any] | None = _validate.function_or_none("loss_function", loss_function)
        self._seeded, self._drawn_from = seeded_loss(loss_function, self._generator.initial_seed(), self.device)
        reduction = _validate.one_of("reduction", reduction, ("mean", "sum", "none"))
        self.l2_loss: torch.nn.MSELoss = torch.nn.MSELoss(reduction=reduction)

    def init_mask(self) -> None:
        """Set the part of the images that counts, ``[m, n]``."""
        limits = _validate.numbers(_validate.real("mask_limits", self.mask_limits))
        if len(limits) != 4 or not (0 <= limits[0] < limits[1] <= 1 and 0 <= limits[2] < limits[3] <= 1):
            raise ValueError(f"mask_limits must be two rising pairs of shares of 0 … 1, got {self.mask_limits!r}")
        rows, columns = self.slm_resolution
        self.mask: torch.Tensor = torch.zeros(rows, columns, dtype=self.targets.dtype, device=self.device)
        top, bottom, left, right = (
            int(n * share) for n, share in zip((rows, rows, columns, columns), limits, strict=True)
        )
        self.mask[top:bottom, left:right] = 1

    def evaluate(self, input_image: torch.Tensor, target_image: torch.Tensor, plane_id: int) -> torch.Tensor:
        """Return the loss of an image on a plane; pixels outside the mask are excluded.

        Parameters
        ----------
        input_image : torch.Tensor
            Reconstructed intensity ``[m, n]``.
        target_image : torch.Tensor
            Target intensity ``[m, n]``.
        plane_id : int
            Index of the plane.
        """
        _validate.integer("plane_id", plane_id)
        rows, columns = self.slm_resolution
        for name, image in (("input_image", input_image), ("target_image", target_image)):
            _validate.instance(name, image, torch.Tensor, "a tensor")
            _validate.shaped(name, image, f"[..., {rows}, {columns}]")
        _validate.one_device(input_image=input_image, target_image=target_image, mask=self.mask)
        pair = input_image * self.mask, target_image * self.mask
        if self.loss_function is None:
            return self.l2_loss(*pair)
        return self._seeded(*pair, plane_id)

    def double_phase_constrain(self, shifted_phase: torch.Tensor, phase_offset: torch.Tensor) -> torch.Tensor:
        """Return the double-phase pattern of the phase minus its mean, ``[m, n]`` or ``[frames, m, n]``.

        Parameters
        ----------
        shifted_phase : torch.Tensor
            Phase in radians, ``[m, n]`` or ``[frames, m, n]``.
        phase_offset : torch.Tensor
            Phase offset in radians, of a shape that broadcasts with the phase.
        """
        shifted_phase, phase_offset = checked_pattern(shifted_phase, phase_offset, "shifted_phase")
        return checkerboard(zero_mean(shifted_phase), phase_offset)

    @differentiates
    def optimize(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Optimize, and return phase, amplitude and intensities.

        Returns
        -------
        tuple of torch.Tensor
            Phase in radians ``[m, n]``, with several frames ``[frames, m, n]``; amplitude ``[m, n]``; intensities
            ``[P, m, n]``.
        """
        self.gradient_descent()
        with torch.no_grad():
            phase = self.double_phase_constrain(self.phase, self.offset)
        return phase, self.amplitude, self.reconstruct(self.amplitude, phase)

    def reconstruct(self, hologram_amplitude: torch.Tensor, hologram_phase: torch.Tensor) -> torch.Tensor:
        """Return the reconstructed intensities on all planes, ``[P, m, n]``.

        Parameters
        ----------
        hologram_amplitude : torch.Tensor
            Amplitude of the hologram ``[m, n]``.
        hologram_phase : torch.Tensor
            Phase of the hologram in radians, ``[m, n]``, with several frames ``[frames, m, n]``.
        """
        m, n = self.slm_resolution
        phases = (self.number_of_frames, m, n)
        for name, value, shape in (
            ("hologram_amplitude", hologram_amplitude, (1, m, n)),
            ("hologram_phase", hologram_phase, phases),
        ):
            if not isinstance(value, torch.Tensor) or value.shape[-2:] != (m, n) or value.numel() != math.prod(shape):
                got = list(value.shape) if isinstance(value, torch.Tensor) else type(value).__name__
                raise ValueError(f"{name} must be a tensor {list(shape if shape[0] > 1 else shape[1:])}, got {got}")
        phase, amplitude = hologram_phase.reshape(phases), hologram_amplitude.reshape(m, n)
        return self.propagator.reconstruct(phase, amplitude)[:, :, 0].mean(0).detach()

    @differentiates
    def gradient_descent(self) -> None:
        """Optimize phase and offset in place."""
        self.init_optimizer()
        planes = range(self.number_of_planes)
        # A step depends on one plane; the best parameters are those with the lowest sum of the latest losses of all.
        with torch.no_grad():
            latest = torch.stack([self._loss_on(plane).detach().reshape(()) for plane in planes])

        def gradient(step):
            plane = step % self.number_of_planes
            loss = self._loss_on(plane)
            loss.backward()
            latest[plane] = loss.detach()
            return latest.mean()

        def about():
            given = fingerprint(self.targets, self.amplitude, self.mask)
            lengths = {"learning_rate": self.learning_rate, "planes": self.number_of_planes}
            return lengths | {"targets, amplitude or mask": given, "display": self.propagator.fingerprint()}

        minimise(
            self.parameters | {"latest losses": latest},
            gradient,
            self.learning_rate,
            self.options,
            description="multiplane hologram",
            about=about,
            generators=self._drawn_from,
        )

    def _loss_on(self, plane):
        phase = self.double_phase_constrain(self.phase, self.offset)
        image = mean_intensity(self.propagator(self.amplitude * unit_phasor(phase), 0, plane), self.number_of_frames)
        return self.evaluate(image, self.targets[plane], plane)
