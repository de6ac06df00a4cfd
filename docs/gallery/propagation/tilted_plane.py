"""Image on a tilted plane

Wafers, retinas and projection screens are tilted, and a hologram for one, or the picture of one, needs the field there.
A rotated plane is reached by one transform in rotated frequencies, as exact as a plane across the axis; the alternative
is one propagation for each row. Fifteen lenses show the tilt: only the row at their focal distance stays sharp.

[Windows and partial coherence](../../guides/windows_and_partial_coherence.md) describes the window and its limits.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import lens_phase, propagate_to_tilted_plane, propagate_to_window

# %%
# Fifteen lenses with axes of their own share a pupil.
wavelength, pitch, size, focal = 532e-9, 4e-6, 400, 30e-3
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
inside = (torch.hypot(place[:, None], place) < 0.7e-3).to(torch.float64)
# Fifteen lenses with axes of their own focus to an array of spots.
field = sum(
    torch.polar(
        inside, lens_phase((size, size), focal, pitch, wavelength, offset=(y, x))
    )
    for y in (-0.5e-3, -0.25e-3, 0.0, 0.25e-3, 0.5e-3)
    for x in (-0.3e-3, 0.0, 0.3e-3)
)

# %%
# The focal plane across the axis, and the same plane turned by 45° about the horizontal.
flat = (
    propagate_to_window(field, wavelength, focal, pitch, (400, 400), 4e-6)
    .abs()
    .square()
)
tilted = (
    propagate_to_tilted_plane(
        field, wavelength, focal, pitch, (45.0, 0.0, 0.0), (400, 400), 4e-6
    )
    .abs()
    .square()
)

# %%
# In the tilted plane the upper row lies in front of the focus, the lower one behind it.
figure, axes = plt.subplots(1, 2, figsize=(9, 4), sharey=True)
for axis, image, title in zip(
    axes, (flat, tilted), ("perpendicular to the axis", "tilted by 45°")
):
    drawn = axis.imshow(
        (image / flat.max()) ** 0.5, extent=[-0.8, 0.8, 0.8, -0.8], vmax=0.5
    )
    axis.set(title=title, xlabel="x (mm)")
    figure.colorbar(
        drawn, ax=axis, label="amplitude of the brightest spot", shrink=0.85
    )
axes[0].set_ylabel("y in the plane (mm)")
# Thumbnail: 0.3
# Picture: Fifteen focal spots in a plane across the axis and in a tilted plane, where the outer ones are out of focus
# Change: `(45.0, 0.0, 0.0)` to `(0.0, 45.0, 0.0)`: Turned about the vertical instead, the columns blur: the middle one stays sharp.
plt.show()
