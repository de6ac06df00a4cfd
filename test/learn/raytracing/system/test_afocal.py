"""Afocal systems: angles behind them by hand, from a trace that ends in front of the ideal lens, and in files."""

import math

import pytest
import torch

from odak.learn.raytracing.system import (
    airy_pattern,
    distortion,
    first_order,
    huygens_point_spread_function,
    lateral_color,
    launch,
    layout_figure,
    lens_report,
    optical_system,
    point_spread_function,
    ray_fan,
    read_zmx,
    report_figures,
    rms_spot,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    wavefront,
    write_zmx,
)

F64 = torch.float64


def telescope(unit="mm", **options):
    """A Keplerian telescope of two glass lenses; lengths in the unit."""
    scale = {"mm": 1.0, "m": 1e-3}[unit]
    rows = [
        surface(100.0 * scale, thickness=5.0 * scale, material="N-BK7", stop=True),
        surface(-100.0 * scale, thickness=118.2 * scale),
        surface(25.0 * scale, thickness=3.0 * scale, material="N-BK7"),
        surface(-25.0 * scale, thickness=20.0 * scale),
    ]
    given = {"fields": [0.0, 0.5], "wavelengths": [0.55e-3 * scale, 0.65e-3 * scale], "unit": unit, "reference": 0}
    return optical_system(rows, 8.0 * scale, **given | options)


def test_lengths_in_the_image_are_tangents_of_angles():
    bare, afocal = telescope(), telescope(afocal=True)
    rays = trace(bare, launch(bare, "rings", 5))
    slopes = [1000 * rays.u / rays.w, 1000 * rays.v / rays.w]
    middle = [value.mean((0, 2), keepdim=True) for value in slopes]
    squares = sum((value - centre).square() for value, centre in zip(slopes, middle, strict=True))
    torch.testing.assert_close(rms_spot(afocal, "rings", 5), squares.mean((0, 2)).sqrt(), rtol=1e-9, atol=0)
    chief = trace(bare, launch(bare, torch.zeros(1, 2, dtype=F64)))
    slope = 1000 * (chief.v / chief.w)[..., 0]
    torch.testing.assert_close(lateral_color(afocal)[1, 1], -(slope[1, 1] - slope[0, 1]), rtol=1e-6, atol=1e-9)
    fan = ray_fan(afocal, "y", 3)[1]
    edge = trace(bare, launch(bare, torch.tensor([[0.0, -1.0]], dtype=F64)))
    torch.testing.assert_close(fan[0, :, 0], 1000 * (edge.v / edge.w)[0, :, 0] - slope[0], rtol=1e-8, atol=1e-9)
    # In metres the same angles are the same tangents.
    torch.testing.assert_close(rms_spot(telescope("m", afocal=True)), rms_spot(afocal) / 1000, rtol=1e-9, atol=0)


def test_wavefronts_are_those_against_a_plane():
    """The path of each ray to the plane across the chief ray in the centre of the exit pupil."""
    bare, afocal = telescope(), telescope(afocal=True)
    points = torch.tensor([[0.0, 0.0], [0.0, 1.0], [0.7, 0.0], [-0.5, -0.5]], dtype=F64)
    rays = launch(bare, points)
    found = trace(bare, rays)
    at, way = (torch.stack(parts, -1)[0] for parts in (found[:3], found[3:6]))
    path = (found.path + rays.x * rays.u + rays.y * rays.v)[0]
    pupil = float(first_order(bare).exit_pupil_distance) - 20.0
    away = (pupil - at[:, :1, 2:]) / way[:, :1, 2:]
    origin, normal = at[:, :1] + away * way[:, :1], way[:, :1]
    lag = path + ((origin - at) * normal).sum(-1) / (way * normal).sum(-1)
    expected = (lag - lag[:, :1]) / bare.wavelengths[0]
    torch.testing.assert_close(wavefront(afocal, points).path[0], expected, atol=2e-3, rtol=0)


def mersenne(**options):
    """A telescope of two confocal paraboloids without aberration on its axis; the beam becomes five times smaller."""
    primary = surface(-200.0, conic=-1.0, thickness=-80.0, material="mirror", stop=True)
    secondary = surface(-40.0, conic=-1.0, thickness=90.0, material="mirror")
    return optical_system([primary, secondary], 10.0, wavelengths=5e-4, **options)


def test_a_perfect_telescope_has_airys_disc():
    system = mersenne(afocal=True)
    assert float(rms_spot(system)) < 1e-9 and float(wavefront(system).rms) < 1e-4
    assert float(first_order(system).focal_length.abs()) == pytest.approx(5 * 1000, rel=1e-9)
    spread = point_spread_function(system, 64, 512)
    line = (torch.arange(512, dtype=F64) - 256) * spread.pitch[0, 0, 0]
    # The exit pupil is 2 mm wide: angles in milliradians are lengths over 1 m.
    expected = airy_pattern(line.abs(), 5e-4, math.sin(math.atan(1.0 / 1000)))
    torch.testing.assert_close(spread.intensity[0, 0, :, 256], expected, atol=5e-3, rtol=0)


@pytest.mark.slow
def test_files_figures_and_what_is_refused(tmp_path):
    system = telescope(afocal=True)
    write_zmx(system, tmp_path / "telescope.zmx")
    read, report = read_zmx(tmp_path / "telescope.zmx")
    assert not report.notes
    for again in (read, system_from_dict(system_to_dict(system))):
        assert again.afocal and len(again.surfaces) == 5
        torch.testing.assert_close(rms_spot(again), rms_spot(system), rtol=1e-12, atol=0)
    assert layout_figure(system).axes[0].dataLim.x1 < 200
    names = report_figures(system)
    assert "µrad" in names["spots"].axes[0].get_xlabel() and "milliradian" in names["transfer"].axes[0].get_xlabel()
    for wrong in ({"aperture_type": "F-number"}, {"image": surface(-50.0)}):
        with pytest.raises(ValueError, match="afocal needs"):
            telescope(afocal=True, **wrong)
    with pytest.raises(ValueError, match="afocal"):
        huygens_point_spread_function(system)


def test_a_mirror_sends_light_back_into_an_afocal_image():
    single = optical_system([surface(thickness=-50.0, material="mirror")], 20.0, fields=[0.0, 1.0], afocal=True)
    assert float(rms_spot(single).max()) < 1e-9 and float(distortion(single).abs().max()) < 1e-9


def test_reports_state_the_angular_magnification(tmp_path):
    """Five times for the confocal paraboloids, whose exit pupil is a fifth of the entrance pupil."""
    lens_report(mersenne(afocal=True), tmp_path / "report.html", figures={})
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    row = page[page.index("angular magnification") :].split("<td>")[1].split("</td>")[0]
    assert abs(float(row)) == pytest.approx(5.0, rel=1e-5)
    assert "exit pupil diameter</td><td>2<" in page and "RMS spot (µrad)" in page
