import json
import math
import struct
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import odak
from odak.learn.perception import color_matching_functions, rgb_to_xyz_matrix
from odak.learn.wave import AmplitudePanel, Display, Modulator, Run, fitted, light_of, optimise, picture_of
from odak.tools import load_image, save_image

pytestmark = pytest.mark.usefixtures("small_judge")

SOURCES = (638e-9, 520e-9, 450e-9)


def decoded(values):
    """Return linear intensities of sRGB values: IEC 61966-2-1, section 5.2, written out once more."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def mixture(light):
    """Return XYZ of the mixture of the sources, in units of the luminance of white: W times lumens per watt."""
    functions = color_matching_functions([1e9 * w for w in light.wavelengths])
    return torch.einsum("xc,chw->xhw", 683.002 * functions * light.watts, light.targets.double())


def inner_picture(seed=0):
    return torch.rand(3, 9, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)) * 0.5 + 0.4


def test_a_mid_grey_is_a_fifth_of_the_light_of_white():
    for value, light in ((0.5, 0.21404114), (0.0, 0.0), (1.0, 1.0), (0.04, 0.04 / 12.92)):
        found = light_of(torch.full((4, 5), value, dtype=torch.float64), SOURCES)
        assert found.targets.shape == (3, 4, 5)
        assert float((found.targets - light).abs().max()) < 1e-8
        assert found.outside == 0


def test_the_powers_mix_to_white():
    light = light_of(torch.ones(3, 1, 1, dtype=torch.float64), SOURCES)
    x, y = 0.3127, 0.3290
    white = torch.tensor([x / y, 1.0, (1 - x - y) / y], dtype=torch.float64)
    assert float((mixture(light).flatten() - white).abs().max()) < 1e-9
    assert float(light.lumens.sum()) == pytest.approx(1, abs=1e-12)
    # Of a source of 555 nm alone a lumen is 1/683 W.
    assert float(light_of(torch.ones(1, 1), 555e-9).watts) == pytest.approx(1 / 683.002, rel=1e-6)


def test_colours_inside_the_gamut_are_reproduced():
    picture = inner_picture()
    light = light_of(picture, SOURCES)
    wanted = torch.einsum("xc,chw->xhw", rgb_to_xyz_matrix(), torch.from_numpy(decoded(picture.numpy())))
    assert light.outside == 0
    assert float((mixture(light) - wanted).abs().max()) < 1e-6
    assert float((picture_of(light.targets, SOURCES) - picture).abs().max()) < 1e-9


def test_linear_light_is_not_decoded_again():
    picture = inner_picture()
    encoded, linear = (
        light_of(picture, SOURCES),
        light_of(torch.from_numpy(decoded(picture.numpy())), SOURCES, linear=True),
    )
    assert float((encoded.targets - linear.targets).abs().max()) < 1e-12
    assert (encoded.source, linear.source) == ("sRGB", "linear light")


def test_colours_outside_the_gamut_keep_luminance_and_hue():
    """Sources near each other leave out red, green and blue."""
    sources = (600e-9, 560e-9, 480e-9)
    picture = torch.zeros(3, 1, 4, dtype=torch.float64)
    picture[0, 0, 0] = picture[1, 0, 1] = picture[2, 0, 2] = 1.0
    picture[:, 0, 3] = 0.7
    wanted = torch.einsum("xc,chw->xhw", rgb_to_xyz_matrix(), torch.from_numpy(decoded(picture.numpy())))
    light = light_of(picture, sources)
    assert light.outside == 0.75
    assert float(light.targets.min()) >= 0
    assert float(light.targets[:, 0, :3].amin(0).max()) < 1e-12
    found = mixture(light)
    assert float((found[1] - wanted[1]).abs().max()) < 1e-9
    white = torch.tensor([0.3127, 0.3290], dtype=torch.float64)
    for pixel in range(3):
        to_found, to_wanted = (xyz[:2, 0, pixel] / xyz[:, 0, pixel].sum() - white for xyz in (found, wanted))
        cross = to_found[0] * to_wanted[1] - to_found[1] * to_wanted[0]
        assert abs(float(cross)) < 1e-9 and float(to_found @ to_wanted) > 0
        assert float(to_found.norm()) < float(to_wanted.norm())
    clipped = light_of(picture, sources, gamut="clip")
    assert clipped.outside == 0.75 and clipped.gamut == "clip"
    assert bool((mixture(clipped)[1, 0, :3] > wanted[1, 0, :3] + 1e-6).all())


def test_grey_is_luminance_in_linear_light():
    picture = inner_picture()
    luminance = torch.einsum("c,chw->hw", rgb_to_xyz_matrix()[1], torch.from_numpy(decoded(picture.numpy())))
    one = light_of(picture, 532e-9)
    assert float((one.targets - luminance).abs().max()) < 1e-9
    three = light_of(picture, SOURCES, grey=True)
    assert three.targets.shape == (3, 9, 7)
    assert float((three.targets - luminance).abs().max()) < 1e-9
    shown = picture_of(one.targets, 532e-9)
    assert float((torch.from_numpy(decoded(shown.numpy())) - luminance).abs().max()) < 1e-9


def profile(primaries, curve, kind=b"RGB "):
    """Return an ICC profile of chromaticities, adapted to D50 by Bradford, and one curve."""
    white = np.array([0.3127 / 0.3290, 1, (1 - 0.3127 - 0.3290) / 0.3290])
    columns = np.array([[x / y, 1, (1 - x - y) / y] for x, y in primaries]).T
    cones = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    d50 = np.array([0.9642, 1, 0.8249])
    adapted = np.linalg.inv(cones) @ np.diag(cones @ d50 / (cones @ white)) @ cones
    columns = adapted @ (columns * np.linalg.solve(columns, white))

    def fixed(values):
        return struct.pack(f">{len(values)}i", *(round(65536 * v) for v in values))

    text = b"desc" + bytes(4) + struct.pack(">I", 5) + b"Test\0" + bytes(80)
    tags = {b"desc": text, b"cprt": b"text" + bytes(4) + b"none\0", b"wtpt": b"XYZ " + bytes(4) + fixed(d50)}
    if kind == b"GRAY":
        tags[b"kTRC"] = curve
    else:
        for k, letter in enumerate((b"r", b"g", b"b")):
            tags[letter + b"XYZ"] = b"XYZ " + bytes(4) + fixed(columns[:, k])
            tags[letter + b"TRC"] = curve
    table, data = b"", b""
    for name, content in tags.items():
        content += bytes(-len(content) % 4)
        table += struct.pack(">4sII", name, 132 + 12 * len(tags) + len(data), len(content))
        data += content
    body = struct.pack(">I", len(tags)) + table + data
    head = struct.pack(
        ">I4sI4s4s4s12s4s", 128 + len(body), bytes(4), 0x02400000, b"mntr", kind, b"XYZ ", bytes(12), b"acsp"
    )
    head += bytes(68 - len(head)) + fixed(d50)
    return head + bytes(128 - len(head)) + body


GAMMA = b"curv" + bytes(4) + struct.pack(">IH", 1, round(256 * 563 / 256))
SRGB = (
    b"para"
    + bytes(4)
    + struct.pack(">HH5i", 3, 0, *(round(65536 * v) for v in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)))
)
ADOBE = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
P3 = ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06))


@pytest.mark.parametrize(
    ("primaries", "curve", "decode"),
    [(ADOBE, GAMMA, lambda v: v ** (563 / 256)), (P3, SRGB, decoded)],
    ids=["Adobe RGB", "Display P3"],
)
def test_the_profile_of_a_file_counts(primaries, curve, decode, tmp_path):
    """Colours beyond sRGB stay: XYZ of the mixture is XYZ of the picture by the profile's primaries."""
    levels = np.random.default_rng(1).integers(90, 240, (6, 5, 3), dtype=np.uint8)
    levels[0, 0] = (60, 240, 90)
    path = tmp_path / "picture.png"
    Image.fromarray(levels).save(path, icc_profile=profile(primaries, curve))
    light = light_of(path, SOURCES)
    wanted = torch.einsum(
        "xc,hwc->xhw", rgb_to_xyz_matrix(primaries), torch.from_numpy(decode(levels.astype(float) / 255))
    )
    assert light.outside == 0 and "picture.png (Test)" in light.source
    # Profiles hold five digits.
    assert float((mixture(light) - wanted).abs().max()) < 1e-4
    ignored = light_of(levels.astype(np.float32).transpose(2, 0, 1) / 255, SOURCES)
    assert float((ignored.targets - light.targets).abs().max()) > 0.02
    # Of pictures in which sRGB holds all colours, the colour management of Pillow finds the same to its 8 bits.
    inside = np.random.default_rng(2).integers(140, 160, (6, 5, 3), dtype=np.uint8)
    Image.fromarray(inside).save(path, icc_profile=profile(primaries, curve))
    managed = odak.tools.load_image(path, 255.0, True, color_managed=True)
    assert (
        float((picture_of(light_of(path, SOURCES).targets, SOURCES) - torch.from_numpy(managed)).abs().max()) < 1 / 255
    )


