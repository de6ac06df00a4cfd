"""Spectra: cone fundamentals, colour-matching functions, Gaussian stand-ins, files of measured spectra."""

import csv
import functools
import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np
import torch

from odak import _validate

CONE_GAUSSIANS = ((567.5, 32.5), (545.0, 27.5), (447.5, 17.0))
BACKLIGHT_GAUSSIANS = ((650.0, 14.5), (550.0, 12.0), (450.0, 12.0))
_TABLES = {
    "CIE 170": "cone_fundamentals_cie_170_2_degree.csv",
    "CIE 1931": "observer_cie_1931_2_degree.csv",
    "D65": "illuminant_cie_d65.csv",
}


def cone_fundamentals(wavelengths: torch.Tensor | Sequence[float], source: str = "CIE 170") -> torch.Tensor:
    """Return how strongly the L, M and S cones respond to light of equal power.

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres.
    source : {"CIE 170", "Gaussian"}
        Table for fields of 2°, CIE 170-1:2006, that is Stockman and Sharpe, Vision Res. 40, 1711 (2000), or the
        Gaussians of :class:`display_color_hvs`, which are rough: symmetric, and too wide.

    Returns
    -------
    torch.Tensor
        ``[3, S]``, each with a maximum of 1 over all wavelengths; float64, or the precision of a tensor given. The
        table is linear between whole nanometres and 0 outside 390 … 830 nm.

    Raises
    ------
    ValueError, TypeError
        If the wavelengths are not a list of real numbers, or the source is not known.

    Examples
    --------
    >>> from odak.learn.perception import cone_fundamentals
    >>> [round(value, 2) for value in cone_fundamentals([442.0, 543.0, 570.0]).diagonal().tolist()]
    [0.04, 1.0, 0.0]
    """
    if _validate.one_of("source", source, ("CIE 170", "Gaussian")) == "Gaussian":
        return gaussian_lines(_checked_axis("wavelengths", wavelengths), CONE_GAUSSIANS)
    return _from_table("CIE 170", wavelengths)


def color_matching_functions(wavelengths: torch.Tensor | Sequence[float]) -> torch.Tensor:
    """Return the colour-matching functions x̄, ȳ, z̄ of the CIE 1931 standard observer (2°).

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres.

    Returns
    -------
    torch.Tensor
        ``[3, S]``, float64 or the precision of a tensor given; linear between whole nanometres, 0 outside 360 … 830 nm.

    Raises
    ------
    ValueError, TypeError
        If the wavelengths are not a list of real numbers.

    Notes
    -----
    CIE 018:2019.
    """
    return _from_table("CIE 1931", wavelengths)


def illuminant_d65(wavelengths: torch.Tensor | Sequence[float]) -> torch.Tensor:
    """Return the relative power of CIE standard illuminant D65, 100 at 560 nm (CIE 015:2018).

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres.

    Returns
    -------
    torch.Tensor
        ``[S]``, float64 or the precision of a tensor given; linear between multiples of 5 nm, 0 outside 300 … 780 nm.

    Raises
    ------
    ValueError, TypeError
        If the wavelengths are not a list of real numbers.
    """
    return _from_table("D65", wavelengths)[0]


def spectrum_to_xyz(spectrum: torch.Tensor, wavelengths: torch.Tensor | Sequence[float]) -> torch.Tensor:
    """Return CIE 1931 XYZ of spectra of light, by the trapezium rule.

    Parameters
    ----------
    spectrum : torch.Tensor
        Power per nanometre ``[..., S]``.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, rising, S of them.

    Returns
    -------
    torch.Tensor
        ``[..., 3]``: ∫ spectrum·x̄ dλ and so on, not scaled. Differentiable in the spectrum.

    Raises
    ------
    ValueError, TypeError
        If the numbers of samples differ or the wavelengths do not rise.
    """
    if not isinstance(spectrum, torch.Tensor) or not spectrum.is_floating_point():
        kind = getattr(spectrum, "dtype", type(spectrum).__name__)
        raise TypeError(f"spectrum must be a tensor of real floats, got {kind}")
    axis = _checked_axis("wavelengths", wavelengths).to(spectrum)
    if spectrum.ndim == 0 or spectrum.shape[-1] != len(axis) or len(axis) < 2 or not bool((axis.diff() > 0).all()):
        raise ValueError(
            f"wavelengths must rise, one for each sample of the spectrum, got {len(axis)} for {tuple(spectrum.shape)}"
        )
    return torch.trapezoid(spectrum[..., None, :] * color_matching_functions(axis), axis)


