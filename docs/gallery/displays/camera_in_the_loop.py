"""Camera in the loop

The display has an aberration that the model does not include. With a camera in the loop, the error of the captured
image drives the optimisation, which then compensates for the aberration.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image, psnr
from odak.learn.wave import (
    calculate_phase,
    simulated_camera,
    stochastic_gradient_descent,
    zernike_phase,
)

pitch, wavelength, distance = 8e-6, 532e-9, 0.01
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[
    1, 60:340, 60:480
]
aberration = zernike_phase(*photo.shape, {(2, 2): 0.8, (3, 1): 0.6}, dx=pitch)
camera = simulated_camera(
    wavelength, distance, pitch, aberration=aberration, exposure=0.25, seed=0
)
options = {
    "n_iteration": 100,
    "learning_rate": 0.1,
    "progress": False,
    "scale": True,
    "initial_phase": torch.zeros_like(photo),
}
blind, _ = stochastic_gradient_descent(photo, wavelength, distance, pitch, **options)
looped, _ = stochastic_gradient_descent(
    photo, wavelength, distance, pitch, camera=camera, **options
)

# %%
figure, axes = plt.subplots(1, 3, figsize=(13, 3.2))
extent = [0, 3.36, 2.24, 0]
drawn = axes[0].imshow(aberration, cmap="RdBu", extent=extent)
axes[0].set(title="aberration of the display", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(drawn, ax=axes[0], label="rad", shrink=0.8)
for axis, hologram, name in zip(
    axes[1:], (blind, looped), ("model alone", "camera in the loop")
):
    image = camera(calculate_phase(hologram))
    image = image * (image * photo).sum() / (image**2).sum()
    drawn = axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=extent)
    axis.set(title=f"{name}: {psnr(image, photo):.1f} dB", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[2], label="captured intensity, scaled", shrink=0.8)
# Thumbnail: 0.14
# Picture: An aberration, the image captured without and with the camera in the loop
plt.show()
