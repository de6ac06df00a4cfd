"""Calibration of an optical table through the protocols of its instruments.

The functions are called in this order, each with a table that has the results of those before: phase response,
registration of the camera, wavefront, distance, illumination.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from odak import _show, _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.focus import astigmatism_by_focus, distance_with_uncertainty, error_by_wavefront, focused
from odak.instruments.illumination import illumination_with_uncertainty
from odak.instruments.mapping import Lens, Registration, ray_matrix
from odak.instruments.phase_response import (
    SMALLEST_REGION,
    between_regions,
    measure_unmodulated_light,
    nearest_levels,
    phases_of_levels,
    phases_with_uncertainty,
    regions_with_uncertainty,
    warn_of_short_range,
)
from odak.instruments.protocols import Camera, SLMDriver, check_square_pixels
from odak.instruments.registration import SMALLEST_SHARE, beyond_view, check_view, registered
from odak.instruments.spots import DEFOCUS, Part, aberration_modes, deflected, ideal_capture, pixel_axes, without
from odak.instruments.steadiness import watched
from odak.instruments.steered import is_wide, linear_part, steered
from odak.instruments.tables import OpticalTable, parts_of
from odak.instruments.wavefronts import UNSETTLED, wavefront_with_uncertainty

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
    "unmodulated": "amplitude of the modulated light",
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
# Residual of a first registration behind a lens in pixels, above which its spots were not found.
LARGEST_RESIDUAL = 10.0
# Factor that makes standard deviations of the errors of the distance of wide modulators.
OF_STEERED = 4.0
# Share of the last change of the wavefront that is taken as its error.
REST = 0.2
# Uncertainties above which calibrate_table warns: rad, pixel, rad.
LIMITS = {"phases": 0.015, "registration": 0.1, "wavefront": 2 * np.pi / 200}
# Error of a wavefront in radians that is left without noise, a five-hundredth of a wavelength.
SMALLEST_ERROR = 2 * np.pi / 500
# Width of a modulator in units of the square root of wavelength and distance below which diffraction spreads the light
# of its lenslets too much to tell the distance; shares of the distance on either side among which the focus is searched
# for there, at first and later; patterns of the illumination, without a lens and behind one, where more patterns reduce
# its error.
FEWEST, FAR, NEAR, PATTERNS, BEHIND_LENS = 5.5, 0.15, 0.03, 16, 40
# Captures of grids of spots for the first registration, those between, and the last.
FIRST_GRIDS, GRIDS, LAST_GRIDS = 2, 2, 4
# Rows and columns of regions where the response varies.
REGIONS = (3, 3)


@dataclass(frozen=True, repr=False)
class Calibration(_show.Shown):
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
        Phase of each level in radians, relative to level 0.
    amplitude : numpy.ndarray
        Amplitude of the illumination at each pixel of the modulator, 1 at its largest.
    wavefront : numpy.ndarray
        Aberration at each pixel of the modulator in radians.
    registration : Registration
        Mapping of the camera.
    regional_phases : numpy.ndarray, optional
        Phase of each level in regions of the modulator, ``[region rows, region columns, levels]``.
    unmodulated : complex
        Amplitude of the light of gaps and the cover glass in units of that of the pixels, from
        :func:`measure_unmodulated_light`.
    uncertainty : dict
        Uncertainties of what was measured, one sigma: about two of three errors are smaller. "phases" and
        "regional_phases" in radians (largest error over the levels), "registration" in pixels of the camera (largest
        error over the middle 70 % of the panel's width and height), "wavefront" in radians and "amplitude" as a
        fraction of the largest (root mean square errors over the panel), and "distance" in metres.

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
    unmodulated: complex = 0.0

    @classmethod
    def nominal(cls, modulator: SLMDriver, camera: Camera, wavelength: float, distance: float | Lens) -> "Calibration":
        """Return the nominal properties of a table, without faults.

        Parameters
        ----------
        modulator : SLMDriver
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

    def table(self, modulator: SLMDriver, camera: Camera) -> OpticalTable:
        """Return the table of a modulator and a camera as it was found, for further measurements.

        Parameters
        ----------
        modulator : SLMDriver
            The modulator.
        camera : Camera
            The camera.

        Returns
        -------
        OpticalTable
            The table, with the response of regions where it was measured.
        """
        there = (modulator, camera, self.wavelength, self.distance)
        return OpticalTable(*there, self.response, self.registration, self.wavefront, self.amplitude)

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
        """Phase of each level in regions of the modulator, where it was measured, or else of the whole modulator."""
        return self.phases if self.regional_phases is None else self.regional_phases

    def response_factors(self) -> np.ndarray:
        """Return the factor ``[rows, columns]`` by which the phases of the levels of each pixel exceed `phases`."""
        if self.regional_phases is None:
            return np.ones(self.amplitude.shape)
        factors = self.regional_phases @ self.phases / (self.phases @ self.phases)
        down, across = (between_regions(n, k) for n, k in zip(self.amplitude.shape, factors.shape, strict=True))
        return down @ factors @ across.T

    def levels(self, phase: np.ndarray) -> np.ndarray:
        """Return the levels that show a phase in radians ``[rows, columns]`` with the aberration corrected.

        Where the response of regions is known, a cubic spline through their middles, which continues to the edges of
        the modulator, gives the response of each pixel.
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
    from odak._drawn import FAINT, color_of, subplots, svg

    figure, ((axes,),) = subplots(1, 1, (3.6, 2.6))
    axes.plot(2 * np.pi * np.linspace(0, 1, len(phases)), color=FAINT)
    axes.plot(phases, color=color_of(0))
    axes.set(xlabel="level", ylabel="phase (rad)")
    return svg(figure)


@_validate.takes_fields("modulator camera wavelength distance", table=OpticalTable)
@_validate.takes_units()
def calibrate_table(
    table: OpticalTable,
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
    table : OpticalTable
        The table, with its nominal distance, or with the lens near whose back focal plane the camera is. What is known
        of it besides is measured anew.
    rounds : int
        Number of measurements of the registration and the wavefront; up to twice as many as long as the wavefront
        changes by more than a twentieth of a wavelength. With two, a calibration without a lens takes about 110
        captures, and 130 with cameras of fewer than 10 bits; of modulators wider than what a pixel reaches,
        λ·distance/pitch, up to 500.
    regions : sequence of int, optional
        Rows and columns of regions whose phase response is measured too, after the second registration, and used in
        the later steps; a response that varies over the modulator acts as an aberration and shifts the image. The
        phases are then the mean over the modulator. None, the default, measures 3 × 3 regions where the captures of the
        phase response deviate by more than 1 % from a response with one phase at all pixels; (1, 1) measures none.
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
        than 36 rows or columns; if the uncertainty of the phases exceeds 0.015 rad, of the registration 0.1 pixels,
        or of the wavefront 1/200 of a wavelength; and as the functions of the steps.

    Notes
    -----
    The uncertainty of the wavefront comes from the fit to its gradients and from what further repetitions would change.
    It contributes to the uncertainty of the distance, as a defocus, and the distance to the uncertainty of the
    registration. The uncertainty of the phases comes from the noise of the captures, as what three images leave of them
    tells it, from the deviation of the captures from a response with one phase at all pixels, from what the two halves
    of the modulator differ by beyond noise, and from the difference between all levels and every second one; with
    regions, it is twice the uncertainty of a mean of independent values.
    The factors between residuals and uncertainties were chosen on 50 simulated tables that share no code with the
    package: uncertainties are estimates, not bounds.

    Examples
    --------
    >>> import warnings
    >>> from odak.instruments import OpticalTable, SimulatedTable, calibrate_table
    >>> hidden = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.1)
    >>> table = OpticalTable(hidden.modulator, hidden.camera, hidden.laser.wavelength, 6e-3)
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore")  # the illumination of so few pixels is found within 3 % only
    ...     found = calibrate_table(table)
    >>> bool(abs(found.distance / hidden.truth.distance - 1) < 0.01)
    True
    >>> bool(abs(found.phases - hidden.truth.phases).max() < 0.02)
    True
    """
    rounds, partial = _validate.integer("rounds", rounds, minimum=1), _validate.flag("partial", partial)
    if isinstance(table.distance, Lens) and (partial or regions not in (None, (1, 1))):
        raise ValueError("distance must be without a lens for regions and partial: behind one, pixels reach all places")
    found = _calibrated(table, rounds, regions, partial)
    for text in _doubts(found.uncertainty):
        warn(text, AccuracyWarning)
    return found