def read_spectra(path: str | os.PathLike, wavelengths: torch.Tensor | Sequence[float] | None = None) -> torch.Tensor:
    """Read measured spectra from a text file.

    Parameters
    ----------
    path : str or os.PathLike
        Each line holds a wavelength in nanometres and one value per spectrum, parted by commas, semicolons, tabs or
        spaces. Lines that do not begin with a number are titles or comments.
    wavelengths : torch.Tensor or sequence of float, optional
        Where the spectra are wanted; 400, 401 … 700 nm by default.

    Returns
    -------
    torch.Tensor
        ``[P, S]``, float32 or the precision of a tensor given; linear between lines, 0 outside them.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file holds fewer than two lines of numbers, lines of different lengths, or a wavelength twice.

    Examples
    --------
    >>> from odak.learn.perception import display_color_hvs, read_spectra
    >>> display = display_color_hvs(primaries_spectrum=read_spectra("display.csv"))  # doctest: +SKIP
    """
    lines = _number_lines(_checked_path(path))
    if len(lines) < 2 or len({len(line) for line in lines}) != 1 or len(lines[0]) < 2:
        raise ValueError(f"{path} must hold two or more lines of a wavelength and as many values each")
    table = np.array(sorted(lines))
    if not np.isfinite(table).all() or not (np.diff(table[:, 0]) > 0).all():
        raise ValueError(f"{path} must hold finite numbers, and each wavelength once")
    wanted = torch.linspace(400, 700, 301) if wavelengths is None else _checked_axis("wavelengths", wavelengths)
    return _interpolated(table, wanted)


def gaussian_lines(wavelengths: torch.Tensor, lines: Sequence[tuple[float, float]]) -> torch.Tensor:
    """Return Gaussians exp(−(λ − μ)²/(4σ²)) scaled to a largest sample of 1, ``[lines, S]``.

    The exponent holds ½ twice, so that σ√2 is the standard deviation; stored results depend on it.
    """
    centres, widths = (torch.tensor(column, dtype=wavelengths.dtype) for column in zip(*lines, strict=True))
    exponent = -(((wavelengths - centres[:, None]) / (2 * widths[:, None])) ** 2)
    # Relative to the largest, so that a narrow line between samples is not 0/0.
    return torch.exp(exponent - exponent.amax(-1, keepdim=True))


def _checked_axis(name, wavelengths):
    _validate.real(name, wavelengths)
    axis = torch.as_tensor(wavelengths, dtype=None if isinstance(wavelengths, torch.Tensor) else torch.float64)
    if axis.ndim != 1 or len(axis) == 0:
        raise ValueError(f"{name} must be a list of numbers, got {tuple(axis.shape)}")
    return axis if axis.is_floating_point() else axis.double()


def _from_table(name, wavelengths):
    return _interpolated(_table(name), _checked_axis("wavelengths", wavelengths))


def _interpolated(table, axis):
    places = axis.detach().cpu().double().numpy()
    values = [np.interp(places, table[:, 0], column, left=0.0, right=0.0) for column in table[:, 1:].T]
    return torch.from_numpy(np.stack(values)).to(axis)


@functools.cache
def _table(name):
    folder = resources.files("odak.learn.perception").joinpath("data")
    return np.array(_numbers_of(folder.joinpath(_TABLES[name]).read_text(encoding="utf-8")))


def _checked_path(path):
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a string or a path, got {type(path).__name__}")
    if "\0" in os.fspath(path):
        raise ValueError(f"path must not hold a null byte, got {path!r}")
    return Path(path)


def _number_lines(path):
    try:
        return _numbers_of(path.read_text(encoding="utf-8-sig"))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is not a UTF-8 text of numbers: {error}") from error


def _numbers_of(text):
    lines = []
    for words in csv.reader(text.replace(";", ",").replace("\t", ",").splitlines()):
        words = [word for cell in words for word in cell.split()]
        try:
            lines.append([float(word) for word in words] if words else None)
        except ValueError:
            continue
    return [line for line in lines if line]
