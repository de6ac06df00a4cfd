"""Exposure, dark counts, high dynamic range, settling time and polarisation of the instruments of an optical table."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label
from scipy.optimize import brentq, curve_fit, least_squares

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.protocols import Camera, CheckedCamera, Laser, Rotator, SLMDriver, checked_camera, checked_dark

# Share of the range of a camera that its brightest pixel should reach.
EXPOSED = 0.6
# Counts of this share of the range are taken as saturated.
SATURATED = 0.98
# Pixels that are stuck at most, reductions of the exposure by 4 through which they stay saturated, and the exposure in
# seconds up to which light is searched for.
LARGEST_STUCK, FEWEST_CUTS, LONGEST_DARK = 200, 5, 30.0
# Rows or columns that are stuck, at most.
STUCK_LINES = 4
# Captures that tell for sure whether a camera has a gamma curve.
SURE = 16
# Share of the wanted counts above which the offset is negligible.
PROPORTIONAL = 0.25
# Share of the wanted counts above which a first capture is used.
USABLE = 0.5
# Frames that are older than what they should show.
STALE = (
    "{} frames that the camera returned after {} show {}: discard as many frames before each capture (skip= of "
    "VideoCamera), empty the buffer of the camera, or use a trigger"
)
# Side in pixels of the squares whose settling is measured.
SQUARE = 8


def set_exposure(camera: Camera, show: Callable[[], None] | None = None, level: float = EXPOSED) -> float:
    """Set the exposure of a camera so that its brightest pixel reaches a share of the range.

    Parameters
    ----------
    camera : Camera
        The camera; its exposure is changed.
    show : callable, optional
        Called first, to show a pattern.
    level : float
        Share of the range, between 0 and 1.

    Returns
    -------
    float
        Exposure time in seconds.

    Raises
    ------
    RuntimeError
        If the camera sees no light, or its counts do not follow the exposure: a gamma curve, an automatic gain.

    Warns
    -----
    AccuracyWarning
        If pixels are stuck, so that their counts do not follow the exposure as the others do, or the exposure is at a
        limit of the camera.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import SimulatedTable, set_exposure
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> table.modulator.show(np.zeros((32, 32), dtype=np.uint8))
    >>> exposure = set_exposure(table.camera)
    >>> bool(0.4 < table.camera.capture().max() / 4095 < 0.8)
    True
    """
    level = float(_validate.number("level", level, positive=True, below=SATURATED))
    if show is not None:
        show()
    camera = checked_camera(camera)
    start, wanted, loudest, same, darkest = camera.exposure, level * camera.top, np.zeros(0, bool), 0, np.inf
    for _ in range(24):
        frame = camera.capture(1)[0]
        brightest, now = float(frame.max()), camera.exposure
        if 0.8 * wanted < brightest < 1.1 * wanted:
            if camera.examined or not _examine(camera):
                break
            continue
        # A saturated pixel gives a lower bound only; a dark one may be its offset alone, which is no less.
        most = 100 if 100 * now < LONGEST_DARK / 10 else 10
        factor = 0.25 if brightest >= SATURATED * camera.top else float(np.clip(wanted / max(brightest, 1), 0.1, most))
        # Pixels that stay the brightest however much the exposure is reduced.
        loud = frame >= min(SATURATED * camera.top, 0.95 * brightest)
        same = same + 1 if factor < 1 and np.array_equal(loud, loudest) and _few(loud) else 0
        loudest = loud
        if same == FEWEST_CUTS:
            _replace(camera, loud)
            camera.exposure = start
            continue
        darkest = min(darkest, brightest)
        # Noise and offset alone do not grow with the exposure.
        none = brightest < max(1.5 * darkest, darkest + 0.02 * camera.top) and brightest < 0.3 * wanted
        if factor > 1 and none and now >= min(LONGEST_DARK, camera.limits[1]):
            camera.exposure = start
            smooth = np.sort(frame, axis=None)
            median, low = float(smooth[smooth.size // 2]), float(smooth[smooth.size // 20])
            if brightest - median > max(20.0, 4 * (median - low)):
                # A picture, and not noise.
                raise RuntimeError(
                    f"the counts of the camera do not follow its exposure: its brightest pixel has {brightest:.0f} of "
                    f"{camera.top} counts, {median:.0f} at most pixels, at {now:.3g} s, as at exposures a hundred "
                    "times shorter; switch off its automatic exposure and gain"
                )
            raise RuntimeError(
                f"the camera sees no light: its brightest pixel has {brightest:.0f} of {camera.top} counts at an "
                f"exposure of {now:.3g} s, {darkest:.0f} at shorter ones; check that the laser is on, that no shutter "
                "or cap is closed, and the distance"
            )
        camera.exposure *= factor
        # What the device made of it.
        if abs(camera.exposure / now - 1) < 1e-3:
            warn(
                f"the exposure of {now:.3g} s is at a limit of the camera: its brightest pixel has {brightest:.0f} of "
                f"{camera.top} counts; {'attenuate the light' if factor < 1 else 'use more light'}",
                AccuracyWarning,
            )
            break
        if camera.examined and PROPORTIONAL * wanted < brightest < SATURATED * camera.top:
            # Its counts are known to follow the exposure.
            break
    else:
        if not camera.examined:
            _examine(camera)
    return camera.exposure


def exposed(camera: CheckedCamera, pattern: str, level: float = EXPOSED, brighter: float = 1.0) -> np.ndarray:
    """Return a capture whose brightest pixel has more than half a share of the range, and set the exposure for it.

    The exposure begins as the last pattern of the same name left it, or another one that is less bright by a factor.
    """
    camera.exposure = camera.exposures.get(pattern, camera.exposure / brighter)
    if not camera.examined:
        set_exposure(camera, level=level)
    for attempt in range(6):
        frame = camera.capture(1)[0].astype(float)
        share = frame.max() / camera.top
        if not camera.examined or (attempt > 1 and share < PROPORTIONAL * level):
            set_exposure(camera, level=level)
            continue
        most = 100 if attempt < 2 else 10
        camera.exposure *= min(level / share, most) if 0 < share < SATURATED else 0.15 if share else 10
        if USABLE * level < share < SATURATED:
            break
    camera.exposures[pattern] = camera.exposure
    return frame


def _examine(camera: CheckedCamera) -> bool:
    """Check that the counts of a camera follow its exposure; return whether stuck pixels were found and replaced."""
    before = camera.exposure
    # Light that varies from frame to frame looks like a gamma curve, but not on average.
    for count in (1, SURE):
        frames, times = [], []
        for part in (1, 2, 4):
            times.append(camera.expose(before / part))
            frames.append(camera.capture(count).mean(0))
        camera.exposure = before
        # Steps that are too coarse, or a limit, leave no two exposures to compare.
        if not (times[2] < 0.9 * times[1] and times[1] < 0.9 * times[0]):
            return False
        try:
            return _follows(camera, frames, times)
        except _Curved:
            if count == SURE:
                raise
    return False


class _Curved(RuntimeError):
    """The counts of a camera grow as another power of its exposure than 1."""


def _follows(camera: CheckedCamera, frames: list[np.ndarray], times: list[float]) -> bool:
    """Check frames of an exposure, its half and its quarter; return whether stuck pixels were found and replaced."""
    before, (whole, half, quarter) = camera.exposure, frames
    floor = float(np.median(whole))
    bright = whole >= floor + 0.3 * (whole.max() - floor)
    stuck = bright & (quarter - floor > 0.8 * (whole - floor)) & (half - floor > 0.8 * (whole - floor))
    if stuck.any() and _few(stuck) and (stuck.sum() < bright.sum() or _alone(stuck)):
        _replace(camera, stuck)
        return True
    camera.examined = True
    first, second = (whole - half)[bright].sum(), (half - quarter)[bright].sum()
    if first <= 0.05 * whole[bright].sum():
        camera.exposure = before / 2
        later = [camera.capture(1)[0].astype(float)[bright].sum() for _ in range(6)]
        camera.exposure = before
        changed = np.flatnonzero(np.array(later) < 0.9 * whole[bright].sum())
        if len(changed):
            raise RuntimeError(STALE.format(1 + changed[0], "its exposure was changed", "that before"))
        raise RuntimeError(
            f"the counts of the camera do not follow its exposure: {whole[bright].mean():.0f} at {before:.3g} s and "
            f"{half[bright].mean():.0f} at half of it; switch off its automatic exposure and gain"
        )
    exponent = _power(first / max(second, 1e-3 * first), *times)
    if not 0.75 < exponent < 1.3:
        raise _Curved(
            f"the counts of the camera grow as the power {exponent:.2f} of its exposure: switch off its gamma curve "
            "and its automatic gain, or use raw frames"
        )
    return False


def _power(ratio: float, whole: float, half: float, quarter: float) -> float:
    """Return the power p of the exposure with which counts grow whose differences have a ratio.

    The ratio is (w^p − h^p)/(h^p − q^p) for exposures w, h and q, and grows with p.
    """

    def excess(power: float) -> float:
        high, low = (whole / half) ** power - 1, 1 - (quarter / half) ** power
        return high / low - ratio

    least, most = 0.05, 12.0
    if excess(least) >= 0:
        return least
    return float(brentq(excess, least, most)) if excess(most) > 0 else most


def _few(mask: np.ndarray) -> bool:
    """Return whether a mask has so few pixels, rows or columns that they may be stuck."""
    return bool(mask.sum() <= LARGEST_STUCK or min(int(mask.any(axis).sum()) for axis in (0, 1)) <= STUCK_LINES)


def _alone(mask: np.ndarray) -> bool:
    """Return whether no two pixels of a mask touch."""
    _, groups = label(mask, np.ones((3, 3)))
    return bool(groups == mask.sum())


def _replace(camera: CheckedCamera, stuck: np.ndarray) -> None:
    camera.replace(stuck)
    row, column = np.argwhere(stuck)[0] + np.array((camera.region or (0, 0))[:2])
    warn(
        f"{stuck.sum()} pixels of the camera do not change with its exposure, the first at row {row}, column {column}: "
        "those around them take their places",
        AccuracyWarning,
    )


def measure_dark(camera: Camera, laser: Laser, count: int = 16) -> np.ndarray:
    """Return the counts of a camera without light, the mean of captures with the laser off.

    Parameters
    ----------
    camera : Camera
        The camera.
    laser : Laser
        The laser; its power is restored.
    count : int
        Number of captures.

    Returns
    -------
    numpy.ndarray
        Counts ``[rows, columns]`` of the region.

    Examples
    --------
    >>> from odak.instruments import SimulatedTable, measure_dark
    >>> table = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    >>> lit = table.camera.capture(4).mean()
    >>> dark = measure_dark(table.camera, table.laser, count=4)
    >>> dark.shape, bool(dark.mean() < lit)
    ((32, 32), True)
    """
    power, camera = laser.power, checked_camera(camera)
    laser.power = 0.0
    try:
        return camera.capture(_validate.integer("count", count, minimum=1)).mean(0)
    finally:
        laser.power = power


def capture_hdr(
    camera: Camera,
    exposures: Sequence[float],
    *,
    dark: np.ndarray | float = 0.0,
    captures: int = 1,
    noise: tuple[float, float] = (0.2, 1.0),
) -> np.ndarray:
    """Return counts per second of a scene, from captures with several exposures.

    Each capture is divided by the exposure that the camera reports of it; their mean is weighted with the inverse of
    the variance that photons and the amplifier cause, of those that are not saturated.

    Parameters
    ----------
    camera : Camera
        The camera; its exposure is restored.
    exposures : sequence of float
        Exposure times in seconds, at least two, usually a factor 4 to 8 apart.
    dark : numpy.ndarray or float
        Counts without light, from :func:`measure_dark`.
    captures : int
        Number of captures of each exposure.
    noise : tuple of float
        Slope (counts per electron) and offset (counts²) of the variance of a capture, for the weights; see
        :meth:`odak.instruments.Captures.noise`.

    Returns
    -------
    numpy.ndarray
        Counts per second ``[rows, columns]``; infinite where all captures are saturated.

    Notes
    -----
    Debevec and Malik, Proc. SIGGRAPH, 369 (1997), with a linear response; weights after Granados et al., Proc. CVPR,
    215 (2010).

    Examples
    --------
    >>> from odak.instruments import SimulatedTable, capture_hdr
    >>> table = SimulatedTable(seed=1, shape=(24, 24), camera_shape=(32, 32))
    >>> exposures = [table.camera.exposure / 4, table.camera.exposure]
    >>> counts_per_second = capture_hdr(table.camera, exposures, captures=2)
    >>> counts_per_second.shape, bool(counts_per_second.max() > 0)
    ((32, 32), True)
    """
    times = _validate.several("exposures", exposures, positive=True)
    if len(times) < 2:
        raise ValueError(f"exposures must be at least two, got {len(times)}")
    camera = checked_camera(camera)
    before, top = camera.exposure, camera.top
    frames, fine, taken_for = [], [], []
    try:
        for time in times:
            taken_for.append(camera.expose(time))
            taken = camera.capture(_validate.integer("captures", captures, minimum=1))
            frames.append(taken.mean(0) - checked_dark(dark, taken))
            fine.append(taken.max(0) < SATURATED * top)
    finally:
        camera.exposure = before
    if max(taken_for) < 1.01 * min(taken_for):
        wanted = ", ".join(f"{time:.3g}" for time in times)
        warn(
            f"exposures are {wanted} s, and the camera took {taken_for[0]:.3g} s for each: they lie beyond its limits "
            "or between its steps, and the range is that of one",
            AccuracyWarning,
        )
    rate = combined(np.stack(frames), np.stack(fine), np.asarray(taken_for), noise)
    if np.isinf(rate).any():
        warn(
            f"{np.isinf(rate).sum()} pixels are saturated at all exposures: add one below {min(times):.3g} s",
            AccuracyWarning,
        )
    return rate


def combined(
    seen: np.ndarray, usable: np.ndarray, exposures: np.ndarray, noise: tuple[float, float] = (0.2, 1.0)
) -> np.ndarray:
    """Return counts per second from counts of several exposures without their offset.

    Parameters
    ----------
    seen : numpy.ndarray
        Counts ``[exposure, ...]``.
    usable : numpy.ndarray
        Whether they are not saturated.
    exposures : numpy.ndarray
        Exposure times in seconds.
    noise : tuple of float
        Slope (counts per electron) and offset (counts²) of their variance.

    Returns
    -------
    numpy.ndarray
        Counts per second ``[...]``; infinite where all are saturated.
    """
    lengths = exposures.reshape(-1, *(seen.ndim - 1) * (1,))
    # Weights from the light itself rather than from each capture, whose chance would bias them: in two rounds.
    rate = _weighted(seen / lengths, usable * lengths)
    variance = (noise[0] * np.clip(rate, 0, None) * lengths + noise[1]) / lengths**2
    return _weighted(seen / lengths, usable / np.where(np.isfinite(variance), variance, 1.0))


def _weighted(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    total = weights.sum(0)
    return np.where(total > 0, (values * weights).sum(0) / np.where(total > 0, total, 1.0), np.inf)


@dataclass(frozen=True)
class SettlingResult:
    """Settling of a modulator.

    Attributes
    ----------
    time_constant : float
        Time constant in seconds in which the distance to a new phase falls by a factor e.
    settling_time : float
        Seconds after which the phase misses the new one by less than the tolerance.
    uncertainty : float
        Standard deviation of the time constant in seconds.
    delays : numpy.ndarray
        Delays of the captures in seconds, their middles.
    phase : numpy.ndarray
        Phase seen at each in radians, 0 before the change.

    Examples
    --------
    The time for another tolerance, 0.1 of a phase step of 3 radians, follows from the time constant:

    >>> import math
    >>> import numpy as np
    >>> from odak.instruments import SettlingResult
    >>> delays = np.array([0.0, 5e-3, 10e-3])
    >>> found = SettlingResult(8e-3, 40e-3, 1e-4, delays, np.array([0.0, 1.5, 2.2]))
    >>> round(found.time_constant * math.log(3 / 0.1), 4)
    0.0272
    """

    time_constant: float
    settling_time: float
    uncertainty: float
    delays: np.ndarray
    phase: np.ndarray


def measure_settling(
    modulator: SLMDriver,
    camera: Camera,
    phases: np.ndarray,
    *,
    tolerance: float = 0.02,
    longest: float | None = None,
    samples: int = 16,
    captures: int = 4,
    exposure: float | None = None,
) -> SettlingResult:
    """Measure in which time a modulator changes from one pattern to another.

    A fixed random pattern of squares is shown, whose phase step φ goes from 0 to about π. Each pixel of the camera sees
    a + b·cos φ + c·sin φ; the three images a, b and c are determined from captures of five settled steps, and with them
    the phase from captures that begin after delays, which the settling time of the modulator is set to. A relaxation
    φ∞·(1 − e^{−t/τ}), averaged over the exposure, is fitted to it.

    Parameters
    ----------
    modulator : SLMDriver
        The modulator; its settling time is restored.
    camera : Camera
        The camera; its exposure is restored.
    phases : numpy.ndarray
        Phase of each level in radians, from :func:`odak.instruments.measure_phase_response`.
    tolerance : float
        Deviation of the phase in radians below which it is settled.
    longest : float, optional
        Longest delay in seconds; the present settling time of the modulator by default.
    samples : int
        Number of delays.
    captures : int
        Number of captures at each.
    exposure : float, optional
        Exposure time in seconds; a 50th of the longest delay by default.

    Returns
    -------
    SettlingResult
        Time constant and settling time. A settling time longer than `longest` is an AccuracyWarning.

    Examples
    --------
    >>> from odak.instruments import SimulatedTable, measure_settling, set_exposure
    >>> table = SimulatedTable(seed=1, shape=(24, 24), distance=3e-3, camera_shape=(32, 32), time_constant=8e-3)
    >>> found = measure_settling(table.modulator, table.camera, table.truth.phases, exposure=5e-3)
    >>> bool(abs(found.time_constant / table.truth.time_constant - 1) < 0.1)
    True
    """
    camera = checked_camera(camera)
    longest = modulator.settling_time if longest is None else longest
    longest = float(_validate.number("longest", longest, positive=True))
    samples = _validate.integer("samples", samples, minimum=6)
    tolerance = float(_validate.number("tolerance", tolerance, positive=True))
    exposure = longest / 50 if exposure is None else float(_validate.number("exposure", exposure, positive=True))
    rows, columns = modulator.shape
    final = int(np.abs(np.abs(phases - phases[0]) - 0.9 * np.pi).argmin())
    step = float(phases[final] - phases[0])
    # Fringing fields smooth the edges of the squares, which must therefore not be small.
    cell = max(1, min(SQUARE, rows // 4, columns // 4))
    coarse = np.random.default_rng(0).random((-(-rows // cell), -(-columns // cell))) < 0.5
    squares = np.kron(coarse, np.ones((cell, cell), dtype=np.int64))[:rows, :columns]
    captures = _validate.integer("captures", captures, minimum=1)
    settled = np.array([np.abs(phases - phases[0] - share * step).argmin() for share in np.linspace(0, 1, 5)])
    before = modulator.settling_time, camera.exposure
    delays, images, seen = np.linspace(0, longest, samples), [], []
    try:
        exposure = camera.expose(exposure)
        modulator.settling_time = 2 * longest
        for level in settled:
            modulator.show(level * squares)
            images.append(camera.capture(4 * captures).mean(0).ravel())
        for delay in delays:
            frames = []
            for _ in range(captures):
                modulator.settling_time = 2 * longest
                modulator.show(0 * squares)
                modulator.settling_time = float(delay)
                modulator.show(final * squares)
                frames.append(camera.capture(1)[0].ravel())
            seen.append(np.mean(frames, axis=0))
    finally:
        modulator.settling_time, camera.exposure = before
    angles = phases[settled] - phases[0]
    waves = np.stack([np.ones_like(angles), np.cos(angles), np.sin(angles)], axis=-1)
    (constant, *parts), *_ = np.linalg.lstsq(waves, np.stack(images), rcond=None)
    # Cosine and sine of the step at each delay, averaged over the exposure.
    circle, *_ = np.linalg.lstsq(np.stack(parts, axis=-1), (np.stack(seen) - constant).T, rcond=None)
    # Gauss's points of the exposure.
    nodes, weights = np.polynomial.legendre.leggauss(5)
    moments, weights = delays[:, None] + exposure * (nodes + 1) / 2, weights / 2

    def model(parameters: np.ndarray) -> np.ndarray:
        """Return cosine and sine; noise in the images of the settled pattern makes both smaller by a factor."""
        time_constant, contrast = parameters
        phase = step * (1 - np.exp(-moments / (longest * abs(time_constant) + 1e-12)))
        return contrast * np.stack([np.cos(phase) @ weights, np.sin(phase) @ weights])

    starts = [np.array([time, 1.0]) for time in (0.02, 0.1, 0.4)]
    found = [least_squares(lambda p: (model(p) - circle).ravel(), start) for start in starts]
    best = min(found, key=lambda result: result.cost)
    time_constant = longest * abs(best.x[0])
    scatter = 2 * best.cost / (2 * samples - 2)
    covariance = scatter * np.linalg.pinv(best.jac.T @ best.jac)
    settling = time_constant * math.log(max(abs(step) / tolerance, math.e))
    if settling > longest or math.sqrt(scatter) > 0.1:
        warn(
            f"the settling time is uncertain: {settling:.3g} s, with delays up to {longest:.3g} s and a scatter of "
            f"{math.sqrt(scatter):.0%} of the change",
            AccuracyWarning,
        )
    middles = delays + exposure / 2
    phase = np.arctan2(circle[1], circle[0])
    return SettlingResult(time_constant, settling, longest * math.sqrt(covariance[0, 0]), middles, phase)


@dataclass(frozen=True)
class PolarisationResult:
    """Dependence of a display on the polarisation.

    Attributes
    ----------
    angle : float
        Angle of the polariser in degrees, −90 … 90, at which most light is modulated.
    uncertainty : float
        Standard deviation of the angle in degrees.
    contrast : float
        Brightness of a spot at that angle over that at 90 degrees to it; infinite where the latter is none.
    angles : numpy.ndarray
        Angles of the captures in degrees.
    brightness : numpy.ndarray
        Brightness of the spot at each.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import PolarisationResult
    >>> angles = np.array([0.0, 45.0, 90.0, 135.0])
    >>> brightness = 10 + 90 * np.cos(np.radians(angles - 20)) ** 2
    >>> found = PolarisationResult(20.0, 0.1, 10.0, angles, brightness)
    >>> found.angle, round(float(found.brightness[0]), 1)
    (20.0, 89.5)
    """

    angle: float
    uncertainty: float
    contrast: float
    angles: np.ndarray
    brightness: np.ndarray


def measure_polarisation(
    modulator: SLMDriver,
    camera: Camera,
    rotator: Rotator,
    levels: np.ndarray,
    *,
    samples: int = 12,
    captures: int = 4,
    dark: np.ndarray | float = 0.0,
) -> PolarisationResult:
    """Find the angle of a polariser at which a modulator modulates all light.

    The modulator focuses a spot. Its brightness follows Malus's law, a + b·cos 2(θ − θ₀), which is fitted.

    Parameters
    ----------
    modulator : SLMDriver
        The modulator.
    camera : Camera
        The camera.
    rotator : Rotator
        Mount of the polariser; it is left at the angle found.
    levels : numpy.ndarray
        Pattern that focuses a spot, integers ``[rows, columns]``, such as a lens pattern.
    samples : int
        Number of angles, evenly spaced over 180°.
    captures : int
        Number of captures at each.
    dark : numpy.ndarray or float
        Counts without light ``[rows, columns]``, or one number.

    Returns
    -------
    PolarisationResult
        The angle and the contrast.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import Calibration, SimulatedTable, measure_polarisation
    >>> from odak.wave import quadratic_phase_function
    >>> table = SimulatedTable(
    ...     seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), polarisation=True, aberration=0.05
    ... )
    >>> lens = np.angle(quadratic_phase_function(32, 32, 2 * np.pi / 532e-9, 4e-3, 8e-6))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 4e-3)
    >>> found = measure_polarisation(table.modulator, table.camera, table.polariser, assumed.levels(lens))
    >>> bool(abs(found.angle - table.truth.polarisation) < 1)
    True
    """
    samples = _validate.integer("samples", samples, minimum=5)
    angles = np.arange(samples) * (180.0 / samples)
    camera = checked_camera(camera)
    region = camera.region
    modulator.show(levels)
    brightest, place = -1.0, (0, 0)
    for angle in (0.0, 60.0, 120.0):
        rotator.turn(angle)
        frame = camera.capture(1)[0]
        frame = frame - checked_dark(dark, frame)
        if frame.max() > brightest:
            brightest, place, best = float(frame.max()), np.unravel_index(frame.argmax(), frame.shape), angle
    rotator.turn(best)
    set_exposure(camera, level=0.5)
    reach, values = 3, []
    window = tuple(slice(max(int(p) - reach, 0), int(p) + reach + 1) for p in place)
    for angle in angles:
        rotator.turn(float(angle))
        frames = camera.capture(_validate.integer("captures", captures, minimum=1)) - dark
        values.append(frames.mean(0)[window].sum())
    camera.region = region
    brightness = np.array(values)

    def law(theta, mean, even, odd):
        return mean + even * np.cos(2 * np.radians(theta)) + odd * np.sin(2 * np.radians(theta))

    (mean, even, odd), covariance = curve_fit(law, angles, brightness, [brightness.mean(), 0.0, 0.0])
    angle = math.degrees(math.atan2(odd, even)) / 2
    swing = math.hypot(even, odd)
    slopes = np.array([0.0, -odd, even]) / (2 * swing**2)
    uncertainty = math.degrees(math.sqrt(slopes @ covariance @ slopes))
    if uncertainty > 2:
        warn(f"the angle of the polariser is uncertain by {uncertainty:.1f} degrees", AccuracyWarning)
    rotator.turn(angle)
    rest = mean - swing
    return PolarisationResult(angle, uncertainty, (mean + swing) / rest if rest > 0 else math.inf, angles, brightness)
