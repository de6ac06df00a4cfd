"""Plotly, or an error that says how to get it."""

try:
    import plotly.graph_objects as graph
    import plotly.io as page
    from plotly.subplots import make_subplots
except ImportError as error:
    raise ImportError("odak.visualize.plotly needs the package plotly: pip install plotly kaleido") from error

__all__ = ["graph", "make_subplots", "page"]
