"""Pooling regions of the periphery

The number of pixels over which the visual system averages at each position of a display, for three gazes.
"""

import matplotlib.pyplot as plt

from odak.learn.perception import make_pooling_size_map_pixels

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
plt.show()
