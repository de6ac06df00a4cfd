"""Pupil expander of a display

Glasses for augmented reality must send one small picture into an eye that moves. A grating couples light into a plate,
total reflection guides it, and a second grating lets a part of it out at each hop. Each direction of the picture leaves
in the direction in which it came, many times, so that the eye may move.

[Stray light](../../guides/stray_light.md) explains scenes and what they lose.
"""

import matplotlib.pyplot as plt
import torch
from matplotlib.collections import LineCollection

from odak.learn.raytracing import Element, Interface, Plane, RayScene, light_source
from odak.raytracing.apertures import RectangularAperture
from odak.raytracing.interfaces import LinearGrating

# %%
# Gratings of 400 nm period on the front face; a rear face without one; an absorber at the end.
index, thickness, wavelength = 1.8, 1.5, 532e-6
lines = LinearGrating(0.0, 1 / 400e-6)


def strip(center, half_height):
    return RectangularAperture(
        center=(0.0, center), half_width=9.0, half_height=half_height
    )


def face(name, interface, center, half_height):
    place = strip(center, half_height)
    return Element(Plane(), (1.0, index), interface, aperture=place, name=name)


plate = [
    face("in", Interface({}, {1: 1.0}, phase=lines), 0.0, 1.3),
    face("out", Interface({0: 0.85}, {-1: 0.15}, phase=lines), 15.0, 10.0),
    face("between", None, 3.15, 1.85),
    Element(Plane(), (index, 1.0), center=(0, 0, thickness), name="rear"),
    Element(
        Plane(),
        interface=Interface(0, 0),
        center=(0, 25.0, thickness / 2),
        angles=(-90, 0, 0),
        aperture=strip(0.0, thickness),
        name="end",
    ),
    Element(Plane(), interface=Interface(0, 0), center=(0, 0, -14), name="eye"),
]

# %%
# Beams in three directions are split at each hop. What reaches the eye's plane is stated.
figure, axis = plt.subplots(figsize=(10, 5))
for angle, colour in ((-4.0, "tab:blue"), (0.0, "tab:green"), (4.0, "tab:red")):
    light = light_source(
        "collimated", 12, (0.01, 1.0), center=(0, 0, -4), angles=(angle, 0, 0)
    )
    found = RayScene(plate).trace(
        light, wavelength, split=True, threshold=0.02, paths=True
    )
    pieces = LineCollection(found.segments[..., [1, 2]].numpy(), color=colour)
    pieces.set_alpha((found.segment_power * 12).sqrt().clamp(max=1).tolist())
    pieces.set_linewidth(0.7)
    axis.add_collection(pieces)
    share = 100 * float(found.absorbed[-1])
    print(f"{angle:+.0f}°: {share:.0f} % reach the eye's plane")
axis.fill_between([-1.5, 25], 0, thickness, color="tab:blue", alpha=0.12)
axis.plot([-1.3, 1.3], [0, 0], "k", lw=3)
axis.plot([5, 25], [0, 0], "k", lw=3)
axis.set(
    xlabel="y (mm)", ylabel="z (mm)", aspect="equal", xlim=(-3, 27), ylim=(-14.5, 3)
)
# Picture: Three beams that enter a plate through a grating and leave a second grating as many parallel beams
# Change: `Interface({0: 0.85}, {-1: 0.15}, phase=lines)` to `Interface({0: 0.5}, {-1: 0.5}, phase=lines)`: If half of the light leaves at each hop, more of it comes out, but nearly all of it on the left: the eye may no longer move.
plt.show()
