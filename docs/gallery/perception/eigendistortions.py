"""The distortions that an eye sees best and least

A picture at half a metre is seen by an eye that is focused one dioptre away. Its optics pass some changes of the picture
to the retina and hold back others: the Jacobian of the image on the retina tells which. All distortions here have one
squared error. The last picture is a metamer: noise that was changed until its image on the retina was the same as the
cup's.
"""

import math
from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import eigendistortions, metamer
from odak.learn.raytracing.system import retinal_image
from odak.learn.tools import load_image

photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
cup = photo.float()[:3, 60:252, 200:392].mean(0, keepdim=True)
cup = torch.nn.functional.avg_pool2d(cup, 4)
pitch = math.radians(0.5 / 48)


def seen(picture):
    return retinal_image(picture.clamp_min(0) ** 2.2, 2.0, pitch, 532e-9, 4.0, 1.0)


_, most = eigendistortions(seen, cup, tolerance=1e-3)
_, least = eigendistortions(seen, cup, least=True, tolerance=1e-3)
other = metamer(seen, cup, iterations=300)

# %%
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
plt.show()
