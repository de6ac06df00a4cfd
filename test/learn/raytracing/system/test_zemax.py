"""Zemax text files and JSON: round trips, what is refused, what is reported."""

import json
import math
from dataclasses import replace

import pytest
import torch

from odak.catalog import material, model_glass
from odak.learn.raytracing.system import (
    coordinate_break,
    first_order,
    load_system,
    optical_system,
    read_zmx,
    sample_systems,
    save_system,
    surface,
    system_from_dict,
    system_to_dict,
    trace_fields,
    write_zmx,
)
from odak.raytracing import Biconic, EvenAsphere, OddAsphere, PolynomialFreeform, Toroid, ZernikeFreeform
from odak.raytracing.apertures import CircularAperture, EllipticAperture, RectangularAperture
from odak.raytracing.interfaces import IdealLens, LinearGrating, PolynomialPhase, RadialPhase

FILE = """VERS 140124 258 36214
MODE SEQ
NAME A doublet
UNIT MM X W X CM MR CPMM
ENPD 10.0
ENVD 20 1 0
GCAT SCHOTT
FTYP 0 0 2 3 0 0 0
XFLN 0.0 0.0 0.0
YFLN 0.0 1.5 0.0
WAVM 1 0.4861327 1
WAVM 2 0.5875618 1
WAVM 3 0.6562725 1
WAVM 4 0.55 1
PWAV 2
SURF 0
  TYPE STANDARD
  CURV 0.0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.0163 0 0 0 0 ""
  COAT AR
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
  DISZ 6.0
  DIAM 12.7 1 0 0 1 ""
  CLAP 0 12.0 0
SURF 2
  CURV -0.0224
  GLAS SF5 0 0 1.6727 32.2
  DISZ 2.5
SURF 3
  TYPE EVENASPH
  CURV -0.0078
  CONI -0.5
  PARM 1 0
  PARM 2 1.0e-7
  DISZ 97.2
SURF 4
  TYPE STANDARD
  CURV 0.0
  DISZ 0
"""


def written(folder, text, encoding="utf-8"):
    path = folder / "lens.zmx"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_a_file_is_read_and_the_rest_reported(tmp_path, encoding):
    system, report = read_zmx(written(tmp_path, FILE.replace("A doublet", "Ein Dublett für"), encoding))
    assert system.name == "Ein Dublett für"
    expected = optical_system(
        [
            surface(curvature=0.0163, thickness=6.0, material="N-BK7", semi_diameter=12.0, stop=True),
            surface(curvature=-0.0224, thickness=2.5, material="SF5"),
            surface(curvature=-0.0078, conic=-0.5, coefficients=[0.0, 1e-7], thickness=97.2),
        ],
        aperture=10.0,
        fields=[0.0, 1.5],
        wavelengths=[486.1327e-6, 587.5618e-6, 656.2725e-6],
    )
    torch.testing.assert_close(trace_fields(system).y, trace_fields(expected).y, atol=1e-12, rtol=0)
    assert (system.stop, system.reference, system.surfaces[0].semi_diameter) == (0, 1, 12.0)
    assert report.ignored == (
        "line 6: ENVD 20 1 0",
        "line 24, surface 1: COAT AR",
        'line 27, surface 1: DIAM 12.7 1 0 0 1 ""',
    )


def test_lengths_in_inches_become_millimetres(tmp_path):
    system, _ = read_zmx(written(tmp_path, FILE.replace("UNIT MM", "UNIT IN")))
    assert float(system.surfaces[0].radius) == pytest.approx(25.4 / 0.0163)
    assert float(system.surfaces[2].coefficients[1]) == pytest.approx(1e-7 / 25.4**3)
    assert system.aperture == pytest.approx(254)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "GLAS SF5 0 0 1.6727 32.2",
            "GLAS SF555 0 0 1.5 40 0",
            r"surface 2: name 'SF555'.*nearest.*nd = 1\.5.*LLF1",
        ),
        ("TYPE EVENASPH", "TYPE USERSURF", "surface 3: TYPE must be one of STANDARD, EVENASPH"),
        ("MODE SEQ", "MODE NSC", "MODE must be SEQ"),
        ("FTYP 0", "FTYP 1", "FTYP must be 0"),
        ("UNIT MM", "UNIT FURLONG", "UNIT must be one of"),
        ("CURV -0.0078", "CURV __import__('os')", "line 35: CURV must have a number"),
        ("CURV -0.0078", "CURV nan", "CURV must have a number, got 'nan'"),
        ("SURF 3", "SURF 7", "SURF must count 0, 1, 2"),
        ("PARM 2", "PARM 9", "PARM must be 1 to 8"),
        ("CURV 0.0\n  DISZ INFINITY", "CURV 0.1\n  DISZ 100", "the object must be flat"),
    ],
)
def test_what_would_be_wrong_is_refused(tmp_path, old, new, message):
    assert FILE.count(old) >= 1
    with pytest.raises(ValueError, match=message):
        read_zmx(written(tmp_path, FILE.replace(old, new, 1)))


