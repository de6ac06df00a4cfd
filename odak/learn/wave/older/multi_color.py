"""Optimizer of phase patterns shown in sequence, each lit by several colours, for images on several planes."""

import functools
import inspect
import itertools
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any

import torch

from odak import _show, _validate
from odak._attributes import Prepared
from odak._torch_private import differentiates
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import checked_device, floating
from odak.learn.tools.iterations import Run, minimise
from odak.learn.wave.camera import captured_by, with_model_gradient
from odak.learn.wave.older.propagators import power_method
from odak.learn.wave.older.propagators import propagator as propagator_type
from odak.learn.wave.older.terms import (
    WEIGHTS,
    check_pair,
    checked_eyebox,
    checked_pattern,
    checked_targets,
    checkerboard,
    double_phase_roughness,
    eyebox_loss,
    eyebox_mask,
    keywords_of,
    light_loss,
    loss_weights,
    powers_from,
    roughness,
    zero_mean,
)
from odak.learn.wave.slm import TURN, even_levels
from odak.learn.wave.training import (
    REGISTER,
    check_brightness,
    checked_noise,
    cosine,
    fingerprint,
    generator_from,
    linear,
    started,
    with_noise,
)
from odak.wave.torch_convolution import Workspace, release_memory

# Learning rate at the end by default in Odak 0.2.4.
_LOWEST_MIXED = 5e-3


def _without_eyebox(place: int) -> Callable:
    """Let a method be called as in Odak 0.2.7, with a number where the eyebox stands now, which is then left out."""

    def decorated(method):
        @functools.wraps(method)
        def adapted(*args, **options):
            if len(args) > place and isinstance(args[place], Real):
                args = (*args[:place], None, *args[place:])
            return method(*args, **options)

        return adapted

    return decorated


