"""Registration, aberration and distance of modulators wider than what their pixels reach, from lenslets that steer.

A pixel sends light to points within λ·distance/(2·pitch) of it. The spots of a registration are then formed by pixels
near them, and move with the gradient of the aberration there as those of lenslets do: the two cannot be told apart. A
lenslet at x that focuses at x + o has its spot at C(x + o·(1 + β) + distance/k·∇W(x)), where C is the mapping of the
camera and β the error of the distance; several o tell the three apart.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from odak.instruments.exposures import exposed
from odak.instruments.mapping import Registration, ray_matrix
from odak.instruments.phase_response import nearest_levels
from odak.instruments.registration import LARGEST
from odak.instruments.spots import (
    DEFOCUS,
    SMALLEST_LENSLET,
    aberration_modes,
    averaged,
    brightest_near,
    centroid,
    divided,
    ideal_capture,
    pixel_axes,
    without,
)
from odak.instruments.tables import OpticalTable, parts_of
from odak.instruments.wavefronts import lit

# Half the width of a modulator in units of what a pixel reaches above which it is wide.
WIDE = 1.2
# Displacement of the spots, and range of the widths of lenslets, in the same units.
STEERED, NARROWEST, WIDEST = 0.3, 0.65, 1.05
FEWEST, MOST = 4, 14
# Half the width of the windows of spots at first and later, as a share of their distance: orders of diffraction of
# others are midway between them.
FIRST_WINDOW, WINDOW = 0.42, 0.3


def reached(wavelength: float, distance: float, pitch: float) -> float:
    """Return how far from its axis a pixel sends light to, in metres."""
    return wavelength * distance / (2 * pitch)


def is_wide(table: OpticalTable) -> bool:
    """Return whether no point gets light from all pixels of a modulator, by far."""
    modulator = table.modulator
    farthest = reached(table.wavelength, ray_matrix(table.distance)[1], modulator.pitch)
    return max(modulator.shape) * modulator.pitch / 2 > WIDE * farthest


def _counts(table: OpticalTable, farthest: float) -> np.ndarray:
    """Return rows and columns of lenslets: orders of diffraction of a spot lie midway between others where possible."""
    modulator, found = table.modulator, []
    smallest = SMALLEST_LENSLET * math.sqrt(table.wavelength * ray_matrix(table.distance)[1])
    for size in np.array(modulator.shape) * modulator.pitch:
        fits = [n for n in range(FEWEST, MOST + 1) if NARROWEST * farthest <= size / n <= WIDEST * farthest]
        fits = [n for n in fits if size / n >= smallest] or [max(FEWEST, min(MOST, int(size / smallest)))]
        found.append(min(fits, key=lambda n: abs((2 * farthest * n / size) % 1 - 0.5)))
    return np.array(found)


def linear_part(table: OpticalTable, registration: Registration) -> Registration:
    """Return the linear part about the axis of a mapping that spots near the axis tell: the rest is not known there."""
    reach = STEERED * reached(table.wavelength, ray_matrix(table.distance)[1], table.modulator.pitch)
    three = reach * np.array([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
    middle = np.array(registration.shape[::-1]) / 2
    pixels = np.column_stack([registration.camera_pixels(three) - middle, np.ones(3)])
    homography = np.vstack([np.linalg.solve(pixels, three).T, [0.0, 0.0, 1.0]])
    return Registration(homography, 0.0, registration.shape)


def steered(table: OpticalTable, first: bool, captures: int = 1) -> tuple[OpticalTable, float, float]:
    """Return a table with registration, wavefront and distance by steered lenslets, from what is known of them roughly.

    The other results are the uncertainties of the wavefront in radians and of the distance in metres.
    """
    modulator, camera, wavelength, distance, phases, registration = parts_of(table, "phases", "registration")
    farthest = reached(wavelength, distance, modulator.pitch)
    counts, shape = _counts(table, farthest), np.array(modulator.shape)
    y, x = pixel_axes(modulator)
    cell, mean = divided(shape, counts)
    middles = np.stack([mean(x), mean(y)], axis=-1)
    modes = aberration_modes(modulator, 4)
    low = modes[[0, 1, DEFOCUS]]
    # Tilts belong to the registration, the defocus to the distance.
    modes = np.stack([without(mode, low) for mode in np.delete(modes, [0, 1, DEFOCUS], axis=0)])
    slopes = [np.gradient(mode, modulator.pitch)[::-1] for mode in modes]
    tilts = np.stack([np.stack([mean(part) for part in pair], axis=-1) for pair in slopes], axis=-1)
    # Displacements in metres by each mode.
    tilts = tilts * (wavelength * distance / (2 * np.pi))
    wavefront = np.broadcast_to(table.wavefront, modulator.shape)
    spacing = float((shape / counts).min() * modulator.pitch)
    offsets = STEERED * farthest * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    points: Any
    seen: Any
    points, seen, amplitude = [], [], table.amplitude
    for offset in offsets:
        targets = middles + offset
        across, down = targets[cell, 0], targets[cell, 1]
        phase = -np.pi / (wavelength * distance) * ((x - across) ** 2 + (y - down) ** 2)
        frame = np.zeros(tuple(camera.shape))
        for turn in np.arange(captures) * 2 * np.pi / captures:
            # Light that is not modulated shifts spots by amounts that depend on their phase.
            modulator.show(nearest_levels(phase - wavefront + turn, phases))
            frame += averaged(camera, 1) if points or turn else exposed(camera, "steered lenslets", 0.5)
        places = registration.camera_pixels(targets)
        pixel = np.linalg.norm(registration.camera_pixels(targets + np.array([spacing, 0.0])) - places, axis=-1).min()
        reach, window = (max(3, int(share * pixel)) for share in (FIRST_WINDOW, WINDOW))
        if first:
            places = np.stack([brightest_near(frame, place, reach) for place in places])
        seen.append(np.stack([centroid(frame, place, window) for place in places]))
        if amplitude is None:
            # Light of lenslets beside a spot displaces it, by as much as the one is brighter than the other.
            amplitude = lit(modulator, frame, seen[0], middles, window)
        ideal = ideal_capture(modulator, phase, amplitude, wavelength, distance, registration)
        expected = np.stack([centroid(ideal, place, window) for place in registration.camera_pixels(targets)])
        points.append(registration.plane_points(expected))
    points, seen = np.concatenate(points), np.concatenate(seen)
    there = (seen > WINDOW * pixel) & (seen < np.array(camera.shape[::-1]) - 1 - WINDOW * pixel)
    used = there.all(-1)
    system = np.concatenate(
        [np.concatenate([tilts, np.broadcast_to(o[:, None], (*tilts.shape[:2], 1))], -1) for o in offsets]
    )
    begin = np.concatenate([registration.homography.ravel()[:8], [registration.distortion], np.zeros(system.shape[-1])])
    scale = np.array(
        [camera.pitch] * 2 + [10 * camera.pitch] + [camera.pitch] * 2 + [10 * camera.pitch, 1e-6, 1e-6, 0.1]
    )
    # Parameters in units of their size: of modes, in radians.
    scale = np.concatenate([scale, np.ones(len(modes)), [1e-3]])

    def mapping(parameters: np.ndarray) -> Registration:
        homography = np.append(parameters[:8], 1.0).reshape(3, 3)
        return Registration(homography, float(parameters[8]), registration.shape)

    def misfit(parameters: np.ndarray) -> np.ndarray:
        missed = mapping(parameters).plane_points(seen[used]) - points[used] - system[used] @ parameters[9:]
        return missed.ravel() / camera.pitch

    fit = least_squares(misfit, begin, x_scale=scale, loss="soft_l1", f_scale=0.3)
    found, missed = mapping(fit.x), misfit(fit.x)
    residual = float(np.sqrt((missed.reshape(-1, 2) ** 2).sum(-1).mean()))
    jacobian = fit.jac * scale
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * (missed @ missed) / max(missed.size - len(fit.x), 1)
    variance = np.einsum("ki,ij,kj->k", jacobian[:, :9], covariance[:9, :9], jacobian[:, :9])
    uncertainty = LARGEST * math.sqrt(variance.reshape(-1, 2).sum(-1).max())
    pure = modes.reshape(len(modes), -1)
    doubt = math.sqrt(np.einsum("ij,ip,jp->", covariance[9:-1, 9:-1], pure, pure, optimize=True) / pure.shape[1])
    wavefront = wavefront + np.tensordot(fit.x[9:-1], modes, axes=1)
    registration = Registration(found.homography, found.distortion, found.shape, residual, uncertainty)
    known = {"registration": registration, "wavefront": wavefront, "distance": distance * (1 + fit.x[-1])}
    return replace(table, **known), doubt, 1e-3 * math.sqrt(covariance[-1, -1]) * distance
