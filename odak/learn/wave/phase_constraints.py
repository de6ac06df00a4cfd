"""What a hologram's phase is held to: the checkerboard of a double phase, smoothness, and light inside an eyebox."""

import torch

from odak import _validate
from odak.learn._tensors import floating
from odak.learn.tools.loss import multi_scale_total_variation_loss
from odak.learn.wave.fields import unit_phasor
from odak.wave.double_phase import decompose_double_phase


def checked_pattern(
    phase, offset, name: str = "phase", *, of_frames: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase ``[..., m, n]`` and the offset that goes with it after checking both.

    Parameters
    ----------
    phase, offset : torch.Tensor
        What came.
    name : str
        What the phase is called; the offset is "phase_offset".
    of_frames : bool
        The offset is one for each frame, ``[F]``, rather than one that broadcasts against the phase.
    """
    phase, offset = _validate.image(name, floating(name, phase)), floating("phase_offset", offset)
    if phase.ndim > 4 or not phase.numel():
        raise ValueError(f"{name} must be [m, n], [F, m, n] or [B, F, m, n], not empty; got {list(phase.shape)}")
    offset = offset.reshape(-1, 1, 1) if of_frames else offset
    if _validate.fitting(**{name: phase, "phase_offset": offset}) != tuple(phase.shape):
        raise ValueError(f"phase_offset must fit into {name} {list(phase.shape)}, got {list(offset.shape)}")
    return phase, offset


def checkerboard(phase: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return phase − offset at (even, even) and (odd, odd), phase + offset at the other pixels.

    Parameters
    ----------
    phase : torch.Tensor
        ``[..., m, n]`` in radians.
    offset : torch.Tensor
        Broadcasts against `phase`.

    Returns
    -------
    torch.Tensor
        ``[..., m, n]``.
    """
    rows, columns = (torch.arange(n, device=phase.device) for n in phase.shape[-2:])
    signs = ((rows[:, None] + columns) % 2 * 2 - 1).to(phase.dtype)
    return torch.addcmul(phase, signs, offset)


def zero_mean(phase: torch.Tensor) -> torch.Tensor:
    """Return the phase ``[..., m, n]`` of each frame less its mean."""
    return phase - phase.mean((-2, -1), keepdim=True)


def roughness(phase: torch.Tensor, levels: int = 6) -> torch.Tensor:
    """Return the total variation of a phase ``[..., m, n]`` over so many sizes, each half of the one before."""
    levels = _validate.whole("levels", levels, minimum=1)
    # Frames smaller than that have fewer sizes.
    return multi_scale_total_variation_loss(phase, min(levels, min(phase.shape[-2:]).bit_length()))


def double_phase_roughness(phase: torch.Tensor, levels: int = 6) -> torch.Tensor:
    """Return the total variation and the standard deviation of the two parts of a double phase ``[F, m, n]``."""
    return sum(roughness(part, levels) + part.std() for part in decompose_double_phase(phase))


def eyebox_loss(phase: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return how unevenly light fills an eyebox in the Fourier plane, and how much of it misses the eyebox.

    Parameters
    ----------
    phase : torch.Tensor
        Phases ``[F, m, n]`` in radians.
    mask : torch.Tensor
        ``[m, n]`` in FFT order, 1 inside the eyebox.

    Returns
    -------
    torch.Tensor
        Mean over the frames of variance/mean² of the spectrum's amplitude inside, plus the share of it outside.
    """
    amplitude = torch.fft.fft2(unit_phasor(phase), norm="ortho").abs()
    inside = amplitude * mask
    within, whole = inside.sum((-2, -1)), amplitude.sum((-2, -1))
    mean = within / mask.sum()
    variance = (inside.square().sum((-2, -1)) / mask.sum() - mean.square()).clamp_min(0)
    return (variance / mean.square() + 1 - within / whole).mean()
