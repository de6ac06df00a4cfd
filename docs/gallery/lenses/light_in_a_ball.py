"""Reflections in a ball of glass

Descartes explained the rainbow by following rays through a drop by hand. Here they are divided at each face of a glass
ball by Fresnel's equations, and all parts are followed until they are weak; their power sets the width and the darkness
of the lines. After one inner reflection the rays turn back, and crowd at an angle: there stands the bow.

[Stray light](../../guides/stray_light.md) explains scenes.
"""

import matplotlib.pyplot as plt
import torch
from matplotlib.collections import LineCollection

from odak.learn.raytracing import Conic, Element, Light, RayScene

# %%
# Two half spheres form the ball; the light is a row of rays.
radius, index, count = 5.0, 1.5, 41
ball = RayScene(
    [
        Element(Conic(1 / radius), (1.0, index), center=(0, 0, -radius)),
        Element(Conic(-1 / radius), (index, 1.0), center=(0, 0, radius)),
    ]
)
heights = torch.linspace(0.2, 4.9, count, dtype=torch.float64)
starts = torch.stack((0 * heights, heights, 0 * heights - 12), -1)
ways = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(count, 3)
light = Light(torch.stack((starts, ways), 1), torch.ones(count, dtype=torch.float64))

# %%
# Rays are split at each face until less than 10⁻⁴ is left. What was emitted is what escaped, was absorbed or was cut.
found = ball.trace(light, 550e-6, split=True, threshold=1e-4, paths=True)
print(
    f"{len(found.segments)} pieces of rays; of a power of {count} emitted "
    f"{float(found.escaped):.3f} left the ball and {float(found.cut):.3f} was cut"
)

# %%
# Segments in the plane of the rays, weaker lines for less power.
figure, axis = plt.subplots(figsize=(9, 6))
power = found.segment_power
strength = (0.08 + 0.72 * power**0.5).tolist()
colours = [(0.75, 0.1, 0.1, alpha) for alpha in strength]
lines = LineCollection(found.segments[..., [2, 1]].numpy(), colors=colours)
lines.set_linewidth((0.3 + power**0.5).tolist())
axis.add_collection(lines)
axis.add_patch(plt.Circle((0, 0), radius, color="tab:blue", alpha=0.15))
axis.set(xlabel="z (mm)", ylabel="y (mm)", aspect="equal", xlim=(-12, 12), ylim=(-9, 7))
# Picture: Rays through a glass ball with all their inner reflections, weaker lines for less power
# Change: `5.0, 1.5, 41` to `5.0, 1.333, 41`: Water bends less: the light of one inner reflection returns at up to 42° from the axis, where the rainbow is.
# Thumbnail: 0.35 0.05 0.95 0.75
plt.show()
