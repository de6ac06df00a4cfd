"""A mirror that learns to focus

Freeform mirrors of headlamps and displays are found by following rays backwards. The heights of a mirror made of
triangles are optimised so that all reflected rays meet in one point, 10 units away; nobody tells it the shape. The
result is the paraboloid r²/40, up to a constant.

[Trace rays](../../guides/trace_rays.md) explains meshes.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing import planar_mesh

# %%
# Parallel rays, and a flat mesh of 25 × 25 heights.
count = 22
grid = torch.linspace(-0.9, 0.9, count, dtype=torch.float64)
x, y = torch.meshgrid(grid, grid, indexing="ij")
starts = torch.stack((x, y, torch.full_like(x, 10.0)), -1).reshape(-1, 3)
down = torch.tensor([0.0, 0.0, -1.0], dtype=starts.dtype)
rays = torch.stack((starts, down.expand_as(starts)), dim=1)
flat = torch.zeros(25, 25, 1, dtype=starts.dtype)
mesh = planar_mesh(size=[2.0, 2.0], number_of_meshes=[25, 25], heights=flat)
optimizer = torch.optim.Adam([mesh.heights], lr=4e-3)

# %%
# Where the reflected rays meet the plane of the focus.
def landing():
    reflected, _ = mesh.mirror(rays)
    point, direction = reflected[:, 0], reflected[:, 1]
    reach = (10.0 - point[:, 2:]) / direction[:, 2:]
    return (point + reach * direction)[:, :2]

# %%
# Three hundred steps, and the paraboloid to compare with.
before = landing().detach()
schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 300)
for _ in range(300):
    loss = landing().square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    schedule.step()
after = landing().detach()
heights = mesh.heights.detach()[..., 0]
parabola = ((mesh.X**2 + mesh.Y**2) / 40).detach()[..., 0]
parabola = parabola + (heights - parabola).mean()
sizes = [points.square().sum(-1).mean().sqrt() for points in (after, before)]
print(f"RMS distance from the focus: {sizes[0]:.2f}, flat {sizes[1]:.3f}")

# %%
# Heights, a section and the spots.
figure = plt.figure(figsize=(12, 3.8))
axes = figure.subplots(1, 3)
drawn = axes[0].imshow(heights.T, extent=[-1, 1, -1, 1], origin="lower", cmap="viridis")
axes[0].set(title="heights of the mirror", xlabel="x", ylabel="y")
figure.colorbar(drawn, ax=axes[0], label="height")
middle = len(heights) // 2
place = torch.linspace(-1, 1, len(heights))
axes[1].plot(place, heights[middle], "o", label="optimised")
axes[1].plot(place, parabola[middle], label="r²/40")
axes[1].set(title="section", xlabel="y", ylabel="height")
axes[1].legend()
axes[2].plot(*before.T, ".", ms=3, label="flat mirror")
axes[2].plot(*after.T, ".", ms=3, label="optimised")
axes[2].set(title="where the rays land", xlabel="x", ylabel="y", aspect="equal")
axes[2].set(ylim=(-1, 1.5), xlim=(-1.1, 1.1))
axes[2].legend(loc="upper center", ncols=2, markerscale=3)
# Thumbnail: 0.16
# Picture: Heights of an optimised mirror, a section through it beside a parabola, and where its rays land
# Change: `reach = (10.0 - point[:, 2:])` to `reach = (5.0 - point[:, 2:])`: A focus at half the distance needs a mirror twice as deep as r²/40, and gets it.
plt.show()
