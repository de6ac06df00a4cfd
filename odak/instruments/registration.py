"""Mapping of a camera to the plane behind a modulator, measured with spots."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.optimize import least_squares

from odak import _validate
from odak._warnings import AccuracyWarning, warn
from odak.instruments.exposures import exposed, set_exposure
from odak.instruments.mapping import Lens, Registration, ray_matrix
from odak.instruments.phase_response import nearest_levels
from odak.instruments.protocols import Camera
from odak.instruments.spots import Part, averaged, brightest, centroid, lenslets, pixel_axes, spots_phase
from odak.instruments.steadiness import watched
from odak.instruments.tables import OpticalTable, parts_of

# Half of the extent of the spots of a registration at most, as a share of the farthest point that a pixel reaches.
SPREAD = 0.6
# Largest error of a mapping among the spots in units of the standard deviation at one of them.
LARGEST = 2.8
# Width of the stripes beside them into which light falls that forms no spots, as a share of what is free.
STRIPE = 0.8
# Displacement of the rays at the edge of an aperture, as a share of its radius, to measure its curvature.
BLUR = 0.4
# Factor by which a spot that is blurred so is darker, about.
BLURRED = 20.0
# Share of the distance from the axis at which a first estimate of the registration has its spots.
NEAR = 0.4
# Steps toward the curvature of the wavefront at most, and the change in radians from peak to valley that ends them:
# about as much is left.
CURVATURES, FLAT = 4, 0.5
# Pixels around the spots of the outermost lenslets, and share of the modulator that is calibrated, at least.
LEAST_MARGIN, SMALLEST_SHARE = 8, 0.3


@_validate.takes_fields("modulator camera wavelength distance phases", table=OpticalTable)
@_validate.takes_units()
def register_camera(
    table: OpticalTable,
    *,
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
    table : OpticalTable
        The table, with phases and the aberration that is corrected; coma and astigmatism that are not shift the spots.
    grid : sequence of int
        Rows and columns of spots.
    extent : float
        Width and height of the grid as a fraction of the modulator's, or behind a lens of the camera image's, at most
        0.8 of what a pixel reaches, λ·distance/pitch.
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
    >>> from odak.instruments import OpticalTable, Registration, SimulatedTable, register_camera
    >>> hidden = SimulatedTable(seed=1, shape=(48, 48), distance=6e-3, camera_shape=(110, 110), aberration=0.05)
    >>> truth, there = hidden.truth, (hidden.modulator, hidden.camera, 532e-9, 6e-3)
    >>> table = OpticalTable(*there, truth.phases, wavefront=truth.wavefront)
    >>> found = register_camera(table, grid=(4, 4))
    >>> exact = Registration(truth.homography, truth.distortion, hidden.camera.shape)
    >>> middle = np.array([[55.0, 55.0]])
    >>> bool(np.linalg.norm(found.plane_points(middle) - exact.plane_points(middle)) < 4e-6)
    True
    """
    return registered(table, grid, extent, middle, captures)


@watched("registration")
def registered(
    table: OpticalTable,
    grid: Sequence[int] = (6, 6),
    extent: float = 0.75,
    middle: bool = False,
    captures: int = 6,
    start: Registration | None = None,
) -> Registration:
    """Return the mapping from the pixels of a camera to points of the image plane.

    The parameters are as in :func:`register_camera`; `start` is a mapping that is correct within some pixels, which
    takes the place of single spots.
    """
    spots = _Spots(table, extent, middle)
    captures = _validate.integer("captures", captures, minimum=1)
    matrix = spots.near_axis() if start is None else spots.matrix_of(start)
    if middle:
        spots.flatten(matrix)
    if start is None:
        # Spots that the aberration had spread are smaller now.
        matrix = spots.far_from_axis(matrix)
    points, seen = spots.grid(_validate.size("grid", grid), captures, matrix)
    found = _fitted(points, seen, matrix, spots.camera)
    # An aberration spreads the spots of a first registration.
    if found.residual > (2.0 if middle else 0.5):
        warn(
            f"the registration of the camera is uncertain: the residual of the fit is {found.residual:.2f} pixels",
            AccuracyWarning,
        )
    return found


