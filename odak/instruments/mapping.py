"""Mapping between the pixels of a camera and the plane that it images: a homography and radial distortion."""

from dataclasses import dataclass

import numpy as np

from odak import _array, _show
from odak._array import Array, ArrayT

__all__ = ["Registration", "plane_points"]


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


@dataclass(frozen=True)
class Registration:
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
        Uncertainty of the mapping among the spots in pixels: twice the largest standard deviation.

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

    __repr__ = _show.one_line

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
