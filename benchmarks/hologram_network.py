"""The hologram network on pictures that it has not seen, beside gradient descent and double phase.

    python benchmarks/hologram_network.py [--side 256] [--part qualities]

The pictures that come with odak, at three geometries, the last outside the range of the training, and the one that has
a depth map, on several planes. The quality is the PSNR of the intensity in focus at the brightness that fits best, by
an angular spectrum in complex128 on a grid of four times the width. Times are of the processor, for one picture of
1080 × 1920 pixels. The guide "A network that computes holograms" shows the output.
"""

import argparse
import math
import time
import warnings
from importlib.resources import files

import numpy as np
import torch

import odak
from odak.learn.models import hologram_network
from odak.learn.tools import load_image
from odak.learn.wave import double_phase_hologram, propagate_beam, stochastic_gradient_descent

# Wavelength, pitch, distance.
GEOMETRIES = ((532e-9, 8e-6, 5e-3), (638e-9, 3.74e-6, 3e-3), (520e-9, 8e-6, 0.03))
# Wavelength, pitch, distances of the planes.
VOLUMES = (
    (532e-9, 8e-6, (4e-3, 6e-3)),
    (532e-9, 8e-6, (3e-3, 4e-3, 5e-3, 6e-3, 7e-3)),
    (638e-9, 3.74e-6, (2e-3, 3e-3, 4e-3)),
)
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
    return psnr(propagated(phase, wavelength, dx, distance, cutoff, padding), target)


def propagated(phase, wavelength, dx, distance, cutoff=np.inf, padding: int = 4) -> np.ndarray:
    """Return the intensity of a hologram's image."""
    rows, columns = phase.shape
    shape = (padding * rows, padding * columns)
    squared = np.fft.fftfreq(shape[0], dx)[:, None] ** 2 + np.fft.fftfreq(shape[1], dx) ** 2
    transfer = np.exp(2j * np.pi * distance * np.sqrt(1 / wavelength**2 - squared)) * (squared <= cutoff**2)
    field = np.exp(1j * phase.numpy().astype(np.float64))
    return abs(np.fft.ifft2(np.fft.fft2(field, shape) * transfer)[:rows, :columns]) ** 2


def psnr(image: np.ndarray, target: torch.Tensor) -> float:
    """Return the PSNR in dB at the brightness that fits best."""
    target = target.numpy().astype(np.float64)
    image = image * ((image * target).sum() / (image**2).sum())
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


def depth_of_scene(side: int) -> torch.Tensor:
    """Return the depth of the pixels of the picture "scene", 0 … 1, without values between near and far."""
    depth = load_image(str(files("odak") / "assets" / "scene_depth.png")).float()
    rows, columns = depth.shape
    width = min(rows, columns)
    top, left = (rows - width) // 2, (columns - width) // 2
    part = depth[None, None, top : top + width, left : left + width]
    return torch.nn.functional.interpolate(part, (side, side), mode="nearest-exact")[0, 0]


def descent_on_planes(target, masks, geometry, start, steps) -> tuple[torch.Tensor, list[float]]:
    """Return the phase after steps of Adam on the squared error in focus, and the PSNR before each step."""
    (wavelength, dx, distances), trace = geometry, []
    phase = start.clone().requires_grad_()
    optimizer = torch.optim.Adam([phase], 0.2)
    for _ in range(steps):
        optimizer.zero_grad()
        hologram, image = torch.polar(torch.ones_like(phase), phase), 0
        for mask, distance in zip(masks, distances, strict=True):
            image = image + mask * propagate_beam(hologram, None, distance, dx, wavelength, "auto").abs().square()
        loss = (image * ((image * target).sum() / image.square().sum()).detach() - target).square().mean()
        loss.backward()
        optimizer.step()
        trace.append(-10 * math.log10(loss.item()))
    return phase.detach(), trace


def print_planes(network, side: int) -> None:
    """Print the quality of a picture with depth at each geometry."""
    target, depth = picture("scene", (side, side)), depth_of_scene(side)
    columns = []
    for wavelength, dx, distances in VOLUMES:
        geometry = (wavelength, dx, distances)
        # The plane nearest to each pixel.
        masks = [(depth * (len(distances) - 1)).round() == plane for plane in range(len(distances))]

        def in_focus(phase, geometry=geometry, masks=masks):
            lengths, places = geometry[:2], geometry[2]
            parts = zip(masks, places, strict=True)
            return psnr(sum(mask.numpy() * propagated(phase, *lengths, z) for mask, z in parts), target)

        found, warm = {}, None
        for network.refinements in (2, 8, 24):
            with torch.no_grad():
                phase = network(target, *geometry, depth)
            found[f"network, refinements: {network.refinements}"] = in_focus(phase)
            warm = phase if network.refinements == 8 else warm
        noise = 2 * torch.pi * torch.rand(target.shape, generator=torch.Generator().manual_seed(0))
        default = None
        for name, start in (("noise", noise), ("network, refinements: 8", warm)):
            phase, trace = descent_on_planes(target, masks, geometry, start, STEPS)
            found[f"{STEPS} steps from {name}"] = in_focus(phase)
            default = trace[-1] if default is None else default
            steps = next((step for step, value in enumerate(trace) if value >= default), STEPS)
        found[f"steps to the quality of {STEPS} from noise, from the network"] = steps
        columns.append(found)
    places = (", ".join(f"{z * 1e3:g}" for z in distances) for *_, distances in VOLUMES)
    head = [f"{w * 1e9:.0f} nm, {dx * 1e6:g} µm, {z} mm" for (w, dx, _), z in zip(VOLUMES, places, strict=True)]
    print(f"\n| planes of {side} × {side} | {' | '.join(head)} |\n|---|{'---|' * len(VOLUMES)}")
    for name in columns[0]:
        print(f"| {name} | {' | '.join(f'{column[name]:.1f}' for column in columns)} |", flush=True)


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
    parser.add_argument("--part", choices=["qualities", "planes", "times"], help="one of the tables alone")
    given = parser.parse_args()
    torch.set_num_threads(1)
    network = hologram_network(pretrained=True)
    if given.part in (None, "qualities"):
        print_qualities(network, given.side)
    if given.part in (None, "planes"):
        print_planes(network, given.side)
    if given.part in (None, "times"):
        print_times(network)


if __name__ == "__main__":
    main()
