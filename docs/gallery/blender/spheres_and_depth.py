"""A scene for holograms: colours and depth

Holograms with depth need pictures whose depth is known for each pixel. A renderer has both: this scene and its depth
map are made of three balls. [Multiplane and multi-colour holograms](../../guides/multiplane_and_colour.md) divides such
a scene into planes.
"""

from odak.visualize import blender

# %%
# Balls, ground, camera and light.
picture = blender.scene(unit="mm", resolution=(500, 700))
for place, radius, color in (
    ([-9, 2, 30], 5, "seagreen"),
    ([1, 3, 20], 6, "gold"),
    ([10, 4, 9], 7, "tomato"),
):
    picture.add_sphere(place, radius, material=blender.diffuse(color))
picture.add_plane([400, 400], location=[0, -3, 30], rotation=[-90, 0, 0])
picture.add_camera([0, 14, -34], [0, 2, 15], fov=44)
picture.add_light([-30, 50, -20], [0, 0, 15], kind="area", size=18)
picture.set_background("#dfe8f2", 0.6)
# Picture: Three coloured balls on a plane
picture.render("colors.png", samples=48, denoise=True, verbose=False)
