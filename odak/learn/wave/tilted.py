"""Propagation to a tilted plane, differentiable."""

from odak.wave.tilted import propagate_to_tilted_plane

__all__ = ["propagate_to_tilted_plane"]
