"""Arrays of spots and images in the far field, as tensors."""

from odak.wave.spots import spot_hologram, uniformity, weighted_gerchberg_saxton

__all__ = ["spot_hologram", "uniformity", "weighted_gerchberg_saxton"]
