"""Bits per pixel of a modulator

Fast panels have few levels: mirrors and pistons four bits, ferroelectric cells one. A hologram found for any phase and
rounded to them loses much of its quality; a search among the levels themselves gives part of it back.

[Real displays](../../guides/real_displays.md) describes panels.
"""

from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.tools import load_image, psnr
from odak.learn.wave import Display, Modulator, Run, light_of, optimise, picture_of

# %%
# A small picture, since the search is slow.
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = photo[:3, 40:300:2, 60:480:2]
target, run = light_of(photo, 532e-9).targets, Run(120, progress=False)


def display(bits):
    return Display(Modulator((130, 210), 8e-6, bits), 532e-9, 0.01)


# %%
# Rounded above, searched below. Quality is that of a camera whose pixels are those of the image.
figure, axes = plt.subplots(2, 5, figsize=(14, 4.6), sharex=True, sharey=True)
smooth = optimise(display(None), target, run=run)
for column, bits in zip(axes.T, (8, 4, 3, 2, 1)):
    panel = display(bits)
    rounded = panel.judge(panel.modulator.shown(smooth.phases))[0][0]
    rounded = rounded * (rounded * target).sum() / rounded.square().sum()
    searched = optimise(panel, target, run=run).images[0]
    for axis, image, way in zip(column, (rounded, searched), ("rounded", "optimised")):
        axis.imshow(picture_of(image, panel)[0], cmap="gray", extent=[0, 1.68, 1.04, 0])
        quality = psnr(image, target)
        axis.set_title(f"{bits} bit, {way}: {quality:.0f} dB")
    column[1].set_xlabel("x (mm)")
for axis in axes[:, 0]:
    axis.set_ylabel("y (mm)")
# Thumbnail: 0.7
# Picture: Images from a modulator of 8, 4, 3, 2 and 1 bits per pixel, each noisier than the one before, less so below
plt.show()
