"""Pictures of a run: reconstructions, and captioned panels with scales for comparison."""

import functools
import textwrap
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

PANEL_WIDTH = 960
NARROWEST = 300
MARGIN, GAP = 16, 8
SIZES = (24, 20, 16, 13)
LINES = 2
BAR_HEIGHT = 12
INK, PAPER, OUTLINE = (20, 20, 20), (255, 255, 255), (200, 200, 200)
# Red, green and blue at equal steps of phase: plotly's cyclic scale "Twilight", whose ends are the same colour.
PHASE_COLOURS = (
    (226, 217, 226), (166, 191, 202), (109, 144, 192), (95, 88, 176), (80, 20, 66),
    (101, 21, 58), (156, 64, 67), (187, 117, 93), (209, 172, 149), (226, 217, 226),
)  # fmt: skip
# Blue for too dark, red for too bright (the ends and quarters of ColorBrewer's scale "RdBu").
DIFFERENCE_COLOURS = ((5, 48, 97), (67, 147, 195), (247, 247, 247), (214, 96, 77), (103, 0, 31))


class Panel(NamedTuple):
    """A picture with its caption and the scale below it.

    Attributes
    ----------
    caption : str
        One or two lines of text above it.
    image : PIL.Image.Image
        RGB.
    scale : tuple, optional
        Colours of a bar, and the labels at its left end, middle and right end.
    """

    caption: str
    image: Image.Image
    scale: tuple[tuple, tuple[str, str, str]] | None = None


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


def picture_panel(caption: str, values: torch.Tensor) -> Panel:
    """Return a panel of intensities ``[1 or 3, rows, columns]``."""
    return Panel(caption, _shrunk(to_image(values).convert("RGB"), Image.Resampling.LANCZOS))


def phase_panel(caption: str, phase: torch.Tensor) -> Panel:
    """Return a panel of phases ``[rows, columns]`` in radians, in a cyclic scale."""
    turns = torch.remainder(phase.detach().cpu().double() / (2 * torch.pi), 1).numpy()
    # Neighbouring phases are not averaged: the mean of 0 and 2π would be π.
    image = _shrunk(Image.fromarray(_coloured(turns, PHASE_COLOURS)), Image.Resampling.NEAREST)
    return Panel(caption, image, (PHASE_COLOURS, ("0", "pi", "2 pi rad")))