def test_files_of_grey_of_16_bits_of_alpha_and_without_a_profile(tmp_path):
    deep = np.random.default_rng(0).integers(0, 65535, (5, 4, 3))
    save_image(str(tmp_path / "deep.png"), deep, cmax=65535, color_depth=16)
    found = light_of(str(tmp_path / "deep.png"), 532e-9)
    luminance = decoded(deep / 65535) @ rgb_to_xyz_matrix()[1].numpy()
    assert np.abs(found.targets[0].numpy() - luminance).max() < 1e-6
    grey = np.full((4, 4), 188, dtype=np.uint8)
    Image.fromarray(grey).save(tmp_path / "grey.png", icc_profile=profile(ADOBE, GAMMA, b"GRAY"))
    found = light_of(tmp_path / "grey.png", SOURCES)
    assert float((found.targets - (188 / 255) ** (563 / 256)).abs().max()) < 1e-4
    see_through = np.full((4, 4, 4), 255, dtype=np.uint8)
    see_through[:2, :, 3] = 0
    Image.fromarray(see_through).save(tmp_path / "alpha.png")
    assert light_of(tmp_path / "alpha.png", 532e-9).targets[0, :, 0].tolist() == [0, 0, 1, 1]
    Image.fromarray(grey).save(tmp_path / "cmyk.jpg", icc_profile=profile(ADOBE, GAMMA, b"GRAY")[:140])
    with pytest.raises(ValueError, match="colour profile in the file cannot be used"):
        light_of(tmp_path / "cmyk.jpg", SOURCES)


