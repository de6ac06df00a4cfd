"""Interference colours between crossed polarisers

Geologists read the thickness of a crystal from its colour between crossed polarisers, and engineers the stress in
plastic. A birefringent sample delays one polarisation by a path, a number of nanometres, which is another phase for
each wavelength: some are passed, others are not, and daylight becomes one of Newton's colours.

[Polarisation](../../guides/polarisation.md) and [Colour](../../guides/colour.md) explain the two halves.
"""

import matplotlib.pyplot as plt
import numpy as np
import torch

from odak.jones import apply_matrix, electricfield, linearpolarizer, retarder
from odak.learn.perception import (
    color_matching_functions,
    illuminant_d65,
    linear_rgb_to_rgb,
    xyz_to_linear_rgb,
)

# %%
# Light along x passes a retarder at 45° and an analyser at 90°, wavelength by wavelength.
path = np.linspace(0, 2200, 600)
wavelengths = np.arange(400, 701, 5.0)
passed = np.empty((len(wavelengths), len(path)))
for row, wavelength in enumerate(wavelengths):
    field = apply_matrix(retarder(360 * path / wavelength, 45), electricfield(1, 0))
    passed[row] = (np.abs(linearpolarizer(field, 90)) ** 2).sum((-2, -1))

# %%
# The spectrum of daylight times the transmission gives the tristimulus values, and these the colour on a screen.
daylight = np.asarray(illuminant_d65(torch.tensor(wavelengths)))
matching = np.asarray(color_matching_functions(torch.tensor(wavelengths)))
xyz = matching @ (daylight[:, None] * passed) / (matching[1] @ daylight)
image = linear_rgb_to_rgb(
    xyz_to_linear_rgb(torch.tensor(xyz)[None, :, None]).clamp(0, 1)
)[0]

# %%
# Colours fade with the path, as ever more wavelengths pass at once: white of higher order.
figure, axes = plt.subplots(2, 1, figsize=(10, 4), sharex=True, height_ratios=(1.3, 1))
axes[0].imshow(
    image.permute(1, 2, 0).repeat(80, 1, 1), extent=[0, path[-1], 0, 1], aspect="auto"
)
axes[0].set(yticks=[], title="colours of a wedge between crossed polarisers")
for wavelength, color in ((450, "tab:blue"), (550, "tab:green"), (650, "tab:red")):
    axes[1].plot(
        path, passed[int((wavelength - 400) / 5)], color=color, label=f"{wavelength} nm"
    )
axes[1].set(xlabel="path difference (nm)", ylabel="transmission")
axes[1].legend(ncols=3, loc="lower right", bbox_to_anchor=(1, 0.98))
# Picture: Newton's colours of a birefringent wedge, and its transmission at three wavelengths
# Change: `360 * path / wavelength, 45` to `360 * path / wavelength, 20`: Away from 45° the same colours are paler: sin²(2·20°) = 0.41 of the light passes.
plt.show()
