import json
import sys

import numpy as np
import pytest
import torch
from PIL import Image, ImageColor
from typer.testing import CliRunner

from odak._show import COLOURS
from odak.cli import app, main, trace
from odak.learn.raytracing.system import (
    Perturbation,
    first_order,
    in_environment,
    layout_figure,
    load_system,
    optical_system,
    rms_spot,
    sample_systems,
    save_solids,
    save_system,
    spots_figure,
    surface,
    tolerance,
    trace_fields,
    transfer_figure,
    wavefront,
    write_zmx,
)


@pytest.mark.parametrize(
    "name", [n if n == "triplet_f28" else pytest.param(n, marks=pytest.mark.slow) for n in sample_systems()]
)
@pytest.mark.slow
def test_a_sample_is_traced_drawn_and_reported(name, tmp_path, capsys):
    assert main(["trace", name, "--output", str(tmp_path), "--rings", "3"]) == 0
    assert "focal length" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    system = load_system(name)
    place, page = system.reference, (tmp_path / "report.html").read_text()
    # Means over a dense grid, which no number of the report knows.
    line = (torch.arange(300, dtype=torch.float64) + 0.5) / 150 - 1
    dense = torch.cartesian_prod(line, line)
    dense = dense[dense.square().sum(-1) <= 1]
    for key, values in (("rms_spot", rms_spot(system, dense)), ("wavefront_rms", wavefront(system, dense).rms[place])):
        found = [field[key] for field in report["fields"]]
        assert found == pytest.approx(values.tolist(), rel=3e-3), key
        scale = 1000 if key == "rms_spot" else 1
        assert all(f"<td>{scale * value:.6g}</td>" in page for value in found), key
    for field in report["fields"]:
        assert f"<td>{field['strehl']:.6g}</td>" in page
        for way in ("tangential", "sagittal"):
            assert all(f"<td>{value:.6g}</td>" in page for value in field["modulation"][way])
    assert report["quadrature"]["change"] < (0.03 if name == "double_gauss" else 1e-3)
    assert report["first_order"]["f_number"] == pytest.approx(
        {
            "singlet": 4.9826,
            "cooke_triplet": 4,
            "double_gauss_f28": 2.8,
            "double_gauss": 2,
            "phone_f2": 2,
            "triplet_f28": 2.8,
        }[name],
        rel=1e-3,
    )
    for field in report["fields"]:
        assert sum(field["statuses"].values()) == 3 * 37
    assert report["system"]["source"] and set(report["definitions"]) >= {"rms_spot", "strehl"}
    several = len(report["fields"]) > 1
    kinds = (
        "layout",
        "spots",
        "fans",
        "transfer",
        "through_focus",
        "wavefront",
        *(["field", "image", "performance", "pupil"] if several else []),
    )
    kinds = (*kinds, "footprint", "polarisation", "seidel")
    assert report["figures"] == [f"{kind}.png" for kind in kinds]
    assert (tmp_path / "report.html").read_text().count("<svg") == len(kinds)
    for picture in ("layout.png", "spots.png"):
        pixels = np.asarray(Image.open(tmp_path / picture).convert("RGB")).reshape(-1, 3).astype(int)
        for colour in COLOURS[:3]:
            assert (abs(pixels - ImageColor.getrgb(colour)).sum(-1) < 60).sum() > 20, (picture, colour)


def test_rays_in_the_layout_end_where_they_are_traced_to():
    lens = load_system("cooke_triplet")
    (axes,) = layout_figure(lens, count=3).axes
    rays = [line.get_xydata() for line in axes.get_lines() if line.get_color() == COLOURS[2]]
    heights = trace_fields(lens, "y", 3).y[lens.reference, 2]
    ends = sum(float(item.thickness) for item in lens.surfaces)
    assert len(rays) == 3
    for line, height in zip(rays, heights.tolist(), strict=True):
        np.testing.assert_allclose(line[-1], [ends, height], atol=1e-12)


