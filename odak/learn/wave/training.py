"""Shared by the optimizers of holograms: seeded losses, checks of targets and starts, schedules."""

import functools
import hashlib
import inspect
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.learn._tensors import checked_generator, floating, real_tensor, trainable
from odak.learn.wave.holograms.bounds import least_error_of_light

# Where the loss of a model with a camera in it rises.
REGISTER = (
    "the gradient of the model does not lead to the image that is captured; register the image, or put the fault into "
    "the model"
)


def recorded(loss: Callable[[], torch.Tensor], parameters: Sequence[torch.Tensor]) -> Callable[[], torch.Tensor]:
    """Return a function of no arguments that replays a loss and its gradient as one graph of CUDA kernels.

    The processor then starts a graph in each iteration instead of some hundred kernels. It is recorded at the first
    call; what `loss` computes must depend on nothing but the numbers in `parameters`.

    Parameters
    ----------
    loss : callable
        Returns the loss, without reading numbers from the device.
    parameters : sequence of torch.Tensor
        Leaf tensors on a CUDA device that require grad. Each call fills their ``grad``.
    """
    replay: Callable[[], None] | None = None
    outputs: list[torch.Tensor] = []

    def compute():
        with torch.enable_grad():
            value = loss()
            return [value.detach(), *torch.autograd.grad(value, parameters, allow_unused=True)]

    def evaluate():
        nonlocal replay, outputs
        if replay is None:
            replay, outputs = _captured(compute, parameters[0].device)
        replay()
        for parameter, slope in zip(parameters, outputs[1:], strict=True):
            parameter.grad = slope
        # The next replay writes to the same memory.
        return outputs[0].clone()

    return evaluate


def _captured(compute: Callable[[], list[Any]], device: torch.device) -> tuple[Callable[[], None], list[Any]]:
    """Return what replays a computation, and the tensors that it writes its results to."""
    if device.type != "cuda":
        raise ValueError(f"graph must be False where the display is not on a CUDA device, got {device}")
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.device(device):
        # Plans of transforms, transfer functions and workspaces are made before, on a stream of their own.
        stream = torch.cuda.Stream()
        stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(stream):
            for _ in range(3):
                compute()
        torch.cuda.current_stream().wait_stream(stream)
        told = (
            "graph must be False for this loss or display, whose computation cannot be recorded: it may read numbers "
            "from the device"
        )
        with _validate.refusing(lambda _: told, RuntimeError, raised=RuntimeError), torch.cuda.graph(graph):
            outputs = compute()
    return graph.replay, outputs


def generator_from(seed: int | None, device: torch.device | str = "cpu") -> torch.Generator:
    """Return a new generator with a seed; without one, with a seed drawn from torch's own generator."""
    seed = int(torch.randint(2**62, ())) if seed is None else _validate.integer("seed", seed)
    return torch.Generator(device).manual_seed(seed)


def parameters_of(loss: Callable[..., Any]) -> dict[str, inspect.Parameter]:
    """Return the parameters of a loss by name; none where they are not known, as for functions of torch in C++."""
    try:
        return dict(inspect.signature(loss.forward if isinstance(loss, torch.nn.Module) else loss).parameters)
    except ValueError:
        return {}


def seeded_loss(
    loss: Callable[..., Any] | None, seed: int | None, device: torch.device
) -> tuple[Callable[..., Any], list[torch.Generator]]:
    """Return a loss whose random numbers a seed reaches, and the generators whose state belongs to a checkpoint.

    Parameters
    ----------
    loss : callable or None
        The user's loss, by default the mean squared error; one that takes a `generator`, which is not bound to one
        yet, is given one.
    seed : int or None
        Seed of the run.
    device : torch.device
        Where the loss draws.
    """
    if loss is None:
        return torch.nn.functional.mse_loss, []
    own = getattr(loss, "generator", None)
    kept, found = [own] if isinstance(own, torch.Generator) else [], parameters_of(loss).get("generator")
    if found is not None and (found.default is None or found.default is found.empty):
        # Not the generator of the start, whose numbers the noise would repeat.
        kept.insert(0, generator_from(None if seed is None else (seed + 1) % 2**62, device))
        loss = functools.partial(loss, generator=kept[0])
    return loss, kept


