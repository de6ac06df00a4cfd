"""Optimizers of holograms for displays of several planes, colours and frames."""

from odak.learn.wave.mixed_color import mixed_color_hologram_optimizer
from odak.learn.wave.multi_color import multi_color_hologram_optimizer
from odak.learn.wave.multiplane import multiplane_hologram_optimizer

__all__ = ["mixed_color_hologram_optimizer", "multi_color_hologram_optimizer", "multiplane_hologram_optimizer"]
