"""Equal spots from a weighted iteration

Optical tweezers and quantum computers of atoms need many foci of exactly one intensity. Gerchberg and Saxton's
iteration leaves them unequal by tens of per cent; the weighted one raises the weights of weak spots in each step, until
all are equal.

[Compute a hologram](../../guides/compute_a_hologram.md) has spots in space, too.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.wave import uniformity, weighted_gerchberg_saxton

# %%
# Spots in the focal plane of a lens spell a word.
size = 256
target = np.zeros((size, size))
for row, line in enumerate(
    (
        "01110 11100 01110 10001",
        "10001 10010 10001 10010",
        "10001 10001 11111 11100",
        "10001 10010 10001 10010",
        "01110 11100 10001 10001",
    )
):
    for column, value in enumerate(line):
        if value == "1":
            target[96 + 14 * row, 52 + 7 * column] = 1

# %%
# Uniformity (1 for equal spots) and efficiency after more and more iterations.
spots = target > 0
evenness, share = [], []
for iterations in (1, 2, 3, 5, 8, 12, 20, 30):
    hologram, image = weighted_gerchberg_saxton(target, iterations, seed=0)
    power = np.abs(image[spots]) ** 2
    evenness.append((iterations, uniformity(power)))
    share.append(power.sum())
print(
    f"uniformity {evenness[-1][1]:.4f}; "
    f"{share[-1]:.1%} of the power is in {spots.sum()} spots"
)

# %%
# The far field is drawn as amplitude, each spot enlarged.
figure, axes = plt.subplots(1, 3, figsize=(13, 3.8))
drawn = axes[0].imshow(np.angle(hologram) % (2 * np.pi), cmap="twilight")
axes[0].set(title="hologram", xlabel="column", ylabel="row")
figure.colorbar(drawn, ax=axes[0], label="phase (rad)", shrink=0.8)
axes[1].imshow(
    np.abs(image)[84:164, 44:220].reshape(40, 2, 88, 2).max((1, 3)),
    extent=[44, 220, 164, 84],
    vmax=np.abs(image).max(),
)
axes[1].set(title="far field, amplitude", xlabel="column")
axes[2].plot(*zip(*evenness), "o-")
axes[2].set(xlabel="iterations", ylabel="uniformity of the spots", xscale="log")
# Thumbnail: 0.14
# Picture: A phase pattern, its far field of equal spots that spell a word, and their uniformity by iteration
# Change: `target[96 + 14 * row, 52 + 7 * column] = 1` to `target[96 + 14 * row, 52 + 7 * column] = 1 + column % 2`: Every second column gets twice the amplitude: the weights follow any ratio, and the uniformity of intensities of 4 to 1 is 1 − 3/5.
plt.show()
