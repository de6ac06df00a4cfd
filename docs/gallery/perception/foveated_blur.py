"""Blur that follows the gaze

A headset that follows the gaze may save most of its pixels: only the fovea sees detail. Each pixel is averaged over the
region that the eye pools at its distance from the gaze, which grows with the angle. From the stated distance, with the
eye on the cross, the image looks sharp.

[Metamers](../../guides/metamers.md) does better: it keeps statistics that blur loses.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import RadiallyVaryingBlur
from odak.learn.tools import load_image

# %%
# A picture of 40 cm width, seen from 40 cm.
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)[
    None, :3, :, 420:1500
].float()
scene = torch.nn.functional.interpolate(scene, (512, 512), mode="area")

# %%
# The same picture for two gazes. `alpha` is the diameter of a region over its eccentricity.
blur = RadiallyVaryingBlur()
figure, axes = plt.subplots(1, 3, figsize=(12, 4.1))
extent = [0, 40, 40, 0]
axes[0].imshow(scene[0].permute(1, 2, 0), extent=extent)
axes[0].set(title="image, seen from 40 cm", ylabel="y (cm)")
for axis, gaze in zip(axes[1:], ((0.25, 0.7), (0.8, 0.5))):
    image = blur.blur(
        scene, alpha=0.2, real_image_width=0.4, real_viewing_distance=0.4, centre=gaze
    )
    axis.imshow(image[0].permute(1, 2, 0).clamp(0, 1), extent=extent)
    axis.plot(40 * gaze[0], 40 * gaze[1], "k+", ms=14, mew=2)
    axis.set_title("gaze at the cross")
for axis in axes:
    axis.set_xlabel("x (cm)")
# Thumbnail: 0.5
# Picture: A scene, and two versions of it that are sharp at the gaze and blurred away from it
# Change: `alpha=0.2` to `alpha=0.6`: Regions three times as wide are seen at once, even at the gaze's side: the saving has gone too far.
plt.show()
