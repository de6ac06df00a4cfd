"""Phase patterns shown in sequence, each lit by several colours at once, that together make colour images on planes."""

import os
from collections.abc import Callable, Sequence

import torch

from odak import _validate
from odak.learn._tensors import checked_device, floating
from odak.learn.wave.color_hologram_losses import ColorHologramLosses
from odak.learn.wave.hologram_losses import WEIGHTS, checked_eyebox, checked_targets, loss_weights, powers_from
from odak.learn.wave.phase_levels import TURN, even_levels
from odak.learn.wave.propagators import propagator as propagator_type
from odak.learn.wave.source_powers import power_method
from odak.learn.wave.spectral import release_memory
from odak.learn.wave.training import Options, cosine, fingerprint, minimise
from odak.learn.wave.workspace import Workspace


class multi_color_hologram_optimizer(ColorHologramLosses):
    """Optimizer of F phase patterns and of the powers at which C colours light each, for images on D planes.

    Parameters
    ----------
    wavelengths : sequence of float
        Wavelengths of the C light sources in metres, as in the propagator.
    resolution : sequence of int
        Rows m and columns n of the modulator, as in the propagator.
    targets : torch.Tensor
        Intensities to show, ``[D, C, ms, ns]``, 0 … 1.
    propagator : odak.learn.wave.propagator
        The display. It takes over `method` and the source powers found.
    number_of_frames, number_of_depth_layers : int
        F and D, as in the propagator.
    learning_rate : float
        Step of Adam in radians, which falls to `min_learning_rate` along a cosine.
    min_learning_rate : float, optional
        1 % of `learning_rate` by default.
    double_phase : bool
        When the phase loss has a weight, hold the pattern to a double phase, else to a smooth one.
    scale_factor : int
        Samples s per pixel, as `resolution_factor` in the propagator.
    method : str
        "conventional" (one source per frame), "multi-color" (powers learned), or either with "full_complex_" before it
        (the amplitude of the light on the modulator is learned too).
    channel_power_filename : str
        File of a tensor ``[F, C]`` of powers to start from, clipped to 0 … 1.
    device : torch.device, optional
        Where to compute; that of the propagator by default.
    loss_function : callable, optional
        ``loss_function(image, target, plane_id=, noise_ratio=, inject_noise=)`` for each plane and colour ``[ms, ns]``;
        keywords it does not know are left out. The squared error by default.
    peak_amplitude : float
        Brightness of the targets, in units of what a source of power one gives where light is spread evenly. The light
        loss pulls the sum of all source amplitudes to F times that.
    optimize_peak_amplitude : bool
        Leave the targets' brightness free: in each iteration it is the one at which the images are closest to them, and
        the loss is that of the images divided by it.
    img_loss_thres : float
        Taken for the sake of older callers, and not used.
    reduction : {"sum", "mean"}
        How the losses of pixels and planes are put together.
    camera : callable, optional
        ``camera(phases)`` shows phases ``[F, m, n]`` on the real display and returns the intensities it captures,
        ``[D, C, ms, ns]``. The loss is then that of the captured images (camera in the loop).
    initial_phase : torch.Tensor, optional
        Phases to start from, ``[F, m, n]``; random over several turns by default.
    progress, callback, checkpoint, checkpoint_every, seed
        As in :func:`odak.learn.wave.stochastic_gradient_descent`.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range or does not fit the propagator, naming it.

    Notes
    -----
    Kavaklı et al., Multi-color holograms improve brightness in holographic displays, SIGGRAPH Asia (2023), section 3.
    Frames, colours and planes are propagated together; with a `memory_budget` in the propagator planes go in chunks.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import multi_color_hologram_optimizer, propagator
    >>> colours = [639e-9, 515e-9, 473e-9]
    >>> display = propagator([32, 32], colours, 8e-6, number_of_frames=3, propagator_type="forward", volume_depth=0)
    >>> optimizer = multi_color_hologram_optimizer(colours, [32, 32], torch.rand(1, 3, 32, 32), display, seed=0)
    >>> amplitudes, phases, images, powers, _, peak = optimizer.optimize(2)
    >>> phases.shape, images.shape, powers.shape
    (torch.Size([3, 32, 32]), torch.Size([3, 1, 3, 32, 32]), torch.Size([3, 3]))
    """

    _title = "multi-colour hologram"

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
        loss_function: Callable | None = None,
        peak_amplitude: float = 1.0,
        optimize_peak_amplitude: bool = False,
        img_loss_thres: float = 2e-3,
        reduction: str = "sum",
        *,
        camera: Callable | None = None,
        initial_phase: torch.Tensor | None = None,
        progress: bool = True,
        callback: Callable | None = None,
        checkpoint: str | os.PathLike | None = None,
        checkpoint_every: int = 50,
        seed: int | None = None,
    ):
        if not isinstance(propagator, propagator_type):
            raise TypeError(f"propagator must be an odak.learn.wave.propagator, got {propagator!r:.80}")
        device = checked_device("device", device)
        self.propagator = propagator if device is None else propagator.to(device)
        self.device = propagator.device
        self.number_of_frames, self.number_of_depth_layers = number_of_frames, number_of_depth_layers
        self.wavelengths = list(_validate.several("wavelengths", wavelengths, positive=True))
        self.resolution, self.scale_factor = list(_validate.size("resolution", resolution)), scale_factor
        self.method = power_method(method).replace(" ", "_")
        self._check_display()
        shape = (self.number_of_depth_layers, len(self.wavelengths), *propagator.field_shape)
        self.targets = checked_targets(targets, shape).to(self.device)
        self.double_phase = _validate.flag("double_phase", double_phase)
        self.learning_rate = _validate.real("learning_rate", learning_rate, positive=True)
        lowest = learning_rate / 100 if min_learning_rate is None else min_learning_rate
        self.min_learning_rate = _validate.real("min_learning_rate", lowest)
        self.channel_power_filename = channel_power_filename
        self._peak = peak_amplitude
        self.optimize_peak_amplitude = _validate.flag("optimize_peak_amplitude", optimize_peak_amplitude)
        self.img_loss_thres, self.camera = img_loss_thres, _validate.function_or_none("camera", camera)
        self.options = Options(progress, callback, checkpoint, checkpoint_every, seed)
        self._generator = None if seed is None else torch.Generator().manual_seed(_validate.integer("seed", seed))
        self.init_loss_function(loss_function, reduction)
        self.init_phase_scale()
        self.init_channel_power()
        self.init_amplitude()
        self.init_peak_amplitude_scale()
        self.init_phase()
        if initial_phase is not None:
            self._start_from(initial_phase)

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

    def init_phase_scale(self) -> None:
        """Take over the propagator's scale of the phase at each colour."""
        self.phase_scale = self.propagator.phase_scale

    def init_amplitude(self) -> None:
        """Set the amplitude of the light on the modulator to one, ``[C, ms, ns]``, learned if the method says so."""
        shape = (len(self.wavelengths), *self.propagator.field_shape)
        self.amplitude = torch.zeros(shape, dtype=self.targets.dtype, device=self.device)
        # Light comes from the pixels, not from between them.
        self.amplitude[:, :: self.scale_factor, :: self.scale_factor] = 1
        self.amplitude.requires_grad_(self.method.startswith("full_complex"))

    def init_phase(self) -> None:
        """Start from phases spread over several turns, ``[F, m, n]``, and an offset for each frame."""
        shape = (self.number_of_frames, *self.resolution)
        self.phase = self._leaf(TURN * self._drawn(torch.randn, shape))
        self.phase_offset = self._leaf(self._drawn(torch.randn, shape[:1]))

    def _drawn(self, draw, shape):
        # On the CPU, so that a seed gives the same start on every device.
        return draw(shape, generator=self._generator, dtype=self.targets.dtype)

    def _leaf(self, values):
        return values.to(self.device).requires_grad_()

    def _start_from(self, phase):
        _validate.real("initial_phase", floating("initial_phase", phase).detach().cpu())
        if tuple(phase.shape) != tuple(self.phase.shape):
            raise ValueError(f"initial_phase must be {tuple(self.phase.shape)}, got {tuple(phase.shape)}")
        self.phase = self._leaf(phase.detach().to(self.phase.dtype, copy=True))

    def init_channel_power(self) -> None:
        """Set the channel powers ``[F, C]``: those of the file, one source per frame, or ones to learn from."""
        shape = (self.number_of_frames, len(self.wavelengths))
        learned = self.method.endswith("multi-color")
        powers = torch.ones(shape) if learned else torch.eye(*shape)
        if self.channel_power_filename:
            powers = powers_from(self.channel_power_filename, shape)
        self.propagator.method = self.method.replace("_", " ")
        self.channel_power = powers.to(self.device, self.targets.dtype).requires_grad_(learned)
        self.propagator.set_laser_powers(self.channel_power)

    def init_optimizer(self, number_of_iterations: int = 100) -> None:
        """Gather what is learned, and the learning rate of each iteration."""
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
        self.learning_rates = cosine(self.learning_rate, self.min_learning_rate, number_of_iterations)

    def gradient_descent(
        self,
        number_of_iterations: int = 100,
        weights: dict[str, float] | Sequence[float] | None = None,
        inject_noise: bool = False,
        eyebox: dict | None = None,
        noise_ratio: float = 1e-3,
    ) -> torch.Tensor:
        """Return the optimized phases ``[F, m, n]``; parameters as in :meth:`optimize`, the eyebox not weighed."""
        iterations = _validate.integer("number_of_iterations", number_of_iterations, minimum=1)
        self.weights = loss_weights(weights, WEIGHTS | {"eyebox": 0.0})
        self._eyebox = checked_eyebox(eyebox)
        inject_noise, noise_ratio = (
            _validate.flag("inject_noise", inject_noise),
            _validate.real("noise_ratio", noise_ratio),
        )
        self._noise = {"inject_noise": inject_noise, "noise_ratio": noise_ratio}
        self.init_optimizer(iterations)
        self._workspace = Workspace()
        about = {"method": self.method, "learning_rate": self.learning_rate, "weights": self.weights}
        if self.options.checkpoint is not None:
            about |= {"targets": fingerprint(self.targets), "display": self.propagator.fingerprint()}
        minimise(
            self.parameters, self._gradient, iterations, self.learning_rates, self.options,
            description=self._title, about=about,
        )  # fmt: skip
        self._workspace = None
        release_memory()
        with torch.no_grad():
            self.propagator.set_laser_powers(self.channel_power.detach())
            return self._pattern()[0].detach()

    def optimize(
        self,
        number_of_iterations: int = 100,
        weights: dict[str, float] | Sequence[float] | None = None,
        eyebox: dict | None = None,
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
            Amplitude of the light on the modulator ``[C, ms, ns]``, phases ``[F, m, n]`` of 2^bits levels over a turn,
            the intensities they give ``[F, D, C, ms, ns]``, source amplitudes ``[F, C]``, channel powers ``[F, C]``,
            and the brightness of the targets.

        Raises
        ------
        ValueError, TypeError
            If an argument is outside its range, naming it.
        """
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
