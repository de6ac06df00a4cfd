"""Reflection at glass and at gold

How much light does a window reflect, and at which angle none? Fresnel's equations answer for both polarisations and any
pair of media: at Brewster's angle a dielectric reflects no p-polarised light, beyond the critical angle it reflects all
light, and a metal, whose index is complex, reflects both nearly everywhere.

[Polarisation](../../guides/polarisation.md) goes on from here.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.raytracing import fresnel_coefficients

# %%
# Rays at 300 angles of incidence meet a plane across z.
angle = np.radians(np.linspace(0, 89.9, 300))
direction = np.stack((np.zeros_like(angle), np.sin(angle), np.cos(angle)), axis=-1)
rays = np.stack((np.zeros_like(direction), direction), axis=1)
normal = [[0, 0, 0], [0, 0, 1]]

# %%
# One call gives the amplitudes and the shares of power; three pairs of media are compared.
figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), sharey=True)
cases = (
    ("air to glass", 1.0, 1.5168),
    ("glass to air", 1.5168, 1.0),
    ("air to gold, 633 nm", 1.0, 0.18 + 3.43j),
)
for axis, (name, n1, n2) in zip(axes, cases):
    found = fresnel_coefficients(rays, normal, n1, n2)
    axis.plot(np.degrees(angle), found.reflectance_s, label="s")
    axis.plot(np.degrees(angle), found.reflectance_p, label="p")
    if np.isreal(n2):
        brewster = np.degrees(np.arctan(n2 / n1))
        axis.axvline(brewster, color="0.6", ls=":", label=f"Brewster {brewster:.1f}°")
    axis.set(title=name, xlabel="angle of incidence (°)", ylim=(0, 1.02))
    axis.legend()
axes[0].set_ylabel("reflectance")
# Thumbnail: 0.18 0.36
# Picture: Reflectance of s and p polarised light by angle, at glass from both sides and at gold
# Change: `0.18 + 3.43j` to `1.37 + 7.62j`: Aluminium at 633 nm reflects 91 % and dips for p-polarised light at grazing incidence.
plt.show()
