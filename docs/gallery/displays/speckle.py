"""Speckle, and its average over frames

A rough surface gives speckle of contrast 1. The mean of N independent patterns, shown faster than the eye resolves, has
the contrast 1/√N.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import generate_complex_field, propagate_beam, temporal_average

frames, size, pitch = 64, 192, 8e-6
generator = torch.Generator().manual_seed(0)
phases = 2 * torch.pi * torch.rand(frames, size, size, generator=generator)
field = generate_complex_field(torch.ones_like(phases), phases)
intensity = (
    propagate_beam(field, None, 2e-3, pitch, 532e-9, zero_padding=(False,) * 3)
    .abs()
    .square()
)
counts = (1, 2, 4, 8, 16, 32, 64)
averages = [temporal_average(intensity[:count]) for count in counts]
contrast = [float(image.std() / image.mean()) for image in averages]

# %%
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
plt.show()
