"""Older call forms, translated in one place so that the physics never sees them."""

import functools
import inspect
from collections.abc import Callable

import torch

from odak import _validate
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
    own = list(inspect.signature(function).parameters)

    @functools.wraps(function)
    def adapted(*args, **options):
        args = list(args)
        if not args and own[0] in options:
            args = [options.pop(own[0])]
        resolution = options.pop("resolution", None)
        if len(args) > 4 and hasattr(args[4], "__len__") and not isinstance(args[4], str):
            resolution = args.pop(4)
        for old, new in (("dx", "pixel_pitch"), ("iteration_number", "n_iteration")):
            if old in options and old not in own:
                options[new] = options.pop(old)
        if args and isinstance(args[0], torch.Tensor):
            shape = tuple(args[0].shape[-2:])
            if resolution is not None and _validate.size("resolution", resolution) != shape:
                raise ValueError(f"resolution must be the {own[0]}'s {shape}, got {tuple(resolution)}")
            if "cuda" in options:
                args[0] = args[0].to(get_device("cuda" if options.pop("cuda") else "cpu"))
        return function(*args, **options)

    return adapted
