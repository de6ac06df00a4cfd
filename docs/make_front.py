"""Draws the pictures of the front page and of the README: a hologram, its reconstruction, a lens with rays, a metamer.

    PYTHONPATH=. python docs/make_front.py

The lens is the render of docs/gallery/blender/triplet.py.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont, ImageOps

from odak.learn.perception import MetamerMSELoss
from odak.learn.tools import load_image
from odak.learn.wave import Display, Modulator, Run, light_of, optimise

DOCS = Path(__file__).resolve().parent
FRONT = DOCS / "pictures" / "front"
SIZE = (640, 480)
LARGEST = 150_000  # bytes of a file, for short loading times
CAPTIONS = {
    "hologram": "a phase-only hologram",
    "reconstruction": "its image, 5 cm away",
    "lens": "a lens, and rays through it",
    "metamer": "a metamer, sharp where one looks",
}


def pictures() -> dict[str, Image.Image]:
    """Return the pictures by name."""
    scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)[:3].float()
    picture = torch.nn.functional.interpolate(scene[None], (540, 960), mode="area")[0, :, 70:520, 200:800]
    display = Display(Modulator((450, 600), 8e-6), 532e-9, 0.05)
    hologram = optimise(display, light_of(picture, display).targets, run=Run(60, progress=False))
    phase = hologram.phases[0] / (2 * torch.pi)
    green = hologram.pictures(0)[0].numpy()[..., None] * np.array([0.35, 1.0, 0.45])
    photo = load_image(files("odak") / "assets" / "photo.png", torch_style=True)[None, :3, :384, :512].float()
    loss = MetamerMSELoss(real_image_width=0.5, real_viewing_distance=0.5)
    metamer = loss.gen_metamer(photo, (0.54, 0.55)).clamp(0, 1)[0].permute(1, 2, 0).numpy()
    lens = Image.open(DOCS / "pictures" / "gallery" / "blender" / "triplet_1.webp")
    side = round(lens.height * SIZE[0] / SIZE[1])
    return {
        "hologram": _image(colormaps["twilight"](phase.numpy())[60:390, 80:520, :3]),
        "reconstruction": _image(green[:, :600]),
        # The elements and what enters and leaves them, without the ends of the rays.
        "lens": lens.crop((lens.width - side, 0, lens.width, lens.height)),
        "metamer": _image(metamer),
    }


def _image(values):
    return Image.fromarray(np.round(255 * values).astype(np.uint8))


def _filled(image):
    """Return the middle of an image in the size and shape of all."""
    scale = max(SIZE[0] / image.width, SIZE[1] / image.height)
    image = image.resize((round(image.width * scale), round(image.height * scale)), Image.LANCZOS)
    left, top = (image.width - SIZE[0]) // 2, (image.height - SIZE[1]) // 2
    return image.crop((left, top, left + SIZE[0], top + SIZE[1]))


def card(drawn):
    """Return the pictures two by two, in the size that chats and search engines show."""
    gap, (width, height) = 12, (1200, 630)
    size = ((width - gap) // 2, (height - gap) // 2)
    whole = Image.new("RGB", (width, height), "white")
    for k, image in enumerate(drawn.values()):
        place = ((k % 2) * (size[0] + gap), (k // 2) * (size[1] + gap))
        whole.paste(ImageOps.fit(image, size, Image.LANCZOS), place)
    return whole


def _save(image, path):
    """Save a picture in the best quality that is small enough."""
    for quality in range(85, 40, -4):
        image.save(path, quality=quality, method=6)
        if path.stat().st_size <= LARGEST:
            break


def main() -> None:
    """Write the pictures, and the four of them side by side for the README."""
    FRONT.mkdir(parents=True, exist_ok=True)
    drawn = {name: _filled(image.convert("RGB")) for name, image in pictures().items()}
    gap, line = 12, 44
    banner = Image.new("RGB", (4 * SIZE[0] + 3 * gap, SIZE[1] + line), "white")
    font = ImageFont.load_default(28)
    for column, (name, image) in enumerate(drawn.items()):
        _save(image, FRONT / f"{name}.webp")
        left = column * (SIZE[0] + gap)
        banner.paste(image, (left, 0))
        place = (left + SIZE[0] // 2, SIZE[1] + line // 2)
        ImageDraw.Draw(banner).text(place, CAPTIONS[name], "#333333", font, anchor="mm")
    _save(banner.resize((banner.width * 5 // 8, banner.height * 5 // 8), Image.LANCZOS), FRONT / "banner.webp")
    card(drawn).save(FRONT / "card.jpg", quality=85)


if __name__ == "__main__":
    main()
