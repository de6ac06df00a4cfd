"""Complex-valued Gaussians, on a picture and in space, and the fields and holograms that they make."""

from odak.learn.wave.complex_gaussians_2d import Scene2D, complex_2d_gaussians
from odak.learn.wave.complex_gaussians_3d import complex_3d_gaussians
from odak.learn.wave.gaussian_scene import Scene
from odak.learn.wave.straight_through import STEFunction, StraightThroughEstimator

__all__ = [
    "STEFunction",
    "Scene",
    "Scene2D",
    "StraightThroughEstimator",
    "complex_2d_gaussians",
    "complex_3d_gaussians",
]
