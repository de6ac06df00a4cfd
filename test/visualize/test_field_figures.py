"""Images of fields: what is drawn, where, in which unit, and how it is reduced."""

import numpy as np
import plotly.colors
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import odak
from odak.visualize.plotly import detectorshow, field_show, plot2dshow, plotshow
from odak.visualize.plotly.field_figures import averaged, picked, reduction, spectrum


@pytest.fixture
def field(random):
    return random.normal(size=(6, 8)) + 1j * random.normal(size=(6, 8))


def drawn(picture):
    return {trace.name.split()[0]: trace for trace in picture.fig.data}


@pytest.mark.parametrize("as_field", [np.asarray, torch.tensor, lambda u: torch.tensor(u).requires_grad_().conj()])
def test_amplitude_phase_and_intensity_in_this_order(field, as_field):
    picture = detectorshow(show_intensity=True)
    picture.add_field(as_field(field))
    amplitude, phase, intensity = picture.fig.data
    seen = np.conj(field) if as_field not in (np.asarray, torch.tensor) else field
    assert amplitude.z == pytest.approx(np.abs(seen))
    assert phase.z == pytest.approx(np.degrees(np.angle(seen)))
    assert intensity.z == pytest.approx(np.abs(seen) ** 2)
    assert [trace.xaxis for trace in picture.fig.data] == ["x", "x2", "x3"]
    assert (picture.settings["sub column no"], picture.settings["column number"]) == (3, 3)


def test_fields_take_columns_of_their_own(field):
    picture = detectorshow(rows=2, cols=2, show_phase=True, show_amplitude=True)
    picture.add_field(field, row=2, col=2)
    assert [trace.xaxis for trace in picture.fig.data] == ["x7", "x8"]
    assert picture.settings["column number"] == 4


def test_precision_is_kept(field):
    picture = detectorshow()
    picture.add_field(field.astype(np.complex64))
    assert {trace.z.dtype for trace in picture.fig.data} == {np.dtype(np.float32)}


def test_equal_phases_have_equal_colours(field):
    picture = detectorshow(show_amplitude=False)
    picture.add_field(field)
    (trace,) = picture.fig.data
    assert trace.colorscale[0][1] == trace.colorscale[-1][1]
    assert (trace.zmin, trace.zmax) == (-180, 180)
    assert len({colour for _, colour in trace.colorscale}) > 5


def test_axes_tell_places_from_the_axis(field):
    for dx, unit, size in ((0.5e-3, "mm", 1e-3), (2e-6, "µm", 1e-6), (40e-9, "nm", 1e-9)):
        picture = detectorshow(show_phase=False)
        picture.add_field(field, dx=dx)
        (trace,) = picture.fig.data
        # 6 rows and 8 columns: the samples 3 and 4 are the axis.
        assert trace.x0 + 4 * trace.dx == pytest.approx(0, abs=1e-12)
        assert trace.y0 + 3 * trace.dy == pytest.approx(0, abs=1e-12)
        assert trace.dx * size == pytest.approx(dx) and trace.dy * size == pytest.approx(dx)
        assert picture.fig.layout.xaxis.title.text == f"x ({unit})"
        assert picture.fig.layout.yaxis.title.text == f"y ({unit})"


def test_rows_and_columns_have_distances_of_their_own():
    picture = field_show(
        np.ones((20, 30), complex), (8e-6, 4e-6), 532e-9, quantities=["amplitude", "spectrum"], show=False
    )
    amplitude, spectrum = picture.fig.data
    assert (amplitude.y0, amplitude.dy, amplitude.x0, amplitude.dx) == pytest.approx((-80, 8, -60, 4))
    # Sines of the angles go up to λ/(2·pitch).
    assert np.sin(np.deg2rad([spectrum.y[0], spectrum.x[0]])) == pytest.approx([-532e-9 / 16e-6, -532e-9 / 8e-6])
    assert picture.settings["title"] == "20 × 30 samples of 8 µm × 4 µm, wavelength 532 nm"


