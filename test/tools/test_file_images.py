import os
import struct
import sys
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

import odak
from odak.learn import tools as learned
from odak.tools import file
from odak.tools.file import load_image, resize_image, save_image

CHANNELS = {2: 3, 4: 2, 6: 4}
PASSES = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("images")


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png(width, height, depth, colour, pixels, interlaced=0):
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", zlib.compress(pixels)) + chunk(b"IEND", b"")


def paeth(left, up, corner):
    nearest = min((abs(left + up - corner - value), rank, value) for rank, value in enumerate((left, up, corner)))
    return nearest[2]


def filtered(samples, kinds):
    """Filter rows byte by byte, as the PNG specification words it."""
    height, _, channels = samples.shape
    rows = samples.astype(">u2").reshape(height, -1).view(np.uint8).astype(int)
    step, out, above = 2 * channels, bytearray(), np.zeros(rows.shape[1], int)
    for row, kind in zip(rows, kinds, strict=True):
        out.append(kind)
        for i, value in enumerate(row):
            left, corner = (row[i - step], above[i - step]) if i >= step else (0, 0)
            up = above[i]
            guess = (0, left, up, (left + up) // 2, paeth(left, up, corner))[kind]
            out.append((value - guess) % 256)
        above = row
    return bytes(out)


@settings(max_examples=30)
@given(
    levels=st.sampled_from([np.uint8, np.uint16]).flatmap(
        lambda dtype: hnp.arrays(
            dtype,
            st.tuples(st.integers(1, 9), st.integers(1, 9), st.sampled_from([0, 1, 3, 4])).map(
                lambda shape: shape if shape[2] else shape[:2]
            ),
        )
    )
)
def test_png_keeps_every_level(folder, levels):
    path, white = str(folder / "levels.png"), np.iinfo(levels.dtype).max
    before = levels.copy()
    assert save_image(path, levels, cmin=0, cmax=white, color_depth=8 * levels.itemsize) is True
    assert np.array_equal(levels, before)
    loaded = load_image(path)
    assert loaded.dtype == np.float64
    assert np.array_equal(loaded, levels[..., 0] if levels.shape[2:] == (1,) else levels)
    first = load_image(path, normalizeby=float(white), torch_style=True)
    assert np.array_equal(first, (np.moveaxis(loaded, -1, 0) if loaded.ndim == 3 else loaded) / white)


@pytest.mark.parametrize("colour", [2, 4, 6])
def test_deep_colour_is_read_through_every_filter(tmp_path, random, colour):
    samples = random.integers(0, 65536, (15, 11, CHANNELS[colour])).astype(np.uint16)
    path = tmp_path / "deep.png"
    path.write_bytes(png(11, 15, 16, colour, filtered(samples, [k % 5 for k in range(15)])))
    expected = samples[..., [0, 0, 0, 1]] if colour == 4 else samples
    assert np.array_equal(load_image(path), expected)


def test_deep_colour_is_read_interlaced(tmp_path, random):
    samples = random.integers(0, 65536, (13, 10, 3)).astype(np.uint16)
    parts = [samples[top::down, left::right] for top, left, down, right in PASSES]
    data = b"".join(filtered(part, [k % 5 for k in range(len(part))]) for part in parts if part.size)
    path = tmp_path / "deep.png"
    path.write_bytes(png(10, 13, 16, 2, data, interlaced=1))
    assert np.array_equal(load_image(path), samples)


@pytest.mark.parametrize("order", ["<", ">"])
def test_deep_colour_is_read_from_tiff(tmp_path, random, order):
    samples = random.integers(0, 65536, (5, 7, 3)).astype(np.uint16)
    data = samples.astype(f"{order}u2").tobytes()
    entries = [(256, 4, 1, 7), (257, 4, 1, 5), (258, 3, 3, 8), (259, 4, 1, 1), (262, 4, 1, 2), (273, 4, 1, 14)]
    entries += [(277, 4, 1, 3), (278, 4, 1, 5), (279, 4, 1, len(data))]
    magic = b"II" if order == "<" else b"MM"
    directory = struct.pack(f"{order}H", len(entries)) + b"".join(struct.pack(f"{order}HHII", *e) for e in entries)
    head = magic + struct.pack(f"{order}HI", 42, 14 + len(data)) + struct.pack(f"{order}3H", 16, 16, 16)
    path = tmp_path / "deep.tif"
    path.write_bytes(head + data + directory + bytes(4))
    assert np.array_equal(load_image(path), samples)


@pytest.mark.parametrize("compression", [1, 5, 8, 32773], ids=["none", "lzw", "deflate", "packbits"])
@pytest.mark.parametrize("channels", [3, 4])
def test_deep_colour_is_read_from_compressed_tiff(tmp_path, random, compression, channels):
    """OpenCV writes LZW with differences of neighbours by default."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    samples = random.integers(0, 65536, (41, 29, channels)).astype(np.uint16)
    path, order = tmp_path / "deep.tif", [2, 1, 0, 3][:channels]
    assert cv2.imwrite(str(path), samples[..., order], [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    assert np.array_equal(load_image(path), samples)
    path.write_bytes(path.read_bytes()[: -len(path.read_bytes()) // 2])
    with pytest.raises(ValueError, match=r"Failed to load image .*deep\.tif'"):
        load_image(path)


def test_radiances_are_read(tmp_path):
    """Against the formula of Radiance's pixels: mantissas of 8 bits times two to the exponent less 136."""
    pytest.importorskip("cv2", reason="OpenCV is not installed")
    pixels = np.random.default_rng(0).integers(128, 256, (3, 5, 4)).astype(np.uint8)
    pixels[..., 3] = [120, 128, 129, 130, 140]
    header = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 3 +X 5\n"
    path = tmp_path / "a.hdr"
    path.write_bytes(header + pixels.tobytes())
    expected = pixels[..., :3] * 2.0 ** (pixels[..., 3:].astype(float) - 136)
    assert np.allclose(load_image(path), expected, rtol=1e-6)
    assert np.allclose(learned.load_image(path).numpy(), expected, rtol=1e-6)
    path.write_bytes(header.replace(b"-Y 3 +X 5", b"-Y 30000 +X 30000"))
    with pytest.raises(ValueError, match=r"a\.hdr': more than 89 megapixels are refused"):
        load_image(path)
    path.write_bytes(b"no picture")
    with pytest.raises(ValueError, match=r"a\.hdr': it is not a picture of Radiance"):
        load_image(path)


@pytest.mark.parametrize("channels", ["Y", "RGB", "RGBA"])
def test_pictures_of_openexr_are_read(tmp_path, channels):
    exr = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed")
    shape = (4, 6) if channels == "Y" else (4, 6, len(channels))
    picture = (20 * np.random.default_rng(0).random(shape)).astype(np.float32)
    path = tmp_path / "a.exr"
    exr.File({"type": exr.scanlineimage, "compression": exr.ZIP_COMPRESSION}, {channels: picture}).write(str(path))
    assert np.array_equal(load_image(path), picture)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(ValueError, match=r"a\.exr"):
        load_image(path)


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.webp"])
def test_photographs_are_turned_upright_once(tmp_path, orientation, name):
    """As Pillow's exif_transpose turns them, whatever the format; the corner that is brightest says where up is."""
    picture = np.zeros((16, 32, 3), np.uint8)
    picture[:8, :8], picture[8:, :8] = 250, 120
    image = Image.fromarray(picture)
    exif = image.getexif()
    exif[0x0112] = orientation
    image.save(tmp_path / name, exif=exif, **({"lossless": True} if name.endswith("webp") else {}))
    upright = {
        1: picture, 2: picture[:, ::-1], 3: picture[::-1, ::-1], 4: picture[::-1], 5: picture.swapaxes(0, 1),
        6: np.rot90(picture, -1), 7: picture[::-1, ::-1].swapaxes(0, 1), 8: np.rot90(picture),
    }[orientation]  # fmt: skip
    for found in (load_image(tmp_path / name), learned.load_image(tmp_path / name, normalizeby=0).numpy()):
        assert found.shape == upright.shape and np.abs(found - upright).max() < 30


def test_a_deep_photograph_is_turned_too(tmp_path, random):
    samples = random.integers(0, 65536, (3, 5, 3)).astype(np.uint16)
    save_image(tmp_path / "a.png", samples, 0, 65535, color_depth=16)
    image = Image.new("RGB", (1, 1))
    exif = image.getexif()
    exif[0x0112] = 6
    content = exif.tobytes()[6:] if exif.tobytes().startswith(b"Exif") else exif.tobytes()
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:33] + chunk(b"eXIf", content) + data[33:])
    assert np.array_equal(load_image(tmp_path / "a.png"), np.rot90(samples, -1))


