"""The multi-colour hologram optimizer in the form of earlier releases."""

from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _validate
from odak.learn.wave.optimizers.multi_color import multi_color_hologram_optimizer
from odak.learn.wave.optimizers.terms import (
    checked_pattern,
    checkerboard,
    double_phase_roughness,
    roughness,
    zero_mean,
)
from odak.learn.wave.propagators import propagator as propagator_type
from odak.learn.wave.training import linear


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
        The display. It takes over `method` and the source powers found.
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
        Where to compute; that of the propagator by default.
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

    Examples
    --------
    >>> import torch
    >>> from odak.learn.wave import mixed_color_hologram_optimizer, propagator
    >>> colours = [639e-9, 515e-9, 473e-9]
    >>> display = propagator([32, 32], colours, 8e-6, number_of_frames=3, propagator_type="forward", volume_depth=0)
    >>> optimizer = mixed_color_hologram_optimizer(
    ...     colours, [32, 32], torch.rand(1, 3, 32, 32), display, seed=0, progress=False
    ... )
    >>> phases, images, *_ = optimizer.optimize(2)
    >>> tuple(phases.shape), tuple(images.shape)
    ((3, 32, 32), (3, 1, 3, 32, 32))
    """

    _title = "mixed-colour hologram"

    def __init__(
        self,
        wavelengths: Sequence[float],
        resolution: Sequence[int],
        targets: torch.Tensor,
        propagator: propagator_type,
        number_of_frames: int = 3,
        number_of_depth_layers: int = 1,
        learning_rate: float = 2e-2,
        learning_rate_floor: float = 5e-3,
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
        **others: Any,
    ):
        self.learning_rate_floor = _validate.real("learning_rate_floor", learning_rate_floor)
        super().__init__(
            wavelengths,
            resolution,
            targets,
            propagator,
            number_of_frames,
            number_of_depth_layers,
            learning_rate,
            learning_rate_floor,
            double_phase,
            scale_factor,
            method,
            channel_power_filename,
            device,
            loss_function,
            peak_amplitude,
            optimize_peak_amplitude,
            img_loss_thres,
            reduction,
            **others,
        )

    def init_phase(self) -> None:
        """Start from phases of zero and offsets of 0 … 1 rad, ``[F, m, n]`` each."""
        shape = (self.number_of_frames, *self.resolution)
        self.phase = self._leaf(torch.zeros(shape, dtype=self.targets.dtype))
        self.phase_offset = self.offset = self._leaf(self._drawn(torch.rand, shape))

    def init_optimizer(self, number_of_iterations: int = 100) -> None:
        """Collect the learned parameters, and compute the learning rate of each iteration.

        Parameters
        ----------
        number_of_iterations : int
            Number of iterations, default 100.
        """
        super().init_optimizer(number_of_iterations)
        self.learning_rates = linear(self.learning_rate, self.learning_rate_floor, number_of_iterations)

    def double_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int = 1
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the double-phase pattern of the phase minus its mean, and the roughness of its two parts.

        Parameters
        ----------
        phase : torch.Tensor
            Phases of the frames in radians, ``[F, m, n]``.
        phase_offset : torch.Tensor
            Phase offset in radians, of a shape that broadcasts with that of the phases.
        levels : int
            Number of scales, each half as large as the one before, over which the total variation is summed, default 1.
        """
        phase, phase_offset = checked_pattern(phase, phase_offset)
        pattern = checkerboard(zero_mean(phase), phase_offset)
        return pattern, double_phase_roughness(pattern, levels)

    def direct_phase_constrain(
        self, phase: torch.Tensor, phase_offset: torch.Tensor, levels: int = 1
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the phase minus its mean and minus the offset, and its roughness.

        Parameters
        ----------
        phase : torch.Tensor
            Phases of the frames in radians, ``[F, m, n]``.
        phase_offset : torch.Tensor
            Phase offset in radians, of a shape that broadcasts with that of the phases.
        levels : int
            Number of scales, each half as large as the one before, over which the total variation is summed, default 1.
        """
        phase, phase_offset = checked_pattern(phase, phase_offset)
        pattern = zero_mean(phase) - phase_offset
        return pattern, roughness(pattern, levels)

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
    def gradient_descent(  # type: ignore[override]
        self, number_of_iterations: int = 100, weights: Sequence[float] | dict = (1.0, 1.0, 0.0, 0.0)
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

    def optimize(  # type: ignore[override]
        self, number_of_iterations: int = 100, weights: Sequence[float] | dict = (1.0, 1.0, 1.0)
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
