"""Distance from modulator to camera and astigmatism, from the sharpness of a spot over focal lengths."""

import itertools
import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.special import stdtrit

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.exposures import exposed, set_exposure
from odak.instruments.mapping import ray_matrix
from odak.instruments.phase_response import nearest_levels, without_lens
from odak.instruments.protocols import Camera, SLMDriver
from odak.instruments.spots import (
    DEFOCUS,
    aberration_modes,
    averaged,
    brightest,
    deflected,
    lens_phase,
    pixel_axes,
    read_around,
    unsaturated,
    without,
)
from odak.instruments.steadiness import watched
from odak.instruments.tables import OpticalTable, parts_of

# Range of the astigmatism that is tried on either side, in radians (root mean square).
ASTIGMATISM = 2 * np.pi * 0.1
# Step of defocus and astigmatism near the sharpest focus, too.
STEP = 2 * np.pi * 0.07
# Step of a sweep of focal lengths in units of the depth of focus, wavelength/width², of the aperture it is made with;
# the sharpness falls to half 3.5 units from its peak. Sweeps at most.
SWEPT, LARGEST_SWEEPS = 2.4, 12
# Standard deviation of the squared distance from the middle of a square is its area over this.
EVEN_SQUARE = math.sqrt(90)
# Defocus of a depth of focus in radians (root mean square).
DEEP = math.pi / EVEN_SQUARE
# The centre of a cube and the middles of its edges; and how often a search for the summit goes on from where it was.
DESIGN = np.array(sorted(itertools.product((-1, 0, 1), repeat=3), key=lambda place: np.abs(place).sum()))
DESIGN, LARGEST_SEARCH = DESIGN[np.isin(np.abs(DESIGN).sum(1), (0, 2))], 3
# Share of a normal distribution below one standard deviation.
ONE_SIGMA = 0.8413
# Factor by which the focus of all pixels is brighter than those of lenslets, about.
FOCUSED = 100.0
# Error of the sharpest focus in units of the depth of focus, without aberration and noise.
FOCUS = 0.01
# Share of the error of a wavefront without defocus that the sharpest focus takes for one: of the eleven terms of third
# and fourth order and of astigmatism, spherical aberration alone has its symmetry.
COUPLED = 0.2


@_validate.takes_fields("modulator camera wavelength distance phases registration", table=OpticalTable)
@_validate.takes_units()
def measure_distance(table: OpticalTable, *, span: float = 0.15, samples: int = 15, captures: int = 4) -> float:
    """Measure the distance from a modulator to a camera by the lens of sharpest focus.

    The depth of focus λ/NA² of all pixels may be a thousandth of the distance or less. A first sweep of focal lengths
    uses only as many pixels in the middle as are needed for a depth of focus of some steps, with the light of the
    others deflected; sweeps with more pixels, and narrower ranges, follow until all pixels are used.

    Parameters
    ----------
    table : OpticalTable
        The table without a lens, with its nominal distance, phases, a registration and the aberration that is
        corrected, whose defocus is excluded: it cannot be distinguished from the distance.
    span : float
        Half the range of the focal lengths of the first sweep, as a fraction of the distance, below 1.
    samples : int
        Number of focal lengths of each sweep.
    captures : int
        Number of captures that are averaged for each in the last sweep; the others take one.

    Returns
    -------
    float
        The distance in metres.

    Raises
    ------
    RuntimeError
        If no spot is detected, or the sharpness has no peak; the message says what the camera captured.

    Warns
    -----
    AccuracyWarning
        If the sharpest focus of the first sweep lies at an end of the range; the search continues beyond it.

    Examples
    --------
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, measure_distance
    >>> hidden = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> truth, there = hidden.truth, (hidden.modulator, hidden.camera, 532e-9, 4e-3)
    >>> mapping = Registration(truth.homography, truth.distortion, hidden.camera.shape)
    >>> found = measure_distance(OpticalTable(*there, truth.phases, mapping, truth.wavefront))
    >>> bool(abs(found / truth.distance - 1) < 0.02)
    True
    """
    return distance_with_uncertainty(table, span, samples, captures)[0]