def test_deep_colour_that_would_lose_bits_is_refused(tmp_path):
    path = tmp_path / "deep.ppm"
    path.write_bytes(b"P6 2 1 65535\n" + bytes(12))
    with pytest.raises(ValueError, match=r"deep\.ppm.*more than 8 bits.*use PNG"):
        load_image(path)


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.tiff", "a.bmp"])
@pytest.mark.parametrize("shape", [(6, 9), (6, 9, 3)])
def test_lossless_formats_keep_8_bits(tmp_path, random, name, shape):
    levels = random.integers(0, 256, shape)
    save_image(tmp_path / name, levels)
    assert np.array_equal(load_image(tmp_path / name), levels)


def test_jpeg_is_close(tmp_path):
    y, x = np.mgrid[0:32, 0:48]
    picture = np.stack([4 * x, 6 * y, 255 - 4 * x], axis=-1)
    save_image(tmp_path / "a.jpg", picture)
    assert np.abs(load_image(tmp_path / "a.jpg") - picture).max() < 8


def test_deep_grey_tiff_and_alpha_tiff(tmp_path, random):
    grey, alpha = random.integers(0, 65536, (6, 9)), random.integers(0, 256, (6, 9, 4))
    save_image(tmp_path / "grey.tif", grey, cmax=65535, color_depth=16)
    save_image(tmp_path / "alpha.tif", alpha)
    assert np.array_equal(load_image(tmp_path / "grey.tif"), grey)
    assert np.array_equal(load_image(tmp_path / "alpha.tif"), alpha)


