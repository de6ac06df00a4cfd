"""Two holograms that look equal at a gaze

A hologram may differ from another in every pixel and look the same. The model is a whole chain: a phase-only display,
the light that it sends to a plane 10 mm away, and the statistics that an eye pools there for a gaze at the red cross. A
second hologram, begun from another picture, is changed until the chain responds to it as to the first one. The map is
the metameric distance of the two for every other gaze, which tells them apart.

[Metamers](../../guides/metamers.md) explains the statistics, [Displays](../../guides/displays.md) the display.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import MetamericLoss, MetamerMSELoss, metamer
from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, optimise

# %%
# The picture, the display and the loss, whose statistics are the model of the eye.
shape, gaze, elsewhere = (256, 384), (0.48, 0.55), (0.08, 0.7)
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = photo.float()[:3, :384, :576].mean(0)[None, None]
photo = torch.nn.functional.interpolate(photo, shape, mode="area")
panel = Display(Modulator(shape, 8e-6), 532e-9, distances=10e-3)
eye = {"alpha": 0.3, "real_image_width": 0.6, "real_viewing_distance": 0.6}
loss = MetamericLoss(n_orientations=4, use_l2_foveal_loss=False, **eye)

# %%
# Two holograms: one of the photograph, one of a metamer of it, where the search begins.
scrambled = MetamerMSELoss(n_orientations=4, **eye).gen_metamer(photo, gaze)
run = Run(iterations=80, progress=False)
one, start = (
    optimise(panel, picture[0, 0].clamp(0, 1) ** 2.2, start="flat", run=run).phases
    for picture in (photo, scrambled)
)
light = panel(one)
brightness = (light * photo**2.2).sum() / (light**2).sum()

# %%
# The chain from phases to pooled statistics.
def seen(phases):
    return (brightness * panel(phases)).clamp_min(1e-4) ** (1 / 2.2)


def chain(phases):
    return loss.calc_statsmaps(seen(phases), gaze, **eye)

# %%
# The search, and how far the two are apart: for the model, and as pictures.
other = metamer(chain, one, start, iterations=80, bounds=None)
first, second = seen(one), seen(other)
turned = torch.angle(torch.exp(1j * (other - one)))
error = (second - first).square().mean().sqrt()
print(f"RMS difference of phases: {turned.square().mean().sqrt():.2f} rad")
print(f"RMS difference of the pictures: {100 * error:.1f} % of white")
noise = torch.randn(first.shape, generator=torch.Generator().manual_seed(0))
noisy = first + error * noise
for name, place in (("at this gaze", gaze), ("at another gaze", elsewhere)):
    distance, noise_gives = loss(second, first, place), loss(noisy, first, place)
    print(f"metameric distance {name}: ≈ {distance:.1e},", end=" ")
    print(f"of equal noise {noise_gives:.1e}")

# %%
# The distance for gazes all over the picture.
places = [[(x / 24, y / 16) for x in range(1, 24, 2)] for y in range(1, 16, 2)]
chart = [[float(loss(second, first, place)) for place in row] for row in places]
phases = {"cmap": "twilight", "vmin": 0, "vmax": 6.283, "extent": (0, 1, 1, 0)}
grey = {"cmap": "gray", "vmin": 0, "vmax": 1, "extent": (0, 1, 1, 0)}
figure, axes = plt.subplots(2, 3, figsize=(13, 6.2), layout="constrained")
for axis, image, title, options in (
    (axes[0, 0], one[0] % 6.283, "a hologram", phases),
    (axes[0, 1], other[0] % 6.283, "another one", phases),
    (axes[1, 0], first[0, 0], "what the first one shows", grey),
    (axes[1, 1], second[0, 0], "what the other one shows", grey),
    (axes[0, 2], (second - first)[0, 0].abs(), "difference", grey | {"vmax": 0.4}),
    (axes[1, 2], chart, "metameric distance by gaze", {"extent": (0, 1, 1, 0)}),
):
    drawn = axis.imshow(image, aspect=2 / 3, **options)
    axis.plot(*gaze, "r+", *elsewhere, "c+", ms=14, mew=2)
    axis.set(title=title, xticks=[], yticks=[])
    if axis in axes[:, 2]:
        figure.colorbar(drawn, ax=axis, shrink=0.9)
# Picture: Two holograms, what they show, the difference, and how well each gaze sees it
plt.show()
