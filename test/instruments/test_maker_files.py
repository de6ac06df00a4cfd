"""Corrections and look-up tables of makers are read, or refused by name."""

import numpy as np
import pytest
from PIL import Image

from odak import instruments

LEVELS = np.random.default_rng(0).integers(256, size=(6, 9))


def test_a_corrected_pattern_is_the_sum_of_pattern_and_image(tmp_path):
    """As makers' manuals say: the levels of both are added, modulo 256."""
    Image.fromarray(LEVELS.astype(np.uint8)).save(tmp_path / "a.bmp")
    correction = instruments.load_correction(tmp_path / "a.bmp", (6, 9))
    assert correction.max() < 2 * np.pi
    table = instruments.SimulatedTable(seed=1, shape=(6, 9), camera_shape=(8, 8))
    known = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 20e-3)
    pattern = np.random.default_rng(1).integers(256, size=(6, 9))
    corrected = instruments.Calibration(**{**known.__dict__, "wavefront": -correction})
    assert (corrected.levels(2 * np.pi / 256 * pattern) == (pattern + LEVELS) % 256).all()


def test_images_of_16_bits_and_of_equal_colours(tmp_path):
    Image.fromarray((LEVELS * 256).astype(np.uint16)).save(tmp_path / "deep.png")
    Image.fromarray(np.repeat(LEVELS[..., None], 3, axis=-1).astype(np.uint8)).save(tmp_path / "three.png")
    deep, three = (instruments.load_correction(tmp_path / name) for name in ("deep.png", "three.png"))
    assert np.array_equal(deep, three) and np.allclose(three, LEVELS * 2 * np.pi / 256)
    Image.fromarray(np.stack([LEVELS, LEVELS, LEVELS[::-1]], axis=-1).astype(np.uint8)).save(tmp_path / "colour.png")
    with pytest.raises(ValueError, match=r"colour\.png' must be an image in grey"):
        instruments.load_correction(tmp_path / "colour.png")


@pytest.mark.parametrize("between", [",", "; ", "\t", " "])
@pytest.mark.parametrize("titled", [False, True])
def test_tables_of_levels(between, titled, tmp_path):
    rows = [[row, *line] if titled else list(line) for row, line in enumerate(LEVELS)]
    lines = [["Y/X", *range(9)], *rows] if titled else rows
    (tmp_path / "a.csv").write_text("\n".join(between.join(map(str, line)) for line in lines), encoding="utf-8-sig")
    found = instruments.load_correction(tmp_path / "a.csv", (6, 9), cycle=1024)
    assert np.allclose(found, LEVELS * 2 * np.pi / 1024)


def test_look_up_tables(tmp_path):
    values = np.random.default_rng(0).uniform(0, 5, 256).round(3)
    (tmp_path / "a.lut").write_text("\n".join(f"{level}\t{value}" for level, value in enumerate(values)))
    (tmp_path / "b.csv").write_text("voltage\n" + "\n".join(map(str, values)))
    (tmp_path / "c.txt").write_text("\n".join(f"{level}, {value}" for level, value in list(enumerate(values))[::-1]))
    for name in ("a.lut", "b.csv", "c.txt"):
        assert np.array_equal(instruments.load_look_up_table(tmp_path / name), values)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it has no lines"),
        ("a,b\n", "holds no numbers"),
        ("1,2\n3\n", "cannot be read as lines of numbers"),
        ("1,two\n", "cannot be read as lines of numbers"),
        ("1,inf\n", "must hold finite levels"),
        ("1,2,3\n", r"must have the shape \[6, 9\] of the modulator, got \[1, 3\]"),
    ],
)
def test_texts_that_are_no_corrections_are_refused_by_name(text, message, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(ValueError, match=rf"a\.csv.*{message}"):
        instruments.load_correction(tmp_path / "a.csv", (6, 9), cycle=256)
    with pytest.raises(ValueError, match=r"cycle must be given for .*a\.csv"):
        instruments.load_correction(tmp_path / "a.csv")


@pytest.mark.parametrize("text", ["1 5\n2 6\n", "0 5\n0 6\n", "0 5 1\n1 6 1\n", "0 nan\n"])
def test_texts_that_are_no_look_up_tables_are_refused_by_name(text, tmp_path):
    (tmp_path / "a.lut").write_text(text)
    with pytest.raises(ValueError, match=r"a\.lut' must hold lines of a level, 0, 1, 2 …, and a finite value"):
        instruments.load_look_up_table(tmp_path / "a.lut")