@pytest.mark.parametrize("n", [4, 5, 6, 7])
def test_the_middle_sample_is_the_axis_for_odd_and_even_sizes(n):
    picture = detectorshow(show_phase=False)
    picture.add_field(np.ones((n, n)), dx=1e-3)
    (trace,) = picture.fig.data
    assert trace.x0 + (n // 2) * trace.dx == 0


def test_without_a_pitch_samples_are_counted(field):
    picture = detectorshow(show_phase=False)
    picture.add_field(field)
    (trace,) = picture.fig.data
    assert (trace.x0, trace.dx, trace.y0, trace.dy) == (0, 1, 0, 1)
    assert picture.fig.layout.xaxis.title.text == "x (samples)"


def test_row_0_is_on_top_as_in_saved_images(field):
    picture = detectorshow(show_phase=False, cols=2)
    picture.add_field(field)
    picture.add_field(field, col=2, origin="lower")
    assert picture.fig.layout.yaxis.autorange == "reversed"
    assert picture.fig.layout.yaxis2.autorange is True
    assert picture.fig.layout.yaxis.scaleanchor == "x" and picture.fig.layout.yaxis2.scaleanchor == "x2"


def test_titles_follow_what_is_shown(field):
    def titles(**options):
        picture = detectorshow(**options)
        return [note.text for note in picture.fig.layout.annotations]

    assert titles() == ["Field 1", "Amplitude", "Phase"]
    assert titles(show_amplitude=False, show_intensity=True, row_titles=[]) == ["Phase", "Intensity"]
    assert titles(rows=2, row_titles=["a", "b"], show_phase=False) == ["a", "b", "Amplitude", "Amplitude"]
    named = ["u", "v", "w", "x"]
    assert titles(rows=2, row_titles=[], subplot_titles=named) == named
    picture = detectorshow(title="Retina")
    picture.add_field(field)
    picture.update_layout()
    assert picture.fig.layout.title.text == "Retina"


@settings(max_examples=40)
@given(st.integers(1, 13), st.integers(1, 13), st.integers(1, 5), st.integers(0, 2**16))
def test_blocks_are_averaged_and_picked(rows, columns, factor, seed):
    values = np.random.default_rng(seed).normal(size=(rows, columns))
    blocks = [
        [values[i : i + factor, j : j + factor] for j in range(0, columns, factor)] for i in range(0, rows, factor)
    ]
    assert averaged(values, factor) == pytest.approx(np.array([[block.mean() for block in row] for row in blocks]))
    found = picked(values, factor)
    assert found.shape == (len(blocks), len(blocks[0]))
    assert all(found[i, j] in blocks[i][j] for i in range(len(blocks)) for j in range(len(blocks[0])))


def test_a_field_too_large_to_draw_keeps_its_light_and_says_so(random):
    field = np.exp(1j * random.uniform(0, 6, (30, 50))) * random.uniform(0, 1, (30, 50))
    picture = detectorshow(show_intensity=True)
    picture.settings["maximum side"] = 25
    picture.add_field(field, dx=1e-3)
    picture.update_layout()
    amplitude, phase, intensity = picture.fig.data
    assert intensity.z.shape == (15, 25)
    assert intensity.z.mean() == pytest.approx((np.abs(field) ** 2).mean())
    assert amplitude.z**2 == pytest.approx(intensity.z)
    assert phase.z == pytest.approx(np.degrees(np.angle(field[1::2, 1::2])))
    # The middle of the first block is at sample 0.5, the axis at sample 25.
    assert (intensity.x0, intensity.dx) == (pytest.approx(0.5 - 25), 2)
    text = picture.fig.layout.annotations[-1].text
    assert "2 × 2 of 30 × 50 samples drawn as one (averaged)" in text
    assert reduction((1080, 1920), 1024) == 2 and reduction((1024, 10), 1024) == 1


def test_laying_out_twice_is_laying_out_once(field):
    picture = detectorshow(show_intensity=True, rows=2, row_titles=["a", "b"])
    picture.settings["maximum side"] = 4
    for row in (1, 2):
        picture.add_field(field, row=row, showscale=True, dx=1e-3)
    picture.update_layout()
    first = picture.fig.to_json()
    picture.update_layout()
    assert picture.fig.to_json() == first


def test_bars_stand_beside_their_images(field):
    picture = detectorshow(show_intensity=True, shape=[1200, 500])
    picture.add_field(field, showscale=True, dx=1e-3)
    picture.update_layout()
    width = 1200 - 65 - 50
    layout = picture.fig.layout
    for i, trace in enumerate(picture.fig.data):
        right = layout[f"xaxis{i + 1 if i else ''}"].domain[1]
        start = trace.colorbar.x
        assert start > right - 0.1 and start + (14 + 40) / width < right + 92 / width
        assert trace.colorbar.title.text.endswith(("(a.u.)", "(°)"))


def test_spectrum_of_a_tilted_wave_peaks_at_its_angle():
    dx, wavelength, n = 2e-6, 532e-9, 256
    order_x, order_y = 40, -24
    y, x = np.mgrid[:n, :n]
    wave = np.exp(2j * np.pi * (order_x * x + order_y * y) / n)
    panel = spectrum(wave, dx, wavelength)
    row, column = np.unravel_index(panel.values.argmax(), panel.values.shape)
    assert panel.values[row, column] == 0.0
    assert panel.axes["x"][column] == pytest.approx(np.degrees(np.arcsin(wavelength * order_x / (n * dx))))
    assert panel.axes["y"][row] == pytest.approx(np.degrees(np.arcsin(wavelength * order_y / (n * dx))))
    # Power spread over other angles is below the floor.
    assert (panel.values > -60).sum() == 1


def test_spectrum_leaves_out_evanescent_waves_and_needs_scale():
    panel = spectrum(np.random.default_rng(0).normal(size=(64, 64)) + 0j, 0.2e-6, 532e-9)
    inside = np.abs(np.fft.fftfreq(64, 0.2e-6) * 532e-9) < 1
    assert panel.values.shape == (inside.sum(),) * 2 and inside.sum() < 64
    with pytest.raises(ValueError, match="needs dx and wavelength"):
        field_show(np.ones((4, 4), complex), quantities="spectrum", show=False)


def test_field_show_in_one_line(field):
    stack = torch.tensor(np.stack([field, 2 * field])).requires_grad_()
    picture = odak.visualize.plotly.field_show(
        stack, 8e-6, 532e-9, quantities=["intensity", "phase", "spectrum"], labels=["near", "far"], show=False
    )
    assert len(picture.fig.data) == 6
    # Quantities have their places, whatever the order in which they are asked for.
    assert [trace.name for trace in picture.fig.data[:3]] == ["phase (°)", "intensity (a.u.)", "power (dB)"]
    assert picture.fig.data[4].z == pytest.approx(4 * np.abs(field) ** 2)
    assert picture.settings["title"] == "6 × 8 samples of 8 µm, wavelength 532 nm"
    assert [note.text for note in picture.fig.layout.annotations[:2]] == ["near", "far"]
    real = field_show(np.abs(field), show=False)
    assert [trace.name for trace in real.fig.data] == ["amplitude (a.u.)"]


def test_four_quantities_are_wrapped_and_the_height_fits(field):
    picture = field_show(field, 8e-6, 532e-9, quantities=["amplitude", "phase", "intensity", "spectrum"], show=False)
    assert [(trace.xaxis, trace.name.split()[0]) for trace in picture.fig.data] == [
        ("x", "amplitude"),
        ("x2", "phase"),
        ("x3", "intensity"),
        ("x4", "power"),
    ]
    picture.update_layout()
    layout = picture.fig.layout
    # 6 rows and 8 columns: each image is drawn 480 pixels wide and 360 high, and nothing is left between the rows.
    wide = (layout.xaxis.domain[1] - layout.xaxis.domain[0]) * (layout.width - 85 - 40)
    high = (layout.yaxis.domain[1] - layout.yaxis.domain[0]) * (layout.height - 80 - 90)
    assert wide == pytest.approx(480, abs=20) and high == pytest.approx(wide * 6 / 8, abs=1)
    assert layout.yaxis.domain[0] > layout.yaxis3.domain[1] and layout.yaxis3.domain[0] == pytest.approx(0)


def test_three_quantities_leave_one_place_empty(field):
    picture = detectorshow(show_intensity=True, wrap=2, rows=2, row_titles=["a", "b"])
    picture.add_field(field, row=2)
    assert [trace.xaxis for trace in picture.fig.data] == ["x5", "x6", "x7"]
    layout = picture.fig.layout
    assert layout.xaxis8.visible is False and layout.xaxis7.visible is None
    assert [note.text for note in layout.annotations][:2] == ["a", "b"]
    assert picture.fig.layout.annotations[1].yref == "y6 domain"


def test_stacks_have_a_slider_and_one_colour_scale(field, tmp_path):
    stack = np.stack([field * (i + 1) for i in range(5)])
    picture = field_show(stack, 8e-6, labels=["0 mm", "1 mm", "2 mm", "3 mm", "4 mm"], show=False)
    data = picture.fig.data
    assert len(data) == 10 and [trace.visible for trace in data] == [True, True, *[False] * 8]
    assert [trace.zmax for trace in data[::2]] == pytest.approx([5 * np.abs(field).max()] * 5)
    (slider,) = picture.fig.layout.sliders
    assert [step.label for step in slider.steps][3] == "3 mm"
    assert [i for i, shown in enumerate(slider.steps[3].args[0]["visible"]) if shown] == [6, 7]
    assert not field_show(stack, layout="rows", show=False).fig.layout.sliders
    assert not field_show(stack[:4], show=False).fig.layout.sliders
    assert field_show(stack[:2], layout="slider", show=False).fig.layout.sliders


def test_field_show_refuses_what_is_no_field():
    with pytest.raises(ValueError, match=r"field must be \[..., rows, columns\]"):
        field_show(np.ones(4), show=False)
    with pytest.raises(ValueError, match="quantities must be one of"):
        field_show(np.ones((4, 4)), quantities=["colour"], show=False)
    with pytest.raises(ValueError, match="dx must be positive"):
        field_show(np.ones((4, 4)), dx=-1.0, show=False)
    with pytest.raises(ValueError, match=r"one image \[rows, columns\]"):
        detectorshow().add_field(np.ones((3, 4, 4)))
    with pytest.raises(ValueError, match="at least one"):
        detectorshow(show_amplitude=False, show_phase=False)


def test_plot2dshow_holds_the_image_and_its_inset(tmp_path):
    name = tmp_path / "inset.png"
    Image.new("RGB", (4, 2), (255, 0, 0)).save(name)
    values = np.arange(12.0).reshape(3, 4)
    picture = plot2dshow(rows=2, cols=3, subplot_titles=[f"{i}" for i in range(6)], row_titles=["a", "b"])
    picture.add_field(torch.tensor(values[None]).requires_grad_(), row=2, col=3, zoomed_inset=str(name))
    (trace,) = picture.fig.data
    assert trace.z == pytest.approx(values) and trace.xaxis == "x6" and trace.showscale is False
    (inset,) = picture.fig.layout.images
    assert (inset.xref, inset.yref, inset.x, inset.y, inset.sizex, inset.sizey) == ("x6", "y6", 0, 150, 150, 150)
    assert inset.source.startswith("data:image/png;base64,")
    picture.update_layout()
    # All axes, not the first four alone.
    assert all(axis.linewidth == 8 and axis.showline for axis in picture.fig.select_xaxes())
    assert all(axis.linewidth == 8 and axis.mirror for axis in picture.fig.select_yaxes())
    assert len(list(picture.fig.select_xaxes())) == 6
    assert {note.font.size for note in picture.fig.layout.annotations} == {48}


def test_plot2dshow_refuses_what_it_cannot_read(tmp_path):
    broken, text = tmp_path / "broken.png", tmp_path / "inset.txt"
    broken.write_bytes(b"not an image")
    text.write_text("no")
    picture = plot2dshow()
    with pytest.raises(ValueError, match=r"broken\.png' cannot be read as an image"):
        picture.add_field(np.ones((2, 2)), zoomed_inset=broken)
    with pytest.raises(ValueError, match=r"Extension '\.txt' is not allowed"):
        picture.add_field(np.ones((2, 2)), zoomed_inset=text)
    with pytest.raises(TypeError, match="complex"):
        picture.add_field(np.ones((2, 2), complex))
    assert not picture.fig.data


def test_settings_are_those_documented():
    kept = plot2dshow().settings
    assert kept["color scale"] == "Inferno" and kept["font"] == {"size": 48}
    assert kept["margin"] == [65, 50, 65, 90] and (kept["width"], kept["height"]) == (1000, 1000)
    assert kept["xaxis"]["linecolor"] == "black"
    other = plot2dshow()
    other.settings["xaxis"]["linecolor"] = "red"
    assert plot2dshow().settings["xaxis"]["linecolor"] == "black"
    assert detectorshow().settings["color scale"] == "Inferno"
    assert detectorshow().settings["phase color scale"].lower() in {
        name.lower() for name in dir(plotly.colors.cyclical)
    }


def test_a_detector_shows_its_field(opened):
    detector = odak.catalog.plane_detector(resolution=[4, 6], shape=[8, 12])
    detector.plot_field()
    assert len(detector.fig.fig.data) == 2


def test_samples_without_a_value_are_counted():
    values = np.ones((4, 6))
    values[1, 2], values[2, 3] = np.nan, np.inf
    for figure in (field_show(values, show=False), plotshow()):
        if isinstance(figure, plotshow):
            figure.add_2d_plot(values)
        figure.update_layout()
        assert "2 of 24 samples are not finite and left blank" in str(figure.fig.layout.annotations)
    with pytest.warns(odak.ArgumentWarning, match="no sample of the image is finite, all 24"):
        field_show(np.full((4, 6), np.nan + 0j), show=False)


def test_lengths_may_have_units(field):
    one, other = (field_show(field, dx=dx, wavelength=w, show=False) for dx, w in (("8um", "532nm"), (8e-6, 532e-9)))
    assert one.settings["title"] == other.settings["title"] and one.fig.to_json() == other.fig.to_json()
