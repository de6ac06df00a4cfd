from . import blender as blender
from . import plotly as plotly
from .export import PLY_object as PLY_object
