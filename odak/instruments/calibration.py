"""Calibration of an optical table through the protocols of its instruments, and files of the results.

The functions are called in this order, each with the results of those before: phase response, registration of the
camera, wavefront, distance, illumination.
"""

import io
import itertools
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline, make_interp_spline
from scipy.ndimage import map_coordinates, uniform_filter
from scipy.optimize import least_squares

from odak import _show, _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.array_files import SUFFIXES, checked_array, checked_number, read_hdf5, write_hdf5
from odak.instruments.captures import LARGEST_DISTANCE, PITCHES, WAVELENGTHS
from odak.instruments.exposures import SATURATED, STALE, set_exposure
from odak.instruments.mapping import Lens, Registration, ray_matrix
from odak.instruments.protocols import Camera, Modulator, check_square_pixels, checked_camera
from odak.tools.file import read_npz
from odak.tools.paths import replacing, validate_path
from odak.tools.zernike import zernike_polynomial
from odak.wave import propagate_beam
from odak.wave.linear_kernels import pixels_spectrum

__all__ = [
    "Calibration",
    "calibrate_table",
    "load_calibration",
    "measure_distance",
    "measure_illumination",
    "measure_phase_response",
    "measure_regional_response",
    "measure_wavefront",
    "register_camera",
    "save_calibration",
]

FORMAT, VERSION = "odak calibration", 1
UNITS = {
    "wavelength": "m",
    "pitch": "m",
    "distance": "m",
    "lens": "m",
    "phases": "rad",
    "amplitude": "fraction of the largest",
    "wavefront": "rad",
    "homography": "pixel to m",
    "regional_phases": "rad",
    "residual": "pixel",
    "distortion": "1/(half diagonal)²",
    "uncertainty_phases": "rad",
    "uncertainty_regional_phases": "rad",
    "uncertainty_registration": "pixel",
    "uncertainty_wavefront": "rad",
    "uncertainty_distance": "m",
    "uncertainty_amplitude": "fraction of the largest",
}
# Deviation of the captures of a phase response, 0.002 by noise alone, above which the response is taken to vary.
SPREAD_OF_RESPONSE = 0.01
# Pixels of a modulator from which the hologram of spots is computed by iterations, at most.
SAMPLED = 1 << 17
# Part of the circle in radians that the phases of levels may leave out.
LARGEST_GAP = 0.15 * np.pi
# Columns of other levels beside the border of the two halves, and rows and columns of pixels evaluated at most.
GUARD, LARGEST_WINDOW = 3, 201
# Rows and columns of pixels of a region at least.
SMALLEST_REGION = 12
# Half of the extent of the spots of a registration at most, as a share of the farthest point that a pixel reaches.
SPREAD = 0.6
# Width of the stripes beside them into which light falls that forms no spots, as a share of what is free.
STRIPE = 0.8
# Width and height of the field of the spots of lenslets behind a lens, as a share of the image of the camera.
FIELD = 0.75
# Radius of the disc around the axis, behind a lens, that is left out, as a share of the spots' distance.
ZERO_ORDER = 0.25
# Displacement of the rays at the edge of an aperture, as a share of its radius, to measure its curvature.
BLUR = 0.4
# Distance from the axis of spots of a first estimate of the registration, as a share of that of the others.
NEAR = 0.4
# Pixels around the spots of the outermost lenslets, and share of the modulator that is calibrated, at least.
LEAST_MARGIN, SMALLEST_SHARE = 8, 0.3
# Rows and columns of the lenslets of which one in four is lit at a time; even.
COARSE = 4
# Zernike polynomials of orders 1 to 4.
FOURTH = 14
# Width of a lenslet in units of the square root of wavelength and distance.
SMALLEST_LENSLET = 1.6
# Points at which the illumination is measured, as a share of the farthest that a pixel reaches, and phases of parts.
ASIDE = 0.3
# Mean share of the light that is missing in dark parts, above which a root mean square of about 1 % is missing.
DUSTY = 1.5e-4
# Share of the light that specks of dust absorb, and uncertainty of the illumination that is reported.
DEPTH, EVEN = 0.7, 0.02
QUARTERS = np.arange(4) * (np.pi / 2)
# Change of the wavefront in the last step, in radians, above which the measurement has not converged.
UNSETTLED = 2 * np.pi / 20
# Range of the astigmatism that is tried on either side, in radians (root mean square).
ASTIGMATISM = 2 * np.pi * 0.1
# Share of the last change of the wavefront that is taken as its error.
REST = 0.2
# Uncertainties above which calibrate_table warns: rad, pixel, rad.
LIMITS = {"phases": 0.03, "registration": 0.2, "wavefront": 2 * np.pi / 100}
# Error of a wavefront in radians that is left without noise, a five-hundredth of a wavelength.
SMALLEST_ERROR = 2 * np.pi / 500
# Step of a sweep of focal lengths in units of the depth of focus, wavelength/width², of the aperture it is made with;
# the sharpness falls to half 3.5 units from its peak. Sweeps at most.
SWEPT, LARGEST_SWEEPS = 2.4, 12
# Standard deviation of the squared distance from the middle of a square is its area over this.
EVEN_SQUARE = math.sqrt(90)
# Error of the sharpest focus in units of the depth of focus, without aberration and noise.
FOCUS = 0.04
# Rows and columns of regions where the response varies.
REGIONS = (3, 3)


