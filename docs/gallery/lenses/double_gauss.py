"""Analysis of a double Gauss

Ray fans, field curvature and distortion of the sample system `double_gauss`.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    distortion,
    draw_layout,
    field_curvature,
    load_system,
    ray_fan,
)

lens = load_system("double_gauss")
pupil, aberration = ray_fan(lens, "y", 41)
figure = plt.figure(figsize=(12, 7))
top, bottom = figure.subfigures(2, 1, height_ratios=(1.2, 1))
axis = top.subplots()
axis.imshow(draw_layout(lens, count=7))
axis.axis("off")
axes = bottom.subplots(1, len(lens.fields))
for index, (axis, field) in enumerate(zip(axes, lens.fields)):
    for wavelength, fan in zip(lens.wavelengths, aberration[:, index].detach()):
        axis.plot(pupil, 1e3 * fan, label=f"{1e6 * float(wavelength):.0f} nm")
    axis.set(title=f"field {field[1]:g}°", xlabel="pupil", ylabel="ray aberration (µm)")
axes[0].legend()
tangential, sagittal = field_curvature(lens)
middle = len(lens.wavelengths) // 2
print("tangential focus (mm):", [round(v, 3) for v in tangential[middle].tolist()])
print("sagittal focus (mm):", [round(v, 3) for v in sagittal[middle].tolist()])
print("distortion:", [f"{v:.2%}" for v in distortion(lens)[middle].tolist()])
# Picture: Section through a double Gauss, and its ray fans for three fields and three wavelengths
# Thumbnail: 0.18 0.03 0.6 0.5
plt.show()
