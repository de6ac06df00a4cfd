"""Colour of 16 bits per channel, which Pillow holds in 8: read in two halves, written as PNG.

Pillow unpacks such a file into 8-bit channels, and its raw mode says which byte of each sample it takes. Decoding
twice, once for each byte, keeps them both, with Pillow's own decoders, limits and checks of a hostile file.
"""

import struct
import sys
import zlib
from typing import Any, BinaryIO

import numpy as np
from PIL import Image

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_HALVES = {"RGB": ("RGB;16B", "RGB;16L"), "RGBA": ("RGBA;16B", "RGBA;16L")}
_BITS_PER_SAMPLE = 258


def is_deep(image: Any) -> bool:
    """Say whether a picture just opened has channels of more than 8 bits that Pillow would cut.

    Parameters
    ----------
    image : PIL.Image.Image
        Opened, not yet loaded.

    Returns
    -------
    bool
        True for colour, or grey with alpha, of 16 bits.

    Raises
    ------
    ValueError
        If there are more than 8 bits in a layout that cannot be read without losing some.
    """
    if image.mode not in ("RGB", "RGBA", "LA", "CMYK") or not image.tile:
        return False
    raw = _raw_mode(image)
    if raw.split(";")[0] in ("RGB", "RGBA", "LA") and ";16" in raw:
        return True
    bits = image.tag_v2.get(_BITS_PER_SAMPLE, (8,)) if image.format == "TIFF" else (8,)
    ppm_white = image.tile[0][3][1] if image.format == "PPM" and isinstance(image.tile[0][3], tuple) else 255
    if max(bits) > 8 or (isinstance(ppm_white, int) and ppm_white > 255):
        raise ValueError(f"its colour has more than 8 bits in a layout that cannot be read whole ({raw}); use PNG")
    return False


def read(image: Image.Image, again: Image.Image) -> np.ndarray:
    """Return the samples of a 16-bit colour picture.

    Parameters
    ----------
    image, again : PIL.Image.Image
        The same file opened twice, neither loaded; :func:`is_deep` holds.

    Returns
    -------
    numpy.ndarray
        uint16 ``[H, W, 3]`` or ``[H, W, 4]``; grey with alpha has its grey repeated.
    """
    raw = _raw_mode(image)
    if raw.startswith("LA"):
        # Grey and alpha of two bytes each are as long as four channels of one byte.
        samples = _decode(image, "RGBA").astype(np.uint16)
        grey, alpha = samples[..., 0] << 8 | samples[..., 1], samples[..., 2] << 8 | samples[..., 3]
        return np.stack([grey, grey, grey, alpha], axis=-1)
    first, second = (
        _decode(half, mode).astype(np.uint16) for half, mode in zip((image, again), _HALVES[image.mode], strict=True)
    )
    little = raw.endswith("L") or (raw.endswith("N") and sys.byteorder == "little")
    return second << 8 | first if little else first << 8 | second


def write_png(stream: BinaryIO, levels: np.ndarray) -> None:
    """Write 16-bit colour as PNG.

    Parameters
    ----------
    stream : file object
        Binary, open for writing.
    levels : numpy.ndarray
        uint16 ``[H, W, 3]`` or ``[H, W, 4]``.
    """
    height, width, channels = levels.shape
    rows = np.zeros((height, 1 + 2 * channels * width), np.uint8)
    rows[:, 1:] = levels.astype(">u2").reshape(height, -1).view(np.uint8)
    header = struct.pack(">IIBBBBB", width, height, 16, _COLOUR_TYPES[channels], 0, 0, 0)
    stream.write(_SIGNATURE)
    for kind, content in ((b"IHDR", header), (b"IDAT", zlib.compress(rows.data)), (b"IEND", b"")):
        stream.write(struct.pack(">I", len(content)) + kind + content)
        stream.write(struct.pack(">I", zlib.crc32(kind + content)))


def _raw_mode(image):
    arguments = image.tile[0][3]
    raw = arguments[0] if isinstance(arguments, tuple) else arguments
    return raw if isinstance(raw, str) else ""


def _decode(image, raw):
    image.tile = [(*tile[:3], (raw, *tile[3][1:]) if isinstance(tile[3], tuple) else raw) for tile in image.tile]
    return np.asarray(image)
