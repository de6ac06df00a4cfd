"""Colour-vision deficiencies

Simulation of the appearance of a picture for observers who lack one of the three types of cones.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import simulate_color_vision_deficiency
from odak.learn.tools import load_image

scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)[
    None, :3, :, 420:1500
].float()
scene = torch.nn.functional.interpolate(scene, (400, 400), mode="area")
figure, axes = plt.subplots(1, 4, figsize=(13, 3.6))
axes[0].imshow(scene[0].permute(1, 2, 0))
axes[0].set_title("all cones")
names = {
    "protan": "protanopia (no L cones)",
    "deutan": "deuteranopia (no M cones)",
    "tritan": "tritanopia (no S cones)",
}
for axis, (kind, name) in zip(axes[1:], names.items()):
    seen = simulate_color_vision_deficiency(scene, kind, 1.0, "Brettel")
    axis.imshow(seen[0].permute(1, 2, 0).clamp(0, 1))
    axis.set_title(name)
for axis in axes:
    axis.axis("off")
# Thumbnail: 0.37
# Picture: A colourful scene as seen with all cones, and by three kinds of dichromats
plt.show()
