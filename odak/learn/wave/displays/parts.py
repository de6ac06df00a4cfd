"""Parts of the images of a display: which frames light them, and which device or rank computes them.

Touches a display by what it computes of a part alone.
"""

import copy
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch.utils.checkpoint import checkpoint

from odak.learn.wave.devices import Ranks, shares_of

# Of a part, in fields at the points of its pixels: spectra of twice their size, what is transformed, and slopes.
_FIELDS = 12


@dataclass(frozen=True)
class Part:
    """Part of the images of a display: the frames of one colour on some planes."""

    colour: int
    planes: tuple[int, ...]
    frames: tuple[int, ...]


class Shares:
    """The images of a display in parts, which several devices compute, or the ranks of a group.

    The parts are nearly equal in number of planes, colours and frames. Each device has the transfer functions of its
    own part alone.

    Parameters
    ----------
    display : Display
        The display.
    devices : sequence of torch.device or Ranks
        Who computes.
    """

    def __init__(self, display: Any, devices: Sequence[torch.device] | Ranks):
        self.ranks: Ranks | None = devices if isinstance(devices, Ranks) else None
        self.shape: tuple[int, int, int, int] = display.shape
        where = [display.powers.device] if isinstance(devices, Ranks) else devices
        units = [
            (colour, plane, frame)
            for colour in range(self.shape[1])
            for plane in range(self.shape[0])
            for frame in display.lit_frames[colour]
        ]
        shares = shares_of(units, len(where) if self.ranks is None else self.ranks.size)
        shares = shares if self.ranks is None else [shares[self.ranks.rank]]
        self.parts: list[tuple[Any, list[Part]]] = [
            (copied_to(display, device), _grouped(share))
            for device, share in zip(where, shares, strict=True)
            if share or self.ranks
        ]

    def images(self, observer: Any, lights: tuple[torch.Tensor, ...], powers: torch.Tensor) -> torch.Tensor:
        """Return what an observer sees of what panels do to light, the sum of what each device computes of it."""
        images: list[list[Any]] = [[0.0] * self.shape[1] for _ in range(self.shape[0])]
        if self.ranks is not None:
            *lights, powers = (self.ranks.sharing(values) for values in (*lights, powers))  # type: ignore[assignment]
        for display, parts in self.parts:
            *there, own = (values.to(display.powers.device, non_blocking=True) for values in (*lights, powers))
            # A rank without a part computes one that does not count, since all ranks take part in the gradient.
            for part in parts or [Part(0, (0,), display.lit_frames[0][:1])]:
                shown = display._images_of(part, observer, tuple(there), own).to(powers.device, non_blocking=True)
                for plane, image in zip(part.planes, (shown if parts else 0 * shown).unbind(-3), strict=True):
                    images[plane][part.colour] = images[plane][part.colour] + image
        if self.ranks is None:
            return torch.stack([torch.stack(row, -3) for row in images], -4)
        like = self.parts[0][0]._lit_by_source(lights, 0)[-1].real[..., 0, :, :]
        nothing = like.new_zeros(observer.grids, *like.shape)
        return self.ranks.sum(torch.stack([torch.stack([nothing + one for one in row], -3) for row in images], -4))


