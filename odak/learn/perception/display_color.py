"""A display seen by three kinds of cones: from the spectra of its primaries to opponent colours."""

import os
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from odak import _validate
from odak.learn._tensors import checked_device, floating
from odak.learn.perception.color_matrices import as_pictures, mix
from odak.learn.perception.spectra import (
    BACKLIGHT_GAUSSIANS,
    CONE_GAUSSIANS,
    cone_fundamentals,
    gaussian_lines,
    read_spectra,
)
from odak.learn.perception.spectrum_fit import fitted_spectrum

FIRST, LAST = 400, 700
OPPONENT = ((-1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 1.0))


class display_color_hvs(nn.Module):
    """How a display excites the cones of a viewer, and how far apart two of its pictures are in opponent colours.

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
        Where the display lives.
    cones : {"Gaussian", "CIE 170"}
        Sensitivities of :func:`cone_fundamentals`.

    Attributes
    ----------
    primaries_spectrum : torch.Tensor
        ``[P, S]``.
    l_normalized, m_normalized, s_normalized : torch.Tensor
        Sensitivities ``[S]``; also spelt ``l_normalised`` and so on.
    lms_tensor, primaries_tensor : torch.Tensor
        Response of each cone to each primary, ``[P, 3]`` and ``[3, P]``.

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
        """Where the display lives."""
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
            The loss, without axes; 0 for equal pictures.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, or the pictures do not have P channels of real floats.
        """
        as_pictures("input_image", input_image, len(self.lms_tensor))
        as_pictures("ground_truth", ground_truth, len(self.lms_tensor))
        _validate.alike(input_image=input_image, ground_truth=ground_truth)
        stages = [self.second_to_third_stage(self.primaries_to_lms(picture)) for picture in (input_image, ground_truth)]
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
        """Return Σ cone·light over the samples, without axes; it grows with their number."""
        cone_spectrum = floating("cone_spectrum", cone_spectrum)
        light_spectrum = floating("light_spectrum", light_spectrum)
        _validate.fitting(cone_spectrum=cone_spectrum, light_spectrum=light_spectrum)
        return (cone_spectrum * light_spectrum).sum()

    def construct_matrix_lms(
        self, l_response: torch.Tensor, m_response: torch.Tensor, s_response: torch.Tensor
    ) -> torch.Tensor:
        """Return and keep as ``lms_tensor`` the response of each cone to each primary, ``[P, 3]``."""
        self.lms_tensor = self._responses(l_response, m_response, s_response)
        return self.lms_tensor

    def construct_matrix_primaries(
        self, l_response: torch.Tensor, m_response: torch.Tensor, s_response: torch.Tensor
    ) -> torch.Tensor:
        """Return and keep as ``primaries_tensor`` the response of each cone to each primary, ``[3, P]``."""
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
        """Return the intensities of the primaries that excite the cones as given.

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
        """Return :meth:`primaries_to_lms`."""
        return self.primaries_to_lms(as_pictures("rgb", rgb, len(self.lms_tensor)))

    def lms_to_rgb(self, lms: torch.Tensor) -> torch.Tensor:
        """Return :meth:`lms_to_primaries`."""
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
        # Derived from the constructor's arguments, so no part of a stored state.
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
