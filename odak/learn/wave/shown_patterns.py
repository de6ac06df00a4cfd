"""Whether what a modulator is to show can be shown."""

import torch

from odak import _validate
from odak.learn._tensors import tensor


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
    if not isinstance(phases, torch.Tensor) or phases.is_complex():
        kind = getattr(phases, "dtype", type(phases).__name__)
        raise TypeError(f"hologram_phases must be a real tensor, got {kind}")
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
