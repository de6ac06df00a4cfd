"""Version of the package, and the constant π."""

import math

pi: float = math.pi
__version__ = "0.3.0"
version_info: tuple[int, ...] = tuple(int(part) for part in __version__.split("."))
