"""Phase of each level of a modulator, for the whole of it and by regions."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.ndimage import binary_dilation, uniform_filter

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.exposures import SATURATED, STALE, set_exposure
from odak.instruments.mapping import Lens
from odak.instruments.protocols import Camera, SLMDriver
from odak.instruments.spots import averaged, brightest, deflected, lens_phase, pixel_axes, read_around
from odak.instruments.steadiness import CLEAR, SLOPES, moved_back, slopes_of, watched
from odak.instruments.tables import OpticalTable, parts_of

# Part of the circle in radians that the phases of levels may leave out.
LARGEST_GAP = 0.15 * np.pi
# Columns of other levels beside the border of the two halves, and rows and columns of pixels evaluated at most.
GUARD, LARGEST_WINDOW = 3, 201
# Rows and columns of pixels of a region at least.
SMALLEST_REGION = 12
# Noise of a phase of one half in radians above which more captures are averaged.
NOISE = 6.5e-4
# Largest of the errors of about 14 levels, with those of the fit of the ellipse and of the spline, in standard
# deviations of one: two of three are below the first, nearly all below the second.
LARGEST, RARELY = 2.9, 4.0
# Largest error of phases whose levels scatter, in standard deviations of one from a smooth response, on independent
# tables that flicker; and at most, as a share of what captures deviate from one phase at all pixels.
ROUGH, MOST = 3.8, 8.0
# Deviation of captures from one phase at all pixels, as a share of the interference, that is a warning.
DEVIATING = 0.1
# Rounds in which displacements of captures are found, of which each leaves about a third; times that captures are
# moved by them, which are small beside the speckles then; and displacements in pixels that are none.
ALIGNMENTS, MOVES, STILL = 8, 4, 0.01
# Share of the deviations from three images that displacements must leave at most, to be some.
EXPLAINED = 0.5
# Exposures in units of that at which no pixel is saturated: without the brightest pixels, the others have more light.
BRIGHT, BRIGHTER = 2.0, 4.0
# Share of the brightest pixel that the darkest ones have by ambient light, above which it is named.
AMBIENT = 0.5
# Share of pixels that are not saturated at least; longer exposures leave about three quarters as a rule.
FEWEST_FINE = 0.02
# Factor by which light is focused, about, for a first exposure.
FOCUSED = 300.0


def nearest_levels(phase: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return the levels whose phases are nearest to a phase, modulo 2π.

    Parameters
    ----------
    phase : numpy.ndarray
        Phase in radians.
    phases : numpy.ndarray
        Phase of each level in radians ``[levels]``, or of the levels of regions ``[region rows, region columns,
        levels]``, between whose middles it is interpolated by a cubic spline.
    """
    if phases.ndim == 3:
        return _regional_levels(phase, phases)
    wrapped = np.mod(phases, 2 * np.pi)
    order = np.argsort(wrapped, kind="stable")
    sorted_phases = wrapped[order]
    wanted = np.mod(phase, 2 * np.pi)
    above = np.searchsorted(sorted_phases, wanted) % len(order)
    below = above - 1

    def apart(index):
        difference = np.abs(sorted_phases[index] - wanted)
        return np.minimum(difference, 2 * np.pi - difference)

    return order[np.where(apart(above) < apart(below), above, below)]


def _regional_levels(phase: np.ndarray, tables: np.ndarray) -> np.ndarray:
    """Return the levels whose phases are nearest at each pixel, the tables of regions interpolated by splines."""
    found = np.empty(phase.shape, dtype=np.int64)
    down, across = (between_regions(n, parts) for n, parts in zip(phase.shape, tables.shape[:2], strict=True))
    for row, shares in enumerate(down):
        apart = np.mod(across @ np.tensordot(shares, tables, axes=1) - phase[row][:, None], 2 * np.pi)
        found[row] = np.minimum(apart, 2 * np.pi - apart).argmin(-1)
    return found


def phases_of_levels(levels: np.ndarray, phases: np.ndarray) -> np.ndarray:
    """Return the phases in radians that levels ``[rows, columns]`` show: the inverse of :func:`nearest_levels`.

    Parameters
    ----------
    levels : numpy.ndarray
        Integers ``[rows, columns]``.
    phases : numpy.ndarray
        Phase of each level in radians ``[levels]``, or of the levels of regions ``[region rows, region columns,
        levels]``.
    """
    if phases.ndim == 1:
        return phases[levels]
    down, across = (between_regions(n, parts) for n, parts in zip(levels.shape, phases.shape[:2], strict=True))
    return np.stack(
        [
            np.take_along_axis(across @ np.tensordot(shares, phases, axes=1), row[:, None], axis=1)[:, 0]
            for shares, row in zip(down, levels, strict=True)
        ]
    )


