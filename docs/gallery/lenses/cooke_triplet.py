"""Rays through a Cooke triplet

Three separate elements are the fewest with which a lens can correct all five of Seidel's aberrations and both colour
errors at a chosen focal length, so the triplet is where one begins to learn, or to design, a lens. A spot diagram shows
where the rays of one object point meet the image plane: for a perfect lens in one point, here in figures whose size is the
blur and whose shape names the aberration, coma with its tail or the cross of astigmatism.
[Design a lens](../../guides/design_a_lens.md) goes on from here.
"""

import matplotlib.pyplot as plt

from odak.learn.raytracing.system import draw_layout, load_system, spot_diagram

# %%
# The sample systems of odak are read by name; a file of another program would be read by `read_zmx`. Rays go through rings
# of the pupil, for each field and wavelength.
triplet = load_system("cooke_triplet")
spots = spot_diagram(triplet, "rings", 8)
print("RMS radii:", ", ".join(f"{1e3 * value:.1f} µm" for value in spots.rms))

# %%
# The section shows the fields in one colour each; below it are the spots, in one colour for each wavelength.
figure = plt.figure(figsize=(9, 6.5))
top, bottom = figure.subfigures(2, 1, height_ratios=(1.5, 1))
axis = top.subplots()
axis.imshow(draw_layout(triplet, count=9))
axis.axis("off")
axes = bottom.subplots(1, len(triplet.fields), sharey=True)
for index, (axis, field) in enumerate(zip(axes, triplet.fields)):
    for x, y, wavelength in zip(
        spots.x[:, index], spots.y[:, index], triplet.wavelengths
    ):
        name = f"{1e6 * float(wavelength):.0f} nm"
        axis.plot(1e3 * x.detach(), 1e3 * y.detach(), ".", ms=3, label=name)
    axis.set(title=f"field {field[1]:g}°", xlabel="x (µm)")
    axis.set_aspect("equal", adjustable="datalim")
axes[0].set_ylabel("y (µm)")
axes[0].legend(fontsize=8, markerscale=3)
# Picture: Section through a Cooke triplet with rays of three fields, and its spot diagrams
# Thumbnail: 0.12 0.08 0.55 0.52
# Change: `"cooke_triplet"` to `"singlet"`: One element has no second glass and no bending left that could correct it.
plt.show()
