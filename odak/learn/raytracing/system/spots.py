"""Where the rays of a field point land: spot diagrams and their size."""

from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.tracing import Traced, trace_fields
from odak.raytracing.geometry import safe_sqrt

REFERENCES = ("centroid", "chief")


class Spots(NamedTuple):
    """A spot diagram.

    Attributes
    ----------
    x, y : torch.Tensor
        Points in the image plane, from the reference point, ``[..., W, F, P]``; NaN where a ray is lost.
    center : torch.Tensor
        Reference points, ``[..., F, 2]``.
    rms, largest : torch.Tensor
        Root mean square and largest distance from the reference point, all wavelengths together, ``[..., F]``.
    status : torch.Tensor
        As in Traced.
    """

    x: torch.Tensor
    y: torch.Tensor
    center: torch.Tensor
    rms: torch.Tensor
    largest: torch.Tensor
    status: torch.Tensor


def spot_diagram(
    system: Any,
    pupil: Any = "rings",
    count: int = 6,
    *,
    reference: str = "centroid",
    prescription: Prescription | None = None,
    **options: Any,
) -> Spots:
    """Return where the rays of each field point land in the image plane.

    Parameters
    ----------
    system, pupil, count
        As in :func:`launch`.
    reference : str
        "centroid": of the spot, all wavelengths together. "chief": the chief ray at the reference wavelength.
    prescription : Prescription, optional
        Numbers in place of the system's own, a batch of systems perhaps.
    **options
        Of :func:`trace_fields`.

    Returns
    -------
    Spots
        Differentiable. Where no ray of a field arrives, its size is NaN. Distances are across the axis: on a tilted or
        strongly curved image surface they are those of its view along the axis.

    Examples
    --------
    >>> from odak.learn.raytracing.system import load_system, spot_diagram
    >>> tuple(spot_diagram(load_system("cooke_triplet")).rms.shape)
    (3,)
    """
    reference = _validate.one_of("reference", reference, REFERENCES)
    traced = trace_fields(system, pupil, count, prescription=prescription, **options)
    x, y, kept = _clean(traced)
    number = kept.sum((-3, -1))
    if reference == "chief":
        chief = trace_fields(
            system,
            torch.zeros(1, 2, dtype=torch.float64),
            prescription=prescription,
            **{**options, "vignetting": False},
        )
        cx, cy = (value[..., system.reference, :, 0].to(x.dtype) for value in (chief.x, chief.y))
    else:
        cx, cy = (value.sum((-3, -1)) / number for value in (x, y))
    around = [torch.where(kept, value - c[..., None, :, None], 0.0) for value, c in ((x, cx), (y, cy))]
    squared = around[0].square() + around[1].square()
    mean = squared.sum((-3, -1)) / number
    # NaN where nothing arrived: 0/0 above, which the root must not hide.
    rms = torch.where(number > 0, safe_sqrt(mean), torch.nan)
    largest = torch.where(number > 0, safe_sqrt(squared.amax((-3, -1))), torch.nan)
    x, y = (torch.where(kept, value, torch.nan) for value in around)
    return Spots(x, y, torch.stack([cx, cy], -1), rms, largest, traced.status)


def rms_spot(system: Any, pupil: Any = "rings", count: int = 6, **options: Any) -> torch.Tensor:
    """Return the root mean square distance of the rays from their centroid, ``[..., F]``, all wavelengths together.

    Parameters
    ----------
    system, pupil, count, **options
        As in :func:`spot_diagram`.
    """
    return spot_diagram(system, pupil, count, **options).rms


def _clean(traced: Traced):
    """Return the points with zeros where rays are lost, and which are not."""
    kept = traced.arrived
    return torch.where(kept, traced.x, 0.0), torch.where(kept, traced.y, 0.0), kept
