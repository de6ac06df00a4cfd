"""Bits per pixel of a modulator

Fast panels have few levels: mirrors and pistons four bits, ferroelectric cells one. A hologram found for any phase and
rounded to them loses much of its quality; a search among the levels themselves gives part of it back.

[Real displays](../../guides/real_displays.md) describes panels.
"""

from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, light_of, optimise

# %%
# A small picture, since the search is slow.
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = photo[:3, 40:300:2, 60:480:2]
target = light_of(photo, 532e-9).targets

# %%
# Rounded above, searched below. Quality is that of a camera at any place.
figure, axes = plt.subplots(2, 5, figsize=(14, 4.6), sharex=True, sharey=True)
for column, bits in zip(axes.T, (8, 4, 3, 2, 1)):
    display = Display(Modulator((130, 210), 8e-6, bits), 532e-9, 0.01)
    for axis, solver in zip(column, ("lbfgs", "auto")):
        run = Run(120, progress=False)
        hologram = optimise(display, target, solver=solver, run=run)
        picture = hologram.pictures(0).permute(1, 2, 0)
        axis.imshow(picture, extent=[0, 1.68, 1.04, 0])
        way = "rounded" if solver == "lbfgs" or bits == 8 else "searched"
        axis.set_title(f"{bits} bit, {way}: {hologram.psnr.item():.0f} dB")
    column[1].set_xlabel("x (mm)")
for axis in axes[:, 0]:
    axis.set_ylabel("y (mm)")
# Thumbnail: 0.7
# Picture: Images from a modulator of 8, 4, 3, 2 and 1 bits per pixel, each noisier than the one before, less so below
plt.show()
