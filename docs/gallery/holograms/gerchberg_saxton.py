"""Gerchberg–Saxton and gradient descent

Two methods compute a phase-only hologram of the same chart: alternating projections, which impose the amplitude in both
planes in turn, and gradient descent on the error of what a camera sees.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, optimise

chart = load_image(files("odak") / "assets" / "chart.png").float()
target = torch.nn.functional.interpolate(chart[None, None], (270, 480), mode="area")[
    0, 0
]
display = Display(Modulator((270, 480), 8e-6), 532e-9, 0.05)
found = {
    name: optimise(display, target, solver=solver, run=Run(60, progress=False))
    for name, solver in (("Gerchberg–Saxton", "gs"), ("gradient descent", "lbfgs"))
}

# %%
figure, axes = plt.subplots(1, 3, figsize=(14, 3))
images = {"target": target} | {
    f"{name}: {hologram.psnr.item():.0f} dB": hologram.images[0, 0]
    for name, hologram in found.items()
}
for axis, (name, image) in zip(axes, images.items()):
    drawn = axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=[0, 3.84, 2.16, 0])
    axis.set(title=name, xlabel="x (mm)")
axes[0].set_ylabel("y (mm)")
figure.colorbar(drawn, ax=axes, label="intensity", shrink=0.8)
# Thumbnail: 0.8
# Picture: A chart and its images by the method of Gerchberg and Saxton and by gradient descent
plt.show()
