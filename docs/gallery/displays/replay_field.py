"""Diffraction orders of a pixelated panel

A modulator of square pixels repeats its replay field in diffraction orders, under the envelope of one pixel. With several
samples per pixel the field behind it shows both.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import spatial_light_modulator, weighted_gerchberg_saxton

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
panel = spatial_light_modulator(samples_per_pixel=samples, fill_factor=0.9)
field = panel(hologram.angle())
spectrum = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(field))).abs()
spectrum = torch.nn.functional.max_pool2d((spectrum / spectrum.max())[None], 3, 1, 1)[0]

# %%
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
plt.show()
