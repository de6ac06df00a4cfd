"""A bounded store of transfer functions, so that a kernel is built once per geometry."""

import math
import os
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable

DEFAULT_BYTES = 1 << 30


class KernelCache:
    """Least-recently-used store, bounded in bytes and safe between threads.

    Parameters
    ----------
    maximum_bytes : int
        Bound on the bytes held. A kernel larger than this is built on each call and never held.
    """

    def __init__(self, maximum_bytes: int = DEFAULT_BYTES):
        self._entries: OrderedDict[Hashable, object] = OrderedDict()
        self._lock = threading.RLock()
        self.maximum_bytes = maximum_bytes
        self.bytes = 0

    def get(self, key: Hashable, build: Callable):
        """Return the entry of `key`, calling `build` for it when it is not held."""
        with self._lock:
            if key in self._entries:
                self._entries.move_to_end(key)
                return self._entries[key]
        kernel = build()
        size = _bytes_of(kernel)
        with self._lock:
            if key not in self._entries and size <= self.maximum_bytes:
                self._entries[key] = kernel
                self.bytes += size
                self._shrink()
        return kernel

    def _shrink(self):
        while self.bytes > self.maximum_bytes:
            self.bytes -= _bytes_of(self._entries.popitem(last=False)[1])

    def _after_fork(self):
        # Another thread may have held the lock: its owner is not in this process, and would never let go.
        self._lock = threading.RLock()

    def resize(self, maximum_bytes: int):
        """Set the bound and drop the least recently used entries above it."""
        with self._lock:
            self.maximum_bytes = maximum_bytes
            self._shrink()

    def clear(self):
        """Drop every entry."""
        with self._lock:
            self._entries.clear()
            self.bytes = 0

    def __len__(self) -> int:
        return len(self._entries)


def _bytes_of(kernel) -> int:
    # The array API has no `nbytes`; every number held is a double or a pair of floats, unless it says 128.
    return math.prod(kernel.shape) * (16 if "128" in str(kernel.dtype) else 8)


kernels = KernelCache()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=kernels._after_fork)


def clear_kernel_cache() -> None:
    """Drop all stored transfer functions.

    Examples
    --------
    >>> import odak
    >>> odak.wave.clear_kernel_cache()
    """
    kernels.clear()


def set_kernel_cache_size(maximum_bytes: int) -> None:
    """Bound the store of transfer functions; 0 switches it off.

    Parameters
    ----------
    maximum_bytes : int
        Largest sum of kernel sizes to hold, in bytes. The default is 1 GiB.

    Raises
    ------
    ValueError
        If `maximum_bytes` is negative.
    TypeError
        If `maximum_bytes` is not an integer.
    """
    from odak import _validate

    kernels.resize(_validate.integer("maximum_bytes", maximum_bytes))
