"""Vignetting factors of fields, and weights of fields and wavelengths: against closed forms, and in files."""

import json
import math

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import (
    Operand,
    Variable,
    airy_pattern,
    exit_field,
    huygens_point_spread_function,
    launch,
    lens_design,
    load_system,
    optical_system,
    point_spread_function,
    point_spread_map,
    pupil_samples,
    read_zmx,
    relative_illumination,
    rms_spot,
    save_system,
    spot_diagram,
    surface,
    system_to_dict,
    through_focus,
    trace,
    trace_fields,
    wavefront,
    write_zmx,
)

F64 = torch.float64
FACTORS = ((0.0, 0.0, 0.0, 0.0), (0.1, -0.2, 0.3, 0.4))


def lens(**options):
    given = {"fields": [0.0, 5.0], "wavelengths": [486e-6, 588e-6, 656e-6]} | options
    rows = [surface(thickness=8.0, stop=True), surface(50.0, thickness=4.0, material="N-BK7")]
    return optical_system([*rows, surface(-60.0, thickness=50.0)], 10.0, **given)


@pytest.mark.parametrize("aim", ["paraxial", "real"])
def test_rays_pass_the_points_of_the_definition(aim):
    """The stop is the first surface, where x = 5·(VDX + (1 − VCX)·px), y = 5·(VDY + (1 − VCY)·py)."""
    points = pupil_samples("rings", 2)
    rays = launch(lens(vignetting_factors=FACTORS), points, aim=aim)
    for i, (dx, dy, cx, cy) in enumerate(FACTORS):
        torch.testing.assert_close(rays.x[0, i], 5 * (dx + (1 - cx) * points[:, 0]), atol=1e-12, rtol=0)
        torch.testing.assert_close(rays.y[0, i], 5 * (dy + (1 - cy) * points[:, 1]), atol=1e-12, rtol=0)


def test_stops_behind_lenses_are_filled_as_the_factors_say():
    triplet = load_system("cooke_triplet")
    triplet.vignetting_factors = ((0, 0, 0, 0), (0.1, 0.0, 0.2, 0.0), (0.0, 0.1, 0.0, 0.4))
    points = pupil_samples("rings", 2)
    rays = launch(triplet, points, aim="real")
    own = triplet.prescription().at(triplet.reference)
    at_stop = trace(triplet, rays, prescription=own, until=triplet.stop, vignetting=False)
    radius = float(at_stop.x[0, 0].max())
    torch.testing.assert_close(at_stop.y[0, 2], radius * (0.1 + 0.6 * points[:, 1]), atol=1e-8, rtol=0)
    torch.testing.assert_close(at_stop.x[0, 1], radius * (0.1 + 0.8 * points[:, 0]), atol=1e-8, rtol=0)


def test_factors_belong_to_the_fields_of_the_system():
    vignetted, whole = lens(vignetting_factors=FACTORS), lens()
    for fields in ([(0.0, 5.0), (0.0, 3.0)], torch.tensor([[0.0, 5.0], [0.0, 3.0]], dtype=F64)):
        found, plain = (launch(system, "y", 5, fields=fields) for system in (vignetted, whole))
        torch.testing.assert_close(found.y[0, 0], plain.y[0, 0] * 0.6 - 5 * 0.2 + 0 * plain.y[0, 0], atol=1e-12, rtol=0)
        assert torch.equal(found.y[0, 1], plain.y[0, 1])
    vignetted.fields = ((0.0, 1.0),)
    with pytest.raises(ValueError, match="vignetting_factors of the system must be given for each of its 1 fields"):
        launch(vignetted)


