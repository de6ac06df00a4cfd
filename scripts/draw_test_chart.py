"""Draw odak/assets/chart.png: three-bar groups in the manner of USAF 1951, a grey wedge and a Siemens star.

Run ``python scripts/draw_test_chart.py [FILE]``. Edges carry the exact area that they cover of each pixel, and the
digits are drawn here rather than taken from a font, so that the chart is the same wherever it is drawn.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from PIL import Image

SHAPE = (1080, 1920)
FIRST_BAR = 32.0
GROUPS = ((90.0, 110.0), (90.0, 570.0), (640.0, 570.0), (640.0, 730.0), (860.0, 730.0), (860.0, 800.0))
ELEMENTS = 6
STAR_CENTRE, STAR_RADIUS, STAR_SPOKES = (430.0, 1430.0), 350.0, 36
WEDGE_STEPS, WEDGE_CORNER, WEDGE_SIZE = 16, (870.0, 920.0), (130.0, 928.0)
TARGET = Path(__file__).resolve().parents[1] / "odak" / "assets" / "chart.png"
DIGITS = {
    "0": "111101101101111",
    "1": "010110010010111",
    "2": "111001111100111",
    "3": "111001111001111",
    "4": "101101111001001",
    "5": "111100111001111",
    "6": "111100111101111",
}


def bar_width(group: int, element: int) -> float:
    """Return the width in pixels of the bars of an element.

    Parameters
    ----------
    group : int
        Group number, from 0; bars halve from one group to the next.
    element : int
        Element number in the group, 1 to 6; bars shrink by 2^(1/6) from one to the next.

    Returns
    -------
    float
        Bar width, which is also the width of the gaps; bars are five times as long.
    """
    return FIRST_BAR * 2.0 ** -(group + (element - 1) / ELEMENTS)


def _coverage(start: float, stop: float) -> tuple[slice, np.ndarray]:
    """Return the unit pixels between `start` and `stop`, and the share of each that lies there."""
    first, last = math.floor(start), math.ceil(stop)
    edges = np.arange(first, last)
    return slice(first, last), np.minimum(edges + 1, stop) - np.maximum(edges, start)


def _fill(canvas: np.ndarray, top: float, left: float, height: float, width: float, value: float = 1.0) -> None:
    rows, vertical = _coverage(top, top + height)
    columns, horizontal = _coverage(left, left + width)
    canvas[rows, columns] += value * np.outer(vertical, horizontal)


def _draw_digit(canvas: np.ndarray, digit: str, top: float, left: float, cell: float) -> None:
    for index, bit in enumerate(DIGITS[digit]):
        if bit == "1":
            _fill(canvas, top + index // 3 * cell, left + index % 3 * cell, cell, cell)


def _draw_element(canvas: np.ndarray, top: float, left: float, width: float) -> None:
    """Draw three horizontal bars and, beside them, three vertical ones."""
    for bar in range(3):
        _fill(canvas, top + 2 * bar * width, left, width, 5 * width)
        _fill(canvas, top, left + (7 + 2 * bar) * width, 5 * width, width)


def _draw_group(canvas: np.ndarray, group: int, top: float, left: float) -> None:
    cell = max(2.0, round(bar_width(group, 1) / 6))
    _draw_digit(canvas, str(group), top - 8 * cell, left, cell)
    for element in range(1, ELEMENTS + 1):
        width = bar_width(group, element)
        _draw_digit(canvas, str(element), top + 2.5 * width - 2.5 * cell, left - 6 * cell, cell)
        _draw_element(canvas, top, left, width)
        top += 5 * width + max(1.6 * width, 6 * cell - 5 * width + 4, 8.0)


def _draw_star(canvas: np.ndarray) -> None:
    rows, columns = np.indices(canvas.shape)
    y, x = rows + 0.5 - STAR_CENTRE[0], columns + 0.5 - STAR_CENTRE[1]
    radius = np.hypot(x, y)
    turn = np.arctan2(y, x) * STAR_SPOKES / (2 * np.pi)
    # Distance to the nearest spoke edge in pixels, positive inside a bright spoke.
    edge = (0.25 - np.abs(turn - np.round(turn))) * 2 * np.pi * radius / STAR_SPOKES
    canvas += np.clip(edge + 0.5, 0, 1) * np.clip(STAR_RADIUS - radius + 0.5, 0, 1)


def _draw_wedge(canvas: np.ndarray) -> None:
    top, left = WEDGE_CORNER
    height, width = WEDGE_SIZE
    for step in range(WEDGE_STEPS):
        value = step / (WEDGE_STEPS - 1)
        _fill(canvas, top, left + step * width / WEDGE_STEPS, height, width / WEDGE_STEPS, value)


def draw_chart() -> np.ndarray:
    """Draw the chart.

    Returns
    -------
    numpy.ndarray
        uint8 ``[1080, 1920]``, bright marks on black.
    """
    canvas = np.zeros(SHAPE, dtype=np.float64)
    for group, (top, left) in enumerate(GROUPS):
        _draw_group(canvas, group, top, left)
    _draw_star(canvas)
    _draw_wedge(canvas)
    return np.round(255 * np.clip(canvas, 0, 1)).astype(np.uint8)


def main() -> None:
    """Write the chart to the file named on the command line, the shipped one by default."""
    parser = argparse.ArgumentParser(description="Draw the test chart that ships with odak.")
    parser.add_argument("file", nargs="?", type=Path, default=TARGET)
    Image.fromarray(draw_chart()).save(parser.parse_args().file, optimize=True)


if __name__ == "__main__":
    main()
