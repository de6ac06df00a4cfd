"""Reading, writing and resizing of images of 8 and 16 bits per channel: grey, colour and alpha."""

import os
import struct
import sys
import warnings
import zlib
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np
from PIL import Image

from odak import _validate
from odak.tools.paths import extension_of, replacing, validate_path

# Where Pillow begins to warn.
MOST_PIXELS = 89_478_485
# Number of pixels that the header of any file may declare, and further pixels for each byte of the file. Only blank
# pages and malicious files exceed this.
FREE_PIXELS, PIXELS_PER_BYTE = 16 << 20, 10_000

_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".tiff": "TIFF", ".tif": "TIFF"}
_READABLE = (*_FORMATS, ".gif", ".webp", ".pbm", ".pgm", ".ppm", ".sr", ".ras")
# Formats are listed one by one, so that no file selects a decoder that runs programs (EPS) or reads other files.
_DECODERS = ("PNG", "JPEG", "BMP", "TIFF", "GIF", "WEBP", "PPM", "SUN")
_ENCODER_OPTIONS = {"JPEG": {"quality": 95, "subsampling": 0}}


def save_image(
    fn: str | os.PathLike, img: np.ndarray, cmin: float = 0, cmax: float = 255, color_depth: int = 8
) -> bool:
    """Write an image to a file, `cmin` as black and `cmax` as white.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.png``, ``.jpg``, ``.jpeg``, ``.bmp``, ``.tiff`` or ``.tif`` file; an older one stays as it was until the
        new one is complete.
    img : numpy.ndarray
        ``[H, W]``, ``[H, W, 1]``, ``[H, W, 3]`` (red, green, blue) or ``[H, W, 4]`` (with alpha), row 0 at the top;
        ``[H]`` is a single column. Values outside the limits are clipped, the others rounded to the nearest level;
        not-a-number is black.
    cmin : float
        Value of black.
    cmax : float
        Value of white.
    color_depth : {8, 16}
        Bits per channel; 16 in PNG, and for grey in TIFF.

    Returns
    -------
    bool
        True.

    Raises
    ------
    TypeError
        If the image does not hold real numbers.
    ValueError
        If the shape, the limits, the depth or the path is not acceptable, the format cannot hold such an image, the
        folder does not exist, or the encoder fails; the message names the file.
    PermissionError
        If the folder cannot be written to.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "grey.png")
    ...     saved = save_image(name, np.asarray([[0.0, 0.2, 1.0]]), cmin=0, cmax=1)
    ...     load_image(name).tolist()
    [[0.0, 51.0, 255.0]]
    """
    path = validate_path(fn, _FORMATS)
    levels = _levels(_checked(img), cmin, cmax, color_depth)
    encode = _encoder(path, levels)
    with replacing(path) as stream:
        try:
            encode(stream)
            stream.flush()
        except (OSError, ValueError, struct.error) as error:
            raise ValueError(f"Failed to save image {path!r}: {error}") from error
    return True


def load_image(fn: str | os.PathLike, normalizeby: float = 0.0, torch_style: bool = False) -> np.ndarray:
    """Read an image from a file.

    Parameters
    ----------
    fn : str or os.PathLike
        A ``.png``, ``.jpg``, ``.jpeg``, ``.bmp``, ``.tiff``, ``.tif``, ``.gif``, ``.webp``, ``.pbm``, ``.pgm``,
        ``.ppm``, ``.sr`` or ``.ras`` file.
    normalizeby : float
        Divide by this unless it is zero.
    torch_style : bool
        Put the channels first.

    Returns
    -------
    numpy.ndarray
        float64 ``[H, W]`` for grey, ``[H, W, 3]`` or ``[H, W, 4]`` for colour (channels first on request), row 0 at
        the top; 0 … 255, or 0 … 65535 for 16 bits.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the file is missing, broken, not an image, or has more than 89 megapixels, or
        more than 16 in less than a byte for each 10 000; the message names the file.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_image, save_image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "colour.png")
    ...     saved = save_image(name, np.full((2, 4, 3), 255))
    ...     image = load_image(name, normalizeby=255.0, torch_style=True)
    >>> image.shape, float(image.max())
    ((3, 2, 4), 1.0)
    """
    divisor = float(_validate.real("normalizeby", normalizeby))
    image = read_levels(fn, torch_style).astype(np.float64)
    if divisor != 0:
        image /= divisor
    return image


