"""Spectra of displays and observers, cone responses and opponent colours of a display, and individual observers.

The cone fundamentals of an individual observer follow from the density and the peak of the pigments of the eye. They
give the failure of metameric matches among observers.
"""

import csv
import functools
import math
import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import nn

from odak import _array, _validate
from odak._attributes import Prepared
from odak._torch_private import in_own_precision
from odak.learn._tensors import as_pictures, checked_device, floating, floating_tensor, in_float32, places_between
from odak.learn.perception.color import ciede2000, mix, xyz_to_lab
from odak.tools.paths import regular_file

CONE_GAUSSIANS = ((567.5, 32.5), (545.0, 27.5), (447.5, 17.0))
BACKLIGHT_GAUSSIANS = ((650.0, 14.5), (550.0, 12.0), (450.0, 12.0))
_TABLES = {
    "CIE 170": "cone_fundamentals_cie_170_2_degree.csv",
    "CIE 1931": "observer_cie_1931_2_degree.csv",
    "CIE 1964": "observer_cie_1964_10_degree.csv",
    "D65": "illuminant_cie_d65.csv",
    "daylight": "illuminant_cie_daylight.csv",
    "CIE 1995": "samples_cie_1995.csv",
    "CIE 2017": "samples_cie_2017.csv",
    "pigments": "pigments_stockman_rider_2023.csv",
}


def cone_fundamentals(wavelengths: torch.Tensor | Sequence[float], source: str = "CIE 170") -> torch.Tensor:
    """Return the sensitivities of the L, M and S cones to light of equal power.

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


def color_matching_functions(wavelengths: torch.Tensor | Sequence[float], observer: str = "CIE 1931") -> torch.Tensor:
    """Return the colour-matching functions x̄, ȳ, z̄ of a standard observer.

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres.
    observer : {"CIE 1931", "CIE 1964"}
        The standard observer for fields of 2°, or for fields of 10°.

    Returns
    -------
    torch.Tensor
        ``[3, S]``, float64 or the precision of a tensor given; linear between whole nanometres, 0 outside 360 … 830 nm.

    Raises
    ------
    ValueError, TypeError
        If the wavelengths are not a list of real numbers, or all below 1 or above 2500.

    Notes
    -----
    CIE 018:2019.

    Examples
    --------
    ȳ is the photopic luminous efficiency, 1 at 555 nm:

    >>> from odak.learn.perception import color_matching_functions
    >>> round(color_matching_functions([555.0])[1].item(), 6)
    1.0
    """
    return _from_table(_validate.one_of("observer", observer, ("CIE 1931", "CIE 1964")), wavelengths)


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
        If the wavelengths are not a list of real numbers, or all below 1 or above 2500.

    Examples
    --------
    >>> from odak.learn.perception import illuminant_d65
    >>> illuminant_d65([560.0]).item()
    100.0
    """
    return _from_table("D65", wavelengths)[0]


def spectrum_to_xyz(
    spectrum: torch.Tensor, wavelengths: torch.Tensor | Sequence[float], observer: str = "CIE 1931"
) -> torch.Tensor:
    """Return CIE XYZ of spectra of light, by the trapezium rule.

    Parameters
    ----------
    spectrum : torch.Tensor
        Power per nanometre ``[..., S]``.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, rising, S of them.
    observer : {"CIE 1931", "CIE 1964"}
        The standard observer for fields of 2°, or for fields of 10°.

    Returns
    -------
    torch.Tensor
        ``[..., 3]``: ∫ spectrum·x̄ dλ and so on, not scaled. Differentiable in the spectrum and the wavelengths.

    Raises
    ------
    ValueError, TypeError
        If the numbers of samples differ, the wavelengths do not rise, or the observer is not known.

    Examples
    --------
    The chromaticity of the illuminant D65 is (0.3127, 0.3290):

    >>> import torch
    >>> from odak.learn.perception import illuminant_d65, spectrum_to_xyz
    >>> wavelengths = torch.arange(380.0, 781.0)
    >>> xyz = spectrum_to_xyz(illuminant_d65(wavelengths), wavelengths)
    >>> [round(value, 3) for value in (xyz[:2] / xyz.sum()).tolist()]
    [0.313, 0.329]
    """
    floating_tensor("spectrum", spectrum)
    axis = _checked_axis("wavelengths", wavelengths).to(spectrum)
    if spectrum.ndim == 0 or spectrum.shape[-1] != len(axis) or len(axis) < 2 or not bool((axis.diff() > 0).all()):
        raise ValueError(
            f"wavelengths must rise, one for each sample of the spectrum, got {len(axis)} for {tuple(spectrum.shape)}"
        )
    return torch.trapezoid(spectrum[..., None, :] * color_matching_functions(axis, observer), axis)


