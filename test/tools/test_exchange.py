"""Fields in xarray, OME-TIFF and napari: round trips, what other programs read of the files, and refusals."""

import json
import sys
import types
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

from odak.tools import load_ome_tiff, napari_reader, save_ome_tiff, to_xarray

WAVES = (639e-9, 515e-9, 473e-9)


def field(*shape, dtype=np.complex64):
    values = np.random.default_rng(0).normal(size=(2, *shape))
    return (values[0] + 1j * values[1]).astype(dtype)


class DataArray:
    """Stands in for that of xarray: keeps what it is given."""

    def __init__(self, data, coords, dims, name):
        self.data, self.coords, self.dims, self.name = data, coords, tuple(dims), name
        assert all(len(value) == data.shape[self.dims.index(d[0])] for d, value, _ in coords.values() if d)


def with_xarray(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", types.SimpleNamespace(DataArray=DataArray))


def test_to_xarray(monkeypatch):
    with_xarray(monkeypatch)
    values = torch.from_numpy(field(5, 2, 3, 4, 6)).requires_grad_()
    found = to_xarray(values, (8e-6, 4e-6), WAVES, torch.tensor([1e-3, 2e-3]))
    assert found.dims == ("frame", "z", "wavelength", "y", "x")
    assert found.coords["wavelength"][1].tolist() == list(WAVES)
    np.testing.assert_allclose(found.coords["y"][1], [-16e-6, -8e-6, 0, 8e-6])
    np.testing.assert_allclose(found.coords["x"][1], np.arange(-3, 3) * 4e-6)
    assert all(attributes == {"units": "m"} for _, _, attributes in found.coords.values())
    np.testing.assert_array_equal(found.data, values.detach().numpy())
    assert not np.shares_memory(found.data, values.detach().numpy())
    plain = to_xarray(values.detach().numpy(), 8e-6, 532e-9, -0.1, name="u")
    assert plain.dims == ("frame_0", "frame_1", "frame_2", "y", "x")
    assert (plain.coords["wavelength"][:2], plain.coords["z"][:2]) == (((), 532e-9), ((), -0.1))
    with pytest.raises(ValueError, match="wavelength must be one number, or as many as an axis of field has samples"):
        to_xarray(values, 8e-6, [532e-9] * 4)
    with pytest.raises(ValueError, match="distance must be one number"):
        to_xarray(field(3, 4, 6), 8e-6, WAVES, [0.1, 0.2])
    with pytest.raises(ValueError, match="pitch"):
        to_xarray(values, -8e-6)
    with pytest.raises(TypeError, match="field must be an array"):
        to_xarray([[1.0]], 8e-6)


def test_xarray_itself():
    pytest.importorskip("xarray")
    found = to_xarray(field(3, 4, 6), 8e-6, WAVES, 0.1)
    assert found.sel(x=8e-6, y=0, wavelength=500e-9, method="nearest").item() == field(3, 4, 6)[1, 2, 4]
    assert found.x.units == "m"
    assert float(found.z) == 0.1


def test_packages_that_are_missing(monkeypatch, tmp_path):
    for module in ("xarray", "tifffile"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match="pip install xarray"):
        to_xarray(field(4, 6), 8e-6)
    with pytest.raises(ImportError, match="pip install tifffile"):
        save_ome_tiff(tmp_path / "field.ome.tif", field(4, 6), 8e-6)


@pytest.mark.parametrize("dtype", [np.complex64, np.complex128, np.float32, np.float64, np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(4, 6), (3, 4, 6), (5, 3, 4, 6), (2, 5, 3, 4, 6)])
def test_round_trip(tmp_path, shape, dtype):
    pytest.importorskip("tifffile")
    values = field(*shape, dtype=np.complex128)
    values = values.astype(dtype) if np.dtype(dtype).kind == "c" else np.abs(50 * values.real).astype(dtype)
    path = tmp_path / "field.ome.tif"
    colours = WAVES if len(shape) > 3 else 532e-9
    save_ome_tiff(path, torch.from_numpy(values), (7.56e-6, 3.74e-6), 1.1e-3, colours)
    found, lengths = load_ome_tiff(path)
    np.testing.assert_array_equal(found, values)
    assert found.dtype == dtype
    assert lengths["pitch"] == pytest.approx((7.56e-6, 3.74e-6), rel=1e-15)
    assert lengths["spacing"] == pytest.approx(1.1e-3, rel=1e-15)
    assert lengths["wavelength"] == pytest.approx(WAVES if len(shape) > 3 else (532e-9,), rel=1e-15)


def test_numbers_without_a_name_in_ome_are_refused(tmp_path):
    pytest.importorskip("tifffile")
    with pytest.raises(TypeError, match=r"field must be of bool, int8.* for OME-TIFF, got int64"):
        save_ome_tiff(tmp_path / "field.ome.tif", np.ones((4, 6), dtype=np.int64), 8e-6)


def test_what_other_programs_read(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "field.ome.tif"
    save_ome_tiff(path, field(2, 3, 4, 6), 8e-6, 2e-3, WAVES)
    with tifffile.TiffFile(path) as file:
        assert (file.is_ome, file.series[0].axes, file.series[0].dtype) == (True, "ZCYX", np.complex64)
        text = file.ome_metadata
    name = "{http://www.openmicroscopy.org/Schemas/OME/2016-06}"
    pixels = ElementTree.fromstring(text).find(f"{name}Image/{name}Pixels")
    assert (pixels.get("Type"), pixels.get("PhysicalSizeXUnit")) == ("complex", "µm")
    assert (float(pixels.get("PhysicalSizeX")), float(pixels.get("PhysicalSizeZ"))) == (8.0, 2000.0)
    assert [float(one.get("EmissionWavelength")) for one in pixels.iter(f"{name}Channel")] == [639, 515, 473]


def test_written_by_others(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "other.ome.tif"
    values = np.arange(24, dtype=np.uint16).reshape(4, 6)
    tifffile.imwrite(path, values, ome=True, metadata={"axes": "YX"})
    found, lengths = load_ome_tiff(path)
    np.testing.assert_array_equal(found, values)
    assert lengths == {"pitch": None, "spacing": None, "wavelength": None}
    size = {"PhysicalSizeX": 0.5, "PhysicalSizeXUnit": "mm", "PhysicalSizeY": 250, "PhysicalSizeYUnit": "nm"}
    tifffile.imwrite(path, values, ome=True, metadata={"axes": "YX", **size})
    assert load_ome_tiff(path)[1]["pitch"] == pytest.approx((250e-9, 0.5e-3))
    tifffile.imwrite(path, values, ome=False)
    with pytest.raises(ValueError, match="as OME-TIFF: no OME-XML"):
        load_ome_tiff(path)
    tifffile.imwrite(path, np.zeros((4, 6, 3), np.uint8), ome=True, photometric="rgb")
    with pytest.raises(ValueError, match="as OME-TIFF"):
        load_ome_tiff(path)


def test_broken_files(tmp_path):
    pytest.importorskip("tifffile")
    path = tmp_path / "field.ome.tif"
    save_ome_tiff(path, field(2, 4, 6), 8e-6)
    whole = path.read_bytes()
    random = np.random.default_rng(1)
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="as OME-TIFF"):
            load_ome_tiff(path)
    for _ in range(60):
        damaged = bytearray(whole)
        for place in random.integers(len(whole), size=8):
            damaged[place] = random.integers(256)
        path.write_bytes(damaged)
        try:
            assert load_ome_tiff(path)[0].nbytes <= 1032 * len(whole)
        except ValueError as error:
            assert "as OME-TIFF" in str(error)
    with pytest.raises(FileNotFoundError):
        load_ome_tiff(tmp_path / "none.ome.tif")


def test_an_older_file_stays(tmp_path, monkeypatch):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "field.ome.tif"
    save_ome_tiff(path, field(4, 6), 8e-6)
    before = path.read_bytes()

    def half(name, *_, **__):
        Path(name).write_bytes(b"II")
        raise OSError("No space left on device")

    monkeypatch.setattr(tifffile, "imwrite", half)
    with pytest.raises(OSError, match="No space left"):
        save_ome_tiff(path, field(4, 6), 8e-6)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_refused(tmp_path):
    pytest.importorskip("tifffile")
    path = tmp_path / "field.ome.tif"
    with pytest.raises(ValueError, match=r"field must have 2 to 5 axes, none empty, got \[6\]"):
        save_ome_tiff(path, field(6), 8e-6)
    with pytest.raises(ValueError, match="wavelength must be one for each of 3 colours of field, got 2"):
        save_ome_tiff(path, field(1, 3, 4, 6), 8e-6, wavelength=[1e-6, 2e-6])
    with pytest.raises(ValueError, match="spacing"):
        save_ome_tiff(path, field(4, 6), 8e-6, spacing=0)
    with pytest.raises(ValueError, match="Extension"):
        save_ome_tiff(tmp_path / "field.png", field(4, 6), 8e-6)
    with pytest.raises(TypeError, match="field must hold"):
        save_ome_tiff(path, np.array([["a"]]), 8e-6)
    assert not list(tmp_path.iterdir())


def test_napari_finds_the_reader():
    manifest = json.loads((files("odak") / "napari.json").read_text())
    (command,), (reader,) = manifest["contributions"]["commands"], manifest["contributions"]["readers"]
    assert manifest["name"] == "odak-optics"
    assert command["id"] == reader["command"]
    module, name = command["python_name"].split(":")
    assert getattr(import_module(module), name) is napari_reader


def test_napari_layers(tmp_path):
    pytest.importorskip("tifffile")
    path = str(tmp_path / "field.ome.tif")
    values = field(3, 4, 6)
    save_ome_tiff(path, values, (8e-6, 4e-6), 1e-3)
    (amplitude, first, kind), (phase, second, _) = napari_reader(path)(path)
    np.testing.assert_allclose(amplitude * np.exp(1j * phase), values, rtol=1e-5)
    assert (kind, first["name"], second["colormap"]) == ("image", "field.ome.tif amplitude", "twilight")
    assert first["scale"] == pytest.approx((1000, 8, 4))
    np.save(tmp_path / "field.npy", values)
    assert napari_reader(str(tmp_path / "field.npy"))(str(tmp_path / "field.npy"))[1][1]["scale"] == (1, 1, 1)
    np.save(tmp_path / "real.npy", values.real)
    np.save(tmp_path / "objects.npy", np.array([{}]), allow_pickle=True)
    for other in ("real.npy", "objects.npy", "none.npy", "picture.png"):
        assert napari_reader(str(tmp_path / other)) is None
    assert napari_reader([path]) is None


UUID = '<UUID FileName="{}">urn:uuid:2</UUID>'


@pytest.mark.parametrize("name", ["../other.ome.tif", "/tmp/other.ome.tif", "other.ome.tif"])
def test_pictures_of_other_files_are_refused(name, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    for path in (tmp_path / "inside" / "other.ome.tif", tmp_path / "other.ome.tif"):
        path.parent.mkdir(exist_ok=True)
        save_ome_tiff(path, np.full((4, 6), 7.0), 8e-6)
    path = tmp_path / "inside" / "field.ome.tif"
    save_ome_tiff(path, np.zeros((4, 6)), 8e-6)
    with tifffile.TiffFile(path) as file:
        text = file.ome_metadata
    block = text[text.index("<TiffData") : text.index("/>", text.index("<TiffData"))]
    tifffile.imwrite(
        path,
        np.zeros((4, 6)),
        description=text.replace(f"{block}/>", f"{block}>{UUID.format(name)}</TiffData>").encode(),
    )
    with pytest.raises(ValueError, match="lie in another file"):
        load_ome_tiff(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('SizeZ="1"', 'SizeZ="1000000000"'),
        ('PlaneCount="1"', 'PlaneCount="1000000000"'),
        ('IFD="0"', 'IFD="1000000000"'),
        ('SizeT="1"', 'SizeT="-1"'),
    ],
)
def test_planes_that_a_file_cannot_hold_are_refused(old, new, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    path = tmp_path / "field.ome.tif"
    save_ome_tiff(path, np.zeros((4, 6)), 8e-6)
    with tifffile.TiffFile(path) as file:
        text = file.ome_metadata
    assert old in text
    tifffile.imwrite(path, np.zeros((4, 6)), description=text.replace(old, new).encode())
    with pytest.raises(ValueError, match="more than its bytes can hold"):
        load_ome_tiff(path)
