"""Focal stacks of scenes made of planes, differentiable."""

from odak.learn.wave import spectral
from odak.wave.incoherent_propagation import incoherent_focal_stack_rgbd

__all__ = ["incoherent_focal_stack_rgbd", "spectral"]
