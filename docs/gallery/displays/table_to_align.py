"""A table to misalign and to register

On a real table the camera is rotated, shifted, tilted and distorting, the beam is aberrated and the modulator does not
respond in proportion. This table is simulated and all its errors are drawn from a seed. The calibration uses only the
modulator and the camera, and finds where each point of the image is seen.

[Your table in an afternoon](../../guides/your_table_in_an_afternoon.md) does the same with a real one.
"""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from scipy.ndimage import map_coordinates

from odak.instruments import (
    Calibration,
    OpticalTable,
    SimulatedTable,
    measure_phase_response,
    measure_wavefront,
    register_camera,
    set_exposure,
)
from odak.instruments.phase_response import nearest_levels
from odak.instruments.spots import spots_phase

# %%
# The table with its hidden errors, and what a data sheet says of it.
hidden = SimulatedTable(seed=7)
modulator, camera = hidden.modulator, hidden.camera
table = OpticalTable(modulator, camera, hidden.laser.wavelength, distance=20e-3)
nominal = Calibration.nominal(modulator, camera, table.wavelength, table.distance)

# %%

# %%
# The response of the phases first, then registration and wavefront in turn, each better by the other.
table = replace(table, phases=measure_phase_response(table, samples=17))
for _ in range(3):
    table = replace(table, registration=register_camera(table))
    table = replace(table, wavefront=measure_wavefront(table, captures=3))
found = register_camera(table)

# %%

# %%
# A letter of spots, shown before and after.
letter = ["####", "#...", "###.", "#...", "#..."]
rows, columns = np.nonzero([[cell == "#" for cell in row] for row in letter])
points = np.stack([columns - 1.5, rows - 2.0], axis=-1) * 0.12e-3
phase = spots_phase(modulator, table.wavelength, table.distance, points)

# %%
# Captures with an exposure of their own.
def photograph(levels):
    """Return a capture of levels."""
    set_exposure(camera, lambda: modulator.show(levels))
    return camera.capture(4).mean(0)


before = photograph(nominal.levels(phase))
after = photograph(nearest_levels(phase - table.wavefront, table.phases))

# %%
# Each spot is looked for where it is assumed, and where it was registered.
def seen(frame, place, reach=5):
    """Return the centroid of the spot next to a pixel."""
    column, row = np.rint(place).astype(int)
    part = frame[row - reach : row + reach + 1, column - reach : column + reach + 1]
    part = np.clip(part - 0.2 * part.max(), 0, None)
    offsets = np.arange(-reach, reach + 1)
    u, v = (part.sum(0) @ offsets, part.sum(1) @ offsets) / part.sum()
    return column + u, row + v


registered, assumed = (r.camera_pixels(points) for r in (found, nominal.registration))
spots = np.array([seen(after, place) for place in registered])
off = [
    np.sqrt(((spots - places) ** 2).sum(-1).mean()) for places in (assumed, registered)
]
print(f"spots off the assumed positions: {off[0]:.1f} pixels")
print(f"off the registered ones by less than 0.2 pixels: {off[1] < 0.2}")

# %%

# %%
# Both captures in the plane of the image.
side = np.linspace(-0.45e-3, 0.45e-3, 361)
plane = np.stack(np.meshgrid(side, side), axis=-1)


def unwarped(frame, registration):
    """Return a frame on the points of the image plane."""
    pixels = registration.camera_pixels(plane)
    return map_coordinates(frame, [pixels[..., 1], pixels[..., 0]], order=1)


figure, axes = plt.subplots(1, 3, figsize=(11.5, 4))
axes[0].imshow(after, cmap="gray", vmax=after.max() / 2)
axes[0].plot(*assumed.T, "x", ms=7, label="assumed")
axes[0].plot(*registered.T, "o", mfc="none", ms=9, label="registered")
axes[0].set(title="camera", xlabel="column (pixels)", ylabel="row (pixels)")
axes[0].legend(labelcolor="white", loc="lower right")
for axis, title, frame, registration in (
    (axes[1], f"before: {off[0]:.1f} pixels off", before, nominal.registration),
    (axes[2], f"after: {off[1]:.2f} pixels off", after, found),
):
    image = unwarped(frame, registration)
    box = (-0.45, 0.45, 0.45, -0.45)
    axis.imshow(image, cmap="magma", vmax=image.max() / 2, extent=box)
    axis.plot(*points.T * 1e3, "o", mfc="none", mec="w", ms=9, mew=0.6)
    axis.set(title=title, xlabel="x in the image (mm)")
axes[1].set_ylabel("y in the image (mm)")
# Picture: A letter of spots as the camera sees it, with assumed and registered positions; in the image plane before and after the calibration, with circles where the spots should be
# Thumbnail: 0.85
plt.show()
