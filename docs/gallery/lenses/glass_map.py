"""Glass map

Refractive index and Abbe number of all glasses of the catalogue.
"""

import matplotlib.pyplot as plt

from odak.catalog import abbe_number, material_names, refractive_index

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
figure, axis = plt.subplots(figsize=(9, 5.5))
axis.plot(*zip(*glasses.values()), "o", ms=4, color="tab:blue", alpha=0.6)
labels = {"ha": "left", "xytext": (6, 3), "textcoords": "offset points"}
for name in (
    "N-BK7",
    "N-SF11",
    "N-SK16",
    "F2",
    "CAF2",
    "N-LAK14",
    "N-LASF31A",
    "N-SF66",
    "FUSED_SILICA",
    "SF6",
):
    if name in glasses:
        axis.plot(*glasses[name], "o", ms=6, color="tab:red")
        axis.annotate(name, glasses[name], fontsize=9, **labels)
axis.set(xlabel="Abbe number", ylabel="refractive index at 587.6 nm", xlim=(100, 15))
# Picture: Refractive index against Abbe number for the glasses of the catalogue
# Thumbnail: 0.35 0.05 0.98 0.85
plt.show()
