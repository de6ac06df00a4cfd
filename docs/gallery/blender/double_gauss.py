"""A double Gauss objective

A section shows a lens to those who read sections; a render shows it to everybody, on a poster or the first page of a
paper. The sample system `double_gauss` is drawn with its glasses and rays of its fields, seen from behind. [Render in
Blender](../../guides/render_in_blender.md) lists what can be drawn.
"""

from odak.learn.raytracing.system import load_system
from odak.visualize import blender

# %%
# The system in millimetres on a ground plane.
picture = blender.scene(unit="mm", resolution=(600, 1100))
picture.add_system(load_system("double_gauss"), count=5, radius=0.25)
picture.add_plane(
    [900, 900],
    location=[0, -36, 60],
    rotation=[-90, 0, 0],
    material=blender.diffuse("#c9ced6"),
)

# %%
# Camera, light and background, then the render.
picture.add_camera([150, 90, -70], [0, -2, 62], fov=42)
picture.add_light([110, 160, -60], [0, 0, 60], kind="area", size=80)
picture.set_background("#eef1f5", 0.55)
# Picture: The six lenses of a double Gauss objective with rays of three fields
picture.render("double_gauss.png", samples=48, denoise=True, verbose=False)
