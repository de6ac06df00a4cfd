"""Caustic of a glass ball

A parallel bundle is refracted twice by a ball of glass. The rays do not meet in a point: they touch a caustic.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.catalog import refractive_index
from odak.raytracing import define_sphere, intersect_w_sphere, refract

index = refractive_index("N-BK7", 532e-9)
sphere = define_sphere([0.0, 0.0, 0.0], 5.0)
heights = np.linspace(-4.6, 4.6, 93)
starts = np.column_stack(
    (np.zeros_like(heights), heights, np.full_like(heights, -12.0))
)
rays = np.stack((starts, np.broadcast_to([0.0, 0.0, 1.0], starts.shape)), axis=1)
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
# Thumbnail: 0.3 0.1 0.88 0.85
plt.show()
