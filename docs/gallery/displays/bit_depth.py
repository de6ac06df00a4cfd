"""Bits per pixel of a modulator

The same hologram, optimised for a continuous phase, is shown by modulators of 8, 4, 3, 2 and 1 bits per pixel.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image, psnr
from odak.learn.wave import (
    calculate_phase,
    propagate_beam,
    spatial_light_modulator,
    stochastic_gradient_descent,
)

pitch, wavelength, distance = 8e-6, 532e-9, 0.03
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[
    1, 40:360, 60:480
]
hologram, _ = stochastic_gradient_descent(
    photo,
    wavelength,
    distance,
    pitch,
    n_iteration=80,
    learning_rate=0.2,
    scale=True,
    progress=False,
    initial_phase=torch.zeros_like(photo),
)

# %%
figure, axes = plt.subplots(1, 5, figsize=(14, 2.7))
for axis, bits in zip(axes, (8, 4, 3, 2, 1)):
    shown = spatial_light_modulator(bits=bits)(calculate_phase(hologram))
    image = propagate_beam(shown, None, distance, pitch, wavelength).abs().square()
    image = image * (image * photo).sum() / (image**2).sum()
    axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=[0, 3.36, 2.56, 0])
    axis.set(title=f"{bits} bit: {psnr(image, photo):.1f} dB", xlabel="x (mm)")
axes[0].set_ylabel("y (mm)")
# Thumbnail: 0.7
# Picture: Reconstructions from a modulator of 8, 4, 3, 2 and 1 bits per pixel, each noisier than the one before
plt.show()
