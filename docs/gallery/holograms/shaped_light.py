"""Tweezers and structured illumination: vortex, Bessel lattice, light sheet

A phase modulator in front of a lens shapes light for more than pictures. A spiral phase turns the focus into a ring
that carries orbital angular momentum and spins particles. Six plane waves on a cone, behind a ring in the Fourier
plane, form a lattice that keeps its shape. A cylindrical lens forms the thin sheet of a microscope.

[Propagate light](../../guides/propagate_light.md) has the elements.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import (
    circular_aperture,
    cylindrical_lens_phase,
    lens_phase,
    propagate_to_window,
    spiral_phase,
)

# %%
# A Gaussian beam on the modulator, and windows that zoom into what it forms.
n, dx, wavelength, focal = 400, 8e-6, 532e-9, 0.1
y, x = np.meshgrid(*[(np.arange(n) - n // 2) * dx] * 2, indexing="ij")
beam = np.exp(-(x**2 + y**2) / 1.1e-3**2)
lens = lens_phase((n, n), focal, dx, wavelength)


def near(field, z, size, pitch, shift=(0.0, 0.0)):
    found = propagate_to_window(field, wavelength, z, dx, size, pitch, shift)
    return np.abs(found) ** 2

# %%
# The vortex: a spiral with the phase of a lens, and a tilt that moves it beside the axis.
# A vortex of charge 3 beside the axis: the ring of a rotating trap.
charge, aside = 3, 0.15e-3
tilt = 2 * np.pi * aside * x / (wavelength * focal)
vortex = beam * np.exp(1j * (lens + spiral_phase((n, n), charge) + tilt))
ring = near(vortex, focal, (128, 128), 2e-6, (0.0, aside))
radius = np.hypot(*np.meshgrid(*[(np.arange(128) - 64) * 2e-6] * 2))
bright = radius[np.unravel_index(ring.argmax(), ring.shape)]
print(f"vortex: bright ring of {1e6 * bright:.0f} µm, dark middle {ring[64, 64]:.0e}")

# %%
# The lattice, with the filter that takes the light of other frequencies away.
# Plane waves on a cone of 0.15 degrees: phase of their sum, as the modulator shows it.
slope = 2 * np.pi / wavelength * np.sin(np.radians(0.15))
angles = 2 * np.pi * np.arange(6) / 6
waves = sum(np.exp(1j * slope * (x * np.cos(a) + y * np.sin(a))) for a in angles)
inside = circular_aperture((n, n), dx, 1.4e-3)
lattice = np.where(inside > 0, np.exp(1j * np.angle(waves)), 0)
frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(n, dx)] * 2))
ring_mask = np.abs(frequency * 2 * np.pi / slope - 1) < 0.3
filtered = np.fft.ifft2(np.fft.fft2(lattice) * ring_mask)
along = [near(filtered, z, (96, 96), 8e-6) for z in (0.02, 0.06, 0.12)]

# %%
# The sheet, over the depth of its focus.
# A cylindrical lens: a sheet that is thin along y over the depth of its focus.
sheet = beam * np.exp(1j * cylindrical_lens_phase((n, n), focal, dx, wavelength, 90.0))
depths = np.linspace(0.07, 0.13, 61)
profile = np.stack([near(sheet, z, (128, 1), 2e-6)[:, 0] for z in depths], -1)
row = profile[:, 30]
width = 2e-6 * (row > row.max() / 2).sum()
print(f"light sheet: {1e6 * width:.0f} µm thick (full width at half maximum)")

# %%
# Patterns above, light below.
figure, axes = plt.subplots(2, 3, figsize=(12, 7))
half = 1e3 * n * dx / 2
patterns = ("vortex trap", vortex), ("lattice", lattice), ("light sheet", sheet)
for axis, (name, field) in zip(axes[0], patterns):
    phase = np.where(np.abs(field) > 0, np.angle(field) % (2 * np.pi), np.nan)
    drawn = axis.imshow(phase, cmap="twilight", extent=[-half, half, half, -half])
    axis.set(title=f"{name}: phase", xlabel="x (mm)", ylabel="y (mm)")
    figure.colorbar(drawn, ax=axis, shrink=0.8, label="rad")
panels = (
    (ring / ring.max(), [-128, 128, 128, -128], "focal plane", "x (µm)", "y (µm)"),
    (along[1] / along[1].max(), [-384, 384, 384, -384], "at 6 cm", "x (µm)", "y (µm)"),
    (profile / profile.max(), [70, 130, 128, -128], "section", "z (mm)", "y (µm)"),
)
for axis, (light, extent, title, across, down) in zip(axes[1], panels):
    aspect = "auto" if title == "section" else "equal"
    drawn = axis.imshow(light, extent=extent, aspect=aspect)
    axis.set(title=title, xlabel=across, ylabel=down)
    figure.colorbar(drawn, ax=axis, shrink=0.8, label="intensity")
likeness = [np.corrcoef(part.ravel(), along[1].ravel())[0, 1] for part in along]
print(f"lattice at 2 and 12 cm against 6 cm: {likeness[0]:.2f}, {likeness[2]:.2f}")
# Thumbnail: 0.4
# Picture: Phase patterns of a vortex trap, a lattice of six waves and a light sheet, and the light that they form
# Change: `charge, aside = 3, 0.15e-3` to `charge, aside = 8, 0.15e-3`: The bright ring of a vortex grows about in proportion to its charge.
plt.show()
