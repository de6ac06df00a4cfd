"""Things to buy: lenses, detectors and diffusers as ray-traced objects, and the refractive indices of materials."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "detectors": ("plane_detector",),
        "diffusers": ("thin_diffuser",),
        "lenses": ("plano_convex_lens",),
        "materials": (
            "abbe_number",
            "load_materials",
            "material",
            "material_names",
            "nearest_materials",
            "refractive_index",
        ),
    },
)
