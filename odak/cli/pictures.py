"""The pictures of a run: the reconstruction, and target, reconstruction and pattern side by side."""

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

PANEL_WIDTH = 960
MARGIN = 12
CAPTION_HEIGHT = 40
INK, PAPER = (20, 20, 20), (255, 255, 255)


def to_image(values: torch.Tensor) -> Image.Image:
    """Return intensities as an 8-bit picture.

    Parameters
    ----------
    values : torch.Tensor
        ``[1 or 3, rows, columns]``; 0 is black, 1 and above white.

    Returns
    -------
    PIL.Image.Image
        Grey or RGB.
    """
    levels = torch.round(values.detach().cpu().clamp(0, 1) * 255).to(torch.uint8).numpy()
    return Image.fromarray(levels[0] if len(levels) == 1 else np.ascontiguousarray(np.moveaxis(levels, 0, -1)))


def side_by_side(panels: list[tuple[str, torch.Tensor]]) -> Image.Image:
    """Return captioned panels in a row, none wider than 960 pixels; see :func:`grid`."""
    return grid([panels])


def grid(rows: list[list[tuple[str, torch.Tensor]]]) -> Image.Image:
    """Return captioned panels in rows, none wider than 960 pixels.

    Parameters
    ----------
    rows : list of list of tuple
        Caption and intensities ``[1 or 3, rows, columns]`` of each panel, all of one size.

    Returns
    -------
    PIL.Image.Image
        RGB.
    """
    images = [[_shrink(to_image(values).convert("RGB")) for _, values in row] for row in rows]
    width, height = images[0][0].size
    # Narrow panels leave room for their captions all the same.
    cell, line = max(width, 240), height + CAPTION_HEIGHT + MARGIN
    sheet = Image.new("RGB", (len(images[0]) * (cell + MARGIN) + MARGIN, len(images) * line + MARGIN), PAPER)
    draw = ImageDraw.Draw(sheet)
    font = _font_for(draw, [caption for row in rows for caption, _ in row], cell)
    for above, (row, pasted) in enumerate(zip(rows, images, strict=True)):
        for index, ((caption, _), image) in enumerate(zip(row, pasted, strict=True)):
            left, top = MARGIN + index * (cell + MARGIN), MARGIN + above * line
            draw.text((left, top), caption, fill=INK, font=font)
            sheet.paste(image, (left, top + CAPTION_HEIGHT))
    return sheet


def _shrink(image: Image.Image) -> Image.Image:
    if image.width <= PANEL_WIDTH:
        return image
    height = max(1, round(image.height * PANEL_WIDTH / image.width))
    return image.resize((PANEL_WIDTH, height), Image.Resampling.LANCZOS)


def _font_for(draw: ImageDraw.ImageDraw, captions: list[str], width: int):
    """Return the largest font of a few in which every caption fits."""
    for size in (24, 18, 14, 11):
        font = ImageFont.load_default(size)
        if all(draw.textlength(caption, font=font) <= width for caption in captions):
            break
    return font