def astigmatism_by_focus(table: OpticalTable) -> np.ndarray:
    """Return the wavefront of a table in radians with the astigmatism of the sharpest focus on the axis.

    Unlike the displacements of the spots of lenslets, the sharpness does not depend on the registration. Its logarithm
    is a parabola of the astigmatism, through three captures for each of the two directions.
    """
    modulator, camera, wavelength, distance, phases, registration = parts_of(table, "phases", "registration")
    start, modes = np.asarray(table.wavefront), aberration_modes(modulator, 2)
    wavefront = start
    low = modes[[0, 1, DEFOCUS]]
    read_around(camera, np.rint(registration.camera_pixels(np.zeros(2))).astype(int), 14)
    lens, share = lens_phase(modulator, wavelength, distance), _share_on_axis(modulator, wavelength, distance, np.inf)

    def show(surface: np.ndarray) -> None:
        modulator.show(nearest_levels(lens - surface, phases))

    show(start)
    # The focus of the right astigmatism may be three times as bright.
    middle = math.log(_sharpness(exposed(camera, "focus", 0.25, FOCUSED)))
    for mode in modes[[DEFOCUS - 1, DEFOCUS + 1]]:
        mode = without(mode, low)
        mode = mode * (ASTIGMATISM / math.sqrt((share * mode**2).sum()))
        values = []
        for step in (-1, 1):
            show(start + step * mode)
            values.append(math.log(_sharpness(averaged(camera, 1))))
        below, above = values
        bend = below + above - 2 * middle
        # Far from the peak, the curve is no parabola.
        peak = np.clip((below - above) / (2 * bend), -2, 2) if bend < 0 else np.sign(above - below)
        wavefront = wavefront + float(peak) * mode
    camera.region = None
    return wavefront


def focused(table: OpticalTable) -> tuple[OpticalTable, float]:
    """Return a table with the distance and the astigmatism of the sharpest focus, which are known roughly before.

    The area of a spot, the reciprocal of its sharpness, is a quadratic function of the three, as second moments are. It
    is fitted to 13 captures (Box and Behnken, Technometrics 2, 455 (1960)). The other result is the uncertainty of the
    distance in metres, without the error of the rest of the wavefront.
    """
    distance = without_lens(table.distance, "measure_wavefront finds the defocus")
    modulator, camera, wavelength, _, phases, registration = parts_of(table, "phases", "registration")
    modes = aberration_modes(modulator, 2)
    low = modes[[0, 1, DEFOCUS]]
    wavefront = without(np.asarray(table.wavefront, float), low)
    astigmatism = np.stack([without(mode, low) for mode in modes[[DEFOCUS - 1, DEFOCUS + 1]]])
    # What pixels send to the axis tells the sharpness.
    share = _share_on_axis(modulator, wavelength, distance, np.inf)
    astigmatism *= STEP / np.sqrt((share * astigmatism**2).sum((1, 2), keepdims=True))
    depth = _depth_of_focus(modulator, wavelength, distance, np.inf)
    step, power = STEP / DEEP * depth, 1 / distance
    reach = 3 * wavelength * distance / (min(modulator.shape) * modulator.pitch * camera.pitch)
    read_around(camera, np.rint(registration.camera_pixels(np.zeros(2))).astype(int), max(14, math.ceil(reach)))
    for _ in range(LARGEST_SEARCH):
        values = []
        for place in DESIGN:
            lens = lens_phase(modulator, wavelength, 1 / (power + place[0] * step))
            surface = wavefront + np.tensordot(place[1:], astigmatism, axes=1)
            modulator.show(nearest_levels(lens - surface, phases))
            frame = averaged(camera, 1) if place.any() else exposed(camera, "focus", 0.4)
            values.append(-1 / _sharpness(frame))
        peak, doubt = _summit(np.array(values))
        power, wavefront = power + peak[0] * step, wavefront + np.tensordot(peak[1:], astigmatism, axes=1)
        if abs(peak).max() < 0.5:
            break
    camera.region = None
    # Pixels send light into an envelope about the axis, and not about the direction to the focus: the sharpness of an
    # ideal table is not even either. Its vertex is some hundredths of the depth of focus beside the distance.
    powers = power + step * np.arange(-1, 2)
    low, middle, high = (-1 / _ideal_sharpness(modulator, camera, wavelength, 1 / power, another) for another in powers)
    found = 1 / (power - step * (low - high) / (2 * (low + high - 2 * middle)))
    doubt = math.hypot(step * doubt, FOCUS * depth) * found**2
    return replace(table, distance=found, wavefront=wavefront), doubt


