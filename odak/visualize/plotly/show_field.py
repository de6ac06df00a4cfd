"""Fields in one line."""

import os
from collections.abc import Sequence
from typing import Any

from odak import _validate
from odak._array import Array
from odak.visualize._arrays import to_numpy
from odak.visualize.plotly import _checks, _layout
from odak.visualize.plotly._panels import QUANTITIES, length
from odak.visualize.plotly.fields import detectorshow

__all__ = ["field_show"]

MARGIN = (75, 40, 75, 90)


def field_show(
    field: Array,
    dx: float | None = None,
    wavelength: float | None = None,
    *,
    quantities: Sequence[str] | None = None,
    title: str | None = None,
    labels: Sequence[str] = (),
    color_scale: str = "Inferno",
    size: int = 480,
    origin: str = "upper",
    filename: str | os.PathLike | None = None,
    show: bool | None = None,
) -> detectorshow:
    """Show fields in one line: amplitude and phase, with axes in mm or µm and colour bars.

    Parameters
    ----------
    field : array or torch.Tensor
        ``[..., rows, columns]``, complex or real; leading axes become rows of the picture.
    dx : float, optional
        Distance between samples in metres.
    wavelength : float, optional
        In metres.
    quantities : sequence of str, optional
        What to draw: "amplitude", "phase", "intensity", and, where `dx` and `wavelength` are given, "spectrum", the
        power of the plane waves over their angles. By default amplitude and phase of complex fields; of real ones
        the amplitude.
    title : str, optional
        Title; by default what is known of the field.
    labels : sequence of str
        Names of the fields.
    color_scale : str
        Of all but the phase, whose scale is cyclic.
    size : int
        Longest side of an image in pixels.
    origin : {"upper", "lower"}
        Where row 0 is.
    filename : str or os.PathLike, optional
        Save the picture: a ``.html`` page, Markdown, or an image.
    show : bool, optional
        Whether to show it; by default if it is not saved.

    Returns
    -------
    detectorshow
        The picture.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.visualize.plotly import field_show
    >>> picture = field_show(np.ones((4, 6), complex), dx=8e-6, wavelength=532e-9, show=False)
    >>> [trace.name for trace in picture.fig.data], picture.settings["title"]
    (['amplitude (a.u.)', 'phase (°)'], '4 × 6 samples of 8 µm, wavelength 532 nm')
    """
    values = to_numpy("field", field)
    if values.ndim < 2 or 0 in values.shape:
        raise ValueError(f"field must be [..., rows, columns], not empty; got {list(values.shape)}")
    for name, value in (("dx", dx), ("wavelength", wavelength)):
        if value is not None:
            _validate.real(name, value, positive=True)
    show = None if show is None else _validate.flag("show", show)
    size, labels = _validate.whole("size", size, minimum=1), _checks.texts("labels", labels)
    if quantities is None:
        quantities = ("amplitude", "phase") if values.dtype.kind == "c" else ("amplitude",)
    names = _validate.texts("quantities", [quantities] if isinstance(quantities, str) else quantities)
    chosen = [_validate.one_of("quantities", name, QUANTITIES) for name in names]
    stack = values.reshape(-1, *values.shape[-2:])
    rows, columns = stack.shape[1:]
    shown: dict[str, Any] = {f"show_{name}": name in chosen for name in QUANTITIES}
    picture = detectorshow(
        row_titles=labels or ([f"Field {i + 1}" for i in range(len(stack))] if len(stack) > 1 else [""]),
        title=_description(rows, columns, dx, wavelength) if title is None else title,
        rows=len(stack),
        shape=_fitting(len(stack), len(chosen), rows, columns, size),
        margin=MARGIN,
        **shown,
    )
    picture.settings["color scale"] = _checks.scale("color_scale", color_scale)
    for i, one in enumerate(stack):
        picture.add_field(one, row=i + 1, showscale=True, dx=dx, wavelength=wavelength, origin=origin)
    if filename is not None:
        picture.save(filename)
    if show or (show is None and filename is None):
        picture.show()
    return picture


def _description(rows, columns, dx, wavelength) -> str:
    text = f"{rows} × {columns} samples" + (f" of {length(float(dx))}" if dx is not None else "")
    return text + (f", wavelength {length(float(wavelength))}" if wavelength is not None else "")


def _fitting(fields: int, images: int, rows: int, columns: int, size: int) -> tuple[int, int]:
    """Return a width and height in which images of the longest side `size` fit with their bars and titles."""
    scale = size / max(rows, columns)
    wide, tall = max(columns * scale, 120), max(rows * scale, 120)
    between = (images - 1) * _layout.COLUMN_GAP, (fields - 1) * _layout.ROW_GAP
    left, right, bottom, top = MARGIN
    width = images * (wide + _layout.BAR_SPACE) + between[0] + left + right
    return round(width), round(fields * tall + between[1] + bottom + top)
