import threading

import numpy as np
import pytest

import odak
from odak.wave.transfer_functions import KernelCache, kernels


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


def test_everything_that_a_kernel_depends_on_tells_it_apart():
    field = np.zeros((24, 20), np.complex128)
    field[12, 10] = 1
    base = {"distance": 0.02, "dx": 8e-6, "wavelength": 532e-9, "propagation_type": "IR Fresnel"}
    base |= {"scale": 1, "samples": (1, 1, 1, 1), "zero_padding": (False, False, False)}
    changes = [
        {},
        {"distance": 0.03},
        {"distance": np.array([0.02])},
        {"dx": 7e-6},
        {"wavelength": 500e-9},
        {"propagation_type": "TR Fresnel"},
        {"scale": 2},
        {"zero_padding": (True, False, True)},
        *({"samples": tuple(3 if n == place else 1 for n in range(4))} for place in range(4)),
    ]

    def results(fresh):
        for change in changes:
            if fresh:
                odak.wave.clear_kernel_cache()
            yield odak.wave.propagate_beam(field, None, **(base | change))

    kept, alone = list(results(False)), list(results(True))
    for one, other in zip(kept, alone, strict=True):
        np.testing.assert_array_equal(one, other)
    assert not any(np.array_equal(value, alone[0]) for value in alone[1:])


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
