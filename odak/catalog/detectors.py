"""Detectors that collect rays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._array import Array
from odak.catalog.placement import NO_SHIFT, check_figure, grid_over, is_ahead, three, two_positive, within_frame
from odak.raytracing import arguments
from odak.raytracing.boundary import intersect_w_surface
from odak.raytracing.primitives import define_plane


class plane_detector:
    """A flat detector of rectangular pixels that adds up the amplitudes of rays.

    Parameters
    ----------
    field : array, optional
        Complex start of the field, ``[n0, n1]`` or ``[n0, n1, channels]``; one channel of zeros by default.
    resolution : sequence of int
        Number of pixels along the detector's own x and y, n0 and n1.
    shape : sequence of float
        Its size along x and y.
    center : sequence of float
        Where its centre is.
    angles : sequence of float
        Its rotation in degrees about X, Y, Z.
    name : str
        For the reader.

    Attributes
    ----------
    settings : dict
        "name", "resolution", "center", "angles", "rotation mode" and "shape".
    plane : numpy.ndarray
        Three points of its plane, see :func:`odak.raytracing.define_plane`.
    field : numpy.ndarray
        Complex64 ``[n0, n1, channels]``.

    Raises
    ------
    ValueError
        If a size is not positive, or the field does not have the detector's resolution.

    Examples
    --------
    >>> import numpy as np
    >>> from odak.catalog import plane_detector
    >>> from odak.raytracing import create_ray_from_two_points
    >>> detector = plane_detector(resolution=[4, 6], shape=[8, 12], center=[0, 0, 10])
    >>> normal, distance = detector.raytrace(create_ray_from_two_points([0, 0, 0], [0.5, 0.5, 10]))
    >>> np.argwhere(detector.get_amplitude())[0], round(float(detector.get_amplitude().max()), 4)
    (array([2, 3, 0]), 9.9502)
    """

    def __init__(
        self,
        field: Array | None = None,
        resolution: Sequence[int] = (1000, 1000),
        shape: Sequence[float] = (10.0, 10.0),
        center: Sequence[float] = NO_SHIFT,
        angles: Sequence[float] = NO_SHIFT,
        name: str = "detector",
    ):
        self.settings = {
            "name": _validate.text("name", name),
            "resolution": list(_validate.size("resolution", resolution)),
            "center": three("center", center),
            "angles": three("angles", angles),
            "rotation mode": "XYZ",
            "shape": two_positive("shape", shape),
        }
        self.plane = define_plane(self.settings["center"], self.settings["angles"])
        size = tuple(self.settings["resolution"])
        field = np.zeros((*size, 1)) if field is None else np.asarray(_validate.array("field", field))
        if field.ndim not in (2, 3) or field.shape[:2] != size or 0 in field.shape:
            raise ValueError(f"field must be {[*size]} or {[*size, 'channels']}, got {field.shape}")
        self.field = np.array(field if field.ndim == 3 else field[..., None], dtype=np.complex64)

    def raytrace(
        self, ray: Array, field: complex | Array | None = None, channel: int | Sequence[int] = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Add rays to the field where they intersect the detector.

        Parameters
        ----------
        ray : array
            ``[2, 3]`` or ``[m, 2, 3]``. Rays that miss the detector, or have it behind them, add nothing.
        field : number or array, optional
            Amplitude of the rays at unit distance: one, ``[m]``, or ``[m, number of channels given]``. By default 1000,
            in all channels.
        channel : int or sequence of int
            Where `field` goes.

        Returns
        -------
        tuple of numpy.ndarray
            Normals and distances of :func:`odak.raytracing.intersect_w_surface`. The field gains amplitude/distance²,
            in the pixel hit; the lower rim of a pixel belongs to it.
        """
        rays = arguments.flat_rays("ray", ray)
        normal, distance = map(np.asarray, intersect_w_surface(rays, self.plane))
        hits = arguments.batch(normal, 2)[:, 0]
        row, column, inside = self._pixels(rays, hits)
        channels = self._channels(channel)
        if field is None:
            amplitude, channels = np.full((len(hits), 1), 1000.0), np.arange(self.field.shape[-1])
        else:
            amplitude = self._amplitude(field, len(hits), len(channels))
        gain = amplitude[inside] / distance[inside, None] ** 2
        np.add.at(self.field, (row[:, None], column[:, None], channels), gain)
        return normal, distance

    def _pixels(self, rays, hits):
        """Return rows and columns of the pixels hit, and which rays hit them."""
        local = within_frame(hits, self.settings["center"], self.settings["angles"])[:, :2]
        count, shape = (np.asarray(self.settings[key]) for key in ("resolution", "shape"))
        place = np.floor((local + shape / 2) / shape * count)
        inside = is_ahead(rays, hits) & np.all((place >= 0) & (place < count), axis=-1)
        row, column = place[inside].astype(int).T
        return row, column, inside

    def _channels(self, channel) -> np.ndarray:
        channels = np.atleast_1d(np.asarray(channel))
        if channels.ndim != 1 or channels.dtype.kind not in "iu":
            raise TypeError(f"channel must be an integer or a sequence of them, got {channel!r}")
        if np.any((channels < 0) | (channels >= self.field.shape[-1])):
            raise ValueError(f"channel must be within 0 … {self.field.shape[-1] - 1}, got {channel!r}")
        return channels

    @staticmethod
    def _amplitude(field, rays: int, channels: int) -> np.ndarray:
        field = np.asarray(_validate.given("field", field))
        wide = field if field.ndim == 2 else field[..., None]
        try:
            return np.broadcast_to(wide, (rays, channels))
        except ValueError:
            raise ValueError(
                f"field must be a number, [{rays}] or [{rays}, {channels}] for {rays} rays in ray; got {field.shape}"
            ) from None

    def clear_detector(self) -> None:
        """Set the field to zero."""
        self.field[...] = 0

    def get_field(self) -> np.ndarray:
        """Return a copy of the field, complex64 ``[n0, n1, channels]``."""
        return self.field.copy()

    def get_intensity(self) -> np.ndarray:
        """Return |field|², ``[n0, n1, channels]``."""
        return np.abs(self.field) ** 2

    def get_amplitude(self) -> np.ndarray:
        """Return |field|, ``[n0, n1, channels]``."""
        return np.abs(self.field)

    def get_phase(self) -> np.ndarray:
        """Return the phase of the field in radians, ``[n0, n1, channels]``."""
        return np.angle(self.field)

    def plot_detector(self, figure: Any, channel: int = 0, plot_type: str = "intensity") -> None:
        """Draw the detector into a figure that has `add_surface`.

        Parameters
        ----------
        figure : object
            Its ``add_surface(data_x=, data_y=, data_z=, surface_color=, opacity=, contour=)`` is called once.
        channel : int
            Which channel gives the colours.
        plot_type : str
            "intensity", "amplitude" or "phase".
        """
        kinds = {"intensity": self.get_intensity, "amplitude": self.get_amplitude, "phase": self.get_phase}
        values = kinds[_validate.one_of("plot_type", plot_type, kinds)]()[..., self._channels(channel)[0]]
        check_figure(figure)
        settings = self.settings
        points = grid_over(settings["resolution"], settings["shape"], settings["center"], settings["angles"])
        x, y, z = np.moveaxis(points, -1, 0)
        figure.add_surface(data_x=x, data_y=y, data_z=z, surface_color=values, opacity=0.5, contour=False)

    def plot_field(self, channel: int = 0) -> None:
        """Show one channel of the field in a figure of its own, which is kept as `fig`."""
        from odak.visualize.plotly import detectorshow

        self.fig = detectorshow()
        self.fig.add_field(self.field[..., self._channels(channel)[0]])
        self.fig.show()
