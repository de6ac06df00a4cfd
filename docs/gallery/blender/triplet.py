"""A Cooke triplet in glass

A Cooke triplet in glass, as on the first page of this site. `add_system` draws an optical system with its glasses and
with rays of all its fields. [Render in Blender](../../guides/render_in_blender.md) goes on from here.
"""

from odak.learn.raytracing.system import load_system
from odak.visualize import blender

# %%
# Seven rays for each field.
picture = blender.scene(unit="mm", resolution=(600, 1100))
picture.add_system(load_system("cooke_triplet"), count=7, radius=0.15)
picture.add_plane([400, 400], location=[0, -16, 30], rotation=[-90, 0, 0])
picture.add_camera([80, 40, -20], [0, 1, 27], fov=40)
picture.add_light([60, 90, -20], [0, 0, 30], kind="area", size=40)
picture.set_background("#e6ebf2", 0.55)
# Picture: A Cooke triplet of glass with rays of three fields in red, green and blue
picture.render("triplet.png", samples=64, denoise=True, verbose=False)