def test_glasses_of_makers_and_model_glasses(tmp_path):
    text = FILE.replace("GLAS SF5 0 0 1.6727 32.2", "GLAS ___BLANK 1 0 1.6727 32.2 0.001").replace("N-BK7", "S-BSL7")
    system, report = read_zmx(written(tmp_path, text.replace("GCAT SCHOTT", "GCAT OHARA")))
    model = system.surfaces[1].material
    assert model.index(0.5875618) == pytest.approx(1.6727, abs=1e-12)
    assert model.abbe_number() == pytest.approx(32.2, rel=1e-9)
    assert system.surfaces[0].material.source.startswith("OHARA")
    assert "surface 2: ___BLANK is a model glass of nd = 1.6727, Vd = 32.2" in report.notes[0]
    write_zmx(system, tmp_path / "again.zmx")
    again, _ = read_zmx(tmp_path / "again.zmx")
    torch.testing.assert_close(trace_fields(again).y, trace_fields(system).y, atol=1e-9, rtol=0)


@pytest.mark.parametrize(("kind", "real"), [(2, False), (3, True)])
def test_image_heights_become_field_angles(tmp_path, kind, real):
    text = FILE.replace("FTYP 0", f"FTYP {kind}").replace("YFLN 0.0 1.5 0.0", "YFLN 0.0 12.0 0.0")
    system, report = read_zmx(written(tmp_path, text))
    assert any("image heights" in note for note in report.notes)
    chief = trace_fields(system, torch.zeros(1, 2), fields=system.fields).y[system.reference, 1, 0]
    paraxial = float(first_order(system).focal_length) * math.tan(math.radians(system.fields[1][1]))
    assert (float(chief) if real else paraxial) == pytest.approx(12.0, abs=1e-9)


def test_what_is_not_used_is_named(tmp_path):
    text = FILE.replace("FTYP 0 0 2", "FTYP 0 1 2")
    text = text.replace("PWAV 2", "VANN 0 0.2 0\nVDXN 0 0 0\nPWAV 2")
    _, report = read_zmx(written(tmp_path, text))
    assert any("telecentric flag" in note for note in report.notes)
    assert any("VANN 0 0.2 0" in line for line in report.ignored) and not any("VDXN" in i for i in report.ignored)


def test_weights_and_vignetting_factors_are_read(tmp_path):
    text = FILE.replace("WAVM 1 0.4861327 1", "WAVM 1 0.4861327 0.5")
    text = text.replace("PWAV 2", "VCYN 0 0.2 0\nVDYN 0 -0.1 0\nFWGN 1 4 1\nPWAV 2")
    system, report = read_zmx(written(tmp_path, text))
    assert system.wavelength_weights == (0.5, 1.0, 1.0)
    assert not any(key in line for line in report.ignored for key in ("VCYN", "VDYN", "FWGN", "WAVM"))
    assert system.vignetting_factors[1] == (0.0, -0.1, 0.0, 0.2)
    assert system.field_weights == (1.0, 4.0)


def test_model_glasses_keep_every_digit_in_both_files(tmp_path):
    glass = model_glass(1.54451234567, 55.987654321, 0.0123)
    lens = optical_system([surface(50.0, thickness=4.0, material=glass), surface(thickness=90.0)], 10.0)
    save_system(lens, tmp_path / "lens.json")
    write_zmx(lens, tmp_path / "lens.zmx")
    for again in (load_system(tmp_path / "lens.json"), read_zmx(tmp_path / "lens.zmx")[0]):
        assert again.surfaces[0].material.coefficients == glass.coefficients
    text = (tmp_path / "lens.json").read_text()
    for wrong, message in (("model 1.5", "two or three numbers"), ("model a b", "could not convert")):
        (tmp_path / "wrong.json").write_text(text.replace("model 1.54451234567 55.987654321 0.0123", wrong))
        with pytest.raises(ValueError, match=message):
            load_system(tmp_path / "wrong.json")


