"""Camera in the loop

No model of a display is right: lenses are aberrated, panels bent, lasers uneven. With a camera in the loop, the error
of the captured image drives the optimisation, and only the derivatives come from the model; what the model does not
know is then compensated all the same. It was the step that made holographic displays look good.

[Real displays](../../guides/real_displays.md) also learns the model itself from captures.
"""

from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.tools import load_image, psnr
from odak.learn.wave import (
    Descent,
    Display,
    Modulator,
    Run,
    light_of,
    optimise,
    simulated_camera,
    zernike_phase,
)

# %%
# A simulated camera behind a display with astigmatism and coma, which the model knows nothing about.
pitch, wavelength, distance = 8e-6, 532e-9, 0.01
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = light_of(photo[:3, 60:340, 60:480], wavelength).targets[0]
aberration = zernike_phase(*photo.shape, {(2, 2): 0.8, (3, 1): 0.6}, dx=pitch)
camera = simulated_camera(
    wavelength, distance, pitch, aberration=aberration, exposure=0.25, seed=0
)

# %%
# The same descent, once by the model alone and once with the camera.
display = Display(Modulator(photo.shape, pitch), wavelength, distance)
run = Run(100, progress=False)
blind, looped = (
    optimise(
        display, photo, solver=Descent("adam", camera=given), start="flat", run=run
    )
    for given in (None, camera)
)

# %%
# Captures of both patterns.
figure, axes = plt.subplots(1, 3, figsize=(13, 3.2))
extent = [0, 3.36, 2.24, 0]
drawn = axes[0].imshow(aberration, cmap="RdBu", extent=extent)
axes[0].set(title="aberration of the display", xlabel="x (mm)", ylabel="y (mm)")
figure.colorbar(drawn, ax=axes[0], label="rad", shrink=0.8)
for axis, hologram, name in zip(
    axes[1:], (blind, looped), ("model alone", "camera in the loop")
):
    image = camera(hologram.phases[0])
    image = image * (image * photo).sum() / (image**2).sum()
    drawn = axis.imshow(image, cmap="gray", vmin=0, vmax=1, extent=extent)
    axis.set(title=f"{name}: {psnr(image, photo):.0f} dB", xlabel="x (mm)")
figure.colorbar(drawn, ax=axes[2], label="captured intensity, scaled", shrink=0.8)
# Thumbnail: 0.14
# Picture: An aberration, the image captured without and with the camera in the loop
# Change: `{(2, 2): 0.8, (3, 1): 0.6}` to `{(2, 2): 1.6, (3, 1): 1.2}`: Twice the aberration takes more steps to compensate: after 100 the camera in the loop is at 19 dB, the model alone at 16 dB.
plt.show()
