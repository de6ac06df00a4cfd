"""A metamer of a photograph

Away from the gaze the visual system represents local statistics of an image rather than its details. A metamer shares
these statistics with a photograph, over regions that grow with the distance from the gaze, and differs from it
everywhere else. Look at the cross in either image from half a metre: the other one looks much the same. Displays and
codecs need to keep no more than that.

[Metamers](../../guides/metamers.md) shows how to choose regions and statistics.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import MetamerMSELoss
from odak.learn.tools import load_image

# %%
# The picture in its size in metres, the distance and the gaze in parts of the picture: from these the regions follow.
photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)
photo = photo.float()[None, :3, :384, :576]
gaze = (0.48, 0.55)
loss = MetamerMSELoss(real_image_width=0.5, real_viewing_distance=0.5)
metamer = loss.gen_metamer(photo, gaze).clamp(0, 1)

# %%
# The difference is smallest at the gaze.
figure, axes = plt.subplots(1, 3, figsize=(13, 3.4))
difference = (metamer - photo).abs().mean(1)[0]
for axis, picture, title in (
    (axes[0], photo[0].permute(1, 2, 0), "photograph"),
    (axes[1], metamer[0].permute(1, 2, 0), "metamer for the gaze at the cross"),
):
    axis.imshow(picture)
    axis.set_title(title)
drawn = axes[2].imshow(difference, cmap="viridis")
axes[2].set_title("absolute difference")
figure.colorbar(drawn, ax=axes[2], shrink=0.8, label="mean of the channels")
rows, columns = photo.shape[-2:]
for axis in axes:
    axis.plot(gaze[0] * columns, gaze[1] * rows, "w+", ms=14, mew=2)
    axis.axis("off")
# Thumbnail: 0.36
# Picture: A photograph, a metamer of it that is sharp at the gaze, and their difference
# Change: `gaze = (0.48, 0.55)` to `gaze = (0.1, 0.1)`: For a gaze at the upper left corner the cup may be disordered, and the corner must not.
plt.show()