def spectra_to_xyz_matrix(
    spectra: torch.Tensor, wavelengths: torch.Tensor | Sequence[float], observer: str = "CIE 1931"
) -> torch.Tensor:
    """Return the matrix from linear amounts of primaries to CIE XYZ, of the spectra of the primaries.

    Parameters
    ----------
    spectra : torch.Tensor
        Power per nanometre of each primary at full drive ``[..., P, S]``, of any unit common to all.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, rising, S of them.
    observer : {"CIE 1931", "CIE 1964"}
        The standard observer for fields of 2°, or for fields of 10°.

    Returns
    -------
    torch.Tensor
        ``[..., 3, P]``, scaled to Y = 1 of all primaries together; their sum is XYZ of the display's white.
        Differentiable in the spectra.

    Raises
    ------
    ValueError, TypeError
        If the numbers of samples differ, the wavelengths do not rise, or the observer is not known.

    Examples
    --------
    Three laser lines, each in the middle of three samples:

    >>> import torch
    >>> from odak.learn.perception import spectra_to_xyz_matrix
    >>> axis = torch.arange(400.0, 701.0, dtype=torch.float64)
    >>> lines = torch.stack([(axis - nm).abs().lt(1.5).double() for nm in (638, 520, 450)])
    >>> matrix = spectra_to_xyz_matrix(lines, axis)
    >>> [round(value, 4) for value in matrix[1].tolist()]
    [0.2037, 0.7558, 0.0405]
    """
    count = len(_checked_axis("wavelengths", wavelengths))
    accepted = f"[..., primaries, {count}], a value for each of wavelengths"
    _validate.shaped("spectra", floating_tensor("spectra", spectra), accepted)
    xyz = spectrum_to_xyz(spectra, wavelengths, observer)
    return xyz.mT / xyz[..., 1].sum(-1)[..., None, None]


