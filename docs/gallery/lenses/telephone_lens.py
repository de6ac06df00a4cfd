"""A telephone lens from −20 to 60 °C

Plastics expand ten times as much as glass, and their index falls by one ten-thousandth
for each kelvin, so the focus of a moulded lens follows the weather. This telephone lens
is that of US patent 7,535,658 as the documentation of Ray Optics states it ("Cell Phone
Camera Lens"): four odd aspheric elements, f = 5.555 mm at f/3.5.

[Design a lens](../../guides/design_a_lens.md#temperature-and-pressure) explains temperatures and mounts.
"""

import matplotlib.pyplot as plt
import torch

from odak.catalog import model_glass, refractive_index
from odak.learn.raytracing.system import (
    draw_layout,
    first_order,
    in_environment,
    modulation_transfer_function,
    optical_system,
    point_spread_function,
    surface,
    through_focus,
)
from odak.raytracing import OddAsphere

# %%
# The patent's table names indices and Abbe numbers only. Each element keeps them, and
# takes dn/dT and expansion of a near material of the catalogue: N-PK52A (1.497, 81.6)
# for the first, which no plastic is near, OKP4 (1.607, 27.0) and Zeonex 480R (1.525,
# 56.0) for the others.
first = model_glass(1.471, 76.6, like="N-PK52A")
second = model_glass(1.603, 27.5, like="OKP4")
third = model_glass(1.510, 56.2, like="Zeonex 480R")
# Radius, conic constant + 1, coefficients of r³ to r¹⁰.
rows = """\
1.962 2.153 -1.895e-2 2.426e-2 -5.123e-2 8.371e-4 7.850e-3 4.091e-3 -7.732e-3 -4.265e-3
33.398 40.18 -4.966e-3 -.01434 -6.139e-3 -9.284e-5 6.438e-3 -5.72e-3 -2.385e-2 1.108e-2
-2.182 2.105 -4.388e-2 -2.555e-2 5.16e-2 -4.307e-2 -2.831e-2 3.162e-2 4.63e-2 -4.877e-2
-6.367 3.382 -1.131e-1 -7.863e-2 1.094e-1 6.228e-3 -2.216e-2 -5.89e-3 4.123e-3 1.041e-3
5.694 -221.1 -7.876e-2 7.02e-2 1.575e-3 -9.958e-3 -7.322e-3 6.914e-4 2.54e-3 -7.65e-4
9.192 0.9331 9.694e-3 -.002516 -3.606e-3 -2.497e-4 -6.84e-4 -1.414e-4 2.932e-4 -7.284e-5
1.674 -7.617 7.429e-2 -6.933e-2 -5.811e-3 2.396e-3 2.1e-3 -3.119e-4 -5.552e-5 7.969e-6
1.509 -2.707 1.767e-3 -4.652e-2 1.625e-2 -3.522e-3 -7.106e-4 3.825e-4 6.271e-5 -2.631e-5
""".splitlines()
gaps = [1.19, 0.93, 0.75, 0.1, 0.89, 0.16, 0.85, 0.7]
media = [first, "air", second, "air", third, "air", third, "air"]
items = [surface(stop=True)]
for row, gap, medium in zip(rows, gaps, media):
    radius, bend, *powers = (float(number) for number in row.split())
    shape = OddAsphere(1 / radius, bend - 1, [0.0, 0.0, *powers])
    items.append(surface(shape=shape, thickness=gap, material=medium))
cover = model_glass(1.516, 64.1, like="N-BK7")
items += [surface(thickness=0.4, material=cover), surface(thickness=0.64)]
lens = optical_system(
    items,
    5.555 / 3.5,
    fields=[0.0, 12.0, 24.0],
    wavelengths=["486.1nm", "587.6nm", "656.3nm"],
)
found = first_order(lens)
print(f"f = {float(found.focal_length):.3f} mm, published 5.555 mm")
print(f"image at {float(found.image_distance):.4f} mm, published 0.5678 mm")

# %%
# The sensor is glued where the axis is sharpest at 20 °C, in a barrel of polycarbonate.
# The spots in planes about it find the best focus at other temperatures.
barrel = 7e-5  # per kelvin
planes = torch.linspace(-0.1, 0.06, 161, dtype=torch.float64)


