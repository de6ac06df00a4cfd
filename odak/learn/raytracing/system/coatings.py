"""Design of coatings: thin films are inserted where they help most, and all thicknesses refined."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch

from odak import _show, _validate
from odak._array import namespace
from odak._torch_private import differentiates
from odak.catalog.materials import MICROMETRES, OpticalMaterial
from odak.jones.thin_films import stack_response
from odak.learn._tensors import takes_constants
from odak.learn.raytracing.system.optimise import LADDER, least_squares
from odak.learn.raytracing.system.surfaces import Coating, _coating_medium, _index

# Places in each film at which needles are tried, needles that are refined side by side, steps before one is chosen and
# after that.
PLACES, TRIED, BEFORE, AFTER = 9, 8, 15, 60
# Share of the mean wavelength below which a film is left out, and share of the merit that a needle must gain.
THINNEST, GAIN = 1e-3, 1e-3
# Mean wavelengths by which one refinement may thicken a film: reflectances are periodic in thicknesses.
WIDEST = 0.25


@_show.shown
class CoatingDesign(NamedTuple):
    """Result of a design of a coating.

    Attributes
    ----------
    coating : Coating
        The films, their thicknesses as a float64 tensor.
    merit : float
        Root mean square of |r| − √R₀, the modulus of the coefficient of reflection less the square root of the target
        R₀. Of a target 0 its square is the mean reflectance.
    history : tuple of pair of int and float
        Number of films and merit of the start, and after each needle that was kept.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Coating, needle_design
    >>> design = needle_design(Coating([2.1], [60e-6]), [1.38, 2.1], ("air", 1.52), [550e-6])
    >>> len(design.coating.media), design.merit < 1e-6
    (2, True)
    """

    coating: Coating
    merit: float
    history: tuple[tuple[int, float], ...]


class _Aim(NamedTuple):
    """What a stack should do: lengths in mean wavelengths, indices ``[W]``, sines and cosines ``[A, 1]``.

    The target is ``[P, A, W]``; P is 1 where s and p are the same.
    """

    wave: torch.Tensor
    front: torch.Tensor
    media: torch.Tensor
    behind: torch.Tensor
    sine: torch.Tensor
    cosine: torch.Tensor
    target: torch.Tensor

    def off(self, films: torch.Tensor, thicknesses: torch.Tensor) -> torch.Tensor:
        """Return what coefficients of reflection are off their targets; squared moduli sum to the mean.

        Parameters
        ----------
        films : torch.Tensor
            Numbers of the media, ``[..., V]``.
        thicknesses : torch.Tensor
            ``[P, ..., A, W, V]`` or what broadcasts to it.

        Returns
        -------
        torch.Tensor
            Complex ``[P, ..., A, W]``.
        """
        count = films.shape[-1]
        stack = [self.media[films[..., k]][..., None, :] for k in range(count)]
        found = []
        for state, part in zip("sp", thicknesses.expand(len(self.target), *thicknesses.shape[1:]), strict=False):
            sheets = [part[..., k] for k in range(count)]
            indices = [self.front, *stack, self.behind]
            xp = namespace(self.wave)
            response = stack_response(xp, self.wave, indices, sheets, self.front * self.sine, self.cosine, state)
            found.append(response.r)
        r = torch.stack(found)
        root = self.target.sqrt().reshape(len(r), *(1,) * (r.ndim - 3), *self.target.shape[1:])
        # Squares sum to the squares of |r| − √target. Without the phase, derivatives would vanish where nothing is
        # reflected.
        return (r - root * torch.sgn(r)) / self.target.numel() ** 0.5


@_validate.takes_units()
@takes_constants("media", "between", "wavelengths", "target", "angles")
@differentiates
def needle_design(
    start: Coating,
    media: Sequence[str | complex | OpticalMaterial],
    between: Sequence[str | complex | OpticalMaterial],
    wavelengths: float | Sequence[float] | torch.Tensor,
    target: float | Sequence[float] | torch.Tensor = 0.0,
    angles: float | Sequence[float] | torch.Tensor = 0.0,
    films: int = 20,
    unit: str = "mm",
) -> CoatingDesign:
    """Design a coating by needles: insert thin films where the merit falls most, refine all thicknesses, repeat.

    Use it for antireflection coatings, beam splitters, filters and mirrors of two or more media, without knowing how
    many films they need.

    Parameters
    ----------
    start : Coating
        One film or more in the order in which light passes them, without a substrate. The thicker it is, the more films
        come of it.
    media : sequence
        Media of which films are inserted: names of the catalogue, Materials, or indices, complex for absorbing films.
    between : pair
        Medium that light comes from, which must not absorb, and substrate, a metal's complex index too.
    wavelengths : sequence of float or torch.Tensor
        In vacuum, ``[W]``.
    target : float, sequence or torch.Tensor
        Wanted reflectance, that which broadcasts to ``[2, A, W]`` of s and p polarisation.
    angles : float, sequence or torch.Tensor
        Angles of incidence in degrees, in the medium that light comes from, ``[A]``.
    films : int
        Largest number of films.
    unit : str
        Unit of wavelengths and thicknesses.

    Returns
    -------
    CoatingDesign
        The coating, the root mean square of |r| − √target, and how they came about.

    Raises
    ------
    ValueError, TypeError
        If an argument is of another form or outside its range, naming it.

    Notes
    -----
    A. V. Tikhonravov, M. K. Trubetskov and G. W. DeBell, Appl. Opt. 35, 5493 (1996). The derivative of the merit by the
    thickness of a film that is not there yet, the function P(z, n), is exact, as it is taken with films of thickness 0.
    Eight places and media where it is most negative are refined side by side by Levenberg and Marquardt's method, and
    the best remains. Films below a thousandth of the mean wavelength are left out. The design ends when P is nowhere
    negative, when a needle gains less than a thousandth of the merit, or at the largest number of films. It is a local
    optimum, which depends on the start.

    Examples
    --------
    Broadband antireflection coating of the visible from one film of 150 nm, to a mean of 0.1 %:

    >>> import torch
    >>> from odak.learn.raytracing.system import Coating, needle_design
    >>> waves = torch.linspace(420e-6, 680e-6, 27, dtype=torch.float64)
    >>> design = needle_design(Coating([2.1], [150e-6]), [1.38, 2.1], ("air", 1.52), waves, films=4)
    >>> len(design.coating.media), design.merit**2 < 0.0015
    (4, True)
    """
    _validate.instance("start", start, Coating, "a Coating")
    if not start.media or start.substrate is not None:
        raise ValueError("start must have at least one film and no substrate, which is the second of between")
    if isinstance(media, (str, bytes)) or not isinstance(media, Iterable) or not len(list(media)):
        raise ValueError(f"media must be a sequence of at least one name, OpticalMaterial or index, got {media!r:.80}")
    if isinstance(between, (str, bytes)) or not isinstance(between, Sequence) or len(between) != 2:
        raise ValueError(f"between must be a pair of media, that light comes from and substrate, got {between!r:.80}")
    _validate.integer("films", films, minimum=len(start.media))
    waves, tilts = _numbers("wavelengths", wavelengths), torch.deg2rad(_numbers("angles", angles))[:, None]
    _validate.real("wavelengths", waves, positive=True)
    if bool((tilts < 0).any()) or bool((tilts >= torch.pi / 2).any()):
        raise ValueError(f"angles must be at least 0 and below 90 degrees, got {angles!r:.80}")
    unit = _validate.one_of("unit", unit, MICROMETRES)
    held = [_medium(f"media[{i}]", value) for i, value in enumerate(media)]
    ends = [_medium(f"between[{i}]", value) for i, value in enumerate(between)]
    if isinstance(ends[0], complex):
        raise ValueError(f"between[0], from which light comes, must not absorb, got {ends[0]}")
    pool = held + [value for value in start.media if value not in held]
    shape = (2, len(tilts), len(waves))
    wanted = _doubles("target", target)
    try:
        wanted = wanted.broadcast_to(shape)
    except RuntimeError as error:
        raise ValueError(f"target must broadcast to {shape} of s and p, got {tuple(wanted.shape)}") from error
    if bool(((wanted < 0) | (wanted > 1)).any()):
        raise ValueError("target must be between 0 and 1")
    if not bool(tilts.any()) and bool((wanted[0] == wanted[1]).all()):
        wanted = wanted[:1]
    scale = waves.mean()
    indices = [
        torch.as_tensor(_index(value, waves, unit), dtype=torch.complex128, device=waves.device)
        for value in (*pool, *ends)
    ]
    indices = [value.expand(len(waves)) for value in indices]
    aim = _Aim(
        waves / scale,
        indices[-2].real,
        torch.stack(indices[:-2]),
        indices[-1],
        tilts.sin(),
        tilts.cos(),
        wanted,
    )
    order = torch.tensor([pool.index(value) for value in start.media], device=waves.device)
    thick = torch.stack([_doubles("thicknesses", value) for value in start.thicknesses]).to(waves) / scale
    merit = float(aim.off(order, thick[None, None, None]).abs().square().sum().sqrt())
    history = [(len(order), merit)]
    while len(order) < films and merit > 1e-12 and (needles := _needles(aim, order, thick, len(held))):
        tried = [_with_needle(order, thick, *needle) for needle in needles]
        orders, thicks = (torch.stack([stack[i] for stack in tried]) for i in (0, 1))
        media_found, sizes, _ = _refined(aim, orders, thicks, BEFORE)
        media_found, sizes, better = _refined(aim, media_found[None], sizes[None], AFTER)
        if len(media_found) > films or better >= (1 - GAIN) * merit:
            break
        order, thick, merit = media_found, sizes, better
        history.append((len(order), merit))
    thick = (thick * scale).to(wavelengths.device if isinstance(wavelengths, torch.Tensor) else thick.device)
    return CoatingDesign(Coating([pool[i] for i in order], thick), merit, tuple(history))


def _medium(name: str, value):
    try:
        return _coating_medium(name, value)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _numbers(name: str, values) -> torch.Tensor:
    found = _doubles(name, values)
    if found.ndim > 1 or not found.numel():
        raise ValueError(f"{name} must be a number or a sequence of at least one, got shape {tuple(found.shape)}")
    return found.reshape(-1)


def _doubles(name: str, values) -> torch.Tensor:
    # Python's numbers are not rounded to torch's default precision first.
    _validate.real(name, values)
    return torch.as_tensor(values, dtype=torch.float64).detach().cpu()


def _refined(
    aim: _Aim, order: torch.Tensor, thick: torch.Tensor, steps: int
) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Return the best of N stacks ``[N, V]`` after refinement, without films that have vanished, and its merit."""
    while True:

        def linearised(x, order=order):
            # Each reflectance has its own copy of the thicknesses: one backward pass gives all rows of the Jacobian.
            copies = (
                x[None, :, None, None].expand(len(aim.target), -1, *aim.target.shape[1:], -1).clone().requires_grad_()
            )
            with torch.enable_grad():
                off = torch.view_as_real(aim.off(order, copies)).unbind(-1)
                slopes = [torch.autograd.grad(part.sum(), copies, retain_graph=True)[0] for part in off]
            rows = [torch.cat([v.detach().movedim(0, 1).flatten(1, 3) for v in both], 1) for both in (off, slopes)]
            return tuple(rows)

        def losses(x, order=order):
            with torch.no_grad():
                return aim.off(order[:, None], x[None, :, :, None, None]).abs().square().sum((0, -2, -1)) / 2

        found = least_squares(
            linearised,
            losses,
            thick,
            lower=0 * thick[0],
            upper=thick.amax(0) + WIDEST,
            iterations=steps,
            tolerance=1e-6,
            ladder=LADDER,
        )
        best = int(found.loss.argmin())
        merit = float((2 * found.loss[best]) ** 0.5)
        kept_order, kept = _cleaned(order[best], found.x[best])
        if len(kept) == order.shape[1]:
            return kept_order, kept, merit
        order, thick = kept_order[None], kept[None]


