"""Draws the pictures of the front page and of the README: a hologram, its image, a light field, two lenses, a metamer.

    PYTHONPATH=. python docs/make_front.py

The lenses are the renders of docs/gallery/blender/triplet.py and pancake.py.
"""

from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont, ImageOps

from odak.learn.perception import MetamerMSELoss
from odak.learn.tools import load_image
from odak.learn.wave import DepthScene, Display, Eyes, Modulator, Run, light_of, optimise, picture_of

DOCS = Path(__file__).resolve().parent
FRONT = DOCS / "pictures" / "front"
SIZE = (640, 480)
LARGEST = 150_000  # bytes of a file, for short loading times
CAPTIONS = {
    "hologram": "a phase-only hologram",
    "reconstruction": "its image, 5 cm away",
    "light_field": "a hologram for eyes, seen by one",
    "lens": "a lens, and rays through it",
    "pancake": "a display, folded by polarisation",
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
    lens, pancake = (
        Image.open(DOCS / "pictures" / "gallery" / "blender" / f"{name}_1.webp") for name in ("triplet", "pancake")
    )
    side = round(lens.height * SIZE[0] / SIZE[1])
    return {
        "hologram": _image(colormaps["twilight"](phase.numpy())[60:390, 80:520, :3]),
        "reconstruction": _image(green[:, :600]),
        "light_field": _image(light_field().permute(1, 2, 0).numpy()),
        # The elements and what enters and leaves them, without the ends of the rays.
        "lens": lens.crop((lens.width - side, 0, lens.width, lens.height)),
        "pancake": pancake.crop((40, 0, 40 + side, pancake.height)),
        "metamer": _image(metamer),
    }


def light_field() -> torch.Tensor:
    """Return what an eye that is focused on the near blocks sees of holograms for five other eyes, in three colours."""
    scene = load_image(files("odak") / "assets" / "scene.png", torch_style=True)[:3, :, 240:1680].float()
    depth = load_image(files("odak") / "assets" / "scene_depth.png")[None, :, 240:1680].float()
    scene, depth = (torch.nn.functional.adaptive_avg_pool2d(part, (240, 320)) for part in (scene, depth))
    lasers, away, near, far = (638e-9, 520e-9, 450e-9), 0.1, 0.094, 0.108
    depth = near + (far - near) * (depth[0] - depth.min()) / (depth.max() - depth.min())
    eyes = Eyes.within(away, 1.2e-3, 5, diameter=(3e-3, 4e-3), focus=(near, far))
    looking = Eyes(away, [(0.0, 0.0)], 4e-3, focus=0.096)
    seen = []
    for seed, (light, laser) in enumerate(zip(light_of(scene, lasers).targets, lasers, strict=True)):
        display = Display(Modulator((240, 320), 8e-6), laser, eyes, frames=6)
        hologram = optimise(display, DepthScene(light, depth), run=Run(30, progress=False, seed=seed))
        image = display.looked_at(looking).judge(hologram.phases)[0][0, 0]
        wanted = DepthScene(light, depth).images(display.looked_at(looking))[0, 0]
        seen.append(image * (image * wanted).sum() / image.square().sum())
    return picture_of(torch.stack(seen), lasers)


def _image(values):
    return Image.fromarray(np.round(255 * values).astype(np.uint8))


def _filled(image):
    """Return the middle of an image in the size and shape of all."""
    scale = max(SIZE[0] / image.width, SIZE[1] / image.height)
    image = image.resize((round(image.width * scale), round(image.height * scale)), Image.LANCZOS)
    left, top = (image.width - SIZE[0]) // 2, (image.height - SIZE[1]) // 2
    return image.crop((left, top, left + SIZE[0], top + SIZE[1]))


def card(drawn):
    """Return the pictures three by two, in the size that chats and search engines show."""
    gap, (width, height) = 12, (1200, 630)
    size = ((width - 2 * gap) // 3, (height - gap) // 2)
    whole = Image.new("RGB", (width, height), "white")
    for k, image in enumerate(drawn.values()):
        place = ((k % 3) * (size[0] + gap), (k // 3) * (size[1] + gap))
        whole.paste(ImageOps.fit(image, size, Image.LANCZOS), place)
    return whole


def _save(image, path):
    """Save a picture in the best quality that is small enough."""
    for quality in range(85, 40, -4):
        image.save(path, quality=quality, method=6)
        if path.stat().st_size <= LARGEST:
            break


def main() -> None:
    """Write the pictures, and the six of them together for the README."""
    FRONT.mkdir(parents=True, exist_ok=True)
    drawn = {name: _filled(image.convert("RGB")) for name, image in pictures().items()}
    gap, line = 12, 44
    banner = Image.new("RGB", (3 * SIZE[0] + 2 * gap, 2 * (SIZE[1] + line)), "white")
    font = ImageFont.load_default(32)
    for k, (name, image) in enumerate(drawn.items()):
        _save(image, FRONT / f"{name}.webp")
        left, top = (k % 3) * (SIZE[0] + gap), (k // 3) * (SIZE[1] + line)
        banner.paste(image, (left, top))
        place = (left + SIZE[0] // 2, top + SIZE[1] + line // 2)
        ImageDraw.Draw(banner).text(place, CAPTIONS[name], "#333333", font, anchor="mm")
    _save(banner.resize((banner.width * 5 // 8, banner.height * 5 // 8), Image.LANCZOS), FRONT / "banner.webp")
    card(drawn).save(FRONT / "card.jpg", quality=85)


if __name__ == "__main__":
    main()
