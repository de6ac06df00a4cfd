"""Distribution of work over processes, GPUs and machines.

Nothing of Dask is imported before it is needed; without Dask, tasks run one after another in this process.
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
