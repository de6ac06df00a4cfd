"""CIEDE2000 beside the distance in L*a*b*

Contours of a colour difference of one unit: circles of equal size in L*a*b*, and the ellipses of CIEDE2000, which are
longer for saturated colours.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import ciede2000, lab_to_srgb

figure, axis = plt.subplots(figsize=(7, 6.5))
angle = torch.linspace(0, 2 * torch.pi, 73, dtype=torch.float64)
ring = torch.stack((torch.zeros_like(angle), angle.cos(), angle.sin()))
for a in range(-80, 81, 20):
    for b in range(-80, 81, 20):
        center = torch.tensor([60.0, a, b], dtype=torch.float64)[:, None]
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
axis.set(
    xlabel="a*", ylabel="b*", aspect="equal", title="contours of ΔE₀₀ = 3 at L* = 60"
)
# Thumbnail: 0.5 1
# Picture: Contours of equal CIEDE2000 difference in the plane of a* and b*, filled with their colours
plt.show()
