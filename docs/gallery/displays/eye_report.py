"""What an eye has of a display

A near-eye display is good where the pupil may be, where the eye may focus, over the field, and without speckle. One
report computes all of these for a display of 48 × 72 pixels whose holograms are optimised for nine pupils: maps of the
quality, the light and the contrast of speckle over the eyebox, of the resolution over the field, and the quality over
focus. What is judged is seen by pupils that were not optimised for.

[Light fields](../../guides/light_fields.md) describes scenes, pupils and the report.
"""

from importlib.resources import files

import torch

from odak.learn.tools import load_image
from odak.learn.wave import (
    DepthScene,
    Display,
    Eyes,
    Modulator,
    Run,
    eye_report,
    light_of,
)

# %%
# A rendered scene at 98.5 to 101.5 mm from the pupils, the panel at 100 mm.
assets, size, green, away = files("odak") / "assets", (48, 72), 532e-9, 0.1
picture = light_of(assets / "scene.png", green).targets[0]
depth = load_image(assets / "scene_depth.png").float()
picture, depth = (
    torch.nn.functional.adaptive_avg_pool2d(part[None], size)[0]
    for part in (picture, depth)
)
picture = (picture - picture.min()) / (picture.max() - picture.min())
near, far = 0.0985, 0.1015
scene = DepthScene(picture, near + (far - near) * depth)

# %%
# Pupils drawn within 1.6 mm, and the report for pupils within 2.4 mm and five distances of focus.
eyes = Eyes.within(away, 1.6e-3, 9, (2.5e-3, 3.5e-3), (near, far))
display = Display(Modulator(size, 8e-6), green, eyes, frames=4)
run, foci = Run(25, progress=False, seed=0), [0.09, near, away, far, 0.11]
report = eye_report(display, scene, 2.4e-3, 5, 3e-3, foci, run=run)
print(f"{float(report.scene.psnr[2, 2]):.0f} dB on the axis")
print(f"speckle from {float(report.speckle.min()):.2f}")
print(f"{float(report.resolution.mean()):.0f} cycles per degree on average,")
print(f"of {report.pupil_limit:.0f} that the pupil passes")

# %%
# The figure: dark is low.
report.figure().savefig("eye_report.png", dpi=90)
# Thumbnail: 0.0
# Picture: Maps over pupils within 2.4 mm of the quality, the light and the contrast of speckle, good within 1.2 mm and worse beyond; a map of the resolution over the field; and the quality over focus, best at the panel
# Change: `frames=4` to `frames=1`: One pattern has not enough numbers for nine pupils: speckle is three times as strong, and fewer cycles per degree are told from it.
