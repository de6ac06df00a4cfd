"""Caustic of a glass ball

A glass ball is the simplest lens, couples light into fibres, and gathers the sun behind a drop. It has no focus: rays
far from the axis cross it earlier than those near it. They touch a caustic instead, the bright curve that one sees in a
cup, whose cusp is the paraxial focus.

[Trace rays](../../guides/trace_rays.md) explains rays and surfaces one by one.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.catalog import refractive_index
from odak.raytracing import define_sphere, intersect_w_sphere, refract

# %%
# A bundle of parallel rays, as points and directions, meets the ball.
index = refractive_index("N-BK7", 532e-9)
sphere = define_sphere([0.0, 0.0, 0.0], 5.0)
heights = np.linspace(-4.6, 4.6, 93)
starts = np.column_stack(
    (np.zeros_like(heights), heights, np.full_like(heights, -12.0))
)
rays = np.stack((starts, np.broadcast_to([0.0, 0.0, 1.0], starts.shape)), axis=1)

# %%
# Refraction into the glass and out of it. The step between them keeps a ray from meeting the surface that it has just
# left.
normals, _ = intersect_w_sphere(rays, sphere)
inside = refract(rays, normals, 1.0, index)
first = inside[:, 0].copy()
inside[:, 0] += (
    1e-6 * inside[:, 1]
)  # step off the surface, so that the far side is found
normals, _ = intersect_w_sphere(inside, sphere)
behind = refract(inside, normals, index, 1.0)
last = behind[:, 0]
end = last + behind[:, 1] * ((9.0 - last[:, 2]) / behind[:, 1, 2])[:, None]
print(
    f"index {index:.4f}; "
    f"paraxial focus {index * 5 / (2 * (index - 1)):.2f} mm from the centre"
)

# %%
# The cross marks the paraxial focus.
figure, axis = plt.subplots(figsize=(10, 5))
for path in zip(starts, first, last, end):
    points = np.array(path)
    axis.plot(points[:, 2], points[:, 1], color="tab:red", lw=0.5, alpha=0.8)
axis.add_patch(plt.Circle((0, 0), 5.0, color="tab:blue", alpha=0.15))
axis.plot(index * 5 / (2 * (index - 1)), 0, "k+", ms=12)
axis.set(
    xlabel="z (mm)", ylabel="y (mm)", aspect="equal", xlim=(-9, 9), ylim=(-5.4, 5.4)
)
# Picture: Parallel rays through a ball of glass, which touch a caustic behind it
# Change: `refractive_index("N-BK7", 532e-9)` to `2.0`: A ball of index 2 has its paraxial focus on its rear face: what comes from there goes back, and road signs use such beads.
# Thumbnail: 0.3 0.1 0.88 0.85
plt.show()