def test_ranges_that_a_file_extends_are_kept():
    """A file may use a glass beyond its range; the system written as JSON must be traced alike."""
    for glass in (model_glass(1.6, 50.0), material("N-BK7")):
        stretched = replace(glass, range=(0.35, 3.0))
        rows = [surface(50.0, thickness=4.0, material=stretched), surface(thickness=90.0)]
        lens = optical_system(rows, 10.0, wavelengths=2.8e-3)
        entry = json.loads(json.dumps(system_to_dict(lens)))
        assert torch.equal(trace_fields(system_from_dict(entry)).y, trace_fields(lens).y)
        for wrong in ([3.0, 0.35], [1.0], "far"):
            entry["surfaces"][0]["material_range"] = wrong
            with pytest.raises((TypeError, ValueError), match="material_range"):
                system_from_dict(entry)
    assert "material_range" not in system_to_dict(load_system("cooke_triplet"))["surfaces"][0]


FORMS = {
    "odd": surface(shape=OddAsphere(0.01, -0.2, [0.0, 1e-4, 1e-5])),
    "many even": surface(80.0, conic=-0.4, coefficients=[0.0, 1e-5, *[3e-7 * 40.0**-i for i in range(7)], 1e-17]),
    "many odd": surface(shape=OddAsphere(0.01, -0.2, [0.0, 1e-4, *[1e-5 * 9.0**-i for i in range(8)]])),
    "toroid": surface(shape=Toroid(0.01, 0.02, -0.3, [1e-5, 1e-7])),
    "cylinder": surface(shape=Toroid(0.0, 0.02)),
    "biconic": surface(shape=Biconic(0.01, 0.02, 0.1, -0.3)),
    "polynomial": surface(shape=PolynomialFreeform(0.01, 0.1, [0.0, 0.01, 0.02, 0.03, 0.01], 10.0)),
    "Zernike": surface(shape=ZernikeFreeform(0.01, 0.1, [0.0, 0.01, 0.0, 0.02, 0.01], 10.0)),
    "grating": surface(-80.0, phase=LinearGrating(0.0, 50.0, -1.0)),
    "binary": surface(60.0, coefficients=[0.0, 1e-6], phase=RadialPhase([-20.0, 1.0], 10.0)),
    "phase polynomial": surface(60.0, phase=PolynomialPhase([1.0, 0.0, -20.0, 3.0, -18.0], 10.0, -1.0)),
    "ideal": surface(phase=IdealLens(80.0)),
    "rectangle": surface(50.0, aperture=RectangularAperture((0.5, -0.2), half_width=3.0, half_height=4.0)),
    "ring": surface(50.0, aperture=[CircularAperture(radius=6.0, inner=1.5)]),
    "vane": surface(50.0, semi_diameter=6.0, aperture=[EllipticAperture(obscures=True, half_width=1, half_height=3)]),
}


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("unit", ["mm", "um"])
def test_every_form_is_written_to_and_read_from_both_files(tmp_path, name, unit):
    """Written and read again, in another unit too: the same rays."""
    item = system_from_dict(system_to_dict(optical_system([FORMS[name], surface(thickness=30.0)], 12.0))).surfaces[0]
    lens = optical_system(
        [
            item,
            coordinate_break((0.2, 0.1), (5.0, -3.0, 2.0), 20.0),
            coordinate_break(tilt=(1.0, 2.0, 0.0), order="tilt"),
        ],
        aperture=12.0,
        fields=[(0.0, 1.0)],
    )
    write_zmx(lens, tmp_path / "a.zmx")
    again, report = read_zmx(tmp_path / "a.zmx")
    expected = trace_fields(lens, "grid", 9)
    found = trace_fields(again, "grid", 9)
    assert torch.equal(found.status, expected.status) and bool(expected.arrived.any())
    torch.testing.assert_close(found.y, expected.y, atol=1e-10, rtol=0, equal_nan=True)
    assert report.notes == () or "STOP" in report.notes[0]
    save_system(lens, tmp_path / "a.json")
    assert torch.equal(
        trace_fields(load_system(tmp_path / "a.json"), "grid", 9).y.nan_to_num(), expected.y.nan_to_num()
    )
    if unit == "um" and not FORMS[name].apertures:
        text = (tmp_path / "a.zmx").read_text().replace("UNIT MM", "UNIT CM")
        (tmp_path / "b.zmx").write_text(text)
        large, _ = read_zmx(tmp_path / "b.zmx")
        assert float(large.surfaces[1].thickness) == pytest.approx(200.0)


