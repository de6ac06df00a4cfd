"""Jones and Mueller calculus of tensors, by the formulas of :mod:`odak.jones`."""

from typing import TYPE_CHECKING

from odak.jones import calculus
from odak.jones.calculus import PolarizationEllipse as PolarizationEllipse
from odak.jones.calculus import apply_matrix as apply_matrix
from odak.jones.calculus import cascade as cascade
from odak.jones.calculus import degree_of_polarization as degree_of_polarization
from odak.jones.calculus import field_from_stokes as field_from_stokes
from odak.jones.calculus import linearpolarizer as linearpolarizer
from odak.jones.calculus import mueller as mueller
from odak.jones.calculus import polarization_ellipse as polarization_ellipse
from odak.jones.calculus import reverse as reverse
from odak.jones.calculus import stokes as stokes
from odak.jones.calculus import stokes_ellipse as stokes_ellipse
from odak.learn._face import torch_face

if TYPE_CHECKING:
    from odak.learn._faces.jones_calculus import *  # noqa: F403

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
