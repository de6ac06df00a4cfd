"""Range of validity of each propagation method

A Gaussian beam of 40 µm waist is propagated over distances from 1 mm to 1 m by four methods, and compared with the closed
form of the paraxial beam. Each method is accurate over a range that depends on pitch and size; `sampling_report` computes
these ranges.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import propagate_beam

wavelength, pitch, size, waist = 532e-9, 8e-6, 256, 40e-6
y = (np.arange(size) - size // 2) * pitch
r2 = y[:, None] ** 2 + y**2
beam = np.exp(-r2 / waist**2).astype(complex)
rayleigh = np.pi * waist**2 / wavelength


def closed_form(z):
    q = 1 - 1j * z / rayleigh
    return np.exp(-r2 / (waist**2 * q.conjugate())) / q.conjugate()


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
axis.set(xlabel="distance (cm)", ylabel="relative error of the field", ylim=(1e-7, 10))
axis.legend()
# Picture: Error of four propagation methods against the closed form of a Gaussian beam, by distance
plt.show()
