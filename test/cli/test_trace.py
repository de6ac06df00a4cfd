import json

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from odak.cli import app, main
from odak.learn.raytracing.system import load_system, rms_spot, sample_systems, write_zmx
from odak.learn.raytracing.system.drawing import COLOURS


@pytest.mark.parametrize("name", sample_systems())
def test_a_sample_is_traced_drawn_and_reported(name, tmp_path, capsys):
    assert main(["trace", name, "--output", str(tmp_path), "--rings", "3"]) == 0
    assert "focal length" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    system = load_system(name)
    expected = rms_spot(system, "rings", 3)
    assert [field["rms_spot"] for field in report["fields"]] == pytest.approx(expected.tolist(), rel=1e-12)
    assert report["first_order"]["f_number"] == pytest.approx(
        {"singlet": 4.9826}.get(name, 4 if "triplet" in name else 2), rel=1e-3
    )
    for field in report["fields"]:
        assert sum(field["statuses"].values()) == 3 * 37
    assert report["system"]["source"] and set(report["definitions"]) >= {"rms_spot", "strehl"}
    for picture in ("layout.png", "spots.png"):
        pixels = np.asarray(Image.open(tmp_path / picture)).reshape(-1, 3).astype(int)
        for colour in COLOURS[:3]:
            assert (abs(pixels - colour).sum(-1) < 60).sum() > 20, (picture, colour)


def test_rays_in_the_layout_end_where_they_are_traced_to(tmp_path):
    """The plane is drawn a tenth higher than the image of the outermost field."""
    assert main(["trace", "cooke_triplet", "--output", str(tmp_path), "--quiet"]) == 0
    pixels = np.asarray(Image.open(tmp_path / "layout.png")).astype(int)
    dark = abs(pixels - 20).sum(-1) < 300
    # The image plane is the rightmost long dark column.
    column = max(x for x in range(pixels.shape[1]) if dark[:, x].sum() > 100)
    rows = np.flatnonzero(dark[:, column])
    red = abs(pixels - np.asarray(COLOURS[2])).sum(-1) < 120
    tip = np.flatnonzero(red[:, column - 4]).mean()
    middle = (rows[0] + rows[-1]) / 2
    assert (middle - tip) / ((rows[-1] - rows[0]) / 2) == pytest.approx(1 / 1.1, abs=0.02)


def test_a_zmx_file_is_traced_and_what_was_ignored_is_said(tmp_path, capsys):
    path = tmp_path / "lens.zmx"
    write_zmx(load_system("singlet"), path)
    assert main(["trace", str(path), "--output", str(tmp_path), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert "DIAM 12.7" in json.loads((tmp_path / "report.json").read_text())["ignored"][0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing"], "one of cooke_triplet, double_gauss, singlet"),
        (["nothing.zmx"], "must be a file"),
        (["singlet", "--rings", "0"], "--rings must be 1 to 100"),
        (["singlet", "--aim", "high"], "--aim must be paraxial or real"),
        (["singlet", "--output", "/proc/none"], "--output cannot be written to"),
    ],
)
def test_what_will_not_do_is_said_in_a_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["trace", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_help_names_the_samples():
    result = CliRunner().invoke(app.app if hasattr(app, "app") else app, ["trace", "--help"])
    assert result.exit_code == 0
    assert all(name in result.output for name in sample_systems())
