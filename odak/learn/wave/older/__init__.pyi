from .single_plane import double_phase_hologram as double_phase_hologram
from .single_plane import gerchberg_saxton as gerchberg_saxton
from .single_plane import point_wise as point_wise
from .single_plane import shift_w_double_phase as shift_w_double_phase
from .single_plane import stochastic_gradient_descent as stochastic_gradient_descent
