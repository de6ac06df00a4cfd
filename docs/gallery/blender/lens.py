"""A lens and its focus

Rays traced by odak and glass rendered by Blender in one picture: a plano-convex lens of the catalogue with two rings of
rays. The rays inside the lens appear displaced because Blender renders refraction with the same index. [Render in
Blender](../../guides/render_in_blender.md) goes on from here.
"""

import numpy as np

from odak.catalog import plano_convex_lens
from odak.raytracing import propagate_a_ray
from odak.visualize import blender

# %%
# The rays as points on the surfaces and behind them.
lens = plano_convex_lens("LA1024")
angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
rings = np.concatenate(
    [r * np.column_stack((np.cos(angles), np.sin(angles))) for r in (0.4, 0.8)]
)
starts = np.column_stack((rings, np.full(len(rings), -3.0)))
rays = np.stack((starts, np.broadcast_to([0.0, 0.0, 1.0], starts.shape)), axis=1)
into, _ = lens.intersect(rays)
behind = lens.raytrace(rays)
paths = np.stack(
    (starts, into[:, 0], behind[:, 0], propagate_a_ray(behind, 6.0)[:, 0]), axis=1
)

# %%
# The lens is drawn from its data, the rays as thin tubes.
picture = blender.scene(unit="mm", resolution=(600, 1100))
picture.add_lens(lens)
picture.add_lines(paths, radius=0.012, color="crimson")
picture.add_plane([30, 30], location=[0, -1.3, 1], rotation=[-90, 0, 0])
picture.add_camera([6.6, 3.0, -2.6], [0, -0.1, 1.3], fov=40)
picture.add_light([4, 7, -4], [0, 0, 1], kind="area", size=3)
picture.set_background("#dfe8f2", 0.55)
# Picture: Red rays bent by a plano-convex lens of glass meet behind it
picture.render("lens.png", samples=64, denoise=True, verbose=False)
