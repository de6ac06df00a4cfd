"""Focus of a lens with a high numerical aperture

A lens turns the polarisation of the rays at its rim. The focus of a linearly polarised beam is wider along the
polarisation, and a part of its field points along the axis (Richards and Wolf, 1959).
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import focus_polarized

wavelength, focal, aperture, count = 532e-9, 3e-3, 0.95, 256
pupil = torch.zeros(2, count, count, dtype=torch.complex128)
pupil[0] = 1  # polarised along x
step = 2 * focal * aperture / (count - 2)
window = wavelength / 40
field = focus_polarized(pupil, step, wavelength, focal, aperture, (121, 121), window)
intensity = field.abs().square()
total = intensity.sum(dim=0)
intensity = intensity / total.max()


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
plt.show()
