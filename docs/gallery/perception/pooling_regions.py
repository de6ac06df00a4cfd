"""Pooling regions of the periphery

How coarse may a picture be without being noticed? The visual system averages over regions whose diameter grows with the
angle from the gaze. In pixels of a display they are small at the gaze and large far from it, and everything that is
foveated starts from such a map.

[Metamers](../../guides/metamers.md) goes on from here.
"""

import matplotlib.pyplot as plt

from odak.learn.perception import make_pooling_size_map_pixels

# %%
# A screen 60 cm wide, seen from 60 cm, at three gazes. The contours are 1, 10, 50 and 100 pixels.
view = {"alpha": 0.2, "real_image_width": 0.6, "real_viewing_distance": 0.6}
figure, axes = plt.subplots(1, 3, figsize=(13, 3.2))
for axis, gaze in zip(axes, ((0.5, 0.5), (0.25, 0.5), (0.9, 0.1))):
    size = make_pooling_size_map_pixels(gaze, (540, 960), **view)
    drawn = axis.imshow(
        size.clamp_min(1),
        norm="log",
        cmap="viridis",
        extent=[0, 60, 33.75, 0],
        vmax=150,
    )
    lines = axis.contour(
        size,
        levels=(1, 10, 50, 100),
        colors="w",
        linewidths=0.8,
        extent=[0, 60, 0, 33.75],
    )
    axis.clabel(lines)
    axis.plot(60 * gaze[0], 33.75 * gaze[1], "r+", ms=12, mew=2)
    axis.set(xlabel="x on the display (cm)")
axes[0].set_ylabel("y (cm)")
figure.colorbar(drawn, ax=axes, label="pooling size (pixels)", shrink=0.9)
# Thumbnail: 0.17
# Picture: Maps of the size of pooling regions on a display for three gazes
# Change: `"real_viewing_distance": 0.6` to `"real_viewing_distance": 0.3`: From half the distance the same screen fills a larger angle: regions near the gaze shrink, and the resolution is needed.
plt.show()
