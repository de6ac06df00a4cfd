"""Complex-valued Gaussians, in a picture and in space, and the fields and holograms that they make."""

from odak._lazy import attach

# The names belong to odak.learn.wave, which lists them.
__getattr__, __dir__, _ = attach(__name__, __file__)
