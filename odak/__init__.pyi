import numpy as np  # noqa: F401 - under its earlier name, not a public one

from . import catalog as catalog
from . import cli as cli
from . import fit as fit
from . import instruments as instruments
from . import jones as jones
from . import learn as learn
from . import log as log
from . import manager as manager
from . import measurement as measurement
from . import raytracing as raytracing
from . import tools as tools
from . import visualize as visualize
from . import wave as wave
from ._find import find as find
from ._version import __version__ as __version__
from ._version import pi as pi
from ._version import version_info as version_info
from ._warnings import AccuracyWarning as AccuracyWarning
from ._warnings import ArgumentWarning as ArgumentWarning
from ._warnings import ConvergenceWarning as ConvergenceWarning
from ._warnings import DeviceWarning as DeviceWarning
from ._warnings import MissingPackageWarning as MissingPackageWarning
from ._warnings import OdakWarning as OdakWarning
from ._warnings import SamplingWarning as SamplingWarning