def test_figures_for_a_paper():
    """Edges are cylinders, numbers of surfaces do not overprint, labels have two decimals, the circle has a scale."""
    rows = [
        surface(20.0, thickness=3.0, material=1.5, semi_diameter=4.0),
        surface(-60.0, thickness=0.1, semi_diameter=6.0),
        surface(-60.0, thickness=0.1, material=1.6, semi_diameter=6.0),
        surface(thickness=30.0, semi_diameter=6.0),
    ]
    lens = optical_system(rows, 6.0, fields=[0.0, 3.14159, 5.0, 7.0])
    figure = layout_figure(lens)
    (axes,) = figure.axes
    outline = axes.patches[0].get_xy()
    rim = outline[outline[:, 1] > 5.9]
    assert rim[:, 1].tolist() == pytest.approx([6.0] * len(rim)) and np.ptp(rim[:, 0]) > 2.0
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text().isdigit()]
    assert len(boxes) == 4 and not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["0°", "3.14°", "5°", "7°"]
    spots = spots_figure(lens)
    assert len({round(axes.get_position().y0, 3) for axes in spots.axes}) == 2
    assert any(text.get_text().startswith("Airy, radius") for text in spots.legends[0].get_texts())


def test_glasses_and_kinds_of_figures(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        trace.lenses, "report_figures", lambda system, aim, quality: {"layout": layout_figure(system, aim)}
    )
    catalogue = tmp_path / "own.agf"
    catalogue.write_text(
        "NM MYGLASS 2 0 1.5168 64.17 0 1\nCD 1.03961212 0.00600069867 0.231792344 0.0200179144 "
        "1.01046945 103.560653\nLD 0.3 2.5\n"
    )
    lens = tmp_path / "lens.zmx"
    write_zmx(load_system("singlet"), lens)
    lens.write_text(lens.read_text().replace("GLAS N-BK7", "GLAS MYGLASS"))
    out = tmp_path / "out"
    assert main(["trace", str(lens), "--output", str(out), "--glasses", str(catalogue), "--figures", "svg"]) == 0
    report = json.loads((out / "report.json").read_text())
    assert report["system"]["surfaces"][0]["material"] == "MYGLASS"
    assert report["figures"] == ["layout.svg"] and "<svg" in (out / "layout.svg").read_text()
    page = (out / "report.html").read_text()
    assert page.count("<svg") == 1 and "MYGLASS" in page and "Seidel" in page and "src=" not in page
    assert main(["trace", str(lens), "--glasses", str(tmp_path / "none.agf")]) == 2
    assert "--glasses" in capsys.readouterr().err


