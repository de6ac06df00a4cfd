"""Fields in chunks, as Dask arrays: equal to those in memory, adjoint, larger holograms that go on after a stop."""

import numpy as np
import pytest

import odak.wave
from odak.wave import hologram_in_chunks, propagate_beam, transfer_functions

da = pytest.importorskip("dask.array")
dask = pytest.importorskip("dask")
METHODS = ("Angular Spectrum", "Bandlimited Angular Spectrum", "TF Fresnel", "IR Fresnel", "Rayleigh-Sommerfeld")
WINDOW = (True, False, True)


@pytest.fixture(autouse=True)
def small_chunks():
    with dask.config.set({"array.chunk-size": "16 kiB", "scheduler": "synchronous"}):
        yield


def field(shape, dtype=np.complex128, seed=0):
    generator = np.random.default_rng(seed)
    return (generator.normal(size=shape) + 1j * generator.normal(size=shape)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128])
@pytest.mark.parametrize("method", METHODS)
def test_as_in_memory(method, dtype):
    whole = field((2, 63, 50), dtype)
    lazy = da.from_array(whole, chunks=(2, 20, 17))
    for distance in (5e-3, -2e-3, np.array([2e-3, 3e-3])):
        expected = propagate_beam(whole, None, distance, (8e-6, 7e-6), 532e-9, method, zero_padding=WINDOW)
        result = propagate_beam(lazy, None, distance, (8e-6, 7e-6), 532e-9, method, zero_padding=WINDOW)
        assert isinstance(result, da.Array) and result.dtype == expected.dtype and result.shape == expected.shape
        assert result.npartitions > 2
        precision = np.finfo(dtype).eps
        np.testing.assert_allclose(result.compute(), expected, rtol=0, atol=50 * precision * np.abs(expected).max())