@dataclass(frozen=True)
class Calibration:
    """Results of the calibration of an optical table.

    Attributes
    ----------
    wavelength : float
        Vacuum wavelength in metres.
    pitch : float
        Distance between pixels of the modulator in metres.
    distance : float or Lens
        From the modulator to the plane of the camera in metres, or the lens between them, whose errors are in the
        registration and in the wavefront.
    phases : numpy.ndarray
        Phase of each level in radians, less that of level 0.
    amplitude : numpy.ndarray
        Amplitude of the illumination at each pixel of the modulator, 1 at its largest.
    wavefront : numpy.ndarray
        Aberration at each pixel of the modulator in radians.
    registration : Registration
        Mapping of the camera.
    regional_phases : numpy.ndarray, optional
        Phase of each level in regions of the modulator, ``[region rows, region columns, levels]``.
    uncertainty : dict
        Uncertainties, which errors exceed in about one of twenty cases, of what was measured: "phases" and
        "regional_phases" in radians (largest over the levels), "registration" in pixels of the camera (largest over
        the middle 70 % of the panel's width and height), "wavefront" in radians and "amplitude" as a fraction of the
        largest (root mean squares over the panel), and "distance" in metres.

    Examples
    --------
    Without a calibration, phases are spread evenly over the levels:

    >>> import numpy as np
    >>> from odak.instruments import Calibration, SimulatedTable
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> int(assumed.levels(np.full((32, 32), np.pi))[0, 0])
    128
    """

    wavelength: float
    pitch: float
    distance: float | Lens
    phases: np.ndarray
    amplitude: np.ndarray
    wavefront: np.ndarray
    registration: Registration = field(repr=False)
    regional_phases: np.ndarray | None = field(default=None, repr=False)
    uncertainty: dict[str, float] = field(default_factory=dict, repr=False)

    __repr__ = _show.one_line

    @classmethod
    def nominal(cls, modulator: Modulator, camera: Camera, wavelength: float, distance: float | Lens) -> "Calibration":
        """Return the nominal properties of a table, without faults.

        Parameters
        ----------
        modulator : Modulator
            The modulator; its levels are taken to be spread evenly over 2π.
        camera : Camera
            The camera, taken to be aligned.
        wavelength : float
            Vacuum wavelength in metres.
        distance : float or Lens
            Distance from the modulator to the camera in metres, or the lens between them.

        Returns
        -------
        Calibration
            The assumptions.
        """
        check_square_pixels(modulator, camera)
        count = 1 << modulator.bits
        shape = (camera.shape[0], camera.shape[1])
        return cls(
            float(_validate.number("wavelength", wavelength, positive=True)),
            modulator.pitch,
            distance if isinstance(distance, Lens) else ray_matrix(distance)[1],
            np.arange(count) * (2 * np.pi / count),
            np.ones(modulator.shape),
            np.zeros(modulator.shape),
            Registration(np.diag([camera.pitch, camera.pitch, 1.0]), 0.0, shape),
        )

    def _repr_html_(self) -> str:
        return _show.page(self, Calibration._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: illumination, aberration and response, with uncertainties."""
        warn_of_short_range(self.phases)
        low, high = float(self.wavefront.min()), float(self.wavefront.max())
        pictures: list = [
            ("amplitude of the illumination, 0 to 1", _show.png(self.amplitude)),
            (f"aberration, {low:.3g} to {high:.3g} rad", _show.png((self.wavefront - low) / (high - low or 1.0))),
            (f"phase of each level, 0 to 2π over 0 to {len(self.phases) - 1}", _response_drawn(self.phases)),
        ]
        waves = float((self.wavefront - self.wavefront.mean()).std()) / (2 * np.pi)
        doubts = {name: f"± {value:.2g} {UNITS[f'uncertainty_{name}']}" for name, value in self.uncertainty.items()}
        rows = [
            ("wavelength", f"{1e9 * self.wavelength:.6g} nm", ""),
            ("pitch", f"{1e6 * self.pitch:.6g} µm", ""),
            ("light path", _path_in_words(self.distance), doubts.get("distance", "")),
            (
                "phase from the first to the last level",
                f"{float(self.phases[-1] / np.pi):.4g}π",
                doubts.get("phases", ""),
            ),
            ("aberration, root mean square", f"{waves:.3g} λ", doubts.get("wavefront", "")),
            ("least amplitude", f"{float(self.amplitude.min()):.3g}", doubts.get("amplitude", "")),
            ("residual of the mapping", f"{self.registration.residual:.3g} pixels", doubts.get("registration", "")),
        ]
        table = [("property", "value", "uncertainty"), *rows]
        return _show.View(
            f"Calibration of {self.wavefront.shape[0]} × {self.wavefront.shape[1]} pixels",
            pictures,
            table,
            _doubts(self.uncertainty),
        )

    @property
    def response(self) -> np.ndarray:
        """Phase of each level in regions of the modulator, where it was measured, or else that of all."""
        return self.phases if self.regional_phases is None else self.regional_phases

    def levels(self, phase: np.ndarray) -> np.ndarray:
        """Return the levels that show a phase in radians ``[rows, columns]`` with the aberration corrected.

        Where the response of regions is known, each pixel takes that of a cubic spline through their middles, which
        continues to the edges of the modulator.
        """
        return nearest_levels(np.asarray(phase) - self.wavefront, self.response)


def _path_in_words(path: float | Lens) -> str:
    """Return a light path as a line."""
    if isinstance(path, Lens):
        return f"lens of {1e3 * path.focal_length:.6g} mm"
    return f"{1e3 * path:.6g} mm"


def _doubts(uncertainty: Mapping[str, float]) -> list[str]:
    """Return what is less certain than holograms need."""
    return [
        f"the calibration is uncertain: {name} by {uncertainty[name]:.2g} {UNITS[f'uncertainty_{name}']}, "
        f"more than {limit:.2g}"
        for name, limit in LIMITS.items()
        if uncertainty.get(name, 0.0) > limit
    ]


def _response_drawn(phases: np.ndarray) -> str:
    """Return the curve of a response, and in grey the straight one."""
    levels = np.linspace(0, 1, len(phases))
    top = max(1.0, float(np.max(phases)) / (2 * np.pi))

    def curve(values: np.ndarray, colour: str) -> str:
        points = " ".join(f"{10 + 300 * x:.1f},{210 - 200 * y / top:.1f}" for x, y in zip(levels, values, strict=True))
        return f'<polyline points="{points}" stroke="{colour}" stroke-width="2"/>'

    drawn = curve(levels, "#9a9a9a") + curve(phases / (2 * np.pi), "#1f4e9c")
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 320 220" width="320" fill="none">{drawn}</svg>'


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
    down, across = (_between_regions(n, parts) for n, parts in zip(phase.shape, tables.shape[:2], strict=True))
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
    down, across = (_between_regions(n, parts) for n, parts in zip(levels.shape, phases.shape[:2], strict=True))
    return np.stack(
        [
            np.take_along_axis(across @ np.tensordot(shares, phases, axes=1), row[:, None], axis=1)[:, 0]
            for shares, row in zip(down, levels, strict=True)
        ]
    )


def _between_regions(pixels: int, parts: int) -> np.ndarray:
    """Return the weights ``[pixels, parts]`` of values in the middles of regions along an axis, for a cubic spline.

    Up to four regions it is the polynomial through all of them, which continues to the edges of the modulator.
    """
    if parts == 1:
        return np.ones((pixels, 1))
    places = (np.arange(pixels) + 0.5) * parts / pixels - 0.5
    return make_interp_spline(np.arange(parts), np.eye(parts), k=min(parts - 1, 3))(places)


@_validate.takes_units("wavelength", "distance")
def calibrate_table(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    *,
    rounds: int = 2,
    regions: Sequence[int] | None = None,
    partial: bool = False,
) -> Calibration:
    """Calibrate an optical table: phase response, registration, wavefront, distance and illumination.

    Registration and wavefront depend on each other and are repeated: an aberration moves the spots of the registration,
    and a wrong registration changes the wavefront's gradients. A shear of the registration and an astigmatism, which
    would cause each other, are separated by the sharpness of a focus on the axis, which depends on the astigmatism
    alone.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera, roughly at `distance`.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Nominal distance from the modulator to the camera in metres, or the lens between them, near whose back focal
        plane the camera is.
    rounds : int
        Number of measurements of the registration and the wavefront; up to twice as many as long as the wavefront
        changes by more than a twentieth of a wavelength. The first takes 17 captures of the wavefront and the others
        12, and about as many to set the exposures.
    regions : sequence of int, optional
        Rows and columns of regions whose phase response is measured too, after the second registration, and used in
        the later steps; a response that varies over the modulator acts as an aberration and shifts the image. The
        phases are then the mean over the modulator. None, the default, measures 3 × 3 regions where the captures of the
        phase response deviate by more than 1 % from those of levels with one phase at all pixels; (1, 1) measures none.
    partial : bool
        If the camera does not see the whole modulator, calibrate the largest middle part that it sees; the amplitude of
        the other pixels is then 0.

    Returns
    -------
    Calibration
        The results with their uncertainties; its wavefront has no tilt and no defocus, which are in the registration
        and the distance. Behind a lens the defocus, of a camera beside the focus, is in the wavefront.

    Raises
    ------
    RuntimeError
        If the camera does not see the whole modulator, after the first registration: the message says in which
        direction to move it and how far; and as the functions of the steps.

    Warns
    -----
    AccuracyWarning
        If the response varies and is not measured in regions, because `regions` is (1, 1) or the modulator has fewer
        than 36 rows or columns; if the uncertainty of the phases exceeds 0.03 rad, of the registration 0.2 pixels, or
        of the wavefront a hundredth of a wavelength; and as the functions of the steps.

    Notes
    -----
    The uncertainty of the wavefront comes from the fit to its gradients and from what further repetitions would change.
    It contributes to that of the distance, as a defocus, and the distance to that of the registration. The uncertainty
    of the phases is what the captures deviate from those of one phase at all pixels, and the difference between the
    results of the two halves of the modulator; with regions, it is twice that of a mean of independent values. The
    factors between residuals and uncertainties were chosen on simulated tables: uncertainties are estimates, not
    bounds.

    Examples
    --------
    >>> import warnings
    >>> from odak.instruments import SimulatedTable, calibrate_table
    >>> table = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.1)
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")  # the illumination of so few pixels is found within 3 % only
    ...     found = calibrate_table(table.modulator, table.camera, table.laser.wavelength, 6e-3)
    >>> bool(abs(found.distance / table.truth.distance - 1) < 0.01)
    True
    >>> bool(abs(found.phases - table.truth.phases).max() < 0.02)
    True
    """
    rounds, partial = _validate.integer("rounds", rounds, minimum=1), _validate.flag("partial", partial)
    behind_lens = isinstance(distance, Lens)
    if behind_lens and (partial or regions not in (None, (1, 1))):
        raise ValueError("distance must be without a lens for regions and partial: behind one, pixels reach all places")
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    there = (modulator, camera, wavelength)
    phases, doubt, spread = phases_with_uncertainty(*there, distance)
    warn_of_short_range(phases)
    varies = spread > SPREAD_OF_RESPONSE
    if regions is None and behind_lens:
        regions = (1, 1)
    elif regions is None:
        enough = all(n >= SMALLEST_REGION * parts for n, parts in zip(modulator.shape, REGIONS, strict=True))
        regions = REGIONS if varies and enough else (1, 1)
    regions = _validate.size("regions", regions)
    if regions == (1, 1) and varies:
        warn(
            f"the calibration is uncertain: captures deviate by {spread:.1%} from those of levels with one phase at "
            "all pixels; where the response varies over the panel, the phases are those near its middle, registration "
            "and distance deviate by some tenths of a pixel and of a percent"
            + ("" if behind_lens else ": use regions=(3, 3)"),
            AccuracyWarning,
        )
    uncertainty = {"phases": doubt}
    response, regional = phases, None
    wavefront, change = np.zeros(modulator.shape), math.inf
    quadratic = _modes(modulator, 2)
    low = quadratic[[0, 1] if behind_lens else [0, 1, _DEFOCUS]]
    for turn in range(2 * rounds):
        if turn >= rounds and change < UNSETTLED:
            break
        registration = register_camera(*there, distance, response, wavefront=wavefront, middle=turn == 0)
        if turn == 0 and not isinstance(distance, Lens):
            view = (modulator, camera, wavelength, distance, registration)
            share = np.ones(2)
            # The registration of the part differs by some pixels.
            spare = 0
            while partial and (beyond := _beyond(*view, share) + spare).max() > 0 and share.min() > SMALLEST_SHARE:
                share -= 0.02 * (beyond[::-1] > 0).any(-1)
                spare = 4
            _check_view(_beyond(*view, share), camera)
            if (share < 1).any():
                rows, columns = (2 * int(n * part / 2) for n, part in zip(modulator.shape, share, strict=True))
                part = _Middle(modulator, (rows, columns))
                return part.embedded(
                    calibrate_table(part, *there[1:], distance, rounds=rounds, regions=regions, partial=True)
                )
        # An aberration falsifies the first registration, and so where the regions are thought to be.
        if turn == min(1, rounds - 1) and regions != (1, 1):
            regional, doubts = regions_with_uncertainty(
                *(*there, distance, registration, wavefront, regions), whole=phases
            )
            response = regional
            shares = np.multiply.outer(
                *(_between_regions(n, parts).mean(0) for n, parts in zip(modulator.shape, regions, strict=True))
            )
            phases = np.tensordot(shares, regional, axes=2)
            # The errors of the regions are partly independent.
            uncertainty = {"phases": 2 * float(np.linalg.norm(shares * doubts)), "regional_phases": float(doubts.max())}
        known = (*there, distance, response, registration)
        if turn == 0:
            found, doubt = wavefront_with_uncertainty(*known, iterations=5, captures=1)
        else:
            found, doubt = wavefront_with_uncertainty(*known, iterations=3, start=wavefront)
        if isinstance(distance, Lens):
            # An aberration does not change the scale and the shear of spots of which each has the light of all pixels.
            found = without(found, low)
            change, wavefront = float((found - wavefront).std()), found
            continue
        if turn > 0:
            found = wavefront + without(found - wavefront, quadratic)
        # Where the illumination is not symmetric, defocus shifts the sharpest astigmatism.
        distance, _ = distance_with_uncertainty(*known, wavefront=found, captures=1)
        known = (*there, distance, response, registration)
        found = without(astigmatism_by_focus(*known, without(found, low)), low)
        change, wavefront = float((found - wavefront).std()), found
    # An error of the response of a region acts as an aberration, of the mean phase of a pattern. The factors here and
    # below are those that cover the errors of simulated tables with fringing fields.
    response_error = 0.4 * uncertainty.get("regional_phases", 0.0)
    uncertainty["wavefront"] = math.hypot(1.5 * doubt, REST * change, SMALLEST_ERROR, response_error)
    by_distance = 0.0
    if not isinstance(distance, Lens):
        distance, doubt = distance_with_uncertainty(*known, wavefront=wavefront)
        # The wavefront π/λ·(x² + y²)/f is that of a lens.
        y, x = _axes(modulator)
        defocus = 0.6 * uncertainty["wavefront"] / (x**2 + y**2).std() * wavelength * distance**2 / np.pi
        uncertainty["distance"] = math.hypot(doubt, defocus)
        far = 0.35 * math.hypot(*modulator.shape) * modulator.pitch
        by_distance = far * uncertainty["distance"] / (distance * camera.pitch)
    registration = register_camera(*there, distance, response, wavefront=wavefront)
    uncertainty["registration"] = math.hypot(registration.uncertainty, by_distance)
    registration = replace(registration, uncertainty=uncertainty["registration"])
    for text in _doubts(uncertainty):
        warn(text, AccuracyWarning)
    amplitude, uncertainty["amplitude"] = illumination_with_uncertainty(
        *there, distance, response, registration, wavefront=wavefront
    )
    found = (wavelength, modulator.pitch, distance, phases, amplitude, wavefront)
    return Calibration(*found, registration, regional, uncertainty)


@_validate.takes_units("wavelength", "distance")
def measure_phase_response(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    *,
    samples: int = 25,
    captures: int = 4,
) -> np.ndarray:
    """Measure the phase of each level of a modulator.

    One half of the panel shows a level g, the same everywhere; the light of the other half is deflected onto that of
    the first by a fixed pattern. Behind them the field is A·e^{iφ(g)} + B, so that the intensity of each pixel of the
    camera is a sum of a constant, cos φ(g) and sin φ(g), whatever the aberration, the illumination and the alignment
    are. The two largest principal components of the captures are such sums too; the ellipse on which they lie gives the
    phase. The halves take turns, and the mean of the two is returned.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera, roughly at `distance`. Its exposure is set for light that is not focused.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Nominal distance from the modulator to the camera in metres, or the lens between them. Behind a lens both halves
        form the focus on the axis, and the sign of the phases, for which the image turns by 180°, is taken to be
        positive.
    samples : int
        Number of levels measured, at least 8; those between are interpolated by a cubic spline.
    captures : int
        Number of captures that are averaged for each pattern; four times as many behind a lens, whose focus few pixels
        see.

    Returns
    -------
    numpy.ndarray
        Phases in radians ``[2^bits]``, less that of level 0, unwrapped; they fall with the level where a lens pattern
        focuses for that sign.
        Where the response varies over the panel, it is a mean over what lies near the line between the halves.

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
    >>> from odak.instruments import SimulatedTable, measure_phase_response
    >>> table = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> phases = measure_phase_response(table.modulator, table.camera, 532e-9, 4e-3, samples=9)
    >>> bool(np.abs(phases - table.truth.phases).max() < 0.02)
    True
    """
    phases, _, spread = phases_with_uncertainty(modulator, camera, wavelength, distance, samples, captures)
    _warn_of_deviations(spread)
    warn_of_short_range(phases)
    return phases


def phases_with_uncertainty(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    samples: int = 25,
    captures: int = 4,
) -> tuple[np.ndarray, float, float]:
    """Return the phase of each level, its uncertainty, and the deviation of the captures from one phase at all pixels.

    The parameters are those of :func:`measure_phase_response`.
    """
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    top = (1 << _validate.integer("modulator.bits", modulator.bits, minimum=1)) - 1
    levels = _measured_levels(top, samples)
    lens_phase(modulator, wavelength, distance)  # checks the lengths
    columns = modulator.shape[1]
    left = np.arange(columns) < columns // 2
    if isinstance(distance, Lens):
        captures = 4 * captures
        pattern = np.full(modulator.shape, (top + 1) // 2)
    else:
        pattern = _onto_the_other_half(modulator, wavelength, distance, top)
    border = np.s_[:, columns // 2 - GUARD : columns // 2 + GUARD]
    pattern[border] = _guard(modulator, top)[border]
    modulator.show(np.where(left, pattern, (top + 1) // 2))
    if isinstance(distance, Lens):
        # Interference may make the focus twice as bright.
        set_exposure(camera, level=0.35)
        focus = _brightest(_averaged(camera, 1))
        _, b = distance.ray_matrix
        width = wavelength * abs(b) / (min(modulator.shape) * modulator.pitch * camera.pitch)
        _read_around(camera, focus, int(min(3 * width + 6, (min(camera.shape) - 1) // 2)))
        step = 1
    else:
        reach = int(min(0.4 * columns * modulator.pitch / camera.pitch + 1, (min(camera.shape) - 1) // 2))
        step = 1 + 2 * reach // LARGEST_WINDOW
        _read_around(camera, np.array(camera.shape[::-1]) // 2, reach)
        set_exposure(camera)
    check_frames_are_new(
        modulator, camera, nearest_levels(_deflected(modulator), np.array([0, np.pi])) * (top + 1) // 2
    )
    found = []
    for fixed in (left, ~left):
        frames = []
        for level in levels:
            modulator.show(np.where(fixed, pattern, level))
            frames.append(_averaged(camera, captures)[::step, ::step].ravel())
        found.append(_phases_of_interference(np.stack(frames)))
    camera.region = None
    (one, first), (other, second) = found
    seen = (one + other) / 2
    if not isinstance(distance, Lens):
        seen = seen * _sign(modulator, camera, wavelength, distance, levels, seen)
    phases, fewer = (CubicSpline(levels[used], seen[used])(np.arange(top + 1)) for used in (np.s_[:], np.s_[::2]))
    # Near level 0, a power law is interpolated by half the samples with about twice the error. What captures deviate
    # from one phase at all pixels, as a share of the interference, is about the error that fringing fields cause.
    within = levels[-1 - (len(levels) + 1) % 2]
    interpolation = 1.5 * float(np.abs(phases - fewer)[:within].max())
    spread = max(first, second)
    return phases, math.hypot(float(np.abs(one - other).max()), interpolation, spread), spread


def _onto_the_other_half(modulator: Modulator, wavelength: float, distance: float, top: int) -> np.ndarray:
    """Return the levels that deflect the light of each half of a modulator onto that of the other."""
    # The lens narrows the light of a half to two thirds, away from the border, whose fringing fields disturb.
    columns = modulator.shape[1]
    focal, size = 3 * distance, columns * modulator.pitch
    shift = min(size / 2, max(0.9 * wavelength * distance / (2 * modulator.pitch) - size / 12, size / 8))
    y, x = _axes(modulator)
    side = np.where(np.arange(columns) < columns // 2, -1, 1)
    away = x - side * size / 4
    lens = -2 * np.pi / wavelength * (side * away * shift / distance + (away**2 + y**2) / (2 * focal))
    return nearest_levels(lens, np.arange(top + 1) * 2 * np.pi / (top + 1))


def _sign(
    modulator: Modulator, camera: Camera, wavelength: float, distance: float, levels: np.ndarray, phases: np.ndarray
) -> int:
    """Return the sign of phases of levels, which interference does not tell, as that for which a lens focuses."""
    y, x = _axes(modulator)
    # The focus of so small an aperture is deep enough for a nominal distance.
    inside = np.maximum(abs(x), abs(y)) <= 3 * math.sqrt(wavelength * distance)
    lens = np.where(inside, lens_phase(modulator, wavelength, distance), _deflected(modulator))
    every = CubicSpline(levels, phases)(np.arange(levels[-1] + 1))
    peaks = []
    for sign in (1, -1):
        modulator.show(nearest_levels(lens, sign * every))
        if sign == 1:
            set_exposure(camera)
        smooth = uniform_filter(_averaged(camera, 1), 3)
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


def check_frames_are_new(modulator: Modulator, camera: Camera, other: np.ndarray, count: int = 5) -> None:
    """Raise an error if a camera returns frames of the pattern before, after another one `other` was shown."""
    first, second = (camera.capture(1)[0].astype(float) for _ in range(2))
    modulator.show(other)
    frames = [camera.capture(1)[0].astype(float) for _ in range(count)]
    last = frames[-1]
    before = (first + second) / 2
    if ((last - before) ** 2).mean() < 9 * ((first - second) ** 2).mean():
        return
    older = [((frame - before) ** 2).mean() < ((frame - last) ** 2).mean() for frame in frames]
    if any(older):
        raise RuntimeError(
            STALE.format(sum(older), "a new pattern was shown", "the one before")
            + f"; or set a longer settling_time of the modulator, now {modulator.settling_time:g} s"
        )


def _guard(modulator: Modulator, top: int) -> np.ndarray:
    """Return the levels beside the border of a part that shows one level g: 0 and the highest in alternate rows.

    Fringing fields smooth the phase across that border, between 0 and φ(g) or between φ(g) and about 2π. The light that
    this scatters has opposite signs in the two cases, up to a sum of a constant and cos φ.
    """
    return np.broadcast_to(np.arange(modulator.shape[0])[:, None] % 2 * top, modulator.shape).copy()


def _measured_levels(top: int, samples: int) -> np.ndarray:
    """Return the levels whose phases are measured, Chebyshev's points, which are denser at the ends of the range."""
    count = _validate.integer("samples", samples, minimum=8)
    return np.unique(np.rint(top / 2 * (1 - np.cos(np.pi * np.arange(count) / (count - 1)))).astype(int))


