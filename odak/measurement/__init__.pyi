from .image_quality import fourier_transform_1d as fourier_transform_1d
from .image_quality import line_spread_function as line_spread_function
from .image_quality import modulation_transfer_function as modulation_transfer_function
from .image_quality import polynomial_fit as polynomial_fit
from .image_quality import roi as roi
from .image_quality import slanted_edge_mtf as slanted_edge_mtf