def between_regions(pixels: int, parts: int) -> np.ndarray:
    """Return the weights ``[pixels, parts]`` of values in the middles of regions along an axis, for a cubic spline.

    Up to four regions it is the polynomial through all of them, which continues to the edges of the modulator.
    """
    if parts == 1:
        return np.ones((pixels, 1))
    places = (np.arange(pixels) + 0.5) * parts / pixels - 0.5
    return make_interp_spline(np.arange(parts), np.eye(parts), k=min(parts - 1, 3))(places)


@_validate.takes_fields("modulator camera wavelength distance", table=OpticalTable)
@_validate.takes_units()
def measure_phase_response(table: OpticalTable, *, samples: int = 25, captures: int = 4) -> np.ndarray:
    """Measure the phase of each level of a modulator.

    Two opposite quarters of the panel show a level g, the same everywhere; a fixed pattern deflects the light of those
    beside them onto their light. Behind them the field is A·e^{iφ(g)} + B, so that the intensity of each pixel of the
    camera is a sum of a constant, cos φ(g) and sin φ(g), whatever the aberration, the illumination and the alignment
    are. The two largest principal components of the captures are such sums too; the ellipse on which they lie gives the
    phase. The mean of the results of the two quarters is returned. Behind a lens, and where fringing fields along the
    borders disturb, halves of the panel take the place of the quarters, one after the other.

    Parameters
    ----------
    table : OpticalTable
        The table. The exposure of the camera is set for light that is not focused, four times as long as the brightest
        pixels allow, which are left out. Behind a lens both halves form the focus on the axis, and the sign of the
        phases, for which the image turns by 180°, is taken to be positive.
    samples : int
        Number of levels measured, at least 8; those between are interpolated by a cubic spline.
    captures : int
        Number of captures that are averaged for each pattern of a half at most, twice as many for one of quarters, and
        three times as many for level 0, whose error is in all phases; four times as many behind a lens, whose focus few
        pixels see. One is enough where its noise changes a phase of a half by less than 0.65 mrad.

    Returns
    -------
    numpy.ndarray
        Phases in radians ``[2^bits]``, relative to level 0, unwrapped; they fall with the level where a lens pattern
        focuses for that sign.
        Where the response varies over the panel, it is a mean over what lies near its middle.

    Raises
    ------
    RuntimeError
        If no change of the phase with the level is detected by the camera.

    Warns
    -----
    AccuracyWarning
        If the captures deviate from such sums by more than 10 %: a level does not have the same phase at all pixels;
        if the phases leave out more than 0.15π of 2π; or if the camera sees no focus that would tell their sign.

    Notes
    -----
    Principal components of interferograms: Vargas, Antonio Quiroga and Belenguer, Opt. Lett. 36, 1326 (2011).

    The levels measured are Chebyshev's points, because the response often bends most near the ends of its range.

    Fringing fields smooth the phase across the border of the two halves, over some tenths of a pixel, and nowhere else.
    The rows along the border alternately show the lowest and the highest level: the light that the border scatters has
    opposite signs in the two cases where they are 2π apart, up to a sum of a constant and cos φ.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import OpticalTable, SimulatedTable, measure_phase_response
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> phases = measure_phase_response(OpticalTable(hidden.modulator, hidden.camera, 532e-9, 4e-3), samples=9)
    >>> bool(np.abs(phases - hidden.truth.phases).max() < 0.02)
    True
    """
    phases, _, spread = phases_with_uncertainty(table, samples, captures)
    _warn_of_deviations(spread)
    warn_of_short_range(phases)
    return phases


