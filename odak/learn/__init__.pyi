from . import jones as jones
from . import lensless as lensless
from . import models as models
from . import perception as perception
from . import raytracing as raytracing
from . import tools as tools
from . import wave as wave
