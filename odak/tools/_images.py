"""Pictures in files: 8 and 16 bits, grey, colour and alpha, through Pillow."""

import os
import struct
import warnings
from collections.abc import Callable

import numpy as np
from PIL import Image

from odak import _validate
from odak.tools import _deep_colour
from odak.tools._atomic import replacing
from odak.tools._paths import extension_of, validate_path

# Where Pillow begins to warn.
MOST_PIXELS = 89_478_485
# What any file may promise, and beyond that for each of its bytes. Only blank pages, and bombs, hold more.
FREE_PIXELS, PIXELS_PER_BYTE = 16 << 20, 10_000

_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP", ".tiff": "TIFF", ".tif": "TIFF"}
_READABLE = (*_FORMATS, ".gif", ".webp", ".pbm", ".pgm", ".ppm", ".sr", ".ras")
# Named one by one, so that no file starts a decoder that runs programs (EPS) or reads other files.
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
        ``[H, W]``, ``[H, W, 1]``, ``[H, W, 3]`` (red, green, blue) or ``[H, W, 4]`` (with alpha), row 0 at the top.
        Values outside the limits are clipped, the others rounded to the nearest level; not-a-number is black.
    cmin, cmax : float
        Values of black and white.
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
    """
    divisor = float(_validate.real("normalizeby", normalizeby))
    image = read_levels(fn, torch_style).astype(np.float64)
    if divisor != 0:
        image /= divisor
    return image


def read_levels(fn: str | os.PathLike, torch_style: bool = False) -> np.ndarray:
    """Read an image as the file holds it.

    Parameters
    ----------
    fn : str or os.PathLike
        As for :func:`load_image`.
    torch_style : bool
        Put the channels first.

    Returns
    -------
    numpy.ndarray
        uint8 or uint16; int32 or float32 for a TIFF that holds them. Shapes as :func:`load_image`.

    Raises
    ------
    ValueError
        As :func:`load_image`.
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
        # On broken files Pillow's decoders raise what they stumble on: OSError, SyntaxError, struct.error, KeyError …
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
        if _deep_colour.is_deep(image):
            with _open(path) as again:
                return _deep_colour.read(image, again)
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
        raise ValueError(f"{image.width} x {image.height} pixels in {os.path.getsize(path)} bytes are not believed")
    return image


def _shallow(image):
    """Return the pixels of a picture that Pillow holds without loss."""
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
        raise TypeError(f"img must hold real numbers, got {img.dtype}")
    if img.ndim not in (2, 3) or 0 in img.shape or (img.ndim == 3 and img.shape[-1] not in (1, 3, 4)):
        raise ValueError(f"img must be [H, W] or [H, W, 1 | 3 | 4], none empty; got {img.shape}")
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
    """Return the function that writes the levels to a stream, or say why the format cannot hold them."""
    form = _FORMATS[extension_of(path)]
    deep, colour, alpha = levels.dtype == np.uint16, levels.ndim == 3, levels.shape[2:] == (4,)
    if deep and (form in ("JPEG", "BMP") or (colour and form != "PNG")):
        held = "16-bit grey only" if form == "TIFF" else "8 bits only"
        raise ValueError(f"{path!r} cannot hold this image: {form} takes {held}; PNG takes 16 bits")
    if alpha and form in ("JPEG", "BMP"):
        raise ValueError(f"{path!r} cannot hold an alpha channel: PNG and TIFF can")
    if deep and colour:
        return lambda stream: _deep_colour.write_png(stream, levels)
    options = _ENCODER_OPTIONS.get(form, {})
    return lambda stream: Image.fromarray(levels).save(stream, format=form, **options)
