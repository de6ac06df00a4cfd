"""Hologram in three colours

Three phase patterns are displayed in sequence, each with one of three lasers; the eye averages the frames. The target
is the light of each laser that mixes to the colours of a stored picture.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, light_of, optimise, picture_of

colours = [639e-9, 515e-9, 473e-9]
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)
scene = scene[:3, :, 420:1500]
picture = torch.nn.functional.interpolate(scene[None], (240, 240), mode="area")[0]
display = Display(Modulator((240, 240), 8e-6), colours, 0.03)
target = light_of(picture, display).targets
hologram = optimise(display, target, run=Run(60, progress=False))
print(", ".join(f"{quality:.0f} dB" for quality in hologram.psnr[0].tolist()))

# %%
figure, axes = plt.subplots(1, 5, figsize=(14, 3), sharey=True)
extent = [0, 1.92, 1.92, 0]
axes[0].imshow(picture_of(target, display).permute(1, 2, 0), extent=extent)
axes[0].set(title="target", xlabel="x (mm)", ylabel="y (mm)")
for axis, phase, wavelength in zip(axes[1:4], hologram.phases, colours):
    drawn = axis.imshow(phase, cmap="twilight", extent=extent, vmin=0, vmax=6.2832)
    axis.set(title=f"frame for {1e9 * wavelength:.0f} nm", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[1:4], label="phase (rad)", pad=0.02)
axes[4].imshow(hologram.pictures(0).permute(1, 2, 0), extent=extent)
axes[4].set(title="sum of the frames", xlabel="x (mm)")
# Thumbnail: 0.1
# Picture: A rendered scene, three phase patterns for red, green and blue, and the image that they add up to
plt.show()