class Streamed:
    """The images of a display in parts whose fields fit a memory budget; the backward pass computes each part anew.

    Parameters
    ----------
    display : Display
        The display.
    budget : int
        Bytes that the fields of a part may take. A part is at least one frame on one plane in one colour.
    """

    def __init__(self, display: Any, budget: int):
        self.display: Any = display
        self.budget: int = budget
        planes, colours, rows, columns = display.shape
        points = rows * columns * display.samples**2 * display.powers.dtype.itemsize * 2
        at_once = max(1, budget // (_FIELDS * points))
        self.keeps: bool = 4 * points * planes * colours <= budget
        self.parts: list[Part] = []
        for colour, lit in enumerate(display.lit_frames):
            frames = [lit[i : i + at_once] for i in range(0, len(lit), at_once)]
            many = max(1, at_once // len(lit))
            for i, some in itertools.product(range(0, planes, many), frames):
                self.parts.append(Part(colour, tuple(range(planes))[i : i + many], some))

    def images(self, observer: Any, lights: tuple[torch.Tensor, ...], powers: torch.Tensor) -> torch.Tensor:
        """Return what an observer sees of what panels do to light, the sum of its parts."""
        planes, colours = self.display.shape[:2]
        images: list[list[Any]] = [[0.0] * colours for _ in range(planes)]
        for part in self.parts:
            shown = checkpoint(self._part, part, observer, powers, *lights, use_reentrant=False)
            for plane, image in zip(part.planes, shown.unbind(-3), strict=True):
                images[plane][part.colour] = images[plane][part.colour] + image
        return torch.stack([torch.stack(row, -3) for row in images], -4)

    def _part(self, part: Part, observer, powers, *lights) -> torch.Tensor:
        if not self.keeps:
            self.display.forget()
        return self.display._images_of(part, observer, lights, powers)


class SomeFrames:
    """The images of some frames of a display added to those of all others, which stay as they are.

    Parameters
    ----------
    display : Display
        A display of these frames alone.
    others : torch.Tensor
        What an observer sees of the other frames, ``[grids, D, C, rows, columns]``.
    shares : torch.Tensor
        Share of the power of each colour that these frames have of all, ``[C]``.
    """

    def __init__(self, display: Any, others: torch.Tensor, shares: torch.Tensor):
        self.display: Any = display
        self.others: torch.Tensor = others
        self.shares: torch.Tensor = shares[:, None, None]

    def images(self, observer: Any, lights: tuple[torch.Tensor, ...], powers: torch.Tensor) -> torch.Tensor:
        """Return what an observer sees of all frames, of what panels do to light in these."""
        return self.others + self.shares * self.display._recorded_of(observer, lights, powers)


def with_frames(display: Any, frames: Sequence[int]) -> tuple[Any, torch.Tensor]:
    """Return a display of some frames of another, and their shares of the power of each colour ``[C]``.

    It has the transfer functions of the other, and computes in parts what that computes in parts.
    """
    panel = display.modulator
    if panel.responses():
        panel = replace(panel, response=[panel.responses()[f] for f in frames])
    powers, others = torch.stack([display.powers[f] for f in frames]), {}
    if display.source is not None and (weights := torch.as_tensor(display.source.weights)).ndim > 1:
        others["profile"] = replace(display.source, weights=torch.stack([weights[f] for f in frames]))
    some = display._changed(modulator=panel, frames=len(frames), powers=powers, **others)
    some._kept = display._kept
    if isinstance(display.shares, Streamed):
        some.shares = Streamed(some, display.shares.budget)
    return some, powers.sum(0) / display.powers.sum(0)


def beside(display: Any, others: torch.Tensor, shares: torch.Tensor) -> Any:
    """Return a display of some frames that shows the images of others too; see :class:`SomeFrames`."""
    return _shown_by(display, lambda whole: SomeFrames(display, others, shares))


def streamed(display: Any, budget: int) -> Any:
    """Return a display with its images computed in parts whose fields fit a memory budget."""
    return _shown_by(display, lambda whole: Streamed(whole, budget))


def shared_among(display: Any, devices: Sequence[torch.device] | Ranks) -> Any:
    """Return a display with its images computed in parts by several devices, or by the ranks of a group."""
    return _shown_by(display, lambda whole: Shares(display, devices))


def _shown_by(display: Any, shares: Callable[[Any], Any]) -> Any:
    """Return a copy of a display whose images are made as `shares` of it says."""
    whole = copied_to(display, display.powers.device)
    whole.shares = shares(whole)
    return whole


def copied_to(display: Any, device: torch.device) -> Any:
    """Return a copy of a display on a device, which has transfer functions of its own."""
    modulator = display.modulator
    if isinstance(modulator.response, torch.nn.Module) and device != display.powers.device:
        modulator = replace(modulator, response=copy.deepcopy(modulator.response).to(device))
    return copy.deepcopy(display, {id(display.path): display.path, id(display.modulator): modulator}).to(device)


def frames_lit(powers: torch.Tensor) -> tuple[tuple[int, ...], ...]:
    """Return for each colour the frames in which its source is on, of powers ``[F, C]`` that light each colour."""
    if bool((powers < 0).any()):
        raise ValueError(f"powers must be at least 0, got {float(powers.min())}")
    if not bool((powers.sum(0) > 0).all()):
        raise ValueError(
            f"powers must light each wavelength in a frame, got {powers.sum(0).tolist()} over all {len(powers)} "
            "frames; give more frames, or powers"
        )
    return tuple(tuple(f for f, power in enumerate(row) if power) for row in powers.T.tolist())


def _grouped(units: Sequence[tuple[int, int, int]]) -> list[Part]:
    """Return few parts that are all of some colours, planes and frames, in this order, each plane in one part."""
    planes = [(key, tuple(f for *_, f in own)) for key, own in itertools.groupby(units, lambda unit: unit[:2])]
    alike = itertools.groupby(planes, lambda found: (found[0][0], found[1]))
    return [Part(colour, tuple(plane for (_, plane), _ in own), frames) for (colour, frames), own in alike]
