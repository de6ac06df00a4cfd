"""Talbot carpet

Behind a grating the light repeats itself without any lens: at the Talbot distance 2p²/λ, shifted by half a period at
half of it, and in finer copies at its fractions. Talbot's effect images in lithography and measures wavefronts. It
follows from the phases of the orders, which all are multiples of 2π there.

[Propagate light](../../guides/propagate_light.md) explains padding, which periodic fields must not have.
"""

import warnings

import matplotlib.pyplot as plt
import torch

from odak import SamplingWarning
from odak.learn.wave import propagate_beam

# %%
# One period is 64 pixels, a quarter of it open. The grid holds a whole number of periods, so that the periodic
# transform is the exact one: no padding.
wavelength, pitch, period, size = 532e-9, 1e-6, 64, 512
line = ((torch.arange(size) + period // 8) % period < period // 4).to(torch.complex128)
talbot = 2 * (period * pitch) ** 2 / wavelength
distances = torch.linspace(0, talbot, 300, dtype=torch.float64)
columns = []
with warnings.catch_warnings():
    # The warning is about fields that end; this one is periodic on the grid.
    warnings.simplefilter("ignore", SamplingWarning)
    for z in distances:
        options = {"propagation_type": "Angular Spectrum", "zero_padding": (False,) * 3}
        columns.append(
            propagate_beam(line.repeat(2, 1), None, z, pitch, wavelength, **options)[0]
        )
carpet = torch.stack(columns, dim=1)
alike = torch.corrcoef(torch.stack((carpet[:, 0].abs(), carpet[:, -1].abs())))[0, 1]
print(
    f"Talbot distance {1e3 * talbot:.2f} mm; "
    f"correlation of the amplitudes before and after it {alike:.3f}"
)

# %%
# A quarter of the columns would do; all are drawn, as the figure is known for its fine lines.
figure, axis = plt.subplots(figsize=(11, 4))
extent = [0, 1e3 * talbot, 1e6 * pitch * 256, 0]
drawn = axis.imshow(carpet[:256].abs().square(), extent=extent, aspect="auto", vmax=2.5)
axis.set(xlabel="z (mm)", ylabel="x (µm)")
figure.colorbar(drawn, label="intensity")
# Picture: Intensity behind a grating over one Talbot distance, a carpet of fine lines
# Change: `period // 4)` to `period // 2)`: Slits of half the period give a coarser carpet with less contrast in its fractions.
plt.show()
