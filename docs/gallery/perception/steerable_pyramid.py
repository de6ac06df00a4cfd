"""Bands of a steerable pyramid

Cells of the visual cortex respond to a size and an orientation. The steerable pyramid splits a picture in the same way,
without losing anything: bands of four orientations at each scale, whose statistics are what metamers keep, and metrics
compare.

[Metamers](../../guides/metamers.md) uses it.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import SpatialSteerablePyramid
from odak.learn.tools import load_image

# %%
# A grey picture of 384 × 384 pixels.
scene = (
    load_image(files("odak") / "assets" / "scene.png", torch_style=True)[None, :3]
    .float()[..., 420:1500]
    .mean(1, keepdim=True)
)
scene = torch.nn.functional.interpolate(scene, (384, 384), mode="area")

# %%
# Three scales with four orientations each; a last, coarse picture and a fine residual complete it.
pyramid = SpatialSteerablePyramid(
    use_bilinear_downup=False, n_orientations=4
).construct_pyramid(scene, 4)
figure, axes = plt.subplots(3, 5, figsize=(12, 7.2))
for axis in axes.ravel():
    axis.axis("off")
axes[1, 0].imshow(scene[0, 0], cmap="gray")
axes[1, 0].set_title("image")
for row in range(3):
    bands = pyramid[row]["b"]
    for column, band in enumerate(bands):
        limit = float(band.abs().quantile(0.995))
        axes[row, column + 1].imshow(band[0, 0], cmap="RdBu", vmin=-limit, vmax=limit)
        axes[row, column + 1].set_title(f"level {row}, {180 * column // len(bands)}°")
# Picture: An image and the bands of its steerable pyramid, four orientations at three scales
# Change: `use_bilinear_downup=False, n_orientations=4` to `use_bilinear_downup=False, n_orientations=2`: Two orientations are broader: each band shows edges that four would share.
plt.show()
