"""Flicker and eyes that move: contrast sensitivity in space and time (stelaCSF), its loss, sums on a moving retina."""

import math
from collections.abc import Callable
from typing import Any

import torch
from torch.nn import functional

from odak import _validate
from odak.learn._tensors import as_pictures, check_loss_inputs, check_values, in_float32, tensor
from odak.learn.perception.csf import CSFLoss, half_spectrum_weights, not_negative, positive_numbers
from odak.learn.perception.sight import Gaze, Viewing, gaze_of

# stelaCSF: peak sensitivity and its frequency by luminance, width of the parabola and where it is cut.
_SUSTAINED = (
    (68.9501, 59.5023, 0.164274, 7.54866e-07, 7.77268e09),
    (1.62144, 36.6565, 0.255823),
    0.000219263,
    0.103686,
)
_TRANSIENT = ((0.500846, 57.3469), (0.0267489,), 1.75147, 0.000273289)
# Power of the temporal frequency and width of the response of each channel; the peak of the second in hertz.
_SLOW, _FAST, _PEAK = (1.3314, 5.79336), (0.1898, 0.12314), 5.0
# Fall of log₁₀ sensitivity per degree of eccentricity, and per degree and cycle per degree.
_FALL, _FALL_BY_FREQUENCY = 0.0296662, 0.0190062
# Spatial integration: area in square degrees and frequency in cycles per degree (Rovamo, Luntinen and Näsänen 1993).
_LARGEST_AREA, _CORNER = 270.0, 0.65
# Lowest spatial frequency for which the model was fitted, and the highest temporal frequency that counts.
_LOWEST, _HIGHEST = 1 / 16, 100.0


def stela_contrast_sensitivity(
    frequency: torch.Tensor | float,
    temporal_frequency: torch.Tensor | float = 0.0,
    luminance: torch.Tensor | float = 100.0,
    eccentricity: torch.Tensor | float = 0.0,
    area: torch.Tensor | float = 7.07,
) -> torch.Tensor:
    """Return the sensitivity of the eye to the contrast of luminance in space and time, by stelaCSF.

    Parameters
    ----------
    frequency : torch.Tensor or float
        In cycles per degree, positive; fitted from 1/16 to 64.
    temporal_frequency : torch.Tensor or float
        In hertz, 0 or more.
    luminance : torch.Tensor or float
        Mean of the pattern in cd/m², positive; fitted from 0.001 to 10 000.
    eccentricity : torch.Tensor or float
        In degrees, 0 or more, outside of the nasal visual field.
    area : torch.Tensor or float
        Of the pattern in square degrees, positive; that of a disc of 1.5° radius by default.

    Returns
    -------
    torch.Tensor
        Sensitivity of the broadcast shape, float64 of plain numbers: one over the contrast at threshold.
        Differentiable in all five.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.

    Notes
    -----
    Mantiuk, Ashraf and Chapiro, ACM Trans. Graph. 41, 145 (2022), doi 10.1145/3528223.3530115, with the parameters of
    its release of April 2022: a sustained and a transient channel, each a parabola of the logarithm of the frequency.

    Examples
    --------
    Fine patterns are seen best at rest, coarse ones as they flicker:

    >>> from odak.learn.perception import stela_contrast_sensitivity
    >>> [round(stela_contrast_sensitivity(4.0, w).item()) for w in (0.0, 8.0, 30.0)]
    [314, 169, 15]
    >>> [round(stela_contrast_sensitivity(0.25, w).item()) for w in (0.0, 8.0, 30.0)]
    [37, 176, 17]
    """
    frequency, luminance, area = positive_numbers(frequency=frequency, luminance=luminance, area=area)
    slow = not_negative("temporal_frequency", temporal_frequency).to(frequency)
    eccentricity = not_negative("eccentricity", eccentricity).to(frequency)
    _validate.fitting(
        frequency=frequency, temporal_frequency=slow, luminance=luminance, eccentricity=eccentricity, area=area
    )
    # The slope of ω^0.19 at rest would be infinite.
    fast = slow.clamp_min(1e-9)
    sustained = torch.exp(-(slow ** _SLOW[0]) / _SLOW[1])
    transient = torch.exp(-((fast ** _FAST[0] - _PEAK ** _FAST[0]) ** 2) / _FAST[1])
    total = sustained * _channel(frequency, luminance, *_SUSTAINED)
    total = total + transient * _channel(frequency, luminance, *_TRANSIENT)
    summed = _LARGEST_AREA / (1 + (frequency / _CORNER) ** 2)
    total = total * frequency * (summed / (1 + summed / area)).sqrt()
    return total * 10 ** (-(_FALL + _FALL_BY_FREQUENCY * frequency) * eccentricity)