def test_terms_beyond_the_eighth_are_those_of_extended_aspheres(tmp_path):
    """Coefficients of r², r⁴, … and of r, r², … in metres come back in millimetres."""
    given = [0.0, 1e-3, *[1e-4 * 0.5**i for i in range(7)]]
    for kind, step, shape in (("XASPHERE", 2, EvenAsphere), ("XOSPHERE", 1, OddAsphere)):
        metres = [a * 1e3 ** (step * i - 1) for i, a in enumerate(given, start=1)]
        faces = [surface(shape=shape(100.0, -0.2, metres), thickness=0.03)]
        write_zmx(optical_system(faces, 0.012, unit="m", wavelengths=550e-9), tmp_path / "a.zmx")
        assert f"TYPE {kind}" in (tmp_path / "a.zmx").read_text()
        found = read_zmx(tmp_path / "a.zmx")[0].surfaces[0].shape
        assert found.coefficients.tolist() == pytest.approx(given, rel=1e-13)
    with pytest.raises(ValueError, match=r"surfaces\[0\] is a Toroid of 8 coefficients, of which the format has 7"):
        write_zmx(optical_system([surface(shape=Toroid(0.01, 0.02, 0.0, [1e-9] * 8))], 1.0), tmp_path / "b.zmx")


def test_a_stand_in_for_a_glass_is_the_callers_choice(tmp_path):
    path = written(tmp_path, FILE.replace("GLAS SF5", "GLAS NIXON"))
    system, _ = read_zmx(path, glasses={"NIXON": 1.67})
    assert float(system.surfaces[1].index) == 1.67


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(ValueError, match="must be a file"):
        read_zmx(tmp_path / "none.zmx")
    with pytest.raises(ValueError, match="at least one surface"):
        read_zmx(written(tmp_path, "MODE SEQ\nSURF 0\n"))
    path = tmp_path / "large.zmx"
    with path.open("wb") as stream:
        stream.truncate(5 << 20)
    with pytest.raises(ValueError, match="must be of at most"):
        read_zmx(path)
    (tmp_path / "odd.zmx").write_bytes(b"\xff\xfe\x00\xd8\x00")
    with pytest.raises(ValueError, match="utf-16"):
        read_zmx(tmp_path / "odd.zmx")


@pytest.mark.parametrize("name", sample_systems())
def test_round_trips_are_exact(tmp_path, name):
    system = load_system(name)
    write_zmx(system, tmp_path / "a.zmx")
    again, _ = read_zmx(tmp_path / "a.zmx")
    torch.testing.assert_close(trace_fields(again).y, trace_fields(system).y, atol=1e-12, rtol=0, equal_nan=True)
    save_system(system, tmp_path / "a.json")
    copy = load_system(tmp_path / "a.json")
    assert torch.equal(trace_fields(copy).y.nan_to_num(), trace_fields(system).y.nan_to_num())
    assert system_to_dict(copy) == system_to_dict(system)


def test_other_systems_are_written_to_and_read_from_json():
    system = optical_system(
        [
            surface(50.0, conic=-0.3, coefficients=[0.0, 1e-6], material=1.6, thickness=3.0, tilt=(0.1, 0.0)),
            surface(thickness=40.0),
        ],
        aperture=0.1,
        aperture_type="NA",
        object_distance=60.0,
        fields=[(1.0, 2.0)],
    )
    copy = system_from_dict(json.loads(json.dumps(system_to_dict(system))))
    assert torch.equal(trace_fields(copy).y, trace_fields(system).y)
    with pytest.raises(ValueError, match="tilted"):
        write_zmx(system, "/nowhere")


