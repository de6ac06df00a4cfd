"""A fast lens between crossed polarisers

In a polarising microscope, or an inspection of stress in a fast lens, light leaks through crossed polarisers although
the sample is clear. The lens itself turns the polarisation: oblique light loses more of its s than of its p component
at each bare surface, and a field along x leaves with a component along y. In the pupil this is a Maltese cross, in the
image a spot with four lobes; coatings that reflect less also leak less.

[Polarised rays](../../guides/polarised_rays.md) explains Jones matrices of rays.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.raytracing.system import (
    Coating,
    launch,
    optical_system,
    polarized_trace,
    surface,
)

# %%
# A condenser of two fast elements, bare or with a quarter wave of magnesium fluoride on each face.
def condenser(coated):
    lens = optical_system(
        [
            surface(40.0, thickness=9.0, material="N-SF11", stop=True),
            surface(400.0, thickness=1.0),
            surface(20.0, thickness=9.0, material="N-SF11"),
            surface(31.0, thickness=13.0),
        ],
        aperture=32.0,
        wavelengths=550e-6,
    )
    if coated:
        film = Coating.quarter_waves([1.38], 550e-6)
        for i, item in enumerate(lens.surfaces):
            # The second face of each lens meets the light from within.
            item.coating = film if i % 2 == 0 else film.reversed()
    return lens

# %%
# Rays on a grid of the pupil carry Jones matrices; the analyser passes the element that turns x into y. The image of a
# point is the transform of what it passes.
size = 101
figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.4), layout="constrained")
for row, coated in zip(axes, (False, True)):
    lens = condenser(coated)
    rays = launch(lens, "grid", size)
    found = polarized_trace(lens, rays)
    passed = found.jones[0, 0, :, 1, 0]
    share = (passed.abs().square() * found.absorption[0, 0]).numpy()
    line = ((torch.stack([rays.x, rays.y])[:, 0, 0] / 16 + 1) / 2 * (size - 1)).round()
    column, line = line.long()
    field = torch.zeros(size, size, dtype=torch.complex128)
    field[line, column] = torch.where(found.traced.arrived[0, 0], passed, 0.0)
    image = torch.fft.fftshift(torch.fft.fft2(field, s=(1024, 1024))).abs().square()
    image = image[488:537, 488:537] / image.max()
    name = "coated" if coated else "bare"
    loss = 100 * found.diattenuation[0, 0]
    print(f"{name}: {share.mean():.1e} of the light passes the analyser")
    for axis, values, title, unit in (
        (row[0], loss.numpy(), "diattenuation", "%"),
        (row[1], 1e3 * share, "light behind the analyser", "‰"),
    ):
        shown = torch.full((size, size), torch.nan, dtype=torch.float64)
        shown[line, column] = torch.from_numpy(values)
        picture = axis.imshow(shown, origin="lower", extent=(-1, 1, -1, 1))
        axis.set(title=f"{title}, {name}", xlabel="pupil x", ylabel="pupil y")
        figure.colorbar(picture, ax=axis, label=unit, shrink=0.9)
    row[2].imshow(image.sqrt(), origin="lower", cmap="gray")
    row[2].set(title=f"image of a point, {name}", xticks=[], yticks=[])
# Thumbnail: 0.5
# Picture: Diattenuation and crossed light over the pupil of a fast lens, bare and coated, and the four-lobed images
# Change: `aperture=32.0` to `aperture=20.0`: At two thirds of the aperture the rays are less oblique, and several times less light leaks through.
plt.show()
