"""CIEDE2000 beside the distance in L*a*b*

Do two colours look the same? Manufacturers agree on a tolerance as a number, ΔE. The distance in L*a*b* is the oldest
such number, and is too strict for saturated colours; CIEDE2000 corrects it by what observers judged. The contours would
be circles of one size if the two agreed.

[Colour](../../guides/colour.md) lists the differences and spaces.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import ciede2000, lab_to_srgb

# %%
# For each of 81 colours a ring of directions, and the distance along each at which the difference is 3, by bisection.
lightness = 60.0
figure, axis = plt.subplots(figsize=(7, 6.5))
angle = torch.linspace(0, 2 * torch.pi, 73, dtype=torch.float64)
ring = torch.stack((torch.zeros_like(angle), angle.cos(), angle.sin()))
for a in range(-80, 81, 20):
    for b in range(-80, 81, 20):
        center = torch.tensor([lightness, a, b], dtype=torch.float64)[:, None]
        low, high = torch.zeros_like(angle), torch.full_like(angle, 40.0)
        for _ in range(30):  # bisection along each direction
            middle = (low + high) / 2
            moved = (center + middle * ring)[None, :, None]
            difference = ciede2000(center[None, :, None].expand_as(moved), moved)[
                0, 0, 0
            ]
            low = torch.where(difference < 3, middle, low)
            high = torch.where(difference < 3, high, middle)
        color = lab_to_srgb(center.reshape(1, 3, 1, 1))[0, :, 0, 0].clamp(0, 1).tolist()
        axis.fill(*(center[1:] + low * ring[1:]).tolist(), color=color, ec="k", lw=0.6)

# %%
# In greys the ellipses are small, among saturated colours long and turned; blue stands out.
axis.set(
    xlabel="a*",
    ylabel="b*",
    aspect="equal",
    title=f"contours of ΔE₀₀ = 3 at L* = {lightness:g}",
)
# Thumbnail: 0.5 1
# Picture: Contours of equal CIEDE2000 difference in the plane of a* and b*, filled with their colours
# Change: `lightness = 60.0` to `lightness = 30.0`: At L* = 30 many of the colours cannot be shown, and the ellipses keep their shape: lightness hardly matters.
plt.show()
