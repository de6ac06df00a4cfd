"""Rays through a Cooke triplet

Rays of three fields are traced through the sample system `cooke_triplet`; the spot diagrams show where they meet the
image plane.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import draw_layout, load_system, spot_diagram

triplet = load_system("cooke_triplet")
spots = spot_diagram(triplet, "rings", 8)
print("RMS radii:", ", ".join(f"{1e3 * value:.1f} µm" for value in spots.rms))

# %%
figure = plt.figure(figsize=(9, 6.5))
top, bottom = figure.subfigures(2, 1, height_ratios=(1.5, 1))
axis = top.subplots()
axis.imshow(draw_layout(triplet, count=9))
axis.axis("off")
axes = bottom.subplots(1, len(triplet.fields), sharey=True)
for index, (axis, field) in enumerate(zip(axes, triplet.fields)):
    for x, y, wavelength in zip(
        spots.x[:, index], spots.y[:, index], triplet.wavelengths
    ):
        name = f"{1e6 * float(wavelength):.0f} nm"
        axis.plot(1e3 * x.detach(), 1e3 * y.detach(), ".", ms=3, label=name)
    axis.set(title=f"field {field[1]:g}°", xlabel="x (µm)", aspect="equal")
    axis.set_xlim(-70, 70)
axes[0].set_ylabel("y (µm)")
axes[0].legend(fontsize=8, markerscale=3)
# Picture: Section through a Cooke triplet with rays of three fields, and its spot diagrams
# Thumbnail: 0.12 0.08 0.55 0.52
plt.show()
