"""Hologram in three colours

Three phase patterns are displayed in sequence, each with one of three lasers; the eye averages the frames.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image, psnr
from odak.learn.wave import multi_color_hologram_optimizer, propagator

colours = [639e-9, 515e-9, 473e-9]
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)
scene = scene[:3, :, 420:1500]
target = torch.nn.functional.interpolate(scene[None], (240, 240), mode="area")
display = propagator(
    [240, 240],
    colours,
    8e-6,
    number_of_frames=3,
    propagator_type="forward",
    volume_depth=0.0,
    image_location_offset=0.03,
    aperture="open",
)
optimizer = multi_color_hologram_optimizer(
    colours,
    [240, 240],
    target,
    display,
    number_of_frames=3,
    learning_rate=0.2,
    optimize_peak_amplitude=True,
    reduction="mean",
    seed=0,
    progress=False,
    initial_phase=0.3
    * torch.randn(3, 240, 240, generator=torch.Generator().manual_seed(0)),
)
_, phases, images, _, _, peak = optimizer.optimize(120, {"eyebox": 0.0, "light": 0.1})
image = (images.sum(0)[0] / peak).clamp(0, 1)
print(f"PSNR {psnr(image, target[0]):.1f} dB")

# %%
figure, axes = plt.subplots(1, 5, figsize=(14, 3), sharey=True)
extent = [0, 1.92, 1.92, 0]
axes[0].imshow(target[0].permute(1, 2, 0), extent=extent)
axes[0].set(title="target", xlabel="x (mm)", ylabel="y (mm)")
for axis, phase, wavelength in zip(axes[1:4], phases, colours):
    drawn = axis.imshow(
        phase % 6.2832, cmap="twilight", extent=extent, vmin=0, vmax=6.2832
    )
    axis.set(title=f"frame for {1e9 * wavelength:.0f} nm", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[1:4], label="phase (rad)", pad=0.02)
axes[4].imshow(image.permute(1, 2, 0), extent=extent)
axes[4].set(title="sum of the frames", xlabel="x (mm)")
# Thumbnail: 0.1
# Picture: A rendered scene, three phase patterns for red, green and blue, and the image that they add up to
plt.show()
