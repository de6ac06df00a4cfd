"""Propagation to a window of any pitch, size and place, differentiable."""

from odak.wave.windows import propagate_to_window

__all__ = ["propagate_to_window"]
