"""Optical components of the catalogue: detectors, diffusers, and lenses of makers."""

import difflib
import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from odak import _show, _validate
from odak._array import Array
from odak.catalog.materials import OpticalMaterial, material, refractive_index
from odak.raytracing import arguments
from odak.raytracing.boundary import intersect_w_circle, intersect_w_sphere, intersect_w_surface, refract
from odak.raytracing.geometry import unit
from odak.raytracing.primitives import bring_plane_to_origin, define_circle, define_plane, define_sphere
from odak.tools.transformation import apply_matrix, rotation_matrix

NO_SHIFT = (0.0, 0.0, 0.0)
_DATA = Path(__file__).parent / "data" / "plano_convex_lenses.json"


class SurfaceFigure(Protocol):
    """A figure to which surfaces can be added."""

    @property
    def add_surface(self) -> Callable[..., object]:
        """Function that adds a surface, see :meth:`odak.visualize.plotly.rayshow.add_surface`."""
        ...


class _Sheet(_show.Shown):
    """A rectangle that rays meet, described by its settings."""

    def _hold(self, name: str, shape: Sequence[float], center: Sequence[float], angles: Sequence[float]) -> None:
        self.settings: dict[str, Any] = {
            "name": _validate.text("name", name),
            "center": three("center", center),
            "angles": three("angles", angles),
            "rotation mode": "XYZ",
            "shape": two_positive("shape", shape),
        }
        self.plane: Array = define_plane(self.settings["center"], self.settings["angles"])

    def _met(self, ray: Array) -> tuple[np.ndarray, ...]:
        """Return rays, normals and distances, where they meet the plane, there in its frame, and which of them do."""
        rays = arguments.flat_rays("ray", ray)
        normal, distance = map(np.asarray, intersect_w_surface(rays, self.plane))
        hits = arguments.batch(normal, 2)[:, 0]
        local = within_frame(hits, self.settings["center"], self.settings["angles"])[:, :2]
        return rays, normal, distance, hits, local, is_ahead(rays, hits)

    def _grid(self, count: Sequence[int]) -> np.ndarray:
        settings = self.settings
        return grid_over(count, settings["shape"], settings["center"], settings["angles"])

    def _draw(self, figure: SurfaceFigure, count: Sequence[int], values: np.ndarray) -> None:
        check_figure(figure)
        x, y, z = np.moveaxis(self._grid(count), -1, 0)
        figure.add_surface(data_x=x, data_y=y, data_z=z, surface_color=values, opacity=0.5, contour=False)


