"""Geometric optics on NumPy arrays: rays, surfaces, intersections, reflection and refraction."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "boundary": (
            "fresnel_coefficients",
            "get_cylinder_normal",
            "get_sphere_normal",
            "get_triangle_normal",
            "intersect_parametric",
            "intersect_w_circle",
            "intersect_w_cylinder",
            "intersect_w_sphere",
            "intersect_w_surface",
            "intersect_w_triangle",
            "intersection_kernel_for_parametric_surfaces",
            "propagate_parametric_intersection_error",
            "reflect",
            "refract",
        ),
        "fields": ("FieldRays", "rays_from_field"),
        "primitives": (
            "bring_plane_to_origin",
            "center_of_triangle",
            "cylinder_function",
            "define_circle",
            "define_cylinder",
            "define_plane",
            "define_sphere",
            "is_it_on_triangle",
            "sphere_function",
        ),
        "ray": (
            "calculate_intersection_of_two_rays",
            "create_ray",
            "create_ray_from_all_pairs",
            "create_ray_from_angles",
            "create_ray_from_two_points",
            "find_nearest_points",
            "get_points_along_a_ray_segment",
            "propagate_a_ray",
        ),
        "status": ("RayStatus",),
        "surfaces": ("Conic", "EvenAsphere", "SplineFreeform", "Toroid", "ZernikeFreeform", "intersect_w_sag"),
    },
)
