"""Bits per pixel of a modulator

A hologram for modulators of 8, 4, 3, 2 and 1 bits per pixel: phases found without levels and rounded to them, and below
the levels that a search finds.
"""

from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, light_of, optimise

photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = photo[:3, 40:300:2, 60:480:2]
target = light_of(photo, 532e-9).targets

# %%
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
