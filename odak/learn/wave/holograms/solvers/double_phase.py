"""Holograms by the double-phase encoding in free space. Touches a problem by its lengths, target and start."""

from dataclasses import dataclass
from typing import Any

import torch

from odak._warnings import AccuracyWarning, warn
from odak.learn.wave.displays.panels import Iris
from odak.learn.wave.holograms.problem import Problem
from odak.learn.wave.holograms.solvers.projections import frames_alone
from odak.learn.wave.propagation import propagate_beam

# Least amplitude of the light on the panel, as a share of its root mean square, that double phase makes up for.
_DIMMEST = 0.1


@dataclass(frozen=True)
class DoublePhase:
    """The double-phase encoding of the image, propagated back with a flat phase: smooth, and at once.

    Use it where images must be free of speckle and the display has an iris of about half an order along each axis;
    without one, the orders of its checkerboard lie over the image.

    Examples
    --------
    >>> from odak.learn.wave import DoublePhase
    >>> DoublePhase()
    DoublePhase()
    """

    def solve(self, problem: Problem) -> torch.Tensor:
        """Return the phases of a problem, ``[F, rows, columns]``."""
        display, phases = problem.display, problem.start.clone()
        quarter = 0.25 / max(display.path.pitches)
        passes = [
            w
            for w in display.wavelengths
            if not isinstance(display.iris, Iris) or display.iris.cutoff(w) > 1.5 * quarter
        ]
        if passes:
            warn(
                "double phase needs an iris that passes frequencies up to about 1/(4·pitch), or the orders of its "
                f"checkerboard lie over the image; this display has {display.iris!r}",
                AccuracyWarning,
            )
        for frame, plane, colour in frames_alone(display, "double phase"):
            there: Any = propagate_beam(
                problem.target[plane, colour].sqrt() + 0j,
                None,
                -display.distances[plane],
                display.modulator.pitch,
                display.wavelengths[colour] / display.medium,
                "auto",
                zero_padding=[True, False, True],
            )
            illumination, aberration = display._flat_light(colour)
            encoded = encode_double_phase(there / illumination.clamp_min(_DIMMEST))
            phases[frame] = display.modulator.asked(encoded - aberration, colour)
        return phases


def encode_double_phase(field: torch.Tensor) -> torch.Tensor:
    """Return the checkerboard phase whose neighbours average to a field (Hsueh and Sawchuk 1978).

    Parameters
    ----------
    field : torch.Tensor
        Complex ``[..., rows, columns]``; the amplitude is divided by its maximum.

    Returns
    -------
    torch.Tensor
        Phase in radians, of zero mean before the ± arccos(amplitude) is added.
    """
    amplitude = field.abs()
    amplitude = amplitude / amplitude.amax(dim=(-2, -1), keepdim=True).clamp_min(torch.finfo(amplitude.dtype).tiny)
    phase = field.angle()
    phase = phase - phase.mean(dim=(-2, -1), keepdim=True)
    # The derivative of arccos is infinite at one, the amplitude of the brightest pixel, whose gradient is set to zero.
    dimmer = amplitude < 1
    offset = torch.where(dimmer, torch.arccos(torch.where(dimmer, amplitude, 0)), 0)
    rows, columns = (torch.arange(n, device=field.device) for n in field.shape[-2:])
    sign = 1 - 2 * ((rows[:, None] + columns[None, :] + 1) % 2)
    return phase + sign * offset
