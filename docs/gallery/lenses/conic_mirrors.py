"""Sphere, parabola and ellipse as mirrors

Why are the mirrors of telescopes parabolas? All light that comes along the axis travels the same path to the focus of a
parabola. A sphere, which is much easier to polish, misses by an amount that grows with the third power of the aperture;
other conics are needed where the object is near or the mirrors are two.

[Design a lens](../../guides/design_a_lens.md) goes on from here.
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

# %%
# One mirror of 100 mm radius, f/0.9, with three conic constants: 0 for the sphere, −1 for the parabola, below −1 for
# hyperbolas.
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
# Change: `aperture=55.0` to `aperture=20.0`: At f/2.5 the spot of the sphere is twenty times smaller than at f/0.9, by the third power of the aperture.
plt.show()
