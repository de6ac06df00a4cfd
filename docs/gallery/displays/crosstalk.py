"""Crosstalk and gaps of a liquid-crystal panel

A liquid-crystal panel does not show the phase that it is given: electric fields at the rims of pixels smooth it, and
gaps between pixels reflect light without it. A blazed grating tells how much: the ideal panel sends its light to the
first order, a real one to the zero order and to copies of the image, too.

[Real displays](../../guides/real_displays.md) measures and models both.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import blazed_grating, calculate_phase, spatial_light_modulator

# %%
# A grating of eight pixels to the period on three panels, with sixteen samples for each pixel.
size, samples = 96, 4
phase = calculate_phase(blazed_grating(size, size, 8)) % (2 * torch.pi)
panels = {
    "ideal": {},
    "fill factor 0.85": {"fill_factor": 0.85},
    "crosstalk of 0.6 pixels": {"crosstalk": 0.6},
}

# %%
# The phase that the panel shows, and the power of each order.
figure, axes = plt.subplots(2, 3, figsize=(12, 6))
for column, (name, options) in enumerate(panels.items()):
    panel = spatial_light_modulator(bits=8, samples_per_pixel=samples, **options)
    field = panel(phase)
    orders = (
        torch.fft.fftshift(torch.fft.fft2(field)).abs().square() / field.numel() ** 2
    )
    detail = calculate_phase(field[: 16 * samples, : 16 * samples]) % (2 * torch.pi)
    drawn = axes[0, column].imshow(
        detail, cmap="twilight", extent=[0, 16, 16, 0], vmin=0, vmax=6.2832
    )
    axes[0, column].set(title=name, xlabel="column (pixels)", ylabel="row (pixels)")
    middle = orders.shape[-1] // 2
    line = orders.sum(1)
    place = (torch.arange(len(line)) - middle) / (size / 8)
    axes[1, column].semilogy(place, line.clamp_min(1e-8))
    axes[1, column].set(
        xlim=(-12, 12),
        ylim=(1e-5, 1.5),
        xlabel="diffraction order",
        ylabel="share of the power",
    )
    axes[1, column].set_title(f"first order: {float(line.max()):.2f}")
figure.colorbar(drawn, ax=axes[0], label="phase (rad)")
# Picture: Phase of a blazed grating on three panels, and the power in its diffraction orders
# Change: `blazed_grating(size, size, 8)` to `blazed_grating(size, size, 3)`: With three pixels to the period even the ideal panel sends only 0.70 of the light to the first order.
plt.show()