def _channel(frequency, luminance, peak, place, width, cut):
    """Return the sensitivity of a channel before spatial integration: a parabola that is cut below its peak."""
    peak, place = _by_luminance(luminance, *peak), _by_luminance(luminance, *place)
    away = torch.log10(frequency / place)
    parabola = 10 ** (-(away**2) / 2**width)
    return peak * torch.where((away < 0) & (parabola < 1 - cut), 1 - cut, parabola)


def _by_luminance(luminance, first, second=None, third=None, fourth=None, fifth=None):
    """Return a parameter: a constant, a power of the luminance, or one or two hyperbolas."""
    if second is None:
        return torch.full_like(luminance, first)
    if third is None:
        return second * luminance**first
    rising = first * (1 + second / luminance) ** -third
    # The last power is huge for a base near 1.
    return rising if fourth is None else rising * -torch.expm1(-fifth * torch.log1p(fourth / luminance))


class FlickerLoss(CSFLoss):
    """Visible flicker of frames that are shown again and again, in squared multiples of the threshold.

    Every change of luminance in time is a sum of gratings that flicker or drift, each of which weighs as many times as
    it exceeds the threshold: one at its threshold costs 1. Frames that do not change cost nothing.

    Parameters
    ----------
    frames_per_second : float
        Rate at which frames follow.
    persistence : float
        Share of its time for which a frame is lit, above 0 and up to 1; its mean luminance over the time stays.
    eccentricity : float
        In degrees, at which the frames are seen.
    encoding : {"sRGB", "linear"}
        Encoding of the frames.
    viewing : Viewing, optional
        Geometry and luminances.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of its range.

    Notes
    -----
    Sensitivity: :func:`stela_contrast_sensitivity`, at the luminance that is the mean of all frames, up to 100 Hz.
    Spatial frequencies below 1/16 cycle per degree count as that. A frame that is lit for a share p has the transfer
    sinc(f·p/rate). Changes of colour alone do not count.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FlickerLoss
    >>> frames = torch.stack([torch.full((1, 16, 16), level) for level in (0.45, 0.55)])[None]
    >>> [bool(FlickerLoss(rate)(frames) > 1) for rate in (20.0, 240.0)]
    [True, False]
    """

    def __init__(
        self,
        frames_per_second: float,
        persistence: float = 1.0,
        eccentricity: float = 0.0,
        encoding: str = "sRGB",
        *,
        viewing: Viewing | None = None,
    ) -> None:
        super().__init__(encoding=encoding, viewing=viewing)
        self.frames_per_second: float = _validate.constant("frames_per_second", frames_per_second, positive=True)
        self.persistence: float = _validate.constant("persistence", persistence, positive=True, most=1)
        self.eccentricity: float = _validate.constant("eccentricity", eccentricity, least=0)

    def forward(self, frames: torch.Tensor) -> torch.Tensor:  # type: ignore[override]
        """Return the loss.

        Parameters
        ----------
        frames : torch.Tensor
            ``[B, F, C, H, W]``, one or three channels, nominally 0 … 1.

        Returns
        -------
        torch.Tensor
            The mean over the batch, without axes; 0 for equal frames without gaps.

        Raises
        ------
        ValueError, TypeError
            If the frames are not as said.
        """
        as_pictures("frames", frames, None)
        _validate.shaped("frames", frames, "[B, F, C, H, W], none empty")
        check_values(frames=frames)
        light = self._luminance(in_float32(frames).flatten(0, 1)).unflatten(0, frames.shape[:2])[:, :, 0]
        mean = light.detach().mean((1, 2, 3), keepdim=True).clamp_min(self.viewing.darkest)
        spectrum = torch.fft.fft(torch.fft.rfft2(light / mean, norm="forward"), dim=1, norm="forward")
        frequencies = self._frequencies(light).clamp_min(_LOWEST)
        weights, count, total = half_spectrum_weights(light), frames.shape[1], light.new_zeros(len(light))
        for k in range(1, math.floor(_HIGHEST * count / self.frames_per_second) + 1):
            flicker = k * self.frames_per_second / count
            gain = stela_contrast_sensitivity(
                frequencies, flicker, mean[:, 0], self.eccentricity, self._size(light) ** 2
            ) * torch.sinc(light.new_tensor(k * self.persistence / count))
            both = [spectrum[:, sign * k % count] for sign in (1, -1)]
            power = sum(one.real**2 + one.imag**2 for one in both)
            total = total + (weights * gain**2 * power).sum((-2, -1))
        return total.mean()


