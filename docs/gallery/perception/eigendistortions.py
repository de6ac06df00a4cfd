"""The distortions that an eye sees best and least

A display, a codec or a tone curve may change what is not seen. The Jacobian of an image on the retina tells which
changes these are, if the model is right; a metamer goes further and is a picture that the model cannot tell from the
original at all. The eye here is focused one dioptre off.

[Metamers](../../guides/metamers.md) and [The eye](../../guides/the_eye.md) explain both halves.
"""

import math
from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import eigendistortions, metamer
from odak.learn.raytracing.system import retinal_image
from odak.learn.tools import load_image

# %%
# A cup of 48 × 48 samples, half a degree wide.
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
cup = photo.float()[:3, 60:252, 200:392].mean(0, keepdim=True)
cup = torch.nn.functional.avg_pool2d(cup, 4)
pitch = math.radians(0.5 / 48)

# %%
# Light of the picture on the retina of an eye with a pupil of 4 mm that accommodates to one dioptre, while the picture
# stands at two.
def seen(picture):
    return retinal_image(picture.clamp_min(0) ** 2.2, 2.0, pitch, 532e-9, 4.0, 1.0)

# %%
# Two distortions of the same squared error, and a metamer from noise.
_, most = eigendistortions(seen, cup, tolerance=1e-3)
_, least = eigendistortions(seen, cup, least=True, tolerance=1e-3)
other = metamer(seen, cup, iterations=300)

# %%
# Above what the display shows, below what the retina gets.
pictures = [cup, cup + 4 * most[0], cup + 4 * least[0], other]
titles = ["picture", "the best visible change", "the least visible one", "a metamer"]
figure, axes = plt.subplots(2, 4, figsize=(12, 6.4), layout="constrained")
for column, (picture, title) in enumerate(zip(pictures, titles)):
    axes[0, column].set_title(title)
    for row, image in enumerate((picture, seen(picture) ** (1 / 2.2))):
        axes[row, column].imshow(image[0], cmap="gray", vmin=0, vmax=1)
        axes[row, column].set(xticks=[], yticks=[])
axes[0, 0].set_ylabel("on the display")
axes[1, 0].set_ylabel("on the retina")
# Picture: A cup, its best and least visible distortion, and a metamer of it, on a display and on a retina
# Change: `532e-9, 4.0, 1.0)` to `532e-9, 4.0, 1.8)`: Focused almost on the picture, the eye passes finer structure: the least visible change is finer, and the metamer is nearer to the cup.
plt.show()
