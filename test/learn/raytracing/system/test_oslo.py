"""Lens files of OSLO: what is read, written and refused."""

import math

import pytest
import torch

from odak.catalog import refractive_index
from odak.learn.raytracing.system import (
    coordinate_break,
    first_order,
    load_system,
    optical_system,
    read_len,
    surface,
    trace_fields,
    write_len,
)

LENS = """// OSLO 6.6 58447     0     0
LEN NEW "A lens" 100 4
EBR  0.5
ANG  5.0
DES  "OSLO"
UNI  10.0
// SRF 0
AIR
TH   1.0e+20
NXT  // SRF 1
GLA BK7
RD   5.0
TH   0.6
AP CHK 0.8
NXT  // SRF 2
WV 0.58756 0.48613 0.65627
GLA MOD MODEL1      1.6201 1.6272360458395 1.6169694895481
RD -4.0; CC -0.5
TH   0.2
NXT  // SRF 3
AIR
RD -20.0
AD 1.0e-4
AST
TH 3.0
PY 0.0
NXT  // SRF 4
AIR
TH 0.02
WV 0.58756 0.48613 0.65627
WW 1.0 0.5 0.5
END  4
"""


def read(folder, text):
    (folder / "lens.len").write_text(text)
    return read_len(folder / "lens.len")


def test_a_file_is_read_in_millimetres(tmp_path):
    system, report = read(tmp_path, LENS)
    assert system.name == "A lens" and (system.aperture, system.aperture_type) == (10.0, "EPD")
    assert system.reference == 0 and system.wavelengths[0] == pytest.approx(587.56e-6) and system.stop == 2
    assert system.wavelength_weights == (1.0, 0.5, 0.5)
    front, middle, back = system.surfaces
    assert (float(front.radius), float(front.thickness), front.semi_diameter) == (50.0, 6.0, 8.0)
    assert "BK7" in front.material.name and float(middle.conic) == -0.5
    found = system.prescription().index[:, 2].tolist()
    assert found == pytest.approx([1.6201, 1.6272360458395, 1.6169694895481], rel=1e-14)
    # 1e-4 centimetres⁻³.
    assert float(back.coefficients[1]) == pytest.approx(1e-7)
    assert float(back.thickness) == pytest.approx(float(first_order(system).image_distance) + 0.2)
    largest = math.tan(math.radians(5.0))
    tangents = [math.tan(math.radians(y)) for _, y in system.fields]
    assert tangents == pytest.approx([0.0, 0.7 * largest, largest])
    assert any("DES" in line for line in report.ignored) and any("0.7" in note for note in report.notes)


def test_wavelengths_beyond_the_third_are_read_by_their_number(tmp_path):
    text = LENS.replace("END  4", "WV4 0.7065\nWW4 0.25\nWV2 0.48\nEND 4")
    system, _ = read(tmp_path, text)
    assert system.wavelengths == pytest.approx([587.56e-6, 480e-6, 656.27e-6, 706.5e-6])
    assert system.wavelength_weights == (1.0, 0.5, 0.5, 0.25)
    with pytest.raises(ValueError, match="WV6 must follow WV3"):
        read(tmp_path, LENS.replace("END  4", "WV6 0.7\nEND 4"))


def test_a_singlet_has_the_power_of_the_lensmaker(tmp_path):
    text = (
        'LEN NEW "x" 50 3\nEBR 2; ANG 0\nTH 1e20\nNXT\nGLA BK7; RD 20; TH 2\nNXT\nAIR; RD -20; TH 20\nNXT\nAIR\nEND 3\n'
    )
    system, _ = read(tmp_path, text)
    n = refractive_index(system.surfaces[0].material, 587.56e-9, medium="air")
    power = (n - 1) * (2 / 20 - (n - 1) * 2 / (n * 400))
    assert float(first_order(system).focal_length) == pytest.approx(1 / power, rel=1e-9)


@pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss", "singlet"])
def test_round_trips_are_exact(tmp_path, name):
    lens = load_system(name)
    write_len(lens, tmp_path / "lens.len")
    again, _ = read_len(tmp_path / "lens.len")
    pupil = torch.tensor([[0.0, 0.0], [0.0, 0.9], [0.5, -0.5]], dtype=torch.float64)
    fields = [max(lens.fields, key=lambda field: field[1])]
    with torch.no_grad():
        first, second = (trace_fields(item, pupil, fields=fields) for item in (lens, again))
    order = [lens.reference, *(i for i in range(len(lens.wavelengths)) if i != lens.reference)]
    assert torch.allclose(first.y[order], second.y, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("near", [False, True])
def test_field_points_weights_and_vignetting_come_back(tmp_path, near):
    fields = [(0.0, 0.0), (0.0, -14.0), (3.0, 9.0), (-5.0, 20.0)]
    factors = [(0.0, 0.0, 0.0, 0.0), (0.1, -0.2, 0.05, 0.3), (0.0, 0.0, 0.0, 0.25), (0.0, 0.1, 0.0, 0.0)]
    lens = load_system("cooke_triplet")
    distance, aperture = (200.0, (0.02, "NA")) if near else (math.inf, (lens.aperture, lens.aperture_type))
    lens = optical_system(
        lens.surfaces,
        *aperture,
        object_distance=distance,
        fields=fields,
        field_weights=[1.0, 2.0, 0.5, 1.0],
        vignetting_factors=factors,
        wavelengths=lens.wavelengths,
    )
    write_len(lens, tmp_path / "lens.len")
    again, report = read_len(tmp_path / "lens.len")
    for name in ("fields", "field_weights", "vignetting_factors"):
        found, expected = (torch.tensor(getattr(item, name), dtype=torch.float64) for item in (again, lens))
        torch.testing.assert_close(found, expected, rtol=1e-14, atol=1e-14)
    assert not report.notes
    # OSLO reads the largest field, and one that is changed by hand scales all of them.
    text = (tmp_path / "lens.len").read_text()
    assert ("OBH 20.0" if near else "ANG 20.0") in text
    scaled, _ = read(tmp_path, text.replace("OBH 20.0", "OBH 10.0").replace("ANG 20.0", "ANG 10.0"))
    assert scaled.fields[-1][1] == pytest.approx(10.0)
    half = -7.0 if near else -math.degrees(math.atan(math.tan(math.radians(14)) * _ratio(10.0, 20.0)))
    assert scaled.fields[1][1] == pytest.approx(half)


def _ratio(one, other):
    return math.tan(math.radians(one)) / math.tan(math.radians(other))


def test_points_that_are_cut_short_and_fields_of_a_half_space_are_refused(tmp_path):
    with pytest.raises(ValueError, match="line 3: a field point must have 7 numbers, got 2"):
        read(tmp_path, LENS.replace("EBR  0.5", "// field point 0.0 1.0"))
    with pytest.raises(ValueError, match="fields of 90 degrees and more are not written, got 95 degrees"):
        write_len(optical_system([surface(50.0, thickness=5.0)], 1.0, fields=[0.0, 95.0]), tmp_path / "lens.len")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("AST\n", "DCY 0.1\n", "line 24: DCY is a command that is not understood"),
        ("TH   0.6", "TH six", "line 13: TH must have a number, got 'six'"),
        ("END  4\n", "", "a lens must end with END"),
        ("GLA BK7", "GLA NOGLASS", "surface 1: name .*NOGLASS.*read_len"),
        ("RD -4.0; CC -0.5", "PY 0.0", "surface 2: PY, a solve, is understood behind the last surface only"),
        ("UNI  10.0", "UNI -1", "UNI, millimetres of a unit, must be positive"),
        ("UNI  10.0", "UNI 1e-320", "a number is out of range"),
    ],
)
def test_what_would_be_wrong_is_refused(tmp_path, old, new, message):
    assert old in LENS
    with pytest.raises(ValueError, match=message):
        read(tmp_path, LENS.replace(old, new))


def test_what_is_not_written_is_refused(tmp_path):
    folded = optical_system([surface(thickness=5.0), coordinate_break(tilt=(5.0, 0.0, 0.0)), surface()], 2.0)
    with pytest.raises(ValueError, match=r"surfaces\[1\] is a coordinate break"):
        write_len(folded, tmp_path / "lens.len")
    zoom = load_system("singlet")
    zoom.settings = (("thickness", 0, (4.0, 5.0)),)
    with pytest.raises(ValueError, match="configurations are not written, got settings of thickness"):
        write_len(zoom, tmp_path / "lens.len")
