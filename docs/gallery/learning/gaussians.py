"""An image as a sum of Gaussians

Splats made three-dimensional scenes fast; in two dimensions a few hundred Gaussians describe a picture with derivatives
for everything. They start where the image has edges. Damped least squares changes all of their places, sizes, rotations
and heights at once; every fourth step the weakest of them move to where the error is largest.

[Learned models](../../guides/learned_models.md) has Gaussians in space.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.models import gaussians_2d
from odak.learn.tools import load_image, psnr

# %%
# A picture of 64 × 64 pixels and the points where the sum is evaluated.
photo = (
    load_image(files("odak") / "assets" / "scene.png", torch_style=True)[:3]
    .mean(0)
    .float()
)
photo = photo[:, 420:1500]
target = torch.nn.functional.interpolate(photo[None, None], (64, 64), mode="area")[0, 0]
y, x = torch.meshgrid(
    torch.linspace(-1, 1, 64), torch.linspace(-1, 1, 64), indexing="ij"
)

# %%
# Five hundred Gaussians, refined in steps of four.
model = gaussians_2d(500)
model.initialize_from_image(target, seed=0)
errors, stages = [], {}
for step in range(0, 41, 4):
    image = model(x, y, test=True)[..., 0]
    errors.append(float((image - target).square().mean()))
    if step in (0, 8, 40):
        stages[step] = image
    model.refine(target, steps=4)

# %%
# The picture at three stages, and the error.
figure, axes = plt.subplots(1, 5, figsize=(14, 2.9))
axes[0].imshow(target, cmap="gray", vmin=0, vmax=1)
axes[0].set_title("target")
for axis, (step, image) in zip(axes[1:4], stages.items()):
    axis.imshow(image, cmap="gray", vmin=0, vmax=1)
    axis.set_title(f"step {step}, {psnr(image, target):.1f} dB")
for axis in axes[:4]:
    axis.axis("off")
axes[4].semilogy(range(0, 41, 4), errors)
axes[4].set(xlabel="step", ylabel="mean squared error")
# Thumbnail: 0.68
# Picture: A scene, and the sum of five hundred Gaussians at its start and at two steps of the fit
# Change: `gaussians_2d(500)` to `gaussians_2d(100)`: A hundred Gaussians draw the large shapes only, and the error stops at a higher value.
plt.show()