def test_a_zmx_file_is_traced_and_what_was_ignored_is_said(tmp_path, capsys, monkeypatch):
    # Figures are those of any lens, which other tests look at.
    monkeypatch.setattr(trace.lenses, "report_figures", lambda *_: {})
    path = tmp_path / "lens.zmx"
    write_zmx(load_system("singlet"), path)
    assert main(["trace", str(path), "--output", str(tmp_path), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert "DIAM 12.7" in json.loads((tmp_path / "report.json").read_text())["ignored"][0]


@pytest.mark.slow
def test_afocal_system_is_traced_without_figures_of_focus(tmp_path, capsys):
    plate = optical_system([surface(thickness=3.0, material="N-BK7"), surface(thickness=20.0)], 5.0)
    save_system(plate, tmp_path / "plate.json")
    assert main(["trace", str(tmp_path / "plate.json"), "--output", str(tmp_path), "--rings", "2"]) == 0
    assert capsys.readouterr().out.startswith("afocal: no focal length")
    assert json.loads((tmp_path / "report.json").read_text())["figures"] == [
        f"{name}.png" for name in ("layout", "spots", "fans", "wavefront", "footprint", "polarisation", "seidel")
    ]
    (panel,) = spots_figure(plate).axes
    # Points of rays, without Airy's circle.
    assert [line.get_marker() for line in panel.get_lines()] == ["."]
    with pytest.raises(ValueError, match="must have a focus"):
        transfer_figure(plate)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing"], "one of cooke_triplet, double_gauss, double_gauss_f28, phone_f2, singlet, triplet_f28"),
        (["nothing.zmx"], "SYSTEM not found: 'nothing.zmx'"),
        ([__file__], "SYSTEM must be a .json, .zmx, .seq or .len file, or the name of a sample lens"),
        (["singlet", "--rings", "0"], "--rings must be from 1 to 100"),
        (["singlet", "--aim", "high"], "--aim must be one of 'paraxial', 'real'"),
        (["singlet", "--figures", "bmp"], "--figures must be one of 'png', 'svg', 'pdf'"),
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


def test_a_lens_is_toleranced(tmp_path, capsys):
    asked = ["--output", str(tmp_path), "--samples", "4", "--limit", "0.13", "--no-focus"]
    assert main(["tolerance", "singlet", *asked]) == 0
    assert "yield" in capsys.readouterr().out
    report = json.loads((tmp_path / "report.json").read_text())
    items = [Perturbation(**item) for item in report["perturbations"]]
    found = tolerance(load_system("singlet"), items, 4)
    assert float(found.yield_within(0.13)) == report["yield"]
    median = float(found.merit.square().mean(-1).sqrt().quantile(0.5))
    assert report["rms_quantiles"]["0.5"] == pytest.approx(median, rel=1e-9)
    assert (tmp_path / "report.html").read_text().count("<svg") == 3 and (tmp_path / "tolerance.png").stat().st_size
    assert main(["tolerance", "singlet", "--yield", "1.5"]) == 2
    assert "--yield must be between 0 and 1" in capsys.readouterr().err


@pytest.mark.slow
def test_the_image_moves_to_the_best_focus(tmp_path, capsys):
    lens = load_system("double_gauss")
    lens.surfaces[-1].thickness += 0.379046  # to the paraxial focus
    save_system(lens, tmp_path / "lens.json")
    asked = ["trace", str(tmp_path / "lens.json"), "--rings", "3", "--output"]
    assert main([*asked, str(tmp_path / "drawn")]) == 0
    assert "0.379 mm in front of the image: --focus best" in capsys.readouterr().out
    assert main([*asked, str(tmp_path / "best"), "--focus", "best"]) == 0
    out = capsys.readouterr().out
    assert "the image has moved by -0.379 mm" in out and "field 14°: RMS spot" in out and "µm" in out
    drawn, best = (json.loads((tmp_path / name / "report.json").read_text()) for name in ("drawn", "best"))
    moved = best["system"]["surfaces"][-1]["thickness"] - drawn["system"]["surfaces"][-1]["thickness"]
    assert moved == pytest.approx(drawn["best_focus"], rel=1e-9)
    assert max(f["rms_spot"] for f in best["fields"]) < 0.5 * min(f["rms_spot"] for f in drawn["fields"])


def test_a_focus_that_is_not_known_is_named(tmp_path, capsys):
    assert main(["trace", "singlet", "--output", str(tmp_path), "--focus", "sharp"]) == 2
    assert "--focus must be one of 'as-drawn', 'best'; got 'sharp'" in capsys.readouterr().err


def test_a_lens_is_traced_at_a_temperature(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(trace.lenses, "report_figures", lambda *_: {})
    assert main(["trace", "singlet", "-o", str(tmp_path / "a"), "--temperature", "70", "--mount", "23.6e-6"]) == 0
    report = json.loads((tmp_path / "a/report.json").read_text())
    warm = in_environment(load_system("singlet"), 70.0, mount=23.6e-6)
    assert report["first_order"]["focal_length"] == pytest.approx(float(first_order(warm).focal_length), rel=1e-12)
    assert report["temperature"] == 70.0 and report["mount"] == 23.6e-6
    capsys.readouterr()
    for given, words in (
        (["--temperature", "-300"], "--temperature must be between"),
        (["--mount", "1e-5"], "--mount needs"),
    ):
        assert main(["trace", "singlet", "-o", str(tmp_path / "b"), *given]) == 2
        assert words in capsys.readouterr().err


def test_lenses_are_written_as_solids(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(trace.lenses, "report_figures", lambda *_: {})
    assert main(["trace", "singlet", "-o", str(tmp_path / "a"), "--solids", "stl"]) == 0
    assert "lenses.stl" in capsys.readouterr().out
    assert json.loads((tmp_path / "a/report.json").read_text())["solids"] == ["lenses.stl"]
    save_solids(load_system("singlet"), tmp_path / "own.stl")
    assert (tmp_path / "a/lenses.stl").read_bytes() == (tmp_path / "own.stl").read_bytes()
    monkeypatch.setitem(sys.modules, "OCP.BRepBuilderAPI", None)
    assert main(["trace", "singlet", "-o", str(tmp_path / "b"), "--solids", "step"]) == 2
    assert "--solids step: STEP needs the package cadquery-ocp" in capsys.readouterr().err
