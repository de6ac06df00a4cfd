"""Wavefront, point spread and modulation transfer

Rays tell how large a spot is; what an image loses is told by waves. From the rays of a Cooke triplet come the wavefront
in the exit pupil, by diffraction the image of a point, and by its transform the modulation transfer, the contrast that
is left of a grating, beside the one of a perfect lens.

[Design a lens](../../guides/design_a_lens.md) goes on from here.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    load_system,
    modulation_transfer_function,
    point_spread_function,
    wavefront,
)

# %%
# Each function takes the lens and traces what it needs.
lens = load_system("cooke_triplet")
waves = wavefront(lens, "grid", 41)
spread = point_spread_function(lens, samples=64, size=256)
frequency, modulation = modulation_transfer_function(spread, "y")
middle = len(lens.wavelengths) // 2
print("wavefront RMS (waves):", [round(v, 3) for v in waves.rms[middle].tolist()])

# %%
# The middle wavelength for two fields; the transfer for all three.
figure, axes = plt.subplots(2, 3, figsize=(12, 6.6), height_ratios=(1, 1))
for index, field in enumerate(lens.fields[:2]):
    axis = axes[0, index]
    path = waves.path[middle, index].detach()
    most = float(path.abs().nan_to_num().max())
    drawn = axis.scatter(
        *waves.pupil.T,
        c=path,
        s=16,
        marker="s",
        lw=0,
        cmap="RdBu",
        vmin=-most,
        vmax=most,
    )
    axis.set(
        title=f"wavefront, field {field[1]:g}°",
        xlabel="pupil x",
        ylabel="pupil y",
        aspect="equal",
    )
    figure.colorbar(drawn, ax=axis, label="waves")
    axis = axes[1, index]
    pitch = 1e3 * float(spread.pitch[middle, index, 0])
    image = spread.intensity[middle, index, 64:192, 64:192].detach()
    drawn = axis.imshow(
        image.sqrt(), extent=[-64 * pitch, 64 * pitch, 64 * pitch, -64 * pitch]
    )
    axis.set(
        title=f"point spread function, field {field[1]:g}°",
        xlabel="x (µm)",
        ylabel="y (µm)",
    )
    figure.colorbar(drawn, ax=axis, label="amplitude")
for index, field in enumerate(lens.fields):
    axes[0, 2].plot(
        frequency[middle, index],
        modulation[middle, index].detach(),
        label=f"{field[1]:g}°",
    )
axes[0, 2].set(
    xlim=(0, 200),
    ylim=(0, 1),
    xlabel="cycles/mm",
    ylabel="modulation",
    title="modulation transfer, tangential",
)
axes[0, 2].legend(title="field")
axes[1, 2].axis("off")
# Picture: Wavefronts and point spread functions of a triplet for two fields, and its modulation transfer
# Change: `"cooke_triplet"` to `"phone_f2"`: The aspheres of a telephone lens are nearly limited by diffraction, with 0.07 waves on the axis at f/2, and its image of a point is half as wide.
plt.show()
