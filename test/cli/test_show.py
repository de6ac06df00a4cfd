"""Interactive pages of results."""

import base64
import html.parser
import io
import json
import re
import shutil
import subprocess
import sys
import webbrowser

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
    assert f"<tr><td>PSNR (dB)</td><td>{psnr:.6g}</td></tr>" in page and "<small>10*log10(1/mean((s*I - T)^2))" in page
    assert "hologram_532nm.png: phase pattern for the modulator" in page
    assert page.count("data:image/png;base64,") >= 3 and page.count("Plotly.newPlot(") >= 1
    assert f"<td>{psnr:.6g}</td>" in page_of(tmp_path / "run" / "report.json", tmp_path)
    assert '<script src="http' not in page and "<link" not in page.partition("<script")[0]


class Parts(html.parser.HTMLParser):
    """What a page shows, in order: titles, alternative texts of images, notes, figures and summaries."""

    def __init__(self, page):
        super().__init__()
        self.parts, self.now, self.folded = [], None, 0
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.folded += tag == "details"
        self.now = "note" if given.get("role") == "note" else tag if tag in ("h1", "summary") else None
        if tag == "img":
            self.parts.append(("folded image" if self.folded else "image", given["alt"]))
        elif "plotly-graph-div" in given.get("class", ""):
            self.parts.append(("figure", ""))

    def handle_endtag(self, tag):
        self.folded -= tag == "details"
        self.now = None

    def handle_data(self, data):
        if self.now:
            self.parts.append((self.now, data))


@pytest.fixture
def many(tmp_path):
    """A run in three colours with warnings, as its files are."""
    path, levels = tmp_path / "h1", np.arange(12 * 10, dtype=np.uint8).reshape(12, 10)
    path.mkdir()
    patterns = [f"hologram_{nm}nm.png" for nm in (450, 520, 638)]
    for name in ["a.png", "comparison.png", "reconstruction.png", *patterns]:
        Image.fromarray(levels).save(path / name)
    report = {"psnr_db": 21.5, "seconds_total": 3.25, "definitions": {"psnr_db": "x < y"}, "warnings": ["a & b", "c"]}
    more = {"pattern": {"files": patterns}, "parameters": {"image": "/home/<me>/cup.png", "pixel_pitch": 8e-6}}
    (path / "report.json").write_text(json.dumps(report | more))
    return path


def test_a_page_begins_with_the_picture_and_folds_the_rest(many, tmp_path):
    page = page_of(many, tmp_path)
    parts = Parts(page).parts
    assert parts[:5] == [
        *(("h1", "cup, h1"), ("image", "reconstruction.png")),
        *(("note", "Warning: a & b"), ("note", "Warning: c"), ("image", "comparison.png")),
    ]
    assert parts[5:7] == [("image", "a.png"), ("figure", "")]
    folded = [("summary", name) for name in ("Definitions", "Parameters", "Patterns")]
    names = [f"hologram_{nm}nm.png" for nm in (450, 520, 638)]
    assert parts[7:] == [*folded, *(("folded image", name) for name in names)]
    shown, _, rest = page.partition("<details>")
    assert "<td>PSNR (dB)</td><td>21.5</td>" in shown and "<td>3.25</td>" not in shown and "<td>3.25</td>" in rest
    assert "x &lt; y" in rest and "&lt;me&gt;" in rest and "<me>" not in page


def test_patterns_of_several_colours_share_a_slider(many):
    report = json.loads((many / "report.json").read_text())
    values = [(np.exp(1j * show._phase(many / name)), name) for name in report["pattern"]["files"]]
    ((figure, caption),) = show._together(values, 8e-6, quantities=["phase"])
    assert [step.label for step in figure.layout.sliders[0].steps] == ["450nm", "520nm", "638nm"]
    assert caption == ", ".join(name for _, name in values)
    other = (np.ones((4, 5), complex), "field.npy")
    assert len(show._together([*values, other], 8e-6)) == 2


