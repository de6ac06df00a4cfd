"""Rays that meet the real stop where they should."""

import torch

from odak.learn.raytracing.system.tracing import trace
from odak.raytracing.status import RayStatus

ROUNDS = 8
# Newton's method ends with steps this small beside that along which it takes differences; one more follows.
CLOSE = 1e-6


def aimed(system, prescription, pupil, points, place, through):
    """Return where in the entrance pupil rays are to start so that they meet the stop at the points asked for.

    Parameters
    ----------
    system, prescription, pupil
        The system, its numbers and its entrance pupil.
    points : torch.Tensor
        ``[..., P, 2]`` in units of the stop's radius.
    place : tuple of torch.Tensor
        Where in the entrance pupil to begin the search, as `reach` has it.
    through : callable
        Returns the rays through such a place.

    Returns
    -------
    tuple of torch.Tensor
        Places, for `through`. Rays that are lost on the way to the stop keep their paraxial aim.
    """
    radius = pupil.stop_radius[..., None, None, None]
    target = radius * points[..., 0], radius * points[..., 1]

    def missed(px, py):
        x, y, kept = at_stop(system, prescription, through(px, py))
        return [torch.where(kept, a - b, 0.0) for a, b in zip((x, y), target, strict=True)]

    px, py = torch.broadcast_tensors(*place)
    px, py = (value.expand(through(*place).x.shape) for value in (px, py))
    return solve_pairs(missed, px, py, 1e-4 * pupil.reach[..., None, None, None])


def at_stop(system, prescription, rays):
    """Return where rays meet the stop at the reference wavelength, and whether they do."""
    numbers = system.prescription([system.wavelengths[system.reference]]) if prescription is None else prescription
    if numbers.index.shape[-2] > 1:
        numbers = numbers._replace(index=numbers.index[..., system.reference : system.reference + 1, :])
    hit = trace(system, rays, prescription=numbers, until=system.stop, vignetting=False)
    return hit.x, hit.y, hit.status == RayStatus.HIT.value


def solve_pairs(missed, x, y, step):
    """Return the pairs (x, y) at which a pair of functions vanishes.

    Parameters
    ----------
    missed : callable
        Takes x and y, returns what both functions are there.
    x, y : torch.Tensor
        Where to begin.
    step : torch.Tensor
        Along which to take differences.

    Notes
    -----
    Newton's method for each pair, with a 2 × 2 Jacobian by differences. Solved without a graph; one more step with one,
    whose Jacobian is by central differences, carries the gradient, as the implicit function theorem has it.
    """
    with torch.no_grad():
        for _ in range(ROUNDS):
            here = missed(x, y)
            change = _newton(here, _slopes(missed, x, y, step, here))
            x, y = x - change[0], y - change[1]
            if x.device.type == "cpu" and bool((torch.maximum(*(v.abs() for v in change)) <= CLOSE * step.abs()).all()):
                break
        slopes = _slopes(missed, x, y, step)
    change = _newton(missed(x, y), slopes)
    return x - change[0], y - change[1]


def _slopes(missed, x, y, step, here=None):
    """Return the derivatives by x and by y, by central differences unless the values themselves are at hand."""
    found = []
    for ahead, behind in (((x + step, y), (x - step, y)), ((x, y + step), (x, y - step))):
        before, width = (missed(*behind), 2 * step) if here is None else (here, step)
        found.append([(a - b) / width for a, b in zip(missed(*ahead), before, strict=True)])
    return found


def _newton(here, slopes):
    """Return Newton's step, 0 where the Jacobian is singular."""
    (ax, ay), (bx, by) = slopes
    determinant = ax * by - bx * ay
    regular = determinant != 0
    inverse = torch.where(regular, 1 / torch.where(regular, determinant, 1.0), 0.0)
    ex, ey = here
    return inverse * (by * ex - bx * ey), inverse * (ax * ey - ay * ex)
