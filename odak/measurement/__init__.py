"""Image quality from pictures of edges: line spread, modulation transfer, ISO 12233 slanted edges."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "image_quality": (
            "fourier_transform_1d",
            "line_spread_function",
            "modulation_transfer_function",
            "polynomial_fit",
            "roi",
        ),
        "slanted_edge": ("slanted_edge_mtf",),
    },
)
