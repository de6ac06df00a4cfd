"""Computes the figures of the site that can be explored: frames behind a slider, and figures of plotly.

    PYTHONPATH=. python docs/make_frames.py [name …]

A figure with a slider is one WebP file with its frames below one another, and the labels of the slider in labels.json.
A figure of plotly is its JSON, which the page draws with the plotly.js of the site.
"""

import json
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from odak.catalog import abbe_number, material_names, refractive_index
from odak.learn.perception import MetamerMSELoss, color_matching_functions, linear_rgb_to_rgb, xyz_to_linear_rgb
from odak.learn.raytracing.system import load_system, retinal_image, spot_diagram, wavefront
from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, optimise, propagate_beam, propagate_to_window
from odak.visualize.plotly import field_show, plotshow, surfaceshow, system_show

FOLDER = Path(__file__).resolve().parent / "pictures" / "interactive"
WAVELENGTH, PITCH = 532e-9, 8e-6
# Largest size of a file, for short loading times on phones.
LARGEST = 300_000


def colored(values, name="magma", top=None):
    """Return an array 0 … top as a picture in the colours of a map."""
    values = np.asarray(values, dtype=float) / (top or np.max(values))
    return Image.fromarray(np.round(255 * colormaps[name](np.clip(values, 0, 1))[..., :3]).astype(np.uint8))


def photograph(rows=240, columns=320):
    """Return the middle of the photograph in grey."""
    photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[:3].mean(0).float()
    return torch.nn.functional.interpolate(photo[None, None, :, 33:566], (rows, columns), mode="area")[0, 0]


def chart(rows, columns):
    """Return the resolution chart."""
    whole = load_image(files("odak") / "assets" / "chart.png").float()
    return torch.nn.functional.interpolate(whole[None, None], (rows, columns), mode="area")[0, 0]


def distance():
    """Yield the field behind a square aperture over distance."""
    field = torch.zeros(320, 320, dtype=torch.complex128)
    field[110:210, 110:210] = 1
    for z in np.geomspace(2e-3, 1.0, 30):
        image = propagate_to_window(field, WAVELENGTH, float(z), PITCH).abs()
        yield f"{100 * z:.3g} cm", colored(image[40:280], top=float(image.max()))


def smooth_hologram(target):
    """Return the phase of a hologram of an image 3 cm away, from a start without speckle."""
    display = Display(Modulator(target.shape, PITCH), WAVELENGTH, 0.03)
    return optimise(display, target, run=Run(40, progress=False)).phases[0]


def wavelength():
    """Yield what a hologram for 532 nm shows in the other colours, at its distance."""
    phase = smooth_hologram(chart(216, 384))
    for nm in range(450, 651, 8):
        # The liquid crystal delays all colours by the same path: its phase is in inverse proportion to the wavelength.
        field = torch.polar(torch.ones_like(phase), phase % (2 * torch.pi) * 532 / nm)
        image = propagate_beam(field, None, 0.03, PITCH, nm * 1e-9).abs().square().double()
        color = xyz_to_linear_rgb(color_matching_functions([float(nm)]).reshape(1, 3, 1, 1))[0, :, 0, 0].clamp(0)
        color = color.double() / color.max()
        linear = color[:, None, None] * (image / image.quantile(0.995)).clamp(0, 1)
        yield f"{nm} nm", Image.fromarray(np.round(255 * linear_rgb_to_rgb(linear[None])[0].permute(1, 2, 0).numpy()).astype(np.uint8))


def aperture():
    """Yield the image of a chart on the retina, half a dioptre out of focus, over the diameter of the pupil."""
    target = chart(270, 480).double().expand(3, -1, -1)
    for diameter in (0.5, 0.7, 1.0, 1.4, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0):
        image = retinal_image(target, 0.5, np.deg2rad(0.8 / 60), [610e-9, 550e-9, 465e-9], diameter, 1.0)
        picture = image.clamp(0, 1).permute(1, 2, 0).numpy() ** (1 / 2.2)
        yield f"pupil of {diameter:.1f} mm", Image.fromarray(np.round(255 * picture).astype(np.uint8))


def bits():
    """Yield reconstructions of modulators of one to eight bits."""
    target = photograph()
    for count in range(1, 9):
        display = Display(Modulator(target.shape, PITCH, count), WAVELENGTH, 0.03)
        image = optimise(display, target, run=Run(60, progress=False)).images[0, 0]
        yield f"{count} bit{'s' * (count > 1)} per pixel", colored(image, "gray", 1.0)


def convergence():
    """Yield the reconstruction after a growing number of iterations, from a random start."""
    target = photograph()
    display = Display(Modulator(target.shape, PITCH), WAVELENGTH, 0.03)
    for count in (1, 2, 3, 5, 8, 12, 20, 30, 50, 80):
        image = optimise(display, target, start="random", run=Run(count, progress=False)).images[0, 0]
        yield f"{count} iteration{'s' * (count > 1)}", colored(image, "gray", 1.0)