def check_brightness(name: str, targets: torch.Tensor, reachable: float | torch.Tensor, remedy: str = "") -> None:
    """Issue a warning if a mean intensity exceeds what phase-only holograms, which conserve energy, can reach.

    It states the least mean squared error that follows from the light that is missing.

    Parameters
    ----------
    name : str
        Name of the targets in the warning.
    targets : torch.Tensor
        Intensities ``[..., rows, columns]``.
    reachable : float or torch.Tensor
        Mean intensity of the light on the modulator, added up over its frames; fits ``[...]``. Infinite where the
        scale of the targets is free: targets of 0 … 255 are still named.
    remedy : str
        What else may be done, after "or".
    """
    means = targets.mean((-2, -1))
    limits = torch.as_tensor(reachable, dtype=means.dtype, device=means.device).expand_as(means)
    if bool((means > limits * (1 + 1e-5)).any()):
        place = (means - limits).argmax()
        most, mean = (values.flatten()[place].item() for values in (limits, means))
        bound = least_error_of_light(targets.reshape(-1, *targets.shape[-2:])[place], 0.0, most)
        warn(
            f"{name} must have a mean intensity of at most {most:.4g}, the mean of the light on the modulator, "
            f"got {mean:.4g}, so that no hologram has a mean squared error below {bound:.3g}: give intensities of "
            "0 … 1 (8-bit values divided by 255)" + (f", or {remedy}" if remedy else ""),
            ArgumentWarning,
        )
    else:
        _validate.check_values(name, targets, "give intensities of 0 … 1 (8-bit values divided by 255)")


def checked_intensities(name: str, values: torch.Tensor) -> torch.Tensor:
    """Return a target in single or double precision after checking that it is finite and not negative."""
    real_tensor(name, values, "a torch.Tensor of real intensities")
    values = values.detach() if values.dtype in (torch.float32, torch.float64) else values.detach().float()
    if not bool(values.isfinite().all()) or bool((values < 0).any()):
        raise ValueError(f"{name} must be finite intensities of at least 0, got NaN, infinite or negative values")
    return trainable(values)


def best_scale(image: torch.Tensor, target: torch.Tensor, axes: tuple[int, ...] | None = (-2, -1)) -> torch.Tensor:
    """Return s = ⟨I, T⟩/⟨I, I⟩ over some axes, or all: the scale at which an image is closest to its target."""
    norm = (image * image).sum(axes, keepdim=True).clamp_min(torch.finfo(image.dtype).tiny)
    return (image * target).sum(axes, keepdim=True) / norm


def brightness_of(images: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the factor of each colour, over all else, at which images are closest to a target, ``[C, 1, 1]``.

    Both are ``[..., C, rows, columns]``.
    """
    axes = *range(images.ndim - 3), -2, -1
    return best_scale(images, target, axes).reshape(-1, 1, 1)


def started(
    name: str,
    given: torch.Tensor | None,
    shapes: Sequence[tuple[int, ...]],
    like: torch.Tensor,
    draw: Callable[..., torch.Tensor],
    names: Sequence[str] = (),
) -> torch.Tensor:
    """Return phases to start from: drawn as the first of some shapes, or given in one of them, as a copy.

    `draw(shape, dtype=)` draws them on the CPU, so that a seed gives the same start on every device.
    """
    if given is None:
        return draw(shapes[0], dtype=like.dtype).to(like.device)
    phase = floating(name, given).detach()
    _validate.real(name, phase.cpu())
    if tuple(phase.shape) not in shapes:
        accepted = " or ".join(str(list(shape)) for shape in dict.fromkeys(shapes))
        named = f", or one of {', '.join(map(repr, names))}" if names else ""
        raise ValueError(f"{name} must be {accepted}, which fits the target (targets){named}; got {list(phase.shape)}")
    return phase.to(like, copy=True)


def checked_noise(
    inject_noise: bool, noise_ratio: float, generator: torch.Generator | None = None
) -> tuple[bool, float, torch.Generator | None]:
    """Return whether and how targets get noise, and where it is drawn from, after checking each."""
    (noise_ratio,) = _validate.constants(noise_ratio=noise_ratio)
    injected, ratio = _validate.flag("inject_noise", inject_noise), _validate.real("noise_ratio", noise_ratio)
    return injected, ratio, checked_generator("generator", generator)


def with_noise(target: torch.Tensor, ratio: float, generator: torch.Generator | None) -> torch.Tensor:
    """Return a target with normal noise, of a standard deviation that is a share of the target's range."""
    spread = ratio * (target.amax() - target.amin())
    return target + spread * torch.empty_like(target).normal_(generator=generator)


def fingerprint(*tensors: torch.Tensor) -> str:
    """Return a short text that identifies tensors, by which a checkpoint is recognised."""
    digest = hashlib.sha256()
    for tensor in tensors:
        array = tensor.detach().resolve_conj().resolve_neg().cpu().contiguous().numpy()
        digest.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return digest.hexdigest()[:16]


def cosine(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls from `rate` to `lowest` along half a cosine (Loshchilov and Hutter, 2017)."""
    return lambda iteration: lowest + (rate - lowest) * (1 + math.cos(math.pi * iteration / iterations)) / 2


def linear(rate: float, lowest: float, iterations: int) -> Callable[[int], float]:
    """Return a learning rate that falls linearly from `rate` to `lowest`."""
    return lambda iteration: rate + (lowest - rate) * iteration / iterations
