"""Public Zemax files beside the project: all are read, and agree with a second opinion on them."""

import json
from pathlib import Path

import pytest
import torch

from odak.learn.raytracing.system import configurations, first_order, read_seq, read_zmx, rms_spot

FOLDER = Path(__file__).resolve().parents[5] / "shared" / "lenses"
EXPECTED = json.loads((FOLDER / "expected.json").read_text()) if (FOLDER / "expected.json").is_file() else {}
# Files in inches are read as millimetres, and a glass that only its index and Abbe number describe differs at 1.55 µm.
SCALES = {"circular_aperture_example_with_aperture.zmx": 25.4}
TOLERANCES = {"354710-C-Zemax(ZMX).zmx": 5e-3}
pytestmark = pytest.mark.skipif(not EXPECTED, reason="no folder of public lenses beside the project")


@pytest.mark.parametrize("name", sorted(EXPECTED) or ["none"])
def test_a_public_file_is_read(name):
    system, report = read_zmx(FOLDER / name)
    assert len(system.surfaces) >= 1 and system.wavelengths
    assert all(isinstance(text, str) and text for text in report.ignored)
    with torch.no_grad():
        assert bool(torch.isfinite(first_order(system).focal_length)) or "mirror" in name or "grating" in name


FOCAL = {name: entry["efl"] for name, entry in EXPECTED.items() if entry.get("efl")}


@pytest.mark.parametrize("name", sorted(FOCAL) or ["none"])
def test_its_focal_length_is_that_of_the_second_opinion(name):
    system, _ = read_zmx(FOLDER / name)
    primary = EXPECTED[name]["primary_um"] / 1000
    with torch.no_grad():
        found = float(first_order(system, wavelength=primary).focal_length)
        sizes = rms_spot(system, "rings", 6)
    expected = abs(FOCAL[name]) * SCALES.get(name, 1.0)
    assert abs(found) == pytest.approx(expected, rel=TOLERANCES.get(name, 1e-3))
    assert sizes.shape == (len(system.fields),)


KINDS = FOLDER / "zemax_kinds"
# Focal lengths and f-numbers that the names of the files, or their patents' normalised prescriptions, state.
STATED = {
    "abbe0__Konica_Minolta_AF_Reflex_500mm_F8": (500, 0.02),
    "abbe0__Nikon_AI_Reflex-Nikkor_1000mm_f11": (1000, 0.02),
    "field90__Canon_EF15mm_f2.8_Fisheye": (15, 0.04),
    "field90__Nikon_AF_Fisheye-Nikkor_10.5mm_f2.8G_ED": (10.5, 0.04),
    "noa__Edmund_33-918": (100, 1e-3),
    "object-glass__Bertele_USP1699682": (100, 1e-3),
    "object-glass__Erfle_USP1478704": (100, 1e-3),
    "other__Sony_DT_16-50mm_F2.8_SSM": (16, 0.04),
    "other__Ricoh_smc_Pentax-FA_28-70mm_F4_AL": (28, 0.04),
    "real-height__Canon_EF28-200mm_f3.5-5.6_USM": (28, 0.04),
    "real-height__Sigma_8-16mm_F4.5-5.6_DC_HSM": (8, 0.04),
    "real-height__Zeiss_Touit_2.8_50M": (50, 0.04),
}
# Their reference heights take seconds to find.
LONG = {"real-height__Sigma_8-16mm_F4.5-5.6_DC_HSM", "real-height__Zeiss_Touit_2.8_50M"}


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in LONG else ()) for n in sorted(STATED)])
def test_a_file_of_each_kind_has_the_focal_length_of_its_name(name):
    if not KINDS.is_dir():
        pytest.skip("no folder of public lenses beside the project")
    system, _ = read_zmx(KINDS / f"{name}.zmx")
    focal, share = STATED[name]
    with torch.no_grad():
        assert float(first_order(system).focal_length) == pytest.approx(focal, rel=share)


# Focal lengths as ray-optics 0.9.8 finds them, in millimetres, of lenses without a glass that no catalogue holds.
CODEV = {
    "CODV_32327": 100.03081274,
    "CODV_65564": 1.49886291,
    "folded_lenses": 2564.335254,
    "lens_reflection_test": 3231.190071,
    "paraboloid": 100.0,
    "paraboloid_f8": 200.0,
    "questar35": 50.5 * 25.4,
    "schmidt_sph": 99.99969577,
}


@pytest.mark.parametrize("name", sorted(CODEV))
def test_a_public_codev_file_has_its_focal_length(name):
    if not (FOLDER / "codev").is_dir():
        pytest.skip("no folder of public lenses beside the project")
    system, _ = read_seq(FOLDER / "codev" / f"{name}.seq")
    with torch.no_grad():
        assert abs(float(first_order(system).focal_length)) == pytest.approx(CODEV[name], rel=1e-8)


# Focal lengths and f-numbers of the first and the last zoom position, as the names of the files state them.
ZOOMS = {
    "configurations__Canon_FD20-35mm_f3.5L_Aspherical": (20, 35, 3.5, 3.5),
    "real-height__Canon_EF28-200mm_f3.5-5.6_USM": (28, 200, 3.5, 5.6),
}


@pytest.mark.parametrize("name", sorted(ZOOMS))
def test_zoom_positions_of_a_public_file_are_those_of_its_name(name):
    if not KINDS.is_dir():
        pytest.skip("no folder of public lenses beside the project")
    system, _ = read_zmx(KINDS / f"{name}.zmx")
    zoom = configurations(system)
    with torch.no_grad():
        found = first_order(system, prescription=zoom.prescription())
        # Without the fields of the image heights, whose search takes seconds.
        bare = configurations(system, [entry for entry in system.settings if entry[0] != "real_image_heights"])
        last = [float(first_order(bare.view(i)).working_f_number) for i in (0, -1)]
    assert found.focal_length[[0, -1]].tolist() == pytest.approx(ZOOMS[name][:2], rel=0.05)
    assert last == pytest.approx(ZOOMS[name][2:], rel=0.05)
    # The image stays in its plane, paraxially, in every position.
    gap = found.image_distance - zoom.prescription().thickness[:, -1]
    assert float(gap.abs().max()) < 0.03
