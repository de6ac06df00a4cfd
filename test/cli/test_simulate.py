"""Optical benches from a file, compared with closed forms."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.special import j1

from odak.cli import main
from odak.wave import bench_schema
from odak.wave.bench_files import KINDS

WAVELENGTH, PITCH, SIDE = 532e-9, 8e-6, 256
HEAD = f"""
[bench]
wavelength = "532nm"
resolution = [{SIDE}, {SIDE}]
pixel_pitch = "8um"
"""


def simulate(folder, text, name="bench.toml", expect=0):
    (folder / name).write_text(text)
    assert main(["simulate", str(folder / name), "-o", str(folder / "out")]) == expect
    if expect == 0:
        return json.loads((folder / "out" / "report.json").read_text())
    return None


PLANE = 'kind = "plane_wave"'
RECORD = 'kind = "record"\nname = "a"'


def elements(*parts):
    return HEAD + "".join(f"[[elements]]\n{part}\n" for part in parts)


def axis():
    return (np.arange(SIDE) - SIDE // 2) * PITCH


@pytest.mark.usefixtures("sheets")
def test_a_lens_makes_an_airy_pattern(tmp_path, capsys):
    diameter, focal = 1.2e-3, 0.1
    report = simulate(
        tmp_path,
        elements(
            'kind = "plane_wave"',
            f'kind = "lens"\nfocal_length = "10cm"\ndiameter = {diameter}',
            'kind = "propagate"\ndistance = "10cm"',
            'kind = "record"\nname = "focus"',
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "focus.npy")) ** 2
    area = np.pi * diameter**2 / 4
    peak = (area / (WAVELENGTH * focal)) ** 2
    assert report["steps"][-1]["peak"] == pytest.approx(peak, rel=2e-3)
    x = np.pi * diameter * axis() / (WAVELENGTH * focal)
    airy = np.where(x == 0, 1.0, (2 * j1(x) / np.where(x == 0, 1.0, x)) ** 2)
    assert np.abs(intensity[SIDE // 2] / peak - airy).max() < 0.01
    assert report["steps"][-1]["peak_position"] == [0.0, 0.0]
    assert report["steps"][1]["share_of_source"] == pytest.approx(area / (SIDE * PITCH) ** 2, rel=6e-3)
    with Image.open(tmp_path / "out" / "focus.png") as picture:
        assert picture.width > 2 * SIDE
    assert "plane_wave" in capsys.readouterr().out


def test_a_lens_steeper_than_the_grid_makes_an_airy_pattern(tmp_path):
    """A lens of 3.6 mm is 5.8 times beyond Nyquist here; the focus has samples of its own."""
    diameter, focal = 1.5e-3, 3.6e-3
    report = simulate(
        tmp_path,
        elements(
            'kind = "plane_wave"',
            f'kind = "lens"\nfocal_length = {focal}\ndiameter = {diameter}',
            f'kind = "propagate"\ndistance = {focal}\npixel_pitch = "0.25um"\nresolution = [64, 65]',
            'kind = "record"\nname = "focus"',
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "focus.npy")) ** 2
    y, x = (np.arange(64) - 32)[:, None] * 0.25e-6, (np.arange(65) - 32) * 0.25e-6
    v = np.pi * diameter * np.hypot(y, x) / (WAVELENGTH * focal) + 1e-9
    airy = (2 * j1(v) / v) ** 2 * (np.pi * diameter**2 / 4 / (WAVELENGTH * focal)) ** 2
    assert np.abs(intensity - airy).max() < 1e-3 * airy.max()
    assert report["warnings"] == []
    assert report["steps"][-1]["pixel_pitch"] == 0.25e-6
    assert report["steps"][-1]["peak_position"] == [0.0, 0.0]


def test_steep_sources_are_named(tmp_path):
    """Reports hold the warnings of the run."""
    sources = ('kind = "plane_wave"\ntilt = [0, 3]', 'kind = "point_source"\ndistance = "5mm"')
    texts = simulate(tmp_path, elements(*sources, RECORD))["warnings"]
    assert [text.split(" is ")[0] for text in texts] == ["plane_wave", "point_source"]


def test_the_report_says_where_light_is_lost(tmp_path):
    """A slit blocks what is beside it; behind it, light leaves the grid."""
    report = simulate(
        tmp_path,
        elements(
            PLANE,
            'kind = "rectangular_aperture"\nsize = ["1.608mm", "24um"]',
            'kind = "propagate"\ndistance = "5cm"',
            RECORD,
        ),
    )
    source, slit, space, record = report["steps"]
    assert "lost" not in source and "lost" not in record
    assert slit["lost"]["aperture"] == pytest.approx(1 - 201 * 3 / SIDE**2, rel=1e-6)
    assert space["lost"]["window"] == pytest.approx(1 - space["power"] / slit["power"], abs=1e-6)
    assert space["lost"]["window"] > 0.02
    assert any("FreeSpace keeps" in text for text in report["warnings"])


def test_a_gaussian_beam_spreads(tmp_path):
    waist, distance = 0.2e-3, 0.1
    report = simulate(
        tmp_path,
        elements(
            f'kind = "gaussian_beam"\nwaist = {waist}\npower = 3.0',
            'kind = "propagate"\ndistance = 0.1\nmethod = "angular spectrum"',
            'kind = "record"\nname = "far"',
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "far.npy")) ** 2
    # The second moment of a Gaussian beam is w(z)²/4 along each axis.
    width = np.sqrt((intensity.sum(0) * axis() ** 2).sum() / intensity.sum())
    expected = waist / 2 * np.sqrt(1 + (distance * WAVELENGTH / (np.pi * waist**2)) ** 2)
    assert width == pytest.approx(expected, rel=1e-3)
    assert [step["power"] for step in report["steps"]] == pytest.approx([3.0] * 3, rel=1e-4)


def test_two_sources_interfere(tmp_path):
    angle = 0.2
    simulate(
        tmp_path,
        elements(
            'kind = "plane_wave"',
            f'kind = "plane_wave"\ntilt = [0, {angle}]',
            'kind = "record"\nname = "fringes"',
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "fringes.npy")[0]) ** 2
    expected = 2 + 2 * np.cos(2 * np.pi / WAVELENGTH * np.sin(np.radians(angle)) * axis())
    assert np.abs(intensity - expected).max() < 1e-5


def test_a_point_source_and_a_lens_collimate(tmp_path):
    simulate(
        tmp_path,
        elements(
            'kind = "point_source"\ndistance = "50cm"',
            'kind = "lens"\nfocal_length = "50cm"',
            'kind = "record"\nname = "flat"',
        ),
    )
    phase = np.angle(np.load(tmp_path / "out" / "flat.npy"))
    # What is left is the spherical aberration of the paraxial lens, k r⁴ / (8 f³).
    radius = np.hypot(axis()[:, None], axis()[None])
    left = 2 * np.pi / WAVELENGTH * (np.sqrt(radius**2 + 0.5**2) - 0.5 - radius**2 / (2 * 0.5))
    assert np.abs(phase - left).max() < 1e-4


@pytest.mark.slow
def test_a_pattern_of_the_command_line_shows_its_picture(tmp_path):
    options = [
        "--resolution",
        str(SIDE),
        str(SIDE),
        "-d",
        "2cm",
        "--iterations",
        "30",
        "--device",
        "cpu",
        "--fill-factor",
        "0",
        "--grey",
        "-q",
    ]
    assert main(["hologram", "chart", "-o", str(tmp_path / "hologram"), *options]) == 0
    simulate(
        tmp_path,
        elements(
            'kind = "plane_wave"',
            'kind = "slm"\npattern = "hologram/hologram_532nm.png"',
            'kind = "propagate"\ndistance = "2cm"',
            'kind = "record"\nname = "image"',
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "image.npy")) ** 2
    report = json.loads((tmp_path / "hologram" / "report.json").read_text())
    with Image.open(tmp_path / "hologram" / "reconstruction.png") as picture:
        stored = np.asarray(picture) / 255
    seen = np.clip(report["channels"][0]["scale"] * intensity, 0, 1)
    # The picture is encoded as screens expect it (IEC 61966-2-1).
    encoded = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    assert np.abs(encoded - stored).max() < 0.51 / 255 + 2e-3


def test_masks_and_rectangles(tmp_path):
    picture = np.zeros((SIDE, SIDE), np.uint8)
    picture[:, : SIDE // 2] = 255
    Image.fromarray(picture).save(tmp_path / "half.png")
    report = simulate(
        tmp_path,
        elements(
            'kind = "plane_wave"',
            'kind = "mask"\npicture = "half.png"',
            'kind = "rectangular_aperture"\nsize = ["0.808mm", "1.608mm"]\noffset = ["0.104mm", 0]',
            'kind = "record"\nname = "half"',
        ),
    )
    field = np.load(tmp_path / "out" / "half.npy")
    inside = (np.abs(axis()[:, None] - 0.104e-3) <= 0.401e-3) & (np.abs(axis()) <= 0.8e-3) & (np.arange(SIDE) < 128)
    np.testing.assert_allclose(np.abs(field) ** 2, inside, atol=1e-6)
    assert report["steps"][1]["share_of_source"] == 0.5


def test_toml_and_json_say_the_same_and_a_report_repeats_itself(tmp_path):
    text = elements('kind = "gaussian_beam"\nwaist = "0.3mm"', 'kind = "record"\nname = "a"')
    first = simulate(tmp_path, text)
    again = simulate(tmp_path, json.dumps({name: first[name] for name in ("bench", "elements")}), "again.json")
    assert first["elements"] == again["elements"] and first["steps"] == again["steps"]


def test_the_schema_covers_every_kind(capsys):
    assert main(["simulate", "--schema"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads(json.dumps(bench_schema()))
    kinds = {part["properties"]["kind"]["const"] for part in printed["properties"]["elements"]["items"]["oneOf"]}
    assert kinds == set(KINDS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "CONFIG needs bench, elements"),
        ("x = [", "is not valid TOML"),
        (HEAD, "CONFIG needs elements"),
        (elements('kind = "lense"\nfocal_length = 1'), "element 1 must have a kind of"),
        (elements('kind = "plane_wav"'), "Did you mean 'plane_wave'?"),
        (elements('kind = "lens"\nfocal_length = 1'), "element 1 (lens): the first element must be a source"),
        (elements('kind = "gaussian_beam"'), "element 1 (gaussian_beam) needs waist"),
        (elements('kind = "gaussian_beam"\nwaist = "1 foot"'), "waist must be a positive length such as 8e-6"),
        (elements('kind = "gaussian_beam"\nwaist = -1'), "waist must be a positive length"),
        (
            elements('kind = "plane_wave"\namplitud = 1'),
            "has no parameter 'amplitud'; accepted: amplitude, tilt. Did you mean",
        ),
        (elements('kind = "plane_wave"', 'kind = "slm"\npattern = "no.png"'), "path of a picture that exists"),
        (
            elements('kind = "plane_wave"', 'kind = "propagate"\ndistance = 1\nmethod = "magic"'),
            "method must be one of",
        ),
        (elements('kind = "plane_wave"'), "the last element must be a record"),
        (elements('kind = "plane_wave"', 'kind = "record"\nname = "../x"'), "name must be a name of letters"),
        (elements('kind = "plane_wave"', 'kind = "record"\nname = "report"'), "name 'report' is already used"),
        (
            elements('kind = "plane_wave"', *['kind = "record"\nname = "a"'] * 2),
            "element 3 (record): name 'a' is already used",
        ),
        (elements('kind = "plane_wave"', 'kind = "record"\nname = "a"', 'kind = "plane_wave"'), "sources come first"),
        (HEAD.replace(f"{SIDE}, {SIDE}", "0, 5") + "[[elements]]\n", "resolution must be two whole numbers"),
    ],
)
def test_what_does_not_keep_to_the_schema_is_named(text, message, tmp_path, capsys):
    simulate(tmp_path, text, expect=2)
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_files_that_cannot_be_read(tmp_path, capsys):
    for name, content in (("a.json", "{"), ("b.yaml", ""), ("c.json", "[" * 100000)):
        (tmp_path / name).write_text(content)
        assert main(["simulate", str(tmp_path / name)]) == 2
    assert main(["simulate", str(tmp_path / "none.toml")]) == 2 == main(["simulate"])
    said = capsys.readouterr().err.splitlines()
    assert "is not valid JSON: line 1" in said[0] and ".toml or .json" in said[1] and "CONFIG is missing" in said[-1]


def test_rows_and_columns_have_pitches_of_their_own(tmp_path):
    """A round beam on samples of 8 µm by 4 µm stays round, converges behind a lens, and keeps its power."""
    waist, distance = 0.2e-3, 0.1
    head = HEAD.replace('"8um"', '["8um", 4e-6]')
    source = f'kind = "gaussian_beam"\nwaist = {waist}\npower = 3.0\noffset = [8e-5, -4e-5]'
    report = simulate(
        tmp_path,
        head
        + "".join(
            f"[[elements]]\n{part}\n"
            for part in (
                source,
                'kind = "lens"\nfocal_length = "20cm"\noffset = [8e-5, -4e-5]',
                f'kind = "propagate"\ndistance = {distance}',
                'kind = "record"\nname = "focus"',
            )
        ),
    )
    intensity = np.abs(np.load(tmp_path / "out" / "focus.npy")) ** 2
    places = axis()[:, None] - 8e-5, axis() / 2 + 4e-5
    # After a lens and a distance z the radius of a waist w is w·sqrt((1 − z/f)² + (z·λ/(πw²))²).
    wanted = waist / 2 * np.hypot(1 - distance / 0.2, distance * WAVELENGTH / (np.pi * waist**2))
    for place in places:
        assert np.sqrt((intensity * place**2).sum() / intensity.sum()) == pytest.approx(wanted, rel=1e-3)
    assert [step["power"] for step in report["steps"]] == pytest.approx([3.0] * 4, rel=1e-4)
    assert report["steps"][-1]["centroid"] == pytest.approx([8e-5, -4e-5], rel=1e-3)
    for wrong in ('["8um"]', '["8um", 0]'):
        simulate(tmp_path, head.replace('["8um", 4e-6]', wrong) + f"[[elements]]\n{PLANE}\n", "wrong.toml", expect=2)
