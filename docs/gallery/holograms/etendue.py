"""A wider eyebox by a mask on the panel

A panel sends light into the angles of one diffraction order of its pixels; field of view times eyebox, the étendue, is
fixed by their number. A mask of finer cells in contact with the panel widens the eyebox without a finer panel. The light
at more places then depends on as many pixels, and quality is the price. How high it is depends on the mask: here it is
learned with the patterns of four pictures, and judged by a fifth beside a random mask and the panel alone.

[Light fields](../../guides/light_fields.md) describes eyes and eyeboxes.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import (
    Display,
    Expander,
    Eyes,
    Modulator,
    Observer,
    Run,
    eyebox_map,
    light_of,
    optimise,
    picture_of,
)

# %%
# Four parts of a rendered scene to learn from, and a photograph to be judged by.
assets, size, green = files("odak") / "assets", (24, 36), 532e-9


def small(picture):
    """Return light on as many pixels as the panel has, from black to white."""
    part = torch.nn.functional.adaptive_avg_pool2d(picture, size)[0]
    return (part - part.min()) / (part.max() - part.min())


scene = light_of(assets / "scene.png", green).targets
quarters = [part for half in scene.chunk(2, 1) for part in half.chunk(2, 2)]
pictures = torch.stack([small(part) for part in quarters])
photo = small(light_of(assets / "photo.png", green).targets)

# %%
# The display: a pupil of 3 mm, 50 mm from the panel, where one order of a pixel is 3.3 mm wide. Without an iris, all
# orders of pixels and cells reach the eye. The observer in the image of each eye is a camera at any place, with pixels
# twice as wide as the panel's.
pitch, away, frames, pupil = 8e-6, 0.05, 4, 3e-3
observer = Observer.camera(magnification=1 / 2)
order = green * away / pitch


def display(phases, cells, count, seed):
    """Return a display with or without a mask, and pupils at random in its eyebox."""
    mask = None if phases is None else Expander(phases)
    panel = Modulator(size, pitch, None, fill=1.0, expander=mask)
    box = 0.8 * cells * order
    eyes = Eyes.within(away, box, count, (pupil, pupil), seed=seed)
    return Display(panel, green, eyes, frames, iris=None)


for cells in (1, 2, 4):
    phases = Expander.random(size, cells).phases
    (found,) = display(phases, cells, 1, 0).extents()
    height, width = (1e3 * side for side in found["eyebox"])
    down, across = found["field_of_view"]
    print(
        f"{cells * cells:2d} cells in a pixel: {down:.2f}° × {across:.2f}° at "
        f"{height:.1f} mm × {width:.1f} mm, {found['etendue']:.1e} m²·sr"
    )

# %%
# A mask is learned by descending along its phases and the patterns of all pictures at once. Other pupils are drawn in
# each step.


def learned(cells, steps=25, pupils=3):
    """Return the phases of a mask that suits the pictures."""
    draw = torch.Generator().manual_seed(0)
    mask = Expander.random(size, cells, 256).phases.requires_grad_()
    shape = (len(pictures), frames, *size)
    patterns = (6.28 * torch.rand(shape, generator=draw)).requires_grad_()
    descent = torch.optim.Adam([mask, patterns], 0.1)
    for step in range(steps):
        seen = display(mask, cells, pupils, step)(patterns)
        # Means over the pixels of the observer.
        seen = torch.nn.functional.avg_pool2d(seen.flatten(0, 2), 2)
        seen = seen.unflatten(0, (len(pictures), pupils))
        wanted = torch.nn.functional.avg_pool2d(pictures[:, None], 2)
        # Each picture is dimmed to its best brightness, one for all pupils.
        over = (seen * wanted).flatten(1).sum(1) / seen.square().flatten(1).sum(1)
        lit = seen * over.detach().reshape(-1, 1, 1, 1)
        descent.zero_grad()
        (lit - wanted).square().mean().backward()
        descent.step()
    return mask.detach()


# %%
# Patterns of the photograph for pupils all over each eyebox, judged at 25 others.
maps = {}
for cells, pupils in ((1, 4), (2, 8), (4, 16)):
    masks = {"no mask": None}
    if cells > 1:
        masks["random mask"] = Expander.random(size, cells).phases
        masks["learned mask"] = learned(cells)
    for name, mask in masks.items():
        hologram = optimise(
            display(mask, cells, pupils, 100),
            photo,
            run=Run(20, progress=False, seed=0),
            observer=observer,
        )
        box = 0.8 * cells * order
        maps[name, cells**2] = eyebox_map(hologram, photo[None], box, 5, pupil)

# %%
# Quality over the eyebox against the expansion, from the worst pupil to the best, and what the middle and a corner see.
figure, axes = plt.subplot_mosaic(
    [["curve", "photo", "a", "b", "c"], ["curve", "g", "d", "e", "f"]],
    figsize=(13, 3.6),
    layout="constrained",
    width_ratios=[1.6, 1, 1, 1, 1],
)
for shift, name in enumerate(("no mask", "random mask", "learned mask")):
    found = [(n, one.psnr) for (which, n), one in maps.items() if which == name]
    number = [n * (0.94 + 0.06 * shift) for n, _ in found]
    mean = [float(ratio.mean()) for _, ratio in found]
    low = [float(ratio.mean() - ratio.min()) for _, ratio in found]
    high = [float(ratio.max() - ratio.mean()) for _, ratio in found]
    axes["curve"].errorbar(
        number, mean, (low, high), marker="o", capsize=3, label=name
    )
axes["curve"].set_xscale("log", base=2)
axes["curve"].set(
    xticks=[1, 4, 16],
    xticklabels=["1", "4", "16"],
    xlabel="eyebox of the panel alone × …",
    ylabel="PSNR over the eyebox (dB)",
)
axes["curve"].legend()
shown = [("no mask", 1), ("no mask", 4), ("learned mask", 4)]
gray = {"cmap": "gray", "vmin": 0, "vmax": 1, "interpolation": "bicubic"}


def draw(axis, view):
    """Draw the means over the pixels of the observer."""
    view = picture_of(torch.nn.functional.avg_pool2d(view, 2), green)[0]
    axis.imshow(view, **gray)
    axis.set(xticks=[], yticks=[])


draw(axes["photo"], photo[None])
axes["photo"].set_title("the photograph")
axes["g"].axis("off")
for one, other, key in zip("abc", "def", shown):
    draw(axes[one], maps[key].images[2, 2])
    draw(axes[other], maps[key].images[0, 0])
    axes[one].set_title(f"{key[0]}, × {key[1]}")
axes["a"].set_ylabel("middle")
axes["d"].set_ylabel("corner")
# Thumbnail: 0.0 0.0 0.3 1.0
# Picture: Quality over the eyebox, which falls with the expansion, least with a learned mask; and a photograph as a pupil in the middle and one in the corner see it
# Change: `cells, 256).phases.requires_grad_()` to `cells, 2).phases.requires_grad_()`: Learning begins with a binary mask.
plt.show()
