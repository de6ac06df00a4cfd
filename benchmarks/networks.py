"""Networks of coordinates on one small task: quality and time beside a plain network written with torch alone.

    python benchmarks/networks.py

Each learns a photograph of 48 × 72 pixels from its coordinates by 150 steps of Adam, all pixels in one batch. The table
of the guide "Learned models" is its output.
"""

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
