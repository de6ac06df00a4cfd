"""Polarisation behind a wave plate

A wave plate turns one state of polarisation into another: a half-wave plate turns linear light, a quarter-wave plate
makes it circular. On the Poincaré sphere each plate is a rotation about an axis in the equator, by its retardance;
whoever sees that needs no matrices to choose a plate.

[Polarisation](../../guides/polarisation.md) goes on from here.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.jones import apply_matrix, electricfield, retarder, stokes

# %%
# Eight retardances of a plate at 30°, each with the ellipse that the tip of the field describes.
light = electricfield(1, 0)
figure = plt.figure(figsize=(12, 4.6))
left, right = figure.subfigures(1, 2, width_ratios=(1.5, 1))
axes = left.subplots(2, 4).ravel()
time = np.linspace(0, 2 * np.pi, 200)
for axis, retardance in zip(axes, np.arange(0, 360, 45)):
    field = apply_matrix(retarder(retardance, 30), light)[:, 0]
    x, y = (np.real(part * np.exp(-1j * time)) for part in field)
    axis.plot(x, y)
    axis.set(
        title=f"{retardance}°",
        aspect="equal",
        xlim=(-1.1, 1.1),
        ylim=(-1.1, 1.1),
        xticks=[],
        yticks=[],
    )

# %%
# The Stokes vectors of all retardances form a circle about the axis of the plate, which stands at 60° on the equator.
sphere = right.add_subplot(projection="3d")
u, v = np.mgrid[0 : 2 * np.pi : 37j, 0 : np.pi : 19j]
sphere.plot_wireframe(
    np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v), color="0.85", lw=0.5
)
path = np.stack(
    [
        stokes(apply_matrix(retarder(angle, 30), light))[:, 0]
        for angle in np.linspace(0, 360, 181)
    ]
)
sphere.plot(*path[:, 1:].T, color="tab:red", lw=2)
axis_of_plate = 1.2 * np.array([np.cos(np.radians(60)), np.sin(np.radians(60)), 0])
sphere.plot(*np.stack((-axis_of_plate, axis_of_plate)).T, "k--", lw=1)
ticks = {f"{name}ticks": (-1, 0, 1) for name in "xyz"}
sphere.set(xlabel="S₁", ylabel="S₂", zlabel="S₃", box_aspect=(1, 1, 1), **ticks)
sphere.set_box_aspect((1, 1, 1), zoom=0.9)
# Thumbnail: 0.8 0.4
# Picture: Polarisation ellipses for eight retardances, and their path on the Poincaré sphere
# Change: `light = electricfield(1, 0)` to `light = electricfield(0.5**0.5, 0.5**0.5)`: Light at 45° is only 15° from the axis of the plate, and the circle on the sphere is small: the polarisation changes little.
plt.show()
