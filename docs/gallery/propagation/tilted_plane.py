"""Image on a tilted plane

A field is propagated to a plane that is rotated by 45° about the horizontal axis: one edge of it lies before the focus of
a lens, the other behind. Only the row at the focal distance is sharp.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import lens_phase, propagate_to_tilted_plane, propagate_to_window

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
plt.show()
