"""Stokes vectors, Mueller matrices and the polarisation ellipse of tensors; see :mod:`odak.jones.stokes_vectors`."""

from odak.jones import stokes_vectors
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
    "degree_of_polarization",
    "depolarizer",
    "field_from_stokes",
    "mueller",
    "polarization_ellipse",
    "stokes",
    "stokes_ellipse",
]

depolarizer = torch_face(stokes_vectors.depolarizer)
