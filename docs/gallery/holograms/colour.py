"""Hologram in three colours

Displays of one modulator show colours one after another, fast enough for the eye to average them. Each laser needs a
pattern of its own, as the same phase is another path for another wavelength; the target is not the stored picture but
the light of each laser that mixes to its colours.

[Multiplane and multi-colour holograms](../../guides/multiplane_and_colour.md) goes on from here.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, light_of, optimise, picture_of

# %%
# A picture of 240 × 240 pixels. `light_of` decodes it and gives the amount of each source; white is 1 of each.
colours = [639e-9, 515e-9, 473e-9]
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)
scene = scene[:3, :, 420:1500]
picture = torch.nn.functional.interpolate(scene[None], (240, 240), mode="area")[0]
display = Display(Modulator((240, 240), 8e-6), colours, 0.03)
target = light_of(picture, display).targets

# %%
# One call for all three frames. The qualities are those of the three lasers' light.
hologram = optimise(display, target, run=Run(60, progress=False))
print(", ".join(f"≈ {quality:.0f} dB" for quality in hologram.psnr[0].tolist()))

# %%
# The patterns, and the mixture as a screen shows it.
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
# Change: `[639e-9, 515e-9, 473e-9]` to `[620e-9, 532e-9, 460e-9]`: Other lasers need other amounts for the same picture; the mixture keeps its colours where their triangle holds them.
plt.show()
