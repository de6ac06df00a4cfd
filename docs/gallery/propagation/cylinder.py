"""Scattering by a cylinder

All orders of scattering by a glass cylinder, from the convergent Born series: a standing wave in front, a focus behind.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import scattered_field

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
plt.show()
