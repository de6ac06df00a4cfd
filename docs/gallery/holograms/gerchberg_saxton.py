"""Gerchberg–Saxton and gradient descent

Two methods compute a phase-only hologram of the same chart: alternating projections, which impose the amplitude in both
planes in turn, and gradient descent on the error of the image.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image, psnr
from odak.learn.wave import (
    calculate_intensity,
    gerchberg_saxton,
    stochastic_gradient_descent,
)

pitch, wavelength, distance, method = 8e-6, 532e-9, 0.05, "Bandlimited Angular Spectrum"
chart = load_image(files("odak") / "assets" / "chart.png").float()
target = torch.nn.functional.interpolate(chart[None, None], (270, 480), mode="area")[
    0, 0
]


def scaled(field):
    intensity = calculate_intensity(field)
    return intensity * (intensity * target).sum() / (intensity**2).sum()


_, projected = gerchberg_saxton(
    target.sqrt().to(torch.complex64),
    100,
    distance,
    pitch,
    wavelength,
    2 * torch.pi,
    method,
    seed=0,
)
_, descended = stochastic_gradient_descent(
    target,
    wavelength,
    distance,
    pitch,
    n_iteration=100,
    learning_rate=0.2,
    scale=True,
    progress=False,
    initial_phase=torch.zeros_like(target),
)

# %%
figure, axes = plt.subplots(1, 3, figsize=(14, 3))
images = {
    "target": target,
    "Gerchberg–Saxton": scaled(projected),
    "gradient descent": scaled(descended),
}
for axis, (name, image) in zip(axes, images.items()):
    drawn = axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=[0, 3.84, 2.16, 0])
    quality = "" if name == "target" else f", PSNR {psnr(image, target):.1f} dB"
    axis.set(title=name + quality, xlabel="x (mm)")
axes[0].set_ylabel("y (mm)")
figure.colorbar(drawn, ax=axes, label="intensity", shrink=0.8)
# Thumbnail: 0.8
# Picture: A chart and its reconstructions by the method of Gerchberg and Saxton and by gradient descent
plt.show()
