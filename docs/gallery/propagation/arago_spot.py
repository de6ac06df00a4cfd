"""Spot of Arago

Poisson derived from Fresnel's waves that the shadow of a disc must be bright in its middle, and took this for their
end; Arago looked, and it was. The wave from all of the rim arrives in phase on the axis, where its intensity is z²/(z²
+ a²) for a disc of radius a. It tests any method of propagation, since light must come together from far apart.

[Propagate light](../../guides/propagate_light.md) compares the methods.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window

# %%
# The disc darkens the middle of a beam with a smooth outer rim, so that only the disc diffracts. Its own rim is
# softened over less than a pixel, as a round edge on square pixels needs.
pitch, size, radius, wavelength = 4e-6, 1000, 0.5e-3, 633e-9
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
r = torch.hypot(place[:, None], place)
beam = torch.exp(-((r / 1.6e-3) ** 16))
field = (beam * torch.sigmoid((r - radius) / (0.3 * pitch))).to(torch.complex128)

# %%
# All four distances are computed in one call, and the intensity on the axis is compared with the closed form.
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
# The shadow at two distances, and a row through its centre.
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
# Change: `0.5e-3, 633e-9` to `0.25e-3, 633e-9`: Half the disc, half the shadow, and the spot becomes twice as wide: its first dark ring lies at 0.38 λz/a.
plt.show()