def test_levels_are_rounded_between_the_limits(tmp_path):
    values = np.array([[-1.0, 0.0, 1.0, 0.3, np.nan, np.inf, -np.inf, 7.0]])
    save_image(tmp_path / "a.png", values, cmin=-1, cmax=1)
    assert load_image(tmp_path / "a.png").tolist() == [[0, 128, 255, 166, 0, 255, 0, 255]]
    save_image(tmp_path / "b.png", np.array([[True, False]]), cmax=1, color_depth=16)
    assert load_image(tmp_path / "b.png").tolist() == [[65535, 0]]


@pytest.mark.parametrize("mode, expected", [("1", (3, 4)), ("P", (3, 4, 3)), ("LA", (3, 4, 4)), ("L", (3, 4))])
def test_other_modes(tmp_path, mode, expected):
    picture = Image.new("L", (4, 3), 255).convert(mode)
    picture.save(tmp_path / "a.png")
    loaded = load_image(tmp_path / "a.png")
    assert loaded.shape == expected
    assert (loaded == 255).all()


def test_transparent_palette_float_tiff_and_gif(tmp_path):
    palette = Image.new("P", (4, 3), 1)
    palette.putpalette([0, 0, 0, 10, 20, 30])
    palette.save(tmp_path / "a.png", transparency=1)
    assert load_image(tmp_path / "a.png")[0, 0].tolist() == [10, 20, 30, 0]
    palette.save(tmp_path / "a.gif")
    assert load_image(tmp_path / "a.gif")[0, 0].tolist() == [10, 20, 30]
    Image.fromarray(np.full((3, 4), 0.25, np.float32)).save(tmp_path / "a.tif")
    assert (load_image(tmp_path / "a.tif") == 0.25).all()


