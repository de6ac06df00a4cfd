"""Point sources and point detectors, for tensors too: the functions of :mod:`odak.wave.vector`."""

from odak.wave.vector import electric_field_per_plane_wave, propagate_field, propagate_plane_waves

__all__ = ["electric_field_per_plane_wave", "propagate_field", "propagate_plane_waves"]
