"""Light path between a modulator and a camera, and mapping between the camera's pixels and the plane that it images."""

from dataclasses import dataclass, replace

import numpy as np

from odak import _array, _show, _validate
from odak._array import Array, ArrayT


@_validate.takes_units("focal_length", "before", "after", "block")
@dataclass(frozen=True)
class Lens:
    """Thin lens between a modulator and a camera, which takes the place of the distance between them.

    At its back focal plane, where a camera is by default, the light of a pattern of phases is its Fourier transform:
    every pixel sends light to all places, whatever `before` is, and light that is not modulated forms the zero order on
    the axis.

    Attributes
    ----------
    focal_length : float
        Focal length in metres.
    before : float, optional
        From the modulator to the lens in metres; by default the focal length.
    after : float, optional
        From the lens to the camera in metres; by default the focal length.
    block : float
        Radius in metres of a disc on the axis in the plane of the camera, or in one that a relay images onto it, which
        blocks the zero order; 0, the default, for none.

    Raises
    ------
    ValueError
        If the focal length is not positive, a length is negative, or the camera sees an image of the modulator.

    Examples
    --------
    >>> from odak.instruments import Lens
    >>> Lens("200mm").ray_matrix
    (0.0, 0.2)
    """

    focal_length: float
    before: float | None = None
    after: float | None = None
    block: float = 0.0

    def __post_init__(self) -> None:
        focal = float(_validate.number("focal_length", self.focal_length, positive=True))
        object.__setattr__(self, "focal_length", focal)
        for name in ("before", "after", "block"):
            value = getattr(self, name)
            value = focal if value is None else float(_validate.number(name, value, least=0))
            object.__setattr__(self, name, value)
        if abs(self.ray_matrix[1]) < 1e-3 * focal:
            raise ValueError(
                f"before and after must not image the modulator onto the camera, got {self.before:g} and "
                f"{self.after:g} m for a focal length of {focal:g} m"
            )

    @property
    def ray_matrix(self) -> tuple[float, float]:
        """The place x of a ray on the camera is A·x + B·angle of the ray at the modulator."""
        before, after = float(self.before or 0.0), float(self.after or 0.0)
        return 1 - after / self.focal_length, before + after * (1 - before / self.focal_length)

    def moved(self, position: float) -> "Lens":
        """Return the path to a camera that is farther from the lens by a position of a stage in metres."""
        return replace(self, after=float(self.after or 0.0) + position)


def ray_matrix(path: float | Lens) -> tuple[float, float]:
    """Return A and B of a light path: x and the angle at the modulator give A·x + B·angle on the camera."""
    if isinstance(path, Lens):
        return path.ray_matrix
    return 1.0, _validate.constant("distance", path, positive=True)


def plane_points(pixels: ArrayT, shape: tuple[int, int], homography: Array, distortion: Array | float) -> ArrayT:
    """Return the points of a plane that are imaged onto camera pixels.

    Parameters
    ----------
    pixels : array
        Columns and rows ``[..., 2]``.
    shape : tuple of int
        Rows and columns of the camera.
    homography : array
        ``[3, 3]``, from undistorted pixels (column, row), counted from the middle of the sensor, to metres (x, y).
    distortion : array or float
        Radial distortion: undistorted = distorted·(1 + distortion·r²), r in half diagonals of the sensor.

    Returns
    -------
    array
        x and y in metres ``[..., 2]``.
    """
    xp = _array.namespace(pixels)
    rows, columns = shape
    x, y = pixels[..., 0] - columns / 2, pixels[..., 1] - rows / 2
    stretch = 1 + distortion * (x**2 + y**2) / ((rows**2 + columns**2) / 4)
    x, y = x * stretch, y * stretch
    along, across, depth = (homography[i, 0] * x + homography[i, 1] * y + homography[i, 2] for i in range(3))
    return xp.stack([along / depth, across / depth], axis=-1)


@dataclass(frozen=True, repr=False)
class Registration(_show.Shown):
    """Mapping from pixels of the camera to the plane in which the modulator forms its image.

    Attributes
    ----------
    homography : numpy.ndarray
        ``[3, 3]``, from undistorted pixels (column, row), counted from the middle of the sensor, to metres (x, y).
    distortion : float
        Radial distortion: undistorted = distorted·(1 + distortion·r²), r in half diagonals of the sensor.
    shape : tuple of int
        Rows and columns of the camera.
    residual : float
        Root mean square distance of the measured spots from the mapping, in pixels.
    uncertainty : float
        Uncertainty of the mapping among the spots in pixels, one standard deviation of its largest error.

    Examples
    --------
    A camera that is aligned and centred images the axis onto its middle pixel:

    >>> import numpy as np
    >>> from odak.instruments import Registration
    >>> registration = Registration(np.diag([4e-6, 4e-6, 1.0]), 0.0, (480, 640))
    >>> points = registration.plane_points(np.asarray([[320.0, 240.0], [330.0, 240.0]]))
    >>> [round(float(value) * 1e6, 3) for value in points[1] - points[0]]
    [40.0, 0.0]
    """

    homography: np.ndarray
    distortion: float
    shape: tuple[int, int]
    residual: float = 0.0
    uncertainty: float = 0.0

    def plane_points(self, pixels: np.ndarray) -> np.ndarray:
        """Return the points x, y in metres ``[..., 2]`` that are imaged onto pixels (column, row) ``[..., 2]``."""
        return plane_points(np.asarray(pixels, float), self.shape, self.homography, self.distortion)

    def camera_pixels(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (column, row) ``[..., 2]`` onto which points x, y in metres ``[..., 2]`` are imaged."""
        points = np.asarray(points, float)
        back = np.linalg.inv(self.homography)
        found = points @ back[:, :2].T + back[:, 2]
        straight = found[..., :2] / found[..., 2:]
        rows, columns = self.shape
        bent = straight
        for _ in range(20):
            squared = (bent**2).sum(-1, keepdims=True) / ((rows**2 + columns**2) / 4)
            bent = straight / (1 + self.distortion * squared)
        return bent + np.array([columns / 2, rows / 2])