def _phases_of_interference(frames: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the phase of each of the frames ``[n, pixels]``, whose pixels are a + b·cos φ + c·sin φ.

    The second result is the size of what deviates from such sums, as a share of the smaller of their two components.
    """
    frames = frames - frames.mean(0)
    values, vectors = np.linalg.eigh(frames @ frames.T)
    values = np.clip(values, 0, None) ** 0.5
    x, y = vectors[:, -1] * len(frames) ** 0.5, vectors[:, -2] * len(frames) ** 0.5
    # The ellipse x² q0 + x y q1 + y² q2 + x l0 + y l1 = 1 through the points, made a circle.
    system = np.stack([x * x, x * y, y * y, x, y], axis=-1)
    (xx, xy, yy, *linear), *_ = np.linalg.lstsq(system, np.ones(len(x)), rcond=None)
    form = np.array([[xx, xy / 2], [xy / 2, yy]])
    sizes, axes = np.linalg.eigh(form)
    noise = values[1]
    if sizes[0] <= 0 or values[-2] < 3 * noise:
        raise RuntimeError(
            "the camera must observe how the interference of the two halves of the modulator depends on the level; the "
            f"first two principal components of its captures are {values[-1]:.3g} and {values[-2]:.3g}, the noise "
            f"{noise:.3g}"
        )
    centre = -np.linalg.solve(2 * form, np.array(linear))
    circle = axes * np.sqrt(sizes) @ axes.T @ (np.stack([x, y]) - centre[:, None])
    phases = np.unwrap(np.arctan2(circle[1], circle[0]))
    other = math.sqrt(max(values[-3] ** 2 - values[1] ** 2, 0)) / values[-2]
    phases = phases - phases[0]
    return phases if phases[-1] >= 0 else -phases, other


def _warn_of_deviations(other: float) -> None:
    """Warn if captures deviate much from those of levels with one phase at all pixels."""
    if other > 0.1:
        warn(
            f"the phase response is uncertain: captures deviate by {other:.0%} from those of levels with one phase at "
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


@_validate.takes_units("wavelength", "distance")
def measure_regional_response(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    registration: Registration,
    *,
    wavefront: np.ndarray | float = 0.0,
    regions: Sequence[int] = (3, 3),
    samples: int = 15,
    captures: int = 4,
) -> np.ndarray:
    """Measure the phase of each level in regions of a modulator, whose response varies over it.

    The regions of a column show a level g, the same everywhere; the light of the column beside it is deflected onto
    them by a fixed pattern. The intensity of each pixel of the camera is then a sum of a constant, cos φ(g) and
    sin φ(g), as in :func:`measure_phase_response`, with the phase of the part of the modulator that is in front of the
    pixel; the principal components are those of the pixels in front of the middle of a region.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float
        Distance from the modulator to the camera in metres.
    registration : Registration
        Mapping of the camera, from :func:`register_camera`.
    wavefront : numpy.ndarray or float
        Aberration in radians, which displaces the light of a region.
    regions : sequence of int
        Rows and columns of regions, two or more in all, of at least 12 pixels along each side.
    samples : int
        Number of levels measured, at least 8; those between are interpolated by a cubic spline.
    captures : int
        Number of captures that are averaged for each pattern.

    Returns
    -------
    numpy.ndarray
        Phases in radians ``[region rows, region columns, 2^bits]``, less that of level 0 of the region; they are taken
        to grow with the level, but for :func:`calibrate_table`, which knows the sign.

    Warns
    -----
    AccuracyWarning
        If the captures deviate from such sums by more than 10 %.

    Examples
    --------
    >>> from odak.instruments import Registration, SimulatedTable, measure_regional_response
    >>> table = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(96, 96), aberration=0.05)
    >>> known = Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    >>> phases = measure_regional_response(
    ...     table.modulator, table.camera, 532e-9, 4e-3, known, regions=(1, 2), samples=9, captures=1
    ... )
    >>> phases.shape, bool(abs(phases - table.truth.phases).max() < 0.1)
    ((1, 2, 256), True)
    """
    there = (modulator, camera, wavelength, distance, registration)
    return regions_with_uncertainty(*there, wavefront, regions, samples, captures)[0]


def regions_with_uncertainty(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    registration: Registration,
    wavefront: np.ndarray | float = 0.0,
    regions: Sequence[int] = (3, 3),
    samples: int = 15,
    captures: int = 4,
    whole: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the phase of each level in regions, and the uncertainty of each region in radians ``[rows, columns]``.

    The parameters are those of :func:`measure_regional_response`, and `whole` the phase of each level of the whole
    modulator, less whose multiples the phases are interpolated between the levels that are measured.
    """
    distance = _without_lens(distance, "its pixels send light to the same places")
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
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
        turned = Registration(registration.homography[[1, 0, 2]], registration.distortion, registration.shape)
        there = (_Transposed(modulator), camera, wavelength, distance, turned)
        found, uncertainty = regions_with_uncertainty(
            *(*there, np.broadcast_to(wavefront, modulator.shape).T, (1, down), samples, captures, whole)
        )
        return found.swapaxes(0, 1), uncertainty.T
    top = (1 << _validate.integer("modulator.bits", modulator.bits, minimum=1)) - 1
    levels = _measured_levels(top, samples)
    y, x = (
        [part * modulator.pitch for part in np.array_split(np.arange(n) - n // 2, parts)]
        for n, parts in ((rows, down), (columns, across))
    )
    number = np.repeat(np.arange(across), [len(part) for part in x])
    # Rows and columns of the camera that the light of each pixel of the modulator reaches.
    slopes = np.gradient(np.broadcast_to(wavefront, modulator.shape), modulator.pitch)[::-1]
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
    phases, others = np.empty((down, across, top + 1)), np.empty((down, across))
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
            frame = _averaged(camera, captures)
            frames.append([(weight * frame)[place] for weight, place in zip(weights, places, strict=True)])
        for row, seen in enumerate(zip(*frames, strict=True)):
            found, others[row, column] = _phases_of_interference(np.stack(seen))
            found = found * (1 if whole[-1] >= whole[0] else -1)
            like = whole * (found @ whole[levels]) / (whole[levels] @ whole[levels])
            phases[row, column] = like + CubicSpline(levels, found - like[levels])(np.arange(top + 1))
    _warn_of_deviations(others.max())
    return phases, others


def _without_lens(path: float | Lens, reason: str) -> float:
    """Return a distance, and raise an error that gives the reason for a lens."""
    if isinstance(path, Lens):
        raise TypeError(f"distance must be a number: behind a lens {reason}, got {path!r}")
    return path


class _Transposed:
    """Modulator whose rows are the columns of another."""

    def __init__(self, modulator: Modulator):
        self.modulator, self.shape, self.pitch = modulator, modulator.shape[::-1], modulator.pitch
        self.bits, self.settling_time = modulator.bits, modulator.settling_time

    def show(self, levels: np.ndarray) -> None:
        self.modulator.show(levels.T)


@_validate.takes_units("wavelength", "distance")
def register_camera(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    *,
    wavefront: np.ndarray | float = 0.0,
    grid: Sequence[int] = (6, 6),
    extent: float = 0.75,
    middle: bool = False,
    captures: int = 6,
) -> Registration:
    """Determine the mapping from the pixels of a camera to points of the image plane.

    Three single spots give an affine estimate; with `middle`, the quadratic part of the aberration there follows from
    the second moments of spots on either side of the focus, and is corrected. Then a grid of spots, computed by
    weighted Gerchberg–Saxton iterations (Di Leonardo, Ianni and Ruocco 2007), is found by centroids, and a homography
    with radial distortion is fitted.

    The side lobes of other spots, and light that is not modulated, shift a spot by interference; captures of patterns
    whose spots have different phases are averaged.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Distance from the modulator to the camera in metres, or the lens between them.
    phases : numpy.ndarray
        Phase of each level in radians, from :func:`measure_phase_response` or :func:`measure_regional_response`.
    wavefront : numpy.ndarray or float
        Aberration in radians that is corrected; coma and astigmatism that are not shift the spots.
    grid : sequence of int
        Rows and columns of spots.
    extent : float
        Width and height of the grid as a fraction of those of the modulator, or behind a lens of those of the camera's
        image, at most 0.8 of what a pixel reaches, λ·distance/pitch.
    middle : bool
        Form the spots by the middle part of the modulator, whose pixels reach all of them, and deflect the light of the
        others beside the spots, for a first registration before the aberration is known: astigmatism and defocus move
        spots that are formed by different parts by different amounts. The spots are larger, and found less accurately
        (0.1 pixel of 4 µm on simulated tables), and shifted by the tilt of the aberration there; their grid is at most
        0.6 of what a pixel reaches.
    captures : int
        Number of patterns, whose captures are averaged.

    Returns
    -------
    Registration
        The mapping. A warning is issued if its residual is large.

    Raises
    ------
    RuntimeError
        If the spots are not found.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.instruments import Registration, SimulatedTable, register_camera
    >>> table = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.05)
    >>> there = (table.modulator, table.camera, 532e-9, 6e-3)
    >>> found = register_camera(*there, table.truth.phases, wavefront=table.truth.wavefront, grid=(4, 4))
    >>> exact = Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    >>> middle = np.array([[55.0, 55.0]])
    >>> bool(np.linalg.norm(found.plane_points(middle) - exact.plane_points(middle)) < 4e-6)
    True
    """
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    shape, pitch = np.array(modulator.shape), modulator.pitch
    a, b = ray_matrix(distance)
    behind_lens = isinstance(distance, Lens)
    seen = np.array(camera.shape) * camera.pitch if behind_lens else shape * pitch
    half = seen * float(_validate.number("extent", extent, positive=True)) / 2
    # A pixel does not send light to points that are farther from it than this along an axis, and lenses that focus
    # there have a second focus at twice that distance on the other side.
    farthest = wavelength * abs(b) / (2 * pitch)
    half = np.minimum(half, (SPREAD if middle else 0.8) * farthest)
    size = shape
    if middle:
        size = shape // 2 if behind_lens else np.minimum(shape, (2 * (farthest - half) / pitch).astype(int))
    part = _Part((int(size[0]), int(size[1])), pitch)
    inside_part = tuple(slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(shape, size, strict=True))
    # The side lobes of an ellipse are weaker than those of a rectangle. Light from beyond it falls into stripes midway
    # between the axis and its orders of diffraction, beside the spots, and is spread along the stripes at random.
    y, x = _axes(modulator)
    lit = np.hypot(x / size[1], y / size[0]) * 2 / pitch < 1 if (size < shape).any() else np.full(shape, True)
    narrowed = STRIPE * 2 * (farthest - half[1]) / (shape[1] * pitch)
    beside_spots = 2 * np.pi / (wavelength * b) * (farthest * x - (a - narrowed) * x**2 / 2)
    # Second moments along x and y of an ellipse, or of all pixels.
    moments = (size[::-1] * pitch) ** 2 / (16 if (size < shape).any() else 12)
    half = half[::-1]
    # On the axis behind a lens is the light that is not modulated.
    origin = -half / 2 if behind_lens else np.zeros(2)
    # What is added to the wavefront within the middle part.
    curved = np.zeros(modulator.shape)

    def show(points: np.ndarray, seed: int = 0, extra: np.ndarray | float = 0.0) -> None:
        phase = np.zeros(modulator.shape)
        phase[inside_part] = spots_phase(part, wavelength, distance, points, seed=seed)
        others = beside_spots + np.random.default_rng(seed).uniform(0, 2 * np.pi, (shape[0], 1))
        modulator.show(nearest_levels(np.where(lit, phase + extra - curved, others) - wavefront, phases))

    around = max(8, math.ceil(1.5 * wavelength * abs(b) / (size.min() * pitch * camera.pitch)))

    def places_of(points: np.ndarray, count: int) -> np.ndarray:
        """Return the pixels of single spots; light that does not move with them cancels."""
        frames = []
        for point in points:
            show(point[None])
            frames.append(_averaged(camera, count))
        moving = np.stack(frames) - np.roll(frames, 1, axis=0)
        return np.stack([_centroid(frame, _brightest(frame), around) for frame in moving])

    captures = _validate.integer("captures", captures, minimum=1)
    show(origin[None])
    set_exposure(camera)
    # Spots near the axis tell which of the farther ones the camera sees.
    steps = NEAR * np.diag(half)
    first, *beside = places_of(origin + np.vstack([np.zeros(2), steps]), 1)
    roughly = (np.array(beside) - first) / (NEAR * half[:, None])
    three = np.diag(half)
    for number in range(2):
        for share in (1, -1, 0.8, -0.8, 0.6, -0.6, 0.4, -0.4):
            three[number] = share * np.diag(half)[number]
            there = first + three[number] @ roughly
            if (there >= around).all() and (there <= np.array(camera.shape[::-1]) - 1 - around).all():
                break
        else:
            three[number] = steps[number]
    three = np.vstack([np.zeros(2), three])
    wanted, three = three @ roughly, origin + three
    pixels = places_of(three, captures)
    matrix = np.linalg.solve(np.column_stack([three, np.ones(3)]), pixels)
    missed = np.linalg.norm(pixels - first - wanted, axis=-1)
    _check_places(first, roughly, camera, bool((missed > 2 * around + 0.3 * np.abs(wanted).max()).any()))
    if middle:
        near = 0.45 * half.min() if behind_lens else half.min()
        blur = min(BLUR, 0.6 * near / (size.max() * pitch)) if behind_lens else BLUR
        for _ in range(4):
            curved += _curvature(
                *(modulator, camera, partial(show, three[:1]), wavelength, b, moments, matrix, origin, near, blur)
            )
        # Spots that the aberration had spread are smaller now.
        matrix = np.linalg.solve(np.column_stack([three, np.ones(3)]), places_of(three, captures))
    down, across = _validate.size("grid", grid)
    y, x = (np.linspace(-h, h, n) for h, n in ((half[1], down), (half[0], across)))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    expected = np.column_stack([points, np.ones(len(points))]) @ matrix
    spacing = np.abs(np.linalg.norm(matrix[:2], axis=-1) * 2 * half / np.maximum([across - 1, down - 1], 1)).min()
    show(points)
    set_exposure(camera)
    frame = np.zeros(tuple(camera.shape))
    for seed in range(captures):
        show(points, seed)
        frame += _averaged(camera, 1)
    reach = int(0.4 * spacing)
    inside = ((expected > reach) & (expected < np.array(camera.shape[::-1]) - reach - 1)).all(-1)
    if inside.sum() < 6:
        raise RuntimeError(
            f"{inside.sum()} of {len(points)} spots lie inside the image of the camera; at least 6 are needed"
        )
    seen = []
    for place in expected[inside]:
        corner = np.rint(place).astype(int) - reach
        window = frame[corner[1] : corner[1] + 2 * reach + 1, corner[0] : corner[0] + 2 * reach + 1]
        seen.append(_centroid(frame, _brightest(window) + corner, min(reach, around)))
    seen, points = np.array(seen), points[inside]
    pixel = 1 / np.linalg.norm(matrix[0])
    start = np.linalg.inv(np.vstack([matrix.T, [0, 0, 1]]))
    shift = np.array([[1, 0, camera.shape[1] / 2], [0, 1, camera.shape[0] / 2], [0, 0, 1.0]])
    start = start @ shift

    def mapping(parameters: np.ndarray) -> Registration:
        homography = np.append(parameters[:8], 1.0).reshape(3, 3)
        homography[:2] *= pixel
        return Registration(homography, float(parameters[8]), (camera.shape[0], camera.shape[1]))

    def misfit(parameters: np.ndarray) -> np.ndarray:
        return ((mapping(parameters).plane_points(seen) - points) / pixel).ravel()

    begin = np.append((start / start[2, 2] / np.array([[pixel], [pixel], [1.0]])).ravel()[:8], 0.0)
    scale = np.array([1, 1, 10, 1, 1, 10, 1e-3, 1e-3, 0.1])
    # Spots that were missed do not enter the fit of the mapping.
    fitted = least_squares(misfit, begin, x_scale=scale, loss="soft_l1", f_scale=0.3)
    found = mapping(fitted.x)
    missed = misfit(fitted.x)
    residual = float(np.sqrt((missed.reshape(-1, 2) ** 2).sum(-1).mean()))
    covariance = np.linalg.pinv(fitted.jac.T @ fitted.jac) * (missed @ missed) / max(missed.size - len(fitted.x), 1)
    variance = np.einsum("ki,ij,kj->k", fitted.jac, covariance, fitted.jac).reshape(-1, 2).sum(-1).max()
    # An aberration spreads the spots of a first registration.
    if residual > (2.0 if middle else 0.5):
        warn(
            f"the registration of the camera is uncertain: the residual of the fit is {residual:.2f} pixels",
            AccuracyWarning,
        )
    return Registration(found.homography, found.distortion, found.shape, residual, 2 * math.sqrt(variance))


def _check_places(axis: np.ndarray, matrix: np.ndarray, camera: Camera, missed: bool) -> None:
    """Raise an error if the places of spots are not those of a camera without a lens: the image may be beside it."""
    scale = np.linalg.norm(matrix, axis=-1) * camera.pitch
    flat = abs(np.linalg.det(matrix)) * camera.pitch**2 < 0.3 * scale.prod()
    if missed or flat or (scale > 3).any() or (scale < 1 / 3).any():
        raise RuntimeError(
            f"no spot was found on the axis of the modulator: the brightest light is at column {axis[0]:.0f}, row "
            f"{axis[1]:.0f} and does not move as the pattern does; the image may lie outside the camera's, of "
            f"{camera.shape[1]} columns and {camera.shape[0]} rows: move the camera until the spot of a lens pattern "
            "lies near its middle"
        )


def _lenslets(shape: Sequence[int], wavelength: float, distance: float, pitch: float) -> np.ndarray:
    """Return the number of lenslets along rows and columns: diffraction spreads the light of smaller ones."""
    smallest = SMALLEST_LENSLET * math.sqrt(wavelength * distance) / pitch
    return np.clip((np.array(shape) / smallest).astype(int), 4, 6)


def _beyond(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float,
    registration: Registration,
    share=(1.0, 1.0),
) -> np.ndarray:
    """Return how many pixels the spots of the outermost lenslets lie outside the image of a camera; inside: negative.

    The axes are columns and rows, and the sides of each the first and the last ``[2, 2]``. `share` is that of the
    modulator's rows and columns that is used.
    """
    size = np.array(modulator.shape) * share
    half = (size * (1 - 1 / _lenslets(size, wavelength, distance, modulator.pitch)))[::-1] * modulator.pitch / 2
    points = half * np.array(list(itertools.product((-1, 0, 1), repeat=2)))
    axis, seen = registration.camera_pixels(np.zeros(2)), registration.camera_pixels(points)
    # Lenslets focus straight ahead: without a lens the scale is 1, and another one is an error of the distance.
    scale = math.sqrt(abs(np.linalg.det(registration.homography[:2, :2]))) / camera.pitch
    sides = []
    for places in (seen, axis + (seen - axis) * scale):
        last = np.array(camera.shape[::-1]) - 1
        sides.append(np.stack([-places.min(0), places.max(0) - last], axis=-1) + LEAST_MARGIN)
    return np.minimum(*sides)


def _check_view(beyond: np.ndarray, camera: Camera) -> None:
    """Raise an error that says how to move a camera that does not see the whole modulator."""
    remedies = []
    for name, (first, last) in zip(("columns", "rows"), beyond, strict=True):
        if max(first, last) <= 0:
            continue
        if first + last <= 0:
            side, move = ("smaller", first) if first > last else ("larger", last)
            remedies.append(
                f"it ends {move:.0f} pixels too early on the side of {side} {name}: move the camera by at least "
                f"{1e3 * move * camera.pitch:.2g} mm toward {side} {name}"
            )
        else:
            remedies.append(
                f"the light of the modulator is {first + last:.0f} pixels, {1e3 * (first + last) * camera.pitch:.2g} "
                f"mm, wider than it along {name}: use a larger sensor, or calibrate the middle with partial=True"
            )
    if remedies:
        raise RuntimeError(f"the camera does not see the whole modulator: {'; '.join(remedies)}")


class _Middle:
    """Middle part of a modulator as a modulator of its own; the light of the other pixels is deflected."""

    def __init__(self, modulator: Modulator, shape: tuple[int, int]):
        self.modulator, self.shape, self.pitch, self.bits = modulator, shape, modulator.pitch, modulator.bits
        self.settling_time = modulator.settling_time
        self.inside = tuple(
            slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(modulator.shape, shape, strict=True)
        )
        self.levels = (_deflected(modulator) > 0) * (1 << modulator.bits - 1)

    def show(self, levels: np.ndarray) -> None:
        self.levels[self.inside] = levels
        self.modulator.show(self.levels)

    def embedded(self, found: Calibration) -> Calibration:
        """Return a calibration of the part as one of the whole modulator, with amplitude 0 beside the part."""
        amplitude, wavefront = np.zeros((2, *self.modulator.shape))
        amplitude[self.inside], wavefront[self.inside] = found.amplitude, found.wavefront
        regional = found.regional_phases
        if regional is not None:
            weights = []
            for whole, part, count in zip(self.modulator.shape, self.shape, regional.shape[:2], strict=True):
                middles = ((np.arange(count) + 0.5) * whole / count - whole / 2 + part / 2).astype(int)
                weights.append(_between_regions(part, count)[np.clip(middles, 0, part - 1)])
            regional = np.einsum("ij,kl,jln->ikn", *weights, regional)
        return replace(found, amplitude=amplitude, wavefront=wavefront, regional_phases=regional)


def _curvature(modulator, camera, show, wavelength, distance, moments, matrix, origin, reach, blur) -> np.ndarray:
    """Return the quadratic part of the wavefront in the middle of a modulator, from spots on either side of the focus.

    Rays of an aperture whose second moments along the axes are the diagonal S, behind a lens that adds the curvature ±c
    to the curvatures H of the wavefront, form a spot whose matrix of second moments is (d/k)²·(H ± c)·S·(H ± c). The
    difference of the two is 2·(d/k)²·c·(H·S + S·H), also with diffraction.
    """
    y, x = _axes(modulator)
    added = blur * 2 * np.pi / wavelength / abs(distance)
    back = np.linalg.inv(matrix[:2])
    difference = np.zeros((2, 2))
    away = (np.moveaxis(np.indices(camera.shape)[::-1], 0, -1) - matrix[2]) @ back - origin
    near = np.abs(away).max(-1) < reach
    for sign in (1, -1):
        show(extra=sign * added / 2 * (x**2 + y**2))
        set_exposure(camera)
        frame = _averaged(camera, 4)
        difference += sign * back.T @ _second_moments(frame, near) @ back
    scale = (wavelength * distance / (2 * np.pi)) ** 2 * np.add.outer(moments, moments)
    hessian = -difference / (2 * scale * added)
    # Curvatures larger than that of the lens are approached step by step.
    hessian *= min(1.0, added / np.linalg.norm(hessian, 2))
    return -(hessian[0, 0] * x**2 + 2 * hessian[0, 1] * x * y + hessian[1, 1] * y**2) / 2


def _second_moments(frame: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the matrix of second moments of a spot, columns first, in square pixels, from the pixels near it."""
    smooth = uniform_filter(frame, 5)
    floor = np.quantile(smooth, 0.5)
    light = np.where(near & (smooth - floor > 0.1 * (smooth[near].max() - floor)), frame - floor, 0)
    v, u = np.indices(frame.shape)
    total = light.sum()
    u, v = u - (light * u).sum() / total, v - (light * v).sum() / total
    return np.array([[(light * a * b).sum() for a in (u, v)] for b in (u, v)]) / total


@_validate.takes_units("wavelength", "distance")
def measure_wavefront(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    *,
    amplitude: np.ndarray | float | None = None,
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
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Distance from the modulator to the camera in metres, or the lens between them.
    phases : numpy.ndarray
        Phase of each level in radians, from :func:`measure_phase_response` or :func:`measure_regional_response`.
    registration : Registration
        Mapping of the camera, from :func:`register_camera`.
    amplitude : numpy.ndarray or float, optional
        Amplitude of the illumination, for the simulation of the ideal table; estimated from the brightness of the spots
        by default.
    cells : int, optional
        Number of lenslets along each axis; by default as many as are wider than diffraction allows, from 4 to 6.
    order : int
        Highest radial order of the Zernike polynomials.
    iterations : int
        Number of iterations. With three or more and no `start`, the first two are of 4 × 4 lenslets, and take four
        captures each.
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
    >>> from odak.instruments import Registration, SimulatedTable, measure_wavefront
    >>> table = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.1)
    >>> known = Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    >>> there = (table.modulator, table.camera, 532e-9, table.truth.distance)
    >>> found = measure_wavefront(*there, table.truth.phases, known, iterations=4, captures=1)

    Up to piston and tilt, it is the aberration within a hundredth of a wavelength:

    >>> rows, columns = np.indices(found.shape)
    >>> planes = np.stack([rows, columns, np.ones(found.shape)], axis=-1).reshape(-1, 3)
    >>> error = (found - table.truth.wavefront).ravel()
    >>> error = error - planes @ np.linalg.lstsq(planes, error)[0]
    >>> bool(error.std() < 2 * np.pi / 100)
    True
    """
    there = (modulator, camera, wavelength, distance, phases, registration)
    return wavefront_with_uncertainty(*there, amplitude, cells, order, iterations, captures, start)[0]


def wavefront_with_uncertainty(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    amplitude: np.ndarray | float | None = None,
    cells: int | None = None,
    order: int = 4,
    iterations: int = 10,
    captures: int = 2,
    start: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Return the aberration at a modulator, and its uncertainty in radians, without tilt and defocus.

    The parameters are those of :func:`measure_wavefront`.
    """
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    shape = np.array(modulator.shape)
    order, iterations, captures = (
        _validate.integer(name, value, minimum=least)
        for name, value, least in (("order", order, 2), ("iterations", iterations, 1), ("captures", captures, 1))
    )
    modes = _modes(modulator, order)
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
        fine = _lenslets(modulator.shape, wavelength, distance, modulator.pitch)

    y, x = _axes(modulator)

    def lenslets_of(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the number of the lenslet of each pixel, the lenslets' middles x, y and their mean slopes."""
        row, column = (np.minimum(np.arange(n) * k // n, k - 1) for n, k in zip(shape, parts, strict=True))
        cell = row[:, None] * parts[1] + column
        count = np.bincount(cell.ravel())

        def mean(values: np.ndarray) -> np.ndarray:
            return np.bincount(cell.ravel(), np.broadcast_to(values, cell.shape).ravel()) / count

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
            phase = np.where(used[cell], lenses(cell, targets), _deflected(modulator))
            modulator.show(nearest_levels(phase - wavefront, phases))
            if pair == (0, 0) and not wavefront.any():
                # Spots of an aberration that is corrected are brighter.
                set_exposure(camera, level=0.4)
            frame = _averaged(camera, 1)
            places = registration.camera_pixels(targets[used])
            reach = int(0.45 * np.linalg.norm(places[1:3] - places[0], axis=-1).min())
            seen = np.stack([_centroid(frame, _brightest_near(frame, place, reach), reach) for place in places])
            moved[used] = registration.plane_points(seen) - targets[used]
        return moved

    # Spots of a large aberration may lie at the places of those of other lenslets: few, coarse lenslets come first.
    coarse = 2 if iterations > 2 and start is None else 0
    wavefront = np.zeros(modulator.shape) if start is None else np.asarray(start, float)
    camera.region = None
    cell, middles, system = lenslets_of(np.array([COARSE, COARSE]))
    for _ in range(coarse):
        wavefront = wavefront + fitted(apart(cell, middles), system[:, :FOURTH])[0]
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
            if step == 0 and capture == 0:
                set_exposure(camera)
            frame += _averaged(camera, 1) / captures
        frame[dark] = np.quantile(frame, 0.02)
        seen = np.stack([_centroid(frame, place, reach) for place in places])
        lit = _lit(modulator, frame, seen, middles, reach) if amplitude is None else amplitude
        ideal = np.where(dark, 0, _ideal_capture(modulator, phase, lit, wavelength, distance, registration))
        wanted = np.stack([_centroid(ideal, place, reach) for place in places])
        moved = registration.plane_points(seen) - registration.plane_points(wanted)
        change, gradient, coefficients = fitted(moved, system)
        wavefront = wavefront + change
    if iterations > 1 and change.std() > UNSETTLED:
        warn(
            f"the wavefront is uncertain: the last pattern changed it by {change.std() / (2 * np.pi):.2g} wavelengths; "
            "the aberration may be larger than the lenslets can measure",
            AccuracyWarning,
        )
    pure = np.stack([without(mode, modes[[0, 1, _DEFOCUS]]) for mode in modes]).reshape(len(modes), -1)
    left = gradient - system @ coefficients
    covariance = np.linalg.pinv(system.T @ system) * (left @ left) / max(left.size - len(modes), 1)
    variance = np.einsum("ij,ip,jp->", covariance, pure, pure, optimize=True) / pure.shape[1]
    return wavefront - wavefront.mean(), 2 * math.sqrt(variance)


def _lit(modulator: Modulator, frame: np.ndarray, spots: np.ndarray, places: np.ndarray, reach: int) -> np.ndarray:
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
    y, x = _axes(modulator)
    amplitude = np.exp(system(x, y) @ coefficients)
    return amplitude / amplitude.max()


@_validate.takes_units("wavelength", "distance")
def measure_distance(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    *,
    wavefront: np.ndarray | float = 0.0,
    span: float = 0.15,
    samples: int = 15,
    captures: int = 4,
) -> float:
    """Measure the distance from a modulator to a camera by the lens of sharpest focus.

    The depth of focus λ/NA² of all pixels may be a thousandth of the distance or less. A first sweep of focal lengths
    uses only as many pixels in the middle as are needed for a depth of focus of some steps, with the light of the
    others deflected; sweeps with more pixels, and narrower ranges, follow until all pixels are used.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float
        Nominal distance in metres.
    phases : numpy.ndarray
        Phase of each level in radians, from :func:`measure_phase_response` or :func:`measure_regional_response`.
    registration : Registration
        Mapping of the camera, from :func:`register_camera`.
    wavefront : numpy.ndarray or float
        Aberration in radians that is corrected; its defocus is excluded, as it cannot be distinguished from the
        distance.
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
    >>> from odak.instruments import Registration, SimulatedTable, measure_distance
    >>> table = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> known = Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    >>> there = (table.modulator, table.camera, 532e-9, 4e-3)
    >>> found = measure_distance(*there, table.truth.phases, known, wavefront=table.truth.wavefront)
    >>> bool(abs(found / table.truth.distance - 1) < 0.02)
    True
    """
    there = (modulator, camera, wavelength, distance, phases, registration)
    return distance_with_uncertainty(*there, wavefront, span, samples, captures)[0]


def astigmatism_by_focus(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    wavefront: np.ndarray,
    captures: int = 1,
) -> np.ndarray:
    """Return a wavefront in radians with the astigmatism of the sharpest focus on the axis.

    Unlike the displacements of the spots of lenslets, the sharpness does not depend on the registration. Its logarithm
    is a parabola of the astigmatism, through three captures for each of the two directions.
    """
    modes = _modes(modulator, 2)
    low = modes[[0, 1, _DEFOCUS]]
    _read_around(camera, np.rint(registration.camera_pixels(np.zeros(2))).astype(int), 14)
    lens = lens_phase(modulator, wavelength, distance)

    def show(surface: np.ndarray) -> None:
        modulator.show(nearest_levels(lens - surface, phases))

    # The focus of the right astigmatism may be three times as bright.
    set_exposure(camera, partial(show, wavefront), level=0.25)
    for mode in modes[[_DEFOCUS - 1, _DEFOCUS + 1]]:
        mode = without(mode, low)
        mode = mode * (ASTIGMATISM / mode.std())
        values = []
        for step in (-1, 0, 1):
            show(wavefront + step * mode)
            values.append(math.log(_sharpness(_averaged(camera, captures))))
        below, middle, above = values
        bend = below + above - 2 * middle
        # Far from the peak, the curve is no parabola.
        peak = np.clip((below - above) / (2 * bend), -2, 2) if bend < 0 else np.sign(above - below)
        wavefront = wavefront + float(peak) * mode
    camera.region = None
    return wavefront


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


def _unsaturated(camera: Camera) -> np.ndarray:
    """Return a capture whose exposure was reduced until no pixel is saturated."""
    for _ in range(20):
        frame = _averaged(camera, 1)
        if frame.max() < SATURATED * ((1 << camera.bits) - 1):
            break
        camera.exposure /= 3
    return frame


def _check_focus(camera: Camera, powers: np.ndarray) -> None:
    """Raise an error if a capture of the sharpest focus of a sweep of powers has no spot."""
    frame = _unsaturated(camera)
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
            "on, that the registration is that of this camera, and the distance, or use a larger span"
        )


def distance_with_uncertainty(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    wavefront: np.ndarray | float = 0.0,
    span: float = 0.15,
    samples: int = 15,
    captures: int = 4,
) -> tuple[float, float]:
    """Return the distance from a modulator to a camera, and its uncertainty in metres.

    The parameters are those of :func:`measure_distance`. The error of the wavefront is not in the uncertainty.
    """
    distance = _without_lens(distance, "measure_wavefront finds the defocus")
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    distance = float(_validate.number("distance", distance, positive=True))
    span, samples = _validate.number("span", span, positive=True), _validate.integer("samples", samples, minimum=5)
    if span >= 1:
        raise ValueError(f"span must be a share of the distance below 1, got {span:g}")
    correction = np.asarray(wavefront, float)
    if correction.ndim:
        correction = without(correction, _modes(modulator, 2)[[0, 1, _DEFOCUS]])
    y, x = _axes(modulator)
    largest = max(modulator.shape) * modulator.pitch
    place = registration.camera_pixels(np.zeros(2))

    def depth_of(width: float) -> float:
        """Return the depth of focus as a power, wavelength/width² of a square, of the light that reaches the axis."""
        across, down = (
            np.clip(np.sinc(a * modulator.pitch / (wavelength * distance)), 0, None) * (abs(a) <= width / 2)
            for a in (x, y)
        )
        share = down * across / (down.sum() * across.sum())
        squares = x**2 + y**2
        return wavelength / (EVEN_SQUARE * math.sqrt((share * (squares - (share * squares).sum()) ** 2).sum()))

    def show(power: float, width: float) -> None:
        phase = lens_phase(modulator, wavelength, 1 / power) - correction
        if width < largest:
            phase = np.where(np.maximum(abs(x), abs(y)) <= width / 2, phase, _deflected(modulator))
        modulator.show(nearest_levels(phase, phases))

    def look(width: float, half: float) -> None:
        """Read the camera where the light of a width lies whose focus is off by a power, and three Airy discs more."""
        extent = half * distance * width / 2 + 3 * wavelength * distance / min(width, smallest)
        _read_around(camera, np.rint(place).astype(int), max(14, math.ceil(extent / camera.pitch)))

    # The focus of a small aperture is deep, and its sweep misses none; the apertures that follow search near it.
    smallest = min(modulator.shape) * modulator.pitch
    low, high = 1 / (distance * (1 + span)), 1 / (distance * (1 - span))
    step = (high - low) / (samples - 1)
    peak, half, depth = (low + high) / 2, (high - low) / 2 + step, depth_of(largest)
    sweeps = 0
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
            frame = _unsaturated(camera)
            spots.append(_brightest(frame) + (camera.region or (0, 0))[1::-1])
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
        values[number] = _sharpness(_averaged(camera, captures))
    camera.region = None
    peak, doubt = _vertex(powers, values, depth)
    # Pixels send light into an envelope about the axis, and not about the direction to the focus: the sharpness of an
    # ideal table is not even either. Its vertex is some hundredths of the depth of focus beside the distance.
    ideal = [_ideal_sharpness(modulator, camera, wavelength, 1 / peak, power) for power in powers]
    found = 1 / (2 * peak - _vertex(powers, np.array(ideal), depth)[0])
    return found, math.hypot(doubt, FOCUS * depth) * found**2


def _vertex(powers: np.ndarray, values: np.ndarray, depth: float) -> tuple[float, float]:
    """Return the power of the largest sharpness, by a parabola within the depth of focus, and its uncertainty."""
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
    return float(peak - slope / (2 * bend) * depth), 2 * math.sqrt(toward @ covariance @ toward) * depth


def _ideal_sharpness(modulator: Modulator, camera: Camera, wavelength: float, distance: float, power: float) -> float:
    """Return the sharpness of a lens of a power on an evenly lit panel, whose light is a product of two axes."""
    pixel, lines = modulator.pitch, []
    # Two points of each of 29 pixels of the camera give their means.
    places = np.add.outer(np.arange(-14, 15), np.array([-1, 1]) / math.sqrt(12)).ravel() * camera.pitch
    for at in (axis.ravel() for axis in _axes(modulator)):
        away = places[:, None] - at
        waves = np.sinc(pixel * away / (wavelength * distance)) * np.exp(1j * np.pi / wavelength * away**2 / distance)
        light = np.abs(waves @ np.exp(-1j * np.pi / wavelength * power * at**2)) ** 2
        lines.append(light.reshape(-1, 2).mean(-1))
    return _sharpness(np.outer(*lines))


@_validate.takes_units("wavelength", "distance")
def measure_illumination(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    *,
    wavefront: np.ndarray | float = 0.0,
    cells: int = 8,
    order: int = 4,
    patterns: int = 150,
    captures: int = 1,
) -> np.ndarray:
    """Measure the amplitude of the illumination at a modulator.

    All pixels focus at one point, and cells × cells parts of them get random phases. The intensities at that point and
    its neighbours are those of a sum of waves whose amplitudes are the exponential of a polynomial of the position. How
    much light a pixel sends to the point depends on the angle, too, because of the area of the pixels, the gaps between
    them and fringing fields; four points are used, so that the dependence on the angle is separated from that on the
    position. The coefficients of both are fitted.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    camera : Camera
        The camera.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Distance from the modulator to the camera in metres, or the lens between them.
    phases : numpy.ndarray
        Phase of each level in radians, from :func:`measure_phase_response` or :func:`measure_regional_response`.
    registration : Registration
        Mapping of the camera, from :func:`register_camera`.
    wavefront : numpy.ndarray or float
        Aberration in radians that is corrected.
    cells : int
        Number of parts along each axis.
    order : int
        Order of the polynomial of the two coordinates.
    patterns : int
        Number of patterns shown.
    captures : int
        Number of captures that are averaged for each pattern.

    Returns
    -------
    numpy.ndarray
        Amplitude at each pixel of the modulator, 1 at its largest.

    Warns
    -----
    AccuracyWarning
        If pixels at the edges are farther from all points than a pixel reaches, λ·distance/(2·pitch); if parts of the
        modulator that send light to all points are darker than the polynomial, for example because of dust; or if the
        deviations of the captures from the model give an uncertainty of more than 0.02. The message contains it: the
        root mean square over the pixels, which the error of a panel without dust exceeds in about one of twenty cases.
        Small specks of dust are not detected (8 of 20 simulated tables with three specks, with errors up to 3 %).

    Examples
    --------
    >>> from odak.instruments import Registration, SimulatedTable, measure_illumination
    >>> table = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 48), aberration=0.05)
    >>> known = Registration(table.truth.homography, table.truth.distortion, table.camera.shape)
    >>> there = (table.modulator, table.camera, 532e-9, table.truth.distance)
    >>> found = measure_illumination(*there, table.truth.phases, known, wavefront=table.truth.wavefront, patterns=900)
    >>> bool(abs(found - table.truth.amplitude / table.truth.amplitude.max()).mean() < 0.06)
    True
    """
    there = (modulator, camera, wavelength, distance, phases, registration)
    return illumination_with_uncertainty(*there, wavefront, cells, order, patterns, captures)[0]


def illumination_with_uncertainty(
    modulator: Modulator,
    camera: Camera,
    wavelength: float,
    distance: float | Lens,
    phases: np.ndarray,
    registration: Registration,
    wavefront: np.ndarray | float = 0.0,
    cells: int = 8,
    order: int = 4,
    patterns: int = 150,
    captures: int = 1,
) -> tuple[np.ndarray, float]:
    """Return the amplitude of the illumination at a modulator, and its uncertainty (root mean square).

    The parameters are those of :func:`measure_illumination`.
    """
    check_square_pixels(modulator, camera)
    camera = checked_camera(camera)
    rows, columns = modulator.shape
    cells, order = _validate.integer("cells", cells, minimum=3), _validate.integer("order", order, minimum=1)
    number = [np.minimum(np.arange(n) * cells // n, cells - 1) for n in (rows, columns)]
    cell = number[0][:, None] * cells + number[1]
    behind_lens, (_, b) = isinstance(distance, Lens), ray_matrix(distance)
    farthest = wavelength * abs(b) / (2 * modulator.pitch)
    half = max(rows, columns) * modulator.pitch / 2
    aside = ASIDE * farthest if behind_lens else min(ASIDE * farthest, half / 2)
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=2)))
    bounds = np.array(camera.shape[::-1]) - 1
    for _ in range(8):
        places = registration.camera_pixels(aside * corners)
        if ((places >= 3) & (places <= bounds - 3)).all():
            break
        aside /= 2
    draw = np.random.default_rng(0)
    each = -(-_validate.integer("patterns", patterns, minimum=40) // len(corners))
    parts = [
        _speckles(
            *(modulator, camera, wavelength, distance, phases, registration, wavefront, aside * corner, cell),
            *(draw.integers(4, size=(each, cells * cells)), captures),
        )
        for corner in corners
    ]
    powers = [(i, j) for i, j in itertools.product(range(order + 1), repeat=2) if 0 < i + j <= order]

    def waves_of(part: _Speckles, parameters: np.ndarray) -> np.ndarray:
        x, y = part.places.T / half
        # Behind a lens all pixels send light to a point at the same angle.
        from_point = 0 * part.places if behind_lens else part.places - part.point
        along, across = from_point.T * (modulator.pitch / (wavelength * b))
        squares = along**2 + across**2
        surface = np.stack(
            [x**i * y**j for i, j in powers] + [squares, along**4 + across**4, np.sqrt(squares + 0.01)], axis=-1
        )
        tilt = parameters[1] * x + parameters[2] * y
        return part.sizes * np.exp(parameters[0] / 2 + surface @ parameters[3:] + 1j * tilt) * part.tilts

    def fields(part: _Speckles, parameters: np.ndarray) -> np.ndarray:
        return np.tensordot(1j**part.steps, waves_of(part, parameters), axes=(1, 2))

    def misfit(parameters: np.ndarray) -> np.ndarray:
        seen = [(np.abs(fields(part, parameters)) ** 2).mean(-1) - part.seen for part in parts]
        return np.concatenate([(s / part.noise).ravel() for s, part in zip(seen, parts, strict=True)])

    start = np.zeros(3 + len(powers) + 3)
    start[0] = math.log(
        sum(part.seen.mean() for part in parts) / sum((np.abs(fields(part, start)) ** 2).mean() for part in parts)
    )
    part_pixels = parts[0].seen.shape[1]
    fit = least_squares(misfit, start, x_scale=np.append(np.ones(len(start) - 3), [1.0, 10.0, 1.0]))
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
    sigma = np.sqrt(np.diag(inverse)[: cells * cells] * left.var())
    whole = np.min([part.sizes for part in parts], axis=0) == np.bincount(cell.ravel())
    # Where captures deviate from the model by more than noise, parts scatter by more than that.
    sigma = np.maximum(sigma, 1.48 * np.median(abs(deviation[whole]))) if whole.any() else sigma
    dark = np.where(whole & (deviation < -4 * sigma), -deviation, 0)
    y, x = (np.broadcast_to(axis / half, modulator.shape) for axis in _axes(modulator))
    terms = np.stack([x**i * y**j for i, j in powers], axis=-1)
    surface = terms @ fitted[3:-3]
    largest = np.unravel_index(surface.argmax(), surface.shape)
    amplitude = np.exp(surface - surface[largest])
    # Errors of a pattern are correlated among the pixels of the camera: their sums over patterns give the covariance.
    scores = (fit.jac * fit.fun[:, None]).reshape(-1, part_pixels, len(fitted)).sum(1)
    inner = np.linalg.pinv(fit.jac.T @ fit.jac)
    covariance = (inner @ (scores.T @ scores) @ inner)[3:-3, 3:-3]
    relative = terms - terms[largest]
    variance = np.einsum("rci,ij,rcj->rc", relative, covariance, relative)
    # The root mean square of errors of some ten coefficients exceeds 1.5 times its expectation in one of twenty cases.
    uncertainty = 1.5 * math.sqrt((amplitude**2 * variance).mean())
    reason = ""
    if half > farthest + aside and not behind_lens:
        reason = (
            f"pixels at the edges, farther than {farthest + aside:.3g} m from the axis along rows or columns, send "
            "little light to it; use a larger distance"
        )
    elif dark.mean() > DUSTY:
        reason = (
            f"parts of the modulator are darker than the polynomial by up to {dark.max():.0%}, for example because of "
            "dust, which the result does not contain"
        )
    elif uncertainty > EVEN:
        reason = "the captures deviate from those of the model"
    if reason:
        uncertainty = math.hypot(uncertainty, math.sqrt(DEPTH * dark.mean()))
        warn(f"the illumination is uncertain by {uncertainty:.2g} (root mean square): {reason}", AccuracyWarning)
    return amplitude, uncertainty


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
    tilts: np.ndarray
    """Wave of each cell at points of the pixels of the camera ``[pixels, 4, cells]``."""


def _speckles(
    modulator, camera, wavelength, distance, phases, registration, wavefront, point, cell, steps, captures
) -> _Speckles:
    """Capture the light of cells with random phases that is focused at a point."""
    y, x = _axes(modulator)
    _, b = ray_matrix(distance)
    farthest = 0.95 * wavelength * abs(b) / (2 * modulator.pitch)
    if isinstance(distance, Lens):
        reaches = np.ones(modulator.shape, dtype=bool)
    else:
        reaches = (np.abs(x - point[0]) < farthest) & (np.abs(y - point[1]) < farthest)
    rows, columns = np.indices(modulator.shape)
    lens = lens_phase(modulator, wavelength, distance, point) - wavefront
    # The light of the other pixels is deflected by the largest angle.
    shown = np.stack(
        [nearest_levels(np.where(reaches, lens + turn, np.pi * (rows + columns)), phases) for turn in QUARTERS]
    )
    _read_around(camera, np.rint(registration.camera_pixels(point)).astype(int), 2)

    def show(step: np.ndarray) -> None:
        modulator.show(np.take_along_axis(shown, step[cell][None], axis=0)[0])

    set_exposure(camera, lambda: show(0 * steps[0]))
    # Random phases spread the light over a region as many times larger as there are cells; speckles are up to five
    # times as bright as their mean.
    cells = steps.shape[1]
    camera.exposure *= cells / 8
    frames = []
    for step in steps:
        show(step)
        frames.append(_averaged(camera, captures))
    seen = np.stack(frames).reshape(len(steps), -1)
    fine = seen.max(-1) < 0.95 * ((1 << camera.bits) - 1)
    # The minimum over many speckles is zero intensity.
    seen = (seen[fine] - np.quantile(seen, 0.005)) / camera.exposure
    camera.exposure /= cells / 8
    row, column, high, wide = camera.region or (0, 0, *camera.shape)
    camera.region = None
    v, u = np.meshgrid(np.arange(row, row + high), np.arange(column, column + wide), indexing="ij")
    # A pixel averages over its area: Gauss's formula of two points along each axis.
    offsets = np.array(list(itertools.product((-1, 1), repeat=2))) / math.sqrt(12)
    points = registration.plane_points(np.stack([u, v], axis=-1).reshape(-1, 1, 2) + offsets)
    count = np.bincount(cell[reaches], minlength=cells)
    places = (
        np.stack([np.bincount(cell[reaches], np.broadcast_to(a, cell.shape)[reaches], cells) for a in (x, y)], axis=-1)
        / np.maximum(count, 1)[:, None]
    )
    tilts = np.exp(-2j * np.pi / (wavelength * b) * ((points - point) @ places.T))
    noise = np.sqrt(np.clip(seen, 0, None) * seen.max() + (0.02 * seen.max()) ** 2)
    return _Speckles(point, steps[fine], seen, noise, places, count, tilts)


def save_calibration(path: str | os.PathLike[str], calibration: Calibration) -> None:
    """Write a calibration to a file, which appears whole or not at all.

    The file holds the arrays phases, amplitude, wavefront and homography, and of the regions where they were measured,
    regional_phases; and the format ("odak calibration"), its version (1), the units of all quantities, and the numbers
    wavelength, pitch, distance, distortion, camera_shape and residual, and uncertainty_phases and so on of what was
    measured. In ``.npz`` these are a JSON object, UTF-8 text
    in the array ``header``; in HDF5 they are attributes of the file.

    Parameters
    ----------
    path : str or os.PathLike
        ``.npz`` file, or ``.h5`` or ``.hdf5`` file, which needs h5py (``pip install h5py``).
    calibration : Calibration
        The results.

    Raises
    ------
    ValueError
        If a value is out of range or an array of another shape than the others require; the message names it.
    OSError
        If the disk is full; the error names the file, and one that was there before remains.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.instruments import Calibration, SimulatedTable, load_calibration, save_calibration
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "table.npz")
    ...     save_calibration(name, assumed)
    ...     load_calibration(name).distance
    0.02
    """
    if not isinstance(calibration, Calibration):
        raise TypeError(f"calibration must be a Calibration, got {type(calibration).__name__}")
    path = validate_path(path, [".npz", *SUFFIXES])
    header = {"format": FORMAT, "version": VERSION, **_values(_checked(_values(calibration)))}
    arrays = {name: header.pop(name) for name in (*_MAPS, "homography", "regional_phases") if name in header}
    if path.lower().endswith(SUFFIXES):
        write_hdf5(path, arrays, header, UNITS)
        return
    packed = io.BytesIO()
    text = json.dumps({**header, "units": UNITS})
    np.savez(packed, header=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)
    with replacing(path) as stream:
        stream.write(packed.getbuffer())


def load_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Read a calibration that :func:`save_calibration` wrote.

    Parameters
    ----------
    path : str or os.PathLike
        ``.npz``, ``.h5`` or ``.hdf5`` file.

    Returns
    -------
    Calibration
        The results.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a calibration, a value is out of range (such as a length that is not in metres) or an array of
        another shape than the others require, or its arrays take more than 160 MiB and more than 64 bytes for each
        byte of the file; the message names the file and the value.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.instruments import Calibration, SimulatedTable, load_calibration, save_calibration
    >>> table = SimulatedTable(seed=1, shape=(32, 32), camera_shape=(40, 48))
    >>> assumed = Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "table.npz")
    ...     save_calibration(name, assumed)
    ...     load_calibration(name).wavelength
    5.32e-07
    """
    path = validate_path(path, [".npz", *SUFFIXES])
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no file {path!r}")
    try:
        arrays, header = read_hdf5(path, FORMAT, VERSION) if path.lower().endswith(SUFFIXES) else _read_npz(path)
        return _checked({**header, **arrays})
    except KeyError as error:
        raise ValueError(f"{path!r} cannot be read as a calibration: {error} is missing") from error
    except (TypeError, ValueError, OSError) as error:
        raise ValueError(f"{path!r} cannot be read as a calibration: {error}") from error


def _read_npz(path: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays and the header of a ``.npz`` file."""
    arrays = read_npz(path)
    try:
        header = json.loads(arrays.pop("header").tobytes().decode())
    except (ValueError, RecursionError) as error:
        raise ValueError(f"its header is not JSON: {error}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT or header.get("version") != VERSION:
        told = header if isinstance(header, dict) else {}
        raise ValueError(f"its format is {told.get('format')!r}, version {told.get('version')!r}")
    return arrays, header


def _values(calibration: Calibration) -> dict[str, Any]:
    """Return the values of a calibration by the names that they have in files."""
    registration, path = calibration.registration, calibration.distance
    lens = [path.focal_length, path.before, path.after, path.block] if isinstance(path, Lens) else None
    return {
        **{name: getattr(calibration, name) for name in ("wavelength", "pitch", *_MAPS)},
        **({"distance": path} if lens is None else {"lens": np.array(lens)}),
        "homography": registration.homography,
        "distortion": registration.distortion,
        "camera_shape": registration.shape,
        "residual": registration.residual,
        **({} if calibration.regional_phases is None else {"regional_phases": calibration.regional_phases}),
        **{f"{_UNCERTAIN}{name}": value for name, value in calibration.uncertainty.items()},
    }


_MAPS, _UNCERTAIN = ("phases", "amplitude", "wavefront"), "uncertainty_"
# Largest phase in radians; distortion at which the mapping of a camera folds; largest camera; least ratio of the
# magnifications of a camera along two directions.
_LARGEST_PHASE, _LARGEST_DISTORTION, _LARGEST_CAMERA, _LEAST_RATIO = 1e6, 1 / 3, 65536, 1e-3


def _checked(values: Mapping[str, Any]) -> Calibration:
    """Return a calibration after checking each value: what is out of range or of another shape is refused by name."""
    phases = checked_array("phases", values["phases"], ("levels",), -_LARGEST_PHASE, _LARGEST_PHASE)
    if len(phases) < 2:
        raise ValueError(f"phases must have at least 2 levels, got {len(phases)}")
    amplitude = checked_array("amplitude", values["amplitude"], ("rows", "columns"), 0, 1 + 1e-6)
    if not amplitude.any():
        raise ValueError("amplitude must be above 0 at some pixel, got 0 at all")
    regional = values.get("regional_phases")
    if regional is not None:
        shape = ("region rows", "region columns", len(phases))
        regional = checked_array("regional_phases", regional, shape, -_LARGEST_PHASE, _LARGEST_PHASE)
        if any(n > m for n, m in zip(regional.shape, amplitude.shape, strict=False)):
            raise ValueError(f"regional_phases must have at most {amplitude.shape} regions, got {regional.shape[:2]}")
    names = [name for name in values if name.startswith(_UNCERTAIN)]
    doubts = {name.removeprefix(_UNCERTAIN): float(checked_number(name, values[name], 0, 1e6)) for name in names}
    return Calibration(
        checked_number("wavelength", values["wavelength"], *WAVELENGTHS, "metres"),
        checked_number("pitch", values["pitch"], *PITCHES, "metres"),
        _checked_path(values),
        phases,
        amplitude,
        checked_array("wavefront", values["wavefront"], amplitude.shape, -_LARGEST_PHASE, _LARGEST_PHASE),
        _checked_registration(values, doubts.get("registration", 0.0)),
        regional,
        doubts,
    )


def _checked_path(values: Mapping[str, Any]) -> float | Lens:
    """Return the distance of a file, or its lens."""
    if "lens" in values:
        return Lens(*(float(n) for n in checked_array("lens", values["lens"], (4,), 0, LARGEST_DISTANCE)))
    return checked_number("distance", values["distance"], 1e-9, LARGEST_DISTANCE, "metres")


def _checked_registration(values: Mapping[str, Any], doubt: float) -> Registration:
    """Return the registration of a file unless it maps the sensor through infinity or onto a line."""
    shape = np.asarray(values["camera_shape"])
    if shape.shape != (2,):
        raise ValueError(f"camera_shape must be two numbers [rows, columns], got {values['camera_shape']!r:.80}")
    rows, columns = (
        int(checked_number(f"camera_shape[{i}]", n, 1, _LARGEST_CAMERA, whole=True)) for i, n in enumerate(shape)
    )
    homography = checked_array("homography", values["homography"], (3, 3), -1e12, 1e12)
    corners = np.array(list(itertools.product((-columns, columns), (-rows, rows)))) / 2
    depths = np.array([homography[2, 2], *(corners @ homography[2, :2] + homography[2, 2])])
    if not (abs(depths) > 1e-9 * abs(homography[2]).max()).all() or len(set(np.sign(depths))) > 1:
        raise ValueError("homography must map the whole sensor to points at finite distances, and has a pole on it")
    # Its derivative in the middle of the sensor, in metres for each pixel.
    derivative = homography[:2, :2] - np.outer(homography[:2, 2], homography[2, :2]) / homography[2, 2]
    large, small = np.linalg.svd(derivative / homography[2, 2], compute_uv=False)
    if not (PITCHES[0] / 100 < large < 100 * PITCHES[1] and small > _LEAST_RATIO * large):
        raise ValueError(
            f"homography must map a pixel to an area, of {PITCHES[0] / 100:g} to {100 * PITCHES[1]:g} metres, got "
            f"{large:g} along one direction and {small:g} along the other"
        )
    return Registration(
        homography,
        checked_number("distortion", values["distortion"], -_LARGEST_DISTORTION, _LARGEST_DISTORTION),
        (rows, columns),
        checked_number("residual", values["residual"], 0, _LARGEST_CAMERA, "pixels"),
        doubt,
    )


class _Part(NamedTuple):
    """Middle part of a modulator."""

    shape: tuple[int, int]
    pitch: float


def lens_phase(
    modulator: Modulator | _Part, wavelength: float, distance: float | Lens, point: Sequence[float] = (0, 0)
) -> np.ndarray:
    """Return the phase in radians ``[rows, columns]`` of a lens that focuses at a point x, y of a plane.

    Parameters
    ----------
    modulator : Modulator
        The modulator.
    wavelength : float
        Vacuum wavelength in metres.
    distance : float or Lens
        Focal length in metres, or the lens between the modulator and the plane.
    point : sequence of float
        x and y in metres.
    """
    wavelength = float(_validate.number("wavelength", wavelength, positive=True))
    y, x = _axes(modulator)
    if isinstance(distance, Lens):
        a, b = distance.ray_matrix
        return 2 * np.pi / (wavelength * b) * (x * point[0] + y * point[1] - a / 2 * (x**2 + y**2))
    distance = float(_validate.number("distance", distance, positive=True))
    squared = (x - point[0]) ** 2 + (y - point[1]) ** 2
    return -2 * np.pi / wavelength * squared / (np.sqrt(squared + distance**2) + distance)


def spots_phase(
    modulator: Modulator | _Part,
    wavelength: float,
    distance: float | Lens,
    points: np.ndarray,
    iterations: int = 12,
    seed: int = 0,
) -> np.ndarray:
    """Return the phase ``[rows, columns]`` that forms spots of equal intensity at points x, y ``[n, 2]`` of a plane.

    The phases of the spots begin at random, by the seed.
    """
    draw = np.random.default_rng(seed)
    angles = 2 * np.pi * draw.random(len(points))
    weights = np.ones(len(points))
    size = math.prod(modulator.shape)
    # Weights and phases of the spots follow from a part of the pixels (Pozzi et al., Appl. Opt. 57, 6664 (2018)).
    chosen = np.sort(draw.choice(size, SAMPLED, replace=False)) if size > SAMPLED else np.arange(size)
    lenses = (lens_phase(modulator, wavelength, distance, point).ravel()[chosen] for point in points)
    waves = np.stack([np.exp(1j * lens) for lens in lenses])
    for _ in range(iterations if len(points) > 1 else 1):
        factors = weights * np.exp(1j * angles)
        hologram = factors @ waves
        hologram /= np.abs(hologram)
        spots = (waves @ hologram.conj()).conj()
        angles, weights = np.angle(spots), weights * np.abs(spots).mean() / np.abs(spots)
    if size > SAMPLED:
        hologram = np.zeros(modulator.shape, dtype=np.complex64)
        for factor, point in zip(factors, points, strict=True):
            phase = np.remainder(lens_phase(modulator, wavelength, distance, point) + np.angle(factor), 2 * np.pi)
            hologram += np.abs(factor) * np.exp(1j * phase.astype(np.float32))
    return np.angle(hologram).reshape(modulator.shape)


def without(surface: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Return a surface ``[rows, columns]`` without its mean and its components along modes ``[n, rows, columns]``."""
    system = np.column_stack([np.ones(surface.size), modes.reshape(len(modes), -1).T])
    coefficients, *_ = np.linalg.lstsq(system, surface.ravel(), rcond=None)
    return surface - (system @ coefficients).reshape(surface.shape)


# Place of defocus among the modes below: two tilts, then radial order 2 with m = −2, 0, 2.
_DEFOCUS = 3


def _modes(modulator: Modulator, order: int) -> np.ndarray:
    """Return the Zernike polynomials of orders 1 to `order` over the circle around the modulator."""
    y, x = _axes(modulator)
    half = math.hypot(*modulator.shape) * modulator.pitch / 2
    rho, theta = np.hypot(x, y) / half, np.arctan2(y, x)
    pairs = [(n, m) for n in range(1, order + 1) for m in range(-n, n + 1, 2)]
    return np.stack([zernike_polynomial(n, m, np.minimum(rho, 1), theta) for n, m in pairs])


def _axes(modulator: Modulator | _Part) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates y ``[rows, 1]`` and x ``[1, columns]`` of the pixels in metres."""
    rows, columns = modulator.shape
    y, x = ((np.arange(n) - n // 2) * modulator.pitch for n in (rows, columns))
    return y[:, None], x[None]


def _averaged(camera: Camera, count: int) -> np.ndarray:
    return camera.capture(count).astype(np.float64).mean(0)


def _brightest(frame: np.ndarray) -> np.ndarray:
    """Return the column and row of the brightest spot."""
    row, column = np.unravel_index(uniform_filter(frame, 3).argmax(), frame.shape)
    return np.array([column, row])


def _brightest_near(frame: np.ndarray, place: np.ndarray, reach: int) -> np.ndarray:
    """Return the column and row of the brightest spot in a window about a place."""
    first = np.maximum(np.rint(place).astype(int) - reach, 0)
    last = np.rint(place).astype(int) + reach + 1
    return _brightest(frame[first[1] : last[1], first[0] : last[0]]) + first


def _deflected(modulator: Modulator) -> np.ndarray:
    """Return the phase 0 and π of a chequerboard, which deflects light by the largest angle."""
    rows, columns = np.indices(modulator.shape)
    return np.pi * ((rows + columns) % 2)


def _centroid(frame: np.ndarray, place: np.ndarray, reach: int) -> np.ndarray:
    """Return the column and row of the centroid of a spot, within a window about a place that follows the spot."""
    for _ in range(5):
        column, row = np.rint(place).astype(int)
        first = max(row - reach, 0), max(column - reach, 0)
        window = frame[first[0] : row + reach + 1, first[1] : column + reach + 1]
        if not window.size:
            raise RuntimeError(f"a spot was expected at column {column}, row {row}, outside the image of the camera")
        floor = np.quantile(window, 0.3)
        light = np.clip(window - floor - 0.1 * (window.max() - floor), 0, None)
        total = light.sum() or 1.0
        down, across = (np.arange(n) for n in window.shape)
        found = np.array([first[1] + (light.sum(0) @ across) / total, first[0] + (light.sum(1) @ down) / total])
        if np.abs(np.rint(found) - np.rint(place)).max() == 0:
            break
        place = found
    return found


def _read_around(camera: Camera, place: np.ndarray, reach: int) -> None:
    """Set the region of a camera to a window about a place (column, row)."""
    column, row = (
        int(np.clip(p - reach, 0, n - 2 * reach - 1)) for p, n in zip(place, camera.shape[::-1], strict=True)
    )
    camera.region = (row, column, 2 * reach + 1, 2 * reach + 1)


def predicted_capture(calibration: Calibration, levels: np.ndarray) -> np.ndarray:
    """Return the intensity at the middles of the camera's pixels that a pattern of levels gives by a calibration.

    Parameters
    ----------
    calibration : Calibration
        Response, aberration, illumination, distance and registration.
    levels : numpy.ndarray
        Integers ``[rows, columns]``.

    Returns
    -------
    numpy.ndarray
        ``[camera rows, camera columns]`` in arbitrary units, without noise and stray light.
    """
    panel = _Part(calibration.amplitude.shape, calibration.pitch)
    phase = phases_of_levels(np.asarray(levels, dtype=np.int64), calibration.response) + calibration.wavefront
    there = (calibration.wavelength, calibration.distance, calibration.registration)
    return _ideal_capture(panel, phase, calibration.amplitude, *there)


def _ideal_capture(modulator, phase, amplitude, wavelength, distance, registration) -> np.ndarray:
    """Return the simulated capture of a pattern on an ideal table."""
    rows, columns = modulator.shape
    v, u = np.indices(registration.shape)
    points = registration.plane_points(np.stack([u, v], axis=-1))
    if isinstance(distance, Lens):
        return _ideal_focus(modulator, amplitude * np.exp(1j * phase), wavelength, distance, points)
    points = points / modulator.pitch
    wide = [2 * n for n in (rows, columns)]
    field = np.zeros(wide, dtype=complex)
    first = [n // 2 - m // 2 for n, m in zip(wide, (rows, columns), strict=True)]
    field[first[0] : first[0] + rows, first[1] : first[1] + columns] = amplitude * np.exp(1j * phase)
    # Pixels are squares: the share that emits is not measured, and scales the light more than it widens the envelope.
    field = np.fft.ifft2(pixels_spectrum(field, wide))
    kind = "Bandlimited Angular Spectrum"
    there: Any = propagate_beam(
        field, None, distance, modulator.pitch, wavelength, kind, zero_padding=[False, False, False]
    )
    return map_coordinates(
        np.abs(np.asarray(there)) ** 2, [points[..., 1] + wide[0] // 2, points[..., 0] + wide[1] // 2], order=3
    )


def _ideal_focus(modulator, field, wavelength: float, lens: Lens, points: np.ndarray) -> np.ndarray:
    """Return the intensity behind a lens at points x, y in metres: the spectrum of square pixels."""
    a, b = lens.ray_matrix
    y, x = _axes(modulator)
    field = field * np.exp(1j * np.pi * a / (wavelength * b) * (x**2 + y**2))
    wide = [3 * n for n in modulator.shape]
    reach = wavelength * abs(b) / modulator.pitch
    orders = min(3, math.ceil(2 * float(np.abs(points).max()) / reach + 0.1))
    light = np.fft.fftshift(np.abs(pixels_spectrum(field, wide, orders)) ** 2)
    places = [points[..., 1 - k] * n * modulator.pitch / (wavelength * b) + orders * n // 2 for k, n in enumerate(wide)]
    return map_coordinates(light, places, order=3) * (np.hypot(points[..., 0], points[..., 1]) >= lens.block)
