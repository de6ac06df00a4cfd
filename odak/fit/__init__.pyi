from .descent import gradient_descent_1d as gradient_descent_1d
from .line import least_square_1d as least_square_1d
from .threshold import perceptron as perceptron
from .threshold import threshold_linear_model as threshold_linear_model
