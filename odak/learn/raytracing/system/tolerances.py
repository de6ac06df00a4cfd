"""What becomes of a lens that is not made as drawn: Monte Carlo over a batch of systems in one call."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _validate
from odak.learn.raytracing.system.lens import checked_system
from odak.learn.raytracing.system.prescription import Prescription
from odak.learn.raytracing.system.spots import rms_spot

NAMES = ("curvature", "radius", "conic", "thickness", "index", "shift", "tilt")
DISTRIBUTIONS = ("normal", "uniform")


class Perturbation(NamedTuple):
    """How far a number may be off.

    Attributes
    ----------
    name : str
        "curvature", "radius", "conic", "thickness", "index" (of what is behind the surface), "shift" or "tilt" (in
        degrees; both of x and y alike).
    surfaces : int or sequence of int
        Of which surfaces, each drawn on its own.
    size : float
        Standard deviation, or half the width of a uniform distribution; in the unit of the number.
    relative : bool
        Whether `size` is a share of the number itself.
    distribution : str
        "normal" or "uniform".
    together : bool
        Draw once for all the surfaces: a lens that is shifted as a whole.
    """

    name: str
    surfaces: int | Sequence[int]
    size: float
    relative: bool = False
    distribution: str = "normal"
    together: bool = False


class ToleranceResult(NamedTuple):
    """A Monte Carlo run.

    Attributes
    ----------
    merit : torch.Tensor
        What `merit` returned for each system, ``[samples, …]``.
    nominal : torch.Tensor
        The same for the system as drawn.
    prescription : Prescription
        The perturbed numbers, ``[samples, …]``.
    """

    merit: torch.Tensor
    nominal: torch.Tensor
    prescription: Prescription


def tolerance(
    system: Any,
    perturbations: Sequence[Perturbation],
    samples: int = 200,
    seed: int = 0,
    *,
    merit: Callable | None = None,
) -> ToleranceResult:
    """Trace many systems whose numbers are off at random, in one batch.

    Parameters
    ----------
    system : optical_system
        The system.
    perturbations : sequence of Perturbation
        What may be off, and how far.
    samples : int
        Number of systems.
    seed : int
        Of the random numbers: the same seed gives the same systems.
    merit : callable, optional
        ``merit(system, prescription=…)``, returns ``[samples, …]``; :func:`rms_spot` by default.

    Returns
    -------
    ToleranceResult
        Its merits are differentiable in the system's parameters if these are.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Perturbation, load_system, tolerance
    >>> off = [Perturbation("radius", [0, 1], 1e-3, relative=True), Perturbation("tilt", 2, 0.02)]
    >>> tuple(tolerance(load_system("cooke_triplet"), off, samples=10).merit.shape)
    (10, 3)
    """
    samples = _validate.integer("samples", samples, minimum=1)
    nominal = checked_system(system).prescription()
    merit = rms_spot if merit is None else _validate.function("merit", merit)
    numbers = perturbed(system, nominal, perturbations, samples, seed)
    return ToleranceResult(merit(system, prescription=numbers), merit(system, prescription=nominal), numbers)


def perturbed(system, nominal: Prescription, perturbations, samples: int, seed: int) -> Prescription:
    """Return a batch of prescriptions with random numbers added."""
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    perturbations = list(perturbations) if isinstance(perturbations, Iterable) else [perturbations]
    if not all(isinstance(item, Perturbation) for item in perturbations):
        raise TypeError(f"perturbations must be a sequence of Perturbation, got {perturbations!r:.80}")
    count = len(system.surfaces)
    values = nominal._asdict()
    for name in ("shift", "tilt"):
        if values[name] is None:
            values[name] = torch.zeros(count, 2, dtype=torch.float64, device=nominal.thickness.device)
    values = {name: value.expand(samples, *value.shape) for name, value in values.items()}
    for item in perturbations:
        name = _validate.one_of("name of a perturbation", item.name, NAMES)
        places = list(item.surfaces) if isinstance(item.surfaces, Iterable) else [item.surfaces]
        places = [_validate.place_in("surfaces of a perturbation", place, count) for place in places]
        drawn = _draw(item, samples, len(places), 2 if name in ("shift", "tilt") else 1, generator)
        target = "curvature" if name == "radius" else name
        change = torch.zeros(samples, count, drawn.shape[-1], dtype=torch.float64)
        for column, place in enumerate(places):
            change[:, place] += drawn[:, column]
        values[target] = _changed(name, values[target], change.to(values[target].device), item.relative)
    # Without tilts the fused kernel does the work.
    for name in ("shift", "tilt"):
        if not bool(values[name].any()):
            values[name] = None
    return Prescription(**values)


def _draw(item: Perturbation, samples: int, places: int, axes: int, generator) -> torch.Tensor:
    kind = _validate.one_of("distribution", item.distribution, DISTRIBUTIONS)
    _validate.real("size of a perturbation", item.size)
    shape = (samples, 1 if item.together else places, axes)
    if kind == "normal":
        drawn = torch.randn(shape, generator=generator, dtype=torch.float64)
    else:
        drawn = 2 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1
    return (item.size * drawn).expand(samples, places, axes)


def _changed(name: str, value, change, relative: bool):
    """Return the numbers with the change added, in the way of each."""
    if name in ("shift", "tilt"):
        return value + (value * change if relative else change)
    change = change[..., 0]
    if name == "radius":
        # c/(1 + cδ) for a radius off by δ: a plane stays one.
        return value / (1 + (change if relative else value * change))
    if name == "index":
        # The first index belongs to the space in front.
        change = torch.nn.functional.pad(change, (1, 0))[:, None, :]
    return value + (value * change if relative else change)
