"""Aberration of an optical table, measured with lenslets on the modulator."""

import itertools
import math

import numpy as np

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.exposures import exposed
from odak.instruments.mapping import Lens, ray_matrix
from odak.instruments.phase_response import nearest_levels
from odak.instruments.protocols import SLMDriver
from odak.instruments.registration import SPREAD
from odak.instruments.spots import (
    DEFOCUS,
    aberration_modes,
    averaged,
    brightest_near,
    centroid,
    deflected,
    divided,
    ideal_capture,
    lenslets,
    pixel_axes,
    without,
)
from odak.instruments.steadiness import watched
from odak.instruments.tables import OpticalTable, parts_of

# Width and height of the field of the spots of lenslets behind a lens, as a share of the image of the camera.
FIELD = 0.75
# Radius of the disc around the axis, behind a lens, that is left out, as a share of the spots' distance.
ZERO_ORDER = 0.25
# Rows and columns of the lenslets of which one in four is lit at a time; even.
COARSE = 4
# Zernike polynomials of orders 1 to 4.
FOURTH = 14
# Change of the wavefront by coarse lenslets, in radians, below which one measurement by them is enough.
SETTLED = 2 * np.pi / 4
# Change of the wavefront in the last step, in radians, above which the measurement has not converged.
UNSETTLED = 2 * np.pi / 20