@watched("calibration")
def _calibrated(table: OpticalTable, rounds: int, regions: Sequence[int] | None, partial: bool) -> Calibration:
    """Return the calibration of a table; the parameters are as in :func:`calibrate_table`."""
    behind_lens = isinstance(table.distance, Lens)
    modulator, camera, wavelength, _ = parts_of(table)
    wavefront = np.zeros(modulator.shape)
    table = replace(table, camera=camera, wavefront=wavefront, amplitude=None)
    phases, doubt, spread = phases_with_uncertainty(table, 13, 5)
    warn_of_short_range(phases)
    regions = _regions_to_measure(regions, modulator, spread, behind_lens)
    uncertainty = {"phases": doubt}
    table, registration = replace(table, phases=phases), None
    regional, change = None, math.inf
    wide = not behind_lens and is_wide(table)
    for turn in range(2 * rounds):
        if turn >= rounds + wide and change < UNSETTLED:
            break
        if turn == 0 or not wide:
            grids = FIRST_GRIDS if turn == 0 else GRIDS
            registration = registered(table, middle=turn == 0, captures=grids, start=registration)
            registration = linear_part(table, registration) if wide else registration
        table = replace(table, registration=registration)
        if turn == 0 and behind_lens:
            _check_orders(table)
        elif turn == 0 and (part := _seen_part(table, partial)):
            within = replace(table, modulator=part)
            return part.embedded(_calibrated(within, rounds, regions, True))
        # An aberration falsifies the first registration, and so where the regions are thought to be.
        if turn == min(1, rounds - 1) and regions != (1, 1):
            regional, doubts = regions_with_uncertainty(table, regions, whole=phases)
            table = replace(table, phases=regional)
            shares = np.multiply.outer(
                *(between_regions(n, parts).mean(0) for n, parts in zip(modulator.shape, regions, strict=True))
            )
            phases = np.tensordot(shares, regional, axes=2)
            # The errors of the regions are partly independent.
            uncertainty = {"phases": 2 * float(np.linalg.norm(shares * doubts)), "regional_phases": float(doubts.max())}
        if wide:
            table, doubt, of_distance = steered(table, turn == 0, 1 if turn == 0 else 2)
            registration = table.registration
        else:
            table, doubt = _with_aberration(table, turn)
        change, wavefront = float((table.wavefront - wavefront).std()), np.asarray(table.wavefront)
    # An error of the response of a region acts as an aberration, of the mean phase of a pattern. The factors here and
    # below are those that make standard deviations of the errors on 50 independent tables.
    response_error = 0.4 * uncertainty.get("regional_phases", 0.0)
    uncertainty["wavefront"] = math.hypot(1.5 * doubt, REST * change, SMALLEST_ERROR, response_error)
    if wide:
        uncertainty["distance"] = OF_STEERED * of_distance
    elif not behind_lens:
        if rounds == 1:
            table = replace(table, distance=distance_with_uncertainty(table, NEAR, captures=1)[0])
        table, of_focus = focused(table)
        uncertainty["distance"] = math.hypot(of_focus, error_by_wavefront(table, uncertainty["wavefront"]))
    if not wide:
        registration = registered(table, captures=LAST_GRIDS, start=registration)
    far = 0.35 * math.hypot(*modulator.shape) * modulator.pitch
    by_distance = far * uncertainty.get("distance", 0.0) / (abs(ray_matrix(table.distance)[1]) * camera.pitch)
    registration = _validate.instance("registration", registration, Registration, "a Registration")
    uncertainty["registration"] = math.hypot(registration.uncertainty, by_distance)
    registration = replace(registration, uncertainty=uncertainty["registration"])
    table = replace(table, registration=registration)
    patterns = BEHIND_LENS if behind_lens else PATTERNS
    amplitude, uncertainty["amplitude"] = illumination_with_uncertainty(table, patterns=patterns)
    found = (wavelength, modulator.pitch, table.distance, phases, amplitude, np.asarray(table.wavefront))
    return Calibration(*found, registration, regional, uncertainty, measure_unmodulated_light(table, samples=5))