def read_spectra(
    path: str | os.PathLike[str], wavelengths: torch.Tensor | Sequence[float] | None = None
) -> torch.Tensor:
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
        ``[P, S]``, float32 by default, of the precision of a tensor that is given, and float64 for a sequence; linear
        between lines, 0 outside them.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file holds fewer than two lines of numbers, lines of different lengths, or a wavelength twice.

    Examples
    --------
    The spectra of two primaries, measured at three wavelengths:

    >>> import os, tempfile
    >>> from odak.learn.perception import read_spectra
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "display.csv")
    ...     with open(name, "w") as stream:
    ...         print("nm, green, red", "500, 0.8, 0.0", "550, 1.0, 0.1", "600, 0.2, 0.9", sep=os.linesep, file=stream)
    ...     read_spectra(name, [525.0, 600.0])
    tensor([[0.9000, 0.2000],
            [0.0500, 0.9000]], dtype=torch.float64)
    """
    _validate.instance("path", path, (str, os.PathLike), "a string or a path")
    if "\0" in os.fspath(path):
        raise ValueError(f"path must not hold a null byte, got {path!r}")
    try:
        lines = _numbers_of(Path(regular_file(os.fspath(path))).read_text(encoding="utf-8-sig"))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{path} is not a UTF-8 text of numbers: {error}") from error
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
        raise ValueError(f"{name} must be a list of numbers, got an array of shape {tuple(axis.shape)}")
    # Wavelengths in metres or in ångström would be beyond all tables, where spectra are zero.
    if _array.is_readable(axis) and bool(((axis.detach() < 1) | (axis.detach() > 2500)).all()):
        raise ValueError(f"{name} must be in nanometres, got {axis.detach().tolist()!r:.80}")
    return axis if axis.is_floating_point() else axis.double()


def _from_table(name, wavelengths):
    return _interpolated(_table(name), _checked_axis("wavelengths", wavelengths))


def _interpolated(table, axis):
    places = axis.double()
    knots, *columns = torch.as_tensor(table.T.copy(), device=axis.device)
    below, share = places_between(knots, places)
    values = torch.stack([column[below].lerp(column[below + 1], share) for column in columns])
    return values.where((places >= knots[0]) & (places <= knots[-1]), 0.0).to(axis)


@functools.cache
def _table(name):
    folder = resources.files("odak.learn.perception").joinpath("data")
    return np.array(_numbers_of(folder.joinpath(_TABLES[name]).read_text(encoding="utf-8")))


def _numbers_of(text):
    lines = []
    for words in csv.reader(text.replace(";", ",").replace("\t", ",").splitlines()):
        words = [word for cell in words for word in cell.split()]
        try:
            lines.append([float(word) for word in words] if words else None)
        except ValueError:
            continue
    return [line for line in lines if line]


FIRST, LAST, LINES = 400, 700, 3
_SMALLEST_WIDTH, _BETWEEN, _CLOSE = 0.5, 0.01, 1e-3


def fitted_spectrum(dataset) -> torch.Tensor:
    """Return the sum of three Gaussians nearest to a measured spectrum.

    Parameters
    ----------
    dataset : torch.Tensor or numpy.ndarray
        Wavelengths in nanometres and values, ``[N, 2]`` or ``[2, N]``.

    Returns
    -------
    torch.Tensor
        ``[301]``, float32, at 400, 401 … 700 nm, in units of the largest value measured there.

    Raises
    ------
    ValueError, TypeError
        If the data are not two columns of finite numbers, or nothing was measured between 400 and 700 nm.

    Notes
    -----
    Least squares at the wavelengths measured, one line after the other: each starts at the peak of what those before
    left over, with the width of that peak, and all lines are fitted together again. A line that meets every measured
    value to a thousandth is the last.
    """
    axis = np.linspace(FIRST, LAST, LAST - FIRST + 1)
    table = _checked(dataset)
    values = np.interp(axis, table[:, 0], table[:, 1], left=0.0, right=0.0)
    if values.max() <= 0:
        raise ValueError(f"dataset must have positive values between {FIRST} and {LAST} nm")
    largest = values.max()
    values = values / largest
    inside = (table[:, 0] >= FIRST) & (table[:, 0] <= LAST)
    places, measured = table[inside, 0], table[inside, 1] / largest
    share = np.sqrt(len(axis) / max(1, len(places)))
    # Interpolated samples have a small weight: linear interpolation cuts the peaks of narrow lines.
    weight = np.where((axis >= table[0, 0]) & (axis <= table[-1, 0]), _BETWEEN, 1.0)

    def apart(parameters):
        lines = weight * (_curve(parameters, axis) - values)
        return np.concatenate([share * (_curve(parameters, places) - measured), lines])

    parameters = np.empty(0)
    while len(parameters) < 3 * LINES and np.abs(apart(parameters)).max() > _CLOSE * share:
        left = values - _curve(parameters, axis)
        parameters = np.append(parameters, _start(left, axis))
        parameters = least_squares(apart, parameters, max_nfev=200).x
    return torch.from_numpy(_curve(parameters, axis)).float()


def _curve(parameters, axis):
    heights, centres, widths = parameters.reshape(-1, 3).T[..., None]
    widths = np.maximum(np.abs(widths), _SMALLEST_WIDTH)
    return (heights * np.exp(-(((axis - centres) / widths) ** 2) / 2)).sum(0)


def _start(left, axis):
    """Return height, centre and width of the largest peak: its area is height·width·√2π."""
    peak = int(np.argmax(np.abs(left)))
    same = np.sign(left) == np.sign(left[peak])
    # Up to where the curve changes its sign on either side.
    low = peak - int(np.argmin(np.append(same[: peak + 1][::-1], False)))
    high = peak + int(np.argmin(np.append(same[peak:], False)))
    area = np.abs(left[low + 1 : high]).sum()
    width = area / (abs(left[peak]) * np.sqrt(2 * np.pi)) if left[peak] else 10.0
    return left[peak], axis[peak], max(width, 1.0)


def _checked(dataset):
    _validate.instance("dataset", dataset, (torch.Tensor, np.ndarray), "a tensor or an array")
    if "complex" in str(dataset.dtype):
        raise TypeError(f"dataset must be real, got {dataset.dtype}")
    table = dataset.detach().cpu().double().numpy() if isinstance(dataset, torch.Tensor) else dataset
    if table.ndim != 2 or 2 not in table.shape or table.size < 4:
        raise ValueError(f"dataset must be [N, 2] or [2, N], got {tuple(table.shape)}")
    table = (table if table.shape[1] == 2 else table.T).astype(float)
    if not np.isfinite(table).all():
        raise ValueError("dataset must hold finite numbers")
    return table[np.argsort(table[:, 0])]


OPPONENT = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))


class display_color_hvs(Prepared, nn.Module):
    """Cone responses of a viewer to the primaries of a display, and differences of its pictures in opponent colours.

    Parameters
    ----------
    resolution : sequence of int
        Columns and rows of the display; kept, not used.
    distance_from_screen : float
        In millimetres; kept, not used.
    pixel_pitch : float
        In millimetres; kept, not used.
    read_spectrum : str
        Kept for its callers, not used.
    primaries_spectrum : torch.Tensor, str or path, optional
        Spectra of P primaries ``[P, S]``, S samples evenly from 400 to 700 nm, both included, or a file for
        :func:`read_spectra`. By default the Gaussians of :meth:`initialize_rgb_backlight_spectrum`, 301 samples.
    device : torch.device
        Device of the display.
    cones : {"Gaussian", "CIE 170"}
        Sensitivities of :func:`cone_fundamentals`.

    Attributes
    ----------
    primaries_spectrum : torch.Tensor
        ``[P, S]``.
    l_normalized : torch.Tensor
        Sensitivity of the L cones ``[S]``; also spelt ``l_normalised``, like the other two.
    m_normalized : torch.Tensor
        Sensitivity of the M cones ``[S]``.
    s_normalized : torch.Tensor
        Sensitivity of the S cones ``[S]``.
    lms_tensor : torch.Tensor
        Response of each cone to each primary, ``[P, 3]``.
    primaries_tensor : torch.Tensor
        The inverse, ``[3, P]``.

    Raises
    ------
    ValueError, TypeError
        If the spectra are not ``[P, S]`` of real floats, or the cones are not known.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import display_color_hvs
    >>> display = display_color_hvs()
    >>> grey = torch.full((1, 3, 2, 2), 0.5)
    >>> tuple(display.primaries_to_lms(grey).shape), display(grey, grey).item()
    ((1, 3, 2, 2), 0.0)
    """

    _follow = dict.fromkeys(("cones", "primaries_spectrum"), "_prepare")
    primaries_spectrum: torch.Tensor
    l_normalized: torch.Tensor
    m_normalized: torch.Tensor
    s_normalized: torch.Tensor
    lms_tensor: torch.Tensor
    primaries_tensor: torch.Tensor

    def __init__(
        self,
        resolution: Sequence[int] = (1920, 1080),
        distance_from_screen: float = 800,
        pixel_pitch: float = 0.311,
        read_spectrum: str = "tensor",
        primaries_spectrum: torch.Tensor | str | os.PathLike[str] | None = None,
        device: torch.device | str = torch.device("cpu"),  # noqa: B008
        *,
        cones: str = "Gaussian",
    ):
        super().__init__()
        self.resolution = resolution
        self.distance_from_screen = distance_from_screen
        self.pixel_pitch = pixel_pitch
        self.read_spectrum = read_spectrum
        self.cones: str = _validate.one_of("cones", cones, ("Gaussian", "CIE 170"))
        self._keep("primaries_spectrum", _checked_spectra(primaries_spectrum).to(checked_device("device", device)))
        self._prepare()

    def _prepare(self):
        for cone, values in zip("lms", self.initialize_cones_normalized(), strict=True):
            self._keep(f"{cone}_normalized", values)
        responses = (self.l_normalized, self.m_normalized, self.s_normalized)
        self._keep("lms_tensor", None)
        self._keep("primaries_tensor", None)
        self.construct_matrix_lms(*responses)
        self.construct_matrix_primaries(*responses)

    @property
    def device(self) -> torch.device:
        """Device of the display."""
        return self.primaries_spectrum.device

    @property
    def l_normalised(self) -> torch.Tensor:
        """Same as ``l_normalized``."""
        return self.l_normalized

    @property
    def m_normalised(self) -> torch.Tensor:
        """Same as ``m_normalized``."""
        return self.m_normalized

    @property
    def s_normalised(self) -> torch.Tensor:
        """Same as ``s_normalized``."""
        return self.s_normalized

    def forward(self, input_image: torch.Tensor, ground_truth: torch.Tensor, gaze: object = None) -> torch.Tensor:
        """Return the mean squared difference of two pictures in opponent colours.

        Parameters
        ----------
        input_image, ground_truth : torch.Tensor
            Linear intensities of the primaries ``[B, P, H, W]``, of one shape.
        gaze : object
            Accepted, not used.

        Returns
        -------
        torch.Tensor
            The loss, without axes, float32 of half precision; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, or the pictures do not have P channels of real floats.
        """
        (gaze,) = _validate.constants(gaze=gaze)
        as_pictures("input_image", input_image, len(self.lms_tensor))
        as_pictures("ground_truth", ground_truth, len(self.lms_tensor))
        _validate.alike(input_image=input_image, ground_truth=ground_truth)
        # Opponent colours are differences of cone responses, in which half precision would lose digits.
        pictures = in_float32(input_image), in_float32(ground_truth)
        stages = [self.second_to_third_stage(self.primaries_to_lms(picture)) for picture in pictures]
        return nn.functional.mse_loss(stages[0], stages[1])

    def initialize_cones_normalized(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return the sensitivities of the L, M and S cones, ``[S]`` each, their largest sample 1.

        The Gaussians have (μ, σ) = (567.5, 32.5), (545, 27.5), (447.5, 17) nm and a standard deviation of σ√2, a slip
        of earlier releases that stored results depend on.
        """
        if self.cones == "Gaussian":
            return tuple(self._lines(CONE_GAUSSIANS))
        return tuple(cone_fundamentals(self._axis(), self.cones).to(self.primaries_spectrum))

    def initialize_rgb_backlight_spectrum(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return Gaussian spectra of red, green and blue, ``[S]`` each, their largest sample 1.

        (μ, σ) = (650, 14.5), (550, 12), (450, 12) nm with a standard deviation of σ√2.
        """
        return tuple(self._lines(BACKLIGHT_GAUSSIANS))

    def initialize_random_spectrum_normalized(self, dataset: torch.Tensor | np.ndarray) -> torch.Tensor:
        """Return a measured spectrum as a smooth curve: a fitted sum of three Gaussians.

        Parameters
        ----------
        dataset : torch.Tensor or numpy.ndarray
            Wavelengths in nanometres and values, ``[N, 2]`` or ``[2, N]``.

        Returns
        -------
        torch.Tensor
            ``[301]``, float32, at 400, 401 … 700 nm, in units of the largest value measured there.

        Raises
        ------
        ValueError, TypeError
            If the data are not two columns of finite numbers, or nothing was measured between 400 and 700 nm.
        """
        return fitted_spectrum(dataset).to(self.device)

    initialize_cones_normalised = initialize_cones_normalized
    initialize_random_spectrum_normalised = initialize_random_spectrum_normalized

    @staticmethod
    def display_spectrum_response(wavelength: float, function: Sequence[float]) -> float:
        """Return the entry of a spectrum that belongs to a wavelength, rounded to nanometres within 400 … 700.

        Parameters
        ----------
        wavelength : float
            In nanometres.
        function : sequence of float
            Values at 400, 401 … 700 nm.

        Returns
        -------
        float
            The value.

        Raises
        ------
        ValueError, TypeError
            If the wavelength is not a positive number or the values are not 301 finite ones.
        """
        wavelength = _validate.constant("wavelength", wavelength, positive=True)
        values = _validate.few("function", function, LAST - FIRST + 1)
        return values[min(max(round(wavelength), FIRST), LAST) - FIRST]

    def cone_response_to_spectrum(self, cone_spectrum: torch.Tensor, light_spectrum: torch.Tensor) -> torch.Tensor:
        """Return the sum of cone response times spectrum over the samples, a scalar tensor.

        The sum is not divided by the number of samples.

        Parameters
        ----------
        cone_spectrum : torch.Tensor
            Sensitivity of a cone at each sampled wavelength, ``[N]``.
        light_spectrum : torch.Tensor
            Spectrum at the same wavelengths, ``[N]``.
        """
        cone_spectrum = floating("cone_spectrum", cone_spectrum)
        light_spectrum = floating("light_spectrum", light_spectrum)
        _validate.fitting(cone_spectrum=cone_spectrum, light_spectrum=light_spectrum)
        return (cone_spectrum * light_spectrum).sum()

    def construct_matrix_lms(
        self, l_response: torch.Tensor, m_response: torch.Tensor, s_response: torch.Tensor
    ) -> torch.Tensor:
        """Compute the response of each cone to each primary and store it as ``lms_tensor``, ``[P, 3]``.

        Parameters
        ----------
        l_response : torch.Tensor
            Sensitivity of the L cones at the sampled wavelengths, ``[N]``.
        m_response : torch.Tensor
            Sensitivity of the M cones at the sampled wavelengths, ``[N]``.
        s_response : torch.Tensor
            Sensitivity of the S cones at the sampled wavelengths, ``[N]``.
        """
        self.lms_tensor = self._responses(l_response, m_response, s_response)
        return self.lms_tensor

    def construct_matrix_primaries(
        self, l_response: torch.Tensor, m_response: torch.Tensor, s_response: torch.Tensor
    ) -> torch.Tensor:
        """Compute the response of each cone to each primary and store it as ``primaries_tensor``, ``[3, P]``.

        Parameters
        ----------
        l_response : torch.Tensor
            Sensitivity of the L cones at the sampled wavelengths, ``[N]``.
        m_response : torch.Tensor
            Sensitivity of the M cones at the sampled wavelengths, ``[N]``.
        s_response : torch.Tensor
            Sensitivity of the S cones at the sampled wavelengths, ``[N]``.
        """
        self.primaries_tensor = self._responses(l_response, m_response, s_response).T
        return self.primaries_tensor

    def primaries_to_lms(self, primaries: torch.Tensor) -> torch.Tensor:
        """Return the responses of the cones to a picture.

        Parameters
        ----------
        primaries : torch.Tensor
            Linear intensities of the primaries ``[..., P, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[..., 3, H, W]``, four axes for three, in the input's precision.

        Raises
        ------
        ValueError, TypeError
            If the picture does not have P channels of real floats.
        """
        return mix(self.lms_tensor.T, as_pictures("primaries", primaries, len(self.lms_tensor)))

    def lms_to_primaries(self, lms_color_tensor: torch.Tensor) -> torch.Tensor:
        """Return the intensities of the primaries that cause given cone responses.

        Parameters
        ----------
        lms_color_tensor : torch.Tensor
            Responses ``[..., 3, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[..., P, H, W]`` in the input's precision: the smallest of all intensities if P > 3, the nearest in the
            sense of least squares if P < 3. Negative where the display cannot show the colour.

        Raises
        ------
        ValueError, TypeError
            If the picture does not have three channels of real floats.
        """
        return mix(torch.linalg.pinv(self.lms_tensor.double()).T, as_pictures("lms_color_tensor", lms_color_tensor))

    def rgb_to_lms(self, rgb: torch.Tensor) -> torch.Tensor:
        """Return the cone responses of an image; the same as :meth:`primaries_to_lms`.

        Parameters
        ----------
        rgb : torch.Tensor
            Linear intensities of the primaries, ``[..., P, H, W]``.
        """
        return self.primaries_to_lms(as_pictures("rgb", rgb, len(self.lms_tensor)))

    def lms_to_rgb(self, lms: torch.Tensor) -> torch.Tensor:
        """Return the intensities of the primaries; the same as :meth:`lms_to_primaries`.

        Parameters
        ----------
        lms : torch.Tensor
            Cone responses, ``[..., 3, H, W]``.
        """
        return self.lms_to_primaries(as_pictures("lms", lms))

    def second_to_third_stage(self, lms_image: torch.Tensor) -> torch.Tensor:
        """Return the opponent channels (M + S) − L, (L + S) − M and L + M + S.

        Parameters
        ----------
        lms_image : torch.Tensor
            Responses ``[..., 3, H, W]``.

        Returns
        -------
        torch.Tensor
            ``[..., 3, H, W]``, four axes for three.

        Raises
        ------
        ValueError, TypeError
            If the picture does not have three channels of real floats.

        Notes
        -----
        Schmidt, Neitz and Neitz, J. Opt. Soc. Am. A 31, A195 (2014), table 1.
        """
        return mix(OPPONENT, as_pictures("lms_image", lms_image))

    def _keep(self, name, value):
        # Derived from the constructor's arguments, hence not part of a stored state.
        self.register_buffer(name, value, persistent=False)

    def _axis(self):
        return torch.linspace(FIRST, LAST, self.primaries_spectrum.shape[-1], dtype=torch.float64)

    def _lines(self, lines):
        return gaussian_lines(self._axis(), lines).to(self.primaries_spectrum)

    @in_own_precision
    def _responses(self, *cones):
        samples = self.primaries_spectrum.shape[-1:]
        cones = [
            floating(f"{name}_response", cone).to(self.primaries_spectrum)
            for name, cone in zip("lms", cones, strict=True)
        ]
        for name, cone in zip("lms", cones, strict=True):
            if cone.shape != samples:
                raise ValueError(f"{name}_response must hold {samples.numel()} samples, got {tuple(cone.shape)}")
        return self.primaries_spectrum @ torch.stack(cones, -1)


def _checked_spectra(spectra):
    if spectra is None:
        return gaussian_lines(torch.linspace(FIRST, LAST, 301, dtype=torch.float64), BACKLIGHT_GAUSSIANS).float()
    if isinstance(spectra, (str, os.PathLike)):
        return read_spectra(spectra)
    floating_tensor("primaries_spectrum", spectra, "a tensor of real floats or a file")
    _validate.shaped("primaries_spectrum", spectra, "[1 or more, 2 or more], a spectrum for each primary")
    return _validate.real("primaries_spectrum", spectra)


# Wavelengths in nanometres at which the absorbances of the pigments L, M and S have their peaks.
PEAKS = {"L": 553.1, "M": 529.9, "S": 416.9}
MACULAR_SCALE, LENS_SCALE = 1.0050048550, 1.0091871745
LOG_START, LOG_STEP = 2.556302500767287267, 0.1187666467581842301
# Fractions of the two common variants of the L pigment, the distance between their peaks in nanometres, and the factor
# that gives the mean of the two the maximum 1.
SHARES, VARIANT, L_SCALE = (0.56, 0.44), -2.70, 1.000935055234848
MACULAR_PEAK, LENS_AT_400, DENSITIES = 0.35, 1.7649, (0.5, 0.5, 0.4)
# Standard deviations over people: of densities in parts of their means, of peaks in nanometres. Asano, Fairchild and
# Blondé, PLoS ONE 11, e0145671 (2016), doi 10.1371/journal.pone.0145671, table 5, after its second step, which scales
# the deviations of the literature (19.1 and 37.2 %; 17.9, 17.9 and 14.7 %; 4, 3 and 2.5 nm) by 0.98 for lens and macula
# and by 0.5 for the pigments.
LENS_SPREAD, MACULAR_SPREAD = 0.187, 0.365
DENSITY_SPREADS, PEAK_SPREADS = (0.09, 0.09, 0.074), (2.0, 1.5, 1.3)
AXIS = tuple(range(390, 781))


def individual_cone_fundamentals(
    wavelengths: torch.Tensor | Sequence[float],
    lens: float = LENS_AT_400,
    macular: float = MACULAR_PEAK,
    densities: Sequence[float] = DENSITIES,
    shifts: Sequence[float] = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return the sensitivities of one person's L, M and S cones to light of equal power.

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres, 390 to 780.
    lens : float
        Optical density of the lens at 400 nm.
    macular : float
        Peak optical density of the macular pigment; 0.35 for the standard observer of 2°.
    densities : sequence of float
        Peak optical densities of the L, M and S pigments.
    shifts : sequence of float
        Of the peaks of the L, M and S pigments, in nanometres.

    Returns
    -------
    torch.Tensor
        ``[3, S]``, float64, each with a maximum of 1 over whole nanometres.

    Raises
    ------
    ValueError, TypeError
        If a wavelength or a number is out of range.

    Notes
    -----
    Formulas of Stockman and Rider, Color Res. Appl. 48, 818 (2023), doi 10.1002/col.22879. With the default numbers
    they are CIE 170-1:2006 for 2° (:func:`cone_fundamentals`) within two per cent of the maximum.

    Examples
    --------
    >>> from odak.learn.perception import cone_fundamentals, individual_cone_fundamentals
    >>> waves = [450.0, 540.0, 600.0]
    >>> bool((individual_cone_fundamentals(waves) - cone_fundamentals(waves)).abs().max() < 0.02)
    True
    """
    densities, shifts = _validate.constants(densities=densities, shifts=shifts)
    nm = torch.as_tensor(_validate.real("wavelengths", wavelengths), dtype=torch.float64)
    if nm.ndim != 1 or not len(nm) or float(nm.min()) < AXIS[0] or float(nm.max()) > AXIS[-1]:
        raise ValueError(f"wavelengths must be a list of numbers from 390 to 780 nanometres, got {wavelengths!r:.80}")
    lens, macular = (_validate.constant(name, one, least=0) for name, one in (("lens", lens), ("macular", macular)))
    densities = [float(one) for one in _validate.several("densities", densities, 3, positive=True)]
    shifts = [float(one) for one in _validate.several("shifts", shifts, 3)]
    whole = torch.tensor(AXIS, dtype=torch.float64)
    peaks = _fundamentals(whole, lens, macular, densities, shifts).amax(1, keepdim=True)
    return _fundamentals(nm, lens, macular, densities, shifts) / peaks


def _fundamentals(nm, lens, macular, densities, shifts):
    *absorbances, macula, eye_lens = _table("pigments").T.tolist()
    filters = macular / MACULAR_PEAK * _density(nm, macula, 375.0, 550.0) * MACULAR_SCALE
    filters = filters + lens / LENS_AT_400 * _density(nm, eye_lens, 360.0, 660.0) * LENS_SCALE
    found = []
    for (name, peak), series, density, shift in zip(PEAKS.items(), absorbances, densities, shifts, strict=True):
        moves = [(1.0, shift)]
        if name == "L":
            moves = [(L_SCALE * share, shift + step) for share, step in zip(SHARES, (0.0, VARIANT), strict=True)]
        angle = (torch.log10(nm) - LOG_START + math.log10(peak)) / LOG_STEP
        absorbance = sum(
            share * 10 ** _series(angle - math.log10(peak + move) / LOG_STEP, series) for share, move in moves
        )
        found.append(nm * (1 - 10 ** (-density * absorbance)) * 10**-filters)
    return torch.stack(found)


def _density(nm, series, start, end):
    """Return a density over the wavelength, whose series runs over half a period from `start` to `end`."""
    return _series(math.pi * (nm - start) / (end - start), series).where((nm >= start) & (nm <= end), 0.0)


def _series(angle, series):
    total = series[0] + 0 * angle
    for order in range(1, len(series) // 2 + 1):
        total = total + series[2 * order - 1] * torch.cos(order * angle) + series[2 * order] * torch.sin(order * angle)
    return total


def sample_observers(number: int, wavelengths: torch.Tensor | Sequence[float] = AXIS, seed: int = 0) -> torch.Tensor:
    """Return the cone fundamentals of people drawn at random.

    Parameters
    ----------
    number : int
        Of people.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, 390 to 780.
    seed : int
        Of the draw.

    Returns
    -------
    torch.Tensor
        ``[number, 3, S]``, float64.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Densities of lens, macula and pigments, and peaks of pigments, are normally distributed about the standard
    observer's, with the deviations of Asano, Fairchild and Blondé, PLoS ONE 11, e0145671 (2016), doi
    10.1371/journal.pone.0145671: 18.7 % for the lens, 36.5 % for the macula, 9, 9 and 7.4 % for the densities and 2,
    1.5 and 1.3 nm for the peaks of the L, M and S pigments. Densities stay above a twentieth of their means. Age, which
    changes the lens, is not varied.

    Examples
    --------
    >>> from odak.learn.perception import sample_observers
    >>> sample_observers(5, [450.0, 550.0]).shape
    torch.Size([5, 3, 2])
    """
    number = _validate.integer("number", number, minimum=1)
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    draws = torch.randn(number, 8, dtype=torch.float64, generator=generator).tolist()
    people = []
    for lens, macular, *rest in draws:
        density = [
            mean * max(0.05, 1 + spread * draw)
            for mean, spread, draw in zip(DENSITIES, DENSITY_SPREADS, rest[:3], strict=True)
        ]
        shifts = [spread * draw for spread, draw in zip(PEAK_SPREADS, rest[3:], strict=True)]
        people.append(
            individual_cone_fundamentals(
                wavelengths,
                LENS_AT_400 * max(0.05, 1 + LENS_SPREAD * lens),
                MACULAR_PEAK * max(0.05, 1 + MACULAR_SPREAD * macular),
                density,
                shifts,
            )
        )
    return torch.stack(people)


class MetamericFailure(NamedTuple):
    """Differences that individual observers see in a match of the standard observer.

    Attributes
    ----------
    differences : torch.Tensor
        CIEDE2000 difference for each person, ``[N]``.
    weights : torch.Tensor
        Of the three primaries in the match of the standard observer, ``[3]``.

    Examples
    --------
    A target that is one of the primaries is matched by it alone, for everybody:

    >>> import torch
    >>> from odak.learn.perception import metameric_failure, sample_observers
    >>> waves = torch.arange(390.0, 781.0, dtype=torch.float64)
    >>> lasers = torch.stack([torch.exp(-((waves - peak) ** 2) / 2) for peak in (638.0, 520.0, 450.0)])
    >>> found = metameric_failure(lasers, lasers[1], sample_observers(3))
    >>> tuple(found.differences.shape), bool(found.differences.max() < 1e-6)
    ((3,), True)
    """

    differences: torch.Tensor
    weights: torch.Tensor


def metameric_failure(
    primaries: torch.Tensor,
    reference: torch.Tensor,
    observers: torch.Tensor,
    wavelengths: torch.Tensor | Sequence[float] = AXIS,
) -> MetamericFailure:
    """Return individual observers' colour differences of a display and a light that match for the standard one.

    Parameters
    ----------
    primaries : torch.Tensor
        Spectra of a display's three primaries ``[3, S]``.
    reference : torch.Tensor
        Spectrum of the light that the display shall match ``[S]``, to which each person adapts.
    observers : torch.Tensor
        Cone fundamentals ``[N, 3, S]``, as :func:`sample_observers` gives them.
    wavelengths : torch.Tensor or sequence of float
        Of the samples, in equal steps, in nanometres.

    Returns
    -------
    MetamericFailure
        Differentiable in the spectra.

    Raises
    ------
    ValueError, TypeError
        If shapes do not fit, or the primaries cannot match the reference.

    Notes
    -----
    The standard observer is :func:`cone_fundamentals`. Each person's cone responses to the display are divided by the
    responses to the reference (von Kries). The standard observer's responses to the reference are multiplied by this
    ratio, and turned into XYZ by the matrix that fits the CIE 1931 functions best.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import illuminant_d65, metameric_failure, sample_observers
    >>> waves = torch.arange(390.0, 781.0, dtype=torch.float64)
    >>> lasers = torch.stack([torch.exp(-((waves - peak) ** 2) / 2) for peak in (638.0, 520.0, 450.0)])
    >>> found = metameric_failure(lasers, illuminant_d65(waves), sample_observers(20))
    >>> bool(found.differences.mean() > 1)
    True
    """
    standard = cone_fundamentals(wavelengths).double()
    matching = color_matching_functions(wavelengths).double()
    spectra = {"primaries": (primaries, 2), "reference": (reference, 1), "observers": (observers, 3)}
    for name, (value, axes) in spectra.items():
        floating_tensor(name, value)
        if value.ndim != axes or value.shape[-1] != standard.shape[-1]:
            raise ValueError(f"{name} must have {standard.shape[-1]} wavelengths, got {tuple(value.shape)}")
        _validate.real(name, value.detach())
    _validate.one_device(primaries=primaries, reference=reference, observers=observers)
    standard, matching = standard.to(primaries.device), matching.to(primaries.device)
    if primaries.shape[0] != 3 or observers.shape[1] != 3:
        raise ValueError(
            f"primaries must be [3, S] and observers [N, 3, S], got {tuple(primaries.shape)}, {tuple(observers.shape)}"
        )
    primaries, reference, observers = primaries.double(), reference.double(), observers.double()
    mixing = standard @ primaries.T
    if not float(torch.linalg.cond(mixing.detach())) <= 1e8:
        raise ValueError("primaries must be three that the cones can distinguish")
    weights = torch.linalg.solve(mixing, standard @ reference)
    shown, wanted = observers @ (primaries.T @ weights), observers @ reference
    to_xyz = torch.linalg.lstsq(standard.T, matching.T).solution.T
    white = to_xyz @ (standard @ reference)
    seen = (shown / wanted * (standard @ reference)) @ to_xyz.T / white[1]
    white = white / white[1]
    lab = xyz_to_lab(torch.cat([seen, white[None]])[:, :, None, None], white)
    differences = ciede2000(lab[:-1], lab[-1:].expand_as(lab[:-1]))
    return MetamericFailure(differences.reshape(-1), weights)