def _summit(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the summit of a quadratic function fitted to values of the design, and its deviation along the first axis.

    It lies two steps from the centre along an axis at most.
    """
    products = [DESIGN[:, i] * DESIGN[:, j] for i, j in itertools.combinations_with_replacement(range(3), 2)]
    system = np.column_stack([np.ones(len(DESIGN)), DESIGN, *products])
    found, *_ = np.linalg.lstsq(system, values, rcond=None)
    left = values - system @ found
    xx, xy, xz, yy, yz, zz = found[4:]
    bend = np.array([[2 * xx, xy, xz], [xy, 2 * yy, yz], [xz, yz, 2 * zz]])
    if np.linalg.eigvalsh(bend)[-1] >= 0:
        raise RuntimeError(
            "no sharpest focus was found: the area of the spot, which varies by "
            f"{values.min() / values.max() - 1:.1%}, has no least value over the defocus and the astigmatism"
        )
    back = np.linalg.inv(bend)
    slopes = (DESIGN[:, 0] ** 2).sum()
    free = left.size - system.shape[1]
    # The scatter of few residuals is often too small: Student's distribution.
    deviation = float(stdtrit(free, ONE_SIGMA)) * math.sqrt((left @ left) / free / slopes)
    return np.clip(-back @ found[1:4], -2, 2), deviation * float(np.linalg.norm(back[0]))


def _share_on_axis(modulator: SLMDriver, wavelength: float, distance: float, width: float) -> np.ndarray:
    """Return the share of each pixel ``[rows, columns]`` of the field on the axis, of those within a square."""
    y, x = pixel_axes(modulator)
    across, down = (
        np.clip(np.sinc(a * modulator.pitch / (wavelength * distance)), 0, None) * (abs(a) <= width / 2) for a in (x, y)
    )
    return down * across / (down.sum() * across.sum())


def _depth_of_focus(modulator: SLMDriver, wavelength: float, distance: float, width: float) -> float:
    """Return the depth of focus as a power, wavelength/width² of a square, of the light that reaches the axis."""
    y, x = pixel_axes(modulator)
    share = _share_on_axis(modulator, wavelength, distance, width)
    squares = x**2 + y**2
    return wavelength / (EVEN_SQUARE * math.sqrt((share * (squares - (share * squares).sum()) ** 2).sum()))


def error_by_wavefront(table: OpticalTable, error: float) -> float:
    """Return the error in metres that one of the wavefront in radians, which has no defocus, causes in the distance."""
    modulator, _, wavelength, distance = parts_of(table)
    _, metres = ray_matrix(distance)
    return COUPLED * error / DEEP * _depth_of_focus(modulator, wavelength, metres, np.inf) * metres**2


def _sharpness(frame: np.ndarray) -> float:
    """Return the mean intensity of a spot, weighted by itself, as a share of the light."""
    light = _above_floor(frame)
    total = float(light.sum())
    if total == 0:
        raise RuntimeError(f"no spot was captured: all pixels around its place have {frame.flat[0]:g} counts")
    return float((light**2).sum()) / total**2


def _above_floor(frame: np.ndarray) -> np.ndarray:
    """Return the counts above those beside a spot: the mean of the middle half, for a median is a whole number."""
    return np.clip(frame - np.sort(frame, axis=None)[frame.size // 4 : -(frame.size // 4)].mean(), 0, None)


def _check_focus(camera: Camera, powers: np.ndarray) -> None:
    """Raise an error if a capture of the sharpest focus of a sweep of powers has no spot."""
    frame = unsaturated(camera)
    smooth = uniform_filter(frame, 3)
    beside = float(np.median(smooth))
    # A median of deviations is 0.67 standard deviations, and 0 where all counts are the same.
    noise = 1.5 * float(np.median(abs(smooth - beside))) + 0.1
    if smooth.max() - beside < 6 * noise:
        camera.region = None
        raise RuntimeError(
            f"no focus was found among focal lengths from {1 / powers[-1]:.4g} m to {1 / powers[0]:.4g} m: at an "
            f"exposure of {camera.exposure:.3g} s the brightest of {frame.size} pixels has {frame.max():.0f} of "
            f"{(1 << camera.bits) - 1} counts, and those around it {beside:.0f} ± {noise:.2g}; check that the laser is "
            "on, that the registration belongs to this camera, and the distance, or use a larger span"
        )


@watched("distance")
def distance_with_uncertainty(
    table: OpticalTable, span: float = 0.15, samples: int = 15, captures: int = 4
) -> tuple[float, float]:
    """Return the distance from a modulator to a camera, and its uncertainty in metres.

    The parameters are as in :func:`measure_distance`. The error of the wavefront is not in the uncertainty.
    """
    distance = without_lens(table.distance, "measure_wavefront finds the defocus")
    modulator, camera, wavelength, _, phases, registration = parts_of(table, "phases", "registration")
    samples = _validate.integer("samples", samples, minimum=5)
    _validate.number("span", span, positive=True, below=1)
    correction = np.asarray(table.wavefront, float)
    if correction.ndim:
        correction = without(correction, aberration_modes(modulator, 2)[[0, 1, DEFOCUS]])
    y, x = pixel_axes(modulator)
    largest = max(modulator.shape) * modulator.pitch
    place = registration.camera_pixels(np.zeros(2))

    def show(power: float, width: float) -> None:
        phase = lens_phase(modulator, wavelength, 1 / power) - correction
        if width < largest:
            phase = np.where(np.maximum(abs(x), abs(y)) <= width / 2, phase, deflected(modulator))
        modulator.show(nearest_levels(phase, phases))

    def look(width: float, half: float) -> None:
        """Read the camera where the light of a width lies whose focus is off by a power, and three Airy discs more."""
        extent = half * distance * width / 2 + 3 * wavelength * distance / min(width, smallest)
        read_around(camera, np.rint(place).astype(int), max(14, math.ceil(extent / camera.pitch)))

    # The focus of a small aperture is deep, and its sweep misses none; the apertures that follow search near it.
    smallest = min(modulator.shape) * modulator.pitch
    depth = _depth_of_focus(modulator, wavelength, distance, largest)
    low, high = 1 / (distance * (1 + span)), 1 / (distance * (1 - span))
    peak, half, sweeps = (low + high) / 2, (high - low) * (0.5 + 1 / (samples - 1)), 0
    while sweeps == 0 or half > 1.5 * depth:
        powers = np.linspace(peak - half, peak + half, samples)
        step = powers[1] - powers[0]
        width = min(largest, math.sqrt(SWEPT * wavelength / step))
        look(width, half)
        show(peak, width)
        set_exposure(camera)
        values = np.empty(samples)
        spots = []
        for number, power in enumerate(powers):
            show(power, width)
            frame = unsaturated(camera)
            spots.append(brightest(frame) + (camera.region or (0, 0))[1::-1])
            values[number] = ((_above_floor(frame) / camera.exposure) ** 2).sum()
        best = int(values.argmax())
        show(powers[best], width)
        _check_focus(camera, powers)
        if sweeps == 0 and best in (0, samples - 1):
            warn("the sharpest focus lies at an end of the range of distances: use a larger span", AccuracyWarning)
        place, peak = np.asarray(spots[best], float), powers[best]
        if 0 < best < samples - 1:
            below, middle, above = values[best - 1 : best + 2]
            peak += step * (above - below) / (2 * (2 * middle - below - above))
        # Where the focus lies at an end, the next sweep is as wide.
        if 0 < best < samples - 1 or sweeps > LARGEST_SWEEPS:
            half = max(1.5 * depth, 1.2 * step)
        half = min(half, 0.9 * peak)
        sweeps += 1
    look(largest, 0.0)
    show(peak, largest)
    set_exposure(camera, level=0.45)
    # Within the depth of focus the sharpness is a parabola.
    powers = peak + np.linspace(-half, half, samples)
    values = np.empty(samples)
    for number, power in enumerate(powers):
        show(power, largest)
        values[number] = _sharpness(averaged(camera, captures))
    camera.region = None
    peak, doubt = _vertex(powers, values, depth)
    # Pixels send light into an envelope about the axis, and not about the direction to the focus: the sharpness of an
    # ideal table is not even either. Its vertex is some hundredths of the depth of focus beside the distance.
    ideal = [_ideal_sharpness(modulator, camera, wavelength, 1 / peak, power) for power in powers]
    found = 1 / (2 * peak - _vertex(powers, np.array(ideal), depth)[0])
    return found, math.hypot(doubt, FOCUS * depth) * found**2


def _vertex(powers: np.ndarray, values: np.ndarray, depth: float) -> tuple[float, float]:
    """Return the power of the largest sharpness, by a parabola within the depth of focus, and its deviation."""
    peak = powers[values.argmax()]
    near = np.abs(powers - peak) <= 1.2 * depth
    system = np.vander((powers[near] - peak) / depth, 3)
    curve, *_ = np.linalg.lstsq(system, values[near], rcond=None)
    left = values[near] - system @ curve
    covariance = np.linalg.pinv(system.T @ system) * (left @ left) / max(left.size - 3, 1)
    bend, slope, _ = curve
    if bend >= 0 or abs(slope) > -4 * bend:
        raise RuntimeError(
            f"no sharpest focus was found near {1 / peak:.4g} m: among focal lengths from {1 / powers[-1]:.4g} m to "
            f"{1 / powers[0]:.4g} m the sharpness varies by {np.ptp(values) / values.max():.1%}, without a peak; "
            "average more captures"
        )
    toward = np.array([slope / (2 * bend**2), -1 / (2 * bend), 0])
    return float(peak - slope / (2 * bend) * depth), math.sqrt(toward @ covariance @ toward) * depth


def _ideal_sharpness(modulator: SLMDriver, camera: Camera, wavelength: float, distance: float, power: float) -> float:
    """Return the sharpness of a lens of a power on an evenly lit panel, whose light is a product of two axes."""
    pixel, lines = modulator.pitch, []
    # Two points of each of 29 pixels of the camera give their means.
    places = np.add.outer(np.arange(-14, 15), np.array([-1, 1]) / math.sqrt(12)).ravel() * camera.pitch
    for at in (axis.ravel() for axis in pixel_axes(modulator)):
        away = places[:, None] - at
        waves = np.sinc(pixel * away / (wavelength * distance)) * np.exp(1j * np.pi / wavelength * away**2 / distance)
        light = np.abs(waves @ np.exp(-1j * np.pi / wavelength * power * at**2)) ** 2
        lines.append(light.reshape(-1, 2).mean(-1))
    return _sharpness(np.outer(*lines))
