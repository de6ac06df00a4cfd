"""Sequence files of CODE V: what is read, written and refused; private glasses; decentres and their returns."""

import math

import pytest
import torch

from odak.catalog import material, model_glass
from odak.catalog.materials import tabulated
from odak.learn.raytracing.system import (
    first_order,
    load_system,
    optical_system,
    read_seq,
    sample_systems,
    surface,
    trace,
    trace_fields,
    write_seq,
)
from odak.learn.raytracing.system.surfaces import is_break
from odak.raytracing import Biconic, OddAsphere, PolynomialFreeform, Toroid
from odak.raytracing.apertures import CircularAperture, EllipticAperture, RectangularAperture
from odak.raytracing.interfaces import RadialPhase

HEAD = """RDM;LEN 'VERSION'
TITLE 'A lens; with ! in its name'
EPD 10.0
DIM M
WL 656.3 587.6 &
486.1
REF 2
WTW 1 2 1
"""
FIELDS = "XAN 0 0\nYAN 0 5\nVUY 0 0.3\nVLY 0 0.1\n"
SURFACES = """SO 0 0.1e14
S 50 6 NBK7_SCHOTT; STO; CIR 8
S -50 2 517.642 ! cement
S 0 90; PIM
SI 0 0.25
GO
"""
LENS = HEAD + FIELDS + SURFACES


def read(folder, text):
    path = folder / "lens.seq"
    path.write_text(text)
    return read_seq(path)


def test_a_file_is_read_and_the_rest_reported(tmp_path):
    system, report = read(tmp_path, LENS)
    assert system.name == "A lens; with ! in its name" and (system.aperture, system.aperture_type) == (10.0, "EPD")
    assert system.wavelengths == pytest.approx([656.3e-6, 587.6e-6, 486.1e-6]) and system.reference == 1
    assert system.fields == ((0.0, 0.0), (0.0, 5.0)) and system.wavelength_weights == (1.0, 2.0, 1.0)
    # Rays pass the pupil from −0.9 to 0.7.
    assert system.vignetting_factors[1] == pytest.approx((0.0, -0.1, 0.0, 0.2))
    front, middle, back = system.surfaces
    assert front.material.name == "N-BK7" and front.stop and front.semi_diameter == 8.0
    assert (middle.material.nd, middle.material.vd) == (1.517, 64.2)
    # The thickness of the image surface is a defocus.
    assert float(back.thickness) == 90.25
    assert any("PIM" in line for line in report.ignored)


@pytest.mark.parametrize("name", sorted(set(sample_systems()) - {"camera_lens_f18"}))
def test_round_trips_of_sample_systems_are_exact(tmp_path, name):
    lens = load_system(name)
    try:
        write_seq(lens, tmp_path / "lens.seq")
    except ValueError as error:
        assert "not written" in str(error) or "coefficient of r²" in str(error)
        return
    again, _ = read_seq(tmp_path / "lens.seq")
    with torch.no_grad():
        first, second = (trace_fields(item, "rings", 3) for item in (lens, again))
    assert torch.equal(first.status, second.status)
    assert torch.allclose(first.y, second.y, atol=1e-9, equal_nan=True)


def test_every_form_is_written_and_read(tmp_path):
    rim = [RectangularAperture((1.0, 0.0), False, 9.0, 8.0), CircularAperture((0.0, 0.0), True, 1.0)]
    parts = [
        surface(60.0, conic=-0.7, coefficients=[0.0, 1e-6, -2e-9], thickness=4.0, material="N-SF6", aperture=rim),
        surface(shape=Toroid(0.01, -0.02, -0.5, [0.0, 1e-6]), thickness=3.0, shift=(0.2, -0.1), tilt=(1.0, 2.0, 3.0)),
        surface(
            shape=Biconic(0.01, 0.015, -0.3, 0.4), thickness=2.0, material=model_glass(1.6, 40.5), semi_diameter=7.0
        ),
        surface(shape=PolynomialFreeform(0.004, -0.2, [0.0, 0.01, 0.02, 0.0, -0.03], 8.0), thickness=3.0),
        surface(80.0, thickness=2.0, material=1.7, phase=RadialPhase([-40.0, 3.0], 6.0, 1.0), stop=True),
        surface(thickness=20.0, aperture=EllipticAperture((0.0, 0.5), False, 6.0, 7.0)),
    ]
    image = surface(-100.0, tilt=(3.0, 1.0))
    lens = optical_system(parts, 8.0, fields=[(0, 0), (2.0, 3.0)], wavelengths=[486e-6, 588e-6], image=image)
    write_seq(lens, tmp_path / "lens.seq")
    again, report = read_seq(tmp_path / "lens.seq")
    with torch.no_grad():
        first, second = (trace_fields(item, "grid", 5) for item in (lens, again))
    assert torch.equal(first.status, second.status) and report.ignored == ()
    for one, two in zip(first[:7], second[:7], strict=True):
        assert torch.allclose(one, two, atol=1e-11, equal_nan=True)


