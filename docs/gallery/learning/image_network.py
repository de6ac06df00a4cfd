"""A picture in the weights of a network

A network from coordinates to colours holds a picture, a scene or a wavefront in its weights, with a value everywhere
and derivatives of all orders. With rectifiers it stays blurred, as they are slow to learn high frequencies; sines
(SIREN) learn them.

[Learned models](../../guides/learned_models.md) goes on from here.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.models import multi_layer_perceptron
from odak.learn.tools import load_image, psnr

# %%
# A picture as points and colours.
scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)
scene = scene[:3, :, 420:1500].float()
target = torch.nn.functional.interpolate(scene[None], (96, 96), mode="area")[0]
axis_points = torch.linspace(-1, 1, 96)
points = torch.stack(
    torch.meshgrid(axis_points, axis_points, indexing="ij"), -1
).reshape(-1, 2)
colours = target.permute(1, 2, 0).reshape(-1, 3)

# %%
# The same training for both activations.
results, curves = {}, {}
for name, options in (
    ("ReLU", {}),
    ("SIREN", {"model_type": "SIREN", "siren_multiplier": 30.0, "uniform_flag": True}),
):
    torch.manual_seed(0)
    network = multi_layer_perceptron([2, 128, 128, 128, 3], bias=True, **options)
    optimizer = torch.optim.Adam(
        network.parameters(), lr=1e-3 if name == "ReLU" else 2e-4
    )
    curves[name] = []
    for _ in range(200):
        loss = (network(points) - colours).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        curves[name].append(float(loss.detach()))
    results[name] = network(points).detach().reshape(96, 96, 3).clamp(0, 1)

# %%
# After 200 steps.
figure, axes = plt.subplots(1, 4, figsize=(13, 3.3))
axes[0].imshow(target.permute(1, 2, 0))
axes[0].set_title("target")
for axis, (name, image) in zip(axes[1:3], results.items()):
    axis.imshow(image)
    axis.set_title(f"{name}, {psnr(image, target.permute(1, 2, 0)):.1f} dB")
for axis in axes[:3]:
    axis.axis("off")
for name, curve in curves.items():
    axes[3].semilogy(curve, label=name)
axes[3].set(xlabel="step", ylabel="mean squared error")
axes[3].legend()
# Thumbnail: 0.63
# Picture: A scene, and what networks with rectifiers and with sines make of it after the same training
# Change: `"siren_multiplier": 30.0` to `"siren_multiplier": 5.0`: The multiplier sets the highest frequency that sines begin with: at 5 they are as blurred as rectifiers.
plt.show()
