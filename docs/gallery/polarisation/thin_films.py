"""Thin films: an antireflection coating and a mirror

A quarter wave of magnesium fluoride reduces the reflection of glass; seventeen quarter waves of alternating high and low
index reflect nearly everything within a band.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.jones import thin_film_stack

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
    title="mirror of 17 films", ylabel="reflectance (%)", xlabel="wavelength (nm)"
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
plt.show()
