"""Diffraction by a square aperture

The most frequent figure of diffraction has three regimes: fringes along the edges of the shadow, Fresnel's pattern, and
the far field, whose amplitude is a product of two sinc functions. The Fresnel number a²/(λz) says which one it is: much
more than 1, about 1, much less than 1. One function computes all of them.

[Propagate light](../../guides/propagate_light.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window

# %%
# A square of 0.6 mm in a plane wave, and four distances in one call on the same window.
pitch, size = 4e-6, 512
field = torch.zeros(size, size, dtype=torch.complex128)
field[size // 2 - 75 : size // 2 + 75, size // 2 - 75 : size // 2 + 75] = 1
distances = torch.tensor([0.01, 0.04, 0.16, 0.64], dtype=torch.float64)
images = propagate_to_window(field, 532e-9, distances, pitch).abs().square()

# %%
# The amplitude is drawn, as the weak fringes far outside would be invisible in the intensity.
half = 1e3 * pitch * size / 2
figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), sharey=True)
for axis, distance, image in zip(axes, distances, images):
    drawn = axis.imshow(image.sqrt(), extent=[-half, half, half, -half])
    fresnel = 0.3e-3**2 / (532e-9 * distance)
    axis.set(
        title=f"{100 * distance:g} cm, Fresnel number {fresnel:.2g}", xlabel="x (mm)"
    )
    figure.colorbar(drawn, ax=axis, shrink=0.7, label="amplitude")
axes[0].set_ylabel("y (mm)")
# Thumbnail: 0.62
# Picture: Amplitude behind a square aperture at four distances, from sharp fringes to a Fraunhofer pattern
# Change: `field[size // 2 - 75 : size // 2 + 75, size // 2 - 75 : size // 2 + 75]` to `field[size // 2 - 75 : size // 2 + 75, size // 2 - 25 : size // 2 + 25]`: An opening three times as high as wide gives a far field three times as wide as high.
plt.show()
