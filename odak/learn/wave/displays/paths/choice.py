"""The choice of a path by the panel of a display and the places of its images, which are checked here."""

from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak.instruments import Lens
from odak.learn.wave.displays.panels import Iris, Modulator, checked_iris, pitch_pair
from odak.learn.wave.displays.paths.base import Path
from odak.learn.wave.displays.paths.free import FreePath
from odak.learn.wave.displays.paths.lens import LensPath
from odak.learn.wave.displays.paths.retina import RetinaPath
from odak.learn.wave.displays.paths.two_panels import TwoPanelsPath
from odak.learn.wave.eyes import Eyes

# The first of them that leads to the images is taken.
PATHS: tuple[type[Path], ...] = (RetinaPath, LensPath, TwoPanelsPath, FreePath)


def path_to(
    modulator: Modulator,
    wavelengths: float | Sequence[float],
    distances: float | Sequence[float] | Lens | Eyes,
    iris: Iris | str | None,
    medium: float,
) -> Path:
    """Return the path of the light of a modulator to images at some distances, behind a lens or in eyes."""
    wavelengths = _numbers("wavelengths", wavelengths, positive=True)
    ends = distances.distance if isinstance(distances, Eyes) else distances
    found = _numbers("distances", ends.after if isinstance(ends, Lens) else ends)
    _validate.lengths_together(wavelengths, modulator.pitch, names=("wavelengths", "pitch", "distances"))
    medium = _validate.constant("medium", medium, positive=True)
    checked_iris(iris)
    ends = distances if isinstance(distances, (Lens, Eyes)) else found
    kind = next(kind for kind in PATHS if kind.leads(modulator, ends))
    pixels = tuple(modulator.resolution), pitch_pair(modulator.pitch), modulator.fill
    return kind(*pixels, modulator.lit_through, wavelengths, ends, iris, medium)  # type: ignore[arg-type]


def _numbers(name, values, positive=False) -> tuple[float, ...]:
    (values,) = _validate.constants(**{name: values})
    given = [values] if np.ndim(values) == 0 else values
    checked = tuple(float(value) for value in _validate.several(name, given, positive=positive))
    if not checked:
        raise ValueError(f"{name} must contain at least one number, got none")
    return checked