def _regions_to_measure(regions, modulator: SLMDriver, spread: float, behind_lens: bool) -> tuple[int, int]:
    """Return rows and columns of regions to measure: by default several if the captures show a varying response."""
    varies = spread > SPREAD_OF_RESPONSE
    if regions is None:
        enough = all(n >= SMALLEST_REGION * parts for n, parts in zip(modulator.shape, REGIONS, strict=True))
        regions = REGIONS if varies and enough and not behind_lens else (1, 1)
    regions = _validate.size("regions", regions)
    if regions == (1, 1) and varies:
        warn(
            f"the calibration is uncertain: captures deviate by {spread:.1%} from a response with one phase at "
            "all pixels; where the response varies over the panel, the phases are those near its middle, registration "
            "and distance deviate by some tenths of a pixel and of a percent"
            + ("" if behind_lens else ": use regions=(3, 3)"),
            AccuracyWarning,
        )
    return regions


def _check_orders(table: OpticalTable):
    """Raise an error if the spots of a first registration behind a lens were not found."""
    modulator, camera, wavelength, lens, registration = parts_of(table, "registration")
    if registration.residual > LARGEST_RESIDUAL:
        spacing = 1e3 * wavelength * abs(ray_matrix(lens)[1]) / modulator.pitch
        rows, columns = (1e3 * n * camera.pitch for n in camera.shape)
        raise RuntimeError(
            f"the spots behind the lens lie {registration.residual:.0f} pixels from where one mapping of the "
            f"camera places them: orders are {spacing:.3g} mm apart there and the camera's image is "
            f"{columns:.3g} x {rows:.3g} mm; use a lens of a shorter focal length or a larger camera, and check "
            "the distances of the lens"
        )