def test_files_of_linear_light_are_not_decoded(monkeypatch):
    values = np.random.default_rng(0).random((3, 6, 5)).astype(np.float32)
    monkeypatch.setattr("odak.learn.wave.pictures.read_levels", lambda path, torch_style: values)
    luminance = np.einsum("c,chw->hw", rgb_to_xyz_matrix()[1].numpy(), values)
    for name in ("light.exr", "light.hdr"):
        found = light_of(name, 532e-9)
        assert np.abs(found.targets[0].numpy() - luminance).max() < 1e-6
        assert found.source == f"{name} (linear light)"
    stated = light_of("scan.tif", 532e-9, linear=True)
    assert np.abs(stated.targets[0].numpy() - luminance).max() < 1e-6


def test_gradients_and_batches():
    sources = (600e-9, 560e-9, 480e-9)
    picture = (inner_picture()[:, :2, :2] - 0.35).requires_grad_()
    assert torch.autograd.gradcheck(lambda p: light_of(p, sources).targets, picture, fast_mode=True)
    images = torch.rand(2, 3, 2, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda i: picture_of(0.9 * i, sources), images, fast_mode=True)
    assert picture_of(images, sources).shape == (2, 3, 2, 2)
    assert picture_of(torch.rand(2, 1, 4, 5), 532e-9).shape == (2, 3, 4, 5)
    assert light_of(torch.rand(3, 4, 5), SOURCES).targets.dtype == torch.float32


