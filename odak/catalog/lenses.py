"""Lenses from makers' catalogues."""

import difflib
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from odak import _validate
from odak._array import Array
from odak.catalog.dispersion import Material
from odak.catalog.materials import material, refractive_index
from odak.catalog.placement import NO_SHIFT, is_ahead, place, three, within_frame
from odak.raytracing import arguments
from odak.raytracing.boundary import intersect_w_circle, intersect_w_sphere, refract
from odak.raytracing.primitives import define_circle, define_sphere

_DATA = Path(__file__).parent / "data" / "plano_convex_lenses.json"


class plano_convex_lens:
    """A plano-convex lens of a catalogue; lengths in millimetres.

    Parameters
    ----------
    item : str
        "LA1024", "LA1026", "LA1036" or "LA1039".
    location : sequence of float
        Where the centre of its flat face is. In the lens' own frame that face is z = 0, the convex vertex stands at
        z = −thickness, and light normally comes along +z.
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
        self.location = three("location", location)
        self.rotation = three("rotation", rotation)
        self.wavelength = _validate.real("wavelength", wavelength, positive=True)
        meduium = _medium("meduium", meduium)
        self.medium = self.meduium = meduium if medium is None else _medium("medium", medium)
        self.path_to_catalog = str(_DATA)
        if item not in _catalogue():
            near = difflib.get_close_matches(str(item), _catalogue(), n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"item must be one of {', '.join(_catalogue())}; got {item!r}.{hint}")
        self.settings = dict(_catalogue()[item])
        self.set_variables()
        self.define_geometry()

    def set_variables(self) -> None:
        """Set type, units, diameter, thickness, radius and coating from the settings."""
        self.type = self.settings["type"]
        self.units = self.settings["units"]
        self.diameter = self.settings["diameter"]
        self.thickness = self.settings["center thickness"]
        self.radius = self.settings["radius of curvature"]
        self.coating = self.settings["coating"]

    def define_geometry(self) -> None:
        """Set the faces from diameter, thickness, radius, location and rotation."""
        self.center = place(np.asarray([0.0, 0.0, self.radius - self.thickness]), self.location, self.rotation)
        self.plane_center = np.asarray(self.location)
        self.convex_point = place(np.asarray([0.0, 0.0, -self.thickness]), self.location, self.rotation)
        self.convex_surface = define_sphere(self.center, self.radius)
        self.plane_surface = define_circle(self.plane_center, self.diameter / 2, self.rotation)

    def index(self) -> float:
        """Return the index of the glass over that of the medium, at the lens' wavelength."""
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
            Index of the glass over that of the medium; by default :meth:`index`.

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
    if not isinstance(value, Material):
        try:
            material(_validate.text(name, value))
        except ValueError as error:
            raise ValueError(f"{name} must be one of odak.catalog.material_names(): {error}") from None
    return value


def _sphere_hits(rays, sphere):
    normal, distance = intersect_w_sphere(rays, sphere)
    if normal is False:
        return np.full((len(rays), 2, 3), np.nan), np.full(len(rays), np.nan)
    return arguments.batch(normal, 2), distance


@cache
def _catalogue() -> dict:
    return json.loads(_DATA.read_text(encoding="utf-8"))