class plane_detector(_Sheet):
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
        self._hold(name, shape, center, angles)
        self.settings["resolution"] = list(_validate.size("resolution", resolution))
        size = tuple(self.settings["resolution"])
        field = np.zeros((*size, 1)) if field is None else np.asarray(_validate.array("field", field))
        if field.ndim not in (2, 3) or field.shape[:2] != size or 0 in field.shape:
            raise ValueError(f"field must be {[*size]} or {[*size, 'channels']}, got {field.shape}")
        self.field: np.ndarray = np.array(field if field.ndim == 3 else field[..., None], dtype=np.complex64)

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
            Device of `field`.

        Returns
        -------
        tuple of numpy.ndarray
            Normals and distances of :func:`odak.raytracing.intersect_w_surface`. The field gains amplitude/distance²,
            whatever the length of the ray's direction, in the pixel hit; the lower rim of a pixel belongs to it.
        """
        rays, normal, distance, hits, local, ahead = self._met(ray)
        row, column, inside = self._pixels(local, ahead)
        channels = self._channels(channel)
        if field is None:
            amplitude, channels = np.full((len(hits), 1), 1000.0), np.arange(self.field.shape[-1])
        else:
            amplitude = self._amplitude(field, len(hits), len(channels))
        length = np.linalg.norm(rays[inside, 1], axis=-1)
        gain = amplitude[inside] / (distance[inside] * length)[:, None] ** 2
        np.add.at(self.field, (row[:, None], column[:, None], channels), gain)
        return normal, distance

    def _pixels(self, local, ahead):
        """Return rows and columns of the pixels hit, and which rays hit them."""
        count, shape = (np.asarray(self.settings[key]) for key in ("resolution", "shape"))
        place = np.floor((local + shape / 2) / shape * count)
        inside = ahead & np.all((place >= 0) & (place < count), axis=-1)
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
        told = f"field must be a number, [{rays}] or [{rays}, {channels}] for {rays} rays in ray; got {field.shape}"
        with _validate.refusing(lambda _: told, ValueError):
            return np.broadcast_to(wide, (rays, channels))

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

    def plot_detector(self, figure: SurfaceFigure, channel: int = 0, plot_type: str = "intensity") -> None:
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
        self._draw(figure, self.settings["resolution"], values)

    def plot_field(self, channel: int = 0) -> None:
        """Show one channel of the field in a figure of its own, which is kept as `fig`."""
        from odak.visualize.plotly import detectorshow

        self.fig: detectorshow = detectorshow()
        self.fig.add_field(self.field[..., self._channels(channel)[0]])
        self.fig.show()


class thin_diffuser(_Sheet):
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
        _validate.number("diffusion_angle", diffusion_angle, least=0, below=180, unit="degrees")
        self._hold(name, shape, center, angles)
        self.settings["diffusion angle"] = diffusion_angle
        self.settings["number of diffusion rays"] = list(_validate.size("diffusion_no", diffusion_no))
        self.k: float = 2 * np.pi / 0.05
        self.phase = phase
        if phase is None:
            self.surface_points: np.ndarray = self._grid((100, 100)).reshape(-1, 3)
        radius = np.tan(np.radians(diffusion_angle) / 2)
        self.diffusion_points: np.ndarray = _ring_points(self.settings["number of diffusion rays"], radius)

    def raytrace(self, ray: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scatter rays.

        Parameters
        ----------
        ray : array
            ``[2, 3]`` or ``[m, 2, 3]``.

        Returns
        -------
        new_rays : numpy.ndarray
            ``[m·n, 2, 3]``, the n rays of the first ray first, with directions as long as its own. NaN for a ray that
            misses the diffuser or has it behind.
        normal, distance : numpy.ndarray
            Of :func:`odak.raytracing.intersect_w_surface`.
        """
        rays, normal, distance, hits, local, ahead = self._met(ray)
        inside = ahead & np.all(np.abs(local) <= np.asarray(self.settings["shape"]) / 2, axis=-1)
        towards = self.diffusion_points / np.linalg.norm(self.diffusion_points, axis=-1, keepdims=True)
        length = np.linalg.norm(rays[:, 1], axis=-1, keepdims=True)
        directions = length[:, None] * _rotated(towards, unit(rays[:, 1]))
        new_rays = np.stack(np.broadcast_arrays(hits[:, None], directions), axis=-2)
        new_rays[~inside] = np.nan
        return new_rays.reshape(-1, 2, 3), normal, distance

    def plot_diffuser(self, figure: SurfaceFigure) -> None:
        """Draw the diffuser into a figure that has `add_surface`."""
        self._draw(figure, (10, 10), np.zeros((10, 10)))


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
    # The rotation matrix 1 + [v]× + [v]×²/(1 + z), v = +z × d; opposite to +z any rotation by 180° is valid.
    back = z < -1 + 1e-12
    bend = 1 / np.where(back, 1, 1 + z)
    rows = ((1 - x * x * bend, -x * y * bend, x), (-x * y * bend, 1 - y * y * bend, y), (-x, -y, z))
    matrix = np.moveaxis(np.asarray(rows), -1, 0)
    matrix[back] = np.diag([1.0, -1.0, -1.0])
    return vectors @ np.swapaxes(matrix, -1, -2)


