"""Benchmarks of modulators, cameras and spots: each against a direct implementation, in the same process."""

import math
from collections.abc import Callable, Iterator

import torch
from measure import interleave

from odak.learn import wave

WAVELENGTH, DISTANCE, PITCH, FOCAL = 532e-9, 0.05, 8e-6, 0.1
SPOTS, TURNS = 100, 5


def _row(task: str, ours: Callable, other: Callable, name: str, bound: float | None, device: str) -> dict:
    best = {key: timing.best for key, timing in interleave({"ours": ours, "other": other}, 3, device).items()}
    return {
        "task": task,
        "ours_s": best["ours"],
        "floor_s": best["other"],
        "floor": name,
        "ratio": best["ours"] / best["other"],
        "bound": bound,
    }


def spots_in_space(device: str) -> Iterator[dict]:
    """Yield five iterations for 100 spots in space on 512 × 512 pixels, against a loop over the spots."""
    n, generator = 512, torch.Generator().manual_seed(0)
    points = (torch.rand(SPOTS, 3, generator=generator) - 0.5) * torch.tensor([2e-3, 2e-3, 1e-2])
    points = points.to(device)
    place = (torch.arange(n, dtype=torch.float64, device=device) - n // 2) * PITCH

    def lens(point):
        x, y, z = (value.double() for value in point)
        radius = place[:, None] ** 2 + place**2
        cycles = (place[:, None] * y + place * x) / (WAVELENGTH * FOCAL) + z * radius / (2 * WAVELENGTH * FOCAL**2)
        angle = (2 * math.pi * (cycles - cycles.round())).float()
        return torch.polar(torch.ones_like(angle), angle)

    def one_by_one():
        lenses = [lens(point) for point in points]
        light = torch.ones(SPOTS, dtype=torch.complex64, device=device)
        weights = torch.ones(SPOTS, device=device)
        for _ in range(TURNS):
            total = sum(weight * own * lens for weight, own, lens in zip(weights, light, lenses, strict=True))
            hologram = total / total.abs()
            light = torch.stack([(lens.conj() * hologram).sum() for lens in lenses])
            weights = weights * light.abs().mean() / light.abs()
            light = light / light.abs()

    yield _row(
        "100 spots in space, 5 turns, 512",
        lambda: wave.spot_hologram(points, (n, n), WAVELENGTH, PITCH, TURNS, FOCAL, seed=0),
        one_by_one,
        "spot by spot",
        0.5,
        device,
    )


def thousand_spots(device: str) -> Iterator[dict]:
    """Yield ten iterations for 1000 spots in space at 1080 × 1920, uniform to 0.999, against 20 padded transforms."""
    generator = torch.Generator().manual_seed(0)
    points = (torch.rand(1000, 3, generator=generator) - 0.5) * torch.tensor([4e-3, 4e-3, 2e-2])
    points, field = points.to(device), torch.randn(2160, 3840, dtype=torch.complex64, device=device)

    def bare():
        for _ in range(20):
            torch.fft.fft2(field)

    yield _row(
        "1000 spots in space, 10 turns, 1080p",
        lambda: wave.spot_hologram(points, (1080, 1920), WAVELENGTH, PITCH, 10, 2 * FOCAL, seed=0),
        bare,
        "20 padded fft2",
        None,
        device,
    )


def far_image(device: str) -> Iterator[dict]:
    """Yield ten iterations of a far-field image of 1024 × 1024 against the two transforms of each."""
    target = torch.rand(1024, 1024, device=device)
    field = torch.randn(1024, 1024, dtype=torch.complex64, device=device)

    def bare():
        for _ in range(20):
            torch.fft.fft2(field)

    yield _row(
        "far-field image, 10 turns, 1024",
        lambda: wave.weighted_gerchberg_saxton(target, 10, seed=0),
        bare,
        "20 fft2",
        None,
        device,
    )


def modulator(device: str) -> Iterator[dict]:
    """Yield the model of a modulator with its gradient against exp(iφ) of plain autograd."""
    phase = (20 * torch.rand(1080, 1920, device=device)).requires_grad_()
    slm = wave.spatial_light_modulator(bits=8, crosstalk=0.3, fill_factor=0.93, zero_order=0.02).to(device)

    def shown(field):
        (phase.grad,) = torch.autograd.grad(field.real.sum(), phase)

    yield _row(
        "modulator with levels, crosstalk, gaps; gradient",
        lambda: shown(slm(phase)),
        lambda: shown(torch.exp(1j * phase)),
        "exp(iφ)",
        None,
        device,
    )


def camera(device: str) -> Iterator[dict]:
    """Yield a captured image against the propagation alone."""
    phase = 6 * torch.rand(1080, 1920, device=device)
    field = torch.polar(torch.ones_like(phase), phase)
    display = wave.simulated_camera(WAVELENGTH, DISTANCE, PITCH, read_noise=5.0, bits=12, seed=0).to(device)
    yield _row(
        "captured image with shot and read noise",
        lambda: display(phase),
        lambda: wave.propagate_beam(field, None, DISTANCE, PITCH, WAVELENGTH),
        "propagation",
        None,
        device,
    )


ALL = (spots_in_space, thousand_spots, far_image, modulator, camera)
