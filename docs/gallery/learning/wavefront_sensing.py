"""Aberrations from an image of a point

Telescopes and optical tables find their aberrations from an image of a star alone, without any sensor of wavefronts. A
known defocus makes the answer unique; gradient descent through the propagation does the rest.

[Windows and partial coherence](../../guides/windows_and_partial_coherence.md) explains the window, [Your table in an
afternoon](../../guides/your_table_in_an_afternoon.md) does it with a camera.
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import lens_phase, propagate_to_window, zernike_phase

# %%
# Five coefficients to be found, and the pupil with a lens.
modes = [(2, -2), (2, 2), (3, -1), (3, 1), (4, 0)]
truth = torch.tensor([0.6, -0.4, 0.5, 0.3, -0.5], dtype=torch.float64)
wavelength, pitch, size, radius, focal = 633e-9, 20e-6, 128, 1.0e-3, 0.1
place = (torch.arange(size, dtype=torch.float64) - size // 2) * pitch
pupil = (torch.hypot(place[:, None], place) <= radius).double()
lens = lens_phase((size, size), focal, pitch, wavelength)

# %%
# The model: an image with two radians of defocus added.
def image_of(coefficients):
    phase = zernike_phase(
        size, size, {(2, 0): 2.0} | dict(zip(modes, coefficients)), radius, pitch
    )
    field = torch.polar(pupil, lens + phase)
    return propagate_to_window(field, wavelength, focal, pitch, (64, 64), 6e-6).abs()

# %%
# 150 steps from zero.
measured = image_of(truth)
coefficients = torch.zeros(5, dtype=torch.float64, requires_grad=True)
optimizer = torch.optim.Adam([coefficients], lr=0.05)
history = []
for _ in range(150):
    loss = (
        image_of(coefficients) - measured
    ).square().mean() / measured.square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
    history.append(coefficients.detach().clone())
print("found:", [round(v, 3) for v in history[-1].tolist()])
print("true: ", truth.tolist())

# %%
# The image with and without the aberrations, and the coefficients by step.
figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), width_ratios=(1, 1, 1.4))
for axis, image, title in zip(
    axes, (measured, image_of(history[0] * 0)), ("measured", "without aberrations")
):
    drawn = axis.imshow(image.detach(), extent=[-192, 192, 192, -192])
    axis.set(title=f"{title}, amplitude", xlabel="x (µm)", ylabel="y (µm)")
for index, mode in enumerate(modes):
    (line,) = axes[2].plot(
        [step[index] for step in history], label=f"n, m = {mode[0]}, {mode[1]}"
    )
    axes[2].axhline(truth[index], color=line.get_color(), ls=":", lw=1)
axes[2].set(xlabel="step", ylabel="coefficient (rad RMS)")
axes[2].legend(fontsize=8)
# Thumbnail: 0.15
# Picture: A defocused image of a point with and without aberrations, and the coefficients by step
# Change: `{(2, 0): 2.0}` to `{(2, 0): 0.7}`: A third of the defocus is still enough to tell the signs of all five coefficients.
plt.show()
