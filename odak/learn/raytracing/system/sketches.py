"""Contents of figures of optical systems, the same for all renderers: surfaces in space, glass, paths of rays."""

from typing import Any, NamedTuple

import numpy as np
import torch

from odak.learn.raytracing.system.specification import plain
from odak.learn.raytracing.system.surfaces import drawn_radii, is_break, is_glass, optical_system
from odak.learn.raytracing.system.tracing import ray_paths


class SystemScene(NamedTuple):
    """Surfaces of a system, the image last, and rays through them, in global coordinates.

    Attributes
    ----------
    items : list of surface or None
        The surfaces; an image without a shape is None. The lens that an afocal system appends stands in for its image.
    frames : list of tuple
        The rotation ``[3, 3]`` and the origin ``[3]`` of each.
    radii : list of float
        How far from its vertex each is drawn.
    paths : numpy.ndarray
        Points of the rays at the reference wavelength, ``[fields, rays, stations, 3]``: the start, each surface, the
        image; NaN from where a ray is lost.
    """

    items: list[Any]
    frames: list[tuple[np.ndarray, np.ndarray]]
    radii: list[float]
    paths: np.ndarray

    def elements(self) -> list[tuple[int, int]]:
        """Return the numbers of the surfaces in front of each piece of glass and behind it."""
        found = []
        for i in (i for i in range(len(self.items) - 1) if is_glass(self.items, i)):
            behind = next(j for j in range(i + 1, len(self.items)) if not is_break(self.items[j]))
            # Glass that reaches to the image has no face there.
            if behind < len(self.items) - 1:
                found.append((i, behind))
        return found

    def points(self, i: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points of surface `i` at x and y in its own frame, NaN where it is not defined, and normals.

        Both are ``[..., 3]``; the normals have unit length and point towards +z of its frame.
        """
        item, (matrix, origin) = self.items[i], self.frames[i]
        x, y = np.broadcast_arrays(x, y)
        z, normals = np.zeros(x.shape), np.broadcast_to([0.0, 0.0, 1.0], (*x.shape, 3))
        if item is not None and not is_break(item):
            with torch.no_grad():
                sag = item.shape.sag(*(torch.as_tensor(v + z, device=item.curvature.device) for v in (x, y)))
            z = torch.where(sag.defined, sag.height, torch.nan).cpu().numpy()
            slopes = [np.broadcast_to(value.cpu().numpy(), x.shape) for value in (sag.slope_x, sag.slope_y)]
            normals = np.stack([-slopes[0], -slopes[1], np.ones(x.shape)], axis=-1)
        normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
        return np.stack([x, y, z], axis=-1) @ matrix.T + origin, normals @ matrix.T

    def sheet(self, i: int, rings: int, angles: int) -> tuple[np.ndarray, np.ndarray]:
        """Return points and normals of a surface from its vertex to its rim, each ``[rings + 1, angles + 1, 3]``.

        The rim is where the surface is drawn to, or where it ceases to exist; the last column is the first again.
        """
        around = np.linspace(0, 2 * np.pi, angles + 1)
        x, y = np.linspace(0, 1, rings + 1)[:, None] * np.stack([np.cos(around), np.sin(around)])[:, None]
        rim = self.radii[i]
        while np.isnan((found := self.points(i, rim * x, rim * y))[0]).any() and rim > 0:
            rim *= 0.98
        return found


@torch.no_grad()
def system_scene(system: optical_system, rays: Any, lead: float = 0.25) -> SystemScene:
    """Return what a figure of a system shows.

    Parameters
    ----------
    system : optical_system
        The system.
    rays : Rays
        From :func:`launch`.
    lead : float
        Rays from far away begin so far in front of the first vertex, as a fraction of the extent of the system.
    """
    paths = ray_paths(system, rays)[system.reference].cpu().numpy()
    frames = [tuple(part.cpu().numpy() for part in pair) for pair in zip(*system.frames(), strict=True)]
    items = [*system.surfaces, system.image]
    if system.afocal:
        items, frames, paths = [*system.surfaces[:-1], None], frames[:-1], paths[..., :-1, :]
    met = paths[..., 1:, :].reshape(-1, 3)
    extent = float(np.ptp(np.nan_to_num(met), axis=0).max()) or 1.0
    if system.at_infinity or system.object_distance > extent:
        start, along = paths[..., 0, :], torch.stack([value[0] for value in rays[3:6]], -1).cpu().numpy()
        paths[..., 0, :] = start - along * ((start[..., 2:] + lead * extent) / along[..., 2:])
    reaches = []
    for i, (matrix, origin) in enumerate(frames):
        local = (paths[..., i + 1, :] - origin) @ matrix
        reaches.append(float(np.nanmax(np.hypot(local[..., 0], local[..., 1]), initial=0.0)))
    radii = drawn_radii(items[:-1], reaches[:-1]) + drawn_radii(items[-1:], reaches[-1:])
    return SystemScene(items, frames, radii, paths)


def field_label(system: optical_system, i: int) -> str:
    """Return a field point as it is written in figures."""
    x, y = plain(system.fields[i])
    unit = "°" if system.at_infinity else f" {unit_of(system)}"
    # Two decimals, of small numbers two digits.
    x, y = (f"{value:.2g}" if 0 < abs(value) < 0.1 else f"{round(value, 2):g}" for value in (x, y))
    return f"{y}{unit}" if x == "0" else f"({x}, {y}){unit}"


def unit_of(system: optical_system) -> str:
    """Return the unit of the system's lengths."""
    return system.unit.replace("um", "µm")
