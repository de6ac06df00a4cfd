"""Three images at three distances

One hologram can form different images at different distances, since light on its way to one plane passes the others out
of focus. Traps, lithography and displays of several depths use it. The planes share the light and the freedom of the
pattern: the closer they are, the more they disturb each other.

[Multiplane and multi-colour holograms](../../guides/multiplane_and_colour.md) goes on from here.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from odak.learn.wave import Display, Modulator, Run, optimise

# %%
# Three digits as targets.
size, pitch = 256, 8e-6
font = ImageFont.load_default(150)
targets = []
for text in "123":
    picture = Image.new("L", (size, size))
    ImageDraw.Draw(picture).text((size // 2, size // 2), text, 255, font, anchor="mm")
    targets.append(torch.from_numpy(np.array(picture, dtype=np.float32) / 255))

# %%
# One display with three distances; targets have one picture for each.
display = Display(Modulator((size, size), pitch), 515e-9, [7e-3, 10e-3, 13e-3])
planes = torch.stack(targets)[:, None]
hologram = optimise(display, planes, run=Run(60, progress=False))
images = hologram.images[:, 0]

# %%
# The pattern, and the light at the three planes.
half = 1e3 * pitch * size / 2
figure, axes = plt.subplots(1, 4, figsize=(14, 3.5), sharey=True)
extent = [-half, half, half, -half]
drawn = axes[0].imshow(hologram.phases[0], cmap="twilight", extent=extent)
axes[0].set(title="hologram", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(drawn, ax=axes[0], label="phase (rad)", shrink=0.75)
for number, (axis, image) in enumerate(zip(axes[1:], images), 1):
    drawn = axis.imshow(image, cmap="gray", extent=extent, vmin=0, vmax=1)
    axis.set(title=f"plane {number}", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[-1], label="intensity", shrink=0.75)
# Thumbnail: 0.37
# Picture: One hologram and its images on three planes, which show the digits 1, 2 and 3
# Change: `[7e-3, 10e-3, 13e-3]` to `[9.5e-3, 10e-3, 10.5e-3]`: Planes of half a millimetre's distance cannot be told apart by their defocus: the digits shine through each other.
plt.show()
