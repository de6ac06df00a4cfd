"""Products, sides and distances of points and rays as tensors, by the formulas of :mod:`odak.tools.vector`."""

from odak.learn._face import torch_face
from odak.tools import vector

cross_product = torch_face(vector.cross_product, tensors=("vector1", "vector2"))
same_side = torch_face(vector.same_side, tensors=("p1", "p2", "a", "b"))
distance_between_two_points = torch_face(vector.distance_between_two_points, tensors=("point1", "point2"))