def focus(system):
    return planes[through_focus(system, planes, fields=[0.0])[0].argmin()].item()


lens.surfaces[-1].thickness.add_(focus(lens))
temperatures = [-20.0, 0.0, 20.0, 40.0, 60.0]
warm = [in_environment(lens, t, mount=barrel) for t in temperatures]


def paraxial(system):
    return float(first_order(system).image_distance - system.surfaces[-1].thickness)


moved = [1e3 * (paraxial(system) - paraxial(lens)) for system in warm]
sharpest = [1e3 * focus(system) for system in warm]

# %%
# Beside it the sum of first order. Where a ray from the axis, of height 1 at the stop,
# has the height y and slope u, a power φ moves the focus by −f²y²φγ per kelvin, with
# γ = (dn/dT)/(n − 1) − α, and a length t of index n by −f²nu²t(α − (dn/dT)/n). Here the
# elements nearly cancel; what is left comes from lengths.
p = lens.prescription(lens.wavelengths[1:2])
length = float(found.focal_length)
media = [*media, cover, "air"]
y, slope, powers, lengths = 1.0, 0.0, [], []
for i, medium in enumerate(media, 1):
    before, behind = p.index[0, i].item(), p.index[0, i + 1].item()
    power = (behind - before) * p.curvature[i].item()
    glass = media[i - 2] if medium == "air" else medium
    n, hot = (
        float(refractive_index(glass, 587.6e-9, medium="air", temperature=t))
        for t in (20.0, 21.0)
    )
    gamma = (hot - n) / (n - 1) - glass.expansion
    powers.append(-((length * y) ** 2) * power * gamma)
    slope -= y * power
    grows = barrel if medium == "air" else medium.expansion - (hot - n) / n
    away = grows * p.thickness[i].item() / behind
    lengths.append(-((length * slope) ** 2) * away)
    y += slope / behind * p.thickness[i].item()
elements = [1e3 * (a + b) for a, b in zip(powers[:8:2], powers[1:8:2])]
print("elements:", ", ".join(f"{rate:+.2f}" for rate in elements), "µm/K")
print(f"lengths: {1e3 * sum(lengths):+.2f} µm/K")
print(f"sum: {sum(elements) + 1e3 * sum(lengths):+.3f} µm/K")
print(f"of the lens: {(moved[-1] - moved[0]) / 80:+.3f} µm/K")

# %%
# The section, the focus, and the contrast on the axis, with the sensor where it is and
# moved to the best focus.
figure = plt.figure(figsize=(9, 7), layout="constrained")
top, bottom = figure.subfigures(2, 1, height_ratios=(1, 1.1))
axis = top.subplots()
axis.imshow(draw_layout(lens, count=7))
axis.axis("off")
left, right = bottom.subplots(1, 2)
left.plot(temperatures, moved, "o-", label="paraxial focus")
left.plot(temperatures, sharpest, "s--", label="smallest spot")
depth = 2 * 0.5876 * 3.5**2
left.axhspan(-depth, depth, alpha=0.15, label="quarter of a wave")
left.set(xlabel="temperature (°C)", ylabel="focus behind the sensor (µm)")
left.legend(fontsize=8)
colours = ["C0", "", "k", "", "C3"]
for t, system, shift, colour in zip(temperatures, warm, sharpest, colours):
    if not colour:
        continue
    for away, style in ((0.0, "-"), (1e-3 * shift, ":")):
        system.surfaces[-1].thickness.add_(away)
        spread = point_spread_function(system, fields=[0.0])
        frequency, contrast = modulation_transfer_function(spread)
        name = f"{t:.0f} °C" + (", refocused" if style == ":" else "")
        line = frequency[1].flatten(), contrast[1].flatten()
        right.plot(*line, style, color=colour, label=name)
right.set(xlabel="cycles per mm", ylabel="modulation", xlim=(0, 250), ylim=(0, 1))
right.legend(fontsize=8)
# Picture: A telephone lens, its focus over temperature, and its contrast cold and hot
# Thumbnail: 0.1 0.0 0.8 0.45
# Change: `"N-PK52A"` to `"PMMA"`: The first element as acrylic doubles the shift.
plt.show()
