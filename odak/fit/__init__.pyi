from .regression import gradient_descent_1d as gradient_descent_1d
from .regression import least_square_1d as least_square_1d
from .regression import perceptron as perceptron
from .regression import threshold_linear_model as threshold_linear_model