def test_malformed_descriptions_are_refused(tmp_path):
    entry = system_to_dict(load_system("singlet"))
    with pytest.raises(ValueError, match=r"key in surfaces\[0\].*Did you mean 'radius'"):
        system_from_dict({**entry, "surfaces": [{"radus": 3.0}]})
    with pytest.raises(ValueError, match="key in system"):
        system_from_dict({**entry, "apertur": 3.0})
    with pytest.raises(ValueError, match="surfaces must be a list"):
        system_from_dict({"aperture": 3.0})
    with pytest.raises(ValueError, match=r"one of cooke_triplet.*got 'nothing'"):
        load_system("nothing")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(ValueError, match=r"bad\.json"):
        load_system(tmp_path / "bad.json")


def test_messages_name_the_surface_that_they_are_about(tmp_path):
    entry = system_to_dict(load_system("singlet"))
    for key, value, message in (
        ("radius", 0, r"surfaces\[1\]: radius must not be 0"),
        ("tilt", [1.0], r"surfaces\[1\]: tilt must be"),
        (
            "coating",
            {"media": [1.4], "thicknesses": []},
            r"coating of surfaces\[1\]: thicknesses must have one",
        ),
        ("shape", {"kind": "Toroid", "curvature_x": "a", "curvature_y": 1.0}, r"surfaces\[1\]"),
    ):
        surfaces = [dict(item) for item in entry["surfaces"]]
        surfaces[1][key] = value
        with pytest.raises((TypeError, ValueError), match=message):
            system_from_dict(entry | {"surfaces": surfaces})
    lens = load_system("singlet")
    lens.surfaces[1].apertures = (CircularAperture((0.0, 1.0), True, 1.0), CircularAperture((0.0, 2.0), True, 1.0))
    with pytest.raises(ValueError, match=r"surfaces\[1\] has apertures about different centres"):
        write_zmx(lens, tmp_path / "lens.zmx")


def test_surfaces_and_systems_check_their_arguments():
    with pytest.raises(ValueError, match="not a known material; the nearest known are"):
        surface(10.0, material="N-BK77")
    with pytest.raises(ValueError, match="radius must not be 0"):
        surface(0.0)
    with pytest.raises(TypeError, match="material must be a name"):
        surface(10.0, material=None)
    with pytest.raises(ValueError, match="radius of a plane cannot be varied"):
        surface().vary("radius")
    with pytest.raises(ValueError, match="cannot be varied"):
        surface(10.0, material="N-BK7").vary("index")
    with pytest.raises(ValueError, match="only one surface may be the stop"):
        optical_system([surface(stop=True), surface(stop=True)], 1.0)
    with pytest.raises(TypeError, match="surfaces must be a sequence"):
        optical_system([], 1.0)
    with pytest.raises(ValueError, match="object_distance must be positive"):
        optical_system([surface()], 1.0, object_distance=-1.0)
    with pytest.raises(ValueError, match="aperture_type must be one of"):
        optical_system([surface()], 1.0, "EDP")


def test_radii_may_be_parameters():
    item = surface(torch.nn.Parameter(torch.tensor(50.0, dtype=torch.float64)), thickness=3.0, material=1.5)
    system = optical_system([item, surface(thickness=97.0)], 10.0)
    loss = trace_fields(system, "y", 5).y.square().sum()
    (by_radius,) = torch.autograd.grad(loss, item.radius_value)
    curvature = item.vary("curvature")
    (by_curvature,) = torch.autograd.grad(trace_fields(system, "y", 5).y.square().sum(), curvature)
    assert float(by_radius) == pytest.approx(float(-by_curvature / 50**2), rel=1e-12)
    assert [name for name, _ in system.named_parameters()] == ["surfaces.0.curvature_value"]


def test_stop_aperture_is_not_its_limit_names_stay_on_a_line(tmp_path):
    lens = optical_system(
        [surface(50.0, thickness=3.0, material="N-BK7", stop=True, semi_diameter=9.0), surface(-60.0, thickness=50.0)],
        10.0,
        "stop",
        name="first\n  SURF 7",
    )
    write_zmx(lens, tmp_path / "lens.zmx")
    found, _ = read_zmx(tmp_path / "lens.zmx")
    assert (found.aperture, found.aperture_type, found.surfaces[0].semi_diameter) == (10.0, "stop", 9.0)
    assert found.name == "first SURF 7"


