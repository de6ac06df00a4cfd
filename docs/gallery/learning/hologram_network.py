"""A hologram by a network

Iterations take seconds, video has milliseconds. A network whose weights are included in odak computes a phase-only
hologram in a few propagations, for arbitrary wavelengths, pitches and distances. It is trained at points; what a camera
of real pixels sees is stated by its guide.

[Holograms by a network](../../guides/hologram_network.md) compares quality and time.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.models import hologram_network
from odak.learn.tools import load_image
from odak.learn.wave import propagate_beam

# %%
# A picture and the network; three displays that it has not been trained for one by one.
scene = load_image(files("odak") / "assets" / "scene.png").mean(-1)
target = torch.nn.functional.interpolate(
    scene[None, None, 60:1020, 480:1440], (240, 240), mode="area"
)[0, 0]
network = hologram_network(pretrained=True, refinements=16)
displays = ((532e-9, 8e-6, 5e-3), (638e-9, 3.74e-6, 2e-3), (450e-9, 6.4e-6, 10e-3))

# %%
# Quality at the points of the grid.
figure, axes = plt.subplots(1, 4, figsize=(14, 4.2))
axes[0].imshow(target, cmap="gray", vmin=0, vmax=1)
axes[0].set(title="target", xlabel="x (pixels)")
for axis, (wavelength, pitch, distance) in zip(axes[1:], displays):
    with torch.no_grad():
        phase = network(target, wavelength, pitch, distance)
    hologram = torch.polar(torch.ones_like(phase), phase)
    image = propagate_beam(hologram, None, distance, pitch, wavelength, "auto")
    image = image.abs() ** 2
    image = image * (image * target).sum() / (image * image).sum()
    quality = -10 * (image - target).square().mean().log10()
    axis.imshow(image, cmap="gray", vmin=0, vmax=1)
    axis.set(
        title=f"{wavelength * 1e9:.0f} nm, {pitch * 1e6:g} µm, {distance * 1e3:g} mm: "
        f"{quality:.0f} dB",
        xlabel="x (pixels)",
    )
# Thumbnail: 0.37
# Picture: The target and the images of three holograms, for three wavelengths, pitches and distances
# Change: `refinements=16` to `refinements=4`: Four refinements instead of sixteen take a quarter of the time and are some decibels worse.
plt.show()
