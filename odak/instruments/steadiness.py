"""Steadiness of an optical table from frame to frame, from a reference pattern that measurements show repeatedly."""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from scipy.ndimage import convolve1d, shift
from scipy.special import chdtri

from odak._warnings import AccuracyWarning, warn
from odak.instruments.mapping import Registration, ray_matrix
from odak.instruments.protocols import CheckedCamera, SLMDriver, checked_camera
from odak.instruments.spots import pixel_axes
from odak.instruments.tables import OpticalTable

P = ParamSpec("P")
R = TypeVar("R")

# Captures between two of the reference pattern, and frames of it from which a drift is told.
EVERY, FEWEST = 20, 4
# Range of the brightest pixel of a reference, as a share of the camera's.
LEAST, MOST = 0.2, 0.95
# Correlation of frames of the reference below which they show something else.
ALIKE = 0.5
# Change of the levels that shows what a change of all phases does.
SCALED = 7 / 8
# Deviations from frame to frame of phases and light as shares, and of places in pixels; drifts; and a change of ambient
# light as a share of the brightest pixel of the reference, that are named.
NAMED, DRIFTED, AMBIENT = (0.02, 0.01, 0.05), (0.05, 0.05, 0.3), 0.01
# Derivative of a line of pixels, right to about 0.4 cycles per pixel, where speckles have details.
SLOPES = np.array([(-1.0) ** n / n * np.sinc(n / 7) if n else 0.0 for n in range(-6, 7)])
# Rounds in which displacements of frames of the reference are found.
ROUNDS = 3
# Share of steady tables whose noise alone may be taken for deviations that are named.
RARE = 1e-4
# Standard deviations of a slope above which it is a drift.
CLEAR = 5.0
# Errors of results by unit deviations of phases, light and places from frame to frame, and of the square of that of
# places: standard deviations on independent tables, of the distance as a defocus in radians. Captures of phases are
# moved back, which leaves an error of second order. Those of the illumination are in what its captures deviate from
# their model, and those of phases by flicker in how their levels scatter, unless they are the mean of regions.
ERRORS = {
    "phases": (0.0, 0.2, 0.0, 0.33),
    "mean of regional_phases": (3.8, 0.55, 0.0, 0.45),
    "regional_phases": (8.4, 1.1, 0.14, 0.0),
    "registration": (8.0, 0.0, 0.85, 0.0),
    "wavefront": (1.3, 0.0, 0.0, 0.0),
    "distance": (2.0, 0.0, 0.0, 0.0),
    "amplitude": (0.0, 0.0, 0.0, 0.0),
}


@dataclass(frozen=True)
class Steadiness:
    """Deviations of phases (share), light (share) and places (pixels) from frame to frame, and their drifts.

    Deviations that are not `sure` may be noise of the camera: they widen uncertainties and are not named. `ambient` is
    the largest change of light that lies evenly on the camera, as a share of the brightest pixel of the reference.
    """

    deviations: np.ndarray
    drifts: np.ndarray
    sure: np.ndarray
    ambient: float = 0.0

    def error(self, name: str, table: OpticalTable) -> float:
        """Return the standard deviation of the error of a result that the deviations cause."""
        error = float(np.linalg.norm(np.array(ERRORS[name]) * [*self.deviations, self.deviations[-1] ** 2]))
        if name == "distance":
            y, x = pixel_axes(table.modulator)
            # A lens has the wavefront π/λ·(x² + y²)/f.
            error *= table.wavelength / np.pi * ray_matrix(table.distance)[1] ** 2 / float((x**2 + y**2).std())
        return error

    def name(self) -> None:
        """Warn of what deviates, drifts or changes much."""
        if self.ambient > AMBIENT:
            warn(
                f"ambient light, or the black level of the camera, changed by {self.ambient:.1%} of the brightest "
                "pixel in the course of the measurement; an even change is corrected, and its noise remains: keep "
                "lamps and monitors off, or shield the camera",
                AccuracyWarning,
            )
        light = "the light varies by {:.1%}: let the laser warm up, or stabilise its power"
        texts = (
            "the phases of the modulator flicker by {:.1%}: use its steadiest sequence, or longer exposures",
            light,
            "the image moves by {:.2f} pixels: fasten camera and modulator, and keep off vibration and moving air",
        )
        named = [
            text.format(value)
            for text, value, limit, sure in zip(texts, self.deviations, NAMED, self.sure, strict=True)
            # A change of the phases changes the light where it is seen, too.
            if sure and value > limit and (text is not light or value > self.deviations[0])
        ]
        if named:
            warn(
                "results are uncertain because the table is not steady: from frame to frame " + "; ".join(named),
                AccuracyWarning,
            )
        words = ("the phases changed by {:.1%}", "the light changed by {:.1%}", "the image moved by {:.2f} pixels")
        named = [
            text.format(value)
            for text, value, limit in zip(words, self.drifts, DRIFTED, strict=True)
            if abs(value) > limit
        ]
        if named:
            warn(
                f"results are uncertain because the table drifts: in the course of the measurement {', '.join(named)}; "
                "wait until laser, modulator and mounts have warmed up",
                AccuracyWarning,
            )


