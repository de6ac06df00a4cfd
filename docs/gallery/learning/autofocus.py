"""Refocusing by the gradient of the distance

A hologram of cells was recorded at some distance from focus, and nobody knows which. Propagation is differentiable in
the distance, so that gradient descent finds it: it makes the gradient of the refocused image sparse, as it is for a
sharp image. The same works for any parameter that a model has.

[Record holograms with a camera](../../guides/record_holograms.md) refocuses records.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.tools import load_image
from odak.learn.wave import generate_complex_field, propagate_beam

# %%
# A chart, 6.3 mm out of focus.
pitch, wavelength, true_distance = 4e-6, 532e-9, 6.3e-3
chart = load_image(files("odak") / "assets" / "chart.png").double()
chart = torch.nn.functional.interpolate(
    chart[None, None, 60:1020, 480:1440], (320, 320), mode="area"
)[0, 0]
recorded = propagate_beam(
    generate_complex_field(chart.sqrt(), 0.0), None, true_distance, pitch, wavelength
)

# %%
# A measure of blur that is least for sharp edges.
def blur_of(distance):
    image = propagate_beam(recorded, None, -distance, pitch, wavelength).abs()[
        8:-8, 8:-8
    ]
    return (image.diff(dim=0).abs() + 1e-3).sqrt().mean() + (
        image.diff(dim=1).abs() + 1e-3
    ).sqrt().mean(), image

# %%
# Eighty steps of Adam from a start that is 1.3 mm off.
distance = torch.tensor(5.0e-3, dtype=torch.float64, requires_grad=True)
optimizer = torch.optim.Adam([distance], lr=8e-5)
history = []
for _ in range(80):
    loss, _ = blur_of(distance)
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    history.append(float(distance.detach()))
print(f"found ≈ {1e3 * history[-1]:.2f} mm, true {1e3 * true_distance:.3f} mm")

# %%
# The measure has one deep minimum within the range, and small ones beside it.
figure, axes = plt.subplots(1, 4, figsize=(14, 3.2))
images = (("recorded", recorded.abs()), ("refocused", blur_of(distance)[1].detach()))
for axis, (title, image) in zip(axes, images):
    axis.imshow(image, cmap="gray", extent=[0, 1.28, 1.28, 0], vmin=0, vmax=1.2)
    axis.set(title=title, xlabel="x (mm)", ylabel="y (mm)")
trial = torch.linspace(4.5e-3, 8e-3, 71, dtype=torch.float64)
with torch.no_grad():
    axes[2].plot(1e3 * trial, [float(blur_of(d)[0]) for d in trial])
axes[2].axvline(1e3 * true_distance, color="k", ls=":")
axes[2].set(xlabel="distance (mm)", ylabel="mean root of the gradient")
axes[3].plot(1e3 * torch.tensor(history))
axes[3].axhline(1e3 * true_distance, color="k", ls=":")
axes[3].set(xlabel="step", ylabel="distance (mm)")
# Thumbnail: 0.35
# Picture: A defocused chart, the refocused one, the measure of blur, and the distance by step
# Change: `torch.tensor(5.0e-3` to `torch.tensor(7.4e-3`: From the other side the descent arrives at the same distance.
plt.show()
