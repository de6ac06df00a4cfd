"""Sequential optical systems: lenses and mirrors in a row, traced, analysed, optimised and toleranced as tensors."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "drawing": ("draw_layout", "draw_spots"),
        "fans": ("distortion", "field_curvature", "ray_fan"),
        "launching": ("launch", "Rays"),
        "lens": ("optical_system",),
        "lens_files": ("load_system", "sample_systems", "save_system", "system_from_dict", "system_to_dict"),
        "optimise": ("levenberg_marquardt", "LevenbergMarquardtResult"),
        "paraxial": ("first_order", "FirstOrder"),
        "prescription": ("Prescription",),
        "psf": (
            "airy_pattern",
            "modulation_transfer_function",
            "point_spread_function",
            "propagated_point_spread_function",
            "Spread",
        ),
        "pupils": ("pupil_samples",),
        "spots": ("rms_spot", "spot_diagram", "Spots"),
        "surfaces": ("surface",),
        "tolerances": ("Perturbation", "tolerance", "ToleranceResult"),
        "tracing": ("trace", "trace_fields", "Traced"),
        "wavefronts": ("wavefront", "Wavefront", "zernike_fit"),
        "waves": ("exit_field", "ExitField"),
        "zemax": ("read_zmx", "write_zmx", "ZmxReport"),
    },
)