def _seen_part(table: OpticalTable, partial: bool) -> "_Middle | None":
    """Return the middle part of a modulator that a camera sees, or None if it sees all; without `partial`, it must."""
    share = np.ones(2)
    # The registration of the part differs by some pixels.
    spare = 0
    while partial and (beyond := beyond_view(table, share) + spare).max() > 0 and share.min() > SMALLEST_SHARE:
        share -= 0.02 * (beyond[::-1] > 0).any(-1)
        spare = 4
    check_view(beyond_view(table, share), table.camera)
    if (share == 1).all():
        return None
    rows, columns = (2 * int(n * part / 2) for n, part in zip(table.modulator.shape, share, strict=True))
    return _Middle(table.modulator, (rows, columns))


def _with_aberration(table: OpticalTable, turn: int) -> tuple[OpticalTable, float]:
    """Return a table with the wavefront and the distance that lenslets and a focus tell, and the wavefront's doubt."""
    if turn == 0:
        found, doubt = wavefront_with_uncertainty(table, iterations=5, captures=1)
    else:
        found, doubt = wavefront_with_uncertainty(table, iterations=2, start=np.asarray(table.wavefront), captures=2)
    if isinstance(table.distance, Lens):
        # An aberration does not change the scale and the shear of spots of which each has the light of all pixels.
        return replace(table, wavefront=without(found, aberration_modes(table.modulator, 1))), doubt
    # The focus of all captures that follows tells the astigmatism, too.
    return _with_distance_and_wavefront(table, found, turn == 0, turn != 1), doubt


def _with_distance_and_wavefront(table: OpticalTable, raw: np.ndarray, first: bool, astigmatic: bool) -> OpticalTable:
    """Return a table with a measured wavefront without tilt and defocus, its distance, and the astigmatism of a focus.

    The quadratic part of the wavefront of the table, which a focus gave, takes the place of the measured one.
    """
    modulator, _, wavelength, distance = parts_of(table)
    quadratic = aberration_modes(modulator, 2)
    found = raw if first else table.wavefront + without(raw - table.wavefront, quadratic)
    # Where the illumination is not symmetric, defocus shifts the sharpest astigmatism.
    if min(modulator.shape) * modulator.pitch < FEWEST * math.sqrt(wavelength * distance):
        distance, _ = distance_with_uncertainty(replace(table, wavefront=found), FAR if first else NEAR, captures=1)
    else:
        distance = _focused(modulator, wavelength, distance, raw)
    low = quadratic[[0, 1, DEFOCUS]]
    table = replace(table, distance=distance, wavefront=without(found, low))
    return replace(table, wavefront=without(astigmatism_by_focus(table), low)) if astigmatic else table


def _focused(modulator: SLMDriver, wavelength: float, distance: float, wavefront: np.ndarray) -> float:
    """Return the distance of which a measured wavefront is the error.

    Lenslets focus straight ahead at any distance, but lenses of the whole modulator at points in proportion to it: what
    a registration by these has in scale more than the other is a defocus of the wavefront.
    """
    y, x = pixel_axes(modulator)
    squares = without(x**2 + y**2, aberration_modes(modulator, 1))
    defocus = float((wavefront * squares).sum() / (squares**2).sum())
    return 1 / (1 / distance + defocus * wavelength / np.pi)


class _Middle:
    """Middle part of a modulator as a modulator of its own; the light of the other pixels is deflected."""

    def __init__(self, modulator: SLMDriver, shape: tuple[int, int]):
        self.modulator, self.shape, self.pitch, self.bits = modulator, shape, modulator.pitch, modulator.bits
        self.settling_time = modulator.settling_time
        self.inside = tuple(
            slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(modulator.shape, shape, strict=True)
        )
        self.levels = (deflected(modulator) > 0) * (1 << modulator.bits - 1)

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
                weights.append(between_regions(part, count)[np.clip(middles, 0, part - 1)])
            regional = np.einsum("ij,kl,jln->ikn", *weights, regional)
        return replace(found, amplitude=amplitude, wavefront=wavefront, regional_phases=regional)


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
    panel = Part(calibration.amplitude.shape, calibration.pitch)
    shown = phases_of_levels(np.asarray(levels, dtype=np.int64), calibration.response)
    light = (np.exp(1j * shown) + calibration.unmodulated) * np.exp(1j * calibration.wavefront)
    there = (calibration.wavelength, calibration.distance, calibration.registration)
    return ideal_capture(panel, np.angle(light), np.abs(light) * calibration.amplitude, *there)
