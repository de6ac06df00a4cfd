"""Diffusers that scatter each ray into a cone of rays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.catalog.placement import NO_SHIFT, check_figure, grid_over, is_ahead, three, two_positive, within_frame
from odak.raytracing import arguments
from odak.raytracing.boundary import intersect_w_surface
from odak.raytracing.primitives import define_plane


class thin_diffuser:
    """A flat diffuser: each ray leaves it as a cone of rays about its onward direction.

    Parameters
    ----------
    phase : array, optional
        Not used; kept for older calls. With it no `surface_points` are made.
    shape : sequence of float
        Size along the diffuser's own x and y.
    center : sequence of float
        Where its centre is.
    angles : sequence of float
        Its rotation in degrees about X, Y, Z.
    diffusion_angle : float
        Full angle of the cone in degrees, below 180.
    diffusion_no : sequence of int
        Rings, and rays on a ring at the full angle; ring i of n has i/n of the radius and of the rays, so that the
        first has none.
    name : str
        For the reader.

    Attributes
    ----------
    settings : dict
        "name", "center", "angles", "rotation mode", "shape", "diffusion angle", "number of diffusion rays".
    plane : numpy.ndarray
        Three points of its plane.
    diffusion_points : numpy.ndarray
        ``[n, 3]``: where the n rays cross the plane z = 1 when the incoming one runs along z.
    surface_points : numpy.ndarray
        ``[10000, 3]``: a grid over the diffuser.
    k : float
        2π/0.05.

    Examples
    --------
    >>> from odak.catalog import thin_diffuser
    >>> thin_diffuser(diffusion_no=[5, 2], diffusion_angle=10.0).diffusion_points.round(5) + 0
    array([[0.05249, 0.     , 1.     ],
           [0.06999, 0.     , 1.     ]])
    """

    def __init__(
        self,
        phase: Array | None = None,
        shape: Sequence[float] = (10.0, 10.0),
        center: Sequence[float] = NO_SHIFT,
        angles: Sequence[float] = NO_SHIFT,
        diffusion_angle: float = 5.0,
        diffusion_no: Sequence[int] = (3, 3),
        name: str = "diffuser",
    ):
        _validate.real("diffusion_angle", diffusion_angle)
        if not 0 <= diffusion_angle < 180:
            raise ValueError(f"diffusion_angle must be within 0 … 180 degrees, 180 not included; got {diffusion_angle}")
        self.settings: dict[str, Any] = {
            "name": _validate.text("name", name),
            "center": three("center", center),
            "angles": three("angles", angles),
            "rotation mode": "XYZ",
            "shape": two_positive("shape", shape),
            "diffusion angle": diffusion_angle,
            "number of diffusion rays": list(_validate.size("diffusion_no", diffusion_no)),
        }
        self.plane = define_plane(self.settings["center"], self.settings["angles"])
        self.k = 2 * np.pi / 0.05
        self.phase = phase
        if phase is None:
            self.surface_points = self._grid(100).reshape(-1, 3)
        radius = np.tan(np.radians(diffusion_angle) / 2)
        self.diffusion_points = _ring_points(self.settings["number of diffusion rays"], radius)

    def raytrace(self, ray: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scatter rays.

        Parameters
        ----------
        ray : array
            ``[2, 3]`` or ``[m, 2, 3]``.

        Returns
        -------
        new_rays : numpy.ndarray
            ``[m·n, 2, 3]``, the n rays of the first ray first. NaN for a ray that misses the diffuser or has it behind.
        normal, distance : numpy.ndarray
            Of :func:`odak.raytracing.intersect_w_surface`.
        """
        rays = arguments.flat_rays("ray", ray)
        normal, distance = map(np.asarray, intersect_w_surface(rays, self.plane))
        hits = arguments.batch(normal, 2)[:, 0]
        local = within_frame(hits, self.settings["center"], self.settings["angles"])[:, :2]
        inside = is_ahead(rays, hits) & np.all(np.abs(local) <= np.asarray(self.settings["shape"]) / 2, axis=-1)
        towards = self.diffusion_points / np.linalg.norm(self.diffusion_points, axis=-1, keepdims=True)
        directions = _rotated(towards, rays[:, 1])
        new_rays = np.stack(np.broadcast_arrays(hits[:, None], directions), axis=-2)
        new_rays[~inside] = np.nan
        return new_rays.reshape(-1, 2, 3), normal, distance

    def plot_diffuser(self, figure: Any) -> None:
        """Draw the diffuser into a figure that has `add_surface`."""
        check_figure(figure)
        x, y, z = np.moveaxis(self._grid(10), -1, 0)
        figure.add_surface(data_x=x, data_y=y, data_z=z, surface_color=np.zeros(x.shape), opacity=0.5, contour=False)

    def _grid(self, count: int) -> np.ndarray:
        settings = self.settings
        return grid_over((count, count), settings["shape"], settings["center"], settings["angles"])


def _ring_points(number: Sequence[int], radius: float) -> np.ndarray:
    """Return points on rings at z = 1: ring i of n at i/n of the radius, with that share of the points."""
    rings, points = number
    found = []
    for ring in range(1, rings):
        share = points * ring / rings
        angle = 2 * np.pi * np.arange(int(share)) / share
        found.append(ring / rings * radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1))
    flat = np.concatenate(found) if found else np.zeros((0, 2))
    return np.concatenate((flat, np.ones((len(flat), 1))), axis=-1)


def _rotated(vectors: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return ``[m, n, 3]``: n vectors about +z, each turned by the shortest way that takes +z to the m directions."""
    x, y, z = directions.T
    # The rotation matrix 1 + [v]× + [v]×²/(1 + z), v = +z × d; opposite to +z any half turn will do.
    back = z < -1 + 1e-12
    bend = 1 / np.where(back, 1, 1 + z)
    rows = ((1 - x * x * bend, -x * y * bend, x), (-x * y * bend, 1 - y * y * bend, y), (-x, -y, z))
    matrix = np.moveaxis(np.asarray(rows), -1, 0)
    matrix[back] = np.diag([1.0, -1.0, -1.0])
    return vectors @ np.swapaxes(matrix, -1, -2)
