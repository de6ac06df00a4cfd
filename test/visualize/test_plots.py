"""Curves, images and surfaces."""

import numpy as np
import pytest
import torch

from odak.visualize.plotly import plot2dshow, plotshow, rayshow, surfaceshow


def test_surface_is_what_was_given_and_laid_out_before_saving(tmp_path):
    y, x = np.mgrid[0:3.0, 0:4.0]
    picture = surfaceshow(title="Sag", labels=["x (mm)", "y (mm)", "z (µm)"], types=["linear", "linear", "log"])
    picture.add_surface(torch.tensor(x), y.tolist(), torch.tensor(x * y).requires_grad_(), opacity=0.5, contour=True)
    (trace,) = picture.fig.data
    assert (trace.x, trace.y, trace.z) == (pytest.approx(x), pytest.approx(y), pytest.approx(x * y))
    assert (trace.opacity, trace.contours.z.show, trace.colorbar.len) == (0.5, True, 0.75)
    picture.save_html(tmp_path / "surface.html")
    layout = picture.fig.layout
    assert layout.title.text == "Sag" and layout.scene.zaxis.title.text == "z (µm)"
    assert layout.scene.zaxis.type == "log" and layout.scene.xaxis.nticks == 10
    assert layout.scene.aspectratio.to_plotly_json() == {"x": 1.0, "y": 1.0, "z": 1.0}
    assert layout.scene.camera.eye.to_plotly_json() == {"x": 1.87, "y": 0.88, "z": -0.64}
    assert (layout.width, layout.height, layout.margin.l, layout.margin.t) == (1000, 1000, 65, 90)


def test_axes_of_a_surface_may_be_rows_and_columns():
    picture = surfaceshow()
    picture.add_surface(np.arange(4.0), np.arange(3.0), np.zeros((3, 4)))
    assert picture.fig.data[0].x.shape == (4,) and picture.fig.data[0].y.shape == (3,)
    with pytest.raises(ValueError, match=r"data_x must be \[3, 4\] as data_z, or \[4\], got \[3\]"):
        picture.add_surface(np.arange(3.0), np.arange(3.0), np.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"data_z must be \[m, n\]"):
        picture.add_surface(np.arange(3.0), np.arange(3.0), np.zeros(3))


def test_settings_of_a_surface():
    assert set(surfaceshow().settings) >= {
        "title",
        "color scale",
        "x label",
        "y axis type",
        "z axis tick number",
        "font size",
        "width",
        "height",
        "margin",
        "camera",
        "colorbar length",
    }


def test_curves_and_images_keep_their_places_when_laid_out():
    picture = plotshow(rows=2, cols=2, subplot_titles=["a", "b", "c", "d"], labels=["time (s)", "loss"])
    picture.add_plot(torch.tensor([1.0, 2.0, 3.0]).requires_grad_(), np.array([4.0, 5.0, 6.0]), label="run", col=2)
    picture.add_plot([7.0, 8.0], mode="lines")
    picture.add_2d_plot(torch.arange(6.0).reshape(2, 3), label="map", row=2, showscale=True)
    curve, alone, image = picture.fig.data
    assert (curve.x.tolist(), curve.y.tolist(), curve.name, curve.xaxis) == ([1, 2, 3], [4, 5, 6], "run", "x2")
    assert (alone.x.tolist(), alone.y.tolist(), alone.mode) == ([7, 8], [0, 1], "lines")
    assert image.z == pytest.approx(np.arange(6.0).reshape(2, 3)) and image.colorbar.title.text == "map"
    picture.update_layout()
    assert picture.fig.layout.xaxis4.domain == pytest.approx((0.55, 1.0), abs=0.02)
    assert picture.fig.layout.yaxis4.domain == pytest.approx((0.0, 0.425))
    assert [note.text for note in picture.fig.layout.annotations] == ["a", "b", "c", "d"]
    assert {axis.title.text for axis in picture.fig.select_xaxes()} == {"time (s)"}
    assert {axis.title.text for axis in picture.fig.select_yaxes()} == {"loss"}


def test_curves_must_be_as_long_as_each_other():
    with pytest.raises(ValueError, match="got 2 and 3"):
        plotshow().add_plot([1.0, 2.0], [1.0, 2.0, 3.0])
    with pytest.raises(TypeError, match="image must be real"):
        plotshow().add_2d_plot(np.ones((2, 2), complex))


def test_settings_of_a_plot():
    kept = plotshow().settings
    assert (kept["color scale"], kept["font size"], kept["x label"], kept["colorbar length"]) == (
        "Inferno",
        16,
        "x",
        0.75,
    )


def test_origins_and_places_that_do_not_exist_are_named():
    picture = plotshow()
    with pytest.raises(ValueError, match="origin must be one of"):
        picture.add_2d_plot(np.ones((3, 4)), origin="nonsense")
    for place, message in (({"row": 2}, "row must be from 1 to 1"), ({"col": 0}, "col must be from 1 to 1")):
        with pytest.raises(ValueError, match=message):
            picture.add_plot([0.0, 1.0], **place)
    assert not picture.fig.data


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: surfaceshow(title=["Sag"]), "title must be a string, got list"),
        (lambda: surfaceshow(labels="xyz"), "labels must be a sequence of strings"),
        (lambda: surfaceshow(labels=["x", "y"]), "labels must have 3 strings, got 2"),
        (lambda: surfaceshow(margin=[0, 0, -1, 0]), "margin must be at least 0"),
        (lambda: plot2dshow(color_scale="no such scale"), "color_scale must be a colour scale of Plotly"),
        (lambda: plot2dshow(font_settings=48), "font_settings must be a dictionary, got int"),
        (lambda: plot2dshow(horizontal_spacing=1.01), "horizontal_spacing must be from 0 to 1"),
        (lambda: plot2dshow(vertical_spacing=-0.01), "vertical_spacing must be from 0 to 1"),
        (lambda: rayshow(line_width=-1), "line_width must be at least 0"),
        (lambda: rayshow(opacity=2), "opacity must be from 0 to 1"),
        (lambda: rayshow().add_triangle(np.eye(3), color=["red", "green"]), "color must be one colour or 1 of them"),
    ],
)
def test_arguments_are_named_before_plotly_sees_them(build, message):
    with pytest.raises((TypeError, ValueError), match=message):
        build()


def test_triangles_take_a_colour_a_value_or_none():
    picture, corners = rayshow(), np.arange(18.0).reshape(2, 3, 3) ** 2
    picture.add_triangle(corners, color=["red", "blue"])
    picture.add_triangle(corners, color=[0.25, 0.75])
    picture.add_triangle(corners, color="green")
    named, valued, one = picture.fig.data
    assert list(named.facecolor) == ["red", "blue"] and named.intensity is None
    assert list(valued.intensity) == [0.25, 0.75] and valued.intensitymode == "cell"
    assert one.color == "green" and one.intensity is None
