"""Terms of the losses of hologram optimizers: targets, weights, light sources, eyebox and phase constraints."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any

import torch

from odak import _validate
from odak.learn._tensors import floating, real_tensor
from odak.learn.tools.file import torch_load
from odak.learn.tools.loss import multi_scale_total_variation_loss
from odak.learn.wave.fields import disc, unit_phasor
from odak.learn.wave.training import checked_intensities, parameters_of
from odak.tools.paths import validate_path
from odak.wave.fields import decompose_double_phase

WEIGHTS = {"image": 1.0, "light": 1.0, "eyebox": 1.0, "phase": 0.0}
_OLDER_ORDER = ("image", "light", "phase", "eyebox")
_OF_A_PLANE = {"plane_id", "noise_ratio", "inject_noise"}


def loss_weights(given: dict[str, float] | Sequence[float] | None, defaults: dict[str, float]) -> dict[str, float]:
    """Return the weight of each loss.

    Parameters
    ----------
    given : dict or sequence of float, optional
        Weights by name, or in the older order image, light, phase, eyebox.
    defaults : dict
        Weights of those that are not given.

    Returns
    -------
    dict
        A weight for "image", "light", "eyebox" and "phase".

    Raises
    ------
    ValueError, TypeError
        If a loss is not known, or a weight is negative or not finite.
    """
    if given is None:
        return dict(defaults)
    if not isinstance(given, dict):
        given = _validate.several("weights", given)
        if len(given) > len(_OLDER_ORDER):
            raise ValueError(f"weights must be at most {len(_OLDER_ORDER)} ({', '.join(_OLDER_ORDER)}), got {given!r}")
        # A loss that the older form leaves out has no weight.
        given = dict.fromkeys(_OLDER_ORDER, 0.0) | dict(zip(_OLDER_ORDER, given, strict=False))
    _validate.known("weights", given, defaults)
    for name, value in given.items():
        _validate.number(f"weights[{name!r}]", value, least=0)
    weights = defaults | {name: float(value) for name, value in given.items()}
    if not any(weights.values()):
        raise ValueError(f"weights must contain one above zero, got {given!r}")
    return weights


def keywords_of(loss: Callable[..., Any]) -> set[str]:
    """Return which of `plane_id`, `noise_ratio`, `inject_noise` and `generator` a loss takes."""
    parameters = parameters_of(loss)
    anything = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    named = set(parameters) & (_OF_A_PLANE | {"generator"})
    return named | _OF_A_PLANE if anything else named


def light_loss(powers: torch.Tensor, targets: torch.Tensor, peak: float, reduction: str) -> torch.Tensor:
    """Return the difference of source powers from those that the brightest pixels need, and a term against dark frames.

    Parameters
    ----------
    powers : torch.Tensor
        Amplitudes of the sources ``[F, C]``.
    targets : torch.Tensor
        Intensities ``[D, C, ms, ns]``.
    peak : float
        Requested brightness.
    reduction : {"sum", "mean"}
        How colours are put together.

    Returns
    -------
    torch.Tensor
        The loss, without axes (Kavaklı et al. 2023, section 3).
    """
    brightest = targets.amax((0, 2, 3)) * peak
    per_colour = (powers.sum(0) - brightest).square()
    whole = (powers.sum() - len(powers) * peak).square()
    return (per_colour.mean() if reduction == "mean" else per_colour.sum()) + whole + powers.sum(1).amin().cos()


def checked_targets(targets: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
    """Return intensities after checking their shape and that they are finite and not negative."""
    if isinstance(targets, torch.Tensor) and tuple(targets.shape) != shape:
        raise ValueError(f"targets must be {shape}, got {tuple(targets.shape)}")
    return checked_intensities("targets", targets)


def check_pair(input_image: torch.Tensor, target_image: torch.Tensor) -> None:
    """Raise ValueError or TypeError unless an image and its target are real tensors of one shape."""
    for name, image in (("input_image", input_image), ("target_image", target_image)):
        real_tensor(name, image)
    if not input_image.ndim:
        raise ValueError("input_image must be [colours, rows, columns], got a number")
    _validate.alike(input_image=input_image, target_image=target_image)


def checked_eyebox(eyebox: dict[str, Any] | None) -> dict[str, Any]:
    """Return offset and diameter of an eyebox in samples, the usual ones where they are not given."""
    usual = {"offset": 0.0, "diameter": 100}
    _validate.instance("eyebox", eyebox, (dict, type(None)), "a dictionary of offset and diameter")
    _validate.known("eyebox", eyebox or {}, usual)
    return usual | (eyebox or {})


def eyebox_mask(shape: Sequence[int], offset: float | Sequence[float], diameter: float) -> torch.Tensor:
    """Return a disc of the spectrum, ``[rows, columns]`` in FFT order, 1 inside.

    Parameters
    ----------
    shape : sequence of int
        Rows and columns.
    offset : float or sequence of float
        Distance of its centre from zero frequency in samples, of both axes or of each.
    diameter : float
        Its diameter in samples.

    Raises
    ------
    ValueError
        If there is no sample in it.
    """
    shift = _validate.numbers(_validate.pair("offset", offset))
    mask = disc(shape, _validate.real("diameter", diameter, positive=True) / 2, shift)
    if not bool(mask.any()):
        raise ValueError(f"eyebox must contain a sample of the spectrum, got offset {offset} and diameter {diameter}")
    return torch.fft.ifftshift(mask)


def powers_from(filename: str | PathLike[str], shape: tuple[int, int]) -> torch.Tensor:
    """Return the channel powers ``[F, C]`` in a file, clipped to 0 … 1."""
    path = validate_path(filename, name="channel_power_filename")
    powers = torch_load(path)
    if not isinstance(powers, torch.Tensor) or tuple(powers.shape) != shape:
        got = list(powers.shape) if isinstance(powers, torch.Tensor) else type(powers).__name__
        raise ValueError(f"channel_power_filename {path!r} must contain a tensor {list(shape)}, got {got}")
    return floating("channel_power_filename", powers).clamp(0, 1)


def checked_pattern(
    phase: torch.Tensor, offset: torch.Tensor, name: str = "phase", *, of_frames: bool = False
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a phase ``[..., m, n]`` and the offset that goes with it after checking both.

    Parameters
    ----------
    phase, offset : torch.Tensor
        What came.
    name : str
        What the phase is called; the offset is "phase_offset".
    of_frames : bool
        The offset is one for each frame, ``[F]``, rather than one that broadcasts against the phase.
    """
    phase, offset = _validate.image(name, floating(name, phase)), floating("phase_offset", offset)
    _validate.shaped(name, phase, "[m, n], [F, m, n] or [B, F, m, n], not empty")
    offset = offset.reshape(-1, 1, 1) if of_frames else offset
    if _validate.fitting(**{name: phase, "phase_offset": offset}) != tuple(phase.shape):
        raise ValueError(f"phase_offset must fit into {name} {list(phase.shape)}, got {list(offset.shape)}")
    return phase, offset


