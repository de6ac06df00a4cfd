"""Interactive pages of results."""

import base64
import io
import json

import numpy as np
import pytest
import torch
import typer
from command import SMALL, run
from PIL import Image
from typer.testing import CliRunner

from odak.cli import app, main, show


def page_of(source, tmp_path):
    assert main(["show", str(source), "-o", str(tmp_path / "page.html"), "--no-open"]) == 0
    return (tmp_path / "page.html").read_text(encoding="utf-8")


def test_a_run_is_shown_with_pictures_numbers_and_figures(tmp_path):
    run("photo", "--output", tmp_path / "run", *SMALL, "--grey", "--quiet")
    page = page_of(tmp_path / "run", tmp_path)
    psnr = json.loads((tmp_path / "run" / "report.json").read_text())["psnr_db"]
    assert "<tr><td>psnr db<small>10*log10(1/mean((s*I - T)^2))" in page and f"<td>{psnr:.6g}</td>" in page
    assert "hologram_532nm.png: phase pattern for the modulator" in page
    assert page.count("data:image/png;base64,") >= 3 and page.count("Plotly.newPlot(") >= 1
    assert f"<td>{psnr:.6g}</td>" in page_of(tmp_path / "run" / "report.json", tmp_path)
    assert '<script src="http' not in page and "<link" not in page.partition("<script")[0]


@pytest.mark.parametrize("suffix", [".npy", ".pt"])
def test_fields_and_stacks(suffix, tmp_path):
    field = np.exp(1j * np.linspace(0, 6, 20 * 30)).reshape(20, 30).astype(np.complex64)
    path = tmp_path / f"field{suffix}"
    np.save(path, field) if suffix == ".npy" else torch.save(torch.as_tensor(field), path)
    page = page_of(path, tmp_path)
    assert f"field{suffix}" in page and "phase" in page


def test_what_is_too_large_for_a_page_is_averaged_or_cut_but_never_decimated():
    stripes = np.tile([0.0, 1.0], (8, 1500))
    assert np.array_equal(show._block_means(stripes, 2), np.full((4, 1500), 0.5))
    figure, caption = show._field_figure(stripes, "stripes")
    assert caption == "stripes, means over 3 × 3 samples"
    assert max(np.shape(trace.z)[-1] for trace in figure.data if trace.z is not None) == 1000
    assert show._field_figure(np.exp(1j * stripes), "phase")[1] == "phase, its middle of 8 × 1024 samples"


def test_pictures_and_lenses(tmp_path):
    Image.new("RGB", (9, 8), "red").save(tmp_path / "red.png")
    assert "red.png" in page_of(tmp_path / "red.png", tmp_path)
    assert "Plotly.newPlot(" in page_of("cooke_triplet", tmp_path)


def test_pages_are_written_to_html_files_only_whose_folder_is_made(tmp_path, capsys):
    page = tmp_path / "new" / "page.html"
    assert main(["show", "singlet", "-o", str(page), "--no-open"]) == 0 and page.is_file()
    Image.new("RGB", (9, 8), "red").save(tmp_path / "red.png")
    before = (tmp_path / "red.png").read_bytes()
    for output in (tmp_path / "red.png", tmp_path):
        assert main(["show", "singlet", "-o", str(output), "--no-open"]) == 2
        assert "--output must be an HTML file" in capsys.readouterr().err
    assert (tmp_path / "red.png").read_bytes() == before


def test_the_browser_is_asked_to_open_the_page(tmp_path, monkeypatch, capsys):
    opened = []
    monkeypatch.setattr(typer, "launch", opened.append)
    assert main(["show", "singlet"]) == 0
    assert opened == [capsys.readouterr().out.strip()]


def test_what_cannot_be_shown_is_named(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    np.save(tmp_path / "line.npy", np.zeros(3))
    (tmp_path / "broken.npy").write_bytes(b"no array")
    np.save(tmp_path / "objects.npy", np.array([print], object), allow_pickle=True)
    (tmp_path / "notes.txt").write_text("text")
    for name, message in (
        ("empty", "must be a folder with pictures or fields"),
        ("line.npy", "must contain a field or a stack of fields, got shape (3,)"),
        ("broken.npy", "cannot be drawn"),
        ("objects.npy", "cannot be drawn"),
        ("notes.txt", "must be a folder of results, or end in"),
        ("none.png", "FILE not found"),
        ("cooke_tripel", "Did you mean 'cooke_triplet'?"),
    ):
        source = name if name == "cooke_tripel" else str(tmp_path / name)
        assert main(["show", source, "-o", str(tmp_path / "page.html"), "--no-open"]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "page.html").exists()


def shown(folder, report=None):
    """Show a folder with a picture, a field and perhaps a report, and return the exit code."""
    if report is not None:
        (folder / "report.json").write_text(report if isinstance(report, str) else json.dumps(report))
    return main(["show", str(folder), "-o", str(folder.parent / "page.html"), "--no-open"])


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "run").mkdir()
    levels = np.random.default_rng(0).integers(0, 256, (12, 10)).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "run" / "phase.png")
    Image.fromarray(255 - levels).save(tmp_path / "secret.png")
    np.save(tmp_path / "run" / "field.npy", np.ones((4, 5), complex))
    return tmp_path / "run"


