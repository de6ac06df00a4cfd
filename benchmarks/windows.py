"""Benchmarks of windows, tilted planes and partial coherence: each against a direct implementation."""

import math
from collections.abc import Callable, Iterator

import torch
from measure import interleave

from odak.learn import wave

WAVELENGTH, DISTANCE, PITCH = 532e-9, 0.05, 8e-6
ZOOM = 8


def _row(
    task: str, ours: Callable, other: Callable, name: str, bound: float | None, device: str, runs: int = 3
) -> dict:
    timings = interleave({"ours": ours, "other": other}, 5, device)
    best = {key: timing.best for key, timing in timings.items()}
    return {
        "task": task,
        "ours_s": best["ours"],
        "floor_s": best["other"],
        "floor": name,
        "ratio": best["ours"] / best["other"],
        "bound": bound,
    }


def zoom(device: str) -> Iterator[dict]:
    """Yield a window of 256 × 256 at an eighth of the pitch against the whole plane at that pitch."""
    field = torch.randn(256, 256, dtype=torch.complex64, device=device)

    def ours():
        wave.propagate_to_window(field, WAVELENGTH, DISTANCE, PITCH, (256, 256), PITCH / ZOOM, (2e-4, -3e-4))

    def fine_grid():
        spectrum = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(field)))
        room = (256 * ZOOM - 256) // 2
        spectrum = torch.nn.functional.pad(spectrum, [room] * 4)
        fine = torch.fft.fftshift(torch.fft.ifft2(torch.fft.ifftshift(spectrum)))
        wave.propagate_beam(fine, None, DISTANCE, PITCH / ZOOM, WAVELENGTH)

    yield _row("window, 8 times finer, 256", ours, fine_grid, "fine grid", 0.5, device)


def same_grid(device: str) -> Iterator[dict]:
    """Yield a window that is the field's own grid against ordinary padded propagation."""
    field = torch.randn(512, 512, dtype=torch.complex64, device=device)
    yield _row(
        "window, the field's own grid, 512",
        lambda: wave.propagate_to_window(field, WAVELENGTH, DISTANCE, PITCH),
        lambda: wave.propagate_beam(field, None, DISTANCE, PITCH, WAVELENGTH),
        "propagate_beam",
        None,
        device,
    )


def tilted(device: str) -> Iterator[dict]:
    """Yield a plane tilted by 30° against the sum over all pairs of points."""
    n = 64
    field = torch.randn(n, n, dtype=torch.complex64, device=device)
    axis = (torch.arange(n, dtype=torch.float64, device=device) - n // 2) * PITCH
    y, x = torch.meshgrid(axis, axis, indexing="ij")
    angle = math.radians(30)

    def ours():
        wave.propagate_to_tilted_plane(field, WAVELENGTH, DISTANCE, PITCH, (0.0, 30.0, 0.0))

    def direct_sum():
        along = (x * math.cos(angle)).reshape(-1, 1) - x.reshape(1, -1)
        depth = DISTANCE - (x * math.sin(angle)).reshape(-1, 1)
        r = torch.sqrt(along**2 + (y.reshape(-1, 1) - y.reshape(1, -1)) ** 2 + depth**2)
        kernel = torch.exp(2j * math.pi * (r / WAVELENGTH % 1)) * (depth / r**2 * PITCH**2 / (1j * WAVELENGTH))
        kernel.to(torch.complex64) @ field.reshape(-1)

    yield _row("tilted plane, 64", ours, direct_sum, "direct sum", 0.5, device)


def tilted_against_plain(device: str) -> Iterator[dict]:
    """Yield planes tilted about one axis and about any, again and again, against an ordinary padded propagation."""
    for n, dtype in ((256, torch.complex64), (512, torch.complex64), (512, torch.complex128), (1024, torch.complex64)):
        field = torch.randn(n, n, dtype=dtype, device=device)

        def plain(field=field):
            wave.propagate_beam(field, None, DISTANCE, PITCH, WAVELENGTH)

        for about, angles in (
            ("y", (0.0, 30.0, 0.0)),
            ("x", (10.0, 0.0, 0.0)),
            ("x and y", (10.0, 20.0, 0.0)),
            ("x, y and z", (10.0, 20.0, 30.0)),
        ):

            def ours(field=field, angles=angles):
                wave.propagate_to_tilted_plane(field, WAVELENGTH, DISTANCE, PITCH, angles)

            yield _row(f"plane tilted about {about}, {n}, {str(dtype)[6:]}", ours, plain, "propagate_beam", 5.0, device)


def partial_coherence(device: str) -> Iterator[dict]:
    """Yield three wavelengths of 24 directions against as many coherent propagations, one by one."""
    field = torch.randn(256, 256, dtype=torch.complex64, device=device)
    spectrum, source = wave.gaussian_spectrum(WAVELENGTH, 1e-8, 3), wave.disk_source(1e-3, 2, 12)

    def one_by_one():
        for wavelength in spectrum[0].tolist():
            for _ in range(24):
                wave.propagate_to_window(field, wavelength, DISTANCE, PITCH)

    yield _row(
        "partial coherence, 3 wavelengths, 24 directions, 256",
        lambda: wave.propagate_partially_coherent(field, spectrum, source, DISTANCE, PITCH),
        one_by_one,
        "one by one",
        1.3,
        device,
    )


ALL = (zoom, same_grid, tilted, tilted_against_plain, partial_coherence)
