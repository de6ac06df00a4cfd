"""A hologram seen from several places of the eyebox

An eye moves, and what it sees must move with it: near objects shift against far ones, and what the eye is not focused on
is blurred. This hologram is optimised for nine pupils drawn at random in an eyebox, each of which sees the scene with its
own place, diameter and focus. It is judged at other pupils, beside a hologram of three planes of the same scene.

[Light fields](../../guides/light_fields.md) describes the scene, the pupils and the map.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import (
    DepthScene,
    Display,
    Eyes,
    Modulator,
    Run,
    eyebox_map,
    light_of,
    optimise,
    picture_of,
)

# %%
# A rendered scene and its depth: 1.5 mm in front of the panel to 1.5 mm behind it, where eyes see it at 98.5 to 101.5 mm.
assets = files("odak") / "assets"
picture = light_of(assets / "scene.png", 532e-9).targets[0]
depth = load_image(assets / "scene_depth.png").float()
picture, depth = (
    torch.nn.functional.adaptive_avg_pool2d(part[None], (64, 96))[0]
    for part in (picture, depth)
)
picture = (picture - picture.min()) / (picture.max() - picture.min())
away, near, far = 0.1, 0.0985, 0.1015
scene = DepthScene(picture, near + (far - near) * depth)

# %%
# The same panel with planes, and with pupils that are focused between the furthest and the nearest point.
panel, run = Modulator((64, 96), 8e-6), Run(30, progress=False, seed=0)
planes = Display(panel, 532e-9, [away - near, 0.0, away - far], frames=5)
eyes = Eyes.within(away, 1.6e-3, 9, (2.5e-3, 3.5e-3), (near, far))
holograms = {
    "for three planes": optimise(planes, (picture, depth), run=run),
    "for nine pupils": optimise(
        Display(panel, 532e-9, eyes, frames=5), scene, run=run
    ),
}

# %%
# What pupils of 3 mm see that neither of them was optimised for, and an eye in the middle with another focus.
box = 1.2e-3
maps = {
    name: eyebox_map(hologram, scene, box, 3, 3e-3, distance=away)
    for name, hologram in holograms.items()
}
focused = {
    name: [
        eyebox_map(hologram, scene, 0.0, 1, 3e-3, focus, distance=away)
        for focus in (near, far)
    ]
    for name, hologram in holograms.items()
}
for name, found in maps.items():
    print(f"{name}: ≈ {float(found.psnr.mean()):.0f} dB on average")

# %%
# The scene as it should be seen through three pupils and with two focuses, what the holograms show, and the maps.
figure, axes = plt.subplots(3, 6, figsize=(13, 5.2), layout="constrained")
titles = [f"pupil at {1e3 * x:.1f} mm" for x in (-box / 2, 0, box / 2)]
titles += [f"focused at {1e3 * focus:.1f} mm" for focus in (near, far)]


def draw(line, name, views):
    """Draw what is seen through three pupils and with two focuses."""
    for axis, view in zip(line, views):
        axis.imshow(picture_of(view[None], 532e-9)[0], cmap="gray", vmin=0, vmax=1)
        axis.set(xticks=[], yticks=[])
    line[0].set_ylabel(name)


for line, (name, found) in zip(axes[1:], maps.items()):
    one, other = (part.images[0, 0, 0] for part in focused[name])
    draw(line, name, [*found.images[1, :, 0], one, other])
    line[5].imshow(found.psnr, vmin=10, vmax=30)
    line[5].set(title="PSNR over the eyebox (dB)", xticks=[], yticks=[])
    for place, ratio in enumerate(found.psnr.flatten().tolist()):
        shown = {"color": "white" if ratio < 22 else "black", "ha": "center"}
        line[5].text(place % 3, place // 3, f"{ratio:.0f}", va="center", **shown)
one, other = (part.wanted[0, 0, 0] for part in focused[name])
draw(axes[0], "the scene", [*found.wanted[1, :, 0], one, other])
for axis, title in zip(axes[0], titles):
    axis.set_title(title)
axes[0, 5].axis("off")
# Thumbnail: 0.0 0.33 0.83 1.0
# Picture: A still life through three pupils and with two focuses: as it should be seen, with fringes from a hologram of three planes, and from one for nine pupils; and maps of their quality over the eyebox
# Change: `1.6e-3, 9, (2.5e-3` to `1.6e-3, 2, (2.5e-3`: With two pupils, these are shown well, and those between them are not.
plt.show()