def focal_sweep():
    """Yield what a hologram of three digits shows from the first plane to the last."""
    font, targets = ImageFont.load_default(140), []
    for text in "123":
        picture = Image.new("L", (256, 256))
        ImageDraw.Draw(picture).text((128, 128), text, 255, font, anchor="mm")
        targets.append(torch.from_numpy(np.array(picture, dtype=np.float32) / 255))
    panel = Modulator((256, 256), PITCH)
    planes = Display(panel, 515e-9, [7e-3, 10e-3, 13e-3])
    hologram = optimise(planes, torch.stack(targets)[:, None], run=Run(60, progress=False))
    for z in np.linspace(4e-3, 17e-3, 27):
        image = Display(panel, 515e-9, float(z))(hologram.phases)[0, 0] * hologram.brightness
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


def lens():
    """Return the Cooke triplet in space, with the rays of its fields."""
    return system_show(load_system("cooke_triplet"), show=False)


def glasses():
    """Return the glass map, with the name of each material."""
    points = {}
    for name in material_names():
        try:
            points[name] = (abbe_number(name), refractive_index(name, 587.5618e-9))
        except ValueError:  # materials that are not transparent at the F, d and C lines
            continue
    points = {name: point for name, point in points.items() if 15 < point[0] < 100 and 1.4 < point[1] < 2.1}
    picture = plotshow(subplot_titles=[""], labels=["Abbe number", "refractive index at 587.6 nm"])
    numbers, indices = zip(*points.values(), strict=True)
    picture.add_plot(numbers, indices, mode="markers", label="materials")
    template = "%{text}<br>index %{y:.4f}<br>Abbe number %{x:.1f}<extra></extra>"
    picture.fig.data[0].update(text=list(points), hovertemplate=template, marker_size=5, showlegend=False)
    picture.fig.update_xaxes(autorange="reversed")
    return picture


def field():
    """Return the amplitude of the field behind a square aperture."""
    square = torch.zeros(160, 160, dtype=torch.complex128)
    square[55:105, 55:105] = 1
    behind = propagate_to_window(square, WAVELENGTH, 25e-3, PITCH)
    picture = field_show(behind, PITCH, WAVELENGTH, quantities=["amplitude"], title="", size=360, show=False)
    picture.settings["margin"] = [60, 20, 60, 30]
    return picture


def surface():
    """Return the wavefront of the Cooke triplet at the edge of its field."""
    radius, angle = torch.meshgrid(
        torch.linspace(0, 1, 25, dtype=torch.float64), torch.linspace(0, 2 * torch.pi, 73, dtype=torch.float64), indexing="ij"
    )
    x, y = radius * angle.cos(), radius * angle.sin()
    error = wavefront(load_system("cooke_triplet"), torch.stack((x, y), -1).reshape(-1, 2))
    picture = surfaceshow(title="", labels=["pupil x", "pupil y", "path difference (waves)"], camera=[1.5, -1.7, 1.0])
    picture.add_surface(x, y, error.path[1, 2].reshape(x.shape).detach(), contour=True)
    return picture


FRAMES = {f.__name__: f for f in (distance, wavelength, aperture, bits, convergence, focal_sweep, through_focus, gaze)}
FIGURES = {f.__name__: f for f in (lens, glasses, field, surface)}


def store_frames(name):
    """Store the frames of a figure as one picture, in the best quality that is small enough."""
    frames = list(FRAMES[name]())
    for width, quality in ((480, 60), (480, 45), (400, 45), (360, 35), (320, 30), (320, 20)):
        images = [image.resize((width, round(image.height * width / image.width)), Image.LANCZOS) for _, image in frames]
        sheet = Image.new("RGB", (width, sum(image.height for image in images)))
        for index, image in enumerate(images):
            sheet.paste(image, (0, index * image.height))
        sheet.save(FOLDER / f"{name}.webp", quality=quality, method=6)
        if (FOLDER / f"{name}.webp").stat().st_size <= LARGEST:
            break
    path = FOLDER / "labels.json"
    labels = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    labels[name] = {"width": width, "height": images[0].height, "labels": [label for label, _ in frames]}
    path.write_text(json.dumps(labels, indent=1, ensure_ascii=False, sort_keys=True) + "\n", encoding="utf-8")


def store_figure(name):
    """Store a figure of plotly: its arrays in single precision, without the size of the page that it is not made for."""
    picture = FIGURES[name]()
    picture.update_layout()
    figure = picture.fig
    for trace in figure.data:
        for key, values in trace.to_plotly_json().items():
            if isinstance(values, np.ndarray) and values.dtype.kind in "fiu":
                trace[key] = values.astype(np.float32 if values.dtype.kind == "f" else np.int32)
    figure.update_layout(width=None, height=None)
    (FOLDER / f"{name}.json").write_text(figure.to_json(), encoding="utf-8")


def main(names):
    """Compute the figures named, or all of them."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name in names or [*FRAMES, *FIGURES]:
        (store_frames if name in FRAMES else store_figure)(name)
        print(name, [path.stat().st_size for path in FOLDER.glob(f"{name}.*")], flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
