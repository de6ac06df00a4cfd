"""Random numbers, from a seed the same for arrays and tensors."""

from typing import Any

import numpy as np

from odak import _array, _validate


def uniform(shape: tuple[int, ...], seed: Any, like):
    """Return numbers between 0 and 1, float64, in the library and on the device of an array.

    Parameters
    ----------
    shape : tuple of int
        Shape of the result.
    seed : int or generator, optional
        An integer gives NumPy arrays and tensors the same numbers. A generator is NumPy's or torch's own. None draws
        tensors from torch's generator, which `torch.manual_seed` seeds, and arrays anew each time.
    like : array
        What the result is like.

    Returns
    -------
    array
        float64.
    """
    seed = _validate.seed("seed", seed)
    own = isinstance(seed, np.random.Generator)
    if _array.is_torch(like) and not own and not isinstance(seed, int):
        import torch

        device = "cpu" if seed is None else seed.device
        drawn = torch.rand(shape, generator=seed, dtype=torch.float64, device=device)
    elif seed is None or own or isinstance(seed, int):
        drawn = np.random.default_rng(seed).random(shape)
    else:
        raise TypeError(f"seed must be an integer or a numpy.random.Generator for arrays, got {type(seed).__name__}")
    return _array.cast(drawn, like, _array.namespace(like).float64)
