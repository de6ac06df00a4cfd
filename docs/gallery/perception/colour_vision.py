"""Colour-vision deficiencies

One man in twelve lacks a type of cone or has a shifted one, and a figure that tells its curves apart by red and green
says nothing to him. Each missing type takes away one of three dimensions of colour; Brettel, Viénot and Mollon (1997)
found which colours remain.

[Colour](../../guides/colour.md) has the function for severity and pictures.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import simulate_color_vision_deficiency
from odak.learn.tools import load_image

# %%
# A picture with colours of all hues, as sRGB values.
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)[
    None, :3, :, 420:1500
].float()
scene = torch.nn.functional.interpolate(scene, (400, 400), mode="area")
figure, axes = plt.subplots(1, 4, figsize=(13, 3.6))
axes[0].imshow(scene[0].permute(1, 2, 0))
axes[0].set_title("all cones")

# %%
# Each deficiency at its full severity.
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
# Change: `kind, 1.0` to `kind, 0.4`: At a severity of 0.4, an anomalous trichromat's, most hues are still there, only paler.
plt.show()
