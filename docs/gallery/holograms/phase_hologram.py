"""Phase-only hologram of a photograph

Gradient descent finds the phase pattern of a spatial light modulator with pixels of 8 µm whose diffraction pattern,
5 cm away, is a given photograph. The right panel is the intensity there, at the middles of pixels; a camera collects
light from areas, between these points too.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image, psnr
from odak.learn.wave import (
    calculate_intensity,
    calculate_phase,
    stochastic_gradient_descent,
)

pitch = 8e-6
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
target = photo[1]
hologram, field = stochastic_gradient_descent(
    target,
    wavelength=532e-9,
    distance=0.05,
    pixel_pitch=pitch,
    n_iteration=150,
    learning_rate=0.2,
    initial_phase=torch.zeros_like(target),
    scale=True,
    progress=False,
)
phase = calculate_phase(hologram) % (2 * torch.pi)
intensity = calculate_intensity(field)
intensity = intensity * (intensity * target).sum() / (intensity**2).sum()
print(f"PSNR {psnr(intensity, target):.1f} dB")

# %%
rows, columns = target.shape
extent = [0, columns * pitch * 1e3, rows * pitch * 1e3, 0]
figure, axes = plt.subplots(1, 3, figsize=(12, 3.3))
for axis, picture, title, options in (
    (axes[0], target, "target", {"cmap": "gray", "vmin": 0, "vmax": 1}),
    (axes[1], phase, "hologram", {"cmap": "twilight", "vmin": 0, "vmax": 6.283}),
    (axes[2], intensity, "5 cm behind it", {"cmap": "gray", "vmin": 0, "vmax": 1}),
):
    drawn = axis.imshow(picture, extent=extent, **options)
    axis.set(title=title, xlabel="x (mm)")
    label = "phase (rad)" if title == "hologram" else "intensity"
    figure.colorbar(drawn, ax=axis, label=label, shrink=0.75)
axes[0].set_ylabel("y (mm)")
# Thumbnail: 0.44
# Picture: A photograph, the phase of its hologram, and the intensity 5 cm behind the hologram
plt.show()
