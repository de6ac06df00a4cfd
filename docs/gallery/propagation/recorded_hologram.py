"""A hologram recorded by a camera

A camera records intensities, and the phase is lost; with a reference wave beside the object it is kept in the fringes.
This is digital holography, by which transparent cells become visible and are refocused after the exposure. In the
spectrum of the record the field stands beside its conjugate, apart by the tilt of the reference: a filter takes it out.

[Record holograms with a camera](../../guides/record_holograms.md) adds in-line and phase-shifting holography.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import (
    circular_aperture,
    off_axis_field,
    propagate_beam,
    recorded_intensity,
    reference_wave,
)

# %%
# A ring of phase in a smooth window is 2.5 mm out of focus when it meets the tilted reference on the camera.
n, dx, wavelength, distance = 384, 2e-6, 532e-9, 2.5e-3
ring = circular_aperture((n, n), dx, 120e-6) - circular_aperture((n, n), dx, 40e-6)
y, x = np.meshgrid(*[(np.arange(n) - n // 2) * dx] * 2, indexing="ij")
thing = np.exp(-(((x**2 + y**2) / 280e-6**2) ** 4)) * np.exp(1.2j * ring)
there = propagate_beam(thing, None, distance, dx, wavelength, "Angular Spectrum")
reference = reference_wave((n, n), dx, wavelength, (3.5, 3.5), 1.5)
hologram = recorded_intensity(there, reference)

# %%
# The field is filtered out of the record, demodulated and propagated back to the object.
# The sharp edges of the ring exceed the band of the filter, as a warning says.
found = off_axis_field(hologram, reference, dx)
back = propagate_beam(found, None, -distance, dx, wavelength, "Angular Spectrum")
error = np.linalg.norm(found - there) / np.linalg.norm(there)
print(f"relative error of the field {error:.3f}")

# %%
# The circles are the bands of the two conjugate orders.
figure, axes = plt.subplots(1, 3, figsize=(13, 3.8))
reach = 1e3 * dx * n / 2
extent = [-reach, reach, reach, -reach]
drawn = axes[0].imshow(hologram, cmap="gray", extent=extent)
axes[0].set(title="recorded intensity", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(drawn, ax=axes[0], shrink=0.8)
spectrum = np.abs(np.fft.fftshift(np.fft.fft2(hologram)))
limit = 1e-3 / (2 * dx)
drawn = axes[1].imshow(
    np.log10(spectrum / spectrum.max() + 1e-7),
    extent=[-limit, limit, limit, -limit],
    vmin=-6,
)
carrier = 1e-3 * np.sin(np.radians(3.5)) / wavelength
for sign in (-1, 1):
    centre = (sign * carrier, sign * carrier)
    axes[1].add_patch(
        plt.Circle(centre, np.sqrt(2) * carrier / 3, fill=False, color="w", ls="--")
    )
axes[1].set(title="its spectrum, log10", xlabel="cycles/mm", ylabel="cycles/mm")
figure.colorbar(drawn, ax=axes[1], shrink=0.8)
inner = np.where(np.abs(back) > 0.2, np.angle(back), np.nan)
drawn = axes[2].imshow(inner, extent=extent, vmin=-0.5, vmax=1.5)
axes[2].set(title="phase at the object", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[2], label="rad", shrink=0.8)
# Thumbnail: 0.4
# Picture: Fringes on a camera, their spectrum with the orders encircled, and the phase of a ring found from it
# Change: `(3.5, 3.5), 1.5` to `(2.0, 2.0), 1.5`: With a smaller tilt the orders come closer to the middle, the filter gets narrower, and the error of the field grows to 0.10.
plt.show()
