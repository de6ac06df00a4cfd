"""Light in a graded-index fibre

A graded-index fibre guides light without a wall: the index falls with the distance from the axis, and a beam off the
axis is bent back. It swings with the period 2π/g of the profile n₀(1 − g²x²/2), and if its width is that of the mode it
keeps it, as the wave packet of a harmonic oscillator does.

[Polarised light, beams and media](../../guides/polarised_light_and_media.md) describes split-step propagation.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import propagate_through_medium

# %%
# The profile on a row of 256 points, and a beam of the mode's width 12 µm off the axis.
wavelength, n0, g = 1e-6, 1.5, 4000.0
count, dx, dz, slices = 256, 0.25e-6, 2e-6, 1200
x = (np.arange(count) - count // 2) * dx
index = n0 * (1 - (g * x) ** 2 / 2)[None, :]
width = math.sqrt(
    wavelength / (math.pi * n0 * g)
)  # radius of the mode, which stays as it is
field = np.exp(-(((x - 12e-6) / width) ** 2))[None, :].astype(complex)

# %%
# Four slices at a time, with an absorber at the ends of the row, so that nothing returns from there.
profile = []
for _ in range(slices // 4):
    field = propagate_through_medium(
        field, [index] * 4, dx, dz, wavelength, absorber=4e-6
    )
    profile.append(abs(field[0]) ** 2)
profile = np.array(profile).T
z = (np.arange(slices // 4) + 1) * 4 * dz

# %%
# The centre of the beam turns where half a period is over.
centre = (profile * x[:, None]).sum(axis=0) / profile.sum(axis=0)
first = np.argmin(
    abs(centre[: len(centre) * 3 // 5] - centre[: len(centre) * 3 // 5].min())
)
print(
    f"turning point after {1e3 * z[first]:.3f} mm; "
    f"half a period π/g is {1e3 * math.pi / g:.3f} mm"
)

# %%
# The ray is that of geometrical optics.
figure, axis = plt.subplots(figsize=(11, 4))
drawn = axis.imshow(
    profile, extent=[0, 1e3 * z[-1], 1e6 * x[-1], 1e6 * x[0]], aspect="auto"
)
axis.plot(
    1e3 * z,
    1e6 * 12e-6 * np.cos(g * z),
    color="#56B4E9",
    ls=":",
    label="ray: 12 µm · cos(gz)",
)
axis.set(xlabel="z (mm)", ylabel="x (µm)", ylim=(25, -25))
axis.legend(labelcolor="w")
figure.colorbar(drawn, label="intensity")
# Picture: A beam that swings from side to side in a graded-index medium, with the ray drawn over it
# Change: `-(((x - 12e-6) / width) ** 2)` to `-(((x - 12e-6) / (2 * width)) ** 2)`: A beam twice as wide as the mode breathes: it is narrowest at each crossing of the axis.
plt.show()
