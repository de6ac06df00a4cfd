"""Chromaticity diagram

Which colours can a display show? In the chromaticity diagram of 1931 the mixtures of two lights lie on the line between
them, so that three primaries show the triangle between them and no more. Lasers stand on the spectral locus and have
the largest triangle; whoever mixes pictures for one display and shows them on another changes all colours.

[Colour](../../guides/colour.md) explains primaries, white and adaptation.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import (
    color_matching_functions,
    linear_rgb_to_rgb,
    rgb_to_xyz_matrix,
    xyz_to_linear_rgb,
)

# %%
# The locus of all spectral colours by the functions of the CIE 1931 observer.
wavelengths = torch.arange(400, 701, dtype=torch.float64)
locus = color_matching_functions(wavelengths)
locus = locus / locus.sum(0)

# %%
# The colours that a screen can show at each place, as light as possible; outside sRGB they are clipped.
size = 500
x, y = torch.meshgrid(
    torch.linspace(0, 0.8, size), torch.linspace(1e-3, 0.9, size), indexing="xy"
)
xyz = torch.stack((x / y, torch.ones_like(y), (1 - x - y) / y))
rgb = xyz_to_linear_rgb(xyz[None])[0].clamp(0)
rgb = linear_rgb_to_rgb((rgb / rgb.amax(0).clamp_min(1e-6))[None])[0].permute(1, 2, 0)
figure, axis = plt.subplots(figsize=(6.5, 6.5))
drawn = axis.imshow(rgb, extent=[0, 0.8, 0, 0.9], origin="lower")
outline = plt.Polygon(
    locus[:2].T.numpy(), closed=True, transform=axis.transData, fc="none", ec="k"
)
axis.add_patch(outline)
drawn.set_clip_path(outline)

# %%
# The triangles of sRGB and of three lasers.
srgb = torch.tensor([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06], [0.64, 0.33]])
lasers = color_matching_functions(torch.tensor([639.0, 515.0, 473.0]))
lasers = (lasers / lasers.sum(0))[:2].T
axis.plot(*srgb.T, "k-", lw=1, label="sRGB")
axis.plot(
    *torch.cat((lasers, lasers[:1])).T,
    "k--",
    lw=1,
    label="lasers at 639, 515 and 473 nm",
)
for wavelength in (460, 480, 500, 520, 540, 560, 580, 600, 620):
    point = locus[:2, wavelength - 400]
    away = point - torch.tensor([0.31, 0.33])  # from white
    place = (12 * away / away.norm()).tolist()
    axis.plot(*point, "k.", ms=4)
    axis.annotate(
        f"{wavelength}",
        point,
        xytext=place,
        textcoords="offset points",
        fontsize=8,
        ha="center",
        va="center",
    )
axis.set(xlabel="x", ylabel="y", xlim=(-0.05, 0.8), ylim=(0, 0.9))
axis.legend()
# Picture: The chromaticity diagram in colour, with the spectral locus and the gamuts of sRGB and of three lasers
# Change: `[639.0, 515.0, 473.0]` to `[620.0, 550.0, 450.0]`: With green at 550 nm the greens and cyans of sRGB are lost, though all three are lasers.
plt.show()
