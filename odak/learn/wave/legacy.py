"""The multiplane optimizer under the name of the module that newer releases keep it in."""

from odak.learn.wave.multiplane import multiplane_hologram_optimizer

__all__ = ["multiplane_hologram_optimizer"]
