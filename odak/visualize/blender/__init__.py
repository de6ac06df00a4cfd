"""Rays, meshes, surfaces and lenses drawn and rendered in Blender, by commands from Python alone."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "libblend": (),
        "locate": ("Blender", "BlenderError", "BlenderNotFoundError", "find_blender"),
        "materials": ("Material", "diffuse", "emission", "glass", "metal"),
        "scenes": ("scene",),
        "server": (),
        "wrapper": (
            "check",
            "cylinder_between",
            "delete_the_cube",
            "import_ply",
            "init",
            "prepare",
            "quit",
            "render",
            "send_msg",
        ),
    },
)
