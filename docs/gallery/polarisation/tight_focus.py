"""Focus of a lens with a high numerical aperture

Lithography, optical data storage and microscopes focus with numerical apertures near 1. Scalar theory then fails: the
lens turns the polarisation of the rays at its rim, so that the focus of a linearly polarised beam is wider along the
polarisation, and part of the field points along the axis (Richards and Wolf, 1959).

[Polarised light, beams and media](../../guides/polarised_light_and_media.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import focus_polarized

# %%
# A pupil polarised along x, as two components of a field; the function returns three in the focus.
wavelength, focal, aperture, count = 532e-9, 3e-3, 0.95, 256
pupil = torch.zeros(2, count, count, dtype=torch.complex128)
pupil[0] = 1  # polarised along x
step = 2 * focal * aperture / (count - 2)
window = wavelength / 40
field = focus_polarized(pupil, step, wavelength, focal, aperture, (121, 121), window)
intensity = field.abs().square()
total = intensity.sum(dim=0)
intensity = intensity / total.max()

# %%
# The widths at half maximum along both axes.
def width(profile):
    """Return the full width at half maximum in wavelengths, by linear interpolation."""
    above = torch.nonzero(profile > profile.max() / 2).flatten()
    first, last = int(above[0]), int(above[-1])
    half = profile.max() / 2
    right = (profile[last] - half) / (profile[last] - profile[last + 1])
    left = (profile[first] - half) / (profile[first] - profile[first - 1])
    return float(last - first + right + left) * window / wavelength


print(
    f"full width at half maximum: {width(total[60]):.3f} λ along x, "
    f"{width(total[:, 60]):.3f} λ along y"
)
print(f"largest |E_z|²: {intensity[2].max():.3f} of the peak")

# %%
# The total and each component.
figure, axes = plt.subplots(1, 4, figsize=(13, 3.4))
reach = 60.5 * window / wavelength
shown = [
    ("total", intensity.sum(dim=0)),
    *zip(("|E_x|²", "|E_y|²", "|E_z|²"), intensity),
]
for axis, (title, picture) in zip(axes, shown):
    drawn = axis.imshow(picture, extent=[-reach, reach, reach, -reach])
    axis.set(title=title, xlabel="x (λ)", ylabel="y (λ)")
    figure.colorbar(drawn, shrink=0.7)
# Thumbnail: 0.08
# Picture: Intensity in the focus and its three components: the spot is wider along x, the longitudinal part has two lobes
# Change: `3e-3, 0.95, 256` to `3e-3, 0.4, 256`: At a numerical aperture of 0.4 the focus is round and wider, 1.3 λ, and the field along the axis has 2 % of the peak: scalar theory is enough.
plt.show()
