"""The convolution whose kernel varies over the picture against its bare form: unfold, multiply, one matrix product."""

import functools
from collections.abc import Iterator

import torch
from measure import interleave
from wave_optics import row

from odak.learn.models.unets import modulated_convolution

# Channels before and after, rows and columns: steps down of the spatially adaptive U-Net from a 1080p picture.
STEPS = [(8, 15, 540, 960), (16, 31, 270, 480), (64, 127, 67, 120)]
BOUND = 2.0


def bare(x: torch.Tensor, factors: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Return the convolution as one would write it down."""
    columns = torch.nn.functional.unfold(x, 3, padding=1) * factors.flatten(2)
    return (weight.flatten(1) @ columns).unflatten(2, x.shape[-2:])


def ours(x: torch.Tensor, factors: torch.Tensor, weight: torch.Tensor) -> torch.Tensor:
    """Return the same by the function of the library."""
    return modulated_convolution(x, factors, weight, stride=1, padding=1)


def convolution(device: str) -> Iterator[dict]:
    """Yield the convolution, then the convolution with its three gradients, at some scales of a network."""
    for channels, outputs, height, width in STEPS:
        shapes = (1, channels, height, width), (1, 9 * channels, height, width), (outputs, channels, 3, 3)
        tensors = [torch.randn(shape, device=device) for shape in shapes]
        incoming = torch.randn(1, outputs, height, width, device=device)
        name = f"adaptive 3 × 3, {channels} → {outputs}, {height} × {width}"

        forward = {form.__name__: functools.partial(form, *tensors) for form in (bare, ours)}
        timings = interleave(forward, device=device)
        yield row(name, timings["ours"].best, timings["bare"].best, "bare form", BOUND)

        tensors = [tensor.requires_grad_() for tensor in tensors]
        both = {form.__name__: functools.partial(_with_gradients, form, tensors, incoming) for form in (bare, ours)}
        timings = interleave(both, device=device)
        yield row(f"{name}, gradients", timings["ours"].best, timings["bare"].best, "bare form", BOUND)


def _with_gradients(form, tensors, incoming):
    return torch.autograd.grad(form(*tensors), tensors, incoming)


ALL = (convolution,)
