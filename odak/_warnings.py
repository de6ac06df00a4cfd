"""Warning categories of the package, and the function that issues a warning at the caller's own line."""

import sys
import warnings
from pathlib import Path

# Frames of these folders are skipped: a warning belongs to the line of the user's program that made the call.
_PACKAGE = str(Path(__file__).parent)
_SKIPPED = ("torch", "array_api_compat")


class OdakWarning(UserWarning):
    """Base class of all warnings of the package.

    Examples
    --------
    All warnings of the package as errors:

    >>> import warnings
    >>> import odak
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", odak.OdakWarning)
    ...     try:
    ...         ray = odak.raytracing.create_ray([0, 0, 0], [45, 45, 45])
    ...     except odak.AccuracyWarning:
    ...         print("not a unit vector")
    not a unit vector
    """


class SamplingWarning(OdakWarning):
    """A field, a kernel or a surface is sampled too coarsely, or a method is used outside its range of validity.

    Examples
    --------
    Fresnel's transfer function far beyond the critical distance N·dx²/λ, here 0.1 mm:

    >>> import warnings
    >>> import numpy as np
    >>> import odak
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     field = odak.wave.propagate_beam(np.ones((16, 16)), None, 0.1, 2e-6, 532e-9, "TR Fresnel")
    >>> caught[0].category is odak.SamplingWarning
    True
    """


class AccuracyWarning(OdakWarning):
    """A result is less accurate than its caller would expect, or an input does not have the property it should have.

    Examples
    --------
    Angles whose cosines do not make a unit vector:

    >>> import warnings
    >>> import odak
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     ray = odak.raytracing.create_ray([0, 0, 0], [45, 45, 45])
    >>> caught[0].category is odak.AccuracyWarning
    True
    """


class ConvergenceWarning(OdakWarning):
    """An iteration stopped without reaching its tolerance, or an optimisation ended in a poor or worse result.

    Examples
    --------
    A Born series that is given too few iterations:

    >>> import warnings
    >>> import numpy as np
    >>> import odak
    >>> wave = np.ones((24, 8), dtype=complex)
    >>> index = np.ones((24, 8))
    >>> index[6:10, 2:6] = 1.4
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     field = odak.wave.scattered_field(wave, index, 0.1e-6, 532e-9, iterations=5)
    >>> caught[0].category is odak.ConvergenceWarning
    True
    """


class DeviceWarning(OdakWarning):
    """A computation runs on another device than the requested one.

    Examples
    --------
    A program that must not fall back to the CPU in silence:

    >>> import warnings
    >>> import torch
    >>> import odak
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", odak.DeviceWarning)
    ...     try:
    ...         found = odak.learn.tools.get_device("cuda").type == "cuda"
    ...     except odak.DeviceWarning:
    ...         found = False
    >>> found == torch.cuda.is_available()
    True
    """


class MissingPackageWarning(OdakWarning):
    """A part of a result was left out because an optional package is not installed.

    Examples
    --------
    A metric whose package may be missing, "lpips" here:

    >>> import importlib.util
    >>> import warnings
    >>> import odak
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", odak.MissingPackageWarning)
    ...     try:
    ...         available = odak.learn.perception.LPIPS(required=False).available
    ...     except odak.MissingPackageWarning:
    ...         available = False
    >>> available == (importlib.util.find_spec("lpips") is not None)
    True
    """


class ArgumentWarning(OdakWarning):
    """An argument has no effect, or was interpreted in a way that its caller may not have meant.

    Examples
    --------
    Alternating projections have no learning rate:

    >>> import warnings
    >>> import torch
    >>> import odak
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     hologram = odak.learn.wave.gerchberg_saxton(
    ...         torch.ones(16, 16), 532e-9, 0.01, 8e-6, n_iterations=1, learning_rate=0.1
    ...     )
    >>> caught[0].category is odak.ArgumentWarning
    True
    """


# Texts of warnings that a process issues once.
_issued: set[str] = set()


def warn(message: str, category: type[Warning] = OdakWarning, *, once: bool = False) -> None:
    """Issue a warning that is attributed to the first line outside the package on the call stack.

    Python's own filters decide what happens with it: by default it is shown once for each place and text.

    Parameters
    ----------
    message : str
        Text of the warning.
    category : type
        One of the categories of this module, or DeprecationWarning.
    once : bool
        Issue it once in this process, wherever it comes from: for what its reader needs to be told but once.
    """
    if once and message in _issued:
        return
    if once:
        _issued.add(message)
    level, frame = 2, sys._getframe(1)
    while frame is not None and _is_inside(frame):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level if frame is not None else 2)


def _is_inside(frame) -> bool:
    module = frame.f_globals.get("__name__", "").partition(".")[0]
    return module in _SKIPPED or frame.f_code.co_filename.startswith(_PACKAGE)