class plano_convex_lens(_show.Shown):
    """A plano-convex lens of a catalogue; lengths in millimetres.

    Parameters
    ----------
    item : str
        "LA1024", "LA1026", "LA1036" or "LA1039".
    location : sequence of float
        Centre of its flat face. In the frame of the lens that face is z = 0, the convex vertex lies at
        z = −thickness, and light normally propagates along +z.
    rotation : sequence of float
        Its rotation in degrees about X, Y, Z.
    wavelength : float
        Millimetres; gives the index of the glass.
    medium : str
        What surrounds the lens: a name of :func:`odak.catalog.material_names`.
    meduium : str
        Earlier, misspelt name of `medium`, kept for older calls.

    Attributes
    ----------
    settings : dict
        The entry of the catalogue.
    type, units, coating, diameter, thickness, radius
        From the entry.
    center : numpy.ndarray
        Centre of the sphere, ``[3]``.
    convex_point : numpy.ndarray
        Vertex of the convex face, ``[3]``.
    plane_center : numpy.ndarray
        Centre of the flat face, ``[3]``.
    convex_surface, plane_surface
        The sphere ``[4]`` and the circle [plane, centre, radius] of the two faces.

    Raises
    ------
    ValueError
        If there is no such lens; the message names those known.

    Examples
    --------
    >>> from odak.catalog import plano_convex_lens
    >>> normal, distance = plano_convex_lens().intersect([[0, 0, -5], [0, 0, 1]])
    >>> normal[0, 0], distance
    (array([ 0.,  0., -1.]), array([4.]))
    """

    medium: str | OpticalMaterial
    meduium: str | OpticalMaterial

    def __init__(
        self,
        item: str = "LA1024",
        location: Sequence[float] = NO_SHIFT,
        rotation: Sequence[float] = NO_SHIFT,
        wavelength: float = 0.000532,
        meduium: str = "air",
        *,
        medium: str | None = None,
    ):
        self.item = item
        self.location: list[float] = three("location", location)
        self.rotation: list[float] = three("rotation", rotation)
        self.wavelength: float = _validate.real("wavelength", wavelength, positive=True)
        meduium = _medium("meduium", meduium)
        self.medium = self.meduium = meduium if medium is None else _medium("medium", medium)
        self.path_to_catalog: str = str(_DATA)
        if item not in _catalogue():
            near = difflib.get_close_matches(str(item), _catalogue(), n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"item must be one of {', '.join(_catalogue())}; got {item!r}.{hint}")
        self.settings: dict[Any, Any] = dict(_catalogue()[item])
        self.set_variables()
        self.define_geometry()

    def set_variables(self) -> None:
        """Set type, units, diameter, thickness, radius and coating from the settings."""
        self.type: str = self.settings["type"]
        self.units: str = self.settings["units"]
        self.diameter: float = self.settings["diameter"]
        self.thickness: float = self.settings["center thickness"]
        self.radius: float = self.settings["radius of curvature"]
        self.coating: str = self.settings["coating"]

    def define_geometry(self) -> None:
        """Set the faces from diameter, thickness, radius, location and rotation."""
        self.center: np.ndarray = place(
            np.asarray([0.0, 0.0, self.radius - self.thickness]), self.location, self.rotation
        )
        self.plane_center: np.ndarray = np.asarray(self.location)
        self.convex_point: np.ndarray = place(np.asarray([0.0, 0.0, -self.thickness]), self.location, self.rotation)
        self.convex_surface: Array = define_sphere(self.center, self.radius)
        self.plane_surface: list[Any] = define_circle(self.plane_center, self.diameter / 2, self.rotation)

    def index(self) -> float:
        """Return the index of the glass relative to the medium, at the lens' wavelength."""
        glass, around = (
            refractive_index(name, self.wavelength, unit="mm", medium="vacuum")
            for name in (self.settings["material"], self.medium)
        )
        return glass / around

    def intersect(self, ray: Array) -> tuple[np.ndarray, np.ndarray]:
        """Intersect rays with the nearer face.

        Parameters
        ----------
        ray : array
            ``[2, 3]`` or ``[m, 2, 3]``.

        Returns
        -------
        tuple of numpy.ndarray
            Normals as rays ``[m, 2, 3]`` (towards the sphere's centre on the convex face), and distances ``[m]``: of
            the nearest hit ahead within the aperture. NaN where there is none.
        """
        rays = arguments.flat_rays("ray", ray)
        hits = (self._flat_face_hits(rays), *self._sphere_intersections(rays))
        distance = np.stack([np.where(np.isnan(d), np.inf, d) for _, d in hits])
        nearest = np.argmin(distance, axis=0)
        each = np.arange(len(rays))
        normal, distance = np.stack([n for n, _ in hits])[nearest, each], distance[nearest, each]
        missed = np.isinf(distance)
        normal[missed], distance[missed] = np.nan, np.nan
        return normal, distance

    def raytrace(self, rays: Array | None = None, n: float | None = None) -> np.ndarray | None:
        """Refract rays through both faces.

        Parameters
        ----------
        rays : array, optional
            ``[2, 3]`` or ``[m, 2, 3]``, starting outside the lens, on either side of it.
        n : float, optional
            Index of the glass relative to the medium; by default :meth:`index`.

        Returns
        -------
        numpy.ndarray or None
            Rays behind the lens, ``[m, 2, 3]``, from where they leave it. NaN for rays that miss a face or are totally
            reflected. None without arguments.
        """
        if rays is None:
            return None
        n = self.index() if n is None else _validate.real("n", n, positive=True)
        rays = arguments.flat_rays("rays", rays)
        first, _ = self.intersect(rays)
        inside = arguments.batch(refract(rays, first, 1.0, n), 2)
        second, _ = self.intersect(inside)
        return arguments.batch(refract(inside, second, n, 1.0), 2)

    def _flat_face_hits(self, rays):
        normal, distance = intersect_w_circle(rays, self.plane_surface)
        missed = (distance == 0) | ~is_ahead(rays, normal[:, 0])
        return normal, np.where(missed | self._starts_at(rays, distance), np.nan, distance)

    def _sphere_intersections(self, rays):
        """Return both intersections with the sphere, NaN distance where one is not on the cap."""
        nearest, reached = _sphere_hits(rays, self.convex_surface)
        onward = np.stack((nearest[:, 0], rays[:, 1]), axis=1)
        last, further = _sphere_hits(onward, self.convex_surface)
        return self._on_cap(rays, nearest, reached), self._on_cap(rays, last, reached + further)

    def _on_cap(self, rays, normal, distance):
        local = within_frame(normal[:, 0], self.location, self.rotation)
        on_cap = (np.hypot(local[:, 0], local[:, 1]) <= self.diameter / 2) & (local[:, 2] <= 0)
        return normal, np.where(on_cap & ~self._starts_at(rays, distance), distance, np.nan)

    def _starts_at(self, rays, distance):
        # The start of a ray on a face is not an intersection with that face.
        return ~(distance > 1e-12 * (self.radius + np.abs(rays[:, 0]).max(axis=-1)))