def retinal_image(frames: torch.Tensor, gaze: Gaze) -> torch.Tensor:
    """Return what a retina adds up that moves with the gaze while frames are shown: their mean, each displaced.

    Colours that are shown one after another then break up at edges.

    Parameters
    ----------
    frames : torch.Tensor
        Light ``[F, C, H, W]``.
    gaze : torch.Tensor or sequence
        (x, y) during each frame, 0 to 1 from the top-left corner ``[F, 2]``, as :meth:`GazeTrace.at` returns it.

    Returns
    -------
    torch.Tensor
        ``[1, C, H, W]``, around the gaze of the first frame, black outside of the display. Differentiable in both.

    Raises
    ------
    ValueError, TypeError
        If there is not one gaze for each frame.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import retinal_image
    >>> frames = torch.zeros(2, 3, 1, 4)
    >>> frames[0, 0, 0, 1] = frames[1, 1, 0, 1] = 2.0
    >>> retinal_image(frames, torch.tensor([[0.5, 0.5], [0.75, 0.5]]))[0, :2, 0].tolist()
    [[0.0, 1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    """
    as_pictures("frames", frames, None)
    _validate.shaped("frames", frames, "[F, C, H, W], none empty")
    places = tensor("gaze", gaze, frames.dtype, frames.device)
    _validate.shaped("gaze", places, f"[{len(frames)}, 2], a row for each frame")
    columns, rows = frames.shape[-1], frames.shape[-2]
    x, y = ((2 * torch.arange(side).to(frames) + 1) / side - 1 for side in (columns, rows))
    grid = torch.stack(torch.meshgrid(x, y, indexing="xy"), -1) + 2 * (places - places[:1])[:, None, None]
    return functional.grid_sample(frames, grid, align_corners=False).mean(0, keepdim=True)


def sequence_loss(
    loss: Callable[[torch.Tensor, torch.Tensor, Gaze], torch.Tensor],
    image: torch.Tensor,
    target: torch.Tensor,
    gaze: Gaze,
    *,
    backward: bool = False,
) -> torch.Tensor:
    """Return the mean of a loss over frames, each with its gaze; its maps are made once for each gaze that occurs.

    Parameters
    ----------
    loss : callable
        Of frames, their targets and one gaze, such as a metameric loss.
    image : torch.Tensor
        Frames ``[F, C, H, W]``.
    target : torch.Tensor
        What they are compared with, in the same shape.
    gaze : torch.Tensor or sequence
        ``[F, 2]``; frames of one fixation have equal rows.
    backward : bool
        Add the gradients to the leaves of the graph of `image` as each gaze has been compared, after which its memory
        is free again, and return a number without a graph.

    Returns
    -------
    torch.Tensor
        Without axes.

    Raises
    ------
    ValueError, TypeError
        If there is not one gaze for each frame.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import MetamericLoss, sequence_loss
    >>> frames, gaze = torch.rand(4, 1, 64, 64), [[0.2, 0.5], [0.2, 0.5], [0.8, 0.5], [0.8, 0.5]]
    >>> sequence_loss(MetamericLoss(n_pyramid_levels=2), frames, frames, gaze).item()
    0.0
    """
    _validate.function("loss", loss)
    for name, value in (("image", image), ("target", target)):
        as_pictures(name, value, None)
        _validate.shaped(name, value, "[F, C, H, W], none empty")
    check_loss_inputs("sequence_loss", image, target)
    places: dict[Any, list[int]] = {}
    rows = tensor("gaze", gaze, torch.float64).tolist()
    if len(rows) != len(image):
        raise ValueError(f"gaze must have a row for each of {len(image)} frames, got {len(rows)}")
    for index, row in enumerate(rows):
        places.setdefault(gaze_of("gaze", row), []).append(index)
    parts = []
    for place, indices in places.items():
        part = loss(image[indices], target[indices], place) * (len(indices) / len(image))
        if _validate.flag("backward", backward):
            part.backward()
            part = part.detach()
        parts.append(part)
    return torch.stack(parts).sum()