@_validate.takes_fields("modulator camera wavelength distance phases registration", table=OpticalTable)
@_validate.takes_units()
def measure_wavefront(
    table: OpticalTable,
    *,
    cells: int | None = None,
    order: int = 4,
    iterations: int = 10,
    captures: int = 2,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Measure the aberration at a modulator, which acts as the lenslets of a Shack–Hartmann sensor.

    Each of cells × cells parts of the modulator focuses at its own middle. The displacements of the spots from those
    of an ideal table, which is simulated, are the gradients of the wavefront; Zernike polynomials are fitted to them
    and corrected, and the measurement is repeated until the gradients vanish. It begins with 4 × 4 lenslets, of which
    four at a time form spots in the four quadrants of the image, for large aberrations.

    Fringing fields at the steps of 2π and light that is not modulated shift the spots by amounts that depend on the
    phase at the middle of the lenslets; the patterns of the captures differ in it, so that the shifts cancel.

    Parameters
    ----------
    table : OpticalTable
        The table, with phases and a registration. Its amplitude serves the simulation of the ideal table, and is
        estimated from the brightness of the spots where it is None; its wavefront is measured anew.
    cells : int, optional
        Number of lenslets along each axis; by default as many as are wider than diffraction allows, from 4 to 6.
    order : int
        Highest radial order of the Zernike polynomials.
    iterations : int
        Number of iterations. With three or more and no `start`, the first two are of 4 × 4 lenslets, and take four
        captures each; the second is left out where the first finds less than a quarter of a wavelength.
    captures : int
        Number of captures that are averaged for each of the others.
    start : numpy.ndarray, optional
        Aberration in radians that is known approximately, from which the measurement begins, with the smallest lenslets
        and all orders. None by default.

    Returns
    -------
    numpy.ndarray
        Aberration in radians at each pixel of the modulator, without piston and tilt. Defocus represents an error of
        the distance too.

    Warns
    -----
    AccuracyWarning
        If the last pattern still changed it by more than a twentieth of a wavelength (root mean square).

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, measure_wavefront
    >>> hidden = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.1)
    >>> truth = hidden.truth
    >>> mapping = Registration(truth.homography, truth.distortion, hidden.camera.shape)
    >>> table = OpticalTable(hidden.modulator, hidden.camera, 532e-9, truth.distance, truth.phases, mapping)
    >>> found = measure_wavefront(table, iterations=4, captures=1)

    Up to piston and tilt, it is the aberration within a hundredth of a wavelength:

    >>> rows, columns = np.indices(found.shape)
    >>> planes = np.stack([rows, columns, np.ones(found.shape)], axis=-1).reshape(-1, 3)
    >>> error = (found - truth.wavefront).ravel()
    >>> error = error - planes @ np.linalg.lstsq(planes, error)[0]
    >>> bool(error.std() < 2 * np.pi / 100)
    True
    """
    return wavefront_with_uncertainty(table, cells, order, iterations, captures, start)[0]


@watched("wavefront")
def wavefront_with_uncertainty(
    table: OpticalTable,
    cells: int | None = None,
    order: int = 4,
    iterations: int = 10,
    captures: int = 2,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Return the aberration at a modulator, and its uncertainty in radians, without tilt and defocus.

    The parameters are as in :func:`measure_wavefront`.
    """
    modulator, camera, wavelength, distance, phases, registration = parts_of(table, "phases", "registration")
    shape = np.array(modulator.shape)
    order, iterations, captures = (
        _validate.integer(name, value, minimum=least)
        for name, value, least in (("order", order, 2), ("iterations", iterations, 1), ("captures", captures, 1))
    )
    modes = aberration_modes(modulator, order)
    slopes = np.stack([np.gradient(mode, modulator.pitch) for mode in modes])[:, ::-1]
    a, b = ray_matrix(distance)
    size = shape * modulator.pitch
    # Width and height of the spots' field. Without a lens, lenslets focus straight ahead.
    wide = size
    if isinstance(distance, Lens):
        farthest = wavelength * abs(b) / (2 * modulator.pitch)
        wide = np.minimum(FIELD * np.array(camera.shape) * camera.pitch, 2 * SPREAD * farthest)
    if cells is not None:
        fine = np.full(2, _validate.integer("cells", cells, minimum=3))
    elif isinstance(distance, Lens):
        # An even number has no spot on the axis, where the light is that is not modulated.
        fine = 2 * np.clip(np.sqrt(0.8 * wide * size / (wavelength * abs(b))) / 2, 2, 3).astype(int)
    else:
        fine = lenslets(modulator.shape, wavelength, distance, modulator.pitch)

    y, x = pixel_axes(modulator)

    def lenslets_of(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the number of the lenslet of each pixel, the lenslets' middles x, y and their mean slopes."""
        cell, mean = divided(shape, parts)
        system = np.stack([np.stack([mean(slope) for slope in pair], axis=-1).ravel() for pair in slopes], axis=-1)
        return cell, np.stack([mean(x), mean(y)], axis=-1), system

    def lenses(cell: np.ndarray, targets: np.ndarray) -> np.ndarray:
        """Return the phase that focuses the light of each lenslet at a target x, y."""
        across, down = targets[cell, 0], targets[cell, 1]
        return -np.pi / (wavelength * b) * (a * (x**2 + y**2) - 2 * (x * across + y * down) + across**2 + down**2)

    def fitted(moved: np.ndarray, system: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the wavefront, the gradients and the coefficients of modes for displacements of spots in metres."""
        gradient = (2 * np.pi / wavelength * moved / b).ravel()
        coefficients, *_ = np.linalg.lstsq(system, gradient, rcond=None)
        # Tilts belong to the registration.
        return np.tensordot(coefficients[2:], modes[2 : len(coefficients)], axes=1), gradient, coefficients

    def apart(cell: np.ndarray, middles: np.ndarray) -> np.ndarray:
        """Return the displacements in metres of the spots of coarse lenslets, of which one in four is lit at a time."""
        quarter = wide[::-1] / 4
        limit = math.inf if isinstance(distance, Lens) else 0.15 * wavelength * b / modulator.pitch
        moved = np.empty_like(middles)
        for pair in itertools.product(range(2), repeat=2):
            used = (np.indices((COARSE, COARSE)) % 2 == np.reshape(pair, (2, 1, 1))).all(0).ravel()
            # The spots lie in the middles of the four quadrants.
            wanted = quarter * np.sign(middles - middles[used].mean(0))
            targets = middles + np.clip(wanted - middles, -limit, limit)
            phase = np.where(used[cell], lenses(cell, targets), deflected(modulator))
            modulator.show(nearest_levels(phase - wavefront, phases))
            # Spots of an aberration that is corrected are brighter.
            first = pair == (0, 0) and not wavefront.any()
            frame = exposed(camera, "coarse lenslets", 0.4) if first else averaged(camera, 1)
            places = registration.camera_pixels(targets[used])
            reach = int(0.45 * np.linalg.norm(places[1:3] - places[0], axis=-1).min())
            seen = np.stack([centroid(frame, brightest_near(frame, place, reach), reach) for place in places])
            moved[used] = registration.plane_points(seen) - targets[used]
        return moved

    # A large aberration may move spots to the places of other lenslets' spots: few, coarse lenslets come first.
    coarse = 2 if iterations > 2 and start is None else 0
    wavefront = np.zeros(modulator.shape) if start is None else np.asarray(start, float)
    camera.region = None
    cell, middles, system = lenslets_of(np.array([COARSE, COARSE]))
    turn, by = 0, math.inf
    while turn < coarse and by > SETTLED:
        change = fitted(apart(cell, middles), system[:, :FOURTH])[0]
        wavefront, by, turn = wavefront + change, float(change.std()), turn + 1
    cell, middles, system = lenslets_of(fine)
    targets = middles * (wide / size)[::-1]
    phase, places = lenses(cell, targets), registration.camera_pixels(targets)
    beside = registration.camera_pixels(targets[:1] + np.diag(wide[::-1] / fine[::-1]))
    reach = int(0.42 * np.linalg.norm(beside - places[:1], axis=-1).min())
    dark = np.zeros(tuple(camera.shape), dtype=bool)
    if isinstance(distance, Lens):
        # Light that is not modulated.
        v, u = np.indices(dark.shape)
        apart_from_axis = registration.plane_points(np.stack([u, v], axis=-1))
        dark = np.hypot(*np.moveaxis(apart_from_axis, -1, 0)) < ZERO_ORDER * (wide / fine).min()
    iterations -= coarse
    for step in range(iterations):
        frame = np.zeros(tuple(camera.shape))
        for capture in range(captures):
            turn = np.pi * (2 * capture + step % 2) / captures
            modulator.show(nearest_levels(phase - wavefront + turn, phases))
            seen = exposed(camera, "lenslets") if step == 0 and capture == 0 else averaged(camera, 1)
            frame += seen / captures
        frame[dark] = np.quantile(frame, 0.02)
        seen = np.stack([centroid(frame, place, reach) for place in places])
        bright = lit(modulator, frame, seen, middles, reach) if table.amplitude is None else table.amplitude
        ideal = np.where(dark, 0, ideal_capture(modulator, phase, bright, wavelength, distance, registration))
        wanted = np.stack([centroid(ideal, place, reach) for place in places])
        moved = registration.plane_points(seen) - registration.plane_points(wanted)
        change, gradient, coefficients = fitted(moved, system)
        wavefront = wavefront + change
    if iterations > 1 and change.std() > UNSETTLED:
        warn(
            f"the wavefront is uncertain: the last pattern changed it by {change.std() / (2 * np.pi):.2g} wavelengths; "
            "the aberration may be larger than the lenslets can measure",
            AccuracyWarning,
        )
    pure = np.stack([without(mode, modes[[0, 1, DEFOCUS]]) for mode in modes]).reshape(len(modes), -1)
    left = gradient - system @ coefficients
    covariance = np.linalg.pinv(system.T @ system) * (left @ left) / max(left.size - len(modes), 1)
    variance = np.einsum("ij,ip,jp->", covariance, pure, pure, optimize=True) / pure.shape[1]
    return wavefront - wavefront.mean(), math.sqrt(variance)


def lit(modulator: SLMDriver, frame: np.ndarray, spots: np.ndarray, places: np.ndarray, reach: int) -> np.ndarray:
    """Return the amplitude at each pixel, estimated from the light of spots (column, row) of lenslets at x, y."""
    frame = frame - np.quantile(frame, 0.02)
    corners = np.clip(np.rint(spots).astype(int) - reach, 0, None)
    size = 2 * reach + 1
    light = np.array([frame[row : row + size, column : column + size].sum() for column, row in corners])
    half = max(modulator.shape) * modulator.pitch / 2

    def system(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        x, y = np.broadcast_arrays(x / half, y / half)
        return np.stack([1 + 0 * x, x, y, x * x, x * y, y * y], axis=-1)

    logarithm = np.log(np.clip(light, 0.02 * light.max(), None)) / 2
    coefficients, *_ = np.linalg.lstsq(system(*places.T), logarithm, rcond=None)
    y, x = pixel_axes(modulator)
    amplitude = np.exp(system(x, y) @ coefficients)
    return amplitude / amplitude.max()
