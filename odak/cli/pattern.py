"""Phase patterns as files: quantised levels, stored so that the phase can be read back exactly.

A level L of 2^bits is stored as the grey value L·2^(depth − bits) of a PNG of depth 8 or 16. Whatever the bits, the
phase of a pixel is then grey·2π/2^depth, which is what a modulator calibrated to 2π over 2^depth grey values shows.
"""

import math
from pathlib import Path

import torch


def depth(bits: int) -> int:
    """Return the bit depth of the file for a pattern of so many bits: 8 or 16."""
    return 8 if bits <= 8 else 16


def quantise(hologram: torch.Tensor, bits: int) -> torch.Tensor:
    """Return the levels of a hologram's phase, each level covering 2π/2^bits radians upwards of it.

    Parameters
    ----------
    hologram : torch.Tensor
        Complex ``[rows, columns]``.
    bits : int
        Bits per pixel.

    Returns
    -------
    torch.Tensor
        int32, 0 … 2^bits − 1.
    """
    from odak.learn.wave import produce_phase_only_slm_pattern

    return produce_phase_only_slm_pattern(hologram, 2 * math.pi, bits=bits, default_range=2 * math.pi)[1]


def save(path: Path, levels: torch.Tensor, bits: int) -> None:
    """Write levels as a grey PNG.

    Parameters
    ----------
    path : Path
        File to write.
    levels : torch.Tensor
        Integers ``[rows, columns]``, 0 … 2^bits − 1.
    bits : int
        Bits per pixel.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    from odak.learn.tools import save_image

    grey = levels.cpu().double() * 2 ** (depth(bits) - bits)
    try:
        save_image(str(path), grey, cmin=0, cmax=2 ** depth(bits) - 1, color_depth=depth(bits))
    except ValueError as error:
        # A full disk is not a wrong option: it must not look like one.
        raise OSError(str(error)) from error


def load_phase(path: Path, bits: int) -> torch.Tensor:
    """Return the phase that a saved pattern stands for.

    Parameters
    ----------
    path : Path
        File written by :func:`save`.
    bits : int
        Bits per pixel that it was written with.

    Returns
    -------
    torch.Tensor
        float64 ``[rows, columns]`` in radians, 0 ≤ phase < 2π.
    """
    from odak.learn.tools import load_image

    white = 2 ** depth(bits) - 1
    grey = torch.round(load_image(str(path), normalizeby=None).double() * white)
    return grey * (2 * math.pi / (white + 1))
