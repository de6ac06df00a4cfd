"""A hologram seen from several places of the eyebox

An eye moves, and what it sees must move with it: near objects shift against far ones. A hologram sends light into all
places of the eyebox, and each of them can have a view of its own. This one has four frames and shows three views,
through a pupil of 2 mm; a hologram of the central view alone shows speckle at the other two positions.

[Displays and holograms as objects](../../guides/displays.md) describes the optics of eyes.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import Display, Eyes, Modulator, Run, optimise

# %%
# A rendered scene and its depth.
assets = files("odak") / "assets"
scene = load_image(assets / "scene.png", torch_style=True)[:3].mean(0)
depth = load_image(assets / "scene_depth.png").float()
scene, depth = (
    torch.nn.functional.interpolate(part[None, None].float(), (128, 192), mode="area")[
        0, 0
    ]
    for part in (scene, depth)
)
wavelength, pitch, distance = 532e-9, 8e-6, 0.1
places = [(0.0, -2e-3), (0.0, 0.0), (0.0, 2e-3)]

# %%
# The scene as each pupil sees it, by its parallax.
def view(place):
    """Return the scene seen from a position of the pupil, at depths of 98 to 103 mm."""
    apart = place[1] * (1 - distance / (0.098 + 0.005 * depth)) / pitch
    y, x = torch.meshgrid(
        torch.linspace(-1, 1, 128), torch.linspace(-1, 1, 192), indexing="ij"
    )
    grid = torch.stack([x - apart * 2 / 192, y], -1)
    return torch.nn.functional.grid_sample(
        scene[None, None], grid[None], padding_mode="border", align_corners=True
    )[0, 0]

# %%
# The display: a panel and the places of eyes. `optimise` takes targets for each place.
def seen_from(places):
    panel = Modulator((128, 192), pitch)
    return Display(panel, wavelength, Eyes(distance, places, 2e-3), frames=4)


targets = torch.stack([view(place) for place in places])[:, None]
run = Run(100, progress=False, seed=0)
hologram = optimise(seen_from(places), targets, run=run)
alone = optimise(seen_from(places[1:2]), targets[1], run=run)

# %%
# The hologram of one view, judged at all three places.
beside = seen_from(places).judge(alone.phases)[0]
beside = beside / beside.amax((2, 3), keepdim=True)
print("PSNR:", ", ".join(f"{float(value):.0f} dB" for value in hologram.psnr))

# %%
# Targets, the hologram of three views, and that of one.
figure, axes = plt.subplots(3, 3, figsize=(11, 7.4), sharex=True, sharey=True)
extent = [-0.77, 0.77, 0.51, -0.51]
rows = (
    ("target", targets),
    ("hologram of three views", hologram.images),
    ("of one view", beside),
)
for line, (name, lights) in zip(axes, rows):
    for axis, light, place in zip(line, lights, places):
        drawn = axis.imshow(light[0].clamp(0, 1), cmap="gray", extent=extent)
        axis.set_title(f"{name}, pupil at {1e3 * place[1]:.0f} mm", fontsize=10)
    line[0].set_ylabel("y (mm)")
for axis in axes[-1]:
    axis.set_xlabel("x (mm)")
# Thumbnail: 0.5
# Picture: Three views of a still life through pupils at three places, the targets above and a hologram of one view below
# Change: `Eyes(distance, places, 2e-3), frames=4` to `Eyes(distance, places, 2e-3), frames=1`: With one frame there is a quarter of the freedom, and all three views are noisier.
plt.show()