class _Spots:
    """Spots that a modulator, or its middle part, forms in the plane of a camera.

    Their matrix ``[3, 2]`` is an affine estimate of the pixels of points, columns first: ``[x, y, 1] @ matrix``.
    """

    def __init__(self, table: OpticalTable, extent: float, middle: bool):
        modulator, camera, wavelength, distance, self.phases = parts_of(table, "phases")
        self.modulator, self.camera, self.wavelength, self.distance = modulator, camera, wavelength, distance
        self.wavefront = table.wavefront
        shape, pitch = np.array(modulator.shape), modulator.pitch
        a, self.b = ray_matrix(distance)
        self.behind_lens = isinstance(distance, Lens)
        seen = np.array(camera.shape) * camera.pitch if self.behind_lens else shape * pitch
        half = seen * float(_validate.number("extent", extent, positive=True)) / 2
        # A pixel does not send light to points that are farther from it than this along an axis, and lenses that focus
        # there have a second focus at twice that distance on the other side.
        farthest = wavelength * abs(self.b) / (2 * pitch)
        half = np.minimum(half, (SPREAD if middle else 0.8) * farthest)
        size = shape
        if middle:
            size = shape // 2 if self.behind_lens else np.minimum(shape, (2 * (farthest - half) / pitch).astype(int))
        self.part = Part((int(size[0]), int(size[1])), pitch)
        self.inside = tuple(slice(n // 2 - m // 2, n // 2 - m // 2 + m) for n, m in zip(shape, size, strict=True))
        # An ellipse has weaker side lobes than a rectangle. Light from beyond it falls into stripes midway
        # between the axis and its orders of diffraction, beside the spots, and is spread along the stripes at random.
        y, x = pixel_axes(modulator)
        ellipse = (size < shape).any()
        self.lit = np.hypot(x / size[1], y / size[0]) * 2 / pitch < 1 if ellipse else np.full(shape, True)
        narrowed = STRIPE * 2 * (farthest - half[1]) / (shape[1] * pitch)
        self.beside = 2 * np.pi / (wavelength * self.b) * (farthest * x - (a - narrowed) * x**2 / 2)
        # Second moments along x and y of an ellipse, or of all pixels.
        self.moments = (size[::-1] * pitch) ** 2 / (16 if ellipse else 12)
        self.half = half[::-1]
        # On the axis behind a lens is the light that is not modulated.
        self.origin = -self.half / 2 if self.behind_lens else np.zeros(2)
        # What is added to the wavefront within the middle part.
        self.curved = np.zeros(modulator.shape)
        self.around = max(8, math.ceil(1.5 * wavelength * abs(self.b) / (size.min() * pitch * camera.pitch)))

    def show(self, points: np.ndarray, seed: int = 0, extra: np.ndarray | float = 0.0) -> None:
        """Show spots at points ``[n, 2]``; `extra` is a phase that is added to their pattern."""
        phase = np.zeros(self.modulator.shape)
        phase[self.inside] = spots_phase(self.part, self.wavelength, self.distance, points, seed=seed)
        others = self.beside + np.random.default_rng(seed).uniform(0, 2 * np.pi, (len(phase), 1))
        phase = np.where(self.lit, phase + extra - self.curved, others) - self.wavefront
        self.modulator.show(nearest_levels(phase, self.phases))

    def places_of(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels of single spots; light that does not move with them cancels."""
        frames = []
        for point in points:
            self.show(point[None])
            frames.append(averaged(self.camera, 1))
        moving = np.stack(frames) - np.roll(frames, 1, axis=0)
        return np.stack([centroid(frame, brightest(frame), self.around) for frame in moving])

    def matrix_of(self, start: Registration) -> np.ndarray:
        """Return the matrix of a known mapping."""
        three = self.origin + np.vstack([np.zeros(2), np.diag(self.half)])
        return _affine(three, start.camera_pixels(three))

    def near_axis(self) -> np.ndarray:
        """Return the matrix of spots near the axis, which tells which of the farther ones the camera sees."""
        self.show(self.origin[None])
        self.bright = set_exposure(self.camera)
        three = self.origin + np.vstack([np.zeros(2), NEAR * np.diag(self.half)])
        pixels = self.places_of(three)
        _check_places(pixels[0], (pixels[1:] - pixels[0]) / (NEAR * self.half[:, None]), self.camera, False)
        return _affine(three, pixels)

    def far_from_axis(self, matrix: np.ndarray) -> np.ndarray:
        """Return the matrix of spots as far from the axis as the camera sees them by the matrix of nearer ones."""
        first, roughly = matrix[2] + self.origin @ matrix[:2], matrix[:2]
        last = np.array(self.camera.shape[::-1]) - 1
        three = np.zeros((3, 2))
        for number, point in enumerate(np.diag(self.half), start=1):
            for share in (1, -1, 0.8, -0.8, 0.6, -0.6, 0.4, -0.4, NEAR):
                three[number] = share * point
                there = first + three[number] @ roughly
                if (there >= self.around).all() and (there <= last - self.around).all():
                    break
        wanted, three = three @ roughly, self.origin + three
        # The last exposure was for blurred spots: where it saturates, a spot and its orders of diffraction are alike.
        self.show(three[0][None])
        self.camera.exposure = self.bright / 2
        set_exposure(self.camera)
        pixels = self.places_of(three)
        missed = np.linalg.norm(pixels - first - wanted, axis=-1)
        too_far = bool((missed > 2 * self.around + 0.3 * np.abs(wanted).max()).any())
        _check_places(first, roughly, self.camera, too_far)
        return _affine(three, pixels)

    def flatten(self, matrix: np.ndarray) -> None:
        """Correct the quadratic part of the wavefront in the middle of the modulator."""
        near = 0.45 * self.half.min() if self.behind_lens else self.half.min()
        width = max(self.part.shape) * self.part.pitch
        blur = min(BLUR, 0.6 * near / width) if self.behind_lens else BLUR
        for _ in range(CURVATURES):
            change = self.curvature(matrix, near, blur)
            self.curved += change
            if np.ptp(change[self.lit]) < FLAT:
                break

    def curvature(self, matrix: np.ndarray, reach: float, blur: float) -> np.ndarray:
        """Return the quadratic part of the wavefront in the middle, from spots on either side of the focus.

        Rays of an aperture whose second moments along the axes are the diagonal S, behind a lens that adds the
        curvature ±c to the curvatures H of the wavefront, form a spot whose matrix of second moments is
        (d/k)²·(H ± c)·S·(H ± c). The difference of the two is 2·(d/k)²·c·(H·S + S·H), also with diffraction.
        """
        y, x = pixel_axes(self.modulator)
        added = blur * 2 * np.pi / self.wavelength / abs(self.b)
        back = np.linalg.inv(matrix[:2])
        difference = np.zeros((2, 2))
        away = (np.moveaxis(np.indices(self.camera.shape)[::-1], 0, -1) - matrix[2]) @ back - self.origin
        near = np.abs(away).max(-1) < reach
        for sign in (1, -1):
            self.show(self.origin[None], extra=sign * added / 2 * (x**2 + y**2))
            frame = exposed(self.camera, "spot", 0.7, 1 / BLURRED)
            difference += sign * back.T @ _second_moments(frame, near) @ back
        scale = (self.wavelength * self.b / (2 * np.pi)) ** 2 * np.add.outer(self.moments, self.moments)
        hessian = -difference / (2 * scale * added)
        # Curvatures larger than the lens has are approached step by step.
        hessian *= min(1.0, added / np.linalg.norm(hessian, 2))
        return -(hessian[0, 0] * x**2 + 2 * hessian[0, 1] * x * y + hessian[1, 1] * y**2) / 2

    def grid(self, counts: tuple[int, int], captures: int, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the points of a grid of spots inside the image of the camera, and their pixels."""
        down, across = counts
        y, x = (np.linspace(-h, h, n) for h, n in ((self.half[1], down), (self.half[0], across)))
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        expected = np.column_stack([points, np.ones(len(points))]) @ matrix
        spacing = np.abs(
            np.linalg.norm(matrix[:2], axis=-1) * 2 * self.half / np.maximum([across - 1, down - 1], 1)
        ).min()
        self.show(points)
        frame = exposed(self.camera, "grid", brighter=1 / len(points))
        for seed in range(1, captures):
            self.show(points, seed)
            frame += averaged(self.camera, 1)
        reach = int(0.4 * spacing)
        inside = ((expected > reach) & (expected < np.array(self.camera.shape[::-1]) - reach - 1)).all(-1)
        if inside.sum() < 6:
            raise RuntimeError(
                f"{inside.sum()} of {len(points)} spots lie inside the image of the camera; at least 6 are needed"
            )
        seen = []
        for place in expected[inside]:
            corner = np.rint(place).astype(int) - reach
            window = frame[corner[1] : corner[1] + 2 * reach + 1, corner[0] : corner[0] + 2 * reach + 1]
            seen.append(centroid(frame, brightest(window) + corner, min(reach, self.around)))
        return points[inside], np.array(seen)


def _affine(points: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Return the matrix of three points ``[3, 2]`` and their pixels."""
    return np.linalg.solve(np.column_stack([points, np.ones(3)]), pixels)


def _fitted(points: np.ndarray, seen: np.ndarray, matrix: np.ndarray, camera: Camera) -> Registration:
    """Return the mapping with which the pixels of spots fit their points best, from an affine estimate of it."""
    pixel = 1 / np.linalg.norm(matrix[0])
    straight = np.linalg.inv(np.vstack([matrix.T, [0, 0, 1]]))
    shift = np.array([[1, 0, camera.shape[1] / 2], [0, 1, camera.shape[0] / 2], [0, 0, 1.0]])
    straight = straight @ shift

    def mapping(parameters: np.ndarray) -> Registration:
        homography = np.append(parameters[:8], 1.0).reshape(3, 3)
        homography[:2] *= pixel
        return Registration(homography, float(parameters[8]), (camera.shape[0], camera.shape[1]))

    def misfit(parameters: np.ndarray) -> np.ndarray:
        return ((mapping(parameters).plane_points(seen) - points) / pixel).ravel()

    begin = np.append((straight / straight[2, 2] / np.array([[pixel], [pixel], [1.0]])).ravel()[:8], 0.0)
    scale = np.array([1, 1, 10, 1, 1, 10, 1e-3, 1e-3, 0.1])
    # Spots that were missed do not enter the fit of the mapping.
    fitted = least_squares(misfit, begin, x_scale=scale, loss="soft_l1", f_scale=0.3)
    found = mapping(fitted.x)
    missed = misfit(fitted.x)
    residual = float(np.sqrt((missed.reshape(-1, 2) ** 2).sum(-1).mean()))
    covariance = np.linalg.pinv(fitted.jac.T @ fitted.jac) * (missed @ missed) / max(missed.size - len(fitted.x), 1)
    variance = np.einsum("ki,ij,kj->k", fitted.jac, covariance, fitted.jac).reshape(-1, 2).sum(-1).max()
    # The largest error among the spots is more than that at any one of them.
    return Registration(found.homography, found.distortion, found.shape, residual, LARGEST * math.sqrt(variance))


def _check_places(axis: np.ndarray, matrix: np.ndarray, camera: Camera, missed: bool) -> None:
    """Raise an error if the places of spots do not fit a camera without a lens: the image may be beside it."""
    scale = np.linalg.norm(matrix, axis=-1) * camera.pitch
    flat = abs(np.linalg.det(matrix)) * camera.pitch**2 < 0.3 * scale.prod()
    if missed or flat or (scale > 3).any() or (scale < 1 / 3).any():
        raise RuntimeError(
            f"no spot was found on the axis of the modulator: the brightest light is at column {axis[0]:.0f}, row "
            f"{axis[1]:.0f} and does not move as the pattern does; the image may lie outside the camera's, of "
            f"{camera.shape[1]} columns and {camera.shape[0]} rows: move the camera until the spot of a lens pattern "
            "lies near its middle"
        )


def beyond_view(table: OpticalTable, share: Sequence[float] | np.ndarray = (1.0, 1.0)) -> np.ndarray:
    """Return how many pixels the spots of the outermost lenslets lie outside the image of a camera; inside: negative.

    The axes are columns and rows, and the sides of each the first and the last ``[2, 2]``. `share` is the used share of
    the modulator's rows and columns.
    """
    modulator, camera, wavelength, distance, registration = parts_of(table, "registration")
    size = np.array(modulator.shape) * np.asarray(share)
    half = (size * (1 - 1 / lenslets(size, wavelength, distance, modulator.pitch)))[::-1] * modulator.pitch / 2
    points = half * np.array(list(itertools.product((-1, 0, 1), repeat=2)))
    axis, seen = registration.camera_pixels(np.zeros(2)), registration.camera_pixels(points)
    # Lenslets focus straight ahead: without a lens the scale is 1, and another one is an error of the distance.
    scale = math.sqrt(abs(np.linalg.det(registration.homography[:2, :2]))) / camera.pitch
    sides = []
    for places in (seen, axis + (seen - axis) * scale):
        last = np.array(camera.shape[::-1]) - 1
        sides.append(np.stack([-places.min(0), places.max(0) - last], axis=-1) + LEAST_MARGIN)
    return np.minimum(*sides)


def check_view(beyond: np.ndarray, camera: Camera) -> None:
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


def _second_moments(frame: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return the matrix of second moments of a spot, columns first, in square pixels, from the pixels near it."""
    smooth = uniform_filter(frame, 5)
    floor = np.quantile(smooth, 0.5)
    light = np.where(near & (smooth - floor > 0.1 * (smooth[near].max() - floor)), frame - floor, 0)
    v, u = np.indices(frame.shape)
    total = light.sum()
    u, v = u - (light * u).sum() / total, v - (light * v).sum() / total
    return np.array([[(light * a * b).sum() for a in (u, v)] for b in (u, v)]) / total
