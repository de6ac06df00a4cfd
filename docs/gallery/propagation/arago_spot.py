"""Spot of Arago

Behind an opaque disc the wave from its rim arrives in phase on the axis: a bright spot stands in the centre of the
shadow. On the axis its intensity is z²/(z² + a²) for a disc of radius a, which the computed one follows.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window

pitch, size, radius, wavelength = 4e-6, 1000, 0.5e-3, 633e-9
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
r = torch.hypot(place[:, None], place)
# The outer rim of the beam is smooth, so that only the disc diffracts.
beam = torch.exp(-((r / 1.6e-3) ** 16))
field = (beam * torch.sigmoid((r - radius) / (0.3 * pitch))).to(torch.complex128)
distances = torch.tensor([0.1, 0.15, 0.2, 0.3], dtype=torch.float64)
images = (
    propagate_to_window(field, wavelength, distances, pitch, (256, 256), pitch)
    .abs()
    .square()
)
for distance, image in zip(distances, images):
    exact = float(distance**2 / (distance**2 + radius**2))
    print(
        f"{100 * distance:.0f} cm: intensity on the axis {image[128, 128]:.3f}, "
        f"closed form {exact:.3f}"
    )

# %%
half = 1e3 * 128 * pitch
figure, axes = plt.subplots(1, 3, figsize=(12, 3.5))
for axis, index in zip(axes, (0, 3)):
    drawn = axis.imshow(images[index], extent=[-half, half, half, -half], vmax=1.6)
    axis.set(title=f"{100 * distances[index]:g} cm", xlabel="x (mm)", ylabel="y (mm)")
    figure.colorbar(drawn, ax=axis, label="intensity", shrink=0.8)
axes[2].plot(1e3 * place[372:628], images[3][128])
axes[2].axvspan(-0.5, 0.5, color="0.9", label="geometrical shadow")
axes[2].set(title="row through the centre, 30 cm", xlabel="x (mm)", ylabel="intensity")
axes[2].set_ylim(0, 1.25)
axes[2].legend(loc="upper center")
# Thumbnail: 0.42
# Picture: Shadows of a disc with a bright spot in the centre, and the intensity along a row
plt.show()