def _cleaned(order: torch.Tensor, thick: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a stack without films that have vanished, and with neighbours of one medium joined."""
    media: list[int] = []
    sizes: list[torch.Tensor] = []
    for medium, size in zip(order.tolist(), thick, strict=True):
        if size < THINNEST:
            continue
        if media and media[-1] == medium:
            sizes[-1] = sizes[-1] + size
        else:
            media.append(medium)
            sizes.append(size)
    if not media:
        return order[:1], thick[:1]
    return torch.tensor(media), torch.stack(sizes)


def _needles(aim: _Aim, order: torch.Tensor, thick: torch.Tensor, count: int) -> list[tuple[int, float, int]]:
    """Return film, place within it and medium of the needles of the most negative derivatives, at most one of each."""
    places = torch.linspace(0, 1, PLACES, dtype=torch.float64).tolist()
    media: list[int] = []
    sizes: list[torch.Tensor] = []
    entries: list[tuple[int, int, float, int]] = []
    for film, (own, size) in enumerate(zip(order.tolist(), thick, strict=True)):
        for place in places:
            if place:
                media.append(own)
                sizes.append(size / (PLACES - 1))
            for medium in (m for m in range(count) if m != own):
                entries.append((len(media), film, place, medium))
                media.append(medium)
                sizes.append(0 * size)
    sheets = torch.stack(sizes).requires_grad_()
    with torch.enable_grad():
        merit = aim.off(torch.tensor(media), sheets[None, None, None]).abs().square().sum() / 2
        (slopes,) = torch.autograd.grad(merit, sheets)
    best: dict[tuple[int, int], tuple[float, float]] = {}
    for row, film, place, medium in entries:
        slope = float(slopes[row])
        if slope < best.get((film, medium), (0.0, 0.0))[0]:
            best[film, medium] = slope, place
    ranked = sorted(best, key=lambda key: best[key][0])[:TRIED]
    return [(film, best[film, medium][1], medium) for film, medium in ranked]


def _with_needle(order: torch.Tensor, thick: torch.Tensor, film: int, place: float, medium: int) -> tuple[Any, ...]:
    """Return a stack with a film of thickness 0 inside another."""
    own, size = order[film : film + 1], thick[film : film + 1]
    media = torch.cat((order[:film], own, own.new_tensor([medium]), own, order[film + 1 :]))
    return media, torch.cat((thick[:film], place * size, 0 * size, (1 - place) * size, thick[film + 1 :]))
