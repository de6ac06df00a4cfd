"""A lens from flat plates

Optimisation of a lens needs a start that is nearly right, and finding it is most of the art. Here there is none: three
plates and a stop are bent at random, and the aperture and the field grow in six steps while least squares keep the
spots small. The same seed gives the same lens.

[Automatic design](../../guides/automatic_design.md) explains requirements, dimensions and searches.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.learn.raytracing.system import (
    DesignSearch,
    LensDimensions,
    LensRequirements,
    automatic_design,
    layout_figure,
    rms_spot,
)

# %%
# Glasses and stop in order, what the lens shall do, and what it may look like. The search keeps the best of six starts.
found = automatic_design(
    ["N-LAK33B", "stop", "SF5", "N-LAK33B"],
    LensRequirements(focal_length=50.0, f_number=4.0, half_field=14.0),
    dimensions=LensDimensions((1.5, 9.0), (0.3, 15.0), edge=0.6, back=20.0, track=80.0),
    search=DesignSearch(starts=6, iterations=12, polish=2),
)
lens = found.system
full = (lens.aperture, ((0.0, 0.0), (0.0, 10.0), (0.0, 14.0)))

# %%
# The plates, an early stage and the lens, all at the full aperture but the stage.
steps = {
    "the plates": found.start,
    "a quarter of the aperture": found.stages[0].system,
    "the lens": lens,
}
print("RMS spots below 15 µm:", bool((rms_spot(lens) < 0.015).all()))

# %%
# Drawings of the three, and the spots as the aperture grows.
figure, axes = plt.subplots(4, 1, figsize=(8, 11), layout="constrained")
for axis, (name, system) in zip(axes, steps.items()):
    if system is not found.stages[0].system:
        system.aperture, system.fields = full
    drawn = layout_figure(system)
    drawn.legends[0].remove()
    drawn.canvas.draw()
    pixels = np.asarray(drawn.canvas.buffer_rgba())
    inked = np.flatnonzero((pixels[..., :3] < 250).any((1, 2)))
    axis.imshow(pixels[max(inked[0] - 5, 0) : inked[-1] + 5])
    axis.set_title(name)
    axis.axis("off")
shares = [f"{s.aperture:.0%}" for s in found.stages[:-1]] + ["polished"]
axes[3].plot(shares, [1e3 * s.rms for s in found.stages], "o-")
axes[3].set(xlabel="share of the aperture", ylabel="RMS spot (µm)", ylim=0)
axes[3].grid(True, alpha=0.3)
# Picture: Flat plates, an early stage and the triplet that they become, and the spots of each stage
plt.show()
# Thumbnail: 0.18 0.53 0.58 0.7
