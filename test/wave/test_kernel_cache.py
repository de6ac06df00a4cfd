import sys
import threading

import numpy as np
import pytest
import torch

import odak
from odak.wave import transfer_functions
from odak.wave.transfer_functions import KernelCache, kernels


def propagate(distance=1e-3, dtype=np.complex64, n=16):
    return odak.wave.angular_spectrum(np.ones((n, n), dtype), None, distance, 8e-6, 532e-9)


def test_a_geometry_builds_its_kernel_once():
    propagate()
    assert len(kernels) == 1
    held = next(iter(kernels.on("cpu")._once.values()))
    propagate()
    assert next(iter(kernels.on("cpu")._again.values())) is held
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
    assert {*cache._once, *cache._again} == {"a", "c", "d"}
    assert cache.bytes == 192
    cache.get("large", lambda: np.zeros(100))
    assert len(cache) == 3
    cache.resize(64)
    # It was used twice, the others once.
    assert {*cache._once, *cache._again} == {"a"} and cache.bytes == 64


def test_what_is_used_once_takes_little_and_displaces_nothing(monkeypatch):
    monkeypatch.setattr(transfer_functions, "ONCE_BYTES", 64 * 10)
    cache, built = KernelCache(maximum_bytes=64 * 100), []

    def get(name, count=8):
        return cache.get(name, lambda: built.append(name) or np.zeros(count))

    # Used in turns, more than the room for what is used once: half of them are built twice, and none again.
    for _ in range(5):
        for name in range(20):
            get(name)
    assert len(built) == 30 and set(built) == set(range(20)) and cache.bytes == 64 * 20
    for name in range(1000, 2000):
        get(name)
    assert cache.bytes == 64 * 30 and set(cache._again) == set(range(20))
    # One that is larger than that room is held until the next, and the bound of all holds.
    get("large", 8 * 50), get("large", 8 * 50)
    assert built.count("large") == 1 and cache.bytes <= 64 * 100
    get("larger", 8 * 60), get("larger", 8 * 60), get("larger", 8 * 60)
    # Too large beside what is used again: built twice, then the least recently used make room.
    assert built.count("larger") == 2 and "larger" in cache._again and 0 not in cache._again
    assert cache.bytes <= 64 * 100


def test_a_thousand_distances_take_at_most_their_room(monkeypatch):
    monkeypatch.setattr(transfer_functions, "ONCE_BYTES", 2**17)
    odak.wave.clear_kernel_cache()
    for index in range(200):
        propagate(1e-3 + index * 1e-6)
    assert 2**16 < kernels.bytes <= 2**17
    odak.wave.clear_kernel_cache()


@pytest.mark.parametrize(("free", "bound"), [(0, 2**27), (2**32, 2**32 // 10), (2**40, 2**30)])
def test_the_bound_is_a_tenth_of_the_free_memory(free, bound, monkeypatch):
    monkeypatch.setattr(transfer_functions, "_free_bytes", lambda device: free)
    caches = transfer_functions.KernelCaches()
    assert caches.on("cpu").maximum_bytes == caches.on("cuda:0").maximum_bytes == bound
    assert caches.on("cpu") is not caches.on("cuda:0")
    caches.resize(5)
    assert caches.on("cpu").maximum_bytes == caches.on("cuda:1").maximum_bytes == 5
    caches.resize(None)
    assert caches.on("cpu").maximum_bytes == bound


@pytest.mark.skipif(sys.platform != "linux", reason="the file of the kernel is Linux's")
def test_a_container_has_what_its_bound_leaves(monkeypatch):
    told = {"memory.max": "3000000", "memory.current": "1000000"}
    monkeypatch.setattr(transfer_functions.Path, "read_text", lambda path: told[path.name])
    assert transfer_functions._free_bytes("cpu") == 2_000_000
    told["memory.max"] = "max"
    assert transfer_functions._free_bytes("cpu") > 2_000_000


def test_free_memory_is_known_on_linux():
    if not sys.platform.startswith("linux"):
        pytest.skip("read from /proc")
    psutil = pytest.importorskip("psutil")
    assert 0 < transfer_functions._free_bytes("cpu") <= psutil.virtual_memory().total


@pytest.mark.cuda
def test_the_bound_on_a_gpu_follows_from_its_memory():
    free = torch.cuda.mem_get_info("cuda")[0]
    field = torch.ones(16, 16, dtype=torch.complex64, device="cuda")
    odak.learn.wave.propagate_beam(field, None, 1e-3, 8e-6, 532e-9)
    cache = kernels.on(field.device)
    assert len(cache) == 1 and cache.maximum_bytes == min(max(free // 10, 2**27), 2**30)


def test_size_is_set_and_checked():
    try:
        odak.wave.set_kernel_cache_size(0)
        propagate()
        assert len(kernels) == 0
        with pytest.raises(ValueError, match="maximum_bytes"):
            odak.wave.set_kernel_cache_size(-1)
    finally:
        odak.wave.set_kernel_cache_size(None)


def test_threads_share_one_cache():
    results = []
    threads = [threading.Thread(target=lambda: results.append(propagate(n=64))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(kernels) == 1
    assert all((result == results[0]).all() for result in results)
