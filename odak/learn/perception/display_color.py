"""Spectra of displays and observers, and the cone responses and opponent colours that a display causes."""

import csv
import functools
import os
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.optimize import least_squares
from torch import nn

from odak import _array, _validate
from odak.learn._tensors import as_pictures, checked_device, floating, in_float32
from odak.learn.perception.color import mix

CONE_GAUSSIANS = ((567.5, 32.5), (545.0, 27.5), (447.5, 17.0))
BACKLIGHT_GAUSSIANS = ((650.0, 14.5), (550.0, 12.0), (450.0, 12.0))
_TABLES = {
    "CIE 170": "cone_fundamentals_cie_170_2_degree.csv",
    "CIE 1931": "observer_cie_1931_2_degree.csv",
    "D65": "illuminant_cie_d65.csv",
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
        If the wavelengths are not a list of real numbers, or all below 1, as those in metres are.

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
        If the wavelengths are not a list of real numbers, or all below 1, as those in metres are.

    Examples
    --------
    >>> from odak.learn.perception import illuminant_d65
    >>> illuminant_d65([560.0]).item()
    100.0
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
    if not isinstance(path, (str, os.PathLike)):
        raise TypeError(f"path must be a string or a path, got {type(path).__name__}")
    if "\0" in os.fspath(path):
        raise ValueError(f"path must not hold a null byte, got {path!r}")
    try:
        lines = _numbers_of(Path(path).read_text(encoding="utf-8-sig"))
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
    # Wavelengths in metres would be beyond all tables, where spectra are zero.
    if _array.is_readable(axis) and bool((axis.detach() < 1).all()):
        raise ValueError(f"{name} must be in nanometres, got {axis.detach().tolist()!r:.80}")
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
    if not isinstance(dataset, (torch.Tensor, np.ndarray)):
        raise TypeError(f"dataset must be a tensor or an array, got {type(dataset).__name__}")
    if "complex" in str(dataset.dtype):
        raise TypeError(f"dataset must be real, got {dataset.dtype}")
    table = dataset.detach().cpu().double().numpy() if isinstance(dataset, torch.Tensor) else dataset
    if table.ndim != 2 or 2 not in table.shape or table.size < 4:
        raise ValueError(f"dataset must be [N, 2] or [2, N], got {tuple(table.shape)}")
    table = (table if table.shape[1] == 2 else table.T).astype(float)
    if not np.isfinite(table).all():
        raise ValueError("dataset must hold finite numbers")
    return table[np.argsort(table[:, 0])]


FIRST, LAST = 400, 700
OPPONENT = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))


class display_color_hvs(nn.Module):
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
        primaries_spectrum: torch.Tensor | str | os.PathLike | None = None,
        device: torch.device | str = torch.device("cpu"),  # noqa: B008
        *,
        cones: str = "Gaussian",
    ):
        super().__init__()
        self.resolution = resolution
        self.distance_from_screen = distance_from_screen
        self.pixel_pitch = pixel_pitch
        self.read_spectrum = read_spectrum
        self.cones = _validate.one_of("cones", cones, ("Gaussian", "CIE 170"))
        self._keep("primaries_spectrum", _checked_spectra(primaries_spectrum).to(checked_device("device", device)))
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

    def forward(self, input_image: torch.Tensor, ground_truth: torch.Tensor, gaze: Any = None) -> torch.Tensor:
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

    def initialize_random_spectrum_normalized(self, dataset: Any) -> torch.Tensor:
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
        _validate.number("wavelength", wavelength, positive=True)
        if len(_validate.numbers(_validate.real("function", function))) != LAST - FIRST + 1:
            raise ValueError(
                f"function must hold {LAST - FIRST + 1} numbers, at {FIRST} … {LAST} nm, got {len(function)}"
            )
        return float(function[min(max(round(float(wavelength)), FIRST), LAST) - FIRST])

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
    if not isinstance(spectra, torch.Tensor) or not spectra.is_floating_point():
        kind = getattr(spectra, "dtype", type(spectra).__name__)
        raise TypeError(f"primaries_spectrum must be a tensor of real floats or a file, got {kind}")
    if spectra.ndim != 2 or spectra.shape[0] == 0 or spectra.shape[1] < 2:
        raise ValueError(f"primaries_spectrum must be [P, S] with two samples or more, got {tuple(spectra.shape)}")
    return _validate.real("primaries_spectrum", spectra)
