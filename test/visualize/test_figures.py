"""Pages and Markdown: whole files, checked paths, nothing that waits for a window; and the package stays light."""

import os
import re
import subprocess
import sys
import webbrowser

import numpy as np
import pytest
import test_learn_ray
import test_learn_ray_intersect_w_a_sphere
import torch

from odak.visualize.plotly import detectorshow, field_show, figures, plot2dshow, plotshow, rayshow, surfaceshow

EVERY = [surfaceshow, plotshow, plot2dshow, detectorshow, rayshow]


def filled(kind):
    picture = kind()
    if kind is surfaceshow:
        picture.add_surface(np.arange(3.0), np.arange(2.0), np.ones((2, 3)))
    elif kind is plotshow:
        picture.add_plot([1.0, 2.0, 4.0])
    elif kind is rayshow:
        picture.add_line([0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    else:
        picture.add_field(np.ones((4, 4)))
    return picture


@pytest.mark.parametrize("kind", EVERY)
def test_page_is_whole_and_its_division_is_returned(kind, tmp_path, opened):
    name = tmp_path / "page.html"
    text = filled(kind).save_html(name)
    page = name.read_text(encoding="utf-8")
    assert "<html>" in page[:40] and page.rstrip().endswith("</html>")
    # The library is in the page, not in what is returned.
    assert len(page) > 3_000_000 and len(text) < 100_000
    assert text.startswith("<div") and text.endswith("</div>") and "Plotly.newPlot" in text
    assert "http" not in re.sub(r"https?://(www\.w3\.org|plotly\.com|plot\.ly)\S*", "", text)
    assert opened == [] and os.listdir(tmp_path) == ["page.html"]


@pytest.mark.parametrize("kind", EVERY)
def test_markdown_has_no_line_at_which_it_would_end(kind, tmp_path):
    name = tmp_path / "page.md"
    text = filled(kind).save_markdown(name)
    assert name.read_text(encoding="utf-8") == text + "\n"
    assert "\n\n" not in text and text.startswith("<div")
    assert not re.search(r"\n\s*\n", filled(kind).save_markdown(name, plotlyjs=True).strip())
    assert "<script" in filled(kind).save_markdown(name, plotlyjs="cdn").split("Plotly.newPlot")[0]


def test_save_offline_writes_the_page_and_returns_the_division(tmp_path, opened):
    name = tmp_path / "plot.html"
    division = filled(rayshow).save_offline(str(name))
    assert "Plotly.newPlot" in division and name.stat().st_size > 3_000_000 and not opened


def test_default_names_are_in_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    filled(rayshow).save_offline()
    filled(plot2dshow).save_markdown()
    assert sorted(os.listdir()) == ["plot.html", "plot.md"]


@pytest.mark.parametrize("method", ["save_html", "save_markdown", "save_image", "save"])
def test_paths_are_checked(method, tmp_path):
    save = getattr(filled(rayshow), method)
    for name in ("page.exe", "../page.html", "http://a/page.html", ""):
        with pytest.raises(ValueError, match=r"not allowed|not accepted"):
            save(name)
    extension = {"save_markdown": "md", "save_image": "png"}.get(method, "html")
    with pytest.raises(ValueError, match="does not exist"):
        save(tmp_path / "nowhere" / f"page.{extension}")
    assert not list(tmp_path.iterdir())


def test_an_older_page_stays_if_the_new_one_fails(tmp_path, monkeypatch):
    name = tmp_path / "page.html"
    name.write_text("older")
    monkeypatch.setattr(figures.page, "to_html", lambda *a, **k: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        filled(rayshow).save_html(name)
    assert name.read_text() == "older" and os.listdir(tmp_path) == ["page.html"]


def test_a_title_cannot_end_the_script(tmp_path):
    picture = surfaceshow(title="</script><script>alert(1)</script>")
    text = picture.save_html(tmp_path / "page.html")
    assert "<script>alert" not in text


def test_showing_without_display_writes_page_and_opens_nothing(tmp_path, opened):
    path = filled(rayshow).show()
    assert path == str(tmp_path / "picture_1.html") and not opened
    assert 'src="plotly.min.js"' in (tmp_path / "picture_1.html").read_text(encoding="utf-8")
    assert (tmp_path / "plotly.min.js").stat().st_size > 3_000_000
    assert filled(plotshow).show() == str(tmp_path / "picture_2.html")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="displays have these names on Linux")
def test_showing_with_a_display_opens_the_page(tmp_path, opened, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "get", lambda *a: webbrowser.BackgroundBrowser("firefox"))
    path = filled(rayshow).show()
    assert opened == [f"file://{path}"]
    # A text browser would take over the terminal.
    monkeypatch.setattr(webbrowser, "get", lambda *a: webbrowser.GenericBrowser("lynx"))
    filled(rayshow).show()
    assert len(opened) == 1


def test_a_chosen_renderer_is_used(opened, monkeypatch):
    shown = []
    monkeypatch.setattr(figures.page.renderers, "default", "json")
    monkeypatch.setattr(figures.page, "show", shown.append)
    picture = filled(rayshow)
    assert picture.show() is None and shown == [picture.fig] and not opened


def test_field_show_shows_unless_it_saves(tmp_path, opened):
    field_show(np.ones((4, 4)))
    assert (tmp_path / "picture_1.html").exists()
    field_show(np.ones((4, 4)), filename=tmp_path / "field.html")
    assert sorted(p.name for p in tmp_path.glob("*.html")) == ["field.html", "picture_1.html"]


def test_course_examples_can_be_seen(tmp_path, opened):
    test_learn_ray.test_rays(visualize=True)
    test_learn_ray_intersect_w_a_sphere.test_sphere_intersection(visualize=True)
    assert (tmp_path / "picture_1.html").exists() and (tmp_path / "picture_2.html").exists()


def test_calls_of_older_scripts(tmp_path, monkeypatch, opened):
    monkeypatch.chdir(tmp_path)
    picture = rayshow(
        rows=1, columns=2, subplot_titles=["Surface-to-Surface", "Target"], line_width=3.0, marker_size=3.0
    )
    points = torch.rand(5, 3).requires_grad_()
    picture.add_point(points, color=["red", "green", "blue", "black", "orange"])
    picture.add_line(torch.zeros(3), points[:1], row=1, column=1, color="black", dash="dash")
    picture.add_triangle(torch.rand(1, 3, 3), row=1, column=2, color="orange")
    picture.add_sphere(torch.tensor([[0.0, 0.0, 5.0, 3.0]]), color="grey")
    html = picture.save_offline()
    assert "<div" in html and len(picture.fig.data) == 4
    image = plot2dshow(row_titles=["a"], subplot_titles=["b", "c"], rows=1, cols=2, title="t")
    image.add_field(torch.rand(8, 8), row=1, col=2, showscale=True)
    assert len(image.fig.data) == 1


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_importing_stays_light_and_attributes_load():
    heavy = "{'plotly', 'kaleido', 'torch', 'plyfile', 'trimesh'} & set(sys.modules)"
    told = run(
        f"import sys, odak; odak.visualize.plotly; print(sorted({heavy}));"
        "figure = odak.visualize.plotly.rayshow(columns=2); print(figure.get_scene_number(1, 2));"
        "figure.add_point([1., 2., 3.]); print('torch' in sys.modules)"
    )
    assert told.split() == ["[]", "2", "False"]


def test_without_plotly_the_error_says_what_to_install():
    code = (
        "import sys; sys.modules['plotly.graph_objects'] = None\nimport odak\n"
        "try: odak.visualize.plotly.rayshow\nexcept ImportError as error: print(error)"
    )
    assert "pip install plotly kaleido" in run(code)


def test_every_public_name_resolves():
    import odak.visualize.plotly as package

    for name in package.__all__:
        assert getattr(package, name) is not None
    assert set(package.__all__) < set(dir(package))


def test_a_figure_describes_itself_in_a_line():
    shown = field_show(np.ones((4, 6), complex), show=False)
    assert repr(shown) == "detectorshow(2 traces: heatmap)"
