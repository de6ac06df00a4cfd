"""The PyTorch face: differentiable, on any device, and what only PyTorch can do."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__, {"jones": (), "lensless": (), "models": (), "perception": (), "raytracing": (), "tools": (), "wave": ()}
)
