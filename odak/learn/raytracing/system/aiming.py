"""Rays that meet the real stop where they should."""

import torch

from odak.learn.raytracing.system.tracing import trace
from odak.raytracing.status import RayStatus

ROUNDS = 8


def aimed(system, prescription, properties, points, place, through):
    """Return rays that meet the stop at the points asked for.

    Parameters
    ----------
    system, prescription, properties
        The system, its numbers and its first-order properties.
    points : torch.Tensor
        ``[P, 2]`` in units of the stop's radius.
    place : tuple of torch.Tensor
        Where in the plane of the entrance pupil to start from.
    through : callable
        Returns the rays through a point of that plane.

    Returns
    -------
    Rays
        Rays that are lost on the way to the stop keep their paraxial aim.

    Notes
    -----
    Newton's method per ray, with the 2 × 2 Jacobian by differences along two more rays. Solved without a graph; one
    more step with one carries the gradient, as the implicit function theorem has it.
    """
    numbers = system.prescription([system.wavelengths[system.reference]]) if prescription is None else prescription
    if numbers.index.shape[-2] > 1:
        numbers = numbers._replace(index=numbers.index[..., system.reference : system.reference + 1, :])
    radius = (properties.stop_diameter / 2)[..., None, None, None]
    target = radius * points[:, 0], radius * points[:, 1]
    step = 1e-4 * (properties.entrance_pupil_diameter / 2)[..., None, None, None]

    def missed(px, py):
        hit = trace(system, through(px, py), prescription=numbers, until=system.stop, vignetting=False)
        kept = hit.status == RayStatus.HIT
        return [torch.where(kept, a - b, 0.0) for a, b in zip((hit.x, hit.y), target, strict=True)]

    px, py = torch.broadcast_tensors(*place)
    px, py = (value.expand(through(*place).x.shape) for value in (px, py))
    with torch.no_grad():
        for _ in range(ROUNDS):
            ex, ey = missed(px, py)
            ax, ay = ((a - b) / step for a, b in zip(missed(px + step, py), (ex, ey), strict=True))
            bx, by = ((a - b) / step for a, b in zip(missed(px, py + step), (ex, ey), strict=True))
            determinant = ax * by - bx * ay
            regular = determinant != 0
            inverse = torch.where(regular, 1 / torch.where(regular, determinant, 1.0), 0.0)
            px = px - inverse * (by * ex - bx * ey)
            py = py - inverse * (ax * ey - ay * ex)
    ex, ey = missed(px, py)
    return through(px - inverse * (by * ex - bx * ey), py - inverse * (ax * ey - ay * ex))
