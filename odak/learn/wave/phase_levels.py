"""Phases as a modulator's levels show them: the nearest level of a look-up table."""

import math

import torch

TURN = 2 * math.pi


def even_levels(phase: torch.Tensor, count: int) -> torch.Tensor:
    """Return the nearest of `count` levels spread evenly over a turn, as whole numbers in the phase's own dtype.

    The search of :func:`nearest_levels`, which finds the same, takes ten times as long.
    """
    return torch.remainder(torch.round(phase * (count / TURN)), count)


def nearest_levels(phase: torch.Tensor, lut: torch.Tensor) -> torch.Tensor:
    """Return the level whose phase is nearest around the circle.

    Parameters
    ----------
    phase : torch.Tensor
        Phase in radians, of any shape.
    lut : torch.Tensor
        Phase of each level in radians, ``[levels]``, in any order. Where it spans more than a turn, a phase inside its
        span is shown as it is, and one outside is moved into it by whole turns.

    Returns
    -------
    torch.Tensor
        int64 levels of the phase's shape.
    """
    phase, lut = phase.detach(), lut.detach()
    low = lut.min()
    period = TURN * torch.ceil((lut.max() - low) / TURN).clamp_min(1)
    rising, order = torch.sort(torch.remainder(lut - low, period))
    offset = torch.remainder(phase - low.to(phase.dtype), period.to(phase.dtype))
    # Half a step beyond the last level there is a better one a turn below, if the table reaches that far.
    top = torch.where(period > 1.5 * TURN, 1.5 * rising[-1] - 0.5 * rising[-2], period)
    offset = torch.where(offset > top.to(phase.dtype), offset - TURN, offset)
    # Behind the last boundary the first level comes again, a period later.
    boundaries = torch.cat([(rising[1:] + rising[:-1]) / 2, (rising[-1:] + period) / 2]).to(phase.dtype)
    return torch.cat([order, order[:1]])[torch.bucketize(offset, boundaries)]


def within_range(phase: torch.Tensor, phase_range: float) -> torch.Tensor:
    """Return a phase as a modulator without levels shows it: 0 … range, the nearer end for what lies beyond."""
    period = TURN * max(1, math.ceil(phase_range / TURN))
    turned = torch.remainder(phase, period)
    if phase_range > TURN:
        return torch.where(turned > phase_range, turned - TURN, turned)
    middle = (phase_range + TURN) / 2
    return torch.where(turned < middle, turned.clamp(max=phase_range), torch.zeros_like(turned))
