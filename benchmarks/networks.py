"""Networks of coordinates on one small task: quality and time beside a plain network written with torch alone.

    python benchmarks/networks.py

Each learns a photograph of 48 × 72 pixels from its coordinates by 150 steps of Adam, all pixels in one batch. Networks
of pictures learn to take noise off patches of the photograph, beside a plain stack of convolutions. The tables of the
guide "Learned models" are its output.
"""

import itertools
import time
from importlib.resources import files

import torch
from torch import nn

from odak.learn import models
from odak.learn.tools import load_image

STEPS = 150


def main():
    """Print the table."""
    torch.set_num_threads(1)
    photo = load_image(str(files("odak") / "assets" / "photo.png"), torch_style=True).mean(0, keepdim=True)[None]
    image = nn.functional.interpolate(photo, (48, 72), mode="area")[0, 0]
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, n) for n in image.shape), indexing="ij")
    points = torch.stack([x, y], -1).reshape(-1, 2)
    print("| network | parameters | PSNR (dB) | time of a step over the plain one |\n|---|---|---|---|")
    plain_time = None
    for name, make, rate in networks(image):
        torch.manual_seed(0)
        network = make()
        seconds, quality = learned(network, points, image, rate)
        plain_time = seconds if plain_time is None else plain_time
        count = sum(parameter.numel() for parameter in network.parameters())
        print(f"| {name} | {count} | {quality:.1f} | {seconds / plain_time:.1f} |", flush=True)
    print_networks_of_pictures(photo)


def print_networks_of_pictures(photo):
    """Print the table of networks that take noise off patches of 48 × 48 pixels."""
    patches = photo[0].unfold(1, 48, 48).unfold(2, 48, 48).reshape(-1, 1, 48, 48)
    generator = torch.Generator().manual_seed(0)
    patches = patches[torch.randperm(len(patches), generator=generator)]
    noisy = patches + 0.15 * torch.randn(patches.shape, generator=generator)
    before = float(-10 * (noisy[-16:] - patches[-16:]).square().mean().log10())
    print(f"\nnoisy patches: {before:.1f} dB\n")
    print("| network | parameters | PSNR (dB) | time of a step over the plain one |\n|---|---|---|---|")
    plain_time = None
    for name, make in networks_of_pictures():
        torch.manual_seed(0)
        network = make()
        seconds, quality = denoised(network, noisy, patches)
        plain_time = seconds if plain_time is None else plain_time
        count = sum(parameter.numel() for parameter in network.parameters())
        print(f"| {name} | {count} | {quality:.1f} | {seconds / plain_time:.1f} |", flush=True)


def networks_of_pictures():
    """Yield names and functions that make networks from one channel to one."""

    def plain():
        widths = [1, 24, 24, 24, 24, 1]
        layers = []
        for one, two in itertools.pairwise(widths):
            layers += [nn.Conv2d(one, two, 3, padding=1), nn.ReLU()]
        return nn.Sequential(*layers[:-1])

    def residual():
        layers = [models.residual_layer(16, kernel_size=3, bias=True) for _ in range(3)]
        return nn.Sequential(nn.Conv2d(1, 16, 3, padding=1), *layers, nn.Conv2d(16, 1, 3, padding=1))

    options = {"input_channels": 1, "output_channels": 1, "bias": True}
    yield "plain torch: five convolutions, ReLU", plain
    yield "three `residual_layer`s", residual
    yield "`unet(depth=2, dimensions=8)`", lambda: models.unet(2, 8, **options)
    yield "`unet(depth=2, dimensions=8, bilinear=True)`", lambda: models.unet(2, 8, bilinear=True, **options)
    yield "`unet(depth=3, dimensions=8)`", lambda: models.unet(3, 8, **options)
    yield "`spatially_adaptive_unet(depth=2, dimensions=8)`", _Adaptive


class _Adaptive(nn.Module):
    def __init__(self):
        super().__init__()
        self.kernels = models.spatially_varying_kernel_generation_model(depth=2, dimensions=8, input_channels=2)
        self.network = models.spatially_adaptive_unet(depth=2, dimensions=8, input_channels=1, out_channels=1)

    def forward(self, picture):
        return self.network(self.kernels(torch.zeros_like(picture), picture), picture)


def denoised(network, noisy, clean):
    """Return the median time of a step and the PSNR of patches that were not learned from."""
    optimizer, times = torch.optim.Adam(network.parameters(), lr=3e-3), []
    generator = torch.Generator().manual_seed(1)
    for _ in range(STEPS):
        chosen = torch.randint(len(clean) - 16, (16,), generator=generator)
        start = time.perf_counter()
        optimizer.zero_grad()
        nn.functional.mse_loss(network(noisy[chosen]), clean[chosen]).backward()
        optimizer.step()
        times.append(time.perf_counter() - start)
    with torch.no_grad():
        error = (network(noisy[-16:]) - clean[-16:]).square().mean()
    return sorted(times)[len(times) // 2], float(-10 * error.log10())


def networks(image):
    """Yield names, functions that make networks, and learning rates."""
    layers = [2, 64, 64, 64, 1]

    def plain():
        return nn.Sequential(
            *(nn.Linear(2, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU()),
            nn.Linear(64, 1),
        )

    def perceptron(kind):
        return lambda: models.multi_layer_perceptron(layers, bias=True, model_type=kind)

    def encoded(encoder, features):
        return nn.Sequential(encoder, models.multi_layer_perceptron([features, 32, 1], bias=True))

    def hash_grid():
        encoder = models.hash_grid_encoder(2, levels=6, table_size=4096, coarsest=8, finest=72)
        return encoded(encoder, encoder.output_features)

    yield "plain torch: linear layers, ReLU", plain, 2e-3
    for kind in ("conventional", "swish", "Gaussian", "FILM SIREN", "SIREN"):
        yield f'`multi_layer_perceptron`, "{kind}"', perceptron(kind), 2e-3
    yield "`positional_encoder(8)`, perceptron", lambda: encoded(models.positional_encoder(8), 34), 1e-2
    yield "`hash_grid_encoder`, perceptron", hash_grid, 1e-2
    yield "`gaussians_2d(400)`, random start", lambda: _Gaussians(400), 2e-2
    yield "`gaussians_2d(400)`, from the image", lambda: _Gaussians(400, image), 5e-3


class _Gaussians(nn.Module):
    def __init__(self, number, image=None):
        super().__init__()
        self.sum = models.gaussians_2d(number)
        if image is not None:
            self.sum.initialize_from_image(image, seed=0)

    def forward(self, points):
        return self.sum(points[:, :1], points[:, 1:])


def learned(network, points, image, rate):
    """Return the median time of a step and the PSNR after all of them."""
    wanted = image.reshape(-1, 1)
    optimizer, times = torch.optim.Adam(network.parameters(), lr=rate), []
    for _ in range(STEPS):
        start = time.perf_counter()
        optimizer.zero_grad()
        nn.functional.mse_loss(network(points), wanted).backward()
        optimizer.step()
        times.append(time.perf_counter() - start)
    with torch.no_grad():
        error = (network(points) - wanted).square().mean()
    return sorted(times)[len(times) // 2], float(-10 * error.log10())


if __name__ == "__main__":
    main()
