"""Numbers of optical systems as tensors, which are traced, differentiated and optimised."""

import math
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
import torch

from odak import _show, _validate
from odak.learn.raytracing.system.sequence import Numbers
from odak.raytracing.surfaces import EvenAsphere, Shape


@_show.shown
class Prescription(NamedTuple):
    """Numbers of a batch of systems, float64; leading axes ``[...]`` are systems, S counts surfaces, W wavelengths.

    Attributes
    ----------
    curvature, conic, thickness : torch.Tensor
        ``[..., S]``.
    coefficients : torch.Tensor
        ``[..., S, K]`` of r², r⁴, …
    index : torch.Tensor
        ``[..., W, S + 1]``: before the first surface, and behind each.
    shift, tilt : torch.Tensor or None
        ``[..., S, 2]``, or ``[..., S, 3]`` for tilts with a rotation about z; None where no surface has any. Tilts in
        degrees.
    shapes : tuple or None
        For each surface its shape if the numbers above do not describe it, its parameters ``[..., …]``, else None.
    phases : tuple or None
        For each surface its phase or None.
    wavelengths : torch.Tensor or None
        Vacuum wavelengths ``[W]``, which phases need.
    gradients : tuple or None
        For each surface the graded index behind it or None.

    Examples
    --------
    >>> from odak.learn.raytracing.system import Prescription, load_system
    >>> lens = load_system("cooke_triplet")
    >>> tuple(lens.prescription().curvature.shape) == (len(lens.surfaces),)
    True
    """

    curvature: torch.Tensor
    conic: torch.Tensor
    thickness: torch.Tensor
    coefficients: torch.Tensor
    index: torch.Tensor  # type: ignore[assignment]  # hides tuple.index
    shift: torch.Tensor | None = None
    tilt: torch.Tensor | None = None
    shapes: tuple[Any, ...] | None = None
    phases: tuple[Any, ...] | None = None
    wavelengths: torch.Tensor | None = None
    gradients: tuple[Any, ...] | None = None

    def _repr_html_(self) -> str:
        return _show.page(self, Prescription._view)

    def _view(self) -> _show.View:
        """Return what notebooks show of it: a row for each surface of the first system of a batch."""
        count, batch = self.thickness.shape[-1], self.batch.numel()

        def of(name: str) -> list[float]:
            values = getattr(self, name).detach()
            return values.expand(*self.batch, count).reshape(-1, count)[0].tolist() if batch else []

        with torch.no_grad():
            index = self.index.expand(*self.batch, *self.index.shape[-2:]).reshape(-1, *self.index.shape[-2:])[0].cpu()
        waves = range(len(index)) if self.wavelengths is None else self.wavelengths.tolist()
        table: list[Any] = [("surface", "radius", "conic constant", "thickness", *(f"index at {w:.6g}" for w in waves))]
        for i, (bend, conic, length) in enumerate(zip(of("curvature"), of("conic"), of("thickness"), strict=True)):
            kind = type(self.shapes[i]).__name__ if self.shapes is not None and self.shapes[i] is not None else None
            table.append((str(i), kind or (1 / bend if bend else "∞"), conic, length, *index[:, i + 1].tolist()))
        of_batch = f", the first of {batch}" if batch != 1 else ""
        return _show.View(f"Prescription in the unit of its lens: {count} surfaces{of_batch}", (), table)

    @property
    def batch(self) -> torch.Size:
        """Leading axes of the batch."""
        shapes = (
            self.curvature.shape[:-1],
            self.conic.shape[:-1],
            self.thickness.shape[:-1],
            self.coefficients.shape[:-2],
            self.index.shape[:-2],
            *(value.shape[:-2] for value in (self.shift, self.tilt) if value is not None),
            *(value.shape[: value.ndim - rank] for value, rank in self.others()),
        )
        return torch.Size(np.broadcast_shapes(*shapes))

    def others(self, image: torch.nn.Module | None = None) -> list[tuple[torch.Tensor, int]]:
        """Return the parameters of shapes, phases and index gradients, each with its own number of axes.

        Parameters
        ----------
        image : surface, optional
            Image surface, whose shape is appended to the shapes of the surfaces.
        """
        groups = [list(group or [None] * self.thickness.shape[-1]) for group in self._groups()]
        if image is not None:
            groups[0].append(image.shape if image.own_shape is not None else None)
        like, found = self.thickness, []
        for parts in zip_longest(*groups):
            for held in parts:
                if held is not None:
                    pairs = zip(held.parameters(), held.ranks_of_parameters(), strict=True)
                    found += [(torch.as_tensor(v, dtype=torch.float64, device=like.device), r) for v, r in pairs]
        return found

    def _groups(self) -> tuple[Any, ...]:
        return self.shapes, self.phases, self.gradients

    def shape(self, i: int) -> Shape:
        """Return the shape of a surface, with parameters ``[..., …]``.

        Parameters
        ----------
        i : int
            Index of the surface.
        """
        if self.shapes is not None and self.shapes[i] is not None:
            return self.shapes[i]
        return EvenAsphere(self.curvature[..., i], self.conic[..., i], self.coefficients[..., i, :])

    def at(self, place: int) -> "Prescription":
        """Return the prescription at one of its wavelengths; with a single wavelength, the prescription itself.

        Parameters
        ----------
        place : int
            Index of the wavelength.
        """
        if self.index.shape[-2] == 1:
            return self
        waves = None if self.wavelengths is None else self.wavelengths[place : place + 1]
        place = place % self.index.shape[-2]
        return self._replace(index=self.index[..., place : place + 1, :], wavelengths=waves)

    def select(self, place: int) -> "Prescription":
        """Return one system of a batch with one leading axis.

        Parameters
        ----------
        place : int
            Index along the leading axis.
        """
        count = self.batch[0]

        def one(value, own: int):
            tail = value.shape[value.ndim - own :]
            return value.expand(count, *tail)[place] if value.ndim > own else value

        axes = (1, 1, 1, 2, 2, 2, 2)
        parts = [None if value is None else one(value, own) for value, own in zip(self[:7], axes, strict=True)]
        held = []
        for group in self._groups():
            chosen = [
                item
                if item is None
                else type(item)(*map(one, map(torch.as_tensor, item.parameters()), item.ranks_of_parameters()))
                for item in group or ()
            ]
            held.append(tuple(chosen) if group is not None else None)
        shapes, phases, gradients = held
        return Prescription._make([*parts, shapes, phases, self.wavelengths, gradients])

    def requires_grad(self) -> bool:
        """Return whether a number requires a gradient."""
        values = [*self[:7], *(value for value, _ in self.others())]
        return any(value is not None and value.requires_grad for value in values)

    def numbers(self, image: torch.nn.Module | None = None) -> Numbers:
        """Return the numbers with one row for each system and wavelength, ``[B, …]``, and the image added.

        Parameters
        ----------
        image : surface, optional
            The image surface; a plane by default.
        """
        batch, wavelengths = self.batch, self.index.shape[-2]
        rows = (*batch, wavelengths)

        def spread(value, own: int):
            """Return `value` with the axes of the wavelengths and of the batch, combined to one."""
            tail = value.shape[value.ndim - own :]
            value = value.reshape(*value.shape[: value.ndim - own], 1, *tail)
            return value.expand(*rows, *tail).reshape(math.prod(rows), *tail)

        distance = torch.cat([torch.zeros_like(self.thickness[..., :1]), self.thickness], -1)
        index = self.index.expand(*rows, self.index.shape[-1]).reshape(math.prod(rows), self.index.shape[-1])
        index = torch.cat([index, index[:, -1:]], -1)
        waves = torch.ones_like(index[:1, 0]) if self.wavelengths is None else self.wavelengths.to(index)
        waves = waves.expand(rows).reshape(-1)
        curvature, conic, coefficients = self._with(image)
        placed: list[Any] = []
        for name, count in (("shift", 2), ("tilt", 3)):
            value = getattr(self, name)
            if value is None:
                value = torch.zeros(self.thickness.shape[-1], count, dtype=torch.float64, device=index.device)
            value = torch.nn.functional.pad(value, (0, count - value.shape[-1]))
            last = value.new_zeros(count) if image is None else padded(getattr(image, name).double(), count)
            last = last.expand(*value.shape[:-2], 1, count)
            placed.append(spread(torch.cat([value, last.to(value)], -2), 2))
        others = tuple(spread(value, rank) for value, rank in self.others(image))
        parts = (spread(curvature, 1), spread(conic, 1), spread(distance, 1), spread(coefficients, 2), index)
        return Numbers(*parts, waves, placed[0], torch.deg2rad(placed[1]), others)

    def _with(self, image):
        """Return curvatures, conic constants and coefficients of all surfaces, the image last."""
        pad = torch.nn.functional.pad
        if image is None or image.own_shape is not None:
            return pad(self.curvature, (0, 1)), pad(self.conic, (0, 1)), pad(self.coefficients, (0, 0, 0, 1))
        found = []
        for own, last in ((self.curvature, image.curvature), (self.conic, image.conic)):
            found.append(torch.cat([own, last.double().expand_as(own[..., :1])], -1))
        own, last = self.coefficients, image.coefficients.double()
        count = max(own.shape[-1], len(last))
        own, last = (pad(value, (0, count - value.shape[-1])) for value in (own, last))
        return *found, torch.cat([own, last.expand_as(own[..., :1, :])], -2)


def padded(value: torch.Tensor, count: int) -> torch.Tensor:
    """Return a vector, or vectors ``[..., n]``, with zeros behind, up to `count` numbers."""
    return torch.nn.functional.pad(value, (0, count - value.shape[-1]))


def checked_prescription(prescription: Prescription | None) -> Prescription | None:
    """Return a prescription after checking that it is one; None stays None."""
    _validate.instance("prescription", prescription, (Prescription, type(None)), "a Prescription")
    return prescription