def _medium(name: str, value):
    if not isinstance(value, OpticalMaterial):
        with _validate.refusing(f"{name} must be one of odak.catalog.material_names(): ", ValueError):
            material(_validate.text(name, value))
    return value


def _sphere_hits(rays, sphere):
    normal, distance = intersect_w_sphere(rays, sphere)
    if normal is False:
        return np.full((len(rays), 2, 3), np.nan), np.full(len(rays), np.nan)
    return arguments.batch(normal, 2), distance


@cache
def _catalogue() -> dict[Any, Any]:
    return json.loads(_DATA.read_text(encoding="utf-8"))


def grid_over(
    count: Sequence[int], shape: Sequence[float], center: Sequence[float], angles: Sequence[float]
) -> np.ndarray:
    """Return ``[count0, count1, 3]`` points over a rectangle, its rim included."""
    x, y = (np.linspace(-size / 2, size / 2, n) for size, n in zip(shape, count, strict=True))
    flat = np.stack((*np.meshgrid(x, y, indexing="ij"), np.zeros(tuple(count))), axis=-1)
    return place(flat, center, angles)


def place(points: np.ndarray, location: Sequence[float], angles: Sequence[float]) -> np.ndarray:
    """Return points of an object's own frame in space: R·p + location."""
    return apply_matrix(rotation_matrix(np.asarray(angles, dtype=np.float64)), points) + np.asarray(location)


def within_frame(points: np.ndarray, location: Any, angles: Any) -> np.ndarray:
    """Return points ``[m, 3]`` in an object's own frame."""
    moved = bring_plane_to_origin(points, None, center=location, angles=angles)
    return arguments.batch(moved, 1)


def is_ahead(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points on the lines of rays ``[m, 2, 3]`` lie ahead of the start; not NaN, not the start itself."""
    return np.sum((points - rays[..., 0, :]) * rays[..., 1, :], axis=-1) > 0


def check_figure(figure: object) -> None:
    """Raise TypeError unless surfaces can be added to a figure."""
    if not callable(getattr(figure, "add_surface", None)):
        raise TypeError(f"figure must have a method add_surface, got {type(figure).__name__}")


def two_positive(name: str, value: Sequence[float]) -> list[Any]:
    """Return a pair of positive numbers as a list."""
    return list(_validate.several(name, value, 2, positive=True))


def three(name: str, value: Sequence[float]) -> list[float]:
    """Return three finite numbers as a list."""
    return [float(number) for number in _validate.several(name, value, 3)]
