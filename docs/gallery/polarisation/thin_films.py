"""Thin films: an antireflection coating and a mirror

Bare glass reflects 4 % at each surface, a lens of ten surfaces a third of the light, and a laser needs mirrors that
lose less than a thousandth. Films of a quarter wave do both: their reflections cancel in the one case and add up in the
other.

[Polarised light, beams and media](../../guides/polarised_light_and_media.md) lists the functions for films.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.jones import thin_film_stack

# %%
# Thicknesses of a quarter of the wavelength in each film, for 550 nm; a film of magnesium fluoride, and a mirror of 17
# films.
design = 550e-9
wavelength = np.linspace(380e-9, 780e-9, 401)
low, high, glass = 1.46, 2.35, 1.52
mirror_indices = [1.0, *[high, low] * 8, high, glass]
mirror = [design / 4 / n for n in mirror_indices[1:-1]]
coatings = {
    "bare glass": thin_film_stack(wavelength, [1.0, glass], []),
    "one film of n = 1.38": thin_film_stack(
        wavelength, [1.0, 1.38, glass], [design / 4 / 1.38]
    ),
}

# %%
# The reflectance at the design wavelength, as textbooks have it.
stack = thin_film_stack(wavelength, mirror_indices, mirror)
print(
    "coated glass at 550 nm: R = "
    f"{thin_film_stack(design, [1, 1.38, glass], [design / 4 / 1.38]).reflectance:.7f}"
)
print(
    "mirror at 550 nm: R = "
    f"{thin_film_stack(design, mirror_indices, mirror).reflectance:.7f}"
)

# %%
# By wavelength, and for the mirror by angle and polarisation: its band moves to the blue, and laser light of 633 nm
# falls out of it or into it.
figure, axes = plt.subplots(1, 3, figsize=(13, 3.8))
for name, response in coatings.items():
    axes[0].plot(1e9 * wavelength, 100 * response.reflectance, label=name)
axes[0].set(
    title="antireflection coating",
    ylim=(0, 5),
    ylabel="reflectance (%)",
    xlabel="wavelength (nm)",
)
axes[0].legend()
axes[1].plot(1e9 * wavelength, 100 * stack.reflectance)
axes[1].set(
    title=f"mirror of {len(mirror)} films",
    ylabel="reflectance (%)",
    xlabel="wavelength (nm)",
)
angle = np.linspace(0, 89, 200)
for polarization in "sp":
    response = thin_film_stack(633e-9, mirror_indices, mirror, angle, polarization)
    axes[2].plot(angle, 100 * response.reflectance, label=f"{polarization}-polarised")
axes[2].set(
    title="the mirror at 633 nm",
    ylabel="reflectance (%)",
    xlabel="angle of incidence (°)",
)
axes[2].legend()
# Thumbnail: 0.498 0.336
# Picture: Reflectance of coated glass and of a mirror by wavelength, and of the mirror by angle for both polarisations
# Change: `[high, low] * 8` to `[high, low] * 3`: With seven films instead of seventeen the mirror reflects 94 % in a wider, softer band.
plt.show()
