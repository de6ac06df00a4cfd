"""Gerchberg–Saxton and gradient descent

Two ideas compete since 1972. Alternating projections impose what is known in both planes in turn, quick to write and
quick at first; gradient descent reduces the error of what a camera sees and goes on improving. On the same chart,
display and number of iterations, both are judged alike.

[Compute a hologram](../../guides/compute_a_hologram.md) explains both.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, optimise

# %%
# A test chart of 270 × 480 pixels, 5 cm from the panel.
chart = load_image(files("odak") / "assets" / "chart.png").float()
target = torch.nn.functional.interpolate(chart[None, None], (270, 480), mode="area")[
    0, 0
]
display = Display(Modulator((270, 480), 8e-6), 532e-9, 0.05)

# %%
# The same call with two solvers.
found = {
    name: optimise(display, target, solver=solver, run=Run(60, progress=False))
    for name, solver in (("Gerchberg–Saxton", "gs"), ("gradient descent", "lbfgs"))
}

# %%
# The quality is that of a camera at any place.
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
# Change: `Run(60, progress=False)` to `Run(10, progress=False)`: After ten iterations the projections have reached what they will reach, while descent still gains.
plt.show()
