"""Bands of a steerable pyramid

The details of an image by size and orientation: four orientations at three scales.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import SpatialSteerablePyramid
from odak.learn.tools import load_image

scene = (
    load_image(files("odak") / "assets" / "scene.png", torch_style=True)[None, :3]
    .float()[..., 420:1500]
    .mean(1, keepdim=True)
)
scene = torch.nn.functional.interpolate(scene, (384, 384), mode="area")
pyramid = SpatialSteerablePyramid(
    use_bilinear_downup=False, n_orientations=4
).construct_pyramid(scene, 4)
figure, axes = plt.subplots(3, 5, figsize=(12, 7.2))
for axis in axes.ravel():
    axis.axis("off")
axes[1, 0].imshow(scene[0, 0], cmap="gray")
axes[1, 0].set_title("image")
for row in range(3):
    for column, band in enumerate(pyramid[row]["b"]):
        limit = float(band.abs().quantile(0.995))
        axes[row, column + 1].imshow(band[0, 0], cmap="RdBu", vmin=-limit, vmax=limit)
        axes[row, column + 1].set_title(f"level {row}, {45 * column}°")
# Picture: An image and the bands of its steerable pyramid, four orientations at three scales
plt.show()