@pytest.mark.parametrize("write", [save_system, write_zmx])
def test_what_is_no_path_makes_no_file(tmp_path, monkeypatch, write):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TypeError, match="path must be"):
        write(load_system("cooke_triplet"), 5)
    assert not list(tmp_path.iterdir())


def test_real_image_heights_of_a_wide_lens(tmp_path):
    """A retrofocus lens, whose pupil of wide fields lies far from the paraxial one."""
    text = FILE.replace("FTYP 0 0 2 3", "RAIM 0 2 1 1\nFTYP 3 0 3 3").replace("YFLN 0.0 1.5 0.0", "YFLN 0 6 9.5")
    front = "SURF 1\n  CURV 0.02\n  GLAS N-BK7 0 0\n  DISZ 2\nSURF 2\n  CURV 0.09\n  DISZ 25\n"
    head, rest = text.split("SURF 1\n", 1)
    rest = rest.replace("SURF 4", "SURF 6").replace("SURF 3", "SURF 5").replace("SURF 2", "SURF 4")
    system, report = read_zmx(written(tmp_path, head + front + "SURF 3\n" + rest.replace("DISZ 97.2", "DISZ 200")))
    with torch.no_grad():
        chief = torch.zeros(1, 2, dtype=torch.float64)
        place = trace_fields(system, chief, aim="real", vignetting=False)
    assert torch.allclose(place.y[1, :, 0].abs(), torch.tensor([0.0, 6.0, 9.5]).double(), atol=1e-8)
    assert not any("out of reach" in note for note in report.notes)
    # No chief ray lands a metre from the axis.
    far, report = read_zmx(written(tmp_path, text.replace("YFLN 0 6 9.5", "YFLN 0 6 1000")))
    assert sum("1000 mm, is out of reach" in note for note in report.notes) == 1
    assert 0 < far.fields[1][1] < far.fields[2][1] < 90


def test_model_glasses_without_an_abbe_number(tmp_path):
    text = FILE.replace("GLAS SF5 0 0 1.6727 32.2", "GLAS ___BLANK 1 0 1.6727 ?")
    text = text.replace("GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0", "GLAS ___BLANK 1 0 1.5 0")
    system, report = read_zmx(written(tmp_path, text))
    assert torch.equal(system.prescription().index[:, 1:3], torch.tensor([[1.5, 1.6727]] * 3, dtype=torch.float64))
    assert sum("no dispersion" in note for note in report.notes) == 2
    write_zmx(system, tmp_path / "again.zmx")
    again, _ = read_zmx(tmp_path / "again.zmx")
    assert torch.equal(again.prescription().index, system.prescription().index)
    mirror, report = read_zmx(written(tmp_path, FILE.replace("GLAS SF5 0 0 1.6727 32.2", "GLAS ___BLANK 1 0 -1 0")))
    assert mirror.surfaces[1].reflects and any("is a mirror" in note for note in report.notes)


def test_surfaces_numbered_from_one_without_object_and_image(tmp_path):
    text = "UNIT MM\n" + FILE[FILE.index("SURF 1") : FILE.index("SURF 4")]
    system, report = read_zmx(written(tmp_path, text.replace("DISZ 97.2", "DISZ 0").replace("GLAS SF5", "GLAS N-SF5")))
    assert system.at_infinity and len(system.surfaces) == 3
    assert [item.stop for item in system.surfaces] == [True, False, False]
    found = first_order(system)
    # The last surface has no glass behind it: it is the image.
    assert found.focal_length > 0
    only = text[: text.index("SURF 3")].replace("GLAS SF5 0 0 1.6727 32.2\n", "").replace("DISZ 2.5", "DISZ 0")
    lens, report = read_zmx(written(tmp_path, only))
    found = first_order(lens)
    assert len(lens.surfaces) == 2 and any("paraxial focus" in note for note in report.notes)
    assert float(lens.surfaces[-1].thickness) == pytest.approx(float(found.back_focal_distance), rel=1e-12)


