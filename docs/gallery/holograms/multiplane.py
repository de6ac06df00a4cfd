"""Three images at three distances

One hologram shows a different digit at each of three planes, 3 mm apart.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from odak.learn.wave import Display, Modulator, Run, optimise

size, pitch = 256, 8e-6
font = ImageFont.load_default(150)
targets = []
for text in "123":
    picture = Image.new("L", (size, size))
    ImageDraw.Draw(picture).text((size // 2, size // 2), text, 255, font, anchor="mm")
    targets.append(torch.from_numpy(np.array(picture, dtype=np.float32) / 255))
display = Display(Modulator((size, size), pitch), 515e-9, [7e-3, 10e-3, 13e-3])
planes = torch.stack(targets)[:, None]
hologram = optimise(display, planes, run=Run(60, progress=False))
images = hologram.images[:, 0]

# %%
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
plt.show()