def test_the_page_of_a_lens_holds_what_a_notebook_shows(tmp_path):
    page = page_of("cooke_triplet", tmp_path)
    # Cooke triplets are scaled to 50 mm; the sample's own first order is tested with lenses.
    assert "<td" in page and ">50.001 mm</td>" in page and Parts(page).parts[0] == ("h1", "Cooke triplet f/4")
    assert [kind for kind, _ in Parts(page).parts] == ["h1", "image", "figure"]


def test_without_plotly_there_are_pictures_and_a_note(many, tmp_path, monkeypatch, capsys):
    for name in ("odak.visualize.plotly.figures", "odak.visualize.plotly.field_figures", "odak.visualize.plotly"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.delattr("odak.visualize.plotly", raising=False)
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    page = page_of(many, tmp_path)
    assert "needs the package plotly: pip install plotly" in page
    assert [kind for kind, _ in Parts(page).parts].count("figure") == 0 and ("image", "a.png") in Parts(page).parts
    np.save(tmp_path / "field.npy", np.ones((4, 5), complex))
    assert main(["show", str(tmp_path / "field.npy"), "-o", str(tmp_path / "page.html"), "--no-open"]) == 2
    assert "pip install plotly" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1400])
def test_nothing_on_a_page_is_wider_than_the_window(width, many, tmp_path):
    if (browser := shutil.which("chromium") or shutil.which("google-chrome")) is None:
        pytest.skip("there is no Chromium")
    page_of(many, tmp_path)
    wider = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
    script = f"<script>addEventListener('load', () => parent.postMessage({wider}, '*'))</script>"
    with (tmp_path / "page.html").open("a", encoding="utf-8") as stream:
        stream.write(script)
    frame = f"<iframe src='page.html' width='{width}' height='900'></iframe>"
    heard = "<script>onmessage = event => document.body.dataset.wider = event.data</script>"
    (tmp_path / "frame.html").write_text(f"<!doctype html><body>{heard}{frame}</body>")
    command = [browser, "--headless", "--no-sandbox", "--virtual-time-budget=5000", "--window-size=1500,1000"]
    address = (tmp_path / "frame.html").as_uri()
    found = subprocess.run([*command, "--dump-dom", address], capture_output=True, text=True, timeout=120).stdout
    assert re.search(r'data-wider="(-?\d+)"', found)[1] == "0"


@pytest.mark.parametrize("suffix", [".npy", ".pt"])
def test_fields_and_stacks(suffix, tmp_path):
    field = np.exp(1j * np.linspace(0, 6, 20 * 30)).reshape(20, 30).astype(np.complex64)
    path = tmp_path / f"field{suffix}"
    np.save(path, field) if suffix == ".npy" else torch.save(torch.as_tensor(field), path)
    page = page_of(path, tmp_path)
    assert f"field{suffix}" in page and "phase" in page


def test_what_is_too_large_for_a_page_is_averaged_or_cut():
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


def test_pages_are_written_to_html_files_whose_folder_is_made(tmp_path, capsys):
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
    monkeypatch.setattr(webbrowser, "get", lambda: None)
    assert main(["show", "singlet"]) == 0
    assert opened == [capsys.readouterr().out.strip()]


def test_one_line_says_that_there_is_no_browser(tmp_path, monkeypatch, capsys):
    def nothing():
        raise webbrowser.Error("could not locate runnable browser")

    monkeypatch.setattr(typer, "launch", lambda _: pytest.fail("nothing can be opened"))
    monkeypatch.setattr(webbrowser, "get", nothing)
    assert main(["show", "singlet", "-o", str(tmp_path / "page.html")]) == 0
    said = capsys.readouterr()
    assert said.out.strip() == str(tmp_path / "page.html") and (tmp_path / "page.html").is_file()
    assert len(said.err.splitlines()) == 1 and "There is no browser here" in said.err


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


def test_sixteen_bit_pictures_are_scaled_and_types_are_known(tmp_path):
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


def test_a_field_without_values_says_so(tmp_path, capsys):
    np.save(tmp_path / "field.npy", np.full((8, 12), np.nan))
    assert "96 of 96 samples are not finite" in page_of(tmp_path / "field.npy", tmp_path)
    assert "no sample of the image is finite" in capsys.readouterr().err