@pytest.mark.parametrize(
    ("name", "content"),
    [("x.png", b"a text"), ("x.npy", None), ("report.json", b'{"psnr_db": 1}'), ("x.gif", None)],
)
def test_links_out_of_the_folder_are_refused(name, content, folder, tmp_path, capsys):
    outside = tmp_path / f"outside{name[-4:]}"
    if name == "x.npy":
        np.save(outside, np.ones((3, 3)))
    elif content is None:
        Image.new("L", (8, 8)).save(outside)
    else:
        outside.write_bytes(content)
    (folder / name).symlink_to(outside)
    assert shown(folder) == 2 and not (tmp_path / "page.html").exists()
    told = capsys.readouterr().err
    assert f"{name!r} leads to" in told and told.count("\n") == 1
    # A link that stays inside is drawn, as is what lies beside it.
    (folder / name).unlink()
    (folder / "same.png").symlink_to(folder / "phase.png")
    assert shown(folder) == 0 and "same.png" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("report", "message"),
    [
        ("[]", "must be a JSON object, got []"),
        ("[" * 100_000, "nested too deeply"),
        ({"warnings": 5}, "warnings must be a sequence of strings"),
        ({"pattern": []}, "pattern must be an object"),
        ({"pattern": {"files": [1]}}, "pattern.files must contain strings"),
        ({"pattern": {"files": ["../secret.png"]}}, "leads to"),
        ({"pattern": {"files": ["PARENT/secret.png"]}}, "leads to"),
        ({"pattern": {"files": ["x\0.png"]}}, "null byte"),
        ({"pattern": {"files": ["field.npy"]}}, "'.npy' is not allowed"),
        ({"bench": {"pixel_pitch": [1, 2, 3]}}, "bench.pixel_pitch must be"),
        ({"bench": {"pixel_pitch": [[1], [2]]}}, "bench.pixel_pitch must be one number"),
        ({"parameters": {"pixel_pitch": float("nan")}}, "parameters.pixel_pitch must be positive"),
        ({"parameters": {"wavelength": "532nm"}}, "parameters.wavelength must be a real number"),
        ({"bench": {"pixel_pitch": 10**400}}, "too large"),
        ({"definitions": {"a": 1}}, "definitions must contain strings"),
    ],
)
def test_reports_that_are_none_are_refused_in_one_line(report, message, folder, capsys):
    text = (report if isinstance(report, str) else json.dumps(report)).replace("PARENT", folder.parent.as_posix())
    assert shown(folder, text) == 2 and not (folder.parent / "page.html").exists()
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1 and str(folder) in told


def test_what_does_not_decode_is_refused_and_odd_names_are_drawn(folder, capsys):
    whole = (folder / "phase.png").read_bytes()
    for name, content in (
        ("x.png", b"<svg xmlns='http://www.w3.org/2000/svg'/>"),
        ("x.png", whole[:-30]),
        ("x.png", b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n"),
        ("x.npy", b""),
        ("x.npy", (folder / "field.npy").read_bytes()[:-1]),
    ):
        (folder / name).write_bytes(content)
        assert shown(folder) == 2
        told = capsys.readouterr().err
        assert name in told and told.count("\n") == 1
        (folder / name).unlink()
    (folder / "phase.png").rename(folder / ("\u00e9" * 50 + "\udcff.png"))
    np.save(folder / "field.npy", np.ones((4, 5), np.longdouble))
    assert shown(folder, {"a": "\ud800", "pattern": {"files": ["missing.png"]}}) == 0


def test_pictures_of_sixteen_bits_are_scaled_and_types_are_those_of_the_content(tmp_path):
    levels = np.arange(0, 2**16, 256, dtype=np.uint16).reshape(16, 16)
    Image.fromarray(levels).save(tmp_path / "deep.tif")
    Image.new("L", (4, 4)).save(tmp_path / "in_fact.png", format="GIF")
    kind, _, content = show._encoded(tmp_path / "deep.tif").partition(";base64,")
    with Image.open(io.BytesIO(base64.b64decode(content))) as image:
        assert kind == "image/png" and np.array_equal(np.asarray(image), np.round(levels / 257).astype(np.uint8))
    assert show._encoded(tmp_path / "in_fact.png").startswith("image/gif;base64,")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_shells_complete_commands_options_and_names(shell):
    def complete(words):
        environment = {"_ODAK_COMPLETE": f"complete_{shell}"}
        if shell == "bash":
            environment |= {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
        else:
            environment |= {"_TYPER_COMPLETE_ARGS": " ".join(words), "_TYPER_COMPLETE_FISH_ACTION": "get-args"}
        return CliRunner().invoke(app, [], prog_name="odak", env=environment).stdout

    assert "hologram" in complete(["odak", "holo"])
    assert "--wavelength" in complete(["odak", "hologram", "--wave"])
    assert "holoeye-leto-3" in complete(["odak", "hologram", "--preset", "holoeye-l"])
    assert "double-phase" in complete(["odak", "hologram", "--method", "dou"])
