"""Cubic B-splines on equal intervals, and Gaussians in space."""

import math

import numpy as np

from odak import _array
from odak.tools.transformation import apply_matrix, rotation_matrix


def bspline_factor(count: int, samples: int) -> np.ndarray:
    """Return the values of cubic B-splines along one axis.

    Parameters
    ----------
    count : int
        Number of splines, their centres equally far apart from 0 to 1; a single one is constant.
    samples : int
        Number of samples from 0 to 1.

    Returns
    -------
    numpy.ndarray
        float64 ``[count, samples]``. The sum over the splines is 1 but within one interval of the ends, where it falls
        to 5/6: no splines have their centres outside.

    Notes
    -----
    de Boor, A Practical Guide to Splines (2001), chapter IX: 2/3 − u² + |u|³/2 for |u| ≤ 1, (2 − |u|)³/6 for |u| ≤ 2.
    """
    if count == 1:
        return np.ones((1, samples))
    place = np.linspace(0, 1, samples) * (count - 1)
    u = np.abs(place - np.arange(count)[:, None])
    return np.where(u <= 1, 2 / 3 - u**2 + u**3 / 2, np.maximum(2 - u, 0) ** 3 / 6)


def gaussians(points, centers, scales, angles, opacity):
    """Return the densities of Gaussians, turned about their centres, at points: ``[n, m]``, any array library.

    Parameters
    ----------
    points : array
        ``[n, 3]``.
    centers, scales, angles : array
        ``[m, 3]``; angles in degrees about X, Y and Z, by which the points are turned.
    opacity : array
        ``[m]``.
    """
    xp = _array.namespace(points)
    arm = apply_matrix(rotation_matrix(angles), points[:, None, :] - centers) / scales
    norm = opacity / ((2 * math.pi) ** 1.5 * xp.prod(scales, axis=-1))
    return norm * xp.exp(-xp.sum(arm**2, axis=-1) / 2)
