"""A ball of glass before a photograph

Refraction is Blender's own: a body of a glass of the catalogue bends light by its index. A ball forms an inverted image
of what is behind it, which anybody can check at a window. [Render in Blender](../../guides/render_in_blender.md) goes
on from here.
"""

from importlib.resources import files

import numpy as np

from odak.tools import load_image
from odak.visualize import blender

# %%
# A photograph stands 25 mm behind a ball of 5 mm radius.
photo = load_image(str(files("odak") / "assets" / "scene.png")).astype(np.uint8)
picture = blender.scene(unit="mm", resolution=(675, 900))
picture.add_sphere([0, 0, 0], 5.0, material="N-BK7")
picture.add_image(photo, [78, 44], location=[0, 0, 25], rotation=[0, 180, 0])
picture.add_camera([0, 0, -30], [0, 0, 0], fov=34)
picture.set_background("#ffffff", 0.2)
# Picture: A ball of glass before a colourful scene, which is seen upside down through it
picture.render("ball.png", samples=64, denoise=True, verbose=False)
