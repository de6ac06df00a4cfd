"""Differentiable geometric optics on tensors: rays, surfaces, intersections, reflection and refraction."""

import importlib
import sys
from types import ModuleType

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "boundary": (
            "fresnel_coefficients",
            "get_sphere_normal_torch",
            "get_triangle_normal",
            "intersect_w_circle",
            "intersect_w_sphere",
            "intersect_w_surface",
            "intersect_w_surface_batch",
            "intersect_w_triangle",
            "intersect_w_triangle_batch",
            "reflect",
            "refract",
        ),
        "cylinders": ("cylinder_function", "define_cylinder", "get_cylinder_normal", "intersect_w_cylinder"),
        "detector": ("detector",),
        "fields": ("FieldRays", "rays_from_field"),
        "implicit": ("Conic", "EvenAsphere", "SplineFreeform", "Toroid", "ZernikeFreeform", "intersect_w_sag"),
        "mesh": ("planar_mesh",),
        "parametric": ("intersect_parametric",),
        "primitives": (
            "bring_plane_to_origin",
            "center_of_triangle",
            "define_circle",
            "define_plane",
            "define_plane_mesh",
            "define_sphere",
            "is_it_on_triangle",
            "is_it_on_triangle_batch",
            "sphere_function",
        ),
        "ray": (
            "calculate_intersection_of_two_rays",
            "create_ray",
            "create_ray_from_all_pairs",
            "create_ray_from_angles",
            "create_ray_from_grid_w_luminous_angle",
            "create_ray_from_point_w_luminous_angle",
            "create_ray_from_two_points",
            "find_nearest_points",
            "get_points_along_a_ray_segment",
            "propagate_a_ray",
            "propagate_ray",
        ),
        "system": (),
        "triangles": ("MeshHit", "triangle_mesh"),
    },
)


class _Package(ModuleType):
    """A package in which `detector` is the class, though importing the module of that name would put that there."""

    @property
    def detector(self):
        return importlib.import_module(f"{__name__}.detector").detector

    @detector.setter
    def detector(self, value):
        pass


sys.modules[__name__].__class__ = _Package