def slopes_of(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the changes from pixel to pixel of frames ``[..., rows, columns]`` down and across."""
    down, across = (convolve1d(frames, SLOPES, axis, mode="nearest") for axis in (-2, -1))
    return down, across


def moved_back(frames: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """Return frames ``[n, rows, columns]`` without displacements in pixels down and across ``[n, 2]``."""
    return np.stack([shift(frame, by, order=5, mode="nearest") for frame, by in zip(frames, moved, strict=True)])


class Watched:
    """Modulator that shows a reference pattern after every some captures of a camera, between the patterns of others.

    The first pattern that the camera captured within its range is the reference.
    """

    def __init__(self, modulator: SLMDriver, camera: CheckedCamera):
        self.modulator: SLMDriver = modulator
        self.camera: CheckedCamera = camera
        self.shape: tuple[int, int] = modulator.shape
        self.pitch: float = modulator.pitch
        self.bits: int = modulator.bits
        self.levels: np.ndarray | None = None
        self.reference: tuple[np.ndarray, float, tuple[int, int, int, int] | None] | None = None
        self.frames: list[np.ndarray] = []
        self.scaled: np.ndarray | None = None
        self.times: list[int] = []
        camera.last = None

    @property
    def settling_time(self) -> float:
        """Seconds after which a new pattern is shown."""
        return self.modulator.settling_time

    @settling_time.setter
    def settling_time(self, value: float) -> None:
        self.modulator.settling_time = value

    def show(self, levels: np.ndarray) -> None:
        """Show levels, and before them the reference if it is time."""
        if self.reference is None:
            self._adopt()
        elif self.camera.taken - self.times[-1] >= EVERY:
            self.look()
        self.modulator.show(levels)
        self.levels, self.camera.last = np.array(levels), None

    def _adopt(self) -> None:
        """Take the pattern that is shown as the reference, if it was captured well."""
        if self.levels is None or self.camera.last is None or not self.camera.examined:
            return
        frame, seconds, region = self.camera.last
        if LEAST * self.camera.top < frame.max() < MOST * self.camera.top:
            self.reference = self.levels, seconds, region
            self._keep(frame)

    def _keep(self, frame: np.ndarray) -> None:
        self.frames.append(frame.astype(float))
        self.times.append(self.camera.taken)

    def look(self) -> None:
        """Capture the reference; region and exposure are restored."""
        if self.reference is None:
            return
        camera, (levels, seconds, region) = self.camera, self.reference
        before = camera.region, camera.exposure
        camera.region = region
        camera.exposure = seconds
        if self.scaled is None:
            self.modulator.show((levels * SCALED).astype(np.int64))
            self.scaled = camera.capture(1)[0].astype(float)
        self.modulator.show(levels)
        frame = camera.capture(1)[0]
        camera.region, camera.exposure = before
        self._keep(frame)
        first, last = self.frames[0] - self.frames[0].mean(), self.frames[-1] - self.frames[-1].mean()
        alike = float((first * last).sum() / (math.sqrt((first**2).sum() * (last**2).sum()) or 1.0))
        if alike < ALIKE:
            raise RuntimeError(
                f"the camera no longer sees what it saw: a pattern that was shown again after {camera.taken} captures "
                f"gives a frame that correlates by {alike:.2f} with its first, of {frame.max()} counts at most where "
                f"it had {self.frames[0].max():.0f}; check that the laser is on, that camera and modulator answer, and "
                "that nothing was moved"
            )

    def found(self) -> Steadiness | None:
        """Return how steady the table was, or None where the reference was captured once."""
        if self.reference is not None and self.camera.taken - self.times[-1] >= EVERY // 2:
            self.look()
        if len(self.frames) < 2 or self.scaled is None:
            return None
        frames, moved = np.stack(self.frames), np.zeros((len(self.frames), 2))
        for _ in range(ROUNDS):
            still = moved_back(frames, moved)
            mean = still.mean(0)
            parts = [(mean - self.scaled) / (1 - SCALED), mean - np.quantile(mean, 0.02), *slopes_of(mean)]
            system = np.stack([part.ravel() for part in [*parts, np.ones_like(mean)]], axis=-1)
            back, changes = np.linalg.pinv(system), (still - mean).reshape(len(frames), -1).T
            values = back @ changes
            moved += values[2:4].T
        # Photons make bright pixels noisier than others, and few bright ones follow the fit: the residuals of each are
        # divided by what the others leave to it (MacKinnon and White, Journal of Econometrics 29, 305, 1985, HC3).
        alone = np.clip(1 - (system * back.T).sum(-1), 0.01, None)
        *noise, of_ambient = back**2 @ (((changes - system @ values) ** 2).sum(-1) / (len(frames) - 1) / alone**2)
        noise, ambient = np.array(noise), float(np.ptp(values[4]))
        ambient = ambient / mean.max() if ambient > CLEAR * math.sqrt(of_ambient) else 0.0
        values = np.column_stack([values[:2].T, moved])
        times = np.array(self.times, float) - np.mean(self.times)
        spread, drifts = values.std(0, ddof=1), np.zeros(4)
        if len(values) >= FEWEST and np.ptp(times) > 0:
            slopes = times @ values / (times**2).sum()
            left = values - values.mean(0) - np.outer(times, slopes)
            about = np.sqrt((left**2).sum(0) / (len(values) - 2))
            clear = abs(slopes) * np.sqrt((times**2).sum()) > CLEAR * about
            drifts = np.where(clear, slopes * np.ptp(times), 0)
            spread = np.where(clear, about, spread)
        # The spread of a few noisy values may be several times the noise.
        count = len(values) - 1
        sure = spread**2 > chdtri(count, RARE) / count * noise
        most = 1 + 3 * math.sqrt(2 / count)
        spread = np.where(spread**2 > most * noise, np.sqrt(np.clip(spread**2 - noise, 0, None)), 0)
        along = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0.5, 0.5]])
        drifts = np.array([*drifts[:2], np.hypot(*drifts[2:])])
        return Steadiness(np.sqrt(along @ spread**2), drifts, np.array([*sure[:2], sure[2:].any()]), ambient)


def watched(
    name: str,
) -> Callable[[Callable[Concatenate[OpticalTable, P], R]], Callable[Concatenate[OpticalTable, P], R]]:
    """Return a decorator by which a measurement shows a reference pattern now and then, and widens its uncertainty.

    The measurement takes a table first, and returns a registration, or a result and its uncertainty; within another
    measurement it remains as it is.
    """

    def decorated(measure: Callable[Concatenate[OpticalTable, P], R]) -> Callable[Concatenate[OpticalTable, P], R]:
        @functools.wraps(measure)
        def run(table: OpticalTable, *args: P.args, **options: P.kwargs) -> R:
            camera = checked_camera(table.camera)
            if camera.watched:
                return measure(table, *args, **options)
            modulator, camera.watched = Watched(table.modulator, camera), True
            try:
                result: Any = measure(replace(table, modulator=modulator, camera=camera), *args, **options)
                found = modulator.found()
            finally:
                camera.watched = False
            if found is None:
                return result
            found.name()
            return widened(result, name, found, table)

        return run

    return decorated


def widened(result: Any, name: str, found: Steadiness, table: OpticalTable) -> Any:
    """Return a result whose uncertainty contains what an unsteady table causes."""
    if isinstance(result, Registration):
        return replace(result, uncertainty=math.hypot(result.uncertainty, found.error(name, table)))
    if isinstance(result, tuple):
        first, doubt, *others = result
        return first, np.hypot(doubt, found.error(name, table))[()], *others
    names = {"phases": "phases" if result.regional_phases is None else "mean of regional_phases"}
    uncertainty = {
        key: math.hypot(doubt, found.error(names.get(key, key), table)) for key, doubt in result.uncertainty.items()
    }
    registration = replace(result.registration, uncertainty=uncertainty["registration"])
    return replace(result, uncertainty=uncertainty, registration=registration)
