"""Gaussian benchmarks: pictures and fields of many Gaussians against the formula, computed for all pixels in parts."""

import json
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator

import torch
from measure import interleave
from torch.utils.checkpoint import checkpoint
from wave_optics import row

from odak.learn.models import gaussians_2d
from odak.learn.wave import Scene2D, complex_2d_gaussians
from odak.learn.wave.gaussians.splatting import Tiling, composite_gaussians

NUMBER, SIDE = 10_000, 512
# Pixels of one part of the bare formula, few enough that all Gaussians stay in the cache, and the share of all pixels
# that it is timed on.
PART, SHARE = 64, 32


def pixels(side: int, device: str) -> torch.Tensor:
    """Return the coordinates [x, y] of the pixels of a square picture ``[side², 2]``."""
    steps = torch.arange(side, dtype=torch.float32, device=device)
    return torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1).reshape(-1, 2)


def bells(places: torch.Tensor, means: torch.Tensor, conics: torch.Tensor) -> torch.Tensor:
    """Return exp of the quadratic form of every Gaussian at every place ``[n, places]``."""
    dx, dy = (places[:, axis] - means[:, axis, None] for axis in (0, 1))
    a, b, c = (conic[:, None] for conic in conics.unbind(-1))
    return torch.exp(torch.clamp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy), min=-50))


def bare_field(model: complex_2d_gaussians, places: torch.Tensor) -> torch.Tensor:
    """Return the field as one would write it: real and imaginary parts as one product, pixels in parts."""
    scales, rotation, phase, opacities, means = model.apply_activations()
    conics = torch.stack(model.invert_cov_2D(*model.compute_cov_2D(scales, rotation)), dim=-1)
    weights = torch.polar(model.colours * opacities[:, None], phase)
    rows = torch.cat([weights.real, weights.imag], dim=-1).T

    def drawn(part):
        return rows @ bells(part, means, conics)

    needed = torch.is_grad_enabled()
    parts = [checkpoint(drawn, part, use_reentrant=False) if needed else drawn(part) for part in places.split(PART)]
    return torch.cat(parts, dim=1)


def field_model(side: int, device: str) -> tuple[complex_2d_gaussians, Scene2D]:
    """Return Gaussians of the default sizes, 1.6 to 5.1 pixels, and their scene."""
    model = complex_2d_gaussians(NUMBER, (side, side), device, seed=0)
    model.make_trainable()
    return model, Scene2D(model, Namespace(wavelengths=[639e-9, 532e-9, 473e-9], pad_size=[side, side]))


def slope(model: torch.nn.Module, picture: Callable) -> None:
    """Run a picture forward and backward."""
    model.zero_grad()
    picture().abs().square().sum().backward()


def complex_field(device: str) -> Iterator[dict]:
    """Yield 10 000 complex Gaussians of three colours against the bare formula, forward, and with gradients."""
    model, scene = field_model(SIDE, device)
    places = pixels(SIDE, device)[::SHARE]
    forward = {"bare": lambda: bare_field(model, places), "ours": lambda: scene.render((SIDE, SIDE))}
    with torch.no_grad():
        timings = interleave(forward, 3, device)
    yield compared("complex Gaussians, 10k at 512²", timings)
    both = {name: lambda picture=picture: slope(model, picture) for name, picture in forward.items()}
    yield compared("  forward and backward", interleave(both, 3, device))


def compared(task: str, timings: dict, share: int = SHARE, bound: float = 0.5) -> dict:
    """Return a row in which the bare formula's time is that of a share of the pixels, times their number."""
    return row(task, timings["ours"].best, share * timings["bare"].best, f"{share} × bare", bound)


