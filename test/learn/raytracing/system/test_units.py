"""Lengths of lenses: texts with units, numbers in the unit of the system, and numbers that another unit explains."""

import warnings

import pytest
import torch

from odak import AccuracyWarning, ArgumentWarning
from odak.catalog import OpticalMaterial, internal_transmittance, refractive_index
from odak.learn.raytracing.system import (
    Coating,
    LensRequirements,
    Wavelengths,
    configurations,
    first_order,
    in_environment,
    launch,
    layout_figure,
    load_system,
    optical_system,
    polarized_trace,
    read_seq,
    standard_design,
    surface,
    wavefront,
)


def mirror(wavelengths, unit="mm"):
    return optical_system([surface(-2000, thickness=-1000, material="mirror")], 200, wavelengths=wavelengths, unit=unit)


def spread(system):
    return float(wavefront(system, vignetting=False).path.std(unbiased=False))


@pytest.mark.parametrize(
    ("given", "unit", "meant"),
    [
        ([0.55], "mm", "550nm"),
        ([550], "mm", "550nm"),
        ([550e-9], "mm", "550nm"),
        ([10.6], "mm", "10600nm"),
        ([0.55], "m", "550nm"),
        ([550], "um", "550nm"),
        ([0.55], "nm", "550nm"),
        (torch.tensor([486e-6, 0.55]), "mm", "550nm"),
    ],
)
def test_wavelengths_of_another_unit_are_named(given, unit, meant):
    with pytest.warns(ArgumentWarning, match=f"wavelengths: .* {unit}, the unit of the system; did you mean '{meant}'"):
        mirror(given, unit)


@pytest.mark.parametrize(
    ("given", "unit"),
    [([0.118], "mm"), ([10.6e-3], "mm"), ([13.5e-6], "mm"), ([0.55], "um"), ([550e-9], "m"), (["300um"], "mm")],
)
def test_wavelengths_from_lithography_to_the_far_infrared_pass(given, unit):
    mirror(given, unit)


def test_texts_have_units_of_their_own_at_every_door():
    """The aberration of a sphere in waves is that of the same lens with the wavelength as a number."""
    right = spread(mirror([550e-6]))
    for given in ("550nm", ["550nm"], Wavelengths("0.55um"), ("5.5e-7m",)):
        assert spread(mirror(given)) == pytest.approx(right, rel=1e-9)
    lens = load_system("cooke_triplet")
    zoom = configurations(lens, [("wavelengths", None, ["550nm", ["486nm", "656nm"]])])
    assert zoom.settings[0][2][1] == pytest.approx((486e-6, 656e-6))
    made = LensRequirements("50mm", 4.0, 10.0, ["550nm"], axial_color="100um", unit="m")
    assert (made.focal_length, made.wavelengths[0], made.axial_color) == pytest.approx((0.05, 550e-9, 1e-4))
    assert standard_design(lens, "4cm").solves[0].value == pytest.approx(40.0)
    assert refractive_index("N-BK7", "587.5618nm", "mm") == pytest.approx(1.5168, abs=1e-5)
    number = internal_transmittance("N-BK7", 400e-6, 25.0, "mm")
    assert internal_transmittance("N-BK7", "400nm", "2.5cm", "mm") == pytest.approx(number, rel=1e-12)


def test_films_have_the_thickness_that_their_text_says():
    """A quarter wave of index √1.5 on glass reflects nothing, in whatever unit the system is."""
    index = 1.5**0.5
    thickness = f"{550 / 4 / index}nm"
    for unit, wavelength in (("mm", 550e-6), ("m", 550e-9), ("um", 0.55)):
        for coating in (Coating([index], [thickness]), Coating.quarter_waves([index], "550nm", unit)):
            assert abs(coating.amplitudes(1.0, 1.5, 1.0, 1.0, wavelength, unit).reflected_s) < 1e-12
            assert abs(coating.reversed().amplitudes(1.5, 1.0, 1.0, 1.0, wavelength, unit).reflected_s) < 1e-12


