from .descent import Descent as Descent
from .double_phase import DoublePhase as DoublePhase
from .network import Network as Network
from .projections import AlternatingProjections as AlternatingProjections
