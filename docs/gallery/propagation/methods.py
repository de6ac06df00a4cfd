"""Range of validity of each propagation method

Each method of propagation is exact in the continuum and wrong on some grid: transfer functions are undersampled at long
distances, impulse responses at short ones. A Gaussian beam, whose paraxial field is known in closed form, shows where.
The question need not be asked each time, since `propagate_beam` without a method chooses one that is accurate on the
given grid.

[Propagate light](../../guides/propagate_light.md) describes the choice, `sampling_report` the ranges.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import propagate_beam

# %%
# The beam, and its closed form with the complex parameter q.
wavelength, pitch, size, waist = 532e-9, 8e-6, 256, 40e-6
y = (np.arange(size) - size // 2) * pitch
r2 = y[:, None] ** 2 + y**2
beam = np.exp(-r2 / waist**2).astype(complex)
rayleigh = np.pi * waist**2 / wavelength


def closed_form(z):
    q = 1 - 1j * z / rayleigh
    return np.exp(-r2 / (waist**2 * q.conjugate())) / q.conjugate()

# %%
# Four methods over three decades of distance. A constant phase is no error, and is taken away before the difference.
distances = np.geomspace(1e-3, 1.0, 25)
methods = (
    "Angular Spectrum",
    "Bandlimited Angular Spectrum",
    "Transfer Function Fresnel",
    "Impulse Response Fresnel",
)
figure, axis = plt.subplots(figsize=(8, 4.5))
styles = ["-.", ":", "--", "-"]
for method in methods:
    errors = []
    for z in distances:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore"
            )  # outside its range a method warns; here that range is what is shown
            found = propagate_beam(
                beam,
                None,
                z,
                pitch,
                wavelength,
                method,
                zero_padding=(True, False, True),
            )
        exact = closed_form(z)
        found = found * np.exp(-1j * np.angle((found * exact.conj()).sum()))
        errors.append(np.linalg.norm(found - exact) / np.linalg.norm(exact))
    axis.loglog(100 * distances, errors, label=method, ls=styles.pop())

# %%
# Where a curve rises, its method has left its range.
axis.set(xlabel="distance (cm)", ylabel="relative error of the field", ylim=(1e-7, 10))
axis.legend()
# Picture: Error of four propagation methods against the closed form of a Gaussian beam, by distance
# Change: `size, waist = 532e-9, 8e-6, 256, 40e-6` to `size, waist = 532e-9, 8e-6, 128, 40e-6`: On half the grid the transfer functions leave their range at half the distance.
plt.show()
