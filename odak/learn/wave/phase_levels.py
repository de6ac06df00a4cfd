"""Phases as a modulator's levels show them: the nearest level of a look-up table, hard or soft."""

import math
from typing import NamedTuple

import torch

TURN = 2 * math.pi


class _Table(NamedTuple):
    """A look-up table in rising order.

    `low` is its lowest phase, `period` the whole turns that hold its span, `top` the phase above `low` from where a
    turn less is shown instead, `offsets` the table above `low` in its own order, `order` the levels by rising phase
    with the first again at the end, `boundaries` the phases above `low` where one level gives way to the next.
    """

    low: torch.Tensor
    period: torch.Tensor
    top: torch.Tensor
    offsets: torch.Tensor
    order: torch.Tensor
    boundaries: torch.Tensor


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
    table = _table(lut.detach())
    offset = _moved_into(phase.detach(), table)
    return table.order[torch.bucketize(offset, table.boundaries.to(phase.dtype))]


def soft_phase(phase: torch.Tensor, lut: torch.Tensor, temperature: float) -> torch.Tensor:
    """Return the mean phase of the levels, weighted by exp(−d²/(2·temperature²)), d being their distance in radians.

    Parameters
    ----------
    phase, lut
        As in :func:`nearest_levels`.
    temperature : float
        In radians; towards 0 the result is that of the nearest level. A ``[..., levels]`` array is held in memory.

    Returns
    -------
    torch.Tensor
        Phase in radians, differentiable in `phase` and in `lut`.
    """
    table = _table(lut)
    offset, period = _moved_into(phase, table), table.period.to(phase.dtype)
    distance = table.offsets.to(phase.dtype) - offset[..., None]
    distance = torch.remainder(distance + period / 2, period) - period / 2
    weight = torch.softmax(-0.5 * (distance / temperature) ** 2, dim=-1)
    return table.low.to(phase.dtype) + offset + (weight * distance).sum(-1)


def within_range(phase: torch.Tensor, phase_range: float) -> torch.Tensor:
    """Return a phase as a modulator without levels shows it: 0 … range, the nearer end for what lies beyond."""
    period = TURN * max(1, math.ceil(phase_range / TURN))
    turned = torch.remainder(phase, period)
    if phase_range > TURN:
        return torch.where(turned > phase_range, turned - TURN, turned)
    middle = (phase_range + TURN) / 2
    return torch.where(turned < middle, turned.clamp(max=phase_range), torch.zeros_like(turned))


def _table(lut: torch.Tensor) -> _Table:
    low, span = lut.min(), lut.max() - lut.min()
    period = TURN * torch.ceil(span / TURN).clamp_min(1)
    offsets = torch.remainder(lut - low, period)
    rising, order = torch.sort(offsets.detach())
    boundaries = torch.cat([(rising[1:] + rising[:-1]) / 2, (rising[-1:] + period.detach()) / 2])
    # Half a step beyond the last level there is a better one a turn below, if the table reaches that far.
    top = torch.where(period > 1.5 * TURN, 1.5 * rising[-1] - 0.5 * rising[-2], period)
    return _Table(low, period, top, offsets, torch.cat([order, order[:1]]), boundaries)


def _moved_into(phase, table: _Table):
    """Return the phase above the table's lowest, by whole turns moved into its span."""
    offset = torch.remainder(phase - table.low.to(phase.dtype), table.period.to(phase.dtype))
    return torch.where(offset > table.top.to(phase.dtype), offset - TURN, offset)