def test_a_display_gives_its_sources_and_the_result_shows_itself():
    display = Display(Modulator((8, 8), 8e-6), SOURCES, 2e-3)
    light = light_of(torch.ones(3, 8, 8), display)
    assert light.wavelengths == display.wavelengths
    assert "638 nm 2.1 mW" in repr(light) and "0.0% of the pixels outside" in repr(light)
    assert "on a screen" in light._repr_html_() and len(light.table()) == 3
    assert math.isclose(sum(row["lumens"] for row in light.table()), 1)
    assert float((picture_of(light.targets[None], display) - 1).abs().max()) < 1e-5


def test_what_cannot_be_mixed_is_refused():
    picture = torch.ones(3, 2, 2)
    with pytest.raises(ValueError, match="display must have one source or three, whose colours can be mixed, got 2"):
        light_of(picture, SOURCES[:2])
    with pytest.raises(ValueError, match="display must have visible sources, got 638 nm, 520 nm, 1550 nm"):
        light_of(picture, (638e-9, 520e-9, 1550e-9))
    with pytest.raises(ValueError, match="display must have sources whose mixture can be white, got 638 nm"):
        light_of(picture, (638e-9, 620e-9, 600e-9))
    with pytest.raises(ValueError, match=r"picture must be \[3, rows, columns\] or \[rows, columns\], got \[2, 2, 2\]"):
        light_of(picture[:2], SOURCES)
    with pytest.raises(ValueError, match="gamut must be"):
        light_of(picture, SOURCES, gamut="perceptual")
    with pytest.raises(ValueError, match=r"images must be pictures \[..., 3, H, W\]"):
        picture_of(torch.ones(1, 2, 2), SOURCES)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        light_of(255 * picture, SOURCES)
    assert caught and issubclass(caught[0].category, odak.OdakWarning)


def test_holograms_show_their_images_as_screens_do():
    display = Display(Modulator((16, 16), 8e-6), SOURCES, 2e-3)
    picture = inner_picture().float()[:, :1, :1].expand(3, 16, 16)
    hologram = optimise(display, light_of(picture, display).targets, run=Run(iterations=1, progress=False))
    exact = replace(hologram, images=hologram.target)
    assert float((exact.pictures() - picture).abs().max()) < 1e-4
    assert exact.pictures(0).shape == (3, 16, 16)
    assert "target" in exact._repr_html_()
    with pytest.raises(ValueError, match="plane must be -1 to 0, got 1"):
        exact.pictures(1)
    # Sources without a white are shown grey.
    two = Display(Modulator((16, 16), 8e-6), SOURCES[:2], 2e-3)
    hologram = optimise(two, torch.rand(2, 16, 16), run=Run(iterations=1, progress=False))
    shown = hologram.pictures(0)
    assert float((shown[0] - shown[2]).abs().max()) < 1e-6
    grey = decoded(shown[0].double().numpy())
    assert np.abs(grey - hologram.images[0].mean(0).clamp(0, 1).numpy()).max() < 1e-5