class multi_color_hologram_optimizer(Prepared):
    """Optimizer of F phase patterns and of the powers at which C colours light each, for images on D planes.

    Parameters
    ----------
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres, as in the propagator.
    resolution : sequence of int
        Rows m and columns n of the modulator, as in the propagator.
    targets : torch.Tensor
        Intensities to show, ``[D, C, ms, ns]``, 0 … 1, or ``[D, 1, ms, ns]``, the same in every colour.
    propagator : odak.learn.wave.propagator
        The display, with its stop in the Fourier plane. It takes over `method` and the source powers found.
    number_of_frames : int
        Number F of patterns, as in the propagator.
    number_of_depth_layers : int
        Number D of planes, as in the propagator.
    learning_rate : float
        Step of Adam in radians, which falls to `min_learning_rate` along a cosine.
    min_learning_rate : float, optional
        1 % of `learning_rate` by default.
    double_phase : bool
        If the phase loss has a weight, constrain the pattern to a double phase instead of a smooth phase.
    scale_factor : int
        Samples s per pixel, as `resolution_factor` in the propagator.
    method : str
        "conventional" (one source per frame), "multi-color" (powers learned), or either with "full_complex_" before it
        (the amplitude of the light on the modulator is learned too).
    channel_power_filename : str
        File of a tensor ``[F, C]`` of powers to start from, clipped to 0 … 1.
    device : torch.device, optional
        Where to compute; the device of the propagator by default.
    loss_function : callable, optional
        ``loss_function(image, target, plane_id=, noise_ratio=, inject_noise=)`` for each plane and colour ``[ms, ns]``;
        keywords it does not know are left out. The squared error by default. If it has a parameter `generator`, it is
        given one with which `seed` determines its random numbers too.
    peak_amplitude : float
        Intensity of the brightest target, in units of what a source of power one gives where light is spread evenly.
        The light loss draws the sum of all source amplitudes to F times that.
    optimize_peak_amplitude : bool
        Leave the targets' scale free: in each iteration it is the one at which the images are closest to them, and
        the loss compares the images divided by it.
    img_loss_thres : float
        Not used; kept for older calls.
    reduction : {"sum", "mean"}
        How the losses of pixels and planes are put together.
    camera : callable, optional
        ``camera(phases)`` shows phases ``[F, m, n]`` on the real display and returns the intensities it captures,
        ``[D, C, ms, ns]``. The loss is then computed from the captured images (camera in the loop).
    initial_phase : torch.Tensor, optional
        Phases in radians to start from, ``[F, m, n]``; random over several cycles of 2π by default.
    progress : bool, default: True
        Show a progress bar.
    callback : callable, optional
        ``callback(iteration, loss)`` after each iteration, the loss being a tensor; returning True stops.
    checkpoint : path, optional
        File to keep the state in (``.pt``). If it is there, the run goes on from it, to the same result bit for bit.
    checkpoint_every : int, default: 50
        Iterations between two writings of that file; it is written at the end and on an interruption too.
    seed : int, optional
        Makes the random start reproducible; by default torch's own generator draws it.
    learning_rate_floor : float, optional
        `min_learning_rate` by its name in Odak 0.2.7.
    scheduler_power : float, optional
        Has no effect; an ArgumentWarning says so.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range or does not fit the propagator, naming it.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, with
        ``solver=Descent(powers=True)`` for shared frames.

    Notes
    -----
    Kavaklı et al., Multi-color holograms improve brightness in holographic displays, SIGGRAPH Asia (2023), section 3.
    Frames, colours and planes are propagated together; with a `memory_budget` in the propagator planes go in chunks.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import multi_color_hologram_optimizer, propagator
    >>> colours = [639e-9, 515e-9, 473e-9]
    >>> display = propagator([32, 32], colours, 8e-6, number_of_frames=3, aperture="open")
    >>> optimizer = multi_color_hologram_optimizer(colours, [32, 32], torch.rand(1, 3, 32, 32), display, seed=0)
    >>> amplitudes, phases, images, powers, _, peak = optimizer.optimize(2)
    >>> phases.shape, images.shape, powers.shape
    (torch.Size([3, 32, 32]), torch.Size([3, 1, 3, 32, 32]), torch.Size([3, 3]))
    """

    parameters: dict[str, torch.Tensor]
    learning_rates: Callable[[int], float]
    phase: torch.Tensor
    phase_offset: torch.Tensor

    _title = "multi-colour hologram"
    # An offset for each frame, of phases that keep their mean; scales of the roughness.
    _offset_of_frames, _levels = True, 6
    # Learning rate at the end, 1 % of that at the start where it is None, and how it falls.
    _lowest_rate: float | None = None
    _falling = staticmethod(cosine)
    _workspace: Workspace | None = None
    _fixed = (
        *("propagator", "wavelengths", "resolution", "number_of_frames", "number_of_depth_layers", "scale_factor"),
        *("method", "device"),
    )
    peak_amplitude: torch.Tensor
    _follow = {"peak_amplitude": "_take_peak"}  # noqa: RUF012

    def __repr__(self) -> str:
        return _show.one_line(self, stop=self.propagator.stop)

    @_validate.takes_units("wavelengths")
    def __init__(
        self,
        wavelengths: Sequence[float],
        resolution: Sequence[int],
        targets: torch.Tensor,
        propagator: propagator_type,
        number_of_frames: int = 3,
        number_of_depth_layers: int = 1,
        learning_rate: float = 2e-2,
        min_learning_rate: float | None = None,
        double_phase: bool = True,
        scale_factor: int = 1,
        method: str = "multi-color",
        channel_power_filename: str = "",
        device: torch.device | None = None,
        loss_function: Callable[..., Any] | None = None,
        peak_amplitude: float = 1.0,
        optimize_peak_amplitude: bool = False,
        img_loss_thres: float = 2e-3,
        reduction: str = "sum",
        *,
        camera: Callable[..., Any] | None = None,
        initial_phase: torch.Tensor | None = None,
        progress: bool = True,
        callback: Callable[..., Any] | None = None,
        checkpoint: str | os.PathLike[str] | None = None,
        checkpoint_every: int = 50,
        seed: int | None = None,
        learning_rate_floor: float | None = None,
        scheduler_power: float | None = None,
    ):
        if learning_rate_floor is not None:
            if min_learning_rate is not None:
                raise TypeError("min_learning_rate and learning_rate_floor are one argument; give one of them")
            min_learning_rate = _validate.real("learning_rate_floor", learning_rate_floor)
        if scheduler_power is not None:
            _validate.real("scheduler_power", scheduler_power)
            warn("scheduler_power has no effect: the learning rate falls along a cosine", ArgumentWarning)
        _validate.instance("propagator", propagator, propagator_type, "an odak.learn.wave.propagator")
        device = checked_device("device", device)
        self.propagator: propagator_type = propagator if device is None else propagator.to(device)
        self.device: torch.device = propagator.device
        self.number_of_frames: int = number_of_frames
        self.number_of_depth_layers: int = number_of_depth_layers
        self.wavelengths: list[Any] = list(_validate.several("wavelengths", wavelengths, positive=True))
        self.resolution: list[int] = list(_validate.size("resolution", resolution))
        self.scale_factor: int = scale_factor
        self.method: str = power_method(method).replace(" ", "_")
        self._check_display()
        shape = (self.number_of_depth_layers, len(self.wavelengths), *propagator.field_shape)
        if isinstance(targets, torch.Tensor) and targets.ndim == 4 and targets.shape[1] == 1:
            targets = targets.expand(-1, shape[1], -1, -1)
        self.targets: torch.Tensor = checked_targets(targets, shape).to(self.device)
        self.double_phase: bool = _validate.flag("double_phase", double_phase)
        self.learning_rate: float = _validate.real("learning_rate", learning_rate, positive=True)
        if min_learning_rate is None:
            min_learning_rate = learning_rate / 100 if self._lowest_rate is None else self._lowest_rate
        self.min_learning_rate: float = _validate.real("min_learning_rate", min_learning_rate)
        self.channel_power_filename = channel_power_filename
        self._peak = peak_amplitude
        self.optimize_peak_amplitude: bool = _validate.flag("optimize_peak_amplitude", optimize_peak_amplitude)
        self.img_loss_thres: float = img_loss_thres
        self.camera: Callable[..., Any] | None = _validate.function_or_none("camera", camera)
        self.options: Run = Run(
            progress=progress, callback=callback, checkpoint=checkpoint, checkpoint_every=checkpoint_every
        )
        self._generator = generator_from(seed)
        self.init_loss_function(loss_function, reduction)
        self.init_channel_power()
        self.init_amplitude()
        self.init_peak_amplitude_scale()
        if not (self.amplitude.requires_grad or self.optimize_peak_amplitude):
            learned = self.channel_power.requires_grad
            reachable = self.number_of_frames if learned else self.channel_power.square().sum(0)
            check_brightness("targets", self.targets * self._peak, reachable)
        else:
            check_brightness("targets", self.targets, math.inf)
        self.init_phase()
        if initial_phase is not None:
            shape = (self.number_of_frames, *self.resolution)
            self.phase = self._leaf(started("initial_phase", initial_phase, [shape], self.targets, torch.zeros))

    def _check_display(self):
        display = self.propagator
        for name, ours, theirs in (
            ("wavelengths", [float(w) for w in self.wavelengths], _validate.numbers(display.wavelengths)),
            ("resolution", self.resolution, display.resolution),
            ("number_of_frames", self.number_of_frames, display.number_of_frames),
            ("number_of_depth_layers", self.number_of_depth_layers, display.number_of_depth_layers),
            ("scale_factor", self.scale_factor, display.resolution_factor),
        ):
            if ours != theirs:
                raise ValueError(f"{name} must be the propagator's {theirs}, got {ours}")

    @property
    def phase_scale(self) -> torch.Tensor:
        """Scale of the phase at each colour, that of the propagator."""
        return self.propagator.phase_scale

    def init_phase_scale(self) -> None:
        """Keep the propagator's scale of the phase at each colour; for older calls."""

    def init_amplitude(self) -> None:
        """Set the amplitude of the light on the modulator to one, ``[C, ms, ns]``, learned if the method says so."""
        shape = (len(self.wavelengths), *self.propagator.field_shape)
        self.amplitude: torch.Tensor = torch.zeros(shape, dtype=self.targets.dtype, device=self.device)
        # Light is modulated by the pixels, not by the gaps between them.
        self.amplitude[:, :: self.scale_factor, :: self.scale_factor] = 1
        self.amplitude.requires_grad_(self.method.startswith("full_complex"))

    def init_phase(self) -> None:
        """Start from phases over several cycles of 2π, ``[F, m, n]``, and an offset for each frame."""
        shape = (self.number_of_frames, *self.resolution)
        self.phase = self._leaf(TURN * self._drawn(torch.randn, shape))
        self.phase_offset = self._leaf(self._drawn(torch.randn, shape[:1]))

    def _drawn(self, draw, shape):
        # On the CPU, so that a seed gives the same start on every device.
        return draw(shape, generator=self._generator, dtype=self.targets.dtype)

    def _leaf(self, values: torch.Tensor) -> torch.Tensor:
        return values.to(self.device).requires_grad_()

    def init_channel_power(self) -> None:
        """Set the channel powers ``[F, C]``: from the file, one source per frame, or ones to learn from."""
        shape = (self.number_of_frames, len(self.wavelengths))
        learned = self.method.endswith("multi-color")
        # Frame f is lit by source f mod C alone where the powers are not learned.
        one_each = torch.eye(shape[1]).repeat(-(-shape[0] // shape[1]), 1)[: shape[0]]
        powers = torch.ones(shape) if learned else one_each
        if self.channel_power_filename:
            powers = powers_from(self.channel_power_filename, shape)
        self.propagator.method = self.method.replace("_", " ")
        self.channel_power: torch.Tensor = powers.to(self.device, self.targets.dtype).requires_grad_(learned)
        self.propagator.set_laser_powers(self.channel_power)

    def init_optimizer(self, number_of_iterations: int = 100) -> None:
        """Collect the learned parameters, and compute the learning rate of each iteration.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations, default 100.
        """
        number_of_iterations = _validate.integer("number_of_iterations", number_of_iterations, minimum=1)
        learned = {
            "phase": self.phase,
            "phase_offset": self.phase_offset,
            "channel_power": self.channel_power,
            "amplitude": self.amplitude,
        }
        self.parameters = {name: tensor for name, tensor in learned.items() if tensor.requires_grad}
        # Not learned, but part of the state that a checkpoint holds.
        self.parameters["peak_amplitude"] = self.peak_amplitude
        self.propagator.set_laser_powers(self.channel_power)
        self.learning_rates = self._falling(self.learning_rate, self.min_learning_rate, number_of_iterations)

    @differentiates
    @_without_eyebox(4)
    def gradient_descent(
        self,
        number_of_iterations: int = 100,
        weights: dict[str, float] | Sequence[float] | None = None,
        inject_noise: bool = False,
        eyebox: dict[Any, Any] | None = None,
        noise_ratio: float = 1e-3,
    ) -> torch.Tensor:
        """Return the optimised phases in radians, ``[F, m, n]``.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations, default 100.
        weights : dict or sequence of float, optional
            Weights of the losses, see :meth:`optimize`; the eyebox loss has weight 0 by default.
        inject_noise : bool
            Whether to add noise to the targets in each iteration, default False.
        eyebox : dict, optional
            Offset and diameter of the disc in the Fourier plane, in samples.
        noise_ratio : float
            Standard deviation of that noise relative to the range of the target, default 1e-3.
        """
        (weights,) = _validate.constants(weights=weights)
        iterations = _validate.integer("number_of_iterations", number_of_iterations, minimum=1)
        self.weights: dict[str, float] = loss_weights(weights, WEIGHTS | {"eyebox": 0.0})
        self._eyebox = checked_eyebox(eyebox)
        inject_noise, noise_ratio, _ = checked_noise(inject_noise, noise_ratio)
        self._noise: dict[str, Any] = {"inject_noise": inject_noise, "noise_ratio": noise_ratio}
        self.init_optimizer(iterations)
        self._workspace = Workspace()

        def about():
            given = {"method": self.method, "learning_rate": self.learning_rate, "weights": self.weights}
            given |= {"double_phase": self.double_phase, "eyebox": repr(self._eyebox)}
            given |= {"noise_ratio": noise_ratio} if inject_noise else {}
            if not self.channel_power.requires_grad:
                given["channel_power"] = fingerprint(self.channel_power)
            return given | {"targets": fingerprint(self.targets), "display": self.propagator.fingerprint()}

        self._noise["generator"] = generator_from((self._generator.initial_seed() + 1) % 2**62, self.device)
        drawn_from = [
            self._noise["generator"], getattr(self.loss_function, "generator", None), self.propagator.generator(),
        ]  # fmt: skip
        minimise(
            self.parameters, self._gradient, self.learning_rates, replace(self.options, iterations=iterations),
            description=self._title, about=about, generators=[own for own in drawn_from if own is not None],
            rising=None if self.camera is None else REGISTER,
        )  # fmt: skip
        self._workspace = None
        release_memory()
        with torch.no_grad():
            self.propagator.set_laser_powers(self.channel_power.detach())
            return self._pattern()[0].detach()

    @differentiates
    @_without_eyebox(3)
    def optimize(
        self,
        number_of_iterations: int = 100,
        weights: dict[str, float] | Sequence[float] | None = None,
        eyebox: dict[Any, Any] | None = None,
        bits: int | None = 8,
        inject_noise: bool = False,
        noise_ratio: float = 1e-3,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, float]:
        """Optimize, and return the hologram as the modulator shows it.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations.
        weights : dict, optional
            Weights of the losses: "image" (1), "light" (1: powers that make the brightest pixel), "eyebox" (1: an
            evenly filled disc of the Fourier plane) and "phase" (0: a double or a smooth phase); or a list in the
            older order image, light, phase, eyebox.
        eyebox : dict, optional
            Offset and diameter of that disc in samples, ``{"offset": [0, 0], "diameter": 100}``.
        bits : int, optional
            Bits of the modulator; None leaves the phase as it is.
        inject_noise : bool
            Add noise to the targets in each iteration.
        noise_ratio : float
            Its standard deviation as a share of the target's range.

        Returns
        -------
        tuple
            Amplitude of the light on the modulator ``[C, ms, ns]``, phases ``[F, m, n]`` of 2^bits levels over 2π,
            the intensities they give ``[F, D, C, ms, ns]``, source amplitudes ``[F, C]``, channel powers ``[F, C]``,
            and the brightness of the targets.

        Raises
        ------
        ValueError, TypeError
            If an argument is outside its range, naming it.
        """
        weights, noise_ratio = _validate.constants(weights=weights, noise_ratio=noise_ratio)
        weights = loss_weights(weights, WEIGHTS)
        phases = self.gradient_descent(number_of_iterations, weights, inject_noise, eyebox, noise_ratio)
        if bits is not None:
            levels = 2 ** _validate.integer("bits", bits, minimum=1)
            phases = even_levels(phases, levels) * (TURN / levels)
        amplitude = torch.relu(self.amplitude).detach()
        powers = self.propagator.get_laser_powers().detach()
        peak = float(self.peak_amplitude)
        return amplitude, phases, self._shown(phases), powers, self.channel_power.detach(), peak

    def _shown(self, phases):
        """Return the intensities of phases in the light found."""
        amplitude = torch.relu(self.amplitude).detach() if self.amplitude.requires_grad else None
        return self.propagator.reconstruct(phases, amplitude)

    def init_loss_function(self, loss_function: Callable[..., Any] | None, reduction: str = "sum") -> None:
        """Set the loss function of images and its reduction.

        Parameters
        ----------
        loss_function : callable or None
            Loss of a reconstructed image; None selects the default loss.
        reduction : {"sum", "mean"}
            Reduction over planes and pixels, default "sum".
        """
        self.loss_function: Callable[..., Any] | None = _validate.function_or_none("loss_function", loss_function)
        self.reduction: str = _validate.one_of("reduction", reduction, ("sum", "mean"))
        if loss_function is not None:
            self._loss_keywords = keywords_of(loss_function)

    def init_peak_amplitude_scale(self) -> None:
        """Set the initial scale of the targets."""
        peak = _validate.real("peak_amplitude", self._peak, positive=True)
        vars(self)["peak_amplitude"] = torch.tensor(float(peak), dtype=self.targets.dtype, device=self.device)

    def _take_peak(self):
        self._peak = float(self.peak_amplitude)
        self.init_peak_amplitude_scale()

    def evaluate(
        self,
        input_image: torch.Tensor,
        target_image: torch.Tensor,
        plane_id: int = 0,
        noise_ratio: float = 1e-3,
        inject_noise: bool = False,
        generator: torch.Generator | None = None,
    ) -> torch.Tensor:
        """Return the loss of an image against its target.

        Parameters
        ----------
        input_image, target_image : torch.Tensor
            Intensities ``[C, ms, ns]``.
        plane_id : int
            Plane, for losses that depend on the plane.
        noise_ratio : float
            Standard deviation of the noise as a share of the target's range.
        inject_noise : bool
            Add noise to the target.
        generator : torch.Generator, optional
            Where the noise is drawn from; torch's own generator by default.

        Returns
        -------
        torch.Tensor
            The loss; a given function is summed over colours.
        """
        inject_noise, noise_ratio, generator = checked_noise(inject_noise, noise_ratio, generator)
        plane_id = _validate.integer("plane_id", plane_id)
        check_pair(input_image, target_image)
        if self.loss_function is not None:
            known = {
                "plane_id": plane_id, "noise_ratio": noise_ratio, "inject_noise": inject_noise, "generator": generator,
            }  # fmt: skip
            keywords = {name: value for name, value in known.items() if name in self._loss_keywords}
            pairs = zip(input_image, target_image, strict=True)
            return sum(self.loss_function(image, target, **keywords) for image, target in pairs)
        if inject_noise:
            target_image = with_noise(target_image, noise_ratio, generator)
        return torch.nn.functional.mse_loss(input_image, target_image, reduction=self.reduction)

    def double_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the double-phase pattern, phase ∓ offset in a checkerboard, and the roughness of its two parts.

        Parameters
        ----------
        phase : torch.Tensor
            Phases of the frames in radians, ``[F, m, n]``.
        phase_offset : torch.Tensor
            Phase offset of each frame in radians, ``[F]``; in the mixed-colour optimizer, which subtracts the mean of
            the phase, a tensor that broadcasts against the phases.
        levels : int, optional
            Number of scales, each half as large as the one before, over which the total variation is summed: 6 by
            default, in the mixed-colour optimizer 1.
        """
        phase, phase_offset = checked_pattern(phase, phase_offset, of_frames=self._offset_of_frames)
        pattern = checkerboard(phase if self._offset_of_frames else zero_mean(phase), phase_offset)
        return pattern, double_phase_roughness(pattern, self._levels if levels is None else levels)

    def direct_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the phase minus its mean and minus the offset, and its roughness.

        Parameters
        ----------
        phase : torch.Tensor
            Phases of the frames in radians, ``[F, m, n]``.
        phase_offset : torch.Tensor
            Phase offset as in :meth:`double_phase_constrain`.
        levels : int, optional
            Number of scales as in :meth:`double_phase_constrain`.
        """
        phase, phase_offset = checked_pattern(phase, phase_offset, of_frames=self._offset_of_frames)
        pattern = zero_mean(phase) - phase_offset
        return pattern, roughness(pattern, self._levels if levels is None else levels)

    def eyebox_constrain(self, phase: torch.Tensor, offset: float | Sequence[float], diameter: float) -> torch.Tensor:
        """Return the non-uniformity of the intensity in a disc of the hologram's spectrum, and the share outside it.

        Parameters
        ----------
        phase : torch.Tensor
            Phases ``[F, m, n]``.
        offset : float or sequence of float
            Distance of the disc's centre from zero frequency, in samples of the spectrum.
        diameter : float
            Diameter of the disc in samples of the spectrum.
        """
        offset, diameter = _validate.constants(offset=offset, diameter=diameter)
        phase = _validate.image("phase", floating("phase", phase))
        if not phase.numel():
            raise ValueError(f"phase must not be empty, got {list(phase.shape)}")
        return eyebox_loss(phase, eyebox_mask(phase.shape[-2:], offset, diameter).to(phase))

    def _pattern(self):
        """Return the displayed phases, and the loss of their constraint (None without)."""
        if not self.weights["phase"]:
            return self.phase, None
        constrain = self.double_phase_constrain if self.double_phase else self.direct_phase_constrain
        return constrain(self.phase, self.phase_offset)

    def _gradient(self, iteration):
        phases, phase_loss = self._pattern()
        amplitude = torch.relu(self.amplitude) if self.amplitude.requires_grad else None
        powers = self.propagator.get_laser_powers()
        hologram = self.propagator.holograms(phases, amplitude)
        images = self._image_losses(phases, hologram, powers, iteration == 0)
        total, learned = torch.zeros_like(self.peak_amplitude), False
        for loss in itertools.chain(images, self._other_losses(phases, phase_loss, powers)):
            if loss.requires_grad:
                # Of each chunk of planes only its own graph is let go, once its gradients have been added.
                loss.backward(retain_graph=True)
                learned = True
            total += loss.detach()
        if not learned:
            raise ValueError(f"weights leave nothing to learn from, got {self.weights}")
        return total

    def _image_losses(self, phases, hologram, powers, first):
        """Yield the loss of the images of each chunk of planes."""
        captured = None if self.camera is None else captured_by(self.camera, phases, tuple(self.targets.shape))
        if self.optimize_peak_amplitude and first:
            with torch.no_grad():
                shown = self._images(hologram, powers, captured)
                self._set_peak([_overlap(images, self.targets[planes]) for planes, images in shown])
        light = []
        for planes, images in self._images(hologram, powers, captured):
            yield self.weights["image"] * self._image_loss(images, planes)
            if self.optimize_peak_amplitude:
                light.append(_overlap(images.detach(), self.targets[planes]))
        if light:
            self._set_peak(light)

    def _images(self, hologram, powers, captured):
        """Yield some planes and their intensities, until all were there."""
        for planes in self.propagator.plane_chunks() if self.weights["image"] else []:
            images = self.propagator.exposures(hologram, planes, powers, workspace=self._workspace)
            yield planes, images if captured is None else with_model_gradient(images, captured[planes])

    def _set_peak(self, overlaps):
        """Set the scale of the targets at which the images of this iteration are closest to them, ⟨I, I⟩/⟨I, T⟩."""
        own, common = torch.stack(overlaps).sum(0)
        self.peak_amplitude.copy_(own / common.clamp_min(torch.finfo(common.dtype).tiny))

    def _image_loss(self, images, planes):
        targets = self.targets[planes]
        if self.optimize_peak_amplitude:
            # Relative to the scale found: were targets scaled by it, a dark image would have the lowest loss.
            images = images / self.peak_amplitude
        elif self._peak != 1:
            targets = targets * self._peak
        share = len(images) / self.number_of_depth_layers if self.reduction == "mean" else 1
        if self.loss_function is None:
            return share * self.evaluate(images, targets, **self._noise)
        ids = range(planes.start, planes.stop)
        losses = [self.evaluate(*pair, plane, **self._noise) for *pair, plane in zip(images, targets, ids, strict=True)]
        return share * sum(losses) / (len(losses) if self.reduction == "mean" else 1)

    def _other_losses(self, phases, phase_loss, powers):
        """Yield the losses of powers and patterns."""
        if self.weights["light"] and powers.requires_grad:
            yield self.weights["light"] * light_loss(powers, self.targets, self._peak, self.reduction)
        if self.weights["eyebox"]:
            yield self.weights["eyebox"] * self.eyebox_constrain(phases, **self._eyebox)
        if phase_loss is not None:
            yield self.weights["phase"] * phase_loss


def _overlap(images, targets):
    """Return ⟨I, I⟩ and ⟨I, T⟩ in one tensor."""
    images, targets = images.flatten(), targets.flatten()
    return torch.stack([torch.dot(images, images), torch.dot(images, targets)])


def _older_signature() -> inspect.Signature:
    """Return the arguments of the constructor by the names and with the defaults of Odak 0.2.4."""
    own = inspect.signature(multi_color_hologram_optimizer).parameters.values()
    given = {p.name: p for p in own if p.kind is not p.KEYWORD_ONLY}
    given["min_learning_rate"] = given["min_learning_rate"].replace(
        name="learning_rate_floor", annotation=float, default=_LOWEST_MIXED
    )
    return inspect.Signature([*given.values(), inspect.Parameter("others", inspect.Parameter.VAR_KEYWORD)])


class mixed_color_hologram_optimizer(multi_color_hologram_optimizer):
    """Multi-colour hologram optimizer of earlier releases, with a phase offset per pixel and constrained patterns.

    Parameters
    ----------
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres, as in the propagator.
    resolution : sequence of int
        Rows m and columns n of the modulator, as in the propagator.
    targets : torch.Tensor
        Intensities to show, ``[D, C, ms, ns]``, 0 … 1, or ``[D, 1, ms, ns]``, the same in every colour.
    propagator : odak.learn.wave.propagator
        The display, with its stop in the Fourier plane. It takes over `method` and the source powers found.
    number_of_frames : int, default: 3
        Number F of patterns, as in the propagator.
    number_of_depth_layers : int, default: 1
        Number D of planes, as in the propagator.
    learning_rate : float, default: 0.02
        Step of Adam in radians at the start.
    learning_rate_floor : float, default: 0.005
        Step of Adam in radians at the end, to which the step falls linearly.
    double_phase : bool, default: True
        Constrain the pattern to a double phase, else to a smooth one.
    scale_factor : int, default: 1
        Samples s per pixel, as `resolution_factor` in the propagator.
    method : str, default: "multi-color"
        "conventional" (one source per frame) or "multi-color" (powers learned).
    channel_power_filename : str, optional
        File of a tensor ``[F, C]`` of powers to start from, clipped to 0 … 1.
    device : torch.device, optional
        Where to compute; the device of the propagator by default.
    loss_function : callable, optional
        Loss of each plane and colour, see :class:`multi_color_hologram_optimizer`; the squared error by default.
    peak_amplitude : float, default: 1.0
        Intensity of the brightest target, in units of what a source of power one gives where light is spread evenly.
    optimize_peak_amplitude : bool, default: False
        Leave the targets' scale free, as in :class:`multi_color_hologram_optimizer`.
    img_loss_thres : float
        Not used; kept for older calls.
    reduction : {"sum", "mean"}
        How the losses of pixels and planes are combined.
    **others
        Further options of :class:`multi_color_hologram_optimizer`: `camera`, `initial_phase`, `progress`, `callback`,
        `checkpoint`, `checkpoint_every` and `seed`.

    See Also
    --------
    odak.learn.wave.optimise : The successor: holograms for a :class:`odak.learn.wave.Display`, with
        ``solver=Descent(powers=True)`` for shared frames.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import mixed_color_hologram_optimizer, propagator
    >>> colours = [639e-9, 515e-9, 473e-9]
    >>> display = propagator([32, 32], colours, 8e-6, number_of_frames=3, aperture="open")
    >>> optimizer = mixed_color_hologram_optimizer(
    ...     colours, [32, 32], torch.rand(1, 3, 32, 32), display, seed=0, progress=False
    ... )
    >>> phases, images, *_ = optimizer.optimize(2)
    >>> tuple(phases.shape), tuple(images.shape)
    ((3, 32, 32), (3, 1, 3, 32, 32))
    """

    _title = "mixed-colour hologram"
    _offset_of_frames, _levels = False, 1
    _lowest_rate, _falling = _LOWEST_MIXED, staticmethod(linear)

    __signature__: inspect.Signature = _older_signature()

    @property
    def learning_rate_floor(self) -> float:
        """Same as ``min_learning_rate``."""
        return self.min_learning_rate

    @property
    def offset(self) -> torch.Tensor:
        """Same as ``phase_offset``."""
        return self.phase_offset

    def init_phase(self) -> None:
        """Start from phases of zero and offsets of 0 … 1 rad, ``[F, m, n]`` each."""
        shape = (self.number_of_frames, *self.resolution)
        self.phase = self._leaf(torch.zeros(shape, dtype=self.targets.dtype))
        self.phase_offset = self._leaf(self._drawn(torch.rand, shape))

    def _pattern(self):
        constrain = self.double_phase_constrain if self.double_phase else self.direct_phase_constrain
        pattern, loss = constrain(self.phase, self.phase_offset)
        return pattern, loss if self.weights["phase"] else None

    def reconstruct(self, hologram_phases: torch.Tensor) -> torch.Tensor:
        """Return the reconstructed intensities, ``[F, D, C, ms, ns]``.

        Parameters
        ----------
        hologram_phases : torch.Tensor
            Phases of the frames in radians, ``[F, m, n]``.
        """
        return self.propagator.reconstruct(hologram_phases)

    # Fewer options than with one colour per frame, and one result less.
    @differentiates
    def gradient_descent(  # type: ignore[override]
        self, number_of_iterations: int = 100, weights: Sequence[float] | dict[Any, Any] = (1.0, 1.0, 0.0, 0.0)
    ) -> torch.Tensor:
        """Return the optimised phases in radians, ``[F, m, n]``.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations, default 100.
        weights : sequence of float or dict
            Weights of the image loss, the intensity loss and the phase losses, see :meth:`optimize`.
        """
        (weights,) = _validate.constants(weights=weights)
        return super().gradient_descent(number_of_iterations, weights)

    @differentiates
    def optimize(  # type: ignore[override]
        self, number_of_iterations: int = 100, weights: Sequence[float] | dict[Any, Any] = (1.0, 1.0, 1.0)
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, float]:
        """Optimize, and return the hologram.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations.
        weights : sequence of float or dict
            Weights of the image, the light and the phase losses.

        Returns
        -------
        tuple
            Phases ``[F, m, n]``, not quantised, the intensities they give ``[F, D, C, ms, ns]``, source amplitudes
            ``[F, C]``, channel powers ``[F, C]``, and the brightness of the targets.
        """
        (weights,) = _validate.constants(weights=weights)
        phases = self.gradient_descent(number_of_iterations, weights)
        powers = self.propagator.get_laser_powers().detach()
        images = self._shown(phases)
        return phases, images, powers, self.channel_power.detach(), float(self.peak_amplitude)
