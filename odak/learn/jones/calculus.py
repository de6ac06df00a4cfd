"""Jones and Mueller calculus of tensors, by the formulas of :mod:`odak.jones`."""

from typing import TYPE_CHECKING

from odak.jones import calculus
from odak.jones.calculus import (
    PolarizationEllipse,
    apply_matrix,
    cascade,
    degree_of_polarization,
    field_from_stokes,
    linearpolarizer,
    mueller,
    polarization_ellipse,
    reverse,
    stokes,
    stokes_ellipse,
)
from odak.learn._face import torch_face

if TYPE_CHECKING:
    from odak.learn._faces.jones_calculus import *  # noqa: F403

__all__ = [
    "PolarizationEllipse",
    "apply_matrix",
    "cascade",
    "circular_polarizer",
    "degree_of_polarization",
    "depolarizer",
    "diattenuator",
    "electricfield",
    "field_from_stokes",
    "half_wave_plate",
    "linearpolarizer",
    "mirror",
    "mueller",
    "polarization_ellipse",
    "polarizer",
    "quarter_wave_plate",
    "retarder",
    "reverse",
    "rotator",
    "stokes",
    "stokes_ellipse",
]

if not TYPE_CHECKING:
    circular_polarizer = torch_face(calculus.circular_polarizer)
    depolarizer = torch_face(calculus.depolarizer)
    diattenuator = torch_face(calculus.diattenuator)
    electricfield = torch_face(calculus.electricfield)
    half_wave_plate = torch_face(calculus.half_wave_plate)
    mirror = torch_face(calculus.mirror)
    polarizer = torch_face(calculus.polarizer)
    quarter_wave_plate = torch_face(calculus.quarter_wave_plate)
    retarder = torch_face(calculus.retarder)
    rotator = torch_face(calculus.rotator)
