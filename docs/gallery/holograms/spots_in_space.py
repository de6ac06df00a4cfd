"""Spots in three dimensions

One pattern can focus light on points at several depths: it is the sum of lenses, one for each point, with phases and
weights that decide how evenly the light is shared. Neurons are excited and atoms are held so, in three dimensions at
once.

[From your SLM to a corrected hologram](../../guides/from_slm_to_hologram.md) puts spots on a real table.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window, spot_hologram, uniformity

# %%
# A helix of 24 points from 8 to 12 cm, and 40 iterations that make them equal.
wavelength, pitch, resolution = 532e-9, 8e-6, (400, 400)
angle = torch.linspace(0, 4 * torch.pi, 25, dtype=torch.float64)[:-1]
depth = 0.08 + 0.04 * angle / (4 * torch.pi)
points = torch.stack((6e-4 * angle.cos(), 6e-4 * angle.sin(), depth), dim=-1)
hologram, spots = spot_hologram(points, resolution, wavelength, pitch, 40, seed=1)
print(f"uniformity of {len(points)} spots: {uniformity(spots.abs().square()):.4f}")

# %%
# At each depth other spots are in focus.
figure = plt.figure(figsize=(13, 3.8))
axes = figure.subplots(1, 4)
axes[0].imshow(
    hologram.angle() % (2 * torch.pi), cmap="twilight", extent=[-1.6, 1.6, 1.6, -1.6]
)
axes[0].set(title="hologram, 0 … 2π", xlabel="x (mm)", ylabel="y (mm)")
for axis, z in zip(axes[1:], (0.083, 0.1, 0.117)):
    image = propagate_to_window(hologram, wavelength, z, pitch, (150, 150), 10e-6).abs()
    drawn = axis.imshow(
        image / image.max(), vmax=0.5, extent=[-0.75, 0.75, 0.75, -0.75]
    )
    axis.set(title=f"{100 * z:.1f} cm", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[-1], label="amplitude", shrink=0.8)
# Thumbnail: 0.1
# Picture: Hologram of a helix of spots, and the fields at three depths, where other spots are in focus
# Change: `+ 0.04 * angle` to `+ 0.01 * angle`: Over a depth of 1 cm instead of 4 cm all of the helix is nearly in focus in the first plane, and none of it in the two others.
plt.show()
