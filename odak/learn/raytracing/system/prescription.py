"""The numbers of one system or of a batch of them, apart from the modules that hold them."""

import math
from typing import Any, NamedTuple

import torch

from odak.learn.raytracing.system.elements import Layout, Numbers


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
        ``[..., S, 2]``; None where no surface has any. Tilts in degrees.
    """

    curvature: torch.Tensor
    conic: torch.Tensor
    thickness: torch.Tensor
    coefficients: torch.Tensor
    index: torch.Tensor  # type: ignore[assignment]  # hides tuple.index
    shift: torch.Tensor | None = None
    tilt: torch.Tensor | None = None

    @property
    def batch(self) -> torch.Size:
        """Leading axes of the batch."""
        return torch.broadcast_shapes(
            self.curvature.shape[:-1],
            self.conic.shape[:-1],
            self.thickness.shape[:-1],
            self.coefficients.shape[:-2],
            self.index.shape[:-2],
            *(value.shape[:-2] for value in (self.shift, self.tilt) if value is not None),
        )

    def numbers(self, image: Any = None) -> Numbers:
        """Return the numbers with one row for each system and wavelength, ``[B, …]``, and the image added.

        Parameters
        ----------
        image : surface, optional
            The image surface; a plane by default.
        """
        batch, wavelengths = self.batch, self.index.shape[-2]
        rows = (*batch, wavelengths)

        def spread(value, own: int):
            """Give `value` the wavelengths' axis and the batch's, and make rows of them."""
            tail = value.shape[value.ndim - own :]
            value = value.reshape(*value.shape[: value.ndim - own], 1, *tail)
            return value.expand(*rows, *tail).reshape(math.prod(rows), *tail)

        distance = torch.cat([torch.zeros_like(self.thickness[..., :1]), self.thickness], -1)
        index = self.index.expand(*rows, self.index.shape[-1]).reshape(math.prod(rows), self.index.shape[-1])
        index = torch.cat([index, index[:, -1:]], -1)
        curvature, conic, coefficients = self._with(image)
        return Numbers(spread(curvature, 1), spread(conic, 1), spread(distance, 1), spread(coefficients, 2), index)

    def _with(self, image):
        """Return curvatures, conic constants and coefficients with those of the image behind them."""
        pad = torch.nn.functional.pad
        if image is None:
            return pad(self.curvature, (0, 1)), pad(self.conic, (0, 1)), pad(self.coefficients, (0, 0, 0, 1))
        found = []
        for own, last in ((self.curvature, image.curvature), (self.conic, image.conic)):
            found.append(torch.cat([own, last.double().expand_as(own[..., :1])], -1))
        own, last = self.coefficients, image.coefficients.double()
        count = max(own.shape[-1], len(last))
        own, last = (pad(value, (0, count - value.shape[-1])) for value in (own, last))
        return *found, torch.cat([own, last.expand_as(own[..., :1, :])], -2)


def checked_prescription(prescription) -> Prescription | None:
    """Return a prescription after checking that it is one; None stays None."""
    if prescription is not None and not isinstance(prescription, Prescription):
        raise TypeError(f"prescription must be a Prescription, got {type(prescription).__name__}")
    return prescription


def layout_of(surfaces, prescription: Prescription, image=None, vignetting: bool = True) -> Layout:
    """Return what about a row of surfaces and the image behind it is no number.

    Parameters
    ----------
    surfaces : sequence of surface
        The surfaces.
    prescription : Prescription
        Their numbers: a surface is plane only if no number bends it and none is being varied.
    image : surface, optional
        The image surface; a plane by default.
    vignetting : bool
        Let semi-diameters block rays.
    """
    kinds, actions, signs, limits = [], [], [], []
    sign, before = 1, None
    for i, item in enumerate(surfaces):
        kinds.append(_kind(prescription.curvature[..., i], prescription.coefficients[..., i, :]))
        medium = _medium_key(item)
        action = "reflect" if item.reflects else "pass" if medium == (before or ("air",)) else "refract"
        actions.append(action)
        signs.append(sign)
        limits.append(item.semi_diameter if vignetting else None)
        sign = -sign if item.reflects else sign
        before = before if item.reflects else medium
    kinds.append("plane" if image is None else _kind(image.curvature, image.coefficients))
    limits.append(image.semi_diameter if image is not None and vignetting else None)
    return Layout(tuple(kinds), (*actions, "pass"), (*signs, sign), tuple(limits))


def _kind(curvature: torch.Tensor, coefficients: torch.Tensor) -> str:
    if (coefficients.requires_grad and coefficients.shape[-1]) or _any(coefficients):
        return "asphere"
    return "conic" if curvature.requires_grad or _any(curvature) else "plane"


def _any(value: torch.Tensor) -> bool:
    """Say whether any number is not zero; numbers that cannot be read may be anything."""
    if torch._C._functorch.is_functorch_wrapped_tensor(value):
        return value.numel() > 0
    return bool(value.detach().any())


def _medium_key(item) -> tuple:
    if item.material is None:
        return ("index", id(item))
    return ("air",) if item.material == "air" else ("material", getattr(item.material, "name", ""))
