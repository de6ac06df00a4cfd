"""Point spread functions of aberrations

An image of a star, or of any point, shows what is wrong with an optical system: each aberration has a figure of its
own, and whoever knows the figures reads the adjustment from them. The phase of the wave in the pupil is described by
Zernike polynomials, and the image is the diffraction pattern of the pupil with this phase. The Strehl ratio is its peak
over the peak without aberration; for small aberrations of root mean square σ it is exp(−σ²).

[Propagate light](../../guides/propagate_light.md) explains windows, which zoom into the focus here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import propagate_to_window, lens_phase, zernike_phase

# %%
# Five polynomials by their orders (n, m). Each gets the same root mean square of 1.2 rad, so that their Strehl ratios
# compare only how the phase is distributed.
names = {
    (0, 0): "none",
    (2, 0): "defocus",
    (2, 2): "astigmatism",
    (3, 1): "coma",
    (3, 3): "trefoil",
    (4, 0): "spherical",
}
wavelength, pitch, size, radius, focal = 532e-9, 5e-6, 512, 1.2e-3, 0.1
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
pupil = (torch.hypot(place[:, None], place) <= radius).to(torch.float64)
lens = lens_phase((size, size), focal, pitch, wavelength)

# %%
# The pupil holds the phase of the lens and that of the aberration. `propagate_to_window` computes the focal plane on a
# grid twice as fine as the pupil's, around the axis only.
figure, axes = plt.subplots(2, 6, figsize=(13, 4.6))
reference = None
for column, (mode, name) in enumerate(names.items()):
    phase = zernike_phase(
        size, size, {mode: 0.0 if mode == (0, 0) else 1.2}, radius, pitch
    )
    field = torch.polar(pupil, lens + phase)
    spread = (
        propagate_to_window(field, wavelength, focal, pitch, (96, 96), 2.5e-6)
        .abs()
        .square()
    )
    reference = reference or float(spread.max())
    spread = spread / reference
    axes[0, column].imshow(
        torch.where(pupil > 0, phase, torch.nan), cmap="RdBu", vmin=-4, vmax=4
    )
    axes[0, column].set(title=name, xticks=[], yticks=[])
    drawn = axes[1, column].imshow(spread.sqrt(), extent=[-120, 120, 120, -120], vmax=1)
    axes[1, column].set(title=f"Strehl ratio {spread.max():.2f}", xlabel="x (µm)")
axes[0, 0].set_ylabel("phase, ±4 rad")
axes[1, 0].set_ylabel("y (µm)")
figure.colorbar(drawn, ax=axes[1], label="amplitude", shrink=0.8)
# Thumbnail: 0.62
# Picture: Phases of five Zernike polynomials and the images of a point that they give
# Change: `0.0 if mode == (0, 0) else 1.2` to `0.0 if mode == (0, 0) else 0.4`: With a third of the aberration all Strehl ratios are near exp(−0.4²) = 0.85, whatever the polynomial.
plt.show()
