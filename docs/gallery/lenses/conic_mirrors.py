"""Sphere, parabola and ellipse as mirrors

A parabolic mirror focuses an axial bundle to a point, a spherical one does not: its spot grows with the third power of
the aperture.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    launch,
    optical_system,
    spot_diagram,
    surface,
    trace,
)

figure, axes = plt.subplots(1, 3, figsize=(13, 3.8), sharey=True)
for axis, (name, conic) in zip(
    axes, (("sphere", 0.0), ("parabola", -1.0), ("hyperbola", -2.0))
):
    mirror = optical_system(
        [
            surface(
                -100.0,
                conic=conic,
                thickness=-50.0,
                material="mirror",
                semi_diameter=30.0,
                stop=True,
            )
        ],
        aperture=55.0,
    )
    rays = launch(
        mirror, torch.stack((torch.zeros(25), torch.linspace(-1, 1, 25)), -1).double()
    )
    traced = trace(mirror, rays)
    height = torch.linspace(-27.5, 27.5, 25)
    sag = -(height**2) / 100 / (1 + (1 - (1 + conic) * height**2 / 1e4).sqrt())
    for y, z, image in zip(height, sag, traced.y.detach().reshape(-1)):
        axis.plot([-70, z, -50], [y, y, image], color="tab:red", lw=0.6)
    axis.plot(sag, height, "k", lw=2)
    size = 1e3 * float(spot_diagram(mirror, "rings", 8).rms[0].detach())
    axis.set(title=f"{name}: RMS spot {size:.1f} µm", xlabel="z (mm)")
axes[0].set_ylabel("y (mm)")
# Thumbnail: 0.517 0.315
# Picture: Parallel rays reflected by a spherical, a parabolic and a hyperbolic mirror
plt.show()
