"""Amplitude of the light at each pixel of a modulator, and dust on it."""

import itertools
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.exposures import combined, exposed
from odak.instruments.mapping import Lens, ray_matrix
from odak.instruments.phase_response import nearest_levels
from odak.instruments.spots import averaged, lens_phase, pixel_axes, read_around
from odak.instruments.steadiness import watched
from odak.instruments.tables import OpticalTable, parts_of

# Points at which the illumination is measured, as a share of the farthest that a pixel reaches, and phases of parts.
ASIDE = 0.3
# Mean share of the light that is missing in dark parts, above which a root mean square of about 1 % is missing.
DUSTY = 1.5e-4
# Share of the light that specks of dust absorb, and uncertainty of the illumination that is reported.
DEPTH, EVEN = 0.7, 0.013
# Bits of cameras below which each pattern is captured at a second exposure, longer by a factor, because most speckles
# are much darker than the brightest; and electrons of a full pixel, from which the weights follow.
FEW_BITS, LONGER, WELL = 10, 8, 20_000.0
# Root mean square of eight independent errors, about, that two of three are below, in units of their deviation: 1.08,
# and as much again as patterns of one point have errors of the model in common, on independent tables.
LARGER = 1.25
# Half the width of the places that are evaluated, as a share of the width of a cell's light, and pixels of it at most.
VIEW, WIDEST = 0.7, 24
# Distance of the outermost points of a wide modulator from its edges, and of its points from one another, in units of
# what a pixel reaches; patterns of each point at least.
EDGE, APART, FEWEST_PATTERNS = 0.7, 1.2, 4
QUARTERS = np.arange(4) * (np.pi / 2)


@_validate.takes_fields("modulator camera wavelength distance phases registration", table=OpticalTable)
@_validate.takes_units()
def measure_illumination(
    table: OpticalTable,
    *,
    cells: int = 8,
    order: int = 4,
    patterns: int = 40,
    captures: int = 1,
) -> np.ndarray:
    """Measure the amplitude of the illumination at a modulator.

    All pixels focus at one point, and cells × cells parts of them get random phases. The intensities at that point and
    its neighbours are given by a sum of waves whose amplitudes are the exponential of a polynomial of the position. How
    much light a pixel sends to the point depends on the angle, too, because of the area of the pixels, the gaps between
    them and fringing fields; four points are used, so that the dependence on the angle is separated from that on the
    position. The coefficients of both are fitted. Cameras of fewer than 10 bits capture each pattern at two exposures.

    Parameters
    ----------
    table : OpticalTable
        The table, with phases, a registration and the aberration that is corrected.
    cells : int
        Number of parts along each axis.
    order : int
        Order of the polynomial of the two coordinates.
    patterns : int
        Number of patterns shown, at least 16.
    captures : int
        Number of captures that are averaged for each pattern.

    Returns
    -------
    numpy.ndarray
        Amplitude at each pixel of the modulator, 1 at its largest.

    Warns
    -----
    AccuracyWarning
        If parts of the modulator that send light to all points are darker than the polynomial, for example because of
        dust; or if the deviations of the captures from the model give an uncertainty of more than 0.013. The message
        contains it: the root mean square over the pixels, by the scatter of the captures. It does not contain how far a
        beam is from the polynomial. Small specks of dust are not detected (one of five simulated tables with three
        specks, with an error of 2 %).

    Examples
    --------
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, measure_illumination
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> truth = hidden.truth
    >>> mapping = Registration(truth.homography, truth.distortion, hidden.camera.shape)
    >>> known = (532e-9, truth.distance, truth.phases, mapping, truth.wavefront)
    >>> found = measure_illumination(OpticalTable(hidden.modulator, hidden.camera, *known))
    >>> bool(abs(found - truth.amplitude / truth.amplitude.max()).mean() < 0.02)
    True
    """
    return illumination_with_uncertainty(table, cells, order, patterns, captures)[0]


