"""Goes from a modulator to a corrected hologram on a simulated table, as the guide of this name does.

    python benchmarks/from_slm_to_hologram.py

writes predicted.png, maps.png and holograms.png and prints the figures; it takes some minutes on a CPU.
"""

from dataclasses import replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates

from odak.instruments import (
    Calibration,
    Registration,
    SimulatedTable,
    measure_dark,
    measure_phase_response,
    measure_wavefront,
    record_captures,
    register_camera,
    set_exposure,
)
from odak.learn.wave import display_hologram, display_model, fit_display
from odak.tools import save_image

n, distance, wavelength = 64, 9e-3, 532e-9
table = SimulatedTable.realistic(
    4,
    shape=(n, n),
    distance=distance,
    camera_shape=(140, 140),
    aberration=0.15,
    samples_per_pixel=1,
    fill_factor=1.0,
    iris=None,
    fringing=0.25,
    dust=2,
)
modulator, camera = table.modulator, table.camera

there = (modulator, camera, wavelength, distance)
phases = measure_phase_response(*there, samples=17)
wavefront = 0.0
for _ in range(2):
    registration = register_camera(*there, phases, wavefront=wavefront)
    wavefront = measure_wavefront(*there, phases, registration, captures=3)
registration = register_camera(*there, phases, wavefront=wavefront)
calibration = replace(
    Calibration.nominal(*there),
    phases=phases,
    wavefront=wavefront,
    registration=registration,
)
print(f"spots lie within 0.3 pixels of the mapping: {registration.residual < 0.3}")

random = np.random.default_rng(0)


def pattern(width):
    """Return random levels, smooth over a width."""
    surface = gaussian_filter(random.normal(size=(n, n)), width)
    return np.mod(np.rint(128 + 80 * surface / surface.std()), 256).astype(int)


levels = np.array([pattern((0.8, 1.2, 2.0)[k % 3]) for k in range(15)])
set_exposure(camera, lambda: modulator.show(levels[2]))
dark = measure_dark(camera, table.laser).mean()
captures = record_captures(modulator, camera, levels, wavelength, dark=dark)

model = display_model.from_calibration(calibration, camera.pitch, free_form=n, nodes=9)
ideal = display_model((n, n), 8e-6, wavelength, distance, (140, 140), camera.pitch)
fit_display(model, captures[:4], iterations=7, pixels=3000)
fit_display(model, captures[:12], iterations=0, refinements=14, learning_rate=1e-2)


def excess(model):
    """Return the error of held-out captures, in dB above their own noise."""
    held = captures[12:]
    with torch.no_grad():
        seen = model(torch.as_tensor(held.levels.astype(int))).numpy()
    noise = held.frames.var(1, ddof=1).mean() / 2
    return 10 * np.log10(((seen - held.means()) ** 2).mean() / noise)


print(f"held-out captures: {excess(model):.1f} dB above their noise")

seen = captures[12:].means()[0]
with torch.no_grad():
    predicted = model(torch.as_tensor(levels[12])).numpy()
gap = np.full((140, 4), seen.max())
difference = np.abs(predicted - seen) * 5
save_image(
    "predicted.png",
    np.kron(np.hstack([seen, gap, predicted, gap, difference]), np.ones((2, 2))),
    cmin=0.0,
    cmax=float(seen.max()),
)
found = model.wavefront().detach().numpy()
truth = table.truth.wavefront
maps = [truth, found, table.truth.amplitude / table.truth.amplitude.max()]
source = model.source_amplitude().detach().numpy()
maps.append(source / np.quantile(source, 0.999))
maps = [(part - part.min()) / np.ptp(part) for part in maps]
gap = np.ones((n, 2))
row = np.hstack([maps[0], gap, maps[1], gap, maps[2], gap, maps[3]])
save_image("maps.png", np.kron(row, np.ones((4, 4))), cmin=0.0, cmax=1.0)

y, x = np.mgrid[:n, :n] / n - 0.5
picture = (np.hypot(x - 0.17, y + 0.15) < 0.15).astype(float)
bars = (np.abs(y - 0.2) < 0.1) & (np.abs(x) < 0.33) & (np.mod(x * 12, 1) < 0.5)
picture += 0.8 * bars + 0.5 * ((np.abs(x + 0.2) < 0.12) & (np.abs(y + 0.17) < 0.12))
target = torch.as_tensor(gaussian_filter(picture, 0.7))

hidden = table.truth
camera_of_truth = Registration(hidden.homography, hidden.distortion, (140, 140))
at = (np.arange(n) - n // 2) * 8e-6
pixels = camera_of_truth.camera_pixels(np.stack(np.meshgrid(at, at), axis=-1))


def show(levels, place=0.0):
    """Capture levels, at the points where the picture should be."""
    table.stage.move(place)
    set_exposure(camera, lambda: modulator.show(levels))
    frame = camera.capture(2).mean(0) - dark
    return map_coordinates(frame, [pixels[..., 1], pixels[..., 0]], order=3)


def best(image, wanted):
    """Return an image at its best brightness."""
    return image * (image * wanted).sum() / (image**2).sum()


def psnr(image, wanted):
    """Return the peak signal-to-noise ratio in dB, at the best brightness."""
    return 10 * np.log10(wanted.max() ** 2 / np.mean((best(image, wanted) - wanted) ** 2))


wanted = target.numpy()
shown = {}
for name, display in (("ideal", ideal), ("fitted", model)):
    hologram = display_hologram(display, target, iterations=100)
    shown[name] = show(hologram.numpy())
    print(f"through the {name} model: {psnr(shown[name], wanted):.1f} dB")
gain = psnr(shown["fitted"], wanted) - psnr(shown["ideal"], wanted)

images = [wanted, best(shown["ideal"], wanted), best(shown["fitted"], wanted)]
gap = np.ones((n, 2))
row = np.hstack([images[0], gap, images[1], gap, images[2]])
save_image("holograms.png", np.kron(row, np.ones((4, 4))), cmin=0.0, cmax=1.0)

places = (0.0, 1e-3)
stack = torch.stack([target, target.flip(-1)])
for name, display in (("ideal", ideal), ("fitted", model)):
    hologram = display_hologram(display, stack, places, iterations=80).numpy()
    values = [psnr(show(hologram, place), image.numpy()) for place, image in zip(places, stack, strict=True)]
    print(f"two planes, {name} model: {values[0]:.1f} and {values[1]:.1f} dB")
