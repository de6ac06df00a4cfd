"""Contents of figures of optical systems, the same for all renderers: surfaces in space, glass, paths of rays."""

from typing import Any, NamedTuple

import numpy as np
import torch

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

    def points(self, i: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return points ``[..., 3]`` of surface `i` at x and y in its own frame, NaN where it is not defined."""
        item, (matrix, origin) = self.items[i], self.frames[i]
        z = np.zeros(np.broadcast_shapes(x.shape, y.shape))
        if item is not None and not is_break(item):
            with torch.no_grad():
                sag = item.shape.sag(*(torch.as_tensor(v + z, device=item.curvature.device) for v in (x, y)))
            z = torch.where(sag.defined, sag.height, torch.nan).cpu().numpy()
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1) @ matrix.T + origin


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