def test_a_file_without_an_aperture_gets_the_stated_default(tmp_path):
    text = FILE.replace("ENPD 10.0\n", "")
    system, report = read_zmx(written(tmp_path, text))
    # The semi-diameter of 12.7 mm of the first surface, at which the axial beam enters.
    assert (system.aperture, system.aperture_type) == (pytest.approx(25.4), "stop")
    assert any("no aperture" in note and "12.7 mm" in note for note in report.notes)
    bare, report = read_zmx(written(tmp_path, text.replace('  DIAM 12.7 1 0 0 1 ""\n', "")))
    assert bare.aperture == pytest.approx(float(first_order(bare).focal_length) / 10)
    assert any("tenth of the focal length" in note for note in report.notes)


def test_adhesives_and_forbes_polynomials_are_read(tmp_path):
    text = FILE.replace("GLAS SF5 0 0 1.6727 32.2\n  DISZ 2.5", "GLAS NOA65 0 0 1.5 40\n  DISZ 0.02")
    system, report = read_zmx(written(tmp_path, text))
    assert system.surfaces[1].material.name == "NOA61" and any("NOA65" in note for note in report.notes)
    for kind, number in (("Qbfs", 0), ("Qcon", 1)):
        terms = f"XDAT 1 {number}\n  XDAT 2 1\n  XDAT 3 10\n  XDAT 4 0.02"
        asphere = FILE.replace("EVENASPH", "QED_TYPE").replace("PARM 1 0\n  PARM 2 1.0e-7", terms)
        read, report = read_zmx(written(tmp_path, asphere))
        r, c, k = 6.0, -0.0078, 0.0 if kind == "Qbfs" else -0.5
        height = c * r * r / (1 + math.sqrt(1 - (1 + k) * c * c * r * r))
        u = r / 10
        # Forbes, Opt. Express 15, 5218 (2007): the first terms are u²(1 − u²)/φ and u⁴.
        height += 0.02 * (u**2 * (1 - u**2) / math.sqrt(1 - c * c * r * r) if kind == "Qbfs" else u**4)
        x = torch.tensor([r], dtype=torch.float64)
        assert float(read.surfaces[2].shape.sag(x, 0 * x).height) == pytest.approx(height, rel=1e-12)
        assert not any("XDAT" in line for line in report.ignored)


@pytest.mark.parametrize(("name", "start"), [("a.zar", b"\xea\x00"), ("b.zmx", b"\xec\x03"), ("c.zbb", b"ab")])
def test_archives_and_black_boxes_are_refused_by_name(tmp_path, name, start):
    (tmp_path / name).write_bytes(start + bytes(64))
    with pytest.raises(ValueError, match=rf"{name} is a Zemax (archive|black box), which is not read"):
        read_zmx(tmp_path / name)
    with pytest.raises(ValueError, match=r"is a Zemax|read_zmx reads"):
        load_system(tmp_path / name)


def test_the_object_may_be_in_a_medium(tmp_path):
    system, _ = read_zmx(written(tmp_path, FILE.replace("SURF 0\n", "SURF 0\n  GLAS WATER 0 0\n")))
    assert system.object_material.name == "water"
    assert system.prescription().index[1, 0].item() == pytest.approx(1.333, abs=1e-3)
    write_zmx(system, tmp_path / "again.zmx")
    for again in (read_zmx(tmp_path / "again.zmx")[0], system_from_dict(system_to_dict(system))):
        assert torch.equal(again.prescription().index, system.prescription().index)


def test_surfaces_and_image_are_written_with_the_diameters_that_rays_need(tmp_path):
    """Those of an ideal image and a plane window are known: f·tan of the field, and the pupil's radius."""
    lens = optical_system(
        [surface(thickness=0.0, stop=True), surface(phase=IdealLens(50.0), thickness=50.0, semi_diameter=9.0)],
        10.0,
        fields=[0.0, 10.0],
    )
    write_zmx(lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text()
    found = [float(line.split()[1]) for line in text.splitlines() if line.startswith("  DIAM")]
    assert found == pytest.approx([5.0, 9.0, 50 * math.tan(math.radians(10.0))], rel=1e-9)
    again, report = read_zmx(tmp_path / "lens.zmx")
    assert [item.semi_diameter for item in again.surfaces] == [None, 9.0] and again.image is None
    assert report.ignored == ("line 34, surface 2: DIAM 9.0 1 0 0 1",)
