"""A pancake eyepiece, folded by polarisation

Light of a small display passes the same lens three times: through it, back from a flat reflective polariser, and forward
again from the half mirror on its curved face. So the headset is as thin as the lens. The rays are those that reach a
pupil of 4 mm. [A pancake eyepiece](../polarisation/pancake_eyepiece.md) finds its ghosts and how to weaken them.
"""

from importlib.resources import files

from odak.learn.raytracing.system import (
    PolarizerFilm,
    RetarderFilm,
    ghost_system,
    launch,
    optical_system,
    ray_paths,
    surface,
)
from odak.learn.tools import load_image
from odak.visualize import blender

# %%
# The surfaces as a ray from the eye meets them, then the path that is reflected at surfaces 4 and 1.
eyepiece = optical_system(
    [
        surface(thickness=15.0, stop=True),
        surface(coating=PolarizerFilm(0.0, (1.0, 0.0), (0.0, 1.0))),
        surface(coating=RetarderFilm(90.0, 45.0, 550e-6)),
        surface(thickness=9.0, material="N-BK7", semi_diameter=13.0),
        surface(
            -75.0,
            coating=PolarizerFilm.half_mirror(),
            thickness=4.0,
            semi_diameter=13.0,
        ),
        surface(coating=RetarderFilm(90.0, -45.0, 550e-6)),
        surface(coating=PolarizerFilm(90.0), thickness=5.0),
    ],
    4.0,
    wavelengths=550e-6,
    fields=[-22.0, 0.0, 22.0],
)
folded = ghost_system(eyepiece, 1, 4)
paths = ray_paths(folded, launch(folded, "y", 5))[0].detach()

# %%
# The lens without its reflecting films, the folded rays, and the display with the picture of a scene.
picture = blender.scene(unit="mm", resolution=(600, 1100))
picture.add_system(eyepiece, count=0)
for field, color in zip(paths, ("#c8102e", "#1a7f37", "#1f5fbf")):
    picture.add_lines(field, radius=0.1, color=color)
shown = load_image(files("odak") / "assets" / "scene.png")[:, 420:1500]
display = float(paths[..., -1, 2].max())
picture.add_image(shown, [22, 22], location=[0, 0, display], rotation=[0, 180, 0])
picture.add_plane([400, 400], location=[0, -18, 15], rotation=[-90, 0, 0])
picture.add_camera([50, 15, -32], [0, -0.5, 13], fov=40)
picture.add_light([60, 90, -40], [0, 0, 20], kind="area", size=40)
picture.set_background("#e6ebf2", 0.55)
# Picture: Rays of a display that a pancake eyepiece folds between its half mirror and a reflective polariser
picture.render("pancake.png", samples=64, denoise=True, verbose=False)
