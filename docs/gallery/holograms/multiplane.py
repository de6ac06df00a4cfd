"""Three images at three distances

One hologram shows a different digit at each of three planes, 2 mm apart.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from odak.learn.wave import multiplane_hologram_optimizer

size, pitch = 256, 8e-6
font = ImageFont.load_default(150)
targets = []
for text in "123":
    picture = Image.new("L", (size, size))
    ImageDraw.Draw(picture).text((size // 2, size // 2), text, 255, font, anchor="mm")
    targets.append(torch.from_numpy(np.array(picture, dtype=np.float32) / 255))
optimizer = multiplane_hologram_optimizer(
    wavelength=515e-9,
    image_location=10e-3,
    image_spacing=3e-3,
    slm_pixel_pitch=pitch,
    slm_resolution=[size, size],
    targets=torch.stack(targets),
    number_of_planes=3,
    number_of_iterations=60,
    learning_rate=0.1,
    aperture="open",
    seed=0,
    progress=False,
)
phase, _, images = optimizer.optimize()

# %%
half = 1e3 * pitch * size / 2
figure, axes = plt.subplots(1, 4, figsize=(14, 3.5), sharey=True)
drawn = axes[0].imshow(
    phase % 6.2832, cmap="twilight", extent=[-half, half, half, -half]
)
axes[0].set(title="hologram", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(drawn, ax=axes[0], label="phase (rad)", shrink=0.75)
for number, (axis, image) in enumerate(zip(axes[1:], images.detach()), 1):
    drawn = axis.imshow(
        image, cmap="gray", extent=[-half, half, half, -half], vmin=0, vmax=1
    )
    axis.set(title=f"plane {number}", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[-1], label="intensity", shrink=0.75)
# Thumbnail: 0.37
# Picture: One hologram and its images on three planes, which show the digits 1, 2 and 3
plt.show()
