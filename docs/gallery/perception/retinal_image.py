"""A photograph on the retina

What reaches the retina is no copy of the screen. Light of three lasers goes through Navarro's schematic eye: rays give
the phase of its pupil, and its autocorrelation the image. Blue light is focused in front of red light by about two
dioptres' difference between the ends of the spectrum, and an eye that accommodates to another distance sees a blur
whose edges are coloured.

[The eye](../../guides/the_eye.md) goes on from here.
"""

import math
from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.raytracing.system import eye_refraction, retinal_image
from odak.learn.tools import load_image

# %%
# Light of a photograph 6° wide, at half a metre, for a pupil of 4 mm.
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
light = photo.float()[:3, 60:252, 200:392] ** 2.2
lasers, pitch, vergence = [638e-9, 532e-9, 450e-9], math.radians(6 / 192), 2.0

# %%
# Three states of accommodation: beyond the picture, at it, in front of it.
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
for axis, accommodation in zip(axes, (0.0, 1.5, 3.5)):
    seen = retinal_image(light, vergence, pitch, lasers, 4.0, accommodation)
    red, green, blue = eye_refraction(lasers, 4.0, accommodation).tolist()
    axis.imshow(seen.clamp(0, 1).permute(1, 2, 0) ** (1 / 2.2), extent=(0, 6, 0, 6))
    axis.set_title(f"in focus: red {red:.1f}, green {green:.1f}, blue {blue:.1f} D")
    axis.set_xlabel("visual angle (degrees)")
axes[0].set_ylabel("visual angle (degrees)")
distance = f"{1 / vergence:g} m ({vergence:g} dioptres)"
figure.suptitle(f"a picture at {distance}, pupil of 4 mm")
# Picture: A cup seen by an eye focused beyond it, at it, and in front of it
# Change: `pitch, vergence = [638e-9, 532e-9, 450e-9], math.radians(6 / 192), 2.0` to `pitch, vergence = [638e-9, 532e-9, 450e-9], math.radians(6 / 192), 4.0`: A picture at 25 cm is out of focus in all three states, least in the last: the eye would have to accommodate by 4 dioptres.
plt.show()