@pytest.mark.parametrize(
    "name, image, options, reason",
    [
        ("a.png", np.zeros((2, 2)), {"color_depth": 12}, "color_depth must be 8 or 16"),
        ("a.png", np.zeros((2, 2)), {"cmax": 0}, "cmax must be larger than cmin"),
        ("a.png", np.zeros((2, 2)), {"cmin": np.nan}, "cmin must be finite"),
        ("a.png", np.zeros((2, 2, 2)), {}, r"img must be .* got \(2, 2, 2\)"),
        ("a.png", np.zeros((0, 2)), {}, "none empty"),
        ("a.jpg", np.zeros((2, 2)), {"color_depth": 16}, r"a\.jpg.*8 bits only"),
        ("a.bmp", np.zeros((2, 2)), {"color_depth": 16}, r"a\.bmp.*8 bits only"),
        ("a.tif", np.zeros((2, 2, 3)), {"color_depth": 16}, r"a\.tif.*16-bit grey only"),
        ("a.jpg", np.zeros((2, 2, 4)), {}, "cannot store an alpha channel"),
        ("a.gif", np.zeros((2, 2)), {}, "not allowed"),
        ("a", np.zeros((2, 2)), {}, "not allowed"),
        ("no/a.png", np.zeros((2, 2)), {}, r"Folder .*no' does not exist"),
        ("a\0.png", np.zeros((2, 2)), {}, "Null bytes"),
    ],
)
def test_what_cannot_be_saved(tmp_path, name, image, options, reason):
    with pytest.raises(ValueError, match=reason):
        save_image(f"{tmp_path}/{name}", image, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name, shape, depth", [("a.png", (4, 4), 8), ("a.png", (4, 4, 3), 16), ("a.jpg", (4, 4), 8)])
def test_a_failing_encoder_leaves_the_old_file(tmp_path, monkeypatch, name, shape, depth):
    path = tmp_path / name
    path.write_bytes(b"old")

    def fail(image, stream, *args, **kwargs):
        (image if depth == 16 else stream).write(b"half of")
        raise OSError("disk full")

    monkeypatch.setattr(*((file, "_write_deep_png") if depth == 16 else (Image.Image, "save")), fail)
    with pytest.raises(ValueError, match=rf"Failed to save image '.*{name}': disk full"):
        save_image(path, np.zeros(shape), color_depth=depth)
    assert path.read_bytes() == b"old"
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_unwritable_folder_is_permission_error_with_path(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")

    def refuse(*args):
        raise PermissionError(13, "Permission denied", args[0])

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with pytest.raises(PermissionError, match=r"a\.png"):
            save_image(path, np.zeros((2, 2)))
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda *args: False)
        with pytest.raises(PermissionError, match=r"write-protected.*a\.png"):
            save_image(path, np.zeros((2, 2)))
    assert path.read_bytes() == b"old"


def broken_files():
    whole = png(8, 8, 8, 0, bytes(72))
    deep = png(8, 8, 16, 2, bytes(8 * 49))
    flipped = bytearray(whole)
    flipped[45] ^= 1
    yield "empty.png", b"", ""
    yield "text.png", b"this is no image at all", "cannot identify"
    yield "half.png", whole[: len(whole) // 2], ""
    yield "half_deep.png", deep[: len(deep) // 2], ""
    yield "end.png", whole[:-12], "truncated"
    yield "flipped.png", bytes(flipped), "checksum"
    yield "few_rows.png", png(8, 8, 8, 0, bytes(20)), "truncated"
    yield "few_rows_deep.png", png(8, 8, 16, 2, bytes(100)), "truncated"
    yield "bomb.png", png(20000, 20000, 8, 0, bytes(100)), "89 megapixels"
    yield "bomb_deep.png", png(20000, 20000, 16, 2, bytes(100)), "89 megapixels"
    yield "page.jpg", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot identify"


@pytest.mark.parametrize("name, content, reason", [pytest.param(*case, id=case[0]) for case in broken_files()])
def test_broken_files_are_named(tmp_path, name, content, reason):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"Failed to load image '.*{name}': .*{reason}"):
        load_image(path)


def test_the_limit_holds_without_that_of_pillow(tmp_path, monkeypatch):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", None)
    (tmp_path / "bomb.png").write_bytes(png(20000, 20000, 8, 0, bytes(100)))
    with pytest.raises(ValueError, match=r"89 megapixels.*20000 x 20000"):
        load_image(tmp_path / "bomb.png")


def test_a_long_stream_in_a_small_picture_does_not_unfold(tmp_path):
    (tmp_path / "bomb.png").write_bytes(png(8, 8, 16, 2, bytes(50_000_000)))
    assert load_image(tmp_path / "bomb.png").shape == (8, 8, 3)


def test_what_is_not_a_file(tmp_path):
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    for name, reason in (("folder", "not a regular"), ("pipe", "not a regular"), ("none", "no such")):
        with pytest.raises(ValueError, match=rf"Failed to load image .*{name}\.png.*{reason} file"):
            load_image(tmp_path / f"{name}.png")
    with pytest.raises(ValueError, match=r"folder\.png' is not a file"):
        save_image(tmp_path / "folder.png", np.zeros((2, 2)))
    with pytest.raises(ValueError, match="Null bytes"):
        load_image("a\0.png")


@pytest.mark.parametrize("source, target", [((9, 12), (4, 3)), ((7, 5), (3, 4)), ((6, 4), (4, 6))])
def test_resizing_smaller_averages_areas(random, source, target):
    picture = random.random(source)
    height, width = target[1], target[0]
    fine = np.kron(picture, np.ones((height, width)))
    expected = fine.reshape(height, source[0], width, source[1]).mean((1, 3))
    assert np.allclose(resize_image(picture, target), expected, atol=1e-14)


def test_resizing_larger_is_bilinear_about_pixel_centres():
    ramp = np.arange(8.0)[None, :, None] * np.ones((3, 1, 3))
    larger = resize_image(ramp, [16, 6])
    assert larger.shape == (6, 16, 3)
    assert np.allclose(larger[2, :, 1], np.clip((np.arange(16) + 0.5) / 2 - 0.5, 0, 7))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64, bool])
