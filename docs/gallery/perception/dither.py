"""Greys on a screen of one bit

A screen that shows black and white alone shows greys as dots. Where the dots stand decides how visible they are: the eye
sees coarse patterns best, so that dots should differ from the grey at high frequencies alone. Dots by a mask of blue noise
and by diffusion of errors do so; dots by chance differ at all frequencies.

[Colour and displays](../../guides/colour.md#screens-of-few-levels) goes on from here.
"""

import matplotlib.pyplot as plt
import skimage
import torch

from odak.learn.perception import CSFLoss, Viewing, dither

# %%
# A photograph on black and white. Averaged over some pixels its light is that of the photograph, which the stored values
# of the file are not proportional to.
photo = torch.from_numpy(skimage.data.astronaut()[10:202, 130:322].mean(-1) / 255)
photo = photo[None, None]
methods = ("white noise", "blue noise", "error diffusion")
seen = CSFLoss(viewing=Viewing.head_mounted((192, 192), pixels_per_degree=60))
figure, axes = plt.subplots(2, 3, figsize=(10, 6.8), layout="constrained")
for axis, method in zip(axes[0], methods, strict=True):
    dots = dither(photo, 1, method)
    times = seen(dots, photo).sqrt()
    axis.imshow(dots[0, 0], cmap="gray", interpolation="nearest")
    axis.set(title=f"{method}: {times:.0f} times the threshold", xticks=[], yticks=[])

# %%
# Power over the spatial frequency in cycles per pixel, of a grey of 30 % of the light of white: the mean over eight
# seeds, black for none and bright for three times the mean.
grey = torch.full((1, 1, 64, 64), 0.3)
for axis, method in zip(axes[1], methods, strict=True):
    dots = [dither(grey, 1, method, encoding="linear", seed=seed) for seed in range(8)]
    power = torch.fft.fft2(torch.cat(dots) - 0.3).abs().square().mean((0, 1))
    axis.imshow(
        torch.fft.fftshift(power) / power.mean(),
        extent=(-0.5, 0.5, 0.5, -0.5),
        vmin=0,
        vmax=3,
        cmap="magma",
    )
    axis.set(title=f"spectrum of {method}", xlabel="cycles per pixel")
# Thumbnail: 0.37 0.035 0.665 0.465
# Picture: A photograph in black and white dots by white noise, blue noise and diffusion of errors; below, their spectra, of which the last two are dark in the middle
# Change: `photo, 1, method` to `photo, 2, method`: With two bits, black, white and two greys, the dots are less than half as visible.
plt.show()
