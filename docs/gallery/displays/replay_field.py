"""Diffraction orders of a pixelated panel

Why is every picture of a hologram repeated, and why are the copies weaker? A modulator of square pixels samples the
field, which repeats its spectrum in diffraction orders; the pixel's own diffraction, a sinc, is the envelope. Displays
block all orders but one.

[Real displays](../../guides/real_displays.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import spatial_light_modulator, weighted_gerchberg_saxton

# %%
# A hologram of eight spots by the weighted iteration.
size, samples = 64, 6
target = torch.zeros(size, size)
for row, column in (
    (24, 20),
    (24, 32),
    (24, 44),
    (36, 18),
    (40, 24),
    (42, 32),
    (40, 40),
    (36, 46),
):
    target[row, column] = 1
hologram, _ = weighted_gerchberg_saxton(target.to(torch.complex64), 30, seed=0)

# %%
# The field behind the panel with six samples to a pixel, and its far field.
panel = spatial_light_modulator(samples_per_pixel=samples, fill_factor=0.9)
field = panel(hologram.angle())
spectrum = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(field))).abs()
spectrum = torch.nn.functional.max_pool2d((spectrum / spectrum.max())[None], 3, 1, 1)[0]

# %%
# Lines mark the central order.
figure, axes = plt.subplots(1, 2, figsize=(10, 4.3))
axes[0].imshow(hologram.angle() % 6.2832, cmap="twilight")
axes[0].set(title="hologram", xlabel="column", ylabel="row")
orders = samples / 2
drawn = axes[1].imshow(
    spectrum.clamp_min(1e-3), norm="log", extent=[-orders, orders, orders, -orders]
)
axes[1].set(
    title="replay field",
    xlabel="spatial frequency × pixel pitch",
    ylabel="spatial frequency × pixel pitch",
)
for edge in (-0.5, 0.5):
    axes[1].axvline(edge, color="w", lw=0.6)
    axes[1].axhline(edge, color="w", lw=0.6)
figure.colorbar(drawn, ax=axes[1], label="amplitude")
# Thumbnail: 0.7
# Picture: A hologram of eight spots, and its replay field, which is repeated in all diffraction orders
# Change: `fill_factor=0.9` to `fill_factor=0.5`: Pixels that fill half of their side have a wider envelope: the copies are much brighter beside the image.
plt.show()
