"""Curved rays in graded-index media

Where the index varies, rays are curved, as over a hot road. A rod whose index falls with the square of the radius needs
no curved faces: it forms a sequence of images, and copiers and endoscopes consist of such rods. Maxwell's fish-eye
images every point of its rim onto the opposite one without any aberration.

[Design a lens](../../guides/design_a_lens.md) shows gradients in systems.
"""

import math

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    Rays,
    curved_paths,
    optical_system,
    ray_paths,
    surface,
    trace,
)
from odak.raytracing.gradients import Gradient, RadialGradient

# %%
# A gradient of one's own is a class with one method; derivatives are taken by the library.
class FishEye(Gradient):
    """Refractive index of Maxwell's fish-eye lens of radius one, centred at z = 1."""

    def index(self, x, y, z, base):
        return 2 / (1 + x**2 + y**2 + (z - 1) ** 2)

# %%
# Two functions of rays within a medium.
def curves(system, rays):
    """Return the points of the rays within the first medium."""
    ends = ray_paths(system, rays)[..., 2, :]
    return curved_paths(system, rays, 0, ends, 80)[0, 0]


def fan(heights, slopes):
    """Return rays in the y–z plane that start in the plane z = 0."""
    zero = 0 * heights
    parts = (zero, heights, zero, zero, slopes, (1 - slopes**2).sqrt())
    return Rays(*(part[None, None] for part in parts))

# %%
# The rod is 3¼ periods long; the fish-eye lies in a box of index 1.
g = 0.3
medium = RadialGradient([-(g**2)])
rod = optical_system(
    [surface(thickness=6.5 * math.pi / g, material=1.6, gradient=medium), surface()],
    1.0,
)
# The source lies on the rim of the unit circle, the medium in a box around it.
box = optical_system(
    [surface(thickness=2.0, material=1.0, gradient=FishEye()), surface()], 1.0
)
inside = torch.linspace(-0.9, 0.9, 15, dtype=torch.float64)
found = trace(box, fan(0 * inside, inside), until=1)
print(f"all rays meet within {found.y.abs().max().item():.0e} radii")

# %%
# Rays of two points in the rod, and of one point of the fish-eye's rim.
figure, axes = plt.subplots(2, 1, figsize=(9, 6.4), height_ratios=(1, 2))
for height, color in ((0.0, "tab:blue"), (0.5, "tab:red")):
    slopes = torch.linspace(-0.28, 0.28, 9, dtype=torch.float64)
    for line in curves(rod, fan(height + 0 * slopes, slopes)).numpy():
        axes[0].plot(line[:, 2], line[:, 1], color=color, lw=0.7)
axes[0].set(xlabel="z (mm)", ylabel="y (mm)", title="A rod of 3¼ pitches")
for line in curves(box, fan(0 * inside, inside)).numpy():
    axes[1].plot(line[:, 2] - 1, line[:, 1], color="tab:green", lw=0.8)
axes[1].add_patch(plt.Circle((0, 0), 1.0, fill=False, color="gray"))
axes[1].set(xlabel="z", ylabel="y", aspect="equal", title="Maxwell's fish-eye")
# Picture: Rays of two points in a rod of graded index, and of one point in Maxwell's fish-eye
# Change: `g = 0.3` to `g = 0.15`: With half the gradient constant the rod is twice as long for the same number of images, and its numerical aperture is half as large: the rays swing farther out.
# Thumbnail: 0.365 0.45 0.72 0.87
plt.show()