def test_resizing_keeps_type_input_and_constants(dtype):
    picture = np.ones((5, 7), dtype)
    result = resize_image(picture, (3, 9))
    assert result.dtype == dtype
    assert result.shape == (9, 3)
    assert np.allclose(result, 1)
    same = resize_image(picture, (7, 5))
    assert np.array_equal(same, picture)
    assert not np.shares_memory(same, picture)


def test_one_axis_is_a_column(tmp_path):
    line = np.asarray([0.0, 100.0, 255.0])
    save_image(tmp_path / "a.png", line)
    assert load_image(tmp_path / "a.png").tolist() == [[0], [100], [255]]
    with pytest.raises(ValueError, match="img must be"):
        save_image(tmp_path / "a.png", np.empty(0))


def profile_of(matrix, gamma=563 / 256):
    """Return an ICC profile of three primaries, their XYZ under D50 in the columns of `matrix`, and a gamma curve."""

    def fixed(value):
        return struct.pack(">i", round(value * 65536))

    def xyz(values):
        return b"XYZ \0\0\0\0" + b"".join(fixed(value) for value in values)

    curve = b"curv\0\0\0\0" + struct.pack(">IHxx", 1, round(gamma * 256))
    text = b"text\0\0\0\0none\0\0\0\0"
    described = b"desc\0\0\0\0" + struct.pack(">I", 5) + b"test\0" + bytes(78)
    tags = {b"desc": described + bytes(-len(described) % 4), b"cprt": text, b"wtpt": xyz((0.9642, 1.0, 0.8249))}
    for name, column in zip((b"r", b"g", b"b"), np.transpose(matrix), strict=True):
        tags |= {name + b"XYZ": xyz(column), name + b"TRC": curve}
    start, table, content = 132 + 12 * len(tags), struct.pack(">I", len(tags)), b""
    for name, value in tags.items():
        table += name + struct.pack(">II", start + len(content), len(value))
        content += value
    header = struct.pack(">I4sI4s4s4s", start + len(content), bytes(4), 0x02100000, b"mntr", b"RGB ", b"XYZ ")
    header += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + xyz((0.9642, 1.0, 0.8249))[8:]
    return header.ljust(128, b"\0") + table + content


def test_colours_are_converted_by_the_profile_of_the_file(tmp_path):
    import torch

    from odak.learn.perception import change_primaries, linear_rgb_to_rgb

    # Columns of Display P3 adapted to D50, as its registered profile states them (ICC, "Display P3", 2017).
    p3 = [[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]]
    levels = np.asarray([[[200, 100, 50], [90, 140, 120], [128, 128, 128], [60, 80, 160]]], np.uint8)
    path = tmp_path / "phone.png"
    Image.fromarray(levels).save(path, icc_profile=profile_of(p3))
    assert (load_image(path) == levels).all()
    linear = torch.from_numpy((levels / 255.0) ** (563 / 256)).movedim(-1, 0)[None]
    expected = linear_rgb_to_rgb(change_primaries(linear, "Display P3", "BT.709").clamp(0, 1))
    found = load_image(path, color_managed=True)
    assert abs(found - 255 * expected[0].movedim(0, -1).numpy()).max() < 1.0
    assert abs(found - levels).max() > 10
    same = learned.load_image(path, color_managed=True)
    np.testing.assert_allclose(255 * same.numpy(), found, atol=1e-4)
    Image.fromarray(np.dstack([levels, np.full((1, 4, 1), 77, np.uint8)])).save(path, icc_profile=profile_of(p3))
    with_alpha = load_image(path, color_managed=True)
    assert (with_alpha[..., :3] == found).all() and (with_alpha[..., 3] == 77).all()


