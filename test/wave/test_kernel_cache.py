import threading

import numpy as np
import pytest

import odak
from odak.wave.kernel_cache import KernelCache, kernels


def propagate(distance=1e-3, dtype=np.complex64, n=16):
    return odak.wave.angular_spectrum(np.ones((n, n), dtype), None, distance, 8e-6, 532e-9)


def test_a_geometry_builds_its_kernel_once():
    propagate()
    assert len(kernels) == 1
    held = next(iter(kernels._entries.values()))
    propagate()
    assert next(iter(kernels._entries.values())) is held
    propagate(2e-3)
    propagate(dtype=np.complex128)
    assert len(kernels) == 3
    assert kernels.bytes == 16 * 16 * (8 + 8 + 16)
    odak.wave.clear_kernel_cache()
    assert len(kernels) == kernels.bytes == 0


def test_the_bound_holds_and_the_oldest_goes_first():
    cache = KernelCache(maximum_bytes=200)
    for name in "abc":
        cache.get(name, lambda: np.zeros(8))
    cache.get("a", lambda: pytest.fail("a was held"))
    cache.get("d", lambda: np.zeros(8))
    assert set(cache._entries) == {"a", "c", "d"}
    assert cache.bytes == 192
    cache.get("large", lambda: np.zeros(100))
    assert "large" not in cache._entries
    cache.resize(64)
    assert set(cache._entries) == {"d"}


def test_size_is_set_and_checked():
    maximum = kernels.maximum_bytes
    try:
        odak.wave.set_kernel_cache_size(0)
        propagate()
        assert len(kernels) == 0
        with pytest.raises(ValueError, match="maximum_bytes"):
            odak.wave.set_kernel_cache_size(-1)
    finally:
        odak.wave.set_kernel_cache_size(maximum)


def test_threads_share_one_cache():
    results = []
    threads = [threading.Thread(target=lambda: results.append(propagate(n=64))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(kernels) == 1
    assert all((result == results[0]).all() for result in results)
