"""Interactive pictures of fields, surfaces and rays with Plotly, saved as pages, Markdown or images."""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(
    __name__,
    {
        "browser": ("BrowserNotFoundError", "close_browser", "find_browser"),
        "fields": ("detectorshow", "plot2dshow"),
        "plots": ("plotshow", "surfaceshow"),
        "rays": ("rayshow",),
        "show_field": ("field_show",),
        "show_system": ("system_show",),
    },
)
