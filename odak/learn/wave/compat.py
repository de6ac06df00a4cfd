"""Older call forms, translated in one place so that the physics never sees them."""

import functools
from collections.abc import Callable, Sequence

import torch

from odak.learn.tools.device import get_device


def accepts_older_form(function: Callable) -> Callable:
    """Let an optimizer be called as ``f(target, wavelength, distance, dx, resolution, propagation_type, count, …)``.

    The older form has a resolution at the fifth place, the keyword `dx` for `pixel_pitch`, `iteration_number` for
    `n_iteration`, and `cuda`.

    Parameters
    ----------
    function : callable
        The optimizer in its present form.

    Returns
    -------
    callable
        The optimizer, accepting both.
    """

    @functools.wraps(function)
    def adapted(target, *args, **options):
        args = list(args)
        resolution = options.pop("resolution", None)
        if len(args) > 3 and isinstance(args[3], Sequence) and not isinstance(args[3], str):
            resolution = args.pop(3)
        for old, new in (("dx", "pixel_pitch"), ("iteration_number", "n_iteration")):
            if old in options:
                options[new] = options.pop(old)
        if (
            resolution is not None
            and isinstance(target, torch.Tensor)
            and tuple(resolution) != tuple(target.shape[-2:])
        ):
            raise ValueError(f"resolution must be the target's {tuple(target.shape[-2:])}, got {tuple(resolution)}")
        if "cuda" in options:
            target = target.to(get_device("cuda" if options.pop("cuda") else "cpu"))
        return function(target, *args, **options)

    return adapted