def test_films_of_another_unit_are_named():
    with pytest.warns(ArgumentWarning, match="wavelength: 550 is taken as 550 mm"):
        Coating.quarter_waves([1.38], 550)
    lens = optical_system([surface(50.0, thickness=4.0, material=1.5, coating=Coating([1.38], [100.0])), surface()], 5)
    with pytest.warns(ArgumentWarning, match="thicknesses of a coating: 100 is taken as 100 mm.* did you mean '100nm'"):
        polarized_trace(lens, launch(lens, "y", 3))
    with pytest.warns(ArgumentWarning, match="did you mean '100nm'"):
        Coating([1.38], [100e-9]).amplitudes(1.0, 1.5, 1.0, 1.0, 550e-6)


def test_a_coating_with_a_unit_is_written_and_varied(tmp_path):
    from odak.learn.raytracing.system import save_system

    lens = optical_system(
        [surface(50.0, thickness=4.0, material=1.5, coating=Coating([1.38], ["100nm"])), surface()], 5
    )
    save_system(lens, tmp_path / "lens.json")
    again = load_system(tmp_path / "lens.json").surfaces[0].coating
    assert (again.unit, float(again.thicknesses[0])) == ("mm", pytest.approx(1e-4))
    varied = lens.surfaces[0].vary("thicknesses")
    power = lens.surfaces[0].coating.amplitudes(1.0, 1.5, torch.tensor([1.0]), torch.tensor([1.0]), 0.55, "um")
    abs(power.reflected_s).square().sum().backward()
    assert float(varied.grad.abs().max()) > 0


def test_expansions_in_parts_per_million_are_named():
    lens = load_system("cooke_triplet")
    with pytest.warns(ArgumentWarning, match="mount is an expansion per kelvin: 23.6 .* did you mean 23.6e-6"):
        in_environment(lens, 40.0, mount=23.6)
    with pytest.warns(ArgumentWarning, match="mirror in settings is an expansion per kelvin: 7.1"):
        configurations(lens, [("temperature", None, [20.0, 40.0]), ("mirror", None, [7.1, 7.1])])
    with pytest.warns(ArgumentWarning, match="expansion of own is an expansion per kelvin: 7.1"):
        OpticalMaterial("own", "cauchy", {"A": [1.5]}, (0.4, 0.8), "air", "measured", expansion=7.1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        in_environment(lens, 40.0, mount=23.6e-6)


@pytest.mark.parametrize(("focal_length", "meant"), [(0.05, "50mm"), (50e6, "50mm"), (5e-5, "50mm")])
def test_focal_lengths_of_another_unit_are_named(focal_length, meant):
    with pytest.warns(ArgumentWarning, match=f"focal_length: .* mm, the unit of the system; did you mean '{meant}'"):
        LensRequirements(focal_length, 4.0, 10.0)


def test_focal_lengths_of_telephones_and_telescopes_pass():
    for focal_length in (1.5, 4.55, 131.4e3):
        LensRequirements(focal_length, 4.0, 10.0)
    with pytest.warns(ArgumentWarning, match="focal_length: 0.05 is taken as 0.05 mm"):
        standard_design(load_system("cooke_triplet"), 0.05)


def test_a_curvature_that_is_a_radius_is_named():
    with pytest.warns(ArgumentWarning, match=r"surfaces\[0\] has a curvature of 22 per mm, .* was 22 mm its radius"):
        optical_system([surface(curvature=22.0, thickness=3.0, material=1.5), surface(thickness=40.0)], 10.0)


@pytest.mark.filterwarnings("ignore:surfaces:odak.ArgumentWarning")
def test_a_file_whose_radii_are_read_as_curvatures_says_so(tmp_path):
    text = "LEN NEW\nEPD 10\nWL 587.6\nYAN 0\nSO 0 1e13\nS 22 6 1.5168:64.17\nSTO\nS -40 20\nSI 0 0\nGO\n"
    path = tmp_path / "lens.seq"
    path.write_text(text)
    with pytest.warns(AccuracyWarning, match="no ray that arrives, which cannot be meant: without a command RDM"):
        _, report = read_seq(path)
    assert any("are they radii?" in note for note in report.notes)
    path.write_text("RDM\n" + text)
    system, report = read_seq(path)
    assert 20 < float(first_order(system).focal_length) < 40 and "RDM" not in " ".join(report.notes)


def test_the_unit_is_shown():
    lens = load_system("cooke_triplet")
    assert "lengths in mm" in repr(lens)
    assert "lengths in um" in repr(mirror([0.55], "um"))
    assert any("mm" in text.get_text() for text in layout_figure(lens).axes[0].texts)