@watched("phases")
def phases_with_uncertainty(
    table: OpticalTable, samples: int = 25, captures: int = 4
) -> tuple[np.ndarray, float, float]:
    """Return the phase of each level, its uncertainty, and the deviation of the captures from one phase at all pixels.

    The parameters are as in :func:`measure_phase_response`.
    """
    modulator, camera, wavelength, distance = parts_of(table)
    top = (1 << _validate.integer("modulator.bits", modulator.bits, minimum=1)) - 1
    # Responses that begin as a power of the level bend most there.
    levels = np.union1d(_measured_levels(top, samples), [1])
    rows, columns = modulator.shape
    left, upper = np.arange(columns) < columns // 2, np.arange(rows)[:, None] < rows // 2
    border = np.s_[:, columns // 2 - GUARD : columns // 2 + GUARD]
    one_side = [np.broadcast_to(side, modulator.shape) for side in (left, ~left)]
    if isinstance(distance, Lens):
        captures = 4 * captures
        pattern = np.full(modulator.shape, (top + 1) // 2)
        pattern[border] = _guard(modulator, top)[border]
        ways = [(1.0, pattern, one_side)]
    else:
        pattern = _onto_the_other_half(modulator, wavelength, distance, top)
        pattern[border] = _guard(modulator, top)[border]
        crossed = pattern.copy()
        crossed[rows // 2 - GUARD : rows // 2 + GUARD] = np.arange(columns) % 2 * top
        crossed[border] = pattern[border]
        # With the level on the left above and on the right below, one pattern tells the response of both halves. It has
        # twice as much border, whose fringing fields disturb.
        ways = [(BRIGHTER, crossed, [left == upper]), (BRIGHT, pattern, one_side)]
    modulator.show(np.where(left, pattern, (top + 1) // 2))
    if isinstance(distance, Lens):
        # Interference may make the focus twice as bright.
        set_exposure(camera, level=0.35)
        focus = brightest(averaged(camera, 1))
        _, b = distance.ray_matrix
        width = wavelength * abs(b) / (min(modulator.shape) * modulator.pitch * camera.pitch)
        read_around(camera, focus, int(min(3 * width + 6, (min(camera.shape) - 1) // 2)))
        step = 1
    else:
        reach = int(min(0.5 * columns * modulator.pitch / camera.pitch + 1, (min(camera.shape) - 1) // 2))
        step = 1 + 2 * reach // LARGEST_WINDOW
        read_around(camera, np.array(camera.shape[::-1]) // 2, reach)
        camera.exposures["even"] = set_exposure(camera) / 2
    before = np.stack([camera.capture(1)[0].astype(float) for _ in range(2)])
    ambient = _ambient(camera, before.mean(0))
    other = nearest_levels(deflected(modulator), np.array([0, np.pi])) * (top + 1) // 2
    check_frames_are_new(modulator, camera, before, other)
    # Upward and back, so that a drift is no response; level 0, whose error is in all phases, tells that of the light.
    turns = np.array([0, *range(2, len(levels), 2), 0, *range(len(levels) - 1 - len(levels) % 2, 0, -2), 0])

    def seen(count: int, pattern: np.ndarray, sides: list[np.ndarray]) -> list[np.ndarray]:
        """Return sums of as many captures of each level on each side ``[levels, rows, columns]``."""
        found = []
        for fixed in sides:
            frames = []
            for level in levels[turns]:
                modulator.show(np.where(fixed, pattern, level))
                taken = camera.capture(count)
                frames.append(count * np.where(taken < SATURATED * camera.top, taken, np.nan).mean(0))
            even = _without_ambient(np.stack(frames))
            even /= _drift(even, turns)[:, None, None]
            found.append(np.stack([even[turns == number].mean(0) for number in range(len(levels))]))
        return found

    def halves(frames: list[np.ndarray]) -> list[np.ndarray]:
        still = [_still(frame)[:, ::step, ::step] for frame in frames]
        return [frame.reshape(len(levels), -1) for frame in still] if len(still) > 1 else _halved(still[0])

    captures = _validate.integer("captures", captures, minimum=1)
    exposure = camera.exposure
    for brighter, *shown in ways:
        # Light that does not come from the modulator must not saturate all pixels.
        camera.exposure = max(1.0, min(brighter, 0.7 / max(ambient, 1e-3))) * exposure
        frames = seen(1, *shown)
        most = 2 * captures // len(frames)
        more = min(most, math.ceil(max((_phases_of_interference(half)[2] / NOISE) ** 2 for half in halves(frames)))) - 1
        if more > 0:
            frames = [one + others for one, others in zip(frames, seen(more, *shown), strict=True)]
        (one, first, *noise), (other, second, *more_noise) = (_phases_of_interference(half) for half in halves(frames))
        spread = max(first, second)
        if spread < DEVIATING:
            break
    camera.region = None
    mean = (one + other) / 2
    if not isinstance(distance, Lens):
        mean = mean * _sign(modulator, camera, wavelength, distance, levels, mean)
    phases, fewer = (_of_all_levels(levels[used], mean[used], top) for used in (np.s_[:], np.s_[::2]))
    # Near level 0, a power law is interpolated by half the samples with several times the error. Fringing fields cause
    # errors of about half of what captures deviate from one phase at all pixels, as a share of the interference.
    within = levels[-1 - (len(levels) + 1) % 2]
    interpolation = float(np.abs(phases - fewer)[:within].max())
    # What the results of the halves differ by more than their noise is no noise.
    of_both = math.hypot(*noise, *more_noise)
    apart = math.sqrt(max(float(np.abs(one - other).max()) ** 2 - (RARELY * of_both) ** 2, 0))
    # Where captures deviate, by flicker as a rule, phases of single levels do so from a smooth response, too.
    flicker = min(ROUGH * _roughness(levels, mean, top), MOST * spread)
    return phases, math.hypot(LARGEST / 2 * of_both, apart / 2, 0.005 * interpolation, 0.4 * spread, flicker), spread


def _roughness(levels: np.ndarray, phases: np.ndarray, top: int) -> float:
    """Return the standard deviation of the phases of some levels from a smooth response.

    It is a sum of two thirds as many cosines of the angle of :func:`_of_all_levels` as there are levels.
    """
    terms = 2 * len(levels) // 3
    system = np.cos(np.outer(np.arccos(1 - 2 * levels / top), np.arange(terms)))
    left = phases - system @ np.linalg.lstsq(system, phases, rcond=None)[0]
    return math.sqrt((left**2).sum() / (len(levels) - terms))


@_validate.takes_fields("modulator camera wavelength distance phases", table=OpticalTable)
@_validate.takes_units()
def measure_unmodulated_light(table: OpticalTable, *, samples: int = 6, captures: int = 1) -> complex:
    """Measure the light of gaps and of the cover glass, which does not follow the levels.

    All pixels show one phase φ, and send e^{iφ} + c, whose intensity 1 + |c|² + 2·|c|·cos(φ − arg c) tells the
    unmodulated part c from captures of several phases. The last is the first one again, and a linear drift of the
    light is fitted too.

    Parameters
    ----------
    table : OpticalTable
        The table, with phases. Without a lens, part of the camera's image must lie beside the light of the modulator.
    samples : int
        Number of phases, at least 4.
    captures : int
        Number of captures that are averaged for each.

    Returns
    -------
    complex
        Amplitude of the unmodulated light in units of that of the pixels, at level 0 of phase 0: (1 − F)/F for gaps
        that reflect as pixels of a share F of the area do. Light of another wavefront, as from a cover glass before an
        aberration, counts as far as its wavefront is that of the pixels.

    Examples
    --------
    >>> from odak.instruments import OpticalTable, SimulatedTable, measure_unmodulated_light
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(96, 96), aberration=0.0)
    >>> table = OpticalTable(hidden.modulator, hidden.camera, 532e-9, 4e-3, hidden.truth.phases)
    >>> found = measure_unmodulated_light(table)
    >>> bool(abs(found - hidden.truth.reflection) < 0.01)
    True
    """
    modulator, camera, _, distance, phases = parts_of(table, "phases")
    samples = _validate.integer("samples", samples, minimum=4)
    captures = _validate.integer("captures", captures, minimum=1)
    camera.region = None
    shown, seen = [], []
    for number in range(samples + 1):
        levels = nearest_levels(np.full(modulator.shape, 2 * np.pi * (number % samples) / samples), phases)
        modulator.show(levels)
        # Levels show phases nearby.
        shown.append(np.exp(1j * phases_of_levels(levels, phases)).mean())
        if number == 0:
            # Interference may be half as bright again.
            camera.exposure = camera.exposures.get("even", camera.exposure)
            set_exposure(camera, level=0.4)
            if isinstance(distance, Lens):
                read_around(camera, brightest(averaged(camera, 1)), min(20, (min(camera.shape) - 1) // 2))
        frame = averaged(camera, captures)
        seen.append((frame - np.quantile(frame, 0.02)).sum())
    camera.region = None
    along, time = np.array(shown), np.linspace(-0.5, 0.5, samples + 1)
    system = np.stack([np.ones(samples + 1), along.real, along.imag, time], axis=-1)
    (mean, cosine, sine, _), *_ = np.linalg.lstsq(system, np.array(seen), rcond=None)
    # 2c/(1 + |c|²) of a c below 1.
    depth = complex(cosine, sine) / mean
    return complex(depth / (1 + math.sqrt(max(1 - abs(depth) ** 2, 0))))


def _ambient(camera: Camera, frame: np.ndarray) -> float:
    """Return the light that does not interfere as a share of the camera's range, and warn where it is most of it.

    Interference makes some pixels dark.
    """
    top = (1 << camera.bits) - 1
    darkest, brightest = float(np.quantile(frame, 0.02)), float(frame.max())
    if darkest > AMBIENT * brightest:
        warn(
            f"ambient light is {darkest / brightest:.0%} of the brightest pixel: its noise and changes are in all "
            "results, and little of the camera's range is left; darken the room, shield the camera, or use a filter of "
            "the wavelength",
            AccuracyWarning,
        )
    return darkest / top


def _onto_the_other_half(modulator: SLMDriver, wavelength: float, distance: float, top: int) -> np.ndarray:
    """Return the levels that deflect the light of each half of a modulator onto the light of the other."""
    # The lens narrows the light of a half to four fifths, away from the border, whose fringing fields disturb.
    columns = modulator.shape[1]
    focal, size = 4.5 * distance, columns * modulator.pitch
    shift = min(size / 2, max(0.9 * wavelength * distance / (2 * modulator.pitch) - size / 12, size / 8))
    y, x = pixel_axes(modulator)
    side = np.where(np.arange(columns) < columns // 2, -1, 1)
    away = x - side * size / 4
    lens = -2 * np.pi / wavelength * (side * away * shift / distance + (away**2 + y**2) / (2 * focal))
    return nearest_levels(lens, np.arange(top + 1) * 2 * np.pi / (top + 1))


def _sign(
    modulator: SLMDriver, camera: Camera, wavelength: float, distance: float, levels: np.ndarray, phases: np.ndarray
) -> int:
    """Return the sign of phases of levels, which interference does not tell, as that for which a lens focuses."""
    y, x = pixel_axes(modulator)
    # The focus of so small an aperture is deep enough for a nominal distance.
    inside = np.maximum(abs(x), abs(y)) <= 3 * math.sqrt(wavelength * distance)
    lens = np.where(inside, lens_phase(modulator, wavelength, distance), deflected(modulator))
    every = _of_all_levels(levels, phases, levels[-1])
    peaks = []
    for sign in (1, -1):
        modulator.show(nearest_levels(lens, sign * every))
        if sign == 1:
            # From the dark side fewer captures are needed.
            camera.exposure /= FOCUSED
            set_exposure(camera)
        smooth = uniform_filter(averaged(camera, 1), 3)
        peaks.append(float(smooth.max() - np.median(smooth)))
    if max(peaks) < 2 * min(peaks):
        warn(
            "whether the phase grows or falls with the level is not known and is taken to grow: a lens pattern and its "
            f"inverse give spots of {peaks[0]:.0f} and {peaks[1]:.0f} counts; check the distance, and that the camera "
            "sees the axis of the modulator",
            AccuracyWarning,
        )
        return 1
    return 1 if peaks[0] > peaks[1] else -1


def check_frames_are_new(
    modulator: SLMDriver, camera: Camera, pair: np.ndarray, other: np.ndarray, count: int = 5
) -> None:
    """Raise an error if a camera returns frames as a pair of the pattern before, after another one was shown."""
    first, second = pair
    modulator.show(other)
    before, noise = (first + second) / 2, ((first - second) ** 2).mean()
    frames = [camera.capture(1)[0].astype(float) for _ in range(2)]
    # Two that differ from those before and from one another by noise alone are new.
    if ((frames[0] - before) ** 2).mean() > 9 * noise > 4 * ((frames[0] - frames[1]) ** 2).mean():
        return
    frames += [camera.capture(1)[0].astype(float) for _ in range(count - 2)]
    last = frames[-1]
    if ((last - before) ** 2).mean() < 9 * noise:
        return
    older = [((frame - before) ** 2).mean() < ((frame - last) ** 2).mean() for frame in frames]
    if any(older):
        raise RuntimeError(
            STALE.format(sum(older), "a new pattern was shown", "the one before")
            + f"; or set a longer settling_time of the modulator, now {modulator.settling_time:g} s"
        )


def _guard(modulator: SLMDriver, top: int) -> np.ndarray:
    """Return the levels beside the border of a part that shows one level g: 0 and the highest in alternate rows.

    Fringing fields smooth the phase across that border, between 0 and φ(g) or between φ(g) and about 2π. The light that
    this scatters has opposite signs in the two cases, up to a sum of a constant and cos φ.
    """
    return np.broadcast_to(np.arange(modulator.shape[0])[:, None] % 2 * top, modulator.shape).copy()


def _measured_levels(top: int, samples: int) -> np.ndarray:
    """Return the levels whose phases are measured, Chebyshev's points, which are denser at the ends of the range."""
    count = _validate.integer("samples", samples, minimum=8)
    return np.unique(np.rint(top / 2 * (1 - np.cos(np.pi * np.arange(count) / (count - 1)))).astype(int))


def _of_all_levels(levels: np.ndarray, phases: np.ndarray, top: int) -> np.ndarray:
    """Return the phases of all levels from the phases of some.

    The spline is one of the angle whose cosine the level is. Chebyshev's points are evenly spaced in it, and a response
    that bends as a power of the level near the ends of its range is smoother, with a slope of zero there.
    """
    angles = np.arccos(1 - 2 * np.arange(top + 1) / top)
    return CubicSpline(angles[levels], phases, bc_type="clamped")(angles)


def _without_ambient(frames: np.ndarray) -> np.ndarray:
    """Return frames ``[n, rows, columns]`` less their means, which change with light that lies evenly on the camera.

    Means of interference depend on the phase as single pixels do.
    """
    fine = np.isfinite(frames).all(0)
    if fine.mean() < FEWEST_FINE:
        raise RuntimeError(
            f"{1 - fine.mean():.0%} of the camera's pixels are saturated in a capture, where few were expected: "
            "ambient light or the laser became brighter; keep the light steady and measure again"
        )
    return frames - frames[:, fine].mean(-1)[:, None, None]


def _drift(frames: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """Return the light at the times of frames ``[n, rows, columns]``, 1 on average, by those of the first level."""
    times = np.flatnonzero(turns == 0)
    first = frames[times]
    first = first[:, np.isfinite(first).all(0)]
    light = first @ first.mean(0)
    line = np.polynomial.Polynomial.fit(times, light / light.mean(), 1)
    missed = np.abs(light / light.mean() - line(times)).max()
    clear = np.ptp(line(times)) > CLEAR * missed
    return line(np.arange(len(turns))) if clear else np.ones(len(turns))


def _still(frames: np.ndarray) -> np.ndarray:
    """Return captures ``[n, rows, columns]``, moved to where the image of most of them is if it moves.

    Saturated pixels are NaN.
    """
    crop = tuple(slice(max(n - LARGEST_WINDOW, 0) // 2, (n + LARGEST_WINDOW) // 2) for n in frames.shape[1:])
    part = frames[:, crop[0], crop[1]]
    usable = ~binary_dilation(np.isnan(part).any(0), iterations=SLOPES.size // 2)
    filled, moved = np.nan_to_num(part, nan=np.nanmax(part)), np.zeros((len(part), 2))
    for _ in range(MOVES):
        now = moved_back(filled, moved) if moved.any() else filled
        down, across = slopes_of(now)
        change = _displacements(now[:, usable], down[:, usable], across[:, usable])
        moved += change - change.mean(0)
        if math.sqrt((change**2).mean()) < STILL:
            break
    if math.sqrt((moved**2).mean()) < STILL:
        return frames
    lost = binary_dilation(np.isnan(frames).any(0), iterations=SLOPES.size // 2)
    return np.where(lost, np.nan, moved_back(np.nan_to_num(frames, nan=np.nanmax(frames)), moved))


def _displacements(seen: np.ndarray, down: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return the displacements down and across ``[n, 2]`` of captures ``[n, pixels]`` from their slopes.

    Without displacements, captures are sums of three images, and what deviates from such sums is the slope of each
    times its displacement.
    """
    moved, still, left_over = np.zeros((len(seen), 2)), seen, []
    for _ in range(ALIGNMENTS):
        values, vectors = np.linalg.eigh(still @ still.T)
        # The slopes of three images along two axes are six more: what is left is noise, which all components have.
        noise = (len(values) - 3) * values[1 : max(len(values) - 9, 2)].mean()
        left_over.append(values[:-3].sum())
        three = vectors[:, -3:] @ vectors[:, -3:].T
        slopes = np.stack([three @ down, three @ across], axis=1)
        left = still - three @ still
        normal = np.einsum("nip,njp->nij", slopes, slopes)
        moved += np.linalg.solve(normal, np.einsum("nip,np->ni", slopes, left)[..., None])[..., 0]
        still = seen - np.einsum("ni,nip->np", moved, slopes)
    # A response that varies over the panel deviates from such sums too, and is no displacement.
    first, last = np.array(left_over)[[0, -1]] - noise
    return moved if last < EXPLAINED * first else 0 * moved


def _halved(frames: np.ndarray) -> list[np.ndarray]:
    """Return the frames ``[n, pixels]`` of the first and of the last rows, of which each has half of the changes."""
    changes = np.nan_to_num(frames.var(0)).sum(-1).cumsum()
    row = int(np.clip(np.searchsorted(changes, changes[-1] / 2), 1, len(changes) - 1))
    return [part.reshape(len(part), -1) for part in (frames[:, :row], frames[:, row:])]


def _phases_of_interference(frames: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return the phase of each of the frames ``[n, pixels]``, whose pixels are a + b·cos φ + c·sin φ.

    The second result is the size of what deviates from such sums, as a share of the smaller of their two components:
    the third one beyond noise, which all components have in steps of about one size. The third is the standard
    deviation of a phase by the noise of the frames.
    """
    frames = frames[:, np.isfinite(frames).all(0)]
    changes = frames - frames.mean(0)
    values = np.clip(np.linalg.eigvalsh(changes @ changes.T), 0, None)
    noise, least = values[-4], values[1]
    other = math.sqrt(max(values[-3] - noise - RARELY * (noise - least) / (len(frames) - 5), 0) / values[-2])
    # Where the light varies, the constant image is not constant: the sum of three images that is nearest to one at all
    # frames is the light of each.
    three = np.linalg.eigh(frames @ frames.T)[1][:, -3:]
    frames = frames / (three @ three.sum(0))[:, None]
    frames -= frames.mean(0)
    values, vectors = np.linalg.eigh(frames @ frames.T)
    values = np.clip(values, 0, None)
    x, y = vectors[:, -1] * len(frames) ** 0.5, vectors[:, -2] * len(frames) ** 0.5
    # Bright pixels have more noise, and more of the interference.
    components = vectors[:, -3:].T @ frames
    of_pixels = ((frames - vectors[:, -3:] @ components) ** 2).sum(0) / (len(frames) - 4)
    variances = (components[1:] ** 2 @ of_pixels) / values[-2:] ** 2
    # The ellipse x² q0 + x y q1 + y² q2 + x l0 + y l1 = 1 through the points, made a circle.
    system = np.stack([x * x, x * y, y * y, x, y], axis=-1)
    (xx, xy, yy, *linear), *_ = np.linalg.lstsq(system, np.ones(len(x)), rcond=None)
    form = np.array([[xx, xy / 2], [xy / 2, yy]])
    sizes, axes = np.linalg.eigh(form)
    if sizes[0] <= 0 or values[-2] < 9 * values[1]:
        raise RuntimeError(
            "the camera must observe how the interference of the two halves of the modulator depends on the level; the "
            f"first two principal components of its captures are {values[-1] ** 0.5:.3g} and {values[-2] ** 0.5:.3g}, "
            f"the noise {values[1] ** 0.5:.3g}"
        )
    centre = -np.linalg.solve(2 * form, np.array(linear))
    circle = axes * np.sqrt(sizes) @ axes.T @ (np.stack([x, y]) - centre[:, None])
    phases = np.unwrap(np.arctan2(circle[1], circle[0]))
    phases = phases - phases[0]
    return phases if phases[-1] >= 0 else -phases, other, math.sqrt(len(frames) / 4 * variances.sum())


def _warn_of_deviations(other: float) -> None:
    """Warn if captures deviate much from the captures that levels with one phase at all pixels would give."""
    if other > DEVIATING:
        warn(
            f"the phase response is uncertain: captures deviate by {other:.0%} from a response with one phase at "
            "all pixels, because of fringing fields between them, or a response that varies over the panel or in time",
            AccuracyWarning,
        )


def warn_of_short_range(phases: np.ndarray) -> None:
    """Warn if the phases of the levels leave out a part of the circle, which holograms need."""
    wrapped = np.sort(np.mod(phases, 2 * np.pi))
    gap = float(np.diff(wrapped, append=wrapped[0] + 2 * np.pi).max())
    if gap > LARGEST_GAP:
        warn(
            f"the phases of the levels leave out {gap / np.pi:.2g}π of 2π: patterns get the nearest phase there and "
            "lose light to the zero order; increase the range of the modulator (voltages, look-up table), or use a "
            "shorter wavelength",
            AccuracyWarning,
        )


@_validate.takes_fields("modulator camera wavelength distance registration", table=OpticalTable)
@_validate.takes_units()
def measure_regional_response(
    table: OpticalTable, *, regions: Sequence[int] = (3, 3), samples: int = 15, captures: int = 4
) -> np.ndarray:
    """Measure the phase of each level in regions of a modulator, whose response varies over it.

    The regions of a column show a level g, the same everywhere; the light of the column beside it is deflected onto
    them by a fixed pattern. The intensity of each pixel of the camera is then a sum of a constant, cos φ(g) and
    sin φ(g), as in :func:`measure_phase_response`, with the phase of the part of the modulator that is in front of the
    pixel; the principal components are taken over the pixels in front of the middle of a region.

    Parameters
    ----------
    table : OpticalTable
        The table without a lens, with a registration and the aberration, which displaces the light of a region.
    regions : sequence of int
        Rows and columns of regions, two or more in all, of at least 12 pixels along each side.
    samples : int
        Number of levels measured, at least 8; those between are interpolated by a cubic spline.
    captures : int
        Number of captures that are averaged for each pattern.

    Returns
    -------
    numpy.ndarray
        Phases in radians ``[region rows, region columns, 2^bits]``, relative to level 0 of the region; they are taken
        to grow with the level, but for :func:`calibrate_table`, which knows the sign.

    Warns
    -----
    AccuracyWarning
        If the captures deviate from such sums by more than 10 %.

    Examples
    --------
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, measure_regional_response
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(96, 96), aberration=0.05)
    >>> mapping = Registration(hidden.truth.homography, hidden.truth.distortion, hidden.camera.shape)
    >>> table = OpticalTable(hidden.modulator, hidden.camera, 532e-9, 4e-3, registration=mapping)
    >>> phases = measure_regional_response(table, regions=(1, 2), samples=9, captures=1)
    >>> phases.shape, bool(abs(phases - hidden.truth.phases).max() < 0.1)
    ((1, 2, 256), True)
    """
    return regions_with_uncertainty(table, regions, samples, captures)[0]


@watched("regional_phases")
def regions_with_uncertainty(
    table: OpticalTable,
    regions: Sequence[int] = (3, 3),
    samples: int = 15,
    captures: int = 4,
    whole: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the phase of each level in regions, and the uncertainty of each region in radians ``[rows, columns]``.

    The parameters are as in :func:`measure_regional_response`; `whole` is the phase of each level of the whole
    modulator. Multiples of it are subtracted before phases are interpolated between the measured levels.
    """
    distance = without_lens(table.distance, "its pixels send light to the same places")
    modulator, camera, wavelength, _, registration = parts_of(table, "registration")
    wavefront = np.broadcast_to(table.wavefront, modulator.shape)
    rows, columns = modulator.shape
    down, across = _validate.size("regions", regions)
    if rows < SMALLEST_REGION * down or columns < SMALLEST_REGION * across:
        raise ValueError(
            f"regions must have at least {SMALLEST_REGION} pixels along each side, "
            f"got {down} x {across} of {rows} x {columns}"
        )
    if down * across == 1:
        raise ValueError(f"regions must be two or more, got {[down, across]}")
    if across == 1:
        mapping = replace(registration, homography=registration.homography[[1, 0, 2]])
        turned = replace(table, modulator=_Transposed(modulator), registration=mapping, wavefront=wavefront.T)
        found, uncertainty = regions_with_uncertainty(turned, (1, down), samples, captures, whole)
        return found.swapaxes(0, 1), uncertainty.T
    top = (1 << _validate.integer("modulator.bits", modulator.bits, minimum=1)) - 1
    levels = _measured_levels(top, samples)
    y, x = (
        [part * modulator.pitch for part in np.array_split(np.arange(n) - n // 2, parts)]
        for n, parts in ((rows, down), (columns, across))
    )
    number = np.repeat(np.arange(across), [len(part) for part in x])
    # Rows and columns of the camera that the light of each pixel of the modulator reaches.
    slopes = np.gradient(wavefront, modulator.pitch)[::-1]
    points = np.stack(np.meshgrid(np.concatenate(x), np.concatenate(y)), axis=-1)
    reached = registration.camera_pixels(points + wavelength * distance / (2 * np.pi) * np.stack(slopes, axis=-1))
    reached = reached.reshape(-1, 2)[:, ::-1]
    step = np.diff(registration.camera_pixels(np.array([[0.0, 0.0], [modulator.pitch, 0.0]])), axis=0)
    neighbours = 2 * math.ceil(np.linalg.norm(step)) + 1

    def on_the_camera(values: np.ndarray) -> np.ndarray:
        """Return the sums of values of the modulator's pixels over neighbourhoods of the camera's."""
        edges = (np.arange(registration.shape[0] + 1) - 0.5, np.arange(registration.shape[1] + 1) - 0.5)
        sums, *_ = np.histogram2d(reached[:, 0], reached[:, 1], edges, weights=values.ravel())
        return uniform_filter(sums, neighbours, mode="constant")

    lit = on_the_camera(np.ones(modulator.shape))
    # Mean points x, y of the modulator whose light a pixel of the camera receives: near caustics there are several.
    seen_at = [on_the_camera(values) / np.where(lit > 1e-9, lit, np.nan) for values in (points[..., 0], points[..., 1])]
    # Light of the edges spreads over about this width.
    spread = math.sqrt(wavelength * distance)

    def taper(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
        size = ends[-1] - ends[0]
        width = size - 2 * min(spread, 0.3 * size)
        return np.cos(np.pi * np.clip((values - ends.mean()) / width, -0.5, 0.5))

    if whole is None:
        whole = np.arange(top + 1.0)
    camera.region = None
    phases, (others, noise) = np.empty((down, across, top + 1)), np.empty((2, down, across))
    for column in range(across):
        beside = column + 1 if column + 1 < across else column - 1
        slope = 2 * np.pi / (wavelength * distance) * (x[column].mean() - x[beside].mean())
        deflected = np.rint(np.mod(slope * x[beside], 2 * np.pi) * (top + 1) / (2 * np.pi)).astype(int) % (top + 1)
        border = np.abs(np.arange(columns) - np.flatnonzero(number == beside).mean()) < len(x[beside]) / 2 + GUARD
        pattern = _guard(modulator, top)
        pattern[:, number == beside] = deflected

        def show(level: int, pattern=pattern, border=border) -> None:
            modulator.show(np.where(border, pattern, level))

        # Without a taper, light that fringing fields scatter at the border resembles the interference.
        weights = [np.nan_to_num(taper(seen_at[0], x[column]) * taper(seen_at[1], part)) for part in y]
        places = [weight > 0.01 for weight in weights]
        for row, place in enumerate(places):
            if place.sum() < 2 * len(levels):
                raise RuntimeError(f"region {[row, column]} of the modulator lies outside the camera's image")
        set_exposure(camera, partial(show, (top + 1) // 2))
        frames = []
        for level in levels:
            show(int(level))
            frames.append(averaged(camera, captures))
        for row, (weight, place) in enumerate(zip(weights, places, strict=True)):
            lines = [np.flatnonzero(place.any(axis)) for axis in (1, 0)]
            window = tuple(slice(line[0], line[-1] + 1) for line in lines)
            still = weight[window] * _still(_without_ambient(np.stack([frame[window] for frame in frames])))
            found, others[row, column], noise[row, column] = _phases_of_interference(still[:, place[window]])
            found = found * (1 if whole[-1] >= whole[0] else -1)
            like = whole * (found @ whole[levels]) / (whole[levels] @ whole[levels])
            phases[row, column] = like + _of_all_levels(levels, found - like[levels], top)
    _warn_of_deviations(others.max())
    return phases, np.hypot(0.5 * others, LARGEST * noise)


def without_lens(path: float | Lens, reason: str) -> float:
    """Return a distance, and raise an error that gives the reason for a lens."""
    if isinstance(path, Lens):
        raise TypeError(f"distance must be a number: behind a lens {reason}, got {path!r}")
    return path


class _Transposed:
    """Modulator whose rows are the columns of another."""

    def __init__(self, modulator: SLMDriver):
        self.modulator, self.shape, self.pitch = modulator, modulator.shape[::-1], modulator.pitch
        self.bits, self.settling_time = modulator.bits, modulator.settling_time

    def show(self, levels: np.ndarray) -> None:
        self.modulator.show(levels.T)