def test_kernel_and_aperture_of_ones_own():
    whole = field((24, 20))
    lazy = da.from_array(whole, chunks=(7, 9))
    kernel = field((48, 40), seed=1)
    expected = propagate_beam(whole, None, 0.0, 1.0, 1.0, "custom", kernel=kernel, zero_padding=WINDOW)
    for given in (kernel, da.from_array(kernel, chunks=13)):
        result = propagate_beam(lazy, None, 0.0, 1.0, 1.0, "custom", kernel=given, zero_padding=WINDOW)
        np.testing.assert_allclose(result.compute(), expected, atol=1e-12)
    mask = np.abs(kernel)
    geometry = (None, 2e-3, 8e-6, 532e-9, "Angular Spectrum")
    expected = propagate_beam(whole, *geometry, zero_padding=WINDOW, aperture=mask)
    result = propagate_beam(lazy, *geometry, zero_padding=WINDOW, aperture=mask)
    np.testing.assert_allclose(result.compute(), expected, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_propagation_back_is_the_adjoint(method):
    there, back = field((30, 22)), field((30, 22), seed=1)
    a = propagate_beam(da.from_array(there), None, 3e-3, 8e-6, 532e-9, method, zero_padding=WINDOW).compute()
    b = propagate_beam(da.from_array(back), None, -3e-3, 8e-6, 532e-9, method, zero_padding=WINDOW).compute()
    assert np.vdot(back, a) == pytest.approx(np.vdot(b, there), rel=1e-12)


def test_kernels_are_computed_in_parts(monkeypatch):
    made, grid = [], transfer_functions.ColumnGrid
    monkeypatch.setattr(transfer_functions, "ColumnGrid", lambda **values: made.append(grid(**values)) or made[-1])
    propagate_beam(da.zeros((100, 120), chunks=50, dtype="complex64"), None, 1e-3, 8e-6, 532e-9, "AS").compute()
    assert sum(grid.stop - grid.start for grid in made) >= 120
    assert max((grid.stop - grid.start) * 100 * 8 for grid in made) <= 16 * 1024


@pytest.mark.parametrize("method", ["Fraunhofer", "Adaptive Sampling Angular Spectrum", "Incoherent Angular Spectrum"])
def test_other_methods_are_refused(method):
    with pytest.raises(ValueError, match=f"for a Dask array, got '{method}'"):
        propagate_beam(da.ones((8, 8)), None, 1e-3, 8e-6, 532e-9, method)


def picture():
    y, x = np.mgrid[-1:1:48j, -1:1:40j]
    return 0.3 + np.exp(-4 * (x**2 + 2 * y**2)) * (1 + 0.5 * np.sin(6 * x))


PROBLEM = {"distance": 2e-3, "dx": (8e-6, 7e-6), "wavelength": 532e-9, "progress": False}


def compare(phase, target):
    """Return the part of the target that the hologram's exact image, scaled to fit best, leaves unexplained."""
    wide = np.zeros((256, 256), complex)
    inside = np.s_[104:152, 108:148]
    wide[inside] = np.exp(1j * phase)
    image = np.abs(propagate_beam(wide, None, 2e-3, (8e-6, 7e-6), 532e-9, "Angular Spectrum")[inside]) ** 2
    return 1 - np.sum(image * target) ** 2 / np.sum(image**2) / np.sum(target**2)


@pytest.mark.parametrize("method", ["gradient descent", pytest.param("Gerchberg-Saxton", marks=pytest.mark.slow)])
@pytest.mark.slow
def test_hologram(tmp_path, method):
    pytest.importorskip("zarr")
    target = da.from_array(picture(), chunks=15)
    phase = hologram_in_chunks(target, tmp_path / "a", 20, **PROBLEM, method=method)
    first = hologram_in_chunks(target, tmp_path / "b", 1, **PROBLEM, method=method).compute()
    assert phase.npartitions > 1
    assert compare(phase.compute(), picture()) < 0.5 * compare(first, picture())


def test_gerchberg_saxton_takes_the_steps_of_the_one_in_memory(tmp_path):
    pytest.importorskip("zarr")
    start = np.random.default_rng(0).uniform(0, 3, (48, 40)).astype(np.float32)
    # The one in memory does not scale its target: one scaled to the hologram's energy takes the same first step.
    target = picture() / picture().mean()
    phase = hologram_in_chunks(
        target, tmp_path / "a", 1, **PROBLEM, method="Gerchberg-Saxton", initial_phase=start, propagation_type="AS"
    )
    # Its phases end at 2π.
    expected, _ = odak.wave.gerchberg_saxton(
        np.sqrt(target), 1, 2e-3, (8e-6, 7e-6), 532e-9, 2 * np.pi, "AS", initial_phase=start
    )
    # The phase of a pixel with a hundredth of the brightest field is known to 100 times the rounding of transforms.
    np.testing.assert_allclose(np.exp(1j * phase.compute()), expected, atol=100 * 8 * np.finfo(np.float32).eps)


@pytest.mark.slow
def test_an_interrupted_run_ends_as_an_unbroken_one(tmp_path, monkeypatch):
    pytest.importorskip("zarr")
    from odak.wave import large_holograms

    unbroken = hologram_in_chunks(picture(), tmp_path / "a", 4, **PROBLEM).compute()
    whole, calls = large_holograms._State.finish, []

    def killed(state, loss):
        calls.append(loss)
        if len(calls) == 3:
            raise KeyboardInterrupt
        whole(state, loss)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(large_holograms._State, "finish", killed)
        hologram_in_chunks(picture(), tmp_path / "b", 4, **PROBLEM)
    assert sorted(path.name for path in (tmp_path / "b").iterdir()) == ["iteration_000002", "iteration_000003.part"]
    resumed = hologram_in_chunks(picture(), tmp_path / "b", 4, **PROBLEM).compute()
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["iteration_000004"]
    np.testing.assert_array_equal(resumed, unbroken)
    with pytest.raises(ValueError, match="state of another problem: other distance"):
        hologram_in_chunks(picture(), tmp_path / "b", 4, **{**PROBLEM, "distance": 3e-3})


def test_the_state_of_another_picture_is_refused(tmp_path):
    dask = pytest.importorskip("dask.array")
    pytest.importorskip("zarr")
    first = hologram_in_chunks(picture(), tmp_path, 1, **PROBLEM).compute()
    # The same picture, whatever its chunks.
    again = hologram_in_chunks(dask.asarray(picture()).rechunk(7), tmp_path, 1, **PROBLEM).compute()
    np.testing.assert_array_equal(again, first)
    with pytest.raises(ValueError, match="state of another problem: other target"):
        hologram_in_chunks(picture()[:, ::-1], tmp_path, 1, **PROBLEM)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    ["flipped", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("missing", "truncated", "array", "numbers"))],
)
def test_a_damaged_state_is_named_and_computed_again(damage, tmp_path):
    pytest.importorskip("zarr")
    whole = hologram_in_chunks(picture(), tmp_path / "a", 3, **PROBLEM)
    hologram_in_chunks(picture(), tmp_path / "b", 2, **PROBLEM)
    place = tmp_path / "b" / "iteration_000002"
    chunks = [path for path in (place / "phase.zarr").rglob("*") if path.is_file() and path.name.isdigit()]
    assert len(chunks) == whole.npartitions > 1
    chunk, named = sorted(chunks)[-1], r"chunk \d\.\d of phase\.zarr;"
    content = chunk.read_bytes()
    if damage == "missing":
        chunk.unlink()
    elif damage == "array":
        (place / "second.zarr" / "zarr.json").unlink()
        named = rf"(chunk \d\.\d of second\.zarr(, |;)){{{len(chunks)}}}"
    elif damage == "numbers":
        (place / "about.json").write_text((place / "about.json").read_text()[:-20])
        named = "about.json;"
    else:
        middle = len(content) // 2
        bent = bytes([content[middle] ^ 64])
        chunk.write_bytes(content[:middle] + (b"" if damage == "truncated" else bent + content[middle + 1 :]))
    with pytest.warns(odak.AccuracyWarning, match=f"iteration_000002' is damaged, missing or changed: {named}"):
        again = hologram_in_chunks(picture(), tmp_path / "b", 3, **PROBLEM)
    np.testing.assert_array_equal(again.compute(), whole.compute())
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["iteration_000003"]