def read_levels(fn: str | os.PathLike, torch_style: bool = False) -> np.ndarray:
    """Read the levels of an image as they are stored in the file.

    Parameters
    ----------
    fn : str or os.PathLike
        File of a format that :func:`load_image` reads.
    torch_style : bool
        Put the channels first.

    Returns
    -------
    numpy.ndarray
        uint8 or uint16; int32 or float32 for a TIFF that holds them. ``[H, W]``, ``[H, W, 3]`` or ``[H, W, 4]``,
        channels first on request.

    Raises
    ------
    ValueError
        If the path is not acceptable, or the file is missing, broken, not an image or too large.
    """
    path, torch_style = validate_path(fn, _READABLE), _validate.flag("torch_style", torch_style)
    if not os.path.isfile(path):
        reason = "it is not a regular file" if os.path.exists(path) else "there is no such file"
        raise ValueError(f"Failed to load image {path!r}: {reason}")
    try:
        levels = _read(path)
    except Image.DecompressionBombError as error:
        raise ValueError(f"Failed to load image {path!r}: more than 89 megapixels are refused ({error})") from error
    except Exception as error:
        # On broken files Pillow's decoders raise errors of many types: OSError, SyntaxError, struct.error, KeyError, …
        raise ValueError(f"Failed to load image {path!r}: {error or type(error).__name__}") from error
    return np.ascontiguousarray(np.moveaxis(levels, -1, 0)) if torch_style and levels.ndim == 3 else levels


def white_level(levels: np.ndarray) -> float:
    """Return the value of white in an image as :func:`read_levels` gives it.

    Parameters
    ----------
    levels : numpy.ndarray
        Image.

    Returns
    -------
    float
        255 or 65535; 1 for floats.
    """
    return float(np.iinfo(levels.dtype).max) if levels.dtype.kind in "iu" else 1.0


def _read(path):
    with _open(path) as image:
        if image.format == "PNG":
            with _open(path) as checked:
                # Loading alone does not compare the checksums of the pixels.
                checked.verify()
        if _is_deep(image):
            with _open(path) as again:
                return _read_deep(image, again)
        return _shallow(image)


def _open(path):
    with warnings.catch_warnings():
        # Pillow warns from half of the size that is refused.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        image = Image.open(path, formats=_DECODERS)
    pixels = image.width * image.height
    if pixels > MOST_PIXELS:
        image.close()
        raise Image.DecompressionBombError(f"{image.width} x {image.height} pixels")
    if pixels > max(FREE_PIXELS, PIXELS_PER_BYTE * os.path.getsize(path)):
        image.close()
        raise ValueError(
            f"{image.width} x {image.height} pixels in {os.path.getsize(path)} bytes are more than such a file "
            "can contain"
        )
    return image


def _shallow(image):
    """Return the pixels of a picture that Pillow represents without loss."""
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode == "I" and image.format in ("PNG", "PPM"):
        return np.asarray(image).astype(np.uint16)
    if image.format == "GIF":
        return np.array(image.convert("RGB"))
    if image.mode in ("L", "RGB", "RGBA", "I", "F"):
        return np.array(image)
    if image.mode == "1":
        return np.array(image.convert("L"))
    alpha = image.mode in ("LA", "La", "PA", "RGBa") or "transparency" in image.info
    return np.array(image.convert("RGBA" if alpha else "RGB"))


def _checked(img):
    img = np.asarray(img)
    if img.dtype.kind not in "buif":
        raise TypeError(f"img must be real, got {img.dtype}")
    img = img[:, None] if img.ndim == 1 else img
    if img.ndim not in (2, 3) or 0 in img.shape or (img.ndim == 3 and img.shape[-1] not in (1, 3, 4)):
        raise ValueError(f"img must be [H], [H, W] or [H, W, 1 | 3 | 4], none empty; got {img.shape}")
    return img[..., 0] if img.ndim == 3 and img.shape[-1] == 1 else img


def _levels(img, cmin, cmax, color_depth):
    if color_depth not in (8, 16):
        raise ValueError(f"color_depth must be 8 or 16, got {color_depth!r}")
    cmin, cmax = float(_validate.real("cmin", cmin)), float(_validate.real("cmax", cmax))
    if not cmin < cmax:
        raise ValueError(f"cmax must be larger than cmin, got cmin={cmin} and cmax={cmax}")
    white = 2**color_depth - 1
    levels = img.astype(np.float64)
    np.clip(levels, cmin, cmax, out=levels)
    levels -= cmin
    levels *= white / (cmax - cmin)
    np.rint(levels, out=levels)
    return np.nan_to_num(levels, copy=False).astype(np.uint8 if color_depth == 8 else np.uint16)


