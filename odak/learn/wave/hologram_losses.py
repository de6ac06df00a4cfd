"""What hologram optimizers aim at: targets, the weights of losses, and how a given loss is called."""

import inspect
from collections.abc import Callable, Iterable, Sequence

import torch

from odak import _validate
from odak.learn._tensors import floating
from odak.learn.tools.file import torch_load
from odak.learn.wave.masks import disc
from odak.tools._paths import validate_path

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
    unknown = sorted(set(map(str, given)) - set(defaults))
    if unknown:
        raise ValueError(f"weights must be of {', '.join(defaults)}; got {', '.join(map(repr, unknown))}")
    for name, value in given.items():
        if _validate.real(f"weights[{name!r}]", value) < 0:
            raise ValueError(f"weights[{name!r}] must not be negative, got {value}")
    weights = defaults | {name: float(value) for name, value in given.items()}
    if not any(weights.values()):
        raise ValueError(f"weights must hold one above zero, got {given!r}")
    return weights


def keywords_of(loss: Callable) -> set[str]:
    """Return which of `plane_id`, `noise_ratio` and `inject_noise` a loss takes."""
    parameters = inspect.signature(loss.forward if isinstance(loss, torch.nn.Module) else loss).parameters
    anything = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    return _OF_A_PLANE if anything else _OF_A_PLANE & set(parameters)


def light_loss(powers: torch.Tensor, targets: torch.Tensor, peak: float, reduction: str) -> torch.Tensor:
    """Return how far source powers are from what the brightest pixels need, and how near a frame is to darkness.

    Parameters
    ----------
    powers : torch.Tensor
        Amplitudes of the sources ``[F, C]``.
    targets : torch.Tensor
        Intensities ``[D, C, ms, ns]``.
    peak : float
        Brightness asked for.
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


def checked_targets(targets, shape: tuple[int, ...]) -> torch.Tensor:
    """Return intensities after checking their shape and that they are finite and not negative."""
    if not isinstance(targets, torch.Tensor) or not targets.is_floating_point():
        kind = getattr(targets, "dtype", type(targets).__name__)
        raise TypeError(f"targets must be a real floating tensor, got {kind}")
    if tuple(targets.shape) != shape:
        raise ValueError(f"targets must be {shape}, got {tuple(targets.shape)}")
    if not bool(targets.isfinite().all()):
        raise ValueError("targets must be finite, got NaN or infinite values")
    if bool((targets < 0).any()):
        raise ValueError(f"targets must not be negative, got {targets.min().item()}")
    return targets.detach()


def check_pair(input_image, target_image) -> None:
    """Raise ValueError or TypeError unless an image and its target are real tensors of one shape."""
    for name, image in (("input_image", input_image), ("target_image", target_image)):
        if not isinstance(image, torch.Tensor) or image.is_complex():
            raise TypeError(f"{name} must be a real tensor, got {getattr(image, 'dtype', type(image).__name__)}")
    if not input_image.ndim:
        raise ValueError("input_image must be [colours, rows, columns], got a number")
    _validate.alike(input_image=input_image, target_image=target_image)


def checked_eyebox(eyebox: dict | None) -> dict:
    """Return offset and diameter of an eyebox in samples, the usual ones where they are not given."""
    usual = {"offset": 0.0, "diameter": 100}
    if eyebox is not None and not isinstance(eyebox, dict):
        raise TypeError(f"eyebox must be a dictionary of offset and diameter, got {eyebox!r:.80}")
    if unknown := set(map(str, eyebox or {})) - set(usual):
        raise ValueError(f"eyebox must hold offset and diameter, got {', '.join(sorted(unknown))}")
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
    alone = not isinstance(offset, Iterable) or getattr(offset, "ndim", 1) == 0
    shift = _validate.numbers(_validate.several("offset", (offset, offset) if alone else offset, 2))
    mask = disc(shape, _validate.real("diameter", diameter, positive=True) / 2, shift)
    if not bool(mask.any()):
        raise ValueError(f"the eyebox must hold a sample of the spectrum, got offset {offset} and diameter {diameter}")
    return torch.fft.ifftshift(mask)


def powers_from(filename, shape: tuple[int, int]) -> torch.Tensor:
    """Return the channel powers ``[F, C]`` in a file, clipped to 0 … 1."""
    path = validate_path(filename, name="channel_power_filename")
    powers = torch_load(path)
    if not isinstance(powers, torch.Tensor) or tuple(powers.shape) != shape:
        got = list(powers.shape) if isinstance(powers, torch.Tensor) else type(powers).__name__
        raise ValueError(f"channel_power_filename {path!r} must hold a tensor {list(shape)}, got {got}")
    return floating("channel_power_filename", powers).clamp(0, 1)
