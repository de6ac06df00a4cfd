"""Propagation of tensors with the defaults of PyTorch users, and of partially coherent fields in bounded memory."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch
from torch.utils.checkpoint import checkpoint

from odak.learn._face import torch_face
from odak.learn._tensors import trainable
from odak.wave import coherence, propagation

if TYPE_CHECKING:
    from odak.learn._faces.wave_propagation import *  # noqa: F403

APERTURE_SAMPLES = (20, 20, 5, 5)

if not TYPE_CHECKING:
    propagate_beam = torch_face(
        propagation.propagate_beam,
        defaults={
            "zero_padding": (True, False, True),
            "samples": APERTURE_SAMPLES,
        },
        describe={
            "Examples": """
>>> import torch
>>> from odak.learn.wave import propagate_beam
>>> distance = torch.tensor(1e-3, dtype=torch.float64, requires_grad=True)
>>> field = propagate_beam(torch.ones(8, 8, dtype=torch.complex128), None, distance, 8e-6, 532e-9)
>>> field.abs().sum().backward()
>>> bool(distance.grad.isfinite())
True
"""
        },
    )
    impulse_response_fresnel = torch_face(propagation.impulse_response_fresnel, defaults={"samples": APERTURE_SAMPLES})
    seperable_impulse_response_fresnel = impulse_response_fresnel

    disk_source = torch_face(coherence.disk_source)
    gaussian_spectrum = torch_face(coherence.gaussian_spectrum)


def _recomputed(step: Callable[..., Any], *values):
    if not torch.is_grad_enabled():
        return step(*values)
    return checkpoint(step, *values, use_reentrant=False, preserve_rng_state=False)


def _recomputing(core, field, spectrum, source, memory=coherence.MEMORY, **geometry) -> torch.Tensor:
    field = trainable(field) if isinstance(field, torch.Tensor) else field
    return coherence.sum_intensities(_recomputed, field, spectrum, source, memory, **geometry)


if not TYPE_CHECKING:
    propagate_partially_coherent = torch_face(
        coherence.propagate_partially_coherent,
        defaults={"window_shape": None, "window_dx": None, "offset": (0.0, 0.0), "guard": coherence.GUARD},
        through=_recomputing,
        describe={
            "memory": "int\nBytes, roughly, that directions propagated at once may take. The backward pass computes "
            "each share anew, so that this bounds it too."
        },
    )
