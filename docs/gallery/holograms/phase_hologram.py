"""Phase-only hologram of a photograph

The first thing that one does with a phase modulator: find the pattern whose diffraction, 5 cm away, is a picture. The
target is the light of the stored photograph, not its stored values, and the quality is what a camera sees at any place,
from a computation of its own.

[Compute a hologram](../../guides/compute_a_hologram.md) and [Displays](../../guides/displays.md) go on from here.
"""

from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.wave import Display, Modulator, Run, light_of, optimise, picture_of

# %%
# A panel of 400 × 600 square pixels of 8 µm and its light, with 60 iterations of descent.
pitch = 8e-6
display = Display(Modulator((400, 600), pitch), 532e-9, 0.05)
light = light_of(files("odak") / "assets" / "photo.png", display)
hologram = optimise(display, light.targets, run=Run(60, progress=False))
print(f"PSNR ≈ {hologram.psnr.item():.0f} dB")

# %%
# The image is encoded for a screen, as the photograph is.
extent = [0, 600 * pitch * 1e3, 400 * pitch * 1e3, 0]
figure, axes = plt.subplots(1, 3, figsize=(12, 3.3))
for axis, picture, title, options in (
    (axes[0], picture_of(light.targets, display)[0], "target", {"cmap": "gray"}),
    (axes[1], hologram.phases[0], "hologram", {"cmap": "twilight", "vmax": 6.283}),
    (axes[2], hologram.pictures(0)[0], "5 cm behind it", {"cmap": "gray"}),
):
    drawn = axis.imshow(picture, extent=extent, **{"vmin": 0, "vmax": 1} | options)
    axis.set(title=title, xlabel="x (mm)")
    label = "phase (rad)" if title == "hologram" else "value on a screen"
    figure.colorbar(drawn, ax=axis, label=label, shrink=0.75)
axes[0].set_ylabel("y (mm)")
# Thumbnail: 0.44
# Picture: A photograph, the phase of its hologram, and the image 5 cm behind the hologram
# Change: `532e-9, 0.05)` to `532e-9, 0.005)`: At 5 mm a pixel can send its light to near places only, and the quality falls to 26 dB.
plt.show()