def checkerboard(phase: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return phase − offset at (even, even) and (odd, odd), phase + offset at the other pixels.

    Parameters
    ----------
    phase : torch.Tensor
        ``[..., m, n]`` in radians.
    offset : torch.Tensor
        Broadcasts against `phase`.

    Returns
    -------
    torch.Tensor
        ``[..., m, n]``.
    """
    rows, columns = (torch.arange(n, device=phase.device) for n in phase.shape[-2:])
    signs = ((rows[:, None] + columns) % 2 * 2 - 1).to(phase.dtype)
    return torch.addcmul(phase, signs, offset)


def zero_mean(phase: torch.Tensor) -> torch.Tensor:
    """Return the phase ``[..., m, n]`` of each frame less its mean."""
    return phase - phase.mean((-2, -1), keepdim=True)


def roughness(phase: torch.Tensor, levels: int = 6) -> torch.Tensor:
    """Return the total variation of a phase ``[..., m, n]`` over so many sizes, each half of the one before."""
    levels = _validate.whole("levels", levels, minimum=1)
    # Frames smaller than that have fewer sizes.
    return multi_scale_total_variation_loss(phase, min(levels, min(phase.shape[-2:]).bit_length()))


def double_phase_roughness(phase: torch.Tensor, levels: int = 6) -> torch.Tensor:
    """Return the total variation and the standard deviation of the two parts of a double phase ``[F, m, n]``."""
    return sum(roughness(part, levels) + part.std() for part in decompose_double_phase(phase))


def eyebox_loss(phase: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the non-uniformity of the intensity in an eyebox of the Fourier plane, and the share outside it.

    Parameters
    ----------
    phase : torch.Tensor
        Phases ``[F, m, n]`` in radians.
    mask : torch.Tensor
        ``[m, n]`` in FFT order, 1 inside the eyebox.

    Returns
    -------
    torch.Tensor
        Mean over the frames of variance/mean² of the spectrum's amplitude inside, plus the share of it outside.
    """
    amplitude = torch.fft.fft2(unit_phasor(phase), norm="ortho").abs()
    inside = amplitude * mask
    within, whole = inside.sum((-2, -1)), amplitude.sum((-2, -1))
    mean = within / mask.sum()
    variance = (inside.square().sum((-2, -1)) / mask.sum() - mean.square()).clamp_min(0)
    return (variance / mean.square() + 1 - within / whole).mean()
