"""How a scene is seen: camera, lights and background."""

import math
from collections.abc import Sequence

import numpy as np

from odak import _validate
from odak.visualize.blender.items import LIGHTS, PROJECTIONS, Camera, Light, aim, pair, positive, three
from odak.visualize.blender.materials import linear_color

# Where a camera stands that was not told: in front, to the right and above, with the optical axis (z) in view.
DEFAULT_LOOK = (0.75, 0.4, -0.65)
# What a light that was not told how strong to be adds to a white surface; the default background adds the rest.
LIT = 0.75


class Views:
    """The part of a scene that adds cameras and lights."""

    # What the scene has that this is a part of.
    metres: float
    resolution: tuple[int, int]
    camera: Camera | None
    lights: list[Light]
    objects: list
    background: dict | None

    def add_camera(
        self,
        location: Sequence[float] | None = None,
        target: Sequence[float] | None = None,
        *,
        up: Sequence[float] | None = None,
        fov: float = 40.0,
        projection: str = "perspective",
        width: float | None = None,
        clip: Sequence[float] | None = None,
    ) -> Camera:
        """Set the camera; a second call replaces it.

        Parameters
        ----------
        location : sequence of float, optional
            Where it stands. By default obliquely in front of `target`, far enough away to see all objects.
        target : sequence of float, optional
            What it looks at; by default the middle of all objects.
        up : sequence of float, optional
            Which way is up in the picture; by default y, or z for a look along y.
        fov : float
            Of a perspective camera: full angle across the picture's width, in degrees.
        projection : str
            "perspective" or "orthographic".
        width : float, optional
            Of an orthographic camera: what the picture shows across its width; by default enough for all objects.
        clip : sequence of float, optional
            Nearest and farthest distance that it sees; by default wide enough for all objects.

        Returns
        -------
        Camera
            The camera, which says where points appear (:meth:`Camera.project`) and what it sees (:meth:`Camera.rays`).

        Raises
        ------
        ValueError
            If a number is out of range, or location and target are the same.
        """
        self.camera = self._camera(self.resolution, location, target, up, fov, projection, width, clip)
        return self.camera

    def add_light(
        self,
        location: Sequence[float],
        target: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        kind: str = "point",
        power: float | None = None,
        size: float | None = None,
        color="white",
    ) -> Light:
        """Add a light.

        Parameters
        ----------
        location : sequence of float
            Where it stands. From a sun light comes in this direction, from infinitely far away.
        target : sequence of float
            What it shines at.
        kind : str
            "point", "area" (a square that shines forwards) or "sun".
        power : float, optional
            Watts, of a sun watts per square metre. By default as much as brings a white matt surface at the target that
            faces the light to 3/4 of white; the default background adds the rest.
        size : float, optional
            Diameter of a point, edge of an area; by default a twentieth of its distance from the target.
        color : str or sequence of float
            A name or "#rrggbb" as in web pages, or red, green, blue from 0 to 1.

        Returns
        -------
        Light
            The light.

        Raises
        ------
        ValueError
            If a number is out of range, or location and target are the same.

        Notes
        -----
        A white matt surface under an irradiance of E watts per square metre has the pixel value E/π. A point of power P
        gives E = P/(4πd²) at the distance d, a small area P/(πd²) straight ahead.
        """
        kind = _validate.one_of("kind", kind, LIGHTS)
        location, target = three("location", location), three("target", target)
        axes = aim(location, target)
        distance = math.dist(location, target)
        if power is None:
            irradiance, squared = LIT * math.pi, (distance * self.metres) ** 2
            power = irradiance * {"point": 4 * math.pi * squared, "area": math.pi * squared, "sun": 1.0}[kind]
        size = distance / 20 if size is None else float(_validate.real("size", size))
        if size < 0:
            raise ValueError(f"size must not be negative, got {size}")
        self.lights.append(Light(kind, location, axes, positive("power", power), size, list(linear_color(color))))
        return self.lights[-1]

    def set_background(self, color="white", strength: float = 1.0) -> None:
        """Set what surrounds everything and shines from all sides.

        Parameters
        ----------
        color : str or sequence of float
            As in :meth:`add_light`.
        strength : float
            How bright; 0 is darkness.
        """
        strength = float(_validate.real("strength", strength))
        if strength < 0:
            raise ValueError(f"strength must not be negative, got {strength}")
        self.background = {"color": list(linear_color(color)), "strength": strength}

    def project(self, points, resolution: Sequence[int] | None = None) -> np.ndarray:
        """Return where points appear in the picture, as :meth:`Camera.project` has it.

        Parameters
        ----------
        points : array
            ``[..., 3]``.
        resolution : sequence of int, optional
            Rows and columns of the picture; by default the scene's.
        """
        size = self._resolution(resolution)
        return self._view(size).project(points, size)

    def camera_rays(self, resolution: Sequence[int] | None = None) -> np.ndarray:
        """Return the rays that end in the pixels of the picture, for odak to trace: float64 ``[rows, columns, 2, 3]``.

        Parameters
        ----------
        resolution : sequence of int, optional
            Rows and columns of the picture; by default the scene's.
        """
        size = self._resolution(resolution)
        return self._view(size).rays(size)

    def _view(self, size) -> Camera:
        return self._camera(size) if self.camera is None else self.camera

    def _camera(
        self, size, location=None, target=None, up=None, fov=40.0, projection="perspective", width=None, clip=None
    ) -> Camera:
        projection = _validate.one_of("projection", projection, PROJECTIONS)
        fov = positive("fov", fov)
        if fov >= 180:
            raise ValueError(f"fov must be below 180 degrees, got {fov}")
        points = self._extremes()
        middle = (points.min(0) + points.max(0)) / 2 if len(points) else np.zeros(3)
        target = middle.tolist() if target is None else three("target", target)
        aside = np.add(target, DEFAULT_LOOK).tolist() if location is None else three("location", location)
        axes = aim(aside, target, None if up is None else three("up", up))
        distance, fitting = _fit(points - target, axes, fov, size)
        location = np.add(target, np.multiply(distance, axes[2])).tolist() if location is None else aside
        width = fitting if width is None else positive("width", width)
        return Camera(location, axes, projection, fov, width, None if clip is None else _clip(clip))

    def _resolution(self, resolution) -> tuple[int, int]:
        return self.resolution if resolution is None else _validate.size("resolution", resolution)

    def _extremes(self) -> np.ndarray:
        """Return points between which all objects lie."""
        return np.concatenate([np.zeros((0, 3)), *(item.extremes() for item in self.objects)])

    def _reach(self, camera: Camera) -> list[float]:
        """Return the nearest and the farthest distance that a camera has to see."""
        if camera.clip is not None:
            return camera.clip
        reach = float(np.linalg.norm(self._extremes() - camera.location, axis=-1).max(initial=1e-3))
        return [1e-4 * reach, 2 * reach]

    def _lighting(self, camera: Camera) -> tuple[list[Light], dict]:
        """Return lights and background, those of the default look where nothing was said."""
        lights = list(self.lights)
        if not lights and self.background is None:
            right, up, behind = np.asarray(camera.axes)
            over_the_shoulder = (0.6 * up - 0.5 * right + behind).tolist()
            axes = aim(over_the_shoulder, [0.0, 0.0, 0.0])
            lights = [Light("sun", over_the_shoulder, axes, LIT * math.pi, 0.0, [1.0, 1.0, 1.0])]
        surroundings = {"color": [1.0, 1.0, 1.0], "strength": 1 - LIT} if self.background is None else self.background
        return lights, surroundings


def _fit(points: np.ndarray, axes, fov: float, size) -> tuple[float, float]:
    """Return how far away a perspective camera sees all points, and how wide an orthographic one must be.

    Points are counted from what the camera looks at; both leave a margin of a twentieth.
    """
    rows, columns = size
    seen = points @ np.asarray(axes).T
    half = 1.05 * np.maximum(np.abs(seen[:, 0]), np.abs(seen[:, 1]) * columns / rows)
    distance = (seen[:, 2] + half / math.tan(math.radians(fov) / 2)).max(initial=1e-3 * np.abs(seen).max(initial=0.0))
    return float(distance) or 1.0, 2 * float(half.max(initial=0.0)) or 1.0


def _clip(clip) -> list[float]:
    near, far = (positive("clip", value) for value in pair("clip", clip))
    if near >= far:
        raise ValueError(f"clip must be the nearest and the farthest distance, got {list(clip)}")
    return [near, far]