@watched("amplitude")
def illumination_with_uncertainty(
    table: OpticalTable, cells: int = 8, order: int = 4, patterns: int = 40, captures: int = 1
) -> tuple[np.ndarray, float]:
    """Return the amplitude of the illumination at a modulator, and its uncertainty (root mean square).

    The parameters are as in :func:`measure_illumination`.
    """
    modulator, camera, wavelength, distance, *_ = parts_of(table, "phases", "registration")
    rows, columns = modulator.shape
    cells, order = _validate.integer("cells", cells, minimum=3), _validate.integer("order", order, minimum=1)
    behind_lens, (_, b) = isinstance(distance, Lens), ray_matrix(distance)
    farthest = wavelength * abs(b) / (2 * modulator.pitch)
    half = max(rows, columns) * modulator.pitch / 2
    if not behind_lens:
        # Four of them at least lie within what a pixel reaches.
        cells = max(cells, math.ceil(4 * half / farthest))
    number = [np.minimum(np.arange(n) * cells // n, cells - 1) for n in (rows, columns)]
    cell = number[0][:, None] * cells + number[1]
    points = _points(table, farthest, half)
    draw = np.random.default_rng(0)
    each = max(-(-_validate.integer("patterns", patterns, minimum=16) // len(points)), FEWEST_PATTERNS)
    there = replace(table, camera=camera)
    parts: list[_Speckles] = []
    for point in points:
        # Pixels of a wide modulator do not reach all of them.
        if not parts or len(points) > 4:
            _expose(there, point)
        parts.append(_speckles(there, point, cell, draw.integers(4, size=(each, cells * cells)), captures))
    powers = [(i, j) for i, j in itertools.product(range(order + 1), repeat=2) if 0 < i + j <= order]

    def logarithm(part: _Speckles, parameters: np.ndarray, places: np.ndarray) -> np.ndarray:
        x, y = places.T / half
        # Behind a lens all pixels send light to a point at the same angle.
        from_point = 0 * places if behind_lens else places - part.point
        along, across = from_point.T * (modulator.pitch / (wavelength * b))
        squares = along**2 + across**2
        surface = np.stack(
            [x**i * y**j for i, j in powers] + [squares, along**4 + across**4, np.sqrt(squares + 0.01)], axis=-1
        )
        return parameters[0] / 2 + surface @ parameters[4:] + 1j * (parameters[1] * x + parameters[2] * y)

    def waves_of(part: _Speckles, parameters: np.ndarray) -> np.ndarray:
        return part.sizes * np.exp(logarithm(part, parameters, part.places)) * part.tilts

    def varied(part: _Speckles, parameters: np.ndarray) -> _Speckles:
        """Return a part whose cells have amplitudes that vary within them as the parameters say."""
        middle, slopes, mean = logarithm(part, parameters, part.places).real, [], 1.0
        for axis in np.eye(2):
            low, high = (
                logarithm(part, parameters, part.places + side * axis * part.widths).real for side in (-0.5, 0.5)
            )
            slopes.append(high - low)
            mean = mean * (1 + (low + high - 2 * middle) / 6)
        tilts = _tilts(part.away, part.places, part.widths, modulator.pitch, np.stack(slopes, axis=-1))
        return part._replace(tilts=mean * part.envelope * tilts)

    def fields(part: _Speckles, parameters: np.ndarray) -> np.ndarray:
        return np.tensordot(1j**part.steps, waves_of(part, parameters), axes=(1, 2))

    def misfit(parameters: np.ndarray) -> np.ndarray:
        # What was taken for no light was little light.
        darkest = parameters[3]
        seen = [
            (np.abs(fields(part, parameters)) ** 2).mean(-1) - darkest * part.seen.mean() - part.seen for part in parts
        ]
        return np.concatenate([(s / part.noise).ravel() for s, part in zip(seen, parts, strict=True)])

    start = np.zeros(4 + len(powers) + 3)
    start[0] = math.log(
        sum(part.seen.mean() for part in parts) / sum((np.abs(fields(part, start)) ** 2).mean() for part in parts)
    )
    scale = np.append(np.ones(len(start) - 3), [1.0, 10.0, 1.0])
    # The first fit, with even cells, tells how the amplitude varies within them, by which it is wrong by about 0.5 %.
    start = least_squares(misfit, start, x_scale=scale).x
    parts = [varied(part, start) for part in parts]
    fit = least_squares(misfit, start, x_scale=scale)
    fitted = fit.x
    # Deviations of the amplitude and of the phase of each cell from the polynomial, by one step of Gauss and Newton.
    slopes = []
    for part in parts:
        field = fields(part, fitted)[..., None].conj()
        change = 2 * (field * waves_of(part, fitted) * (1j**part.steps)[:, None, None]).mean(2) / part.noise[..., None]
        slopes.append(np.concatenate([change.real, -change.imag], axis=-1).reshape(-1, 2 * cells * cells))
    system, left = np.concatenate(slopes), -misfit(fitted)
    inverse = np.linalg.pinv(system.T @ system, rcond=1e-6)
    deviation = (inverse @ (system.T @ left))[: cells * cells]
    sigma = np.sqrt(np.clip(np.diag(inverse)[: cells * cells], 0, None) * left.var())
    whole = np.min([part.sizes for part in parts], axis=0) == np.bincount(cell.ravel())
    # Where captures deviate from the model by more than noise, parts scatter by more than that.
    sigma = np.maximum(sigma, 1.48 * np.median(abs(deviation[whole]))) if whole.any() else sigma
    dark = np.where(whole & (deviation < -4 * sigma), -deviation, 0)
    y, x = (np.broadcast_to(axis / half, modulator.shape) for axis in pixel_axes(modulator))
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    surface = terms @ fitted[4:-3]
    largest = np.unravel_index(surface.argmax(), surface.shape)
    amplitude = np.exp(surface - surface[largest])
    # Errors of a pattern are correlated among the pixels of the camera: the scatter of fits that each leave out one
    # pattern (jackknife) gives the variance, with one step of Gauss and Newton for each.
    ends = np.cumsum([part.seen.shape[1] for part in parts for _ in part.seen])[:-1]
    normal = fit.jac.T @ fit.jac
    changes = np.stack(
        [
            np.linalg.pinv(normal - rows_of.T @ rows_of) @ (rows_of.T @ missed)
            for rows_of, missed in zip(np.split(fit.jac, ends), np.split(fit.fun, ends), strict=True)
        ]
    )[:, 4:-3]
    variance = (((terms - terms[largest]) @ changes.T) ** 2).sum(-1) * (1 - 1 / len(changes))
    uncertainty = LARGER * math.sqrt((amplitude**2 * variance).mean())
    reason = ""
    if dark.mean() > DUSTY:
        reason = (
            f"parts of the modulator are darker than the polynomial by up to {dark.max():.0%}, for example because of "
            "dust, which the result does not contain"
        )
    elif uncertainty > EVEN:
        reason = "the captures deviate from the model"
    if reason:
        uncertainty = math.hypot(uncertainty, math.sqrt(DEPTH * dark.mean()))
        warn(f"the illumination is uncertain by {uncertainty:.2g} (root mean square): {reason}", AccuracyWarning)
    return amplitude, uncertainty


def _points(table: OpticalTable, farthest: float, half: float) -> np.ndarray:
    """Return the points x, y ``[n, 2]`` at which the illumination is measured, such that each pixel reaches some."""
    modulator, camera, _, distance, registration = parts_of(table, "registration")
    behind_lens = isinstance(distance, Lens)
    aside = ASIDE * farthest if behind_lens else min(ASIDE * farthest, half / 2)
    bounds = np.array(camera.shape[::-1]) - 1
    for _ in range(8):
        lines = []
        for count in modulator.shape[::-1]:
            last = count * modulator.pitch / 2 - EDGE * farthest
            number = 2 if behind_lens or last <= aside else math.ceil(2 * last / (APART * farthest)) + 1
            lines.append(np.linspace(-1, 1, number) * (aside if number == 2 else last))
        points = np.array(list(itertools.product(*lines)))
        places = registration.camera_pixels(points)
        there = ((places >= 3) & (places <= bounds - 3)).all(-1)
        if there.all() or len(points) > 4:
            break
        aside /= 2
    return points[there] if there.any() else points


class _Speckles(NamedTuple):
    """Captures of light that is focused at a point x, y, with random phases of cells."""

    point: np.ndarray
    steps: np.ndarray
    """Phases of the cells in quarters of a cycle ``[patterns, cells]``."""
    seen: np.ndarray
    """Intensities ``[patterns, pixels]``."""
    noise: np.ndarray
    places: np.ndarray
    """Middles x, y of the pixels of the cells that reach the point ``[cells, 2]``, and their number."""
    sizes: np.ndarray
    widths: np.ndarray
    away: np.ndarray
    """Points of the pixels of the camera beside the point, as spatial frequencies ``[pixels, 4, 2]``."""
    envelope: np.ndarray
    """Field that a pixel of a cell sends to these points, over that at the point ``[pixels, 4, cells or 1]``."""
    tilts: np.ndarray
    """Wave of each cell at these points ``[pixels, 4, cells]``."""


def _tilts(
    away: np.ndarray, places: np.ndarray, widths: np.ndarray, pitch: float, slopes: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return the waves of cells whose amplitude changes by factors exp(slopes) along their widths.

    The mean wave of n points a pitch p apart is sinc(npf)/sinc(pf) at a frequency f.
    """
    turns = away[..., None, :] * widths + 1j * slopes / (2 * np.pi)
    waves = np.exp(-2j * np.pi * (away @ places.T)) * np.sinc(turns).prod(-1)
    return waves / np.sinc(pitch * away).prod(-1)[..., None]


def _expose(table: OpticalTable, point: np.ndarray) -> None:
    """Set the exposure of the camera for the focus of all pixels at a point, at four tenths of its range."""
    modulator, camera, wavelength, distance, phases, registration = parts_of(table, "phases", "registration")
    place = np.rint(registration.camera_pixels(point)).astype(int)
    read_around(camera, place, int(min(14, *place, *(np.array(camera.shape[::-1]) - 1 - place))))
    modulator.show(nearest_levels(lens_phase(modulator, wavelength, distance, point) - table.wavefront, phases))
    exposed(camera, "focus", 0.4)
    camera.region = None


def _speckles(table: OpticalTable, point: np.ndarray, cell: np.ndarray, steps: np.ndarray, captures) -> _Speckles:
    """Capture the light of cells with random phases that is focused at a point."""
    modulator, camera, wavelength, distance, phases, registration = parts_of(table, "phases", "registration")
    y, x = pixel_axes(modulator)
    _, b = ray_matrix(distance)
    farthest = 0.95 * wavelength * abs(b) / (2 * modulator.pitch)
    if isinstance(distance, Lens):
        reaches = np.ones(modulator.shape, dtype=bool)
    else:
        reaches = (np.abs(x - point[0]) < farthest) & (np.abs(y - point[1]) < farthest)
    rows, columns = np.indices(modulator.shape)
    lens = lens_phase(modulator, wavelength, distance, point) - table.wavefront
    # The light of the other pixels is deflected by the largest angle, along the axis on which it would not come nearer.
    others = np.pi * np.where(np.abs(x - point[0]) < farthest, columns, rows)
    shown = np.stack([nearest_levels(np.where(reaches, lens + turn, others), phases) for turn in QUARTERS])
    # Within a part of the width of the light of a cell.
    size = max(rows_of * modulator.pitch for rows_of in modulator.shape) / math.sqrt(steps.shape[1])
    reach = int(np.clip(VIEW * wavelength * abs(b) / (size * camera.pitch), 2, WIDEST))
    place = np.rint(registration.camera_pixels(point)).astype(int)
    reach = min(reach, *place, *(np.array(camera.shape[::-1]) - 1 - place))
    read_around(camera, place, reach)

    def show(step: np.ndarray) -> None:
        modulator.show(np.take_along_axis(shown, step[cell][None], axis=0)[0])

    # Random phases spread the light over a region as many times larger as there are cells that send it; speckles are
    # up to five times as bright as their mean.
    cells = steps.shape[1]
    before = camera.exposure
    count = np.bincount(cell[reaches], minlength=cells)
    top, base = (1 << camera.bits) - 1, count.sum() / count.max() / 5 * before
    frames, times = [], []
    for factor in (1.0, LONGER) if camera.bits < FEW_BITS else (1.0,):
        times.append(camera.expose(factor * base))
        for step in steps:
            show(step)
            frames.append(averaged(camera, captures))
    camera.exposure = before
    seen = np.stack(frames).reshape(len(times), len(steps), -1)
    fine = seen[0].max(-1) < 0.95 * top
    # The minimum over many speckles is zero intensity.
    offsets = np.quantile(seen, 0.005, axis=(1, 2), keepdims=True)
    noise = (top / (WELL * captures), 1 / (12 * captures))
    usable, seen = seen < 0.95 * top, seen - offsets
    # A short exposure has few counts, and its offset is found to a count: longer ones have the same light.
    seen = [short - (short - seen[-1] * t / times[-1])[usable[-1]].mean() for short, t in zip(seen, times, strict=True)]
    seen = combined(np.stack(seen), usable, np.asarray(times), noise)[fine]
    row, column, high, wide = camera.region or (0, 0, *camera.shape)
    camera.region = None
    v, u = np.meshgrid(np.arange(row, row + high), np.arange(column, column + wide), indexing="ij")
    # A pixel averages over its area: Gauss's formula of two points along each axis.
    offsets = np.array(list(itertools.product((-1, 1), repeat=2))) / math.sqrt(12)
    points = registration.plane_points(np.stack([u, v], axis=-1).reshape(-1, 1, 2) + offsets)
    places, squares = (
        np.stack([np.bincount(cell[reaches], np.broadcast_to(a, cell.shape)[reaches], cells) for a in axes], axis=-1)
        / np.maximum(count, 1)[:, None]
        for axes in ((x, y), (x**2, y**2))
    )
    # The widths of the cells follow from their second moments.
    widths = np.sqrt(12 * np.clip(squares - places**2, 0, None) + modulator.pitch**2)
    away = (points - point) / (wavelength * b)
    noise = np.sqrt(np.clip(seen, 0, None) * seen.max() + (0.02 * seen.max()) ** 2)
    # All pixels lie at the same angle behind a lens.
    angles = np.zeros(2) if isinstance(distance, Lens) else places
    turns = (modulator.pitch / (wavelength * b)) * (points[..., None, :] - angles)
    at_point = (modulator.pitch / (wavelength * b)) * (point - angles)
    envelope = np.sinc(turns).prod(-1) / np.sinc(at_point).prod(-1)
    tilts = envelope * _tilts(away, places, widths, modulator.pitch)
    return _Speckles(point, steps[fine], seen, noise, places, count, widths, away, envelope, tilts)
