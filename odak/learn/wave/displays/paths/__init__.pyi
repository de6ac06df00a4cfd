from .base import Path as Path
from .choice import PATHS as PATHS
from .free import FreePath as FreePath
from .lens import LensPath as LensPath
from .retina import RetinaPath as RetinaPath
from .two_panels import TwoPanelsPath as TwoPanelsPath