def test_decentres_and_their_returns_are_those_of_the_manual(tmp_path):
    """A tilt of ADE = 30 turns the axis upwards: it is left-handed. REV undoes it behind, DAR for its surface alone."""
    body = "SO 0 0.1e14\nS 0 10\nS 0 10; YDE 2; ADE 30\nS 0 5; ADE 30; YDE 2; REV\n"
    body += "S 0 5; ADE 20; DAR\nS 0 5; RET S1\nSI 0 0\n"
    system, _ = read(tmp_path, HEAD + body)
    rotations, origins = system.frames()
    places = [i for i, item in enumerate(system.surfaces) if not is_break(item)]
    up = math.radians(30)
    assert origins[places[1]].tolist() == pytest.approx([0.0, 2.0, 10.0])
    assert rotations[places[1]][:, 2].tolist() == pytest.approx([0.0, math.sin(up), math.cos(up)])
    tilted = [0.0, 2 + 10 * math.sin(up), 10 + 10 * math.cos(up)]
    assert origins[places[2]].tolist() == pytest.approx(tilted)
    # Behind the third surface the axis runs straight again, less the decentre of 2.
    assert origins[places[3]].tolist() == pytest.approx([0.0, tilted[1] - 2, tilted[2] + 5])
    assert rotations[places[3]][1, 2].item() == pytest.approx(math.sin(math.radians(20)))
    assert origins[places[4]].tolist() == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)


def test_a_bend_follows_the_reflected_axis(tmp_path):
    body = "SO 0 0.1e14\nS 0 10\nS 0 -20 REFL; ADE 25; BDE 15; BEN\nS 0 -5; BDE 10; DAR\nSI 0 0\n"
    system, _ = read(tmp_path, HEAD + body)
    ray = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)
    found = trace(system, ray)
    # The ray along the axis stays on it.
    assert float(torch.stack([found.x, found.y, found.u, found.v]).abs().max()) < 1e-12
    assert found.path.flatten().tolist() == pytest.approx([35.0] * found.path.numel())
    write_seq(system, tmp_path / "again.seq")
    again, _ = read_seq(tmp_path / "again.seq")
    assert torch.allclose(again.frames()[1][-1], system.frames()[1][-1], atol=1e-12)


def test_private_glasses_have_their_indices(tmp_path):
    block = "PRV\n PWL 656.3 587.6 486.1\n 'MINE' 1.61 1.615 1.625\nEND\n"
    system, _ = read(tmp_path, LENS.replace("SO 0", block + "SO 0").replace("517.642", "'MINE'"))
    index = system.prescription().index[:, 2]
    assert index.tolist() == pytest.approx([1.61, 1.615, 1.625], rel=1e-14)
    # Between tabulated values: N-BK7 from steps of 20 nm, to 1e-7.
    glass = material("N-BK7")
    places = [0.42 + 0.02 * i for i in range(16)]
    table = tabulated("table", places, [glass.index(w) for w in places], "test")
    points = torch.linspace(0.43, 0.71, 29, dtype=torch.float64)
    assert torch.allclose(table.index(points), glass.index(points), atol=1e-7)
    assert [table.index(float(w)) for w in points] == pytest.approx(table.index(points).tolist(), rel=1e-14)


