"""A wavefront with coma

An aberration is easier to grasp as a surface than as a map: here coma and defocus, with the height in wavelengths much
enlarged. [Render in Blender](../../guides/render_in_blender.md) draws any surface given by points.
"""

import numpy as np

from odak.tools import zernike_polynomial
from odak.visualize import blender

# %%
# The wavefront on a polar grid, with a colour for each height.
rho, theta = np.meshgrid(np.linspace(0.001, 1, 81), np.linspace(0, 2 * np.pi, 241))
height = 1.5 * zernike_polynomial(3, 1, rho, theta) + 0.6 * zernike_polynomial(
    2, 0, rho, theta
)
share = ((height - height.min()) / np.ptp(height)).reshape(-1, 1)
colors = (1 - share) * [0.1, 0.25, 0.7] + share * [0.95, 0.55, 0.2]

# %%
# The surface above a ground plane.
picture = blender.scene(unit="mm", resolution=(600, 900))
picture.add_surface(
    5 * rho * np.cos(theta), height, 5 * rho * np.sin(theta), color=colors
)
picture.add_plane([80, 80], location=[0, -4, 0], rotation=[-90, 0, 0])
picture.add_camera([6, 8, -13], [0, -0.6, 0], fov=44)
picture.add_light([-10, 14, -6], [0, 0, 0], kind="area", size=6)
picture.set_background("#e6ebf2", 0.5)
# Picture: A wavefront with coma and defocus as a surface coloured by its height
picture.render("wavefront.png", samples=64, denoise=True, verbose=False)
