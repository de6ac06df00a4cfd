"""Reflection at glass and at gold

Reflectance by the angle of incidence: at Brewster's angle a dielectric reflects no p-polarised light; a metal reflects
both nearly everywhere.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.raytracing import fresnel_coefficients

angle = np.radians(np.linspace(0, 89.9, 300))
direction = np.stack((np.zeros_like(angle), np.sin(angle), np.cos(angle)), axis=-1)
rays = np.stack((np.zeros_like(direction), direction), axis=1)
normal = [[0, 0, 0], [0, 0, 1]]
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
plt.show()
