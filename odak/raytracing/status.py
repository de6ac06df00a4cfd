"""What became of a ray at a surface."""

from enum import IntEnum


class RayStatus(IntEnum):
    """What became of a ray at a surface; arrays of statuses hold these numbers as int8."""

    HIT = 0
    MISS = 1
    TOTAL_INTERNAL_REFLECTION = 2
    VIGNETTED = 3
    NOT_CONVERGED = 4
