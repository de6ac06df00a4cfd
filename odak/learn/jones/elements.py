"""Jones vectors and matrices as tensors, by the formulas of :mod:`odak.jones.elements`."""

from odak.jones import elements
from odak.jones.elements import apply_matrix, cascade, linearpolarizer, reverse
from odak.learn._face import torch_face

__all__ = [
    "apply_matrix",
    "cascade",
    "circular_polarizer",
    "diattenuator",
    "electricfield",
    "half_wave_plate",
    "linearpolarizer",
    "mirror",
    "polarizer",
    "quarter_wave_plate",
    "retarder",
    "reverse",
    "rotator",
]

circular_polarizer = torch_face(elements.circular_polarizer)
diattenuator = torch_face(elements.diattenuator)
electricfield = torch_face(elements.electricfield)
half_wave_plate = torch_face(elements.half_wave_plate)
mirror = torch_face(elements.mirror)
polarizer = torch_face(elements.polarizer)
quarter_wave_plate = torch_face(elements.quarter_wave_plate)
retarder = torch_face(elements.retarder)
rotator = torch_face(elements.rotator)
