"""The hologram network on pictures that it has not seen, beside gradient descent and double phase.

    python benchmarks/hologram_network.py [--side 256] [--part qualities]

The pictures that come with odak, at three geometries, the last outside the range of the training. The quality is the
PSNR of the intensity at the brightness that fits best, by an angular spectrum in complex128 on a grid of four times the
width. Times are of the processor, for one picture of 1080 × 1920 pixels. The guide
"A network that computes holograms" shows its output.
"""

import argparse
import time
import warnings
from importlib.resources import files

import numpy as np
import torch

import odak
from odak.learn.models import hologram_network
from odak.learn.tools import load_image
from odak.learn.wave import double_phase_hologram, stochastic_gradient_descent

# Wavelength, pitch, distance.
GEOMETRIES = ((532e-9, 8e-6, 5e-3), (638e-9, 3.74e-6, 3e-3), (520e-9, 8e-6, 0.03))
NAMES = ("photo", "scene", "chart")
STEPS = 200


def picture(name: str, shape: tuple[int, int]) -> torch.Tensor:
    """Return a picture that comes with odak as intensities 0 … 1, its middle part if the proportions differ."""
    image = load_image(str(files("odak") / "assets" / f"{name}.png")).float()
    image = image.mean(-1) if image.ndim == 3 else image
    rows, columns = image.shape
    least = min(rows / shape[0], columns / shape[1])
    height, width = int(least * shape[0]), int(least * shape[1])
    top, left = (rows - height) // 2, (columns - width) // 2
    part = image[None, None, top : top + height, left : left + width]
    return torch.nn.functional.interpolate(part, shape, mode="bicubic", antialias=True)[0, 0].clamp(0, 1)


def judged(phase, target, wavelength, dx, distance, cutoff=np.inf, padding: int = 4) -> float:
    """Return the PSNR in dB by an independent propagation in double precision."""
    target = target.numpy().astype(np.float64)
    rows, columns = target.shape
    shape = (padding * rows, padding * columns)
    squared = np.fft.fftfreq(shape[0], dx)[:, None] ** 2 + np.fft.fftfreq(shape[1], dx) ** 2
    transfer = np.exp(2j * np.pi * distance * np.sqrt(1 / wavelength**2 - squared)) * (squared <= cutoff**2)
    field = np.exp(1j * phase.numpy().astype(np.float64))
    image = abs(np.fft.ifft2(np.fft.fft2(field, shape) * transfer)[:rows, :columns]) ** 2
    image *= (image * target).sum() / (image**2).sum()
    return float(-10 * np.log10(((image - target) ** 2).mean()))


def descent(target, geometry, start, steps) -> tuple[torch.Tensor, list[float]]:
    """Return the phase after gradient descent, and the PSNR before each step."""
    (wavelength, dx, distance), trace = geometry, []
    hologram, _ = stochastic_gradient_descent(
        target, wavelength, distance, dx, n_iteration=steps, learning_rate=0.2, initial_phase=start, scale=True,
        seed=0, progress=False, callback=lambda step, loss: trace.append(-10 * float(loss.log10())),
    )  # fmt: skip
    return hologram.angle(), trace


def qualities(network, target, geometry) -> dict[str, float]:
    """Return the PSNR of each method, and the steps that warm starts need."""
    wavelength, dx, distance = geometry
    found, warm = {}, None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", odak.AccuracyWarning)
        double = double_phase_hologram(target, wavelength, distance, dx, iris=False)[0].angle()
    found["double phase, no iris"] = judged(double, target, *geometry)
    double = double_phase_hologram(target, wavelength, distance, dx)[0].angle()
    found["double phase, iris of half the band"] = judged(double, target, *geometry, cutoff=0.25 / dx)
    for network.refinements in (2, 8, 24):
        with torch.no_grad():
            phase = network(target, wavelength, dx, distance)
        found[f"network, refinements: {network.refinements}"] = judged(phase, target, *geometry)
        warm = phase if network.refinements == 8 else warm
    traces = {}
    for name, start in (("noise, the default", None), ('"gs"', "gs"), ("network, refinements: 8", warm)):
        phase, traces[name] = descent(target, geometry, start, STEPS)
        found[f"{STEPS} steps from {name}"] = judged(phase, target, *geometry)
    default, *_ = traces.values()
    for name, trace in list(traces.items())[1:]:
        reached = next((step for step, value in enumerate(trace) if value >= default[-1]), STEPS)
        found[f"steps to the quality of {STEPS} from noise, from {name}"] = reached
    for steps in (5, 25):
        found[f'the quality after {steps} steps from "gs"'] = traces['"gs"'][steps]
    return found


def print_qualities(network, side: int) -> None:
    """Print the mean over the pictures at each geometry."""
    columns = []
    for geometry in GEOMETRIES:
        rows = [qualities(network, picture(name, (side, side)), geometry) for name in NAMES]
        columns.append({name: np.mean([row[name] for row in rows]) for name in rows[0]})
    head = (f"{w * 1e9:.0f} nm, {dx * 1e6:g} µm, {z * 1e3:g} mm" for w, dx, z in GEOMETRIES)
    print(f"| {side} × {side} | {' | '.join(head)} |\n|---|{'---|' * len(GEOMETRIES)}")
    for name in columns[0]:
        print(f"| {name} | {' | '.join(f'{column[name]:.1f}' for column in columns)} |")


def print_times(network) -> None:
    """Print the processor time of a picture of 1080 × 1920 pixels, and the quality."""
    geometry = GEOMETRIES[0]
    target = picture("photo", (1080, 1920))
    print("\n| 1080 × 1920, one thread | time (s) | PSNR (dB) |\n|---|---|---|")

    def timed(name, function):
        start = time.process_time()
        phase = function()
        spent = time.process_time() - start
        print(f"| {name} | {spent:.1f} | {judged(phase, target, *geometry, padding=2):.1f} |", flush=True)

    # What is made once for a geometry, the kernel above all, is not of the time of a picture.
    network.refinements = 1
    with torch.no_grad():
        network(target, *geometry)
    for refinements in (2, 8):
        network.refinements = refinements
        with torch.no_grad():
            timed(f"network, refinements: {refinements}", lambda: network(target, *geometry))
    for steps in (5, 20):
        timed(f'{steps} steps from "quadratic"', lambda n=steps: descent(target, geometry, "quadratic", n)[0])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=256)
    parser.add_argument("--part", choices=["qualities", "times"], help="one of the tables alone")
    given = parser.parse_args()
    torch.set_num_threads(1)
    network = hologram_network(pretrained=True)
    if given.part != "times":
        print_qualities(network, given.side)
    if given.part != "qualities":
        print_times(network)


if __name__ == "__main__":
    main()
