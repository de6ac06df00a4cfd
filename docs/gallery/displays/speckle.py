"""Speckle, and its average over frames

A rough surface, or a hologram with random phases, gives speckle: grains of contrast 1, as annoying as they are
informative. The mean of N independent patterns, shown faster than the eye resolves, has the contrast 1/√N, and about
0.05 is called invisible.

[Real displays](../../guides/real_displays.md) uses frames to this end.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import generate_complex_field, propagate_beam, temporal_average

# %%
# Sixty-four fields of random phase, 2 mm from the surface.
frames, size, pitch = 64, 192, 8e-6
generator = torch.Generator().manual_seed(0)
phases = 2 * torch.pi * torch.rand(frames, size, size, generator=generator)
field = generate_complex_field(torch.ones_like(phases), phases)
intensity = (
    propagate_beam(field, None, 2e-3, pitch, 532e-9, zero_padding=(False,) * 3)
    .abs()
    .square()
)

# %%
# Averages of the first frames, and their contrast.
counts = (1, 2, 4, 8, 16, 32, 64)
averages = [temporal_average(intensity[:count]) for count in counts]
contrast = [float(image.std() / image.mean()) for image in averages]

# %%
# The grains stay, their contrast falls.
figure, axes = plt.subplots(1, 4, figsize=(13, 3.2))
for axis, index in zip(axes, (0, 2, 6)):
    image = averages[index] / averages[index].mean()
    drawn = axis.imshow(image, vmin=0, vmax=3, cmap="gray", extent=[0, 1.54, 1.54, 0])
    axis.set(
        title=f"{counts[index]} frames, contrast {contrast[index]:.2f}", xlabel="x (mm)"
    )
figure.colorbar(drawn, ax=axes[2], label="intensity / mean")
axes[3].loglog(counts, contrast, "o", label="measured")
axes[3].loglog(counts, [count**-0.5 for count in counts], label="1/√N")
axes[3].set(xlabel="frames N", ylabel="contrast")
axes[3].legend()
# Thumbnail: 0.14
# Picture: Speckle in 1, 4 and 64 frames, and its contrast by the number of frames
# Change: `torch.rand(frames, size, size, generator=generator)` to `0.3 * torch.rand(frames, size, size, generator=generator)`: Phases over a third of a turn leave part of the light unscattered: the contrast begins below 1, and the mean is not 1/√N any more.
plt.show()
