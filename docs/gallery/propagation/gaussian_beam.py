"""Width of a Gaussian beam

The beam of a laser widens as w(z) = w₀·√(1 + (z/z₀)²), with z₀ = πw₀²/λ: the narrower its waist, the faster. This
decides how far a beam stays usable and how small it can be focused. As the formula is exact for paraxial waves, it is
also a good test of a propagation method.

[Propagate light](../../guides/propagate_light.md) goes on from here.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import propagate_to_window

# %%
# A waist of 100 µm on pixels of 10 µm, and the intensity of one row for each of 81 distances.
wavelength, waist, pitch, size = 633e-9, 100e-6, 10e-6, 256
place = (np.arange(size) - size // 2) * pitch
field = np.exp(-(place[:, None] ** 2 + place**2) / waist**2).astype(complex)
z = np.linspace(0, 0.2, 81)
section = (
    np.stack(
        [
            np.abs(propagate_to_window(field, wavelength, d, pitch))[size // 2]
            for d in z
        ],
        axis=1,
    )
    ** 2
)

# %%
# The radius is twice the standard deviation of the intensity, which for a Gaussian beam is w.
power = section / section.sum(0)
radius = 2 * np.sqrt((power * place[:, None] ** 2).sum(0))
exact = waist * np.sqrt(1 + (z * wavelength / (np.pi * waist**2)) ** 2)
print(f"largest deviation from the closed form: {np.abs(radius / exact - 1).max():.1e}")

# %%
# The section is drawn on a logarithmic scale, with the closed form on it.
figure, axis = plt.subplots(figsize=(9, 4))
drawn = axis.imshow(
    section.clip(1e-9),  # a logarithmic scale has no place for zeros
    extent=[0, 100 * z[-1], 1e3 * place[-1], 1e3 * place[0]],
    aspect="auto",
    norm="log",
    vmin=1e-5,
    vmax=1,
)
for sign in (-1, 1):
    axis.plot(
        100 * z,
        sign * 1e3 * exact,
        "w--",
        lw=1,
        label="w(z), closed form" if sign > 0 else None,
    )
axis.set(xlabel="z (cm)", ylabel="x (mm)", ylim=(-1, 1))
axis.legend(labelcolor="w", loc="upper center")
figure.colorbar(drawn, label="intensity")
# Thumbnail: 0.4
# Picture: Section along a Gaussian beam that widens, with the closed form of its radius
# Change: `100e-6, 10e-6` to `60e-6, 10e-6`: A narrower waist diffracts more: after 20 cm the beam is wider than that of the wider waist.
plt.show()
