"""`odak metamer` from a file to its three pictures."""

import os

import numpy as np
import pytest
import torch
from command import invoke
from PIL import Image

from odak.cli import main
from odak.cli.metamer import _texture_distance
from odak.learn.perception import make_pooling_size_map_pixels

ROWS, COLUMNS = 60, 72
METAMER = ["comparison.png", "metamer.png", "pooling_map.png"]
VIEW = ["--gaze", "0.25", "0.5", "--width", "0.6", "--distance", "0.5", "--alpha", "0.6", "--levels", "4"]


def run(*arguments):
    result = invoke("metamer", *arguments, "--device", "cpu")
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    values = np.random.default_rng(0).integers(0, 256, (ROWS, COLUMNS, 3)).astype(np.uint8)
    path = tmp_path_factory.mktemp("pictures") / "noise.png"
    Image.fromarray(values).save(path)
    return path


@pytest.mark.usefixtures("sheets")
def test_three_pictures(file, tmp_path):
    result = run(file, "--output", tmp_path, *VIEW, "--iterations", 10)
    assert "metameric loss" in result.stdout
    assert "metamer" in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == [*METAMER, "report.json"]
    metamer, picture = pixels(tmp_path / "metamer.png").astype(float), pixels(file).astype(float)
    assert metamer.shape == picture.shape
    error = abs(metamer - picture).mean(-1)
    pooling = make_pooling_size_map_pixels([0.25, 0.5], (ROWS, COLUMNS), 0.6, 0.6, 0.5).numpy()
    # Sharp vision sees the picture, the rest is other noise.
    assert error[pooling < 0.5].mean() < 10
    assert error[pooling > 4].mean() > 25
    shade = np.round(np.log2(pooling.clip(1)) / np.log2(pooling.max()) * 255)
    assert abs(pixels(tmp_path / "pooling_map.png") - shade).max() <= 1
    sheet = pixels(tmp_path / "comparison.png")
    # Small pictures are shown enlarged by a whole factor.
    factor = 300 // COLUMNS
    rows, columns = factor * ROWS, factor * COLUMNS
    picture, metamer = (np.kron(values, np.ones((factor, factor, 1))) for values in (picture, metamer))
    (top,) = (
        row
        for row in range(sheet.shape[0] - rows)
        if np.array_equal(sheet[row : row + rows, 16 : 16 + columns], picture)
    )
    assert np.array_equal(sheet[top : top + rows, 332 : 332 + columns], metamer)


def test_texture_of_squares_away_from_the_gaze():
    picture = torch.rand(1, 3, 130, 270, generator=torch.Generator().manual_seed(0))
    pooling = torch.full((130, 270), 4.0)
    pooling[50, 50] = 1.0
    # The first square has a resolved pixel, in the second one the texture is the same at another place.
    shown = picture.clone()
    shown[..., :128, :128] = 0.5
    assert _texture_distance(shown, picture, pooling) == 0
    shown[..., :128, 128:256] = picture[..., :128, 128:256].flip(-1).flip(-2)
    flat, turned = (_texture_distance(one, picture, pooling) for one in (torch.zeros_like(picture), shown))
    assert 0 < turned < 0.01 * flat
    assert _texture_distance(shown, picture, torch.ones_like(pooling)) is None


def test_iterations_lower_the_loss_and_the_seed_reproduces(file, tmp_path):
    losses = []
    for iterations in (0, 10):
        out = run(file, "--output", tmp_path / str(iterations), *VIEW, "--iterations", iterations).stdout
        losses.append(float(out.split("metameric loss ")[1].split(",")[0]))
    # Noise of full contrast nearly fills the range of RGB; the gain is far larger for photographs.
    assert losses[1] < 0.5 * losses[0]
    quiet = run(file, "--output", tmp_path / "again", *VIEW, "--quiet", "--iterations", 0)
    assert quiet.output == ""
    run(file, "--output", tmp_path / "other", *VIEW, "--quiet", "--seed", 1, "--iterations", 0)
    first, again, other = (pixels(tmp_path / name / "metamer.png") for name in ("0", "again", "other"))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_grey_pictures(tmp_path):
    path = tmp_path / "grey.png"
    Image.fromarray(np.tile(np.arange(64, dtype=np.uint8) * 4, (64, 1))).save(path)
    run(path, "--output", tmp_path / "out", "--levels", 3, "--quiet", "--iterations", 2)
    assert pixels(tmp_path / "out" / "metamer.png").shape == (64, 64)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nowhere.png"], "nowhere.png"),
        (["--gaze", "nan", "0"], "--gaze"),
        (["--width", "0"], "--width"),
        (["--distance", "-1"], "--distance"),
        (["--alpha", "inf"], "--alpha"),
        (["--mode", "cubic"], "'quadratic', 'linear'"),
        (["--levels", "1"], "--levels"),
        (["--iterations", "-1"], "--iterations"),
        (["--device", "abacus"], "--device"),
    ],
)
def test_bad_input_is_one_line_and_code_2(arguments, named, tmp_path, capsys):
    assert main(["metamer", *arguments, "--output", str(tmp_path / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("odak: ")
    assert captured.err.count("\n") == 1
    assert named in captured.err
    assert not (tmp_path / "out").exists()


def test_a_failed_write_is_code_1_and_leaves_the_old_file(file, tmp_path, capsys, monkeypatch):
    (tmp_path / "metamer.png").write_text("old")

    def full(*_):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", full)
    assert main(["metamer", str(file), "--output", str(tmp_path), *VIEW, "--iterations", "0", "--quiet"]) == 1
    assert "disk full" in capsys.readouterr().err
    assert (tmp_path / "metamer.png").read_text() == "old"