def test_a_broken_profile_is_named(tmp_path):

    path = tmp_path / "broken.png"
    Image.new("RGB", (4, 4), (10, 20, 30)).save(path, icc_profile=b"no profile at all" * 20)
    assert load_image(path)[0, 0].tolist() == [10.0, 20.0, 30.0]
    with pytest.raises(ValueError, match="its colour profile cannot be used"):
        load_image(path, color_managed=True)


@pytest.mark.parametrize("kind", ["tif", "gif", "webp", "png"])
def test_pages_are_read_on_request_and_told_of_otherwise(tmp_path, kind):
    levels = np.asarray([0, 100, 200], np.uint8)
    frames = [Image.fromarray(np.full((4, 6, 3), level, np.uint8)) for level in levels]
    path = tmp_path / f"stack.{kind}"
    frames[0].save(path, save_all=True, append_images=frames[1:], **({"lossless": True} if kind == "webp" else {}))
    with pytest.warns(odak.ArgumentWarning, match=r"has 3 frames or pages; the first one is used") as caught:
        first = load_image(path)
    assert len(caught) == 1 and first.shape == (4, 6, 3) and (first == 0).all()
    stack = load_image(path, pages="all")
    assert stack.shape == (3, 4, 6, 3) and np.array_equal(stack[:, 0, 0, 0], levels)
    assert np.array_equal(load_image(path, pages=[2, 0], torch_style=True), np.moveaxis(stack[[2, 0]], -1, 1))
    assert np.array_equal(load_image(path, pages=1), stack[1])
    learnt = learned.load_image(path, pages="all", torch_style=True)
    assert np.allclose(learnt.numpy(), np.moveaxis(stack, -1, 1) / 255)
    for pages, error in ((3, ValueError), ([], ValueError), ("most", ValueError), (1.5, TypeError), (-1, ValueError)):
        with pytest.raises(error, match="pages must be"):
            load_image(path, pages=pages)


def test_a_tiff_without_pages_is_called_damaged(tmp_path):
    # The header of a TIFF whose writer was interrupted: no directory follows.
    (tmp_path / "none.tif").write_bytes(b"II*\0\0\0\0\0")
    with pytest.raises(ValueError, match="no pages: it is damaged or incomplete"):
        load_image(tmp_path / "none.tif")


def test_deep_pages_and_pages_of_several_sizes(tmp_path, random):
    tifffile = pytest.importorskip("tifffile")
    deep = random.integers(0, 65536, (3, 5, 7, 3)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "deep.tif", deep, photometric="rgb")
    assert np.array_equal(load_image(tmp_path / "deep.tif", pages="all"), deep)
    with tifffile.TiffWriter(tmp_path / "sizes.tif") as writer:
        writer.write(deep[0])
        writer.write(deep[0, :3])
    with pytest.raises(ValueError, match=r"pages of .*sizes\.tif' differ in shape or type"):
        load_image(tmp_path / "sizes.tif", pages="all")
    assert np.array_equal(load_image(tmp_path / "sizes.tif", pages=1), deep[0, :3])


@pytest.mark.parametrize("dtype", ["float16", "float32", "uint16"])
@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_floating_point_colour_and_planes_of_tiff(tmp_path, random, dtype, planar, monkeypatch):
    tifffile = pytest.importorskip("tifffile")
    picture = (random.random((5, 7, 3)) * (1 if "float" in dtype else 65535)).astype(dtype)
    given = np.moveaxis(picture, -1, 0) if planar == "separate" else picture
    # Orientation 6: the first row of the file is the right side of the picture.
    tifffile.imwrite(tmp_path / "a.tif", given, photometric="rgb", planarconfig=planar, extratags=[(274, 3, 1, 6)])
    levels = file.read_levels(tmp_path / "a.tif")
    assert levels.dtype == ("uint16" if dtype == "uint16" else "float32")
    assert np.array_equal(levels, np.rot90(picture, -1).astype(levels.dtype))
    if planar == "separate":
        monkeypatch.setitem(sys.modules, "tifffile", None)
        with pytest.raises(ValueError, match=r"Failed to load image .*a\.tif'.*pip install tifffile"):
            load_image(tmp_path / "a.tif")


def test_tiffs_that_remain_refused(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((3, 4, 3), np.int64), photometric="rgb")
    with pytest.raises(ValueError, match="its samples are int64"):
        load_image(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((6, 4, 5), np.float32), photometric="rgb", planarconfig="contig")
    with pytest.raises(ValueError, match="it has 5 samples of RGB"):
        load_image(tmp_path / "b.tif")
