"""Conversion of older call forms of hologram functions to the present ones."""

import functools
import inspect
from collections.abc import Callable
from numbers import Integral

import torch

from odak import _validate
from odak._warnings import ArgumentWarning, warn
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


_DESCENT_NAMES = ("field", "wavelength", "distance", "dx")
_DESCENT_OPTIONS = ("propagation_type", "n_iterations", "loss_function", "learning_rate")
_RENAMED = {"pixel_pitch": "dx", "n_iteration": "n_iterations", "iteration_number": "n_iterations"}
_WITHOUT_EFFECT = ("loss_function", "learning_rate", "optimizer", "scale")


def accepts_descent_form(function: Callable) -> Callable:
    """Let Gerchberg–Saxton be called with the arguments of `stochastic_gradient_descent`, present or older.

    The form is recognised by a wavelength at the second place, or the keyword `target`, which is then an intensity.
    Arguments that alternating projections have no use for are named in an ArgumentWarning.

    Parameters
    ----------
    function : callable
        `gerchberg_saxton` in its own form.

    Returns
    -------
    callable
        The function, accepting both.
    """
    older = accepts_older_form(function)

    @functools.wraps(function)
    def adapted(*args, **options):
        options = {_RENAMED.get(name, name): value for name, value in options.items()}
        if "target" in options or (len(args) > 1 and not isinstance(args[1], Integral)):
            names = list(_DESCENT_NAMES)
            if len(args) > 4 and hasattr(args[4], "__len__") and not isinstance(args[4], str):
                names.append("resolution")
            names += _DESCENT_OPTIONS
            if "target" in options:
                options["field"] = options.pop("target")
            given = dict(zip(names, args, strict=False))
            if len(args) > len(names) or given.keys() & options.keys():
                raise TypeError("gerchberg_saxton got more than one value, or too many, for its arguments")
            options = given | options
            options["field"] = torch.sqrt(_validate.image("target", options["field"]).abs())
            args = ()
        ignored = [name for name in _WITHOUT_EFFECT if options.pop(name, None) not in (None, False)]
        if ignored:
            warn(f"gerchberg_saxton has no use for {' and '.join(ignored)}: ignored", ArgumentWarning)
        return older(*args, **options)

    return adapted
