"""Makes odak/assets/hologram_network.pt, the weights of odak.learn.models.hologram_network, seed 2026.

    python scripts/train_hologram_network.py [--device cuda] [--checkpoint training.pt] [--file FILE]

Learns from pictures that are drawn here (shapes, strokes, gradients, textures, fractal noise) and from parts of those
that come with scikit-image. What comes with odak (odak/assets) is not among them and is left for the tests of
``benchmarks/hologram_network.py``. Each batch has a geometry, a number of refinements and a number of planes of its
own; the depth of the pixels is another of the drawn pictures. Half of the batches repeat their pictures without end,
which stands for the inside of large pictures. The loss is the error of the amplitude in focus, at the brightness that
fits best, in decibels, computed through the propagation.
"""

import argparse
import math
import sys
import time
from importlib.resources import files

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from skimage import data

from odak.learn.models import hologram_network, save_weights, train
from odak.learn.models.hologram_networks import RATIOS, SPREADS
from odak.learn.tools.matrix import plane_indices
from odak.wave.propagation import propagate_beam, propagate_within_window

SEED, SIDE, BATCH, EPOCH = 2026, 128, 2, 25
# Not skimage's "coffee", which is odak's photo.png.
PHOTOGRAPHS = ("astronaut", "brick", "camera", "chelsea", "coins", "grass", "gravel", "moon", "rocket")
DRAWN, CUT = 300, 16
REFINEMENTS = (2, 5)
# Share of the batches that represent the inside of large pictures.
PERIODIC = 0.5
# Share of the batches with one plane, most planes of the others, and the range of the half of their depth by distance.
FLAT, PLANES, HALF_DEPTHS = 0.5, 4, (0.05, 0.5)


def fractal(random: np.random.Generator, side: int) -> np.ndarray:
    """Return noise whose spectrum falls with a random power of the frequency, 0 … 1."""
    frequency = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    frequency[0, 0] = 1
    noise = np.fft.ifft2(np.fft.fft2(random.normal(size=(side, side))) / frequency ** random.uniform(0.8, 2)).real
    low, high = np.percentile(noise, [1, 99])
    return np.clip((noise - low) / (high - low), 0, 1)


def drawing(random: np.random.Generator, side: int = SIDE) -> np.ndarray:
    """Return shapes, rings, strokes and stripes on a gradient or on noise, 0 … 1."""
    y, x = np.mgrid[:side, :side]
    if random.random() < 0.5:
        image = fractal(random, side) * random.uniform(0.2, 1)
    else:
        angle = random.uniform(0, 2 * np.pi)
        slope = np.cos(angle) * (x / side - 0.5) + np.sin(angle) * (y / side - 0.5)
        image = np.clip(0.5 + slope, 0, 1) * random.uniform(0, 1)
    for _ in range(random.integers(0, 14)):
        column, row = random.uniform(0, side, 2)
        radius = side * np.exp(random.uniform(np.log(0.02), np.log(0.4)))
        angle, ratio = random.uniform(0, np.pi), random.uniform(0.1, 1)
        along = np.cos(angle) * (x - column) + np.sin(angle) * (y - row)
        across = np.cos(angle) * (y - row) - np.sin(angle) * (x - column)
        inside = np.hypot(along, across) < radius
        covered = (
            np.hypot(along, across / ratio) < radius,
            (abs(along) < radius) & (abs(across) < radius * ratio),
            abs(np.hypot(along, across) - radius) < max(1, 0.15 * radius * ratio),
            (abs(along) < radius) & (abs(across) < random.uniform(0.6, 2.5)),
            inside & (np.mod(along, period := random.uniform(3, 14)) < period / 2),
        )[random.integers(5)]
        value = random.uniform(0, 1) * (fractal(random, side) if random.random() < 0.3 else 1)
        image = np.where(covered, value, image)
    return gaussian_filter(image, random.uniform(0.3, 1.2)) if random.random() < 0.7 else image


