"""Focus of a thin lens

A lens with a focal length of 20 mm and a diameter of 1 mm focuses a plane wave. The section along the axis shows the
focus; the intensity in the focal plane is the Airy pattern.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import lens_phase, propagate_to_window

wavelength, pitch, size, focal, radius = 532e-9, 2e-6, 600, 20e-3, 0.5e-3
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
r = torch.hypot(place[:, None], place)
aperture = ((radius - r) / pitch + 0.5).clamp(0, 1)
field = torch.polar(aperture, lens_phase((size, size), focal, pitch, wavelength))
fine = 0.5e-6
z = torch.linspace(16e-3, 25e-3, 91, dtype=torch.float64)
section = torch.cat(
    [
        propagate_to_window(field, wavelength, d, pitch, (1, 160), fine).abs().square()
        for d in z
    ]
)
spot = (
    propagate_to_window(field, wavelength, focal, pitch, (160, 160), fine)
    .abs()
    .square()
)
x = (torch.arange(160, dtype=torch.float64) - 80) * fine
v = 2 * torch.pi / wavelength * radius * x / (focal**2 + x**2).sqrt()
airy = torch.where(v == 0, 1.0, (2 * torch.special.bessel_j1(v) / v) ** 2)
difference = (spot[80] / spot.max() - airy).abs().max()
print(f"largest difference from Airy's pattern: {difference:.4f} of the peak")

# %%
figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), width_ratios=(1.6, 1, 1.1))
extent = [1e3 * z[0], 1e3 * z[-1], -40, 40]
drawn = axes[0].imshow(
    (section / section.max()).T, extent=extent, aspect="auto", norm="log", vmin=1e-4
)
axes[0].set(xlabel="z (mm)", ylabel="x (µm)", title="section along the axis")
figure.colorbar(drawn, ax=axes[0], label="intensity")
drawn = axes[1].imshow(
    (spot / spot.max()), extent=[-40, 40, 40, -40], norm="log", vmin=1e-4
)
axes[1].set(xlabel="x (µm)", ylabel="y (µm)", title="focal plane")
figure.colorbar(drawn, ax=axes[1], shrink=0.8)
axes[2].plot(1e6 * x, spot[80] / spot.max(), label="computed")
axes[2].plot(1e6 * x, airy, "--", label="Airy")
axes[2].set(xlabel="x (µm)", ylabel="intensity", title="row through the focus")
axes[2].legend()
# Thumbnail: 0.17
# Picture: Section through the focus of a lens, the focal plane, and its row beside Airy's pattern
plt.show()
