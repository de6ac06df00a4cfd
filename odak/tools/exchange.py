"""Fields for other programs: labelled arrays of xarray, OME-TIFF files with lengths, and a reader for napari."""

import math
import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from odak import _array, _validate
from odak._array import Array
from odak.tools.paths import regular_file, temporary_name, validate_path

AXES = "TZCYX"
# Types of numbers that OME-TIFF has a name for.
_OME_NUMBERS = ("bool", "int8", "uint8", "int16", "uint16", "int32", "uint32")
_OME_NUMBERS += ("float32", "float64", "complex64", "complex128")
TIFF_ENDINGS, NAPARI_ENDINGS = (".tif", ".tiff"), (".ome.tif", ".ome.tiff", ".npy")
OME_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "μm": 1e-6, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "Å": 1e-10}
MICROMETRE, NANOMETRE = 1e-6, 1e-9
# Deflate shortens data at most so many times.
LARGEST_COMPRESSION = 1032
# Bytes of the shortest directory of a page: a count, one entry and the place of the next directory.
SMALLEST_PAGE = 18


@_validate.takes_units("pitch", "wavelength", "distance")
def to_xarray(
    field: Array,
    pitch: float | Sequence[float],
    wavelength: float | Sequence[float] | None = None,
    distance: float | Sequence[float] | None = None,
    name: str = "field",
) -> Any:
    """Return a field as an array of xarray with its positions in metres.

    Parameters
    ----------
    field : array
        ``[..., rows, columns]``, real or complex, NumPy or torch on any device.
    pitch : float or sequence of float
        Distance between samples in metres, or a pair for rows and columns.
    wavelength : float or sequence of float, optional
        In metres; several belong to the last axis before the rows.
    distance : float or sequence of float, optional
        Of the plane from the source in metres; several belong to the axis before the wavelengths, or before the rows if
        there is one wavelength.
    name : str
        Name of the array.

    Returns
    -------
    xarray.DataArray
        A copy with the axes "frame" (or "frame_0", "frame_1", …), "z", "wavelength", "y", "x", as far as there are. Its
        coordinates are in metres and say so by the attribute "units"; 0 of x and y is sample ``n // 2``.

    Raises
    ------
    ValueError, TypeError
        If an argument is no length, or there is no axis of as many samples as wavelengths or distances.
    ImportError
        If xarray is missing; the message states what to install.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.tools import to_xarray
    >>> field = np.ones((3, 4, 6), dtype=complex)
    >>> shown = to_xarray(field, 8e-6, [640e-9, 520e-9, 460e-9])  # doctest: +SKIP
    >>> shown.sel(x=0, y=0, wavelength=520e-9, method="nearest").item()  # doctest: +SKIP
    (1+0j)
    """
    xarray = _package("xarray")
    values = _numbers("field", field, 2, None)
    steps = _pitches(pitch)
    _validate.instance("name", name, str, "a string")
    coordinates: dict[str, Any] = {}
    dims, place = ["y", "x"], values.ndim - 2
    for dim, step, count in zip(dims, steps, values.shape[-2:], strict=True):
        coordinates[dim] = (dim, (np.arange(count) - count // 2) * step, {"units": "m"})
    for argument, dim, given in (("wavelength", "wavelength", wavelength), ("distance", "z", distance)):
        if given is None:
            continue
        lengths = _array.on_host(given)
        _validate.several(argument, lengths.reshape(-1).tolist(), positive=argument == "wavelength")
        if several := lengths.ndim > 0:
            place -= 1
            if place < 0 or values.shape[place] != len(lengths):
                raise ValueError(
                    f"{argument} must be one number, or as many as an axis of field has samples; got {len(lengths)} "
                    f"numbers and the shape {list(values.shape)}"
                )
            dims = [dim, *dims]
        coordinates[dim] = ((dim,) if several else (), lengths, {"units": "m"})
    frames = ["frame"] if place == 1 else [f"frame_{i}" for i in range(place)]
    return xarray.DataArray(values.copy(), coordinates, [*frames, *dims], name)


@_validate.takes_units("pitch", "wavelength")
def save_ome_tiff(
    filename: str | os.PathLike[str],
    field: Array,
    pitch: float | Sequence[float],
    spacing: float | None = None,
    wavelength: float | Sequence[float] | None = None,
) -> bool:
    """Write a field, real or complex, as an OME-TIFF file with its lengths, as microscopes do.

    Parameters
    ----------
    filename : str or os.PathLike
        A ``.tif`` or ``.tiff`` file, best ``.ome.tif``; an older one stays as it was until the new one is complete.
    field : array
        ``[rows, columns]``, ``[planes, rows, columns]``, ``[planes, colours, rows, columns]`` or
        ``[frames, planes, colours, rows, columns]`` of 8- to 32-bit integers, single or double precision, real or
        complex; NumPy or torch on any device.
    pitch : float or sequence of float
        Distance between samples in metres, or a pair for rows and columns.
    spacing : float, optional
        Distance between planes in metres.
    wavelength : float or sequence of float, optional
        Wavelength of each colour in metres.

    Returns
    -------
    bool
        True.

    Raises
    ------
    ValueError, TypeError
        If an argument is none of these, or the file cannot be written; the message names it.
    ImportError
        If tifffile is missing; the message states what to install.

    Notes
    -----
    Goldberg et al., Genome Biol. 6, R47 (2005). OME-TIFF has types for complex samples, which Bio-Formats, ImageJ and
    :func:`load_ome_tiff` take; other viewers of pictures show real ones alone. Lengths are written in micrometres and
    wavelengths, of emission, in nanometres, both to the last digit.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_ome_tiff, save_ome_tiff
    >>> field = np.exp(1j * np.arange(24.0)).reshape(4, 6)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "field.ome.tif")
    ...     saved = save_ome_tiff(name, field, 8e-6, wavelength=532e-9)
    ...     values, lengths = load_ome_tiff(name)
    >>> bool((values == field).all()), lengths["pitch"], lengths["wavelength"]
    (True, (8e-06, 8e-06), (5.32e-07,))
    """
    path = validate_path(filename, TIFF_ENDINGS)
    tifffile = _package("tifffile")
    values = _numbers("field", field, 2, len(AXES))
    if values.dtype.name not in _OME_NUMBERS:
        raise TypeError(f"field must be of {', '.join(_OME_NUMBERS)} for OME-TIFF, got {values.dtype.name}")
    axes = "ZYX"[-values.ndim :] if values.ndim < 4 else AXES[-values.ndim :]
    described: dict[str, Any] = {"axes": axes}
    lengths = dict(zip("YX", _pitches(pitch), strict=True))
    if spacing is not None:
        lengths["Z"] = _validate.number("spacing", spacing, positive=True)
    for axis, length in lengths.items():
        described |= {f"PhysicalSize{axis}": _divided(length, MICROMETRE), f"PhysicalSize{axis}Unit": "µm"}
    if wavelength is not None:
        colours = values.shape[axes.index("C")] if "C" in axes else 1
        waves = _validate.several("wavelength", _array.on_host(wavelength).reshape(-1).tolist(), positive=True)
        if len(waves) != colours:
            raise ValueError(f"wavelength must be one for each of {colours} colours of field, got {len(waves)}")
        written = [_divided(wave, NANOMETRE) for wave in waves]
        described["Channel"] = {"EmissionWavelength": written, "EmissionWavelengthUnit": ["nm"] * colours}
    with temporary_name(path) as temporary:
        tifffile.imwrite(temporary, values, ome=True, photometric="minisblack", metadata=described)
    return True


def load_ome_tiff(filename: str | os.PathLike[str]) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the values of an OME-TIFF file and its lengths.

    Parameters
    ----------
    filename : str or os.PathLike
        File of one series of pictures in grey or of complex samples, of this package or another program. A file whose
        pictures lie in other files is refused.

    Returns
    -------
    numpy.ndarray
        ``[rows, columns]`` with the axes that have more than one sample before: frames, planes, colours.
    dict
        "pitch" along rows and columns, "spacing" of planes, and "wavelength": one for each colour, all in
        metres; None where the file does not state them.

    Raises
    ------
    ValueError
        If the file is not such a file, or is broken; the message names it.
    FileNotFoundError
        If there is none.
    ImportError
        If tifffile is missing; the message states what to install.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import load_ome_tiff, save_ome_tiff
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "stack.ome.tif")
    ...     saved = save_ome_tiff(name, np.zeros((3, 4, 6)), (8e-6, 4e-6), spacing=1e-3)
    ...     values, lengths = load_ome_tiff(name)
    >>> values.shape, lengths["pitch"], lengths["spacing"]
    ((3, 4, 6), (8e-06, 4e-06), 0.001)
    """
    path = validate_path(filename, TIFF_ENDINGS)
    tifffile = _package("tifffile")
    # Broken files make tifffile raise errors of many types.
    unreadable = _validate.refusing(f"Failed to read {path!r} as OME-TIFF: ", Exception)
    with open(regular_file(path), "rb") as stream, unreadable, tifffile.TiffFile(stream) as file:
        text = file.ome_metadata
        if text is None:
            raise ValueError("no OME-XML of grey or complex pictures")
        _check_promise(text, path)
        series = file.series[0]
        if not series.axes.endswith("YX"):
            raise ValueError("no OME-XML of grey or complex pictures")
        if series.nbytes > LARGEST_COMPRESSION * os.path.getsize(path):
            raise ValueError(f"it states {series.nbytes} bytes, more than it can hold")
        return series.asarray(), _lengths(text)


def napari_reader(path: str | list[str]) -> Callable[[str | list[str]], list[tuple[Any, dict[str, Any], str]]] | None:
    """Return a function that gives napari the layers of a file of complex values, or None for other files.

    Parameters
    ----------
    path : str or list of str
        An OME-TIFF or a ``.npy`` file; napari's own readers take lists, and files of real values.

    Returns
    -------
    callable or None
        ``read(path)``, which returns ``(values, arguments, "image")`` for the amplitude and the phase, with scales in
        micrometres where the file states them.

    Notes
    -----
    Contract of npe2's readers. napari finds it by the entry point "napari.manifest" of this package.

    Examples
    --------
    >>> from odak.tools import napari_reader
    >>> napari_reader("picture.png") is None
    True
    """
    if not isinstance(path, str) or not path.lower().endswith(NAPARI_ENDINGS):
        return None
    try:
        values, _ = _stack(path)
    except (ValueError, OSError, ImportError):
        return None
    return _layers if np.iscomplexobj(values) else None


def _layers(path):
    """Return the layers of a file of complex values."""
    values, scale = _stack(path)
    title = os.path.basename(path)
    phase = {"colormap": "twilight", "contrast_limits": (-np.pi, np.pi), "visible": False}
    return [
        (np.abs(values), {"name": f"{title} amplitude", "scale": scale}, "image"),
        (np.angle(values), {"name": f"{title} phase", "scale": scale, **phase}, "image"),
    ]


def _stack(path):
    """Return the values of a file and the scale of each axis, in micrometres where the file states lengths."""
    if path.lower().endswith(".npy"):
        values = np.load(path, allow_pickle=False)
        return values, (1.0,) * values.ndim
    values, lengths = load_ome_tiff(path)
    if lengths["pitch"] is None:
        return values, (1.0,) * values.ndim
    leading = [1.0] * (values.ndim - 2)
    if lengths["spacing"] is not None and values.ndim == 3:
        leading = [lengths["spacing"] / MICROMETRE]
    return values, (*leading, *(step / MICROMETRE for step in lengths["pitch"]))


def _package(name):
    return _validate.optional(name, f"the package {name} is missing: pip install {name}")


def _numbers(name, value, least, most):
    """Return an array of numbers of at least `least` and at most `most` axes, none of them empty."""
    if not _array.is_array(value):
        raise TypeError(f"{name} must be an array [..., rows, columns], got {type(value).__name__}")
    values = _array.on_host(value)
    if values.dtype.kind not in "biufc":
        raise TypeError(f"{name} must hold numbers, got {values.dtype}")
    if values.ndim < least or (most is not None and values.ndim > most) or not values.size:
        axes = f"at least {least}" if most is None else f"{least} to {most}"
        raise ValueError(f"{name} must have {axes} axes, none empty, got {list(values.shape)}")
    return values


def _pitches(pitch):
    steps = _array.on_host(pitch)
    return _validate.pair("pitch", pitch if not steps.ndim else steps.tolist(), positive=True)


def _divided(length, unit):
    """Return the number that times `unit` is the length to the last digit, as far as there is one."""
    quotient = length / unit
    near = (np.nextafter(quotient, 0.0), quotient, np.nextafter(quotient, np.inf))
    return float(min(near, key=lambda one: abs(one * unit - length)))


def _check_promise(text: str, path: str) -> None:
    """Raise ValueError where an OME-XML names other files, or more planes than the file can hold.

    tifffile follows such names, and makes a list of all planes before it looks for them in the file.
    """
    root, most = ElementTree.fromstring(text), os.path.getsize(path) // SMALLEST_PAGE
    for part in root.iter():
        kind, given = part.tag.rpartition("}")[2], part.attrib
        # A file that was renamed still knows itself by its own identifier.
        other = given.get("FileName", "").lower() != os.path.basename(path).lower()
        if kind == "BinaryOnly" or (kind == "UUID" and other and part.text != root.get("UUID")):
            raise ValueError(f"its pictures lie in another file, {given.get('FileName')!r:.80}; only its own are read")
        if kind.startswith("ModuloAlong"):
            raise ValueError("its planes have axes of other kinds (ModuloAlong), which are not read")
        if kind == "Pixels":
            planes = math.prod(int(given[f"Size{axis}"]) for axis in "ZCT")
            blocks = [block.attrib for block in part if block.tag.endswith("}TiffData")]
            numbers = [planes, sum(_pages(block, planes) for block in blocks)]
            numbers += [int(block.get(name, 0)) for block in blocks for name in ("IFD", "FirstZ", "FirstC", "FirstT")]
            if planes < 1 or min(numbers) < 0 or max(numbers) > most:
                raise ValueError(f"it states {planes} planes, more than its bytes can hold")


def _pages(block: Mapping[str, str], planes: int) -> int:
    """Return how many pages a block of an OME-XML is of; one without a number is of all."""
    return int(block.get("PlaneCount", block.get("NumPlanes", 1 if "IFD" in block else planes)))


def _lengths(text):
    """Return the lengths that an OME-XML text states of its first picture."""
    pixels = next(part for part in ElementTree.fromstring(text).iter() if part.tag.endswith("}Pixels"))

    def length(part, name, default):
        unit = OME_UNITS.get(part.get(f"{name}Unit", default))
        value = float(part.get(name, "nan"))
        return value * unit if unit is not None and value > 0 else None

    rows, columns, planes = (length(pixels, f"PhysicalSize{axis}", "µm") for axis in "YXZ")
    waves = [length(part, "EmissionWavelength", "nm") for part in pixels if part.tag.endswith("}Channel")]
    return {
        "pitch": (rows, columns) if rows and columns else None,
        "spacing": planes,
        "wavelength": tuple(waves) if waves and all(waves) else None,
    }