def test_a_diffractive_surface_has_the_power_of_its_first_term(tmp_path):
    phase = "DIF DOE; HOR 1; HWL 587.6; HCT R; HCO C1 -0.002; HCO C2 1e-6"
    text = HEAD + f"SO 0 0.1e14\nS 0 0; STO; {phase}\nS 0 250\nSI 0 0\n"
    system, _ = read(tmp_path, text)
    # The optical path −r²/(2f).
    assert float(first_order(system).focal_length) == pytest.approx(250.0, rel=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("STO;", "SPS ZRN;", r"surface 1: the form must be one of .*, got SPS ZRN"),
        ("STO;", "DIF HOE;", "DIF must be DOE with HCT R, a radial phase, got HOE"),
        ("STO;", "XYZ 3;", "line 14: .*XYZ is a command that is not understood"),
        ("STO;", "NSS 3;", "NSS is a command that is not understood"),
        ("STO;", "THI;", "line 14: THI must have a number, got none"),
        ("STO;", "GLA;", "line 14: GLA must have a name, got none"),
        ("STO;", "HCO 1;", "HCO is a command that is not understood"),
        ("S 50 6", "S 50 six", "line 14: S must have a number, got 'six'"),
        ("NBK7_SCHOTT", "NOGLASS_SCHOTT", "surface 1: name .*NOGLASS.* or with odak trace --glasses FILE.*read_seq"),
        ("DIM M", "DIM F", "DIM must be one of M, MM"),
        ("SI 0 0.25", "", "a lens must have an object"),
        ("STO;", "RET S7;", "RET must name an earlier surface, got S7"),
    ],
)
def test_what_would_be_wrong_is_refused(tmp_path, old, new, message):
    assert old in LENS
    with pytest.raises(ValueError, match=message):
        read(tmp_path, LENS.replace(old, new))


def test_what_is_not_written_is_refused(tmp_path):
    for item, message in (
        (surface(50.0, coefficients=[1e-3]), "coefficient of r²"),
        (surface(shape=OddAsphere(0.02, 0.0, [0.0, 1e-4])), "is a OddAsphere, which is not written"),
    ):
        lens = optical_system([item, surface(-50.0, thickness=20.0)], 5.0)
        with pytest.raises(ValueError, match=message):
            write_seq(lens, tmp_path / "lens.seq")


def test_zoom_positions_are_read_and_written(tmp_path):
    zoom = "ZOO 3\nZOO THI S2 2 3 4\nZOO THC S2 0 0 0\nZOO EPD 10 9 8\nZOO YAN F2 5 4 3\nZOO CUY S3 0 0.001 0.002\n"
    system, report = read(tmp_path, LENS.replace("GO", zoom + "ZOO VUY F2 0 0 0.1\nGO"))
    settings = {(name, place): values for name, place, values in system.settings}
    assert settings["thickness", 1] == (2.0, 3.0, 4.0) and settings["aperture", None] == (10.0, 9.0, 8.0)
    assert settings["curvature", 2] == (0.0, 0.001, 0.002)
    assert [points[1] for points in settings["fields", None]] == [(0.0, 5.0), (0.0, 4.0), (0.0, 3.0)]
    assert any("not used: VUY F2" in note for note in report.notes)
    write_seq(system, tmp_path / "again.seq")
    again, _ = read_seq(tmp_path / "again.seq")
    assert sorted(again.settings, key=str) == sorted(system.settings, key=str)
    with pytest.raises(ValueError, match="line 19: ZOO THI must have 3 values, got 2"):
        read(tmp_path, LENS.replace("GO", "ZOO 3\nZOO THI S2 2 3\nGO"))


def test_glasses_by_index_and_abbe_number_and_objects_at_inf(tmp_path):
    system, _ = read(tmp_path, LENS.replace("SO 0 0.1e14", "SO 0 inf").replace("517.642", "1.5168:64.17"))
    glass = system.surfaces[1].material
    assert (glass.nd, glass.vd) == (1.5168, 64.17) and math.isinf(system.object_distance)


def test_private_glasses_by_the_formula_of_laurent(tmp_path):
    """BK7 by n² = A₀ + A₁λ² + A₂λ⁻² + …, of Schott's catalogue of 1992: 1.51680 at the d line, 1.52238 at F."""
    terms = "2.2718929 -0.010108077 0.010592509 0.00020816965 -7.6472538e-6 4.9240991e-7"
    block = f"PRV\n PWL 365.0 1014.0\n 'OWN' LAURENT {terms}\nEND\n"
    system, _ = read(tmp_path, LENS.replace("RDM;", block + "RDM;").replace("NBK7_SCHOTT", "OWN"))
    glass = system.surfaces[0].material
    assert (glass.index(0.5875618), glass.index(0.4861327)) == pytest.approx((1.51680, 1.52238), abs=1e-5)
    with pytest.raises(ValueError, match="private glass OWN must have an index"):
        read(tmp_path, LENS.replace("RDM;", block.replace(terms, "-2.0") + "RDM;"))
