"""Colours of a picture by the profile in its file: light relative to the profile's white, as XYZ under D50."""

import io
import struct
from dataclasses import dataclass

import numpy as np

from odak import _validate

_HEADER, _ENTRY = 128, 12


@dataclass(frozen=True)
class MatrixProfile:
    """ICC profile of three primaries, or of grey, and a curve for each channel.

    Attributes
    ----------
    description : str
        Name that the profile gives itself.
    to_xyz : numpy.ndarray
        XYZ under D50 of each channel's full light, ``[3, channels]``.
    curves : tuple
        For each channel its light at equidistant levels of 0 … 1, or the parameters (g, a, b, c, d, e, f) of
        (a·x + b)^g + e for levels of at least d and c·x + f below.
    """

    description: str
    to_xyz: np.ndarray
    curves: tuple[np.ndarray | tuple[float, ...], ...]

    def light(self, levels: np.ndarray) -> np.ndarray:
        """Return XYZ ``[3, rows, columns]`` under D50 of levels ``[channels, rows, columns]`` of 0 … 1.

        Parameters
        ----------
        levels : numpy.ndarray
            Levels; of more channels, such as alpha, the first count.
        """
        light = [_decoded(curve, level) for curve, level in zip(self.curves, levels, strict=False)]
        return np.einsum("xc,c...->x...", self.to_xyz, np.stack(light))


def profile_of(content: bytes) -> MatrixProfile | None:
    """Return the profile that the bytes of an ICC profile describe.

    Parameters
    ----------
    content : bytes
        The profile, as :func:`odak.tools.file.embedded_profile` returns it.

    Returns
    -------
    MatrixProfile or None
        None for a profile of tables without a matrix, as those of printers.

    Raises
    ------
    ValueError
        If the profile is broken.
    """
    from PIL import ImageCms

    broken = (ImageCms.PyCMSError, OSError, struct.error, ValueError)
    with _validate.refusing("the colour profile in the file cannot be used: ", *broken):
        opened = ImageCms.ImageCmsProfile(io.BytesIO(content)).profile
        return _parsed(content, opened.profile_description or "unnamed")


def _parsed(content: bytes, description: str) -> MatrixProfile | None:
    (count,) = struct.unpack_from(">I", content, _HEADER)
    entries = (struct.unpack_from(">4sII", content, _HEADER + 4 + _ENTRY * k) for k in range(min(count, 100)))
    tags = {name: content[start : start + size] for name, start, size in entries}
    if content[16:20] == b"GRAY" and b"kTRC" in tags:
        white = struct.unpack_from(">3i", content, 68)  # of the connection space, D50
        return MatrixProfile(description, np.array(white)[:, None] / 65536, (_curve(tags[b"kTRC"]),))
    if content[16:20] != b"RGB " or b"A2B0" in tags or not {b"rXYZ", b"gXYZ", b"bXYZ"} <= tags.keys():
        return None
    columns = [struct.unpack_from(">3i", tags[name], 8) for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
    curves = tuple(_curve(tags.get(name, b"")) for name in (b"rTRC", b"gTRC", b"bTRC"))
    return MatrixProfile(description, np.array(columns).T / 65536, curves)


def _curve(tag: bytes) -> np.ndarray | tuple[float, ...]:
    """Return the curve of a tag of the type "curv" or "para" (ICC.1:2022, 10.6 and 10.18)."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 1:
            return (struct.unpack_from(">H", tag, 12)[0] / 256, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        return np.array(struct.unpack_from(f">{count}H", tag, 12)) / 65535 if count else np.array([0.0, 1.0])
    if tag[:4] != b"para":
        raise ValueError(f"a curve has the type {tag[:4]!r}")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind > 4:
        raise ValueError(f"a curve has the kind {kind}")
    given = [value / 65536 for value in struct.unpack_from(f">{(1, 3, 4, 5, 7)[kind]}i", tag, 12)]
    g, a, b, c, d, e, f = given + [0.0] * (7 - len(given))
    if kind == 0:
        return g, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if kind in (1, 2):
        return g, a, b, 0.0, -b / a, c, c
    return g, a, b, c, d, e, f


def _decoded(curve, levels):
    if isinstance(curve, np.ndarray):
        return np.interp(levels, np.linspace(0, 1, len(curve)), curve)
    g, a, b, c, d, e, f = curve
    return np.where(levels >= d, np.maximum(a * levels + b, 0) ** g + e, c * levels + f)
