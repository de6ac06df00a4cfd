"""Points of a pupil that rays are sent through."""

import math

import torch

from odak import _validate
from odak.learn._tensors import checked_device, checked_dtype

PATTERNS = ("rings", "grid", "x", "y", "random")


def pupil_samples(
    pattern: str = "rings",
    count: int = 6,
    *,
    seed: int = 0,
    device: torch.device | str | None = None,
    dtype: torch.dtype = torch.float64,
) -> torch.Tensor:
    """Return points of the unit disc, for rays through a pupil.

    Parameters
    ----------
    pattern : str
        "rings": the centre and `count` rings of 6, 12, 18 … points. "grid": those of a square grid of `count` ×
        `count` that lie in the disc. "x", "y": `count` points along a diameter. "random": `count` random points.
    count : int
        As above.
    seed : int
        Of the random points.
    device, dtype
        Of the result.

    Returns
    -------
    torch.Tensor
        ``[P, 2]``.

    Examples
    --------
    >>> from odak.learn.raytracing.system import pupil_samples
    >>> tuple(pupil_samples("rings", 6).shape), pupil_samples("y", 3).tolist()
    ((127, 2), [[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]])
    """
    pattern = _validate.one_of("pattern", pattern, PATTERNS)
    count, seed = _validate.integer("count", count, minimum=1), _validate.integer("seed", seed)
    dtype, device = checked_dtype("dtype", dtype), checked_device("device", device)
    wide = torch.float64
    if pattern == "rings":
        points = [torch.zeros(1, 2, dtype=wide)]
        for ring in range(1, count + 1):
            angle = torch.arange(6 * ring, dtype=wide) * (2 * math.pi / (6 * ring))
            points.append(torch.stack([angle.cos(), angle.sin()], -1) * (ring / count))
        found = torch.cat(points)
    elif pattern == "grid":
        line = _line(count)
        found = torch.stack(torch.meshgrid(line, line, indexing="xy"), -1).reshape(-1, 2)
        found = found[found.square().sum(-1) <= 1 + 1e-12]
    elif pattern == "random":
        generator = torch.Generator().manual_seed(seed)
        radius, angle = torch.rand(2, count, generator=generator, dtype=wide).unbind()
        found = radius.sqrt()[:, None] * torch.stack([(2 * math.pi * angle).cos(), (2 * math.pi * angle).sin()], -1)
    else:
        line, still = _line(count), torch.zeros(count, dtype=wide)
        found = torch.stack([line, still] if pattern == "x" else [still, line], -1)
    return found.to(device=device, dtype=dtype)


def _line(count: int) -> torch.Tensor:
    return torch.linspace(-1, 1, count, dtype=torch.float64) if count > 1 else torch.zeros(1, dtype=torch.float64)
