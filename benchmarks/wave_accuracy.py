"""Predicted against actual errors of "auto", and vector fields, media and first-order systems against propagations."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
import torch
from measure import interleave

import odak
from odak.learn import wave

WAVELENGTH, PITCH = 532e-9, 8e-6
PITCHES, SHARES = (8e-6, 1e-6, 4e-7), (-0.3, 1.0, 3.0)
SHAPES = ((24, 24), (48, 48), (1, 1), (1, 24), (48, 1), (2, 24), (5, 40))
# Below this the reference sums are not more accurate than the results.
JUDGED_TO = 2e-12


def _exact(field: np.ndarray, distance: float, dx: float) -> np.ndarray:
    """Return the field by Gauss-Legendre quadrature over its band, whose waves all travel, at each lag."""
    z, band = abs(distance), 0.5 / dx
    reach = z * band / math.sqrt(1 / WAVELENGTH**2 - 2 * band**2) / dx
    nodes, weights = np.polynomial.legendre.leggauss(int(2.5 * (reach + max(field.shape)) + 100))
    frequency = nodes * band
    squared = frequency[:, None] ** 2 + frequency**2
    # Less the phase of the axial wave, whose whole cycles would take digits.
    cycles = math.fmod(z, WAVELENGTH) / WAVELENGTH - z * squared / (
        np.sqrt(1 / WAVELENGTH**2 - squared) + 1 / WAVELENGTH
    )
    transfer = np.exp(math.copysign(2, distance) * 1j * np.pi * cycles) * np.outer(weights, weights) / 4
    down, across = (np.exp(2j * np.pi * dx * np.outer(np.arange(n), frequency)) for n in field.shape)
    response = down @ transfer @ across.T
    # Even in both lags.
    indices = [np.abs(np.concatenate([np.arange(n), np.arange(-n, 0)])) for n in field.shape]
    lags = np.pad(response, ((0, 1), (0, 1)))[np.ix_(*indices)]
    rows, columns = field.shape
    return np.fft.ifft2(np.fft.fft2(lags) * np.fft.fft2(field, lags.shape))[:rows, :columns]


def _fields(shape: tuple[int, int]) -> dict[str, np.ndarray]:
    """Return a smooth, a rough, a sharp and a slanting field."""
    (rows, columns), (y, x) = shape, (np.arange(n) - n // 2 for n in shape)
    down, across = (
        np.cos(np.pi / 2 * np.clip(np.abs(at) * 4 / n - 1, 0, 1)) ** 2 for at, n in zip((y, x), shape, strict=True)
    )
    return {
        "Gaussian": np.exp(-((y[:, None] * 8 / rows) ** 2) - (x * 8 / columns) ** 2) + 0j,
        "random phase": np.exp(2j * np.pi * np.random.default_rng(0).random(shape)),
        "slit": ((np.abs(x) < max(columns / 10, 1)) & (np.abs(y) < max(rows / 4, 1))[:, None]) + 0j,
        "tilted plane wave": np.exp(2j * np.pi * 0.2 * x) * across * down[:, None],
    }


def predicted_error(device: str) -> Iterator[dict]:
    """Yield, for each kind of field, the extremes of predicted over actual error over pitches, shapes, distances."""
    del device  # in double precision on the CPU
    worst: dict[str, list] = {}
    for dx, shape, share in itertools.product(PITCHES, SHAPES, SHARES):
        distance = share * max(shape) * dx**2 / WAVELENGTH
        for kind, field in _fields(shape).items():
            exact = _exact(field, distance, dx)
            found = odak.wave.propagate_beam(field, None, distance, dx, WAVELENGTH, "auto")
            report = odak.wave.sampling_report(field.shape, dx, WAVELENGTH, distance, field=field)
            actual = np.linalg.norm(found - exact) / np.linalg.norm(exact)
            ratio = (report.predicted_error + JUDGED_TO) / (actual + JUDGED_TO)
            worst.setdefault(kind, []).append((ratio, actual))
    for kind, rows in worst.items():
        ratios, errors = zip(*rows, strict=True)
        for name, ratio, bound in (("largest", max(ratios), 10.0), ("actual over", 1 / min(ratios), 1.0)):
            yield {
                "task": f"{name} predicted error, {kind}",
                "ours_arrays": max(errors),
                "floor": "actual error",
                "ratio": ratio,
                "bound": bound,
            }


def _row(task: str, ours, floor, name: str, bound: float | None, device: str) -> dict:
    timings = interleave({"ours": ours, "floor": floor}, 7, device)
    best = {key: timing.best for key, timing in timings.items()}
    return {
        "task": task,
        "ours_s": best["ours"],
        "floor_s": best["floor"],
        "floor": name,
        "ratio": best["ours"] / best["floor"],
        "bound": bound,
    }


def choice(device: str) -> Iterator[dict]:
    """Yield "auto" against the same propagation by name: the time of the choice in a loop."""
    for n in (128, 512):
        field = torch.randn(n, n, dtype=torch.complex64, device=device)

        def by(name, field=field):
            wave.propagate_beam(field, None, 0.05, PITCH, WAVELENGTH, name)

        def chosen(by=by):
            by("auto")

        def named(by=by):
            by("Bandlimited Angular Spectrum")

        yield _row(f"auto, {n}", chosen, named, "propagate_beam", 1.1, device)


def vector(device: str) -> Iterator[dict]:
    """Yield a polarised field against two bare padded pairs of transforms and against two scalar propagations."""
    n = 512
    field = torch.randn(2, n, n, dtype=torch.complex64, device=device)
    padded = torch.randn(2 * n, 2 * n, dtype=torch.complex64, device=device)

    def ours():
        wave.propagate_beam(field, None, 0.02, PITCH, WAVELENGTH)

    def scalars():
        for component in field:
            wave.propagate_beam(component, None, 0.02, PITCH, WAVELENGTH)

    def bare():
        for _ in range(2):
            torch.fft.ifft2(torch.fft.fft2(padded))

    yield _row("polarised field, 512", ours, bare, "4 fft2", 1.3, device)
    yield _row("polarised field, 512", ours, scalars, "2 scalar", 1.2, device)


def media(device: str) -> Iterator[dict]:
    """Yield slices of a medium by both methods against the bare transforms of an unpadded propagation."""
    n, slices = 256, 16
    field = torch.randn(n, n, dtype=torch.complex64, device=device)
    index = 1 + 0.02 * torch.rand(slices, n, n, device=device)
    glass = torch.where(index > 1.01, 1.5, 1.0)

    def bare():
        for _ in range(slices):
            torch.fft.ifft2(torch.fft.fft2(field))

    def split():
        wave.propagate_through_medium(field, index, 1e-6, 1e-6, WAVELENGTH, reference=1.01)

    def waves():
        wave.propagate_through_medium(field, glass, 1e-6, 1e-6, WAVELENGTH, "wave propagation")

    yield _row("split-step, 16 slices, 256", split, bare, "32 fft2", 3.0, device)
    # Two indices take one transform there and one back for each: 48 of them.
    yield _row("wave propagation, 16 slices of two indices, 256", waves, bare, "32 fft2", None, device)


def first_order(device: str) -> Iterator[dict]:
    """Yield a first-order system against the bare transforms of a padded propagation of the same size."""
    n = 512
    field = torch.randn(n, n, dtype=torch.complex64, device=device)
    padded = torch.randn(2 * n, 2 * n, dtype=torch.complex64, device=device)
    matrix = ((-0.5, 0.1), (-10.0, 0.0))

    def ours():
        wave.propagate_abcd(field, matrix, PITCH, WAVELENGTH)

    def bare():
        torch.fft.ifft2(torch.fft.fft2(padded))

    assert math.isclose(matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0], 1.0)
    yield _row("first-order system, 512", ours, bare, "2 fft2", 3.0, device)


ALL = (predicted_error, choice, vector, media, first_order)
