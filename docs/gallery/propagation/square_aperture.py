"""Diffraction by a square aperture

A plane wave of 532 nm passes a square aperture of 0.6 mm. Close behind it the shadow has fringes along its edges;
further away it turns into the pattern of Fraunhofer diffraction. `propagate_to_window` computes each distance on the
same window.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window

pitch, size = 4e-6, 512
field = torch.zeros(size, size, dtype=torch.complex128)
field[size // 2 - 75 : size // 2 + 75, size // 2 - 75 : size // 2 + 75] = 1
distances = torch.tensor([0.01, 0.04, 0.16, 0.64], dtype=torch.float64)
images = propagate_to_window(field, 532e-9, distances, pitch).abs().square()

# %%
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
plt.show()
