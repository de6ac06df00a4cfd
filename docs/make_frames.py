"""Computes the frames of the figures with sliders in docs/interactive.md.

    PYTHONPATH=. python docs/make_frames.py [name …]

Each figure is one WebP file with its frames below one another, and the labels of the slider in labels.json.
"""

import json
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from odak.learn.perception import MetamerMSELoss
from odak.learn.raytracing.system import load_system, spot_diagram
from odak.learn.tools import load_image
from odak.learn.wave import (
    calculate_phase,
    multiplane_hologram_optimizer,
    propagate_beam,
    propagate_to_window,
    spatial_light_modulator,
    stochastic_gradient_descent,
)

FOLDER = Path(__file__).resolve().parent / "pictures" / "interactive"
WAVELENGTH, PITCH = 532e-9, 8e-6


def colored(values, name="magma", top=None):
    """Return an array 0 … top as a picture in the colours of a map."""
    values = np.asarray(values, dtype=float) / (top or np.max(values))
    return Image.fromarray(np.round(255 * colormaps[name](np.clip(values, 0, 1))[..., :3]).astype(np.uint8))


def photograph(rows=240, columns=320):
    """Return the middle of the photograph in grey."""
    photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[:3].mean(0).float()
    return torch.nn.functional.interpolate(photo[None, None, :, 33:566], (rows, columns), mode="area")[0, 0]


def distance():
    """Yield the field behind a square aperture over distance."""
    field = torch.zeros(320, 320, dtype=torch.complex128)
    field[110:210, 110:210] = 1
    for z in np.geomspace(2e-3, 1.0, 30):
        image = propagate_to_window(field, WAVELENGTH, float(z), PITCH).abs()
        yield f"{100 * z:.3g} cm", colored(image[40:280], top=float(image.max()))


def bits():
    """Yield reconstructions of modulators of one to eight bits."""
    target = photograph()
    hologram, _ = stochastic_gradient_descent(
        target, WAVELENGTH, 0.03, PITCH, n_iteration=60, learning_rate=0.2, scale=True, progress=False,
        initial_phase=torch.zeros_like(target),
    )
    for count in range(1, 9):
        shown = spatial_light_modulator(bits=count)(calculate_phase(hologram))
        image = propagate_beam(shown, None, 0.03, PITCH, WAVELENGTH).abs().square()
        image = image * (image * target).sum() / (image**2).sum()
        yield f"{count} bits per pixel", colored(image, "gray", 1.0)


def convergence():
    """Yield the reconstruction after a growing number of iterations, from a random start."""
    target = photograph()
    for count in (1, 2, 3, 5, 8, 12, 20, 30, 50, 80):
        _, field = stochastic_gradient_descent(
            target, WAVELENGTH, 0.03, PITCH, n_iteration=count, learning_rate=0.2, scale=True, seed=0, progress=False
        )
        image = field.abs().square()
        image = image * (image * target).sum() / (image**2).sum()
        yield f"{count} iterations", colored(image, "gray", 1.0)


def focal_sweep():
    """Yield what a hologram of three digits shows from the first plane to the last."""
    font, targets = ImageFont.load_default(140), []
    for text in "123":
        picture = Image.new("L", (256, 256))
        ImageDraw.Draw(picture).text((128, 128), text, 255, font, anchor="mm")
        targets.append(torch.from_numpy(np.array(picture, dtype=np.float32) / 255))
    optimizer = multiplane_hologram_optimizer(
        515e-9, 10e-3, 3e-3, PITCH, [256, 256], torch.stack(targets), number_of_planes=3, number_of_iterations=60,
        learning_rate=0.1, seed=0, progress=False, propagator_type="forward",
    )
    phase, amplitude, _ = optimizer.optimize()
    field = torch.polar(amplitude, phase).to(torch.complex64)
    for z in np.linspace(4e-3, 17e-3, 27):
        image = propagate_beam(field, None, float(z), PITCH, 515e-9).abs().square()
        yield f"{1e3 * z:.1f} mm", colored(image[44:212, 16:240], "gray", 1.2)


def through_focus():
    """Yield the spots of a triplet while the image plane moves through the focus."""
    lens = load_system("cooke_triplet")
    shifts = np.linspace(-0.5, 0.5, 21)
    with torch.no_grad():
        surface = lens.surfaces[-1]
        start = float(surface.thickness)
        for shift in shifts:
            surface.thickness = torch.as_tensor(start + shift, dtype=torch.float64)
            spots = spot_diagram(lens, "rings", 10, reference="chief")
            canvas = Image.new("RGB", (480, 200), "white")
            draw = ImageDraw.Draw(canvas)
            for field in range(3):
                middle = 80 + 160 * field
                for wave, color in enumerate(("#3b6fd4", "#2a9d5c", "#d1495b")):
                    points = zip(spots.x[wave, field].tolist(), spots.y[wave, field].tolist(), strict=True)
                    for x, y in points:
                        place = (middle + 700 * x, 100 - 700 * y)
                        draw.ellipse([place[0] - 1.5, place[1] - 1.5, place[0] + 1.5, place[1] + 1.5], fill=color)
            yield f"{1e3 * shift:+.0f} µm from the focus", canvas
        surface.thickness = torch.as_tensor(start, dtype=torch.float64)


def gaze():
    """Yield metamers for gazes along a line."""
    photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[None, :3, :384, :576].float()
    loss = MetamerMSELoss(real_image_width=0.5, real_viewing_distance=0.5)
    for x in np.linspace(0.1, 0.9, 9):
        image = loss.gen_metamer(photo, (float(x), 0.5)).clamp(0, 1)[0].permute(1, 2, 0).numpy()
        picture = Image.fromarray(np.round(255 * image).astype(np.uint8))
        place = (x * 576, 192)
        for arm in ((12, 0), (0, 12)):
            line = [place[0] - arm[0], place[1] - arm[1], place[0] + arm[0], place[1] + arm[1]]
            ImageDraw.Draw(picture).line(line, fill="white", width=3)
        yield f"gaze at {100 * x:.0f} % of the width", picture


FIGURES = {f.__name__: f for f in (distance, bits, convergence, focal_sweep, through_focus, gaze)}


def main(names):
    """Compute the figures named, or all of them."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    path = FOLDER / "labels.json"
    labels = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for name in names or FIGURES:
        frames = list(FIGURES[name]())
        width = 480
        images = [image.resize((width, round(image.height * width / image.width)), Image.LANCZOS) for _, image in frames]
        sheet = Image.new("RGB", (width, sum(image.height for image in images)))
        for index, image in enumerate(images):
            sheet.paste(image, (0, index * image.height))
        sheet.save(FOLDER / f"{name}.webp", quality=60, method=6)
        labels[name] = {"height": images[0].height, "labels": [label for label, _ in frames]}
        print(name, len(frames), flush=True)
        path.write_text(json.dumps(labels, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
