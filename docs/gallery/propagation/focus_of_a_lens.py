"""Focus of a thin lens

How small can a focus be? A lens without aberrations focuses to the Airy pattern, whose first dark ring has the radius
1.22 λf/D, and whose depth grows with (f/D)². Whoever designs a microscope, a scanner or a display begins with these two
numbers. Here a lens of 20 mm focal length and 1 mm diameter is followed through its focus.

[Propagate light](../../guides/propagate_light.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import lens_phase, propagate_to_window

# %%
# The pupil is a disc whose rim is averaged over a pixel, with the phase of a thin lens.
wavelength, pitch, size, focal, radius = 532e-9, 2e-6, 600, 20e-3, 0.5e-3
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
r = torch.hypot(place[:, None], place)
aperture = ((radius - r) / pitch + 0.5).clamp(0, 1)
field = torch.polar(aperture, lens_phase((size, size), focal, pitch, wavelength))

# %%
# Windows of half a micrometre zoom into the focus: one row for each distance gives the section along the axis, and a
# square window the focal plane.
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

# %%
# The closed form, with the exact angle instead of the paraxial one.
x = (torch.arange(160, dtype=torch.float64) - 80) * fine
v = 2 * torch.pi / wavelength * radius * x / (focal**2 + x**2).sqrt()
airy = torch.where(v == 0, 1.0, (2 * torch.special.bessel_j1(v) / v) ** 2)
difference = (spot[80] / spot.max() - airy).abs().max()
print(f"largest difference from Airy's pattern: {difference:.4f} of the peak")

# %%
# The colours are logarithmic, so that the rings are visible.
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
# Change: `20e-3, 0.5e-3` to `20e-3, 0.25e-3`: Half the diameter gives a spot of twice the width and a focus four times as deep, longer than the section.
plt.show()
