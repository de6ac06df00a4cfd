"""Glass map

A lens designer chooses glasses from this map: the refractive index says how strongly a glass bends light, the Abbe
number how little that depends on the wavelength. An achromatic doublet needs two glasses far apart on it, a flat field
a positive lens from the upper left.

[Design a lens](../../guides/design_a_lens.md) uses the catalogue.
"""

import matplotlib.pyplot as plt

from odak.catalog import abbe_number, material_names, refractive_index

# %%
# Every material of the catalogue that is transparent at the F, d and C lines.
points = {}
for name in material_names():
    try:
        points[name] = (abbe_number(name), refractive_index(name, 587.5618e-9))
    except ValueError:  # materials that are not transparent at the F, d and C lines
        continue
glasses = {
    name: point
    for name, point in points.items()
    if 15 < point[0] < 100 and 1.4 < point[1] < 2.1
}
print(f"{len(glasses)} materials")

# %%
# The Abbe number falls to the right, as is the custom.
figure, axis = plt.subplots(figsize=(9, 5.5))
axis.plot(*zip(*glasses.values()), "o", ms=4, color="tab:blue", alpha=0.6)
labels = {"ha": "left", "xytext": (6, 3), "textcoords": "offset points"}
for name in (
    "N-BK7",
    "N-SF11",
    "N-SK16",
    "F2",
    "CaF2",
    "N-LAK14",
    "N-LASF31A",
    "N-SF66",
    "fused silica",
    "SF6",
):
    if name in glasses:
        axis.plot(*glasses[name], "o", ms=6, color="tab:red")
        axis.annotate(name, glasses[name], fontsize=9, **labels)
axis.set(xlabel="Abbe number", ylabel="refractive index at 587.6 nm", xlim=(100, 15))
# Picture: Refractive index against Abbe number for the glasses of the catalogue
# Change: `"N-BK7",` to `"N-FK51A",`: Fluor crowns stand at the far left: with them, and a flint of little anomalous dispersion, three wavelengths are brought to one focus.
# Thumbnail: 0.35 0.05 0.98 0.85
plt.show()