def _encoder(path, levels) -> Callable:
    """Return the function that writes the levels to a stream, or an error message if the format cannot store them."""
    form = _FORMATS[extension_of(path)]
    deep, colour, alpha = levels.dtype == np.uint16, levels.ndim == 3, levels.shape[2:] == (4,)
    if deep and (form in ("JPEG", "BMP") or (colour and form != "PNG")):
        held = "16-bit grey only" if form == "TIFF" else "8 bits only"
        raise ValueError(f"{path!r} cannot store this image: {form} stores {held}; PNG stores 16 bits")
    if alpha and form in ("JPEG", "BMP"):
        raise ValueError(f"{path!r} cannot store an alpha channel: PNG and TIFF can")
    if deep and colour:
        return lambda stream: _write_deep_png(stream, levels)
    options = _ENCODER_OPTIONS.get(form, {})
    return lambda stream: Image.fromarray(levels).save(stream, format=form, **options)


_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {3: 2, 4: 6}
_HALVES = {"RGB": ("RGB;16B", "RGB;16L"), "RGBA": ("RGBA;16B", "RGBA;16L")}
_BITS_PER_SAMPLE = 258


def _is_deep(image: Any) -> bool:
    """Return whether a picture just opened has channels of more than 8 bits that Pillow would truncate.

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


def _read_deep(image: Image.Image, again: Image.Image) -> np.ndarray:
    """Return the samples of a 16-bit colour picture.

    Parameters
    ----------
    image : PIL.Image.Image
        A file for which :func:`_is_deep` holds, opened and not loaded.
    again : PIL.Image.Image
        The same file, opened a second time.

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


def _write_deep_png(stream: BinaryIO, levels: np.ndarray) -> None:
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


def resize_image(img: np.ndarray, target_size: tuple[int, int]) -> np.ndarray:
    """Resize an image; a smaller axis averages the pixels that each new one covers, a larger one interpolates.

    Parameters
    ----------
    img : numpy.ndarray
        ``[H, W]`` or ``[H, W, C]``.
    target_size : sequence of int
        Width and height, in that order.

    Returns
    -------
    numpy.ndarray
        ``[height, width]`` or ``[height, width, C]`` of the same dtype; integers are rounded.

    Raises
    ------
    TypeError
        If the image holds no numbers or the size no integers.
    ValueError
        If the image does not have two or three axes, or the size is not two positive integers.

    Examples
    --------
    A smaller image holds averages:

    >>> import numpy as np
    >>> from odak.tools import resize_image
    >>> resize_image(np.asarray([[0.0, 1.0, 2.0, 5.0]]), (2, 1)).tolist()
    [[0.5, 3.5]]
    """
    img = np.asarray(img)
    if img.dtype.kind not in "buifc":
        raise TypeError(f"img must be numeric, got {img.dtype}")
    if img.ndim not in (2, 3) or 0 in img.shape:
        raise ValueError(f"img must be [H, W] or [H, W, C], none empty; got {img.shape}")
    if np.shape(target_size) != (2,):
        raise ValueError(f"target_size must be [width, height], got {target_size!r}")
    width, height = (
        _validate.side(name, _validate.integer(name, count, minimum=1))
        for name, count in zip(("target_size[0] (width)", "target_size[1] (height)"), target_size, strict=True)
    )
    result = img.astype(np.result_type(img, np.float64))
    for axis, size in sorted(((0, height), (1, width)), key=lambda pair: pair[1] / img.shape[pair[0]]):
        if size != img.shape[axis]:
            index, weight = _taps(img.shape[axis], size)
            along = [-1 if i == axis else 1 for i in range(img.ndim)]
            result = sum(result.take(i, axis) * w.reshape(along) for i, w in zip(index.T, weight.T, strict=True))
    return np.rint(result).astype(img.dtype) if img.dtype.kind in "bui" else result.astype(img.dtype)


def _taps(source, target):
    """Return the indices and weights of the samples that each new one is a mean of, both ``[target, taps]``."""
    step = source / target
    first = np.arange(target)[:, None]
    if step < 1:
        centre = (first + 0.5) * step - 0.5
        index = np.floor(centre) + np.arange(2)
        weight = 1 - np.abs(index - centre)
    else:
        start, end = first * step, (first + 1) * step
        index = np.floor(start) + np.arange(int(np.ceil(step)) + 1)
        weight = np.clip(np.minimum(index + 1, end) - np.maximum(index, start), 0, None) / step
    return np.clip(index, 0, source - 1).astype(np.intp), weight
