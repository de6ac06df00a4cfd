"""Contents of Zemax files beyond plain lenses, against closed forms: surfaces, media, apertures, fields, glasses."""

import math
import re

import numpy as np
import pytest
import torch

from odak.catalog import refractive_index
from odak.learn.raytracing.system import (
    coordinate_break,
    first_order,
    launch,
    load_system,
    optical_system,
    read_zmx,
    surface,
    trace,
    trace_fields,
    write_zmx,
)

HEAD = """VERS 140124 258 36214
MODE SEQ
NAME test
UNIT {unit} X W X CM MR CPMM
{aperture}
GCAT {makers}
FTYP {fields} {count} 1 0 0 0
XFLN {x}
YFLN {y}
WAVM 1 {wave} 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ {distance}
SURF 1
{surface}
SURF 2
  TYPE STANDARD
  CURV -0.01
  DISZ 90
SURF 3
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""
DEFAULTS = {
    "unit": "MM",
    "aperture": "ENPD 10.0",
    "makers": "SCHOTT",
    "fields": "0 0",
    "count": "1",
    "x": "0",
    "y": "0",
    "wave": "0.5875618",
    "distance": "INFINITY",
    "surface": "  STOP\n  TYPE STANDARD\n  CURV 0.01\n  DISZ 4\n  GLAS N-BK7 0 0",
}


def read(folder, encoding="utf-8", change=str, glasses=None, **given):
    path = folder / "lens.zmx"
    path.write_bytes(change(HEAD.format(**(DEFAULTS | given))).encode(encoding))
    return read_zmx(path, glasses)


def a_surface(kind, *lines, glass="N-BK7"):
    rows = ["STOP", f"TYPE {kind}", *lines, "DISZ 4", f"GLAS {glass} 0 0"]
    return {"surface": "\n".join(f"  {row}" for row in rows)}


def numbers(key, values, start=1):
    return [f"{key} {i} {value!r}" for i, value in enumerate(values, start=start)]


# Points of a surface in millimetres; the files are in centimetres, so that lengths and powers must be converted.
X, Y = (torch.tensor(v, dtype=torch.float64) for v in ([0.3, -2.0, 1.1], [0.8, 0.7, -1.9]))
U, V = X / 10, Y / 10


def conic(curvature, k):
    squared = U**2 + V**2
    return curvature * squared / (1 + (1 - (1 + k) * curvature**2 * squared) ** 0.5)


def fringe(u, v):
    """Return the first ten fringe Zernike polynomials and the sixteenth, in Cartesian coordinates."""
    s = u * u + v * v
    first = [1 + 0 * u, u, v, 2 * s - 1, u * u - v * v, 2 * u * v, (3 * s - 2) * u, (3 * s - 2) * v]
    return [*first, 6 * s**2 - 6 * s + 1, u**3 - 3 * u * v * v], 20 * s**3 - 30 * s**2 + 12 * s - 1


def fringe_sag():
    ten, sixteenth = fringe(U / 0.4, V / 0.4)
    values = [0.01 * (i + 1) for i in range(10)]
    total = sum(a * z for a, z in zip(values, ten, strict=True)) + 0.02 * sixteenth
    return values, total + 0.3 * (U**2 + V**2) ** 2


S = U**2 + V**2
SHAPES = {
    "TILTSURF": (["CURV 0.0", "PARM 1 0.1", "PARM 2 -0.2"], 0.1 * U - 0.2 * V),
    "XASPHERE": (
        ["CURV 0.2", "CONI -0.5", *numbers("XDAT", [3, 0.5, 0.01, 0.02, -0.03])],
        conic(0.2, -0.5) + sum(a * (S / 0.25) ** i for i, a in ((1, 0.01), (2, 0.02), (3, -0.03))),
    ),
    "XOSPHERE": (
        ["CURV 0.2", *numbers("XDAT", [3, 0.5, 0.01, 0.02, -0.03])],
        conic(0.2, 0.0) + sum(a * (S**0.5 / 0.5) ** i for i, a in ((1, 0.01), (2, 0.02), (3, -0.03))),
    ),
    "FZERNSAG": (
        ["CURV 0.2", "PARM 2 0.3", *numbers("XDAT", [16, 0.4, *fringe_sag()[0], 0, 0, 0, 0, 0, 0.02])],
        conic(0.2, 0.0) + fringe_sag()[1],
    ),
    "IRREGULA": (
        ["CURV 0.2", "CONI -0.5", "DIAM 0.4 1 0 0 1", *numbers("PARM", [0.01, -0.02, 3.0, 2.0, 0.02, 0.03, -0.01])],
        conic(0.2, -0.5) + 0.02 * (S / 0.16) ** 2 + 0.03 * V**2 / 0.16 - 0.01 * S * V / 0.064,
    ),
    "SZERNSAG": (
        ["CURV 0.2", "PARM 1 0.1", "PARM 3 -0.7", *numbers("XDAT", [5, 0.4, 0, 0, 0.01, 0.02, 0.03])],
        conic(0.2, 0.0)
        + 0.1 * S
        - 0.7 * S**3
        + 0.01 * 2 * V / 0.4
        + 0.02 * 3**0.5 * (2 * S / 0.16 - 1)
        + 0.03 * 6**0.5 * 2 * U * V / 0.16,
    ),
}


@pytest.mark.filterwarnings("ignore:.*no ray that arrives:odak.AccuracyWarning")
@pytest.mark.parametrize("kind", SHAPES)
def test_heights_of_surfaces_are_those_of_their_definitions(tmp_path, kind):
    lines, expected = SHAPES[kind]
    system, report = read(tmp_path, unit="CM", **a_surface(kind, *lines))
    torch.testing.assert_close(system.surfaces[0].shape.sag(X, Y).height, 10 * expected, atol=1e-12, rtol=0)
    assert not [line for line in report.ignored if "PARM" in line or "XDAT" in line]


def test_irregular_surfaces_are_as_between_coordinate_breaks(tmp_path):
    """One decentred by (0.2, -0.1) and tilted by (3, 2) degrees; without a deviation it is the sphere itself."""
    rows = ["CURV 0.01", *numbers("PARM", [0.2, -0.1, 3.0, 2.0])]
    found, _ = read(tmp_path, **a_surface("IRREGULA", *rows))
    front, back = found.surfaces
    turn = {"shift": (0.2, -0.1), "tilt": (3.0, 2.0, 0.0)}
    undo = {"shift": (-0.2, 0.1), "tilt": (-3.0, -2.0, 0.0), "order": "tilt"}
    item = surface(curvature=0.01, material="N-BK7")
    row = [
        coordinate_break(**turn),
        item,
        coordinate_break(**undo, thickness=4.0),
        surface(curvature=-0.01, thickness=90.0),
    ]
    system = optical_system(row, 10.0, wavelengths=587.5618e-6)
    rays = launch(found, "rings", 3)
    for name in "xyuv":
        one, other = (getattr(trace(lens, rays), name) for lens in (found, system))
        torch.testing.assert_close(one, other, atol=1e-12, rtol=0)
    assert bool(front.is_off_axis) and not back.is_off_axis


@pytest.mark.parametrize(
    ("rows", "message"),
    [(["PARM 6 0.1"], "needs a semi-diameter"), (["DIAM 5", "PARM 6 0.1", "PARM 8 30"], "turned by an angle")],
)
def test_irregular_surfaces_that_are_not_understood_are_refused(tmp_path, rows, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, **a_surface("IRREGULA", "CURV 0.01", *rows))


def test_a_binary_phase_polynomial_is_in_radians(tmp_path):
    lines = ["CURV 0.0", "PARM 0 -1", *numbers("XDAT", [5, 0.5, 3.0, 0.0, 20.0, 5.0, -7.0])]
    system, _ = read(tmp_path, unit="CM", **a_surface("BINARY_1", *lines))
    u, v = U / 0.5, V / 0.5
    phase = -(3.0 * u + 20.0 * u**2 + 5.0 * u * v - 7.0 * v**2)
    torch.testing.assert_close(system.surfaces[0].phase.cycles(X, Y)[0], phase / (2 * math.pi), atol=1e-12, rtol=0)


Z = torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64)
MEDIA = {
    "GRINSUR1": ([1.0, 1.6, -0.4], (1.6 - 0.4 * S) ** 2),
    "GRINSUR2": ([1.0, 2.56, -0.4, 0.3], 2.56 - 0.4 * S + 0.3 * S**2),
    "GRINSUR3": ([1.0, 1.6, -0.4, 0.3, 0.2], (1.6 - 0.4 * S + 0.3 * S**2 + 0.2 * S**3) ** 2),
    "GRINSUR3 along the axis": ([1.0, 1.6, 0, 0, 0, 0.5, -0.1], (1.6 + 0.5 * Z / 10 - 0.1 * (Z / 10) ** 2) ** 2),
}


@pytest.mark.filterwarnings("ignore:.*no ray that arrives:odak.AccuracyWarning")
@pytest.mark.parametrize("name", MEDIA)
def test_graded_media_have_the_index_of_their_definitions(tmp_path, name):
    values, expected = MEDIA[name]
    system, _ = read(tmp_path, unit="CM", **a_surface(name.split()[0], "CURV 0.0", *numbers("PARM", values)))
    item = system.surfaces[0]
    squared = item.gradient.squared(X, Y, Z, item.index)[0]
    torch.testing.assert_close(squared, expected.expand_as(squared), atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (("GRINSUR3", "CURV 0", *numbers("PARM", [1, 1.5, 0.1, 0, 0, 0.1])), "GRINSUR3 both radial and axial"),
        (("GRINSUR1", "CURV 0", "PARM 2 0"), "PARM 2, the index on the axis"),
        (("SZERNSAG", "CURV 0", "PARM 9 1", "XDAT 1 1"), "shifted Zernike terms"),
        (("FZERNSAG", "CURV 0", "XDAT 1 40", "XDAT 2 1"), "at most 37 fringe"),
        (("XPOLYNOM", "CURV 0", "XDAT 1 1e9"), "at most 500 terms"),
        (("USERSURF", "CURV 0"), "TYPE must be one of"),
    ],
)
def test_surfaces_that_cannot_be_read_are_refused(tmp_path, lines, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, **a_surface(*lines))


def unindented(text):
    return "\n".join(line.strip() for line in text.splitlines())


WRITTEN = {
    "without indents": ("utf-8", unindented),
    "with tabs and carriage returns": ("utf-8", lambda text: text.replace("  ", "\t").replace("\n", "\r\n")),
    "UTF-16 without a mark": ("utf-16-le", str),
    "big-endian UTF-16 without a mark": ("utf-16-be", str),
    "decimal commas": ("utf-8", lambda text: text.replace("0.01", "0,01").replace("10.0", "10,0")),
    "Fortran exponents": ("utf-8", lambda text: text.replace("CURV 0.01", "CURV 1.0D-02")),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_ways_of_writing_a_file_make_no_difference(tmp_path, name):
    encoding, change = WRITTEN[name]
    expected, _ = read(tmp_path, distance="300", y="2", fields="1 0")
    found, _ = read(tmp_path, encoding, change, distance="300", y="2", fields="1 0")
    assert found.object_distance == 300.0 and found.fields == ((0.0, 2.0),)
    assert torch.equal(trace_fields(found).y, trace_fields(expected).y)


def test_a_near_object_may_be_seen_under_angles(tmp_path):
    """The chief ray leaves the object under the field angle and meets the centre of the entrance pupil."""
    system, report = read(tmp_path, distance="300", x="3", y="-5")
    rays = trace_fields(system, torch.zeros(1, 2), fields=system.fields)
    slopes = [-value / (300.0 + float(first_order(system).entrance_pupil_distance)) for value in system.fields[0]]
    assert slopes == pytest.approx([math.tan(math.radians(3)), math.tan(math.radians(-5))], rel=1e-12)
    assert bool(rays.arrived.all()) and any("angles from the entrance pupil" in note for note in report.notes)


def test_a_very_far_object_is_at_infinity(tmp_path):
    found, report = read(tmp_path, distance="1.0E+10", y="5")
    expected, _ = read(tmp_path, y="5")
    assert torch.equal(trace_fields(found).y, trace_fields(expected).y)
    assert any("is taken to be at infinity" in note for note in report.notes)
    assert read(tmp_path, distance="1.0E+10", fields="1 0", y="5")[0].object_distance == 1e10


def test_theodolite_angles_are_those_of_azimuth_and_elevation(tmp_path):
    system, _ = read(tmp_path, fields="4 0", x="20", y="30")
    cosines = np.asarray([math.tan(math.radians(angle)) for angle in system.fields[0]] + [1.0])
    cosines /= np.linalg.norm(cosines)
    az, el = math.radians(20), math.radians(30)
    assert cosines == pytest.approx([math.sin(az) * math.cos(el), math.sin(el), math.cos(az) * math.cos(el)])


def test_heights_of_an_infinite_object_must_be_zero(tmp_path):
    assert read(tmp_path, fields="1 0")[0].fields == ((0.0, 0.0),)
    with pytest.raises(ValueError, match=r"1 \(object heights, object near\)"):
        read(tmp_path, fields="1 0", y="2")


def test_apertures_of_near_objects(tmp_path):
    working, _ = read(tmp_path, distance="300", aperture="FNUM 7.0 1")
    assert float(first_order(working).working_f_number) == pytest.approx(7.0, rel=1e-12)
    plain, _ = read(tmp_path, distance="300", aperture="FNUM 7.0 0")
    assert float(first_order(plain).f_number) == pytest.approx(7.0, rel=1e-12)
    cone, report = read(tmp_path, distance="300", aperture="OBNA 2.0 1")
    assert (cone.aperture, cone.aperture_type) == (pytest.approx(math.sin(math.radians(2.0))), "NA")
    assert any("cone of 2 degrees" in note for note in report.notes)
    with pytest.raises(ValueError, match=r"OBNA.*near object"):
        read(tmp_path, aperture="OBNA 0.1 0")


def test_stop_of_unknown_size_is_filled_to_narrowest_surface(tmp_path):
    text = DEFAULTS["surface"].replace("  STOP\n", "") + "\n  DIAM 6.0 1 0 0 1"

    def with_stop(written):
        return written.replace("SURF 2\n", "SURF 2\n  STOP\n")

    system, report = read(tmp_path, change=with_stop, aperture="FLOA", surface=text)
    edge = trace_fields(system, torch.tensor([[0.0, 1.0]]), vignetting=False)
    assert float(first_order(system).entrance_pupil_diameter) == pytest.approx(12.0, rel=1e-12)
    assert bool(edge.arrived.all()) and any("FLOA without a semi-diameter" in note for note in report.notes)
    with pytest.raises(ValueError, match="FLOA takes the aperture from the stop"):
        read(tmp_path, change=with_stop, aperture="FLOA")


@pytest.mark.parametrize(
    ("glass", "makers", "found", "note"),
    [
        ("SK5", "SCHOTT", "N-SK5", "its successor N-SK5"),
        ("BAFN10", "SCHOTT", "N-BAF10", "its successor"),
        ("FD10", "HOYA", "E-FD10", "its successor E-FD10"),
        ("BAF10", "HOYA", "hoya:BAF10", None),
        ("BAF10", "SCHOTT", "N-BAF10", "its successor"),
        ("BAF10", "CORNING", "hoya:BAF10", "of several makers"),
        ("SILICON", "INFRARED", "silicon", None),
        ("517642", "SCHOTT", "model 1.517 64.2", "is a model glass of nd = 1.517, Vd = 64.2"),
    ],
)
def test_glasses_are_found_by_names_in_use(tmp_path, glass, makers, found, note):
    wave = "1.55" if glass == "SILICON" else "0.5875618"
    system, report = read(tmp_path, makers=makers, wave=wave, **a_surface("STANDARD", "CURV 0.01", glass=glass))
    assert system.surfaces[0].material.name == found
    assert any(note in line for line in report.notes) if note else report.notes == ()


def test_glasses_are_used_somewhat_beyond_their_range(tmp_path):
    surface = a_surface("STANDARD", "CURV 0.01", glass="PMMA")
    system, report = read(tmp_path, wave="0.85", **surface)
    assert "surface 1: PMMA is extrapolated to 0.85 … 0.85 µm" in report.notes
    # G. Beadie et al., Appl. Opt. 54, F139 (2015): 1.4850 at 0.85 µm.
    assert float(system.prescription().index[0, 1]) == pytest.approx(1.4850, abs=2e-3)
    with pytest.raises(ValueError, match=r"PMMA must be used from 0\.4861 to 0\.6563 µm"):
        read(tmp_path, wave="10.6", **surface)


# Handbook of Optics, volume II (1995), chapter 33: tables 26 to 34, except where named.
CRYSTALS = {
    "SILICON": (4.0, 3.4257, 2e-3),
    "GERMANIUM": (10.6, 4.003, 4e-3),
    "ZNSE": (10.6, 2.4028, 5e-4),
    "ZNS_BROAD": (10.6, 2.192, 3e-3),
    "SAPPHIRE": (0.5875618, 1.76817, 1e-4),
    "LIF": (0.5893, 1.3921, 5e-4),
    "NACL": (0.5893, 1.5443, 5e-4),
    "KBR": (10.0, 1.5264, 1e-3),
    "MGF2": (0.5893, 1.3777, 5e-4),
    "CALCITE": (0.5893, 1.6584, 5e-4),
    "GAAS": (10.0, 3.27, 1e-2),
    "YAG": (1.064, 1.8153, 1e-3),
    "E48R": (0.5875618, 1.531, 2e-3),
    "OKP4HT": (0.5875618, 1.632, 1e-6),
}


@pytest.mark.parametrize("name", CRYSTALS)
def test_crystals_and_plastics_have_the_published_index(name):
    wavelength, index, tolerance = CRYSTALS[name]
    assert refractive_index(name, wavelength, unit="um") == pytest.approx(index, abs=tolerance)


def test_what_a_file_says_beyond_the_lens_is_named(tmp_path):
    lines = ["CURV 0.01 2 0.0 0 0", "PARM 3 0.5", "UDAP 3 3", "SPID 1 3"]

    def with_configurations(text):
        return text.replace("0 0 1 1 0 0 0", "0 0 1 1 0 0 1") + "MNUM 3 1\n"

    system, report = read(tmp_path, change=with_configurations, **a_surface("DGRATING", *lines))
    for part in ("PARM 3 0.5", "UDAP 3 3", "SPID 1 3"):
        assert any(part in line for line in report.ignored), part
    for part in ("3 configurations", "surfaces 1 are variables or solves"):
        assert any(part in note for note in report.notes), part
    assert system.afocal and system.surfaces[0].apertures == ()


def test_the_curvature_of_a_distant_object_has_no_effect(tmp_path):
    system, report = read(tmp_path, change=lambda text: text.replace("CURV 0.0\n  DISZ INF", "CURV 0.1\n  DISZ INF"))
    assert system.at_infinity and any("surface 0: CURV 0.1" in line for line in report.ignored)


@pytest.mark.parametrize(("name", "expected"), [("NAME", ""), ("NAME Two words", "Two words"), ("", "lens")])
def test_an_empty_name_stays_empty_and_a_missing_one_is_the_files(tmp_path, name, expected):
    path = tmp_path / "lens.zmx"
    write_zmx(load_system("singlet"), path)
    path.write_text(re.sub(r"NAME.*", name, path.read_text(encoding="utf-8")), encoding="utf-8")
    assert read_zmx(path)[0].name == expected