def test_an_elliptic_pupil_has_an_elliptic_airy_disc():
    """A parabolic mirror, compressed to the half along y: along y the pattern is that of half the aperture."""
    parabola = surface(radius=-200.0, conic=-1.0, thickness=-100.0, material="mirror")
    mirror = optical_system([parabola], aperture=2.0, wavelengths=500e-6, vignetting_factors=[(0, 0, 0, 0.5)])
    spread = point_spread_function(mirror, 64, 512)
    for axis, aperture in ((0, 0.005), (1, 0.01)):
        line = (spread.intensity[0, 0, :, 256] if axis == 0 else spread.intensity[0, 0, 256])[256:288]
        radius = torch.arange(32, dtype=F64) * spread.pitch[0, 0, axis]
        torch.testing.assert_close(line, airy_pattern(radius, 500e-6, aperture), atol=4e-3, rtol=0)
    direct = huygens_point_spread_function(mirror, 48, 33, pitch=2e-3)
    for line, aperture in ((direct.intensity[0, 0, :, 16], 0.005), (direct.intensity[0, 0, 16], 0.01)):
        radius = (torch.arange(33, dtype=F64) - 16).abs() * 2e-3
        torch.testing.assert_close(line, airy_pattern(radius, 500e-6, aperture), atol=4e-3, rtol=0)


@pytest.mark.parametrize("aim", ["paraxial", "real"])
def test_the_field_behind_the_lens_ends_at_the_vignetted_pupil(aim):
    """Behind the parabola in its own aperture plane, the field covers π·1·0.5 of it, shifted by VDY."""
    parabola = surface(radius=-2000.0, conic=-1.0, thickness=-1000.0, material="mirror")
    mirror = optical_system([parabola], 2.0, wavelengths=500e-6, vignetting_factors=[(0, 0.25, 0, 0.5)])
    found = exit_field(mirror, 128, 0.025, distance=-1e-3, aim=aim)
    lit = found.field.abs() > 0.5 * found.field.abs().max()
    assert float(lit.sum()) * 0.025**2 == pytest.approx(math.pi * 0.5, rel=0.05)
    rows, columns = torch.nonzero(lit, as_tuple=True)
    assert (int(rows.max() - rows.min()) + 1) * 0.025 == pytest.approx(1.0, abs=0.06)
    assert (int(columns.max() - columns.min()) + 1) * 0.025 == pytest.approx(2.0, abs=0.06)


def test_compressed_pupils_pass_less_light():
    whole, vignetted = (relative_illumination(lens(**o), 6)[1, 1] for o in ({}, {"vignetting_factors": FACTORS}))
    small = [relative_illumination(lens_of(o), 6)[0, 1] for o in ({}, {"vignetting_factors": FACTORS})]
    assert float(small[1] / small[0]) == pytest.approx(0.7 * 0.6, rel=1e-3)
    assert float(vignetted) < 0.5 * float(whole)


def lens_of(options):
    """A lens of so small an aperture that its pupil is evenly lit."""
    rows = [surface(thickness=8.0, stop=True), surface(50.0, thickness=54.0, material=1.5)]
    return optical_system(rows, 0.1, fields=[0.0, 5.0], **options)


def test_weights_of_wavelengths_in_spots():
    weights = np.array([1.0, 3.0, 0.5])
    system, plain = lens(wavelength_weights=weights.tolist()), lens()
    rays = trace_fields(plain, "rings", 4)
    share = (weights / weights.sum())[:, None]
    for field in range(2):
        x, y = rays.x[:, field].numpy(), rays.y[:, field].numpy()
        cx, cy = ((share * v).sum() / v.shape[1] for v in (x, y))
        expected = math.sqrt((share * ((x - cx) ** 2 + (y - cy) ** 2)).sum() / x.shape[1])
        assert float(rms_spot(system, "rings", 4)[field]) == pytest.approx(expected, rel=1e-12)
        assert float(through_focus(system, [0.0], "rings", 4)[field, 0]) == pytest.approx(expected, rel=1e-9)
    alike = lens(wavelength_weights=[2.0, 2.0, 2.0])
    assert torch.equal(spot_diagram(alike).rms, spot_diagram(plain).rms)
    # Weights belong to the wavelengths of the system, and others have none.
    numbers = system.prescription([system.wavelengths[2], system.wavelengths[0]])
    lone = lens(wavelengths=numbers.wavelengths.tolist(), wavelength_weights=[weights[2], weights[0]], reference=0)
    assert float(rms_spot(system, prescription=numbers)[1]) == pytest.approx(float(rms_spot(lone)[1]), rel=1e-9)
    others = plain.prescription([4.5e-4, 5.5e-4, 6.0e-4])
    assert torch.equal(rms_spot(system, prescription=others), rms_spot(plain, prescription=others))
    # One wavelength alone has no weight.
    one = plain.prescription().at(1)
    assert torch.equal(rms_spot(system, prescription=one), rms_spot(plain, prescription=one))


