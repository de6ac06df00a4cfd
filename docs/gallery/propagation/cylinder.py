"""Scattering by a cylinder

Spheres and cylinders of the size of the wavelength bend light in ways that neither rays nor a thin phase describe:
cells in a microscope, droplets and fibres do so. The convergent Born series computes the exact field of any
distribution of the refractive index, with all orders of scattering, reflections included. Behind a glass cylinder of
two wavelengths' radius the light meets in a narrow focus at the rim.

[Polarised light, beams and media](../../guides/polarised_light_and_media.md) shows the other methods for media.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import scattered_field

# %%
# The index is given on a grid of fourteen samples to the wavelength; the rim of the cylinder is averaged over a pixel.
# The incident wave comes from the left.
wavelength, dx, count = 633e-9, 633e-9 / 14, 224
y = ((np.arange(count) - count // 2) * dx)[:, None]
x = ((np.arange(count) - count // 4) * dx)[None, :]
radius = 2 * wavelength
inside = np.clip((radius - np.hypot(x, y)) / dx + 0.5, 0, 1)
index = np.sqrt(1 + (1.45**2 - 1) * inside)
incident = np.exp(2j * np.pi / wavelength * x) * np.ones_like(y)
total = scattered_field(incident, index, dx, wavelength, tolerance=1e-4)
row, column = np.unravel_index(abs(total).argmax(), total.shape)
print(
    f"largest intensity {abs(total).max() ** 2:.1f} "
    f"at {x[0, column] / radius:.2f} radii behind the centre"
)

# %%
# The real part shows the standing wave before the cylinder, the intensity the focus.
figure, axes = plt.subplots(1, 2, figsize=(11, 4.6))
extent = np.array([x[0, 0], x[0, -1], y[-1, 0], y[0, 0]]) / wavelength
limit = abs(total.real).max()
shown = (
    ("real part", total.real, {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}),
    ("intensity", abs(total) ** 2, {}),
)
for axis, (title, picture, options) in zip(axes, shown):
    drawn = axis.imshow(picture, extent=extent, **options)
    axis.add_patch(
        plt.Circle((0, 0), radius / wavelength, fill=False, ls=":", color="0.5")
    )
    axis.set(title=title, xlabel="x (λ)", ylabel="y (λ)")
    figure.colorbar(drawn, ax=axis)
# Picture: Field and intensity around a glass cylinder, a plane wave from the left, a focus at the right rim
# Change: `1.45**2` to `1.33**2`: Water instead of glass bends less: the focus moves away from the rim and becomes wider and weaker.
plt.show()