def test_a_dark_target_is_refused(tmp_path):
    pytest.importorskip("zarr")
    with pytest.raises(ValueError, match="target must be finite and not all zero"):
        hologram_in_chunks(np.zeros((8, 8)), tmp_path, 1, **PROBLEM)


@pytest.mark.parametrize("method", ["AS", "Bandlimited Angular Spectrum", "TR Fresnel", "Impulse Response Fresnel"])
def test_propagation_through_files_is_that_in_memory(method, random, tmp_path):
    field = random.normal(size=(54, 75)) + 1j * random.normal(size=(54, 75))
    chunked = da.from_array(field.astype(np.complex64), chunks=(20, 30))
    geometry = {"distance": 5e-3, "dx": (8e-6, 7e-6), "wavelength": 532e-9, "propagation_type": method}
    stored = odak.wave.propagate_on_disk(chunked, tmp_path / "far.zarr", **geometry, memory=1 << 17, progress=False)
    expected = odak.wave.propagate_beam(field, None, **geometry, zero_padding=(True, False, True))
    found = stored.compute()
    assert found.dtype == np.complex64 and abs(found - expected).max() < 2e-6 * abs(expected).max()
    # What is there is replaced, and nothing else remains.
    again = odak.wave.propagate_on_disk(2 * field, tmp_path / "far.zarr", **geometry, progress=False)
    assert abs(again.compute() - 2 * expected).max() < 1e-12 * abs(expected).max()
    assert [entry.name for entry in tmp_path.iterdir()] == ["far.zarr"]


def test_propagation_through_files_leaves_no_pieces(tmp_path):
    geometry = {"distance": 1e-3, "dx": 8e-6, "wavelength": 532e-9, "progress": False}
    field = np.ones((16, 16), complex)
    (tmp_path / "notes").mkdir()
    with pytest.raises(ValueError, match="path must be new or a Zarr array"):
        odak.wave.propagate_on_disk(field, tmp_path / "notes", **geometry)
    odak.wave.propagate_on_disk(field, tmp_path / "far.zarr", **geometry)

    def broken():
        raise OSError("no space left on device")

    lazy = da.map_blocks(lambda: broken(), chunks=((16,), (16,)), dtype=complex, meta=np.empty((0, 0), complex))
    with pytest.raises(OSError, match="no space left"):
        odak.wave.propagate_on_disk(lazy, tmp_path / "far.zarr", **geometry)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["far.zarr", "notes"]
    assert da.from_zarr(str(tmp_path / "far.zarr")).shape == (16, 16)
    # The next propagation of a Dask array is one in memory again.
    assert odak.wave.propagate_beam(da.ones((8, 8), dtype=complex), None, 1e-3, 8e-6, 532e-9, "AS").compute().any()
