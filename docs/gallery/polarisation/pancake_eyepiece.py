"""A pancake eyepiece: light folded by polarisation

Thin headsets fold the path: a half mirror and a reflective polariser, with a quarter-wave plate between them, send light
through the same lens three times. A quarter of the polarised light is left. What goes straight through the eyepiece is a
ghost, and how much of it there is depends on the plate in front of the display; gradients turn that plate.

[Coatings, polarised rays and graded media](../../guides/polarised_rays.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    PolarizerFilm,
    RetarderFilm,
    Wavelengths,
    draw_layout,
    ghost_system,
    ghosts,
    launch,
    optical_system,
    polarized_trace,
    surface,
)

# %%
# The surfaces in the order in which a ray from the eye meets them, without the fold. The first film passes light along x
# and reflects light along y. The plate in front of the display retards green light by 84° in place of 90°, and was
# glued on 9° off.
green, fields = 550e-6, [0.0, 10.0, 20.0, 30.0]
eyepiece = optical_system(
    [
        surface(thickness=15.0, stop=True),
        surface(coating=PolarizerFilm(0.0, (1.0, 0.0), (0.0, 1.0))),
        surface(coating=RetarderFilm(90.0, 45.0, green)),
        surface(thickness=9.0, material="N-BK7", semi_diameter=16.0),
        surface(-75.0, coating=PolarizerFilm.half_mirror(), thickness=4.0),
        surface(coating=RetarderFilm(84.0, -36.0, green)),
        surface(coating=PolarizerFilm(90.0), thickness=5.0),
    ],
    4.0,
    wavelengths=Wavelengths([450e-6, green, 630e-6], 1),
    fields=fields,
    name="Pancake eyepiece",
)

# %%
# The image is the light that is reflected at the half mirror and at the reflective polariser. The same call finds all
# other paths with up to four reflections; light from unpolarised pixels has a power of 1.
image = ghost_system(eyepiece, 1, 4)
found = ghosts(eyepiece, 5, fields=[0.0], reflections=4, least=1e-5)
print(f"straight through: {100 * found.direct[0]:.2f} %")
for path in found.paths:
    places = [path.second, path.first, *path.further]
    print(f"reflected at {places}: {100 * path.power[0]:.2f} %")


# %%
# Descent on the ratio of the light that goes straight through to the image, over three colours and four fields.
def powers(system):
    """Return the mean power in each colour and field."""
    rays = launch(system, "rings", 1)
    return polarized_trace(system, rays).transmittance.mean(-1)


def contrast():
    """Return the power of the image over that of the ghost."""
    with torch.no_grad():
        return powers(image) / powers(eyepiece)


before = contrast()
numbers = {5: ("retardance", "angle"), 6: ("angle",)}
varied = [eyepiece.surfaces[i].vary(name) for i in numbers for name in numbers[i]]
image = ghost_system(eyepiece, 1, 4)  # with the same parameters
search = torch.optim.LBFGS(varied, max_iter=40, line_search_fn="strong_wolfe")


def ghost_ratio():
    search.zero_grad()
    ratio = powers(eyepiece).mean() / powers(image).mean()
    ratio.backward()
    return ratio


search.step(ghost_ratio)
after = contrast()
for name, values in (("before", before), ("after", after)):
    print(f"contrast {name}: at least {float(values.min()):.3g}")
values = ", ".join(f"{float(number.detach()):.0f}" for number in varied)
print(f"plate and polariser at the display: {values} degrees")

# %%
# The folded path, and the contrast of each field.
figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
drawing = draw_layout(image, count=3)
ink = drawing.convert("L").point(lambda value: 255 * (value < 250))
axes[0].imshow(drawing.crop(ink.getbbox()))
axes[0].set(xticks=[], yticks=[], frame_on=False)
for values, line in ((before, "--"), (after, "-")):
    for curve, color in zip(values, ("tab:blue", "tab:green", "tab:red")):
        axes[1].plot(fields, curve.numpy(), line, color=color)
axes[1].set(yscale="log", xlabel="field (degrees)", ylabel="image over ghost")
# Picture: Rays folded in a pancake eyepiece; its contrast in three colours, dashed before and solid after the descent
plt.show()
