"""Version of the package, and the constant π."""

import math

pi = math.pi
__version__ = "0.3.0"
version_info = tuple(int(part) for part in __version__.split("."))
