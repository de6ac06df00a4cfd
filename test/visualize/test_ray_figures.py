"""Rays, points, meshes and volumes: the traces hold what was given."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import odak
from odak.visualize.plotly import rayshow

KINDS = {
    "list": lambda x: np.asarray(x).tolist(),
    "numpy": np.asarray,
    "float32": lambda x: torch.tensor(np.asarray(x), dtype=torch.float32),
    "with gradient": lambda x: torch.tensor(np.asarray(x)).requires_grad_(),
    "bfloat16": lambda x: torch.tensor(np.asarray(x), dtype=torch.bfloat16),
    "list of tensors": lambda x: [torch.tensor(row).requires_grad_() for row in np.asarray(x)],
}
CORNERS = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 1.0], [0.0, 4.0, 0.5]])


def segments(trace, count):
    """Return the lines of a trace, taken apart at their gaps, ``[m, count, 3]``."""
    places = np.stack([trace.x, trace.y, trace.z], axis=-1)
    gaps = np.isnan(places).all(-1)
    assert not np.isnan(places[~gaps]).any()
    pieces = [piece for piece in np.split(places, np.flatnonzero(gaps)) if len(piece)]
    pieces = [piece[np.isfinite(piece).all(-1)] for piece in pieces]
    assert {len(piece) for piece in pieces} <= {count, 0}
    return np.array([piece for piece in pieces if len(piece)]).reshape(-1, count, 3)


@pytest.mark.parametrize("kind", KINDS)
def test_points_of_any_kind(kind):
    picture = rayshow(marker_size=3.0)
    picture.add_point(KINDS[kind](CORNERS), color="blue", label="corners", show_legend=True)
    (trace,) = picture.fig.data
    assert np.stack([trace.x, trace.y, trace.z], -1) == pytest.approx(CORNERS)
    assert (trace.mode, trace.marker.size, trace.marker.color) == ("markers", 3.0, "blue")
    assert (trace.name, trace.showlegend, trace.opacity) == ("corners", True, 1.0)


@pytest.mark.cuda
def test_points_on_a_gpu():
    picture = rayshow()
    picture.add_point(torch.tensor(CORNERS, device="cuda").requires_grad_())
    assert picture.fig.data[0].z == pytest.approx(CORNERS[:, 2])


def test_one_point_and_the_older_place_of_show_legend():
    picture = rayshow(opacity=0.3)
    picture.add_point(CORNERS[1], 1, 1, "green", True)
    (trace,) = picture.fig.data
    assert [trace.x[0], trace.y[0], trace.z[0]] == CORNERS[1].tolist()
    assert (trace.showlegend, trace.opacity) == (True, 0.3)


def test_colours_of_single_points():
    picture = rayshow(color_scale="Viridis")
    picture.add_point(CORNERS, color=["red", "green", "blue"])
    picture.add_point(CORNERS, color=torch.tensor([1.0, 2.0, 3.0]))
    names, values = picture.fig.data
    assert list(names.marker.color) == ["red", "green", "blue"]
    assert values.marker.color == pytest.approx([1, 2, 3])
    assert values.marker.colorscale[-1][1] == "#fde725"
    with pytest.raises(ValueError, match="3 of them or of values, got 2"):
        picture.add_point(CORNERS, color=["red", "green"])


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(2, 5), st.integers(0, 2**16))
def test_all_lines_are_one_trace_with_gaps(count, stations, seed):
    lines = np.random.default_rng(seed).normal(size=(count, stations, 3))
    picture = rayshow(line_width=2.0, opacity=0.4)
    picture.add_path(lines)
    (trace,) = picture.fig.data
    assert segments(trace, stations) == pytest.approx(lines)
    assert (trace.line.width, trace.opacity, trace.connectgaps) == (2.0, 0.4, False)


def test_ten_thousand_rays_are_one_trace():
    random = torch.Generator().manual_seed(0)
    rays = torch.randn(10_000, 2, 3, generator=random, dtype=torch.float64).requires_grad_()
    distance = torch.rand(10_000, generator=random, dtype=torch.float64)
    picture = rayshow()
    picture.add_rays(rays, distance)
    (trace,) = picture.fig.data
    found, kept = segments(trace, 2), rays.detach()
    assert found[:, 0] == pytest.approx(kept[:, 0].numpy())
    assert found[:, 1] == pytest.approx((kept[:, 0] + distance[:, None] * kept[:, 1]).numpy())


def test_rays_that_are_lost_are_left_out():
    rays = np.stack([np.zeros((3, 3)), np.eye(3)], axis=1)
    rays[1, 1] = np.nan
    picture = rayshow()
    picture.add_rays(rays, 2.0)
    assert segments(picture.fig.data[0], 2)[:, 1] == pytest.approx(2 * np.eye(3)[[0, 2]])


def test_a_path_breaks_where_a_point_is_lost():
    path = np.array([[[0.0, 0, 0], [0, 0, 1], [np.nan, 5, 2], [0, 0, 3]]])
    picture = rayshow()
    picture.add_path(path)
    z = picture.fig.data[0].z
    assert z[[0, 1, 3]].tolist() == [0, 1, 3] and np.isnan(z[2])


def test_one_start_serves_many_ends():
    picture = rayshow()
    picture.add_line(torch.zeros(3), torch.tensor(CORNERS), color="black", dash="dash")
    picture.add_line(CORNERS, [[0.0, 0.0, 9.0]])
    forth, back = picture.fig.data
    assert segments(forth, 2) == pytest.approx(np.stack([np.zeros((3, 3)), CORNERS], axis=1))
    assert segments(back, 2)[:, 1] == pytest.approx(np.tile([0.0, 0.0, 9.0], (3, 1)))
    assert (forth.line.dash, forth.line.color) == ("dash", "black")


def test_colours_of_single_lines():
    picture = rayshow()
    picture.add_line(np.zeros(3), np.eye(3), color=["red", "green", "blue"])
    (trace,) = picture.fig.data
    assert len(trace.line.color) == len(trace.x)
    assert [trace.line.color[i] for i in (0, 1, 3, 4, 6, 7)] == ["red"] * 2 + ["green"] * 2 + ["blue"] * 2


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda p: p.add_line(np.zeros((2, 3)), np.zeros((3, 3))), ValueError, "got 2 and 3"),
        (lambda p: p.add_line(np.zeros(3), np.zeros(3), dash="wavy"), ValueError, "dash must be one of"),
        (lambda p: p.add_point([1.0, 2.0]), ValueError, r"point must be \[3\] or \[m, 3\]"),
        (lambda p: p.add_point(np.zeros(3) * 1j), TypeError, "point must be real"),
        (lambda p: p.add_point("abc"), TypeError, "point must be an array"),
        (lambda p: p.add_point(np.zeros(3), column=2), ValueError, "column must be from 1 to 1, got 2"),
        (lambda p: p.add_triangle(np.zeros((3, 2))), ValueError, r"triangle must be \[3, 3\]"),
        (lambda p: p.add_sphere([0.0, 1.0]), ValueError, r"sphere must be \[4\]"),
        (lambda p: p.add_rays(np.zeros((4, 3))), ValueError, r"rays must be \[2, 3\]"),
        (lambda p: p.add_rays(np.zeros((4, 2, 3)), np.ones(3)), ValueError, "one for each of the 4 rays, got 3"),
        (
            lambda p: p.add_volume(np.zeros((4, 3)), np.zeros(3)),
            ValueError,
            "values must have one entry for each of 4",
        ),
        (lambda p: p.add_mesh(CORNERS, [[0, 1, 3]]), ValueError, "faces must be indices of vertices, 0 to 2"),
        (lambda p: p.add_surface(*[np.zeros((2, 3))] * 3, np.zeros((3, 2))), ValueError, "surface_color must be"),
        (lambda p: p.set_axis_limits(row=2), ValueError, "row must be from 1 to 1"),
    ],
)
def test_what_does_not_fit_is_named(call, error, message):
    picture = rayshow()
    with pytest.raises(error, match=message):
        call(picture)
    assert not picture.fig.data


def test_triangles_are_those_given():
    # Seen along z they overlap: only the corners' numbers can tell which three belong together.
    stacked = np.stack([CORNERS] * 3) + np.array([[[0, 0, 0]], [[0, 0, 1]], [[1, 1, 2]]])
    picture = rayshow(opacity=0.7)
    picture.add_triangle(torch.tensor(stacked), color="orange")
    (mesh,) = picture.fig.data
    places = np.stack([mesh.x, mesh.y, mesh.z], axis=-1)
    assert places[np.stack([mesh.i, mesh.j, mesh.k], axis=-1)] == pytest.approx(stacked)
    assert (mesh.color, mesh.opacity) == ("orange", 0.7)


def test_sphere_has_its_radius_and_colour_and_no_bar():
    picture = rayshow()
    picture.add_sphere(torch.tensor([[1.0, 2.0, 3.0, 5.0]]), color="orange")
    (ball,) = picture.fig.data
    places = np.stack([ball.x, ball.y, ball.z], axis=-1)
    assert places.shape == (100, 100, 3)
    assert np.linalg.norm(places - [1, 2, 3], axis=-1) == pytest.approx(np.full((100, 100), 5.0), rel=1e-6)
    assert places[..., 2].min() == pytest.approx(-2) and places[..., 2].max() == pytest.approx(8)
    assert ball.showscale is False
    assert {colour for _, colour in ball.colorscale} == {"orange"}


def test_surface_and_volume():
    y, x = np.mgrid[0:3.0, 0:4.0]
    picture = rayshow(columns=2, subplot_titles=["a", "b"])
    picture.add_surface(x, y, x * y, x + y, opacity=0.5, contour=True, column=2)
    picture.add_volume(np.random.default_rng(0).normal(size=(8, 3)), torch.arange(8.0), limits=[1.0, 5.0])
    surface, volume = picture.fig.data
    assert surface.z == pytest.approx(x * y) and surface.surfacecolor == pytest.approx(x + y)
    assert (surface.scene, surface.contours.z.show, surface.opacity) == ("scene2", True, 0.5)
    assert volume.value == pytest.approx(np.arange(8))
    assert (volume.isomin, volume.isomax, volume.surface.count) == (1.0, 5.0, 17)


def test_a_surface_too_fine_to_draw_is_thinned_and_says_so():
    z = np.add.outer(np.arange(1200.0), np.arange(30.0))
    picture = rayshow()
    picture.add_surface(np.arange(30.0), np.arange(1200.0), z, z)
    picture.update_layout()
    (trace,) = picture.fig.data
    assert trace.z == pytest.approx(z[::3, ::3]) and trace.y == pytest.approx(np.arange(0, 1200, 3))
    assert picture.fig.layout.annotations[-1].text == "every 3. point of 1200 × 30 drawn"


def test_scenes_are_numbered_row_by_row_and_set_alone():
    picture = rayshow(rows=2, columns=3)
    assert [picture.get_scene_number(row, column) for row in (1, 2) for column in (1, 2, 3)] == [1, 2, 3, 4, 5, 6]
    picture.set_camera(row=2, column=1, x=3.0, y=0.5, up="y")
    picture.set_axis_limits(row=2, column=1, z_limits=[0.0, 9.0])
    scene = picture.fig.layout.scene4
    assert (scene.camera.eye.x, scene.camera.eye.z, scene.camera.up.y) == (3.0, 1.0, 1.0)
    assert (scene.zaxis.range, scene.xaxis.range) == ((0.0, 9.0), (-1.0, 1.0))
    assert picture.fig.layout.scene5.zaxis.range is None


def test_aspect_holds_in_all_scenes(opened):
    picture = rayshow(columns=2)
    for column in (1, 2):
        picture.add_point(CORNERS, column=column)
    picture.show(aspect_ratio=[1.0, 2.0, 3.0])
    for scene in (picture.fig.layout.scene, picture.fig.layout.scene2):
        assert scene.aspectmode == "manual"
        assert (scene.aspectratio.x, scene.aspectratio.y, scene.aspectratio.z) == (1.0, 2.0, 3.0)


def test_settings():
    kept = rayshow(rows=1, columns=2, subplot_titles=["a", "b"], line_width=3.0, marker_size=4.0).settings
    assert {name: kept[name] for name in ("rows", "columns", "subplot titles", "line width", "marker size")} == {
        "rows": 1,
        "columns": 2,
        "subplot titles": ["a", "b"],
        "line width": 3.0,
        "marker size": 4.0,
    }
    assert (kept["opacity"], kept["color scale"]) == (0.5, "Inferno")


def test_a_detector_draws_itself_into_the_scene():
    detector = odak.catalog.plane_detector(resolution=[4, 6], shape=[8, 12], center=[0.0, 0.0, 10.0])
    picture = rayshow()
    detector.plot_detector(picture, plot_type="amplitude")
    (trace,) = picture.fig.data
    assert trace.z == pytest.approx(np.full((4, 6), 10.0)) and trace.surfacecolor.shape == (4, 6)
