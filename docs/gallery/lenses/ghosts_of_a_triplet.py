"""Ghosts of a triplet

A lamp in or near the picture makes discs and rings of light: ghosts. Each pair of surfaces reflects light twice on its
way to the image, so that n surfaces have n(n − 1)/2 of them, and four per cent of four per cent is still much beside a
dark part of the picture. The maps show where the light of a lamp goes besides its image.

[Stray light](../../guides/stray_light.md) traces all paths, mounts included.
"""

import matplotlib.pyplot as plt

from odak.learn.raytracing.system import ghosts, load_system

# %%
# All fifteen pairs of a triplet without coatings, for a lamp in three directions.
lens = load_system("cooke_triplet")
angles = (0.0, 7.0, 14.0)
found = ghosts(lens, 81, fields=[(0.0, angle) for angle in angles])
brightest = found.paths[0]
print(
    f"{len(found.paths)} ghosts bring {100 * float(found.ratio[0]):.1f} % "
    f"of the light of the image; the brightest one, between surfaces "
    f"{brightest.first} and {brightest.second}, "
    f"{1e6 * float(brightest.power[0]):.0f} ppm"
)

# %%
# The brightest spot is a ghost that is nearly in focus.
figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), layout="constrained", sharey=True)
for place, (axis, angle) in enumerate(zip(axes, angles)):
    seen = 1e6 * found.irradiance((60.0, 60.0), (54, 54), place)
    shown = axis.imshow(
        seen.numpy(),
        extent=(-30, 30, -30, 30),
        origin="lower",
        cmap="magma",
        vmin=0,
        vmax=20,
    )
    axis.set(title=f"{angle:g}°", xlabel="x (mm)")
axes[0].set_ylabel("y (mm)")
figure.colorbar(shown, label="ppm of the light on each mm²")
# Picture: Irradiance of the ghosts in the image plane of a triplet for three directions of light
# Change: `angles = (0.0, 7.0, 14.0)` to `angles = (2.0, 4.0, 6.0)`: As the lamp leaves the axis, the focused ghost moves to the other side, and the discs are cut by the rims.
plt.show()
