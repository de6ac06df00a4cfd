"""Samples that must be made anew for each call."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy
import torch


@dataclass(frozen=True)
class Build:
    """A sample made by a function of an empty folder."""

    function: Callable[[Path], Any]


def numbers(*shape: int, seed: int = 3) -> numpy.ndarray:
    """Return float64 numbers between 0.1 and 0.9."""
    return numpy.random.default_rng(seed).uniform(0.1, 0.9, shape)


def field(*shape: int, seed: int = 5) -> numpy.ndarray:
    """Return a complex128 field of amplitudes between 0.1 and 0.9."""
    return numbers(*shape, seed=seed) * numpy.exp(2j * numpy.pi * numbers(*shape, seed=seed + 1))


def tensor(*shape: int, seed: int = 3) -> torch.Tensor:
    """Return float32 numbers between 0.1 and 0.9."""
    return torch.from_numpy(numbers(*shape, seed=seed)).float()


def tensor_field(*shape: int, seed: int = 5) -> torch.Tensor:
    """Return a complex64 field of amplitudes between 0.1 and 0.9."""
    return torch.from_numpy(field(*shape, seed=seed)).to(torch.complex64)