def test_weights_in_merit_functions():
    """The squares of the residuals are those of each field and wavelength times its weight over the mean."""
    options = {"field_weights": [1.0, 3.0], "wavelength_weights": [1.0, 2.0, 1.0]}
    system = lens(**options)
    for kind in ("spot", "wavefront"):
        design = lens_design(system, Operand(kind), Variable("thickness", 2), pupil="rings", count=3)
        total = float(design.residuals(design.values[None]).square().sum())
        if kind == "spot":
            expected = float((rms_spot(system, "rings", 3).square() * torch.tensor([0.5, 1.5], dtype=F64)).sum())
        else:
            each = wavefront(lens(), "rings", 3).rms.square() * torch.tensor([[0.75], [1.5], [0.75]], dtype=F64)
            expected = float((each * torch.tensor([0.5, 1.5], dtype=F64)).sum())
        assert total == pytest.approx(expected, rel=1e-9)


def test_pictures_of_one_channel_weigh_the_wavelengths():
    """Of two wavelengths, that of weight 0 adds nothing."""
    rows = [surface(thickness=1.0, stop=True), surface(50.0, thickness=100.0, material=1.5)]
    two = optical_system(rows, 4.0, wavelengths=[5e-4, 6e-4], reference=0, wavelength_weights=[1.0, 0.0])
    one = optical_system(rows, 4.0, wavelengths=5e-4)
    spreads = [point_spread_map(system, (16, 16), 0.2, grid=(3, 3)) for system in (two, one)]
    torch.testing.assert_close(spreads[0].kernels, spreads[1].kernels, atol=1e-12, rtol=0)


def test_files_keep_factors_and_weights(tmp_path):
    options = {"vignetting_factors": FACTORS, "field_weights": [1.0, 2.0], "wavelength_weights": [0.5, 1.0, 0.25]}
    system = lens(**options)
    save_system(system, tmp_path / "lens.json")
    write_zmx(system, tmp_path / "lens.zmx")
    assert json.loads((tmp_path / "lens.json").read_text())["wavelength_weights"] == [0.5, 1.0, 0.25]
    for again in (load_system(tmp_path / "lens.json"), read_zmx(tmp_path / "lens.zmx")[0]):
        for name, value in options.items():
            assert getattr(again, name) == tuple(tuple(v) if isinstance(v, tuple) else v for v in value), name
        torch.testing.assert_close(trace_fields(again).y, trace_fields(system).y, atol=1e-9, rtol=0)
    assert not {"vignetting_factors", "field_weights"} & set(system_to_dict(lens()))


def test_factors_with_an_angle_are_named(tmp_path):
    path = tmp_path / "lens.zmx"
    write_zmx(lens(vignetting_factors=FACTORS), path)
    assert read_zmx(path)[1].ignored == ()
    path.write_text(path.read_text().replace("VCXN", "VANN 0.0 30.0\nVCXN"))
    found, report = read_zmx(path)
    assert found.vignetting_factors is None
    assert any("vignetting factors of fields 2 have an angle (VANN)" in note for note in report.notes)
    assert any("VANN 0.0 30.0" in line for line in report.ignored)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vignetting_factors": [(0, 0, 0, 0)]}, "vignetting_factors must be given for each of 2 fields, got 1"),
        ({"vignetting_factors": [(0, 0, 0)] * 2}, "vignetting_factors must have 4 numbers, got 3"),
        ({"vignetting_factors": [(0, 0, 1.0, 0)] * 2}, "VCX and VCY below 1"),
        ({"field_weights": [1.0]}, "field_weights must have 2 numbers, got 1"),
        ({"field_weights": [1.0, -1.0]}, "field_weights"),
        ({"wavelength_weights": [0, 0, 0]}, "wavelength_weights must have one above 0"),
    ],
)
def test_what_is_wrong_is_named(options, message):
    with pytest.raises(ValueError, match=message):
        lens(**options)
