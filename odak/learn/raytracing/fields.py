"""Waves to rays, differentiable in the field."""

from odak.raytracing.fields import FieldRays, rays_from_field

__all__ = ["FieldRays", "rays_from_field"]
