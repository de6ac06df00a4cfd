"""A picture through two lenses

What would a photograph look like through this lens? Numbers such as the modulation transfer do not answer that for all
of the field at once. The image of a point varies over the field; the photograph is convolved with the images of a grid
of points, interpolated between them, with distortion and shading.

[Pictures through a lens](../../guides/pictures_through_a_lens.md) goes on to sensors and networks.
"""

import matplotlib.pyplot as plt
import skimage
import torch

from odak.learn.raytracing.system import (
    load_system,
    optical_system,
    point_spread_map,
    simulate_image,
    surface,
)
from odak.learn.tools import resize

# %%
# A single lens and a triplet of about the same focal length and f-number.
waves = [486e-6, 546e-6, 656e-6]
single = optical_system(
    [
        surface(thickness=8.0, stop=True),
        surface(-250.0, thickness=4.0, material="N-BK7"),
        surface(-23.6, thickness=50.8),
    ],
    aperture=12.5,
    wavelengths=waves,
    fields=[0.0, 14.0, 20.0],
    name="single lens",
)
triplet = load_system("cooke_triplet")
triplet.wavelengths = tuple(waves)

# %%
# A photograph in linear light, on a sensor with pixels of 0.1 mm.
photo = torch.from_numpy(skimage.data.astronaut() / 255).float().movedim(-1, 0)
photo = resize(photo[:, :400], 0.6, "area") ** 2.2
rows, columns = photo.shape[-2:]
pixel = 0.1

# %%
# Spread functions on 5 × 7 places of the field, and the simulated image.
seen = {"the picture": photo}
for lens in (single, triplet):
    spread = point_spread_map(lens, (rows, columns), pixel, grid=(5, 7), kernel=31)
    seen[lens.name] = simulate_image(photo, spread)
    corner = spread.illumination[1, 0, 0]
    print(f"{lens.name}: {100 * corner:.0f} % of the light in the corner")

# %%
# Encoded again for a screen; below are enlarged parts.
figure, axes = plt.subplots(2, 3, figsize=(11, 5.6), layout="constrained")
cut = (slice(None), slice(0, 78), slice(205, 307))
for column, (name, picture) in zip(axes.T, seen.items()):
    for axis, part in zip(column, (picture, picture[cut])):
        shown = part.clamp(0, 1) ** (1 / 2.2)
        axis.imshow(shown.movedim(0, -1), interpolation="nearest")
        axis.axis("off")
    column[0].set_title(name)
# Picture: A photograph, and how a single lens and a triplet image it, with enlarged parts
# Change: `aperture=12.5` to `aperture=5.0`: Stopped down to f/10, the single lens is sharper all over: landscape cameras were used so.
plt.show()
# Thumbnail: 0.5 1