def cuttings(random: np.random.Generator, count: int = CUT) -> list[np.ndarray]:
    """Return parts of photographs, at several scales."""
    found = []
    for name in PHOTOGRAPHS:
        photograph = np.asarray(getattr(data, name)(), dtype=float) / 255
        photograph = photograph.mean(-1) if photograph.ndim == 3 else photograph
        for _ in range(count):
            step = int(random.integers(1, min(photograph.shape) // SIDE + 1))
            smaller = gaussian_filter(photograph, 0.4 * (step - 1))[::step, ::step]
            row, column = (random.integers(0, n - SIDE + 1) for n in smaller.shape)
            found.append(smaller[row : row + SIDE, column : column + SIDE])
    return found


class Batches:
    """Batches of pictures, each with planes, a geometry, a number of refinements, and whether it repeats itself."""

    def __init__(self, seed: int):
        random = np.random.default_rng(seed)
        pictures = [drawing(random) for _ in range(DRAWN)] + cuttings(random)
        self.pictures = torch.from_numpy(np.stack(pictures)).float()
        self.generator = torch.Generator().manual_seed(seed)

    def __len__(self) -> int:
        return EPOCH

    def __iter__(self):
        fewest, most = REFINEMENTS
        for _ in range(EPOCH):
            chosen = torch.randint(len(self.pictures), (BATCH,), generator=self.generator)
            other = torch.randint(DRAWN, (BATCH,), generator=self.generator)
            place = torch.rand(11, generator=self.generator, dtype=torch.float64).tolist()
            target = self.pictures[chosen]
            target = target.transpose(-1, -2) if place[0] < 0.5 else target
            target = target.flip([axis for axis in (-2, -1) if place[1 - axis] < 0.5])
            ratio, spread = (
                math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
                for share, (low, high) in zip(place[4:6], (RATIOS, SPREADS), strict=True)
            )
            wavelength = 420e-9 + 260e-9 * place[6]
            dx = wavelength / ratio
            distance, depth = spread * dx**2 / wavelength, None
            if place[8] >= FLAT:
                half = HALF_DEPTHS[0] + place[9] * (HALF_DEPTHS[1] - HALF_DEPTHS[0])
                planes = 2 + int((PLANES - 1) * place[10])
                distance, depth = (distance * np.linspace(1 - half, 1 + half, planes)).tolist(), self.pictures[other]
                depth = depth.clamp(0, 1)
            yield (
                target,
                wavelength,
                dx,
                distance,
                depth,
                fewest + int((most - fewest + 1) * place[7]),
                place[3] < PERIODIC,
            )


def loss(network, batch) -> torch.Tensor:
    """Return the mean over the pictures of the squared error of the amplitude in decibels."""
    target, wavelength, dx, distance, depth, network.refinements, network.periodic = batch
    phase = network(target, wavelength, dx, distance, depth)
    hologram, image = torch.polar(torch.ones_like(phase), phase), 0
    distances = [distance] if depth is None else distance
    indices = torch.zeros_like(target) if depth is None else plane_indices(depth, len(distances))
    for plane, one in enumerate(distances):
        lengths = (one, dx, wavelength, "Angular Spectrum")
        if network.periodic:
            field = propagate_beam(hologram, None, *lengths, zero_padding=(False, False, False))
        else:
            field = propagate_within_window(hologram, *lengths)
        image = image + (indices == plane) * field.abs()
    amplitude, axes = target.clamp_min(0).sqrt(), (-2, -1)
    scale = (image * amplitude).sum(axes, keepdim=True) / (image * image).sum(axes, keepdim=True)
    return 10 * torch.log10((scale * image - amplitude).square().mean(axes) + 1e-6).mean()


def main() -> None:
    """Train for a number of epochs and write the weights."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--epochs", type=int, default=80, help=f"of {EPOCH} batches each")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--checkpoint", help="file of the state of the training (.pt), from which it continues")
    parser.add_argument("--file", default=str(files("odak") / "assets" / "hologram_network.pt"))
    given = parser.parse_args()
    torch.manual_seed(SEED)
    torch.set_num_threads(1)
    network, start = hologram_network(), time.perf_counter()

    trials = list(Batches(SEED + 1))[:12]

    def report(epoch, history):
        if epoch % 10 == 0:
            with torch.no_grad():
                values = [
                    np.mean([loss(network, (*batch[:5], 4, inside)).item() for batch in trials])
                    for inside in (False, True)
                ]
            sys.stdout.write(f"other pictures: {values[0]:.2f} dB, {values[1]:.2f} dB inside\n")
        sys.stdout.write(f"{epoch} {history.training[-1]:.2f} dB, {time.perf_counter() - start:.0f} s\n")
        sys.stdout.flush()

    train(
        network,
        loss,
        Batches(SEED),
        given.epochs,
        optimizer=lambda parameters: torch.optim.Adam(parameters, 3e-3),
        scheduler=lambda optimizer: torch.optim.lr_scheduler.OneCycleLR(
            optimizer, 3e-3, total_steps=given.epochs + 1, pct_start=0.08
        ),
        max_norm=3.0,
        seed=SEED,
        device=given.device,
        checkpoint=given.checkpoint,
        checkpoint_every=4,
        callback=report,
        progress=False,
    )
    save_weights(network.half(), given.file)


if __name__ == "__main__":
    main()