def difference_panel(caption: str, difference: torch.Tensor) -> Panel:
    """Return a panel of signed differences ``[channels, rows, columns]``, averaged over channels."""
    values = difference.detach().cpu().double().mean(0)
    limit = max(float(torch.quantile(values.abs().flatten()[:: max(1, values.numel() // 10**6)], 0.995)), 1e-6)
    image = Image.fromarray(_coloured((values / (2 * limit) + 0.5).clamp(0, 1).numpy(), DIFFERENCE_COLOURS))
    labels = (f"{-limit:.2g}, too dark", "0", f"{limit:.2g}, too bright")
    return Panel(caption, _shrunk(image, Image.Resampling.LANCZOS), (DIFFERENCE_COLOURS, labels))


def sheet(rows: list[list[Panel]], width_in_metres: float | None = None, aspect: float = 1.0) -> Image.Image:
    """Return captioned panels in rows.

    Parameters
    ----------
    rows : list of list of Panel
        All pictures of one size.
    width_in_metres : float, optional
        Physical width of the pictures, for a bar of length below the first one.
    aspect : float
        Height of a sample over its width.

    Returns
    -------
    PIL.Image.Image
        RGB. Captions are set in the largest size, and broken into lines, such that none leaves its panel.
    """
    # Small pictures are enlarged by a whole factor, such that all samples are of one size.
    factor = max(1, NARROWEST // rows[0][0].image.width)
    width, height = (
        round(factor * side * max(1.0, stretch))
        for side, stretch in zip(rows[0][0].image.size, (1 / aspect, aspect), strict=True)
    )
    panels = [panel for row in rows for panel in row]
    cell = max(width, NARROWEST)
    font, line = _typeset([panel.caption for panel in panels], cell)
    small = ImageFont.load_default(max(11, min(18, cell // 28)))
    below = GAP + BAR_HEIGHT + 4 + _height(small) + GAP
    columns = max(map(len, rows))
    lines = [max(_broken(panel.caption, font, cell).count("\n") + 1 for panel in row) for row in rows]
    aboves = [count * line + GAP for count in lines]
    size = columns * (cell + MARGIN) + MARGIN, sum(aboves) + len(rows) * (height + below + MARGIN) + MARGIN
    paper = Image.new("RGB", size, PAPER)
    draw = ImageDraw.Draw(paper)
    top = MARGIN
    for row, above in zip(rows, aboves, strict=True):
        for along, panel in enumerate(row):
            left = MARGIN + along * (cell + MARGIN)
            draw.multiline_text((left, top), _broken(panel.caption, font, cell), fill=INK, font=font, spacing=4)
            draw.rectangle((left - 1, top + above - 1, left + width, top + above + height), outline=OUTLINE)
            paper.paste(panel.image.resize((width, height), Image.Resampling.NEAREST), (left, top + above))
            bottom = top + above + height + GAP
            if panel.scale is not None:
                _draw_scale(paper, (left, bottom), max(width, NARROWEST), *panel.scale, small)
            elif width_in_metres is not None and panel is rows[0][0]:
                _draw_length(draw, (left, bottom), width, width_in_metres, small)
        top += above + height + below + MARGIN
    return paper


def _draw_scale(paper: Image.Image, place: tuple[int, int], width: int, colours: tuple, labels, font) -> None:
    bar = _coloured(np.tile(np.linspace(0, 1, width), (BAR_HEIGHT, 1)), colours)
    paper.paste(Image.fromarray(bar), place)
    draw = ImageDraw.Draw(paper)
    draw.rectangle((place[0], place[1], place[0] + width - 1, place[1] + BAR_HEIGHT - 1), outline=INK)
    for share, label in zip((0, 0.5, 1), labels, strict=True):
        left = place[0] + share * (width - draw.textlength(label, font=font))
        draw.text((left, place[1] + BAR_HEIGHT + 2), label, fill=INK, font=font)


def _draw_length(draw: ImageDraw.ImageDraw, place: tuple[int, int], width: int, metres: float, font) -> None:
    """Draw a bar whose length is 1, 2 or 5 times a power of ten, about a quarter of the picture."""
    power = 10.0 ** np.floor(np.log10(metres / 4))
    length = max(factor * power for factor in (1, 2, 5) if factor * power <= metres / 4 * 1.000001)
    unit, factor = next(((u, f) for u, f in (("m", 1.0), ("mm", 1e-3)) if length >= f / 10), ("um", 1e-6))
    right = place[0] + round(width * length / metres)
    draw.rectangle((place[0], place[1] + 2, right, place[1] + 6), fill=INK)
    draw.text((place[0], place[1] + BAR_HEIGHT + 2), f"{length / factor:g} {unit}", fill=INK, font=font)


def _coloured(shares: np.ndarray, colours: tuple) -> np.ndarray:
    """Return 8-bit colours of numbers from 0 to 1, interpolated between equally spaced ones."""
    table = _table(colours)
    return table[np.clip(np.round(shares * (len(table) - 1)), 0, len(table) - 1).astype(int)]


@functools.cache
def _table(colours: tuple) -> np.ndarray:
    places, given = np.linspace(0, 1, 1024), np.linspace(0, 1, len(colours))
    return np.stack([np.interp(places, given, channel) for channel in np.transpose(colours)], -1).round().astype("u1")


def _shrunk(image: Image.Image, resampling) -> Image.Image:
    if image.width <= PANEL_WIDTH:
        return image
    height = max(1, round(image.height * PANEL_WIDTH / image.width))
    return image.resize((PANEL_WIDTH, height), resampling)


def _typeset(captions: list[str], width: int):
    """Return the largest font of a few in which every caption fits on two lines, and the height of a line."""
    for size in SIZES:
        font = ImageFont.load_default(size)
        if all(_broken(caption, font, width).count("\n") < LINES for caption in captions):
            break
    # Pillow's own font has no µ and no π; captions and labels do without.
    return font, _height(font) + 4


def _broken(caption: str, font, width: int) -> str:
    """Return a caption with line breaks such that each line fits the width, also where a word alone does not."""
    count = len(caption)
    while True:
        lines = textwrap.wrap(caption, max(count, 1), break_long_words=count < 12)
        if count <= 4 or all(font.getlength(line) <= width for line in lines):
            return "\n".join(lines)
        count -= 1


def _height(font) -> int:
    top, bottom = font.getbbox("Ågq")[1], font.getbbox("Ågq")[3]
    return round(bottom - min(top, 0))
