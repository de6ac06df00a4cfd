from . import blender as blender
from . import plotly as plotly
from .exploring import Exploration as Exploration
from .exploring import explore as explore
from .export import PLY_object as PLY_object
