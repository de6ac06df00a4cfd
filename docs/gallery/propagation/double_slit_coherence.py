"""Fringes of an extended source

A star is too small to be resolved, yet Michelson measured its diameter: he moved two slits apart until their fringes
vanished. Each point of an extended source makes fringes of its own, displaced against the others, and the sum loses
contrast. By van Cittert and Zernike the visibility is |2J₁(ρ)/ρ| for a round source, with ρ = 2π·(angular
radius)·(distance of the slits)/λ.

[Windows and partial coherence](../../guides/windows_and_partial_coherence.md) treats sources and spectra.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import j1

from odak.wave import disk_source, propagate_partially_coherent

# %%
# Two slits 0.4 mm apart. A source is a set of directions with weights; each is propagated, and the intensities are
# summed.
wavelength, pitch, apart = 550e-9, 5e-6, 400e-6
slits = np.zeros((8, 400), complex)
for center in (-apart / 2, apart / 2):
    first = 200 + round(center / pitch)
    slits[:, first - 3 : first + 4] = 1
radii = (0, 2e-4, 4e-4, 6e-4, 8e-4, 1e-3)
rows, visibility = [], []
for radius in radii:
    source = disk_source(radius, 6, 24) if radius else None
    image = propagate_partially_coherent(
        slits, wavelength, source, 0.5, pitch, (1, 400), 10e-6
    )
    rows.append(image[0])
    middle = image[0][150:250]
    visibility.append((middle.max() - middle.min()) / (middle.max() + middle.min()))

# %%
# Fringes of three sources, and the visibility of all beside the closed form.
figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), width_ratios=(1.6, 1))
x = (np.arange(400) - 200) * 10e-3
for radius, row in list(zip(radii, rows))[::2]:
    axes[0].plot(x, row / rows[0].max(), label=f"{1e3 * radius:g} mrad")
axes[0].set(xlabel="x (mm)", ylabel="intensity", xlim=(-2, 2), ylim=(0, 1.3))
axes[0].legend(title="radius of the source", ncols=3, loc="upper center")
rho = 2 * np.pi * np.linspace(1e-6, 1e-3, 200) * apart / wavelength
axes[1].plot(
    np.linspace(0, 1, 200), np.abs(2 * j1(rho) / rho), label="van Cittert–Zernike"
)
axes[1].plot(1e3 * np.array(radii), visibility, "o", label="computed fringes")
axes[1].set(xlabel="radius of the source (mrad)", ylabel="visibility")
axes[1].legend()
# Thumbnail: 0.3 0.6
# Picture: Fringes of two slits for three sizes of the source, and their visibility beside the closed form
# Change: `550e-9, 5e-6` to `450e-9, 5e-6`: Blue light has narrower fringes, and its visibility falls to zero at 0.69 mrad, not at 0.84 mrad.
plt.show()