@pytest.mark.parametrize("pitch", [8e-6, (16e-6, 8e-6)])
def test_a_circle_fitted_to_a_panel_is_one_in_metres(pitch):
    display = Display(Modulator((60, 100), pitch, fill=1.0), 532e-9, 2e-3)
    y, x = torch.meshgrid(torch.arange(301.0) - 150, torch.arange(301.0) - 150, indexing="ij")
    disc = (y**2 + x**2 < 100**2).double()
    down, across = display.path.pitches
    sides = (60 * down, 100 * across)
    for how, side in (("pad", min(sides)), ("crop", max(sides))):
        frame = fitted(disc, display, how)
        assert frame.shape == (60, 100) and frame.min() >= 0
        # Area and, where it is whole, the second moments of a disc of a third of the side of the square.
        radius = side / 3
        if 2 * radius < min(sides):
            area = float(frame.sum()) * down * across
            assert area == pytest.approx(torch.pi * radius**2, rel=0.02)
        rows, columns = ((torch.arange(n) - (n - 1) / 2) * p for n, p in ((60, down), (100, across)))
        if how == "pad":
            spread = [float((frame.sum(k) * w**2).sum() / frame.sum()) for k, w in ((1, rows), (0, columns))]
            assert spread == pytest.approx([radius**2 / 4] * 2, rel=0.03)
    assert (fitted(torch.ones(2, 3, 50, 50), display, "crop") - 1).abs().max() < 1e-5
    scaled = fitted(disc, display, "scale")
    assert float(scaled.mean()) == pytest.approx(float(disc.mean()), rel=5e-3)
    assert fitted(disc[:60, :100], display, "scale").equal(disc[:60, :100])


def test_what_cannot_be_fitted_is_named():
    display = Display(Modulator((16, 24), 8e-6), 532e-9, 2e-3)
    with pytest.raises(ValueError, match="how must be one of 'pad', 'crop', 'scale'"):
        fitted(torch.ones(8, 8), display, "fill")
    with pytest.raises(TypeError, match="display must be a Display"):
        fitted(torch.ones(8, 8), (16, 24))


@pytest.mark.parametrize("bits", [1, 8, 10])
def test_a_saved_hologram_is_read_back(tmp_path, bits):
    display = Display(Modulator((16, 24), 8e-6, bits=bits), SOURCES, 2e-3)
    target = torch.rand(3, 16, 24, generator=torch.Generator().manual_seed(0))
    hologram = optimise(display, target, run=Run(iterations=2, progress=False))
    files = hologram.save(tmp_path / "new" / "folder")
    assert [Path(file).name for file in files] == [
        *(f"pattern_{k}.png" for k in (1, 2, 3)),
        "image_1.png",
        "report.json",
    ]
    depth = 8 if bits <= 8 else 16
    for file, levels in zip(files[:3], hologram.levels(), strict=True):
        with Image.open(file) as stored:
            assert stored.mode == ("L" if depth == 8 else "I;16")
            grey = np.asarray(stored).astype(int)
        np.testing.assert_array_equal(grey >> (depth - bits), levels.numpy())
    image = load_image(files[3]) / 255
    np.testing.assert_allclose(image, hologram.pictures(0).movedim(0, -1).clamp(0, 1).numpy(), atol=0.51 / 255)
    report = json.loads(Path(files[-1]).read_text())
    assert [row["psnr_db"] for row in report["table"]] == pytest.approx(hologram.psnr.flatten().tolist())
    assert report["files"] == [Path(file).name for file in files[:-1]]
    assert report["patterns"] == {"pattern": {"bits": bits}}


def test_a_saved_hologram_of_two_panels_has_its_amplitudes(tmp_path):
    first = AmplitudePanel(1e-3, bits=4)
    display = Display(Modulator((16, 24), 8e-6, lit_through=first), 532e-9, 2e-3)
    hologram = optimise(display, torch.ones(16, 24), run=Run(iterations=2, progress=False))
    files = hologram.save(tmp_path)
    assert [Path(file).name for file in files][:2] == ["pattern_1.png", "amplitude_1.png"]
    grey = load_image(files[1]).astype(int)
    np.testing.assert_array_equal(grey >> 4, first.levels(hologram.amplitudes)[0].numpy())
