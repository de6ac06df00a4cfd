"""Interactive pages of results."""

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
