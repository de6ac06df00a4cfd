"""The choice of a path by the panel of a display and the places of its images, which are checked here."""

from collections.abc import Sequence

from odak import _validate
from odak._lengths import likely_length
from odak._warnings import ArgumentWarning, warn
from odak.instruments import Lens
from odak.learn.wave.displays.panels import Iris, Modulator, checked_iris, pitch_pair
from odak.learn.wave.displays.paths.base import Path, checked_numbers
from odak.learn.wave.displays.paths.eyepiece import EyepiecePath
from odak.learn.wave.displays.paths.free import Free, FreePath
from odak.learn.wave.displays.paths.lens import LensPath
from odak.learn.wave.displays.paths.retina import RetinaPath
from odak.learn.wave.displays.paths.two_panels import TwoPanelsPath
from odak.learn.wave.eyes import Eyes

# The first of them that leads to the images is taken.
PATHS: tuple[type[Path], ...] = (EyepiecePath, RetinaPath, LensPath, TwoPanelsPath, FreePath)
# A distance that may be meant in millimetres, and the share of the first order beside the panel below which it is.
_METRES, _SHARE = 1.0, 0.02


def path_to(
    modulator: Modulator,
    wavelengths: float | Sequence[float],
    distances: float | Sequence[float] | Lens | Eyes | Free,
    iris: Iris | str | None,
    medium: float,
) -> Path:
    """Return the path of the light of a modulator to images at some distances, behind a lens or in eyes."""
    wavelengths = checked_numbers("wavelengths", wavelengths, positive=True)
    found = distances
    if not isinstance(distances, (Lens, Eyes, Free)):
        found = checked_numbers("distances", distances)
    _validate.lengths_together(wavelengths, modulator.pitch, names=("wavelengths", "pitch", "distances"))
    medium = _validate.constant("medium", medium, positive=True)
    if isinstance(found, tuple):
        _warn_of_millimetres(modulator, max(wavelengths) / medium, max(map(abs, found)))
    checked_iris(iris)
    kind = next(kind for kind in PATHS if kind.leads(modulator, found))
    if modulator.expander is not None and not kind.on_retinas:
        raise ValueError(
            "distances must be odak.learn.wave.Eyes for a modulator with an expander, whose light an image of the "
            f"panel's pixels does not show, got {distances!r:.80}"
        )
    pixels = tuple(modulator.resolution), pitch_pair(modulator.pitch), modulator.fill
    return kind(*pixels, modulator.lit_through, wavelengths, found, iris, medium, modulator.expander)  # type: ignore[arg-type]


def _warn_of_millimetres(modulator: Modulator, wavelength: float, furthest: float) -> None:
    """Warn of a distance of metres over which hardly any light of a panel's band stays beside the panel."""
    if furthest <= _METRES:
        return
    sides = zip(modulator.resolution, pitch_pair(modulator.pitch), strict=True)
    share = max(n * pitch**2 for n, pitch in sides) / wavelength / furthest
    if 0 < share < _SHARE:
        meant = likely_length(furthest, 1e-3, 1.0, "mm")
        warn(
            f"distances are in metres: over {furthest:g} m the first order of the pixels becomes {1 / share:.0f} times "
            f"as wide as the panel; did you mean {meant}?",
            ArgumentWarning,
        )
