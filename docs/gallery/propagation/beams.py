"""Beams: amplitude and phase

Lasers and fibres deliver modes, not plane waves, and traps, microscopes and displays use beams that keep their shape or
bend. Hermite–Gauss and Laguerre–Gauss modes are the light of resonators with square and round symmetry; a Bessel beam
keeps its core over a long distance, and an Airy beam follows a parabola. Modes are normalised to a power of 1, the two
others to a peak of 1, since they would need infinite power.

[Propagate light](../../guides/propagate_light.md) lets them travel.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import (
    airy_beam,
    bessel_beam,
    hermite_gaussian_beam,
    laguerre_gaussian_beam,
)

# %%
# Each beam is a complex field on the same grid. Powers are sums over pixels times their area.
shape, dx, wavelength, waist = (256, 256), 4e-6, 532e-9, 150e-6
beams = {
    "Hermite–Gauss (2, 1)": hermite_gaussian_beam(shape, dx, wavelength, waist, (2, 1)),
    "Laguerre–Gauss p = 1, l = 2": laguerre_gaussian_beam(
        shape, dx, wavelength, waist, 1, 2
    ),
    "Bessel–Gauss l = 1": bessel_beam(shape, dx, wavelength, 0.5, 1, waist=250e-6),
    "Airy": airy_beam(shape, dx, 35e-6, 0.06, offset=(150e-6, 150e-6)),
}
for name, beam in list(beams.items())[:2]:
    print(f"{name}: power {(abs(beam) ** 2).sum() * dx**2:.9f}")

# %%
# Amplitudes above, phases below. The phase of a mode with l = 2 turns twice around the axis.
figure, axes = plt.subplots(2, 4, figsize=(13, 6.4))
reach = 1e3 * 128 * dx
for column, (name, beam) in enumerate(beams.items()):
    amplitude = abs(beam) / abs(beam).max()
    shown = axes[0, column].imshow(amplitude, extent=[-reach, reach, reach, -reach])
    axes[0, column].set(title=name, xlabel="x (mm)", ylabel="y (mm)")
    phase = np.where(amplitude > 0.01, np.angle(beam), np.nan)
    turned = axes[1, column].imshow(
        phase,
        extent=[-reach, reach, reach, -reach],
        cmap="twilight",
        vmin=-np.pi,
        vmax=np.pi,
    )
    axes[1, column].set(xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(shown, ax=axes[0], label="amplitude", shrink=0.8)
figure.colorbar(turned, ax=axes[1], label="phase (rad)", shrink=0.8)
# Thumbnail: 0.3
# Picture: Amplitude and phase of a Hermite–Gauss, a Laguerre–Gauss, a Bessel and an Airy beam
# Change: `waist, 1, 2` to `waist, 0, 5`: With p = 0 one ring is left, and with l = 5 the phase turns five times and the dark core grows.
plt.show()
