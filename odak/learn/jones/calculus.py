"""Jones and Mueller calculus of tensors, by the formulas of :mod:`odak.jones`."""

from odak.jones import elements, stokes_vectors
from odak.jones.elements import apply_matrix, cascade, linearpolarizer, reverse
from odak.jones.stokes_vectors import (
    PolarizationEllipse,
    degree_of_polarization,
    field_from_stokes,
    mueller,
    polarization_ellipse,
    stokes,
    stokes_ellipse,
)
from odak.learn._face import torch_face

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

circular_polarizer = torch_face(elements.circular_polarizer)
depolarizer = torch_face(stokes_vectors.depolarizer)
diattenuator = torch_face(elements.diattenuator)
electricfield = torch_face(elements.electricfield)
half_wave_plate = torch_face(elements.half_wave_plate)
mirror = torch_face(elements.mirror)
polarizer = torch_face(elements.polarizer)
quarter_wave_plate = torch_face(elements.quarter_wave_plate)
retarder = torch_face(elements.retarder)
rotator = torch_face(elements.rotator)
