"""A photograph on the retina

Light of three lasers goes through Navarro's schematic eye: rays give the phase of its pupil, and the autocorrelation of
the pupil the image on the retina. Blue light is focused in front of red light, and an eye that accommodates to another
distance sees a blur whose edges are coloured.
"""

import math
from importlib.resources import files

import matplotlib.pyplot as plt

from odak.learn.raytracing.system import eye_refraction, retinal_image
from odak.learn.tools import load_image

photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
light = photo.float()[:3, 60:252, 200:392] ** 2.2
lasers, pitch, vergence = [638e-9, 532e-9, 450e-9], math.radians(6 / 192), 2.0

# %%
figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
for axis, accommodation in zip(axes, (0.0, 1.5, 3.5)):
    seen = retinal_image(light, vergence, pitch, lasers, 4.0, accommodation)
    red, green, blue = eye_refraction(lasers, 4.0, accommodation).tolist()
    axis.imshow(seen.clamp(0, 1).permute(1, 2, 0) ** (1 / 2.2), extent=(0, 6, 0, 6))
    axis.set_title(f"in focus: red {red:.1f}, green {green:.1f}, blue {blue:.1f} D")
    axis.set_xlabel("visual angle (degrees)")
axes[0].set_ylabel("visual angle (degrees)")
figure.suptitle("a picture at 0.5 m (2 dioptres), pupil of 4 mm")
# Picture: A cup seen by an eye focused beyond it, at it, and in front of it
plt.show()
