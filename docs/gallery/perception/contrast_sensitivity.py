"""Contrast sensitivity of the eye

What contrast can be seen, at which size and brightness? Displays, codecs and metrics of quality are built on this
curve. Barten's model derives it from the optics of the eye, the noise of photons and neurons, and lateral inhibition,
which cuts off low frequencies; the chart shows the reader's own.

[The eye](../../guides/the_eye.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import contrast_sensitivity

# %%
# Sensitivity for five luminances, for a target of 10°.
frequency = torch.logspace(-0.7, 1.78, 200, dtype=torch.float64)
figure, axes = plt.subplots(1, 2, figsize=(12, 4.2))
for luminance in (0.1, 1.0, 10.0, 100.0, 1000.0):
    axes[0].loglog(
        frequency,
        contrast_sensitivity(frequency, luminance, 10.0),
        label=f"{luminance:g} cd/m²",
    )
axes[0].set(xlabel="cycles per degree", ylabel="sensitivity", ylim=(1, 1000))
axes[0].legend()

# %%
# The chart of Campbell and Robson: frequency grows to the right, contrast downwards. The height at which bars disappear
# follows the curve.
# The frequency grows to the right, the contrast downwards (Campbell and Robson).
x = torch.linspace(0, 1, 1200, dtype=torch.float64)
phase = 2 * torch.pi * 4 * (torch.exp(4.2 * x) - 1) / 4.2
contrast = torch.logspace(-3, 0, 600, dtype=torch.float64)[:, None]
axes[1].imshow(
    0.5 + 0.5 * contrast * torch.sin(phase), cmap="gray", vmin=0, vmax=1, aspect="auto"
)
axes[1].set(
    title="chart of Campbell and Robson",
    xticks=[],
    yticks=[],
    xlabel="frequency →",
    ylabel="← contrast",
)
# Thumbnail: 0.22
# Picture: Contrast sensitivity by frequency for five luminances, and a chart of Campbell and Robson
# Change: `luminance, 10.0)` to `luminance, 1.0)`: A target of 1° instead of 10° holds few periods of a low frequency, and is seen less well on the left of the diagram.
plt.show()
