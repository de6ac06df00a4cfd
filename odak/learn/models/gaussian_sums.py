"""Sums of flat Gaussians at points, with gradients, in memory that grows with neither their product.

Values are computed anew in the backward pass, part by part.
"""

import math

import torch
from torch.autograd.function import once_differentiable

# Points that lie close together, for which far Gaussians are left out.
_RUN = 512
# Larger parts leave the cache of a CPU core; on a GPU they keep it busy.
_PART = {"cpu": 1 << 18, "cuda": 1 << 25}
_CELLS = 1024


def sum_of_soft_gaussians(points: torch.Tensor, rows: torch.Tensor, alphas: torch.Tensor) -> torch.Tensor:
    """Return Σ tanh(α·exp(−u² − v²)) at points, u = A·x + B·y + C and v = D·x + E·y + F.

    Parameters
    ----------
    points : torch.Tensor
        ``[p, 2]``.
    rows : torch.Tensor
        A, B, C, D, E and F of each Gaussian ``[n, 6]``.
    alphas : torch.Tensor
        ``[n]``.

    Returns
    -------
    torch.Tensor
        ``[p]``; differentiable once in all three. Terms below the dtype's rounding error are left out.
    """
    dtype = torch.promote_types(points.dtype, torch.promote_types(rows.dtype, torch.float32))
    with torch.autocast(rows.device.type, enabled=False):
        return _Sum.apply(points.to(dtype), rows.to(dtype), alphas.to(dtype))


class _Sum(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, rows, alphas):
        ctx.save_for_backward(points, rows, alphas)
        result = points.new_zeros(len(points))
        for places, near, (values, v) in _parts(points, rows, alphas, 2):
            _exponentials(points[places], rows[near], values, v)
            total = values.mul_(alphas[near, None]).tanh_().sum(0)
            result.index_add_(0, places, total)
        return result

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        points, rows, alphas = ctx.saved_tensors
        slopes = [torch.zeros_like(tensor) for tensor in (points, rows, alphas)]
        for places, near, (values, u, v) in _parts(points, rows, alphas, 3):
            at, six, alpha = points[places], rows[near], alphas[near, None]
            _exponentials(at, six, values, v, u)
            change = (1 - (alpha * values).tanh_().square_()).mul_(gradient[places]).mul_(values)
            slopes[2].index_add_(0, near, change.sum(1))
            change.mul_(-2 * alpha)
            powers = torch.cat([at, torch.ones_like(at[:, :1])], dim=1).T
            arms = (u.mul_(change), v.mul_(change))
            slopes[1].index_add_(0, near, torch.cat([powers @ arm.T for arm in arms]).T)
            if ctx.needs_input_grad[0]:
                slopes[0].index_add_(0, places, arms[0].T @ six[:, :2] + arms[1].T @ six[:, 3:5])
        return tuple(slopes)


def _exponentials(points, rows, out, v, u=None):
    """Write exp(−u² − v²) ``[n, p]`` to `out`, v to its place and u too if one is given."""
    x, y = points.unbind(-1)
    u = out if u is None else u
    for arm, (along_x, along_y, offset) in ((u, rows[:, :3].T[..., None]), (v, rows[:, 3:].T[..., None])):
        torch.addcmul(offset, along_x, x, out=arm).addcmul_(along_y, y)
    torch.mul(u, u, out=out).neg_().addcmul_(v, v, value=-1)
    # Exponentials that underflow take ten times as long as others.
    out.clamp_(min=math.log(torch.finfo(out.dtype).tiny)).exp_()


def _parts(points, rows, alphas, count):
    """Yield numbers of some points, of the Gaussians near them, and that many arrays ``[Gaussians, points]``."""
    boxes = _boxes(rows, alphas)
    at_once = max(1, _PART.get(points.device.type, _PART["cuda"]) // _RUN)
    memory = points.new_empty(count, at_once * _RUN)
    for places in _compact_runs(points, boxes):
        low, high = points[places].aminmax(dim=0)
        # Asked this way round, NaN is near.
        far = ((boxes[0] > high) | (boxes[1] < low)).any(-1)
        for near in (~far).nonzero()[:, 0].split(at_once):
            if len(near):
                shape = len(near), len(places)
                yield places, near, [part[: shape[0] * shape[1]].view(shape) for part in memory]


def _boxes(rows, alphas):
    """Return the lower and upper corners ``[n, 2]`` of the boxes outside which terms are below rounding error."""
    six, size = rows.double(), alphas.double().abs()
    reach = (size.clamp_min(1).log() - math.log(torch.finfo(rows.dtype).eps)).sqrt()
    inverse = torch.linalg.inv_ex(torch.stack([six[:, :2], six[:, 3:5]], dim=1)).inverse
    centre = -(inverse @ six[:, [2, 5], None])[..., 0]
    half = inverse.square().sum(-1).sqrt() * reach[:, None]
    return centre - half, centre + half


def _compact_runs(points, boxes):
    """Return numbers of points in runs, along a Z-shaped curve unless most Gaussians reach all over the points."""
    numbers = torch.arange(len(points), device=points.device)
    if len(points) <= _RUN:
        return (numbers,) if len(points) else ()
    low, high = points.double().aminmax(dim=0)
    width = (high - low).clamp_min(torch.finfo(torch.float64).tiny)
    covered = (torch.minimum(boxes[1], high) - torch.maximum(boxes[0], low)).clamp_min(0) / width
    if bool(covered.prod(-1).mean() < 0.5):
        cells = ((points - low) / width.max() * (_CELLS - 1)).nan_to_num(0.0).long()
        numbers = torch.argsort(_spread(cells[:, 0]) | (_spread(cells[:, 1]) << 1))
    return numbers.split(_RUN)


def _spread(number):
    """Return whole numbers below 2¹⁶ with a zero between each two of their bits (Morton 1966)."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        number = (number | (number << shift)) & mask
    return number