def bare_picture(model: gaussians_2d, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """Return the picture as one would write it, points in parts."""
    parts = zip(x.split(PART), y.split(PART), strict=True)
    if torch.is_grad_enabled():
        sums = [checkpoint(lambda x, y: model.model(x, y).sum(-1), *part, use_reentrant=False) for part in parts]
    else:
        sums = [model.model(*part).sum(-1) for part in parts]
    return torch.cat(sums)


def real_picture(device: str) -> Iterator[dict]:
    """Yield `gaussians_2d` against the bare formula: as first drawn, each over much of the picture; and narrow ones."""
    torch.manual_seed(0)
    model = gaussians_2d(NUMBER).to(device)
    for task, side, width in (
        ("wide Gaussians, 10k at 128²", 128, None),
        ("narrow Gaussians, 10k at 512²", SIDE, 0.01),
    ):
        if width is not None:
            model.model.initialize_parameters_uniformly({"widths": (width / 2, 3 * width / 2)})
        x, y = (2 / (side - 1) * pixels(side, device) - 1).split(1, dim=-1)
        share, bound = side**2 // (32 * PART), 1.0 if width is None else 0.5
        some = [coordinate[::share] for coordinate in (x, y)]
        forward = {
            "bare": lambda some=some: bare_picture(model, *some),
            "ours": lambda x=x, y=y: model(x, y),
        }
        with torch.no_grad():
            timings = interleave(forward, 3, device)
        yield compared(task, timings, share, bound)
        both = {name: lambda picture=picture: slope(model, picture) for name, picture in forward.items()}
        yield compared("  forward and backward", interleave(both, 3, device), share, bound)


def occlusion(device: str) -> Iterator[dict]:
    """Yield 1 000 Gaussians that hide each other, against a cumulative product over all of them at all pixels."""
    number, side = 1000, 256
    model, _ = field_model(side, device)
    scales, rotation, phase, opacities, means = (value[:number].detach() for value in model.apply_activations())
    conics = torch.stack(model.invert_cov_2D(*model.compute_cov_2D(scales, rotation)), dim=-1)
    weights = torch.polar(model.colours[:number].detach(), phase)
    rows, places = torch.cat([weights.real, weights.imag], dim=-1).T, pixels(side, device)
    layers, tiling = torch.zeros(number, dtype=torch.long, device=device), Tiling(side, side, 64, 64)

    def bare():
        alpha = opacities[:, None] * bells(places, means, conics)
        passed = torch.cat([torch.ones_like(alpha[:1]), 1 - alpha[:-1]]).cumprod(0)
        return rows @ (alpha * passed.where(passed >= 1e-4, 0.0))

    def ours():
        return composite_gaussians(means, conics, opacities, weights, layers, tiling)

    timings = interleave({"bare": bare, "ours": ours}, 3, device)
    yield row("occluding Gaussians, 1k at 256²", timings["ours"].best, timings["bare"].best, "bare formula", 1.0)


def memory(device: str) -> Iterator[dict]:
    """Yield the peak memory of a field forward and backward, in fields of three colours (6 MB each).

    One number for each Gaussian and pixel would take 10 GB, 1667 of them.
    """
    code = (
        "import json, sys; sys.path.insert(0, 'benchmarks'); import torch; from measure import peak_memory; "
        f"import gaussians; gaussians.NUMBER = 100; model, scene = gaussians.field_model(64, {device!r}); "
        "gaussians.slope(model, lambda: scene.render((64, 64))); "
        f"gaussians.NUMBER = {NUMBER}; model, scene = gaussians.field_model({SIDE}, {device!r}); "
        f"before = peak_memory({device!r}); gaussians.slope(model, lambda: scene.render(({SIDE}, {SIDE}))); "
        f"print(json.dumps(peak_memory({device!r}) - before))"
    )
    # Through a shell, because a process inherits the peak memory of the one from which it was forked.
    command = ["sh", "-c", '"$0" -c "$1"; exit $?', sys.executable, code]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    arrays = json.loads(output) / (3 * 8 * SIDE**2)
    yield {
        "task": "  at 512², forward and backward, peak memory",
        "ours_arrays": arrays,
        "floor": "complex64 [3, H, W]",
        "bound": 30.0,
        "ratio": arrays,
    }


ALL = (complex_field, memory, real_picture, occlusion)
