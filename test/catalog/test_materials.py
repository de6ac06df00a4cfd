"""Refractive indices against published values and against formulas of other authors."""

import json
import math
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

import odak
from odak import ArgumentWarning, catalog
from odak.catalog import air_index, internal_transmittance, materials, refractive_index
from odak.catalog.materials import LINE_C, LINE_D, LINE_F

# Published n_d and V_d: Schott data sheets; Malitson 1965 and 1963; Dodge 1984; Malitson 1964.
PUBLISHED = {
    "N-BK7": (1.51680, 64.17),
    "N-SF11": (1.78472, 25.68),
    "F2": (1.62004, 36.37),
    "N-F2": (1.62005, 36.43),
    "SF2": (1.64769, 33.85),
    "SF6": (1.80518, 25.43),
    "SF11": (1.78472, 25.76),
    "N-SK2": (1.60738, 56.65),
    "N-SK16": (1.62041, 60.32),
    "N-LAK9": (1.69100, 54.71),
    "N-LASF44": (1.80420, 46.50),
    "N-BAF10": (1.67003, 47.11),
    "fused silica": (1.45846, 67.82),
    "CaF2": (1.43385, 95.00),
    "PMMA": (1.491756, 57.44),
    "polycarbonate": (1.58547, 29.91),
}


@pytest.fixture
def own_catalogue(monkeypatch):
    monkeypatch.setattr(materials, "_found", dict(materials._catalogue()))


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_published_index_and_abbe_number(name):
    nd, vd = PUBLISHED[name]
    assert catalog.refractive_index(name, LINE_D, unit="um") == pytest.approx(nd, abs=1e-5)
    assert catalog.abbe_number(name) == pytest.approx(vd, abs=0.05)


def test_every_material_reproduces_what_its_entry_states():
    stated = [catalog.material(name) for name in catalog.material_names()]
    stated = [found for found in stated if found.nd is not None]
    assert len(stated) > 90
    for found in stated:
        # Water's n_d is published to four decimals.
        tolerance = 5e-5 if found.name == "water" else 1e-5
        assert found.index(LINE_D) == pytest.approx(found.nd, abs=tolerance), found.name
        assert found.abbe_number() == pytest.approx(found.vd, abs=0.05), found.name


def iapws_water(wavelength):
    """A. H. Harvey et al., J. Phys. Chem. Ref. Data 27, 761 (1998), at 20 °C and 998.2 kg/m³."""
    density, heat, x = 0.9982, 293.15 / 273.15, (wavelength / 0.589) ** 2
    terms = (
        0.244257733 + 9.74634476e-3 * density - 3.73234996e-3 * heat + 2.68678472e-4 * x * heat + 1.58920570e-3 / x,
        2.45934259e-3 / (x - 0.2292020**2) + 0.900704920 / (x - 5.432937**2) - 1.66626219e-2 * density**2,
    )
    r = density * sum(terms)
    return np.sqrt((1 + 2 * r) / (1 - r))


def edlen_air(wavelength):
    """B. Edlén, Metrologia 2, 71 (1966): 15 °C, 300 ppm CO2."""
    s = wavelength**-2.0
    return 1 + 1e-8 * (8342.13 + 2406030 / (130 - s) + 15997 / (38.9 - s))


def test_water_and_air_agree_with_other_authors():
    visible = np.linspace(0.4, 0.7, 7)
    np.testing.assert_allclose(catalog.refractive_index("water", visible, "um"), iapws_water(visible), atol=5e-6)
    wide = np.linspace(0.25, 1.6, 9)
    # 150 ppm more CO2 weigh 2e-8.
    np.testing.assert_allclose(catalog.refractive_index("air", wide, "um"), edlen_air(wide), atol=3e-8)


def test_quartz_at_the_sodium_line():
    # Radhakrishnan's values at 18 °C, in the American Institute of Physics Handbook: 1.54425 and 1.55336.
    ordinary, other = (catalog.refractive_index(f"quartz ({k})", 589.3e-9) for k in ("ordinary", "extraordinary"))
    assert ordinary == pytest.approx(1.54425, abs=1e-4) and other == pytest.approx(1.55336, abs=1e-4)
    assert other - ordinary == pytest.approx(0.00911, abs=2e-5)


def test_index_counted_in_air_or_in_vacuum():
    glass, air = (catalog.refractive_index(name, 0.5e-6) for name in ("N-BK7", "air"))
    assert catalog.refractive_index("N-BK7", 0.5e-6, medium="air") == glass
    assert catalog.refractive_index("N-BK7", 0.5e-6, medium="vacuum") == glass * air
    assert catalog.refractive_index("air", 0.5e-6, medium="air") == 1
    assert catalog.refractive_index("vacuum", 0.5e-6) == 1


def test_names_units_and_shapes(as_array):
    assert catalog.refractive_index("nbk7", 532, "nm") == catalog.refractive_index("BK-7", 0.000532, "mm")
    values = np.linspace(0.4e-6, 0.7e-6, 6).reshape(2, 3)
    result = catalog.refractive_index("F2", as_array(values))
    assert tuple(result.shape) == (2, 3) and "float64" in str(result.dtype)
    expected = [[catalog.refractive_index("F2", float(v)) for v in row] for row in values]
    np.testing.assert_allclose(np.asarray(result), expected, atol=1e-15)
    assert "float32" in str(catalog.refractive_index("F2", as_array(values.astype(np.float32))).dtype)
    assert catalog.refractive_index("F2", [0.5e-6, 0.6e-6]).shape == (2,)


@pytest.mark.parametrize("name", ["N-SF11", "PMMA", "air", "water"])
def test_index_is_differentiable_in_wavelength(name):
    wavelength = torch.tensor([0.5, 0.55, 0.62], dtype=torch.float64, requires_grad=True)
    for medium in (None, "air", "vacuum"):
        index = lambda w: catalog.refractive_index(name, w, "um", medium)  # noqa: B023, E731
        assert torch.autograd.gradcheck(index, (wavelength,), fast_mode=True)
    slope = torch.autograd.grad(catalog.refractive_index(name, wavelength, "um").sum(), wavelength)[0]
    assert (slope < 0).all()


def test_wavelength_out_of_range():
    with pytest.raises(ValueError, match=r"within 0.3 … 2.5 µm for N-BK7 .* got 0.2 … 0.5 µm"):
        catalog.refractive_index("N-BK7", np.asarray([0.2, 0.5]), "um")
    assert catalog.refractive_index("N-BK7", 3.0, "um", extrapolate=True) < 1.5
    catalog.refractive_index("N-BK7", np.float32(2.5e-6))
    for wrong in (0.0, np.asarray([0.5e-6, np.nan]), [0.5e-6, -0.5e-6]):
        with pytest.raises(ValueError, match="wavelength must be positive"):
            catalog.refractive_index("N-BK7", wrong, extrapolate=True)
    with pytest.raises(TypeError, match="wavelength must be real"):
        catalog.refractive_index("N-BK7", np.asarray([1j]))
    assert catalog.refractive_index("N-BK7", np.zeros((0, 2))).shape == (0, 2)


def test_unknown_material_names_the_nearest():
    with pytest.raises(ValueError, match="'N-SK166' is not a known material; the nearest known are N-SK16"):
        catalog.refractive_index("N-SK166", 0.5e-6)
    with pytest.raises(ValueError, match=r"'@@@' is not a known material\. Add it"):
        catalog.material("@@@")
    with pytest.raises(TypeError, match="name must be a string"):
        catalog.material(3)
    with pytest.raises(ValueError, match="unit must be one of"):
        catalog.refractive_index("F2", 0.5, "inch")


def test_nearest_materials_by_their_numbers():
    assert catalog.nearest_materials(1.78472, 25.7, 2) == ("N-SF11", "SF11")
    assert catalog.nearest_materials(1.433, 95)[0] == "CaF2"


ENTRY = {"formula": "cauchy", "A": [1.5, 0.004], "range": [0.4, 0.8], "source": "a measurement"}


def write(folder, content):
    path = folder / "own.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def test_own_materials(tmp_path, own_catalogue):
    path = write(tmp_path, {"materials": {"My resin": ENTRY}, "aliases": {"glue": "My resin", "K8": "N-BK7"}})
    assert catalog.load_materials(path) == ("My resin",)
    assert catalog.refractive_index("glue", 0.5, "um") == pytest.approx(1.5 + 0.004 / 0.25)
    assert catalog.refractive_index("k8", 0.5, "um") == catalog.refractive_index("N-BK7", 0.5, "um")
    with pytest.raises(ValueError, match="in the catalogue already"):
        catalog.load_materials(path)
    assert catalog.load_materials(path, replace=True)


def test_a_built_in_name_is_kept_by_default(tmp_path, own_catalogue):
    path = write(tmp_path, {"materials": {"nbk7": ENTRY, "new": ENTRY}})
    with pytest.raises(ValueError, match="'N-BK7' is in the catalogue already"):
        catalog.load_materials(path)
    assert "new" not in catalog.material_names()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"formula": "sellmeyer"}, "Did you mean 'sellmeier'"),
        ({"A": []}, "A must be a list of finite numbers"),
        ({"A": [float("inf")]}, "A must be a list of finite numbers"),
        ({"range": [0.8, 0.4]}, "range must be"),
        ({"source": " "}, 'needs a "source"'),
        ({"relative_to": "oil"}, "relative_to must be one of"),
        ({"nd": 1.6}, "nd is stated as 1.6 but its formula gives 1.51159"),
        ({"vd": "64"}, "vd must be a finite number"),
        ({"colour": "red"}, "unknown keys colour"),
        ({"formula": "gas", "B": [1, 2], "C": [1]}, "must have equal lengths"),
        ({"formula": "sellmeier", "A": 1, "B": [-9.0], "C": [0.01]}, "gives an index of"),
        ({"A": [-1.5]}, "gives an index of -1.5 at 0.4 µm"),
    ],
)
def test_malformed_entries_are_named(change, message, tmp_path, own_catalogue):
    path = write(tmp_path, {"materials": {"resin": {**ENTRY, **change}}})
    with pytest.raises(ValueError, match=message) as caught:
        catalog.load_materials(path)
    assert "own.json" in str(caught.value) and "resin" in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [
        "{",
        "[]",
        {"materials": {}},
        {"materials": {"a": 1}},
        {"materials": {"a": ENTRY}, "aliases": {"b": "c"}},
        {"materials": {"a b": ENTRY, "A-B": ENTRY}},
    ],
)
def test_malformed_files_are_named(content, tmp_path, own_catalogue):
    with pytest.raises(ValueError, match=r"own\.json"):
        catalog.load_materials(write(tmp_path, content))


def test_the_abbe_number_uses_the_lines_of_its_definition():
    index = {line: catalog.refractive_index("N-BK7", line, "um") for line in (LINE_C, LINE_D, LINE_F)}
    # Schott's data sheet: n_C 1.51432, n_F 1.52238.
    assert index[LINE_C] == pytest.approx(1.51432, abs=1e-5) and index[LINE_F] == pytest.approx(1.52238, abs=1e-5)


def test_nothing_has_no_dispersion():
    assert catalog.abbe_number("vacuum") == math.inf


def test_makers_catalogues():
    """Published n_d and ν_d of data sheets; every glass has its source; names that makers share need the maker."""
    published = {
        "ohara:S-BSL7": (1.51633, 64.14),
        "S-TIH53": (1.84666, 23.78),
        "hoya:FCD1": (1.49700, 81.61),
        "J-LAK02": (1.67000, 57.35),
        "K-SFLD6": (1.80518, 25.43),
        "H-K9L": (1.51680, 64.20),
        "schott:N-SF11": (1.78472, 25.68),
    }
    for name, (nd, vd) in published.items():
        found = catalog.material(name)
        assert found.nd == pytest.approx(nd, abs=2e-5) and found.vd == pytest.approx(vd, abs=0.03)
        assert "catalog" in found.source
    names = {maker: catalog.material_names(maker) for maker in catalog.glass_makers()}
    assert sum(map(len, names.values())) >= 1600
    for maker, group in names.items():
        for name in group[::17]:
            found = catalog.material(name)
            assert found.source and found is catalog.material(f"{maker}:{name.rpartition(':')[2]}")
            assert 1 < catalog.refractive_index(found, sum(found.range) / 2, unit="um") < 5
    shared = [key for key in ("F2", "BAF10") if len(materials._makers_of(key.casefold())) > 1]
    twice = next(
        name.rpartition(":")[2]
        for name in names["hoya"]
        if ":" in name and materials._key(name.rpartition(":")[2]) not in materials._catalogue()
    )
    with pytest.raises(ValueError, match=f"several makers; name one of .*{twice}"):
        catalog.material(twice)
    assert shared == [] or catalog.material(shared[0]).name == shared[0]
    with pytest.raises(ValueError, match="maker in"):
        catalog.material("oharra:S-BSL7")
    near = catalog.nearest_materials(1.58913, 61.2, 5, makers=["ohara"])
    assert "L-BAL35" in near


# Schott, data sheet of N-BK7 (2017-01-20): internal transmittance of 10 mm and 25 mm.
TRANSMITTANCE = {
    ("N-BK7", 0.320): (0.770, 0.520),
    ("N-BK7", 0.334): (0.905, 0.780),
    ("N-BK7", 0.365): (0.988, 0.971),
    ("N-BK7", 0.400): (0.997, 0.992),
    ("N-BK7", 2.325): (0.793, 0.560),
}


@pytest.mark.parametrize("name, line", TRANSMITTANCE)
def test_internal_transmittance_of_data_sheets(name, line):
    for thickness, expected in zip((10e-3, 25e-3), TRANSMITTANCE[name, line], strict=True):
        assert catalog.internal_transmittance(name, line * 1e-6, thickness) == pytest.approx(expected, abs=2e-3)


def test_nearly_all_glasses_have_an_absorption():
    """Beer's law between thicknesses, numbers and arrays alike, and the gradient by the wavelength."""
    known = [
        materials.extinction_of(catalog.material(f"{maker}:{name.rpartition(':')[2]}"))
        for maker in catalog.glass_makers()
        for name in catalog.material_names(maker)
    ]
    assert sum(found is not None for found in known) > 1600
    waves = torch.tensor([0.41e-3, 0.7e-3], dtype=torch.float64, requires_grad=True)
    found = catalog.internal_transmittance("N-SF5", waves, 10.0, "mm")
    assert torch.allclose(catalog.internal_transmittance("N-SF5", waves, 30.0, "mm"), found**3)
    one = catalog.internal_transmittance("N-SF5", 0.41e-3, 10.0, "mm")
    assert one == pytest.approx(found[0].item(), abs=1e-14)
    (slope,) = torch.autograd.grad(found.sum(), waves)
    step = 1e-9
    ends = [catalog.internal_transmittance("N-SF5", 0.41e-3 + side * step, 10.0, "mm") for side in (1, -1)]
    assert slope[0].item() == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)
    with pytest.raises(ValueError, match="'water' is a material whose absorption is not known"):
        catalog.internal_transmittance("water", 500e-9, 1.0)


def test_absorption_from_files(tmp_path, own_catalogue):
    """Lines IT of a glass catalogue are transmittances, tables of an entry are κ itself."""
    text = "NM OWNGLASS 2 517642 1.5168 64.17 0 1\n"
    text += "CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.56\n"
    text += "LD 0.3 2.5\nIT 0.4 0.9 10\nIT 0.5 0.99 10\nIT 0.6 0.5 5\n"
    (tmp_path / "own.agf").write_text(text)
    catalog.load_materials(tmp_path / "own.agf")
    for wavelength, thickness, expected in ((0.4e-3, 10.0, 0.9), (0.5e-3, 20.0, 0.99**2), (0.6e-3, 10.0, 0.25)):
        assert catalog.internal_transmittance("OWNGLASS", wavelength, thickness, "mm") == pytest.approx(expected)
    entry = "DATA:\n  - type: formula 2\n    wavelength_range: 0.3 2.5\n    coefficients: 0 1.0 0.01\n"
    entry += "  - type: tabulated k\n    data: |\n        0.4 2E-8\n        0.6 4E-8\nSPECS:\n"
    (tmp_path / "entry.yml").write_text(entry)
    catalog.load_materials(tmp_path / "entry.yml")
    expected = math.exp(-4 * math.pi * 3e-8 * 1.0 / 0.5e-6)
    assert catalog.internal_transmittance("entry", 0.5e-6, 1.0) == pytest.approx(expected, rel=1e-12)


def test_model_glass_keeps_its_statements_near_the_real_one():
    lines = {"g": 0.4358343, "F": 0.4861327, "d": 0.5875618, "C": 0.6562725}
    real = catalog.material("N-BK7")
    partial = {name: real.index(line) for name, line in lines.items()}
    spread = partial["F"] - partial["C"]
    deviation = (partial["g"] - partial["F"]) / spread - (0.6438 - 0.001682 * real.abbe_number())
    model = catalog.model_glass(partial["d"], real.abbe_number(), deviation)
    modelled = {name: model.index(line) for name, line in lines.items()}
    assert modelled["d"] == pytest.approx(partial["d"], abs=1e-13)
    assert modelled["F"] - modelled["C"] == pytest.approx(spread, abs=1e-13)
    assert modelled["g"] - modelled["F"] == pytest.approx(partial["g"] - partial["F"], abs=1e-13)
    for line in (0.45, 0.55, 0.7):
        assert model.index(line) == pytest.approx(real.index(line), abs=2e-4)
    with pytest.raises(ValueError, match="nd must be above 1"):
        catalog.model_glass(0.9, 50)


AGF = """CC a catalogue
NM SCHOTTISH 1 0 1.5168 64.17 0 1 -1
CD 2.271176 -0.009700709 0.0110971 4.622809E-005 1.616105E-005 -8.285043E-007
LD 0.35 2.5
NM SELL 2 0 1.5168 64.17 0 1
CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653
LD 0.3 2.5
NM CONRADY 5 0 1.5064 60 0 1
CD 1.49 0.0085 0.0003
LD 0.4 0.8
NM HANDBOOK 8 0 0 0 0 1
CD 1.2 1.3 0.01 0.01
LD 0.4 2.0
NM STRANGE 3 0 1.5 60 0 1
CD 1.5 0 0 0 0 0
LD 0.4 2.0
"""


def test_glass_catalogues_and_entries_are_read(tmp_path, monkeypatch):
    from odak.catalog import materials

    monkeypatch.setattr(materials, "_found", {})
    path = tmp_path / "mine.agf"
    path.write_text(AGF, encoding="utf-16")
    with pytest.warns(ArgumentWarning, match="skipped STRANGE"):
        names = catalog.load_materials(path)
    assert names == ("SCHOTTISH", "SELL", "CONRADY", "HANDBOOK")
    assert catalog.material("sell").index(0.5875618) == pytest.approx(1.5168, abs=2e-6)
    assert catalog.material("SCHOTTISH").index(0.5875618) == pytest.approx(1.5168, abs=2e-5)
    wave = 0.6
    assert catalog.material("CONRADY").index(wave) == pytest.approx(1.49 + 0.0085 / wave + 0.0003 / wave**3.5)
    handbook = (1.2 + 1.3 * wave**2 / (wave**2 - 0.01) - 0.01 * wave**2) ** 0.5
    assert catalog.material("HANDBOOK").index(wave) == pytest.approx(handbook)
    path.write_text(AGF.replace("1.5168 64.17 0 1\n", "1.6168 64.17 0 1\n"))
    with pytest.raises(ValueError, match=r"SELL states nd = 1.6168 but its formula gives 1.5168"):
        materials.read_agf(path)
    entry = tmp_path / "Malitson.yml"
    entry.write_text(
        "REFERENCES: |\n    I. H. Malitson, J. Opt. Soc. Am. 55, 1205 (1965)\nDATA:\n  - type: formula 1\n"
        "    wavelength_range: 0.21 6.7\n"
        "    coefficients: 0 0.6961663 0.0684043 0.4079426 0.1162414 0.8974794 9.896161\n"
    )
    assert catalog.load_materials(entry) == ("Malitson",)
    assert catalog.material("Malitson").index(0.5875618) == pytest.approx(1.45846, abs=1e-5)
    assert catalog.material("Malitson").relative_to == "vacuum"
    entry.write_text("DATA:\n  - type: tabulated n\n")
    with pytest.raises(ValueError, match="must contain formula 1, 2, 3 or 5"):
        materials.read_entry(entry)


def test_air_is_that_of_ciddors_tables():
    """P. E. Ciddor, Appl. Opt. 35, 1566 (1996), table 1: dry air at 633 nm, 10⁸(n − 1)."""
    for temperature, pressure, value in (
        (20, 80e3, 21458.0),
        (20, 100e3, 26824.4),
        (20, 120e3, 32191.6),
        (10, 100e3, 27774.7),
        (30, 100e3, 25937.2),
    ):
        assert 1e8 * (catalog.air_index(633e-9, temperature, pressure) - 1) == pytest.approx(value, abs=0.06)
    assert catalog.air_index(633e-9, 20.0, 0.0) == 1.0
    # Vapour is lighter than air: one hundredth of a part per million for each percent of humidity at 20 °C.
    dry, moist = (catalog.air_index(633, 20.0, humidity=h, unit="nm") for h in (0.0, 1.0))
    assert 0.8e-6 < dry - moist < 1.0e-6
    wave, warm = (torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (0.55, 20.0))
    assert torch.autograd.gradcheck(
        lambda w, t: 1e4 * (catalog.air_index(w, t, 9e4, 0.5, unit="um") - 1), (wave, warm), fast_mode=True
    )


@pytest.mark.parametrize(
    ("line", "relative", "absolute"),
    [(1.06, (2.4, 2.4, 2.5), (0.3, 1.1, 1.5)), (0.546074, (2.9, 3.0, 3.1), (0.8, 1.6, 2.1))],
)
def test_dn_dt_is_that_of_schotts_data_sheet(line, relative, absolute):
    """N-BK7, Δn/ΔT in 10⁻⁶/K from −40 to −20, 20 to 40 and 60 to 80 °C."""
    for medium, stated in (("air", relative), ("vacuum", absolute)):
        for low, value in zip((-40, 20, 60), stated, strict=True):
            cold, warm = (catalog.refractive_index("N-BK7", line, "um", medium, temperature=t) for t in (low, low + 20))
            assert (warm - cold) / 20e-6 == pytest.approx(value, abs=0.06)


def test_dn_dt_and_expansion_of_glass_catalogues(tmp_path):
    glass = "NM MINE 2 0 1.5168 64.17\nED 7.1 8.3 2.51 -0.0009 0\n"
    glass += "CD 1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653\n"
    glass += "TD 1.86E-6 1.31E-8 -1.37E-11 4.34E-7 6.27E-10 0.17 20\nLD 0.31 2.5\n"
    (tmp_path / "own.agf").write_text("CC own\n" + glass)
    (found,) = materials.read_agf(tmp_path / "own.agf")
    assert (found.expansion, found.measured_at, len(found.thermal)) == (pytest.approx(7.1e-6), 20.0, 6)
    hot = [catalog.refractive_index(name, 0.6, "um", "air", temperature=80.0) for name in (found, "N-BK7")]
    assert hot[0] == hot[1] == catalog.refractive_index(found.at(80.0), 0.6, "um", "air")
    assert hot[0] > catalog.refractive_index(found, 0.6, "um")


@pytest.mark.parametrize("wavelength", [532.0, 0.532])
def test_a_wavelength_in_another_unit_is_named(wavelength):
    with pytest.raises(ValueError, match=f"got {wavelength:g} m: wavelengths are in metres; did you mean 532nm"):
        catalog.refractive_index("N-BK7", wavelength)


@pytest.mark.parametrize(
    ("weather", "warning", "words"),
    [
        ({"temperature": 293.15}, odak.AccuracyWarning, r"degrees Celsius.*kelvin meant \(20 °C\)"),
        ({"temperature": torch.tensor([20.0, 300.0])}, odak.AccuracyWarning, "got 300"),
        ({"temperature": -196.0}, odak.AccuracyWarning, "got -196"),
        ({"pressure": 1013.25}, odak.ArgumentWarning, r"hPa meant \(101325 Pa\)"),
        ({"pressure": 101.325}, odak.ArgumentWarning, r"kPa meant \(101325 Pa\)"),
    ],
)
@pytest.mark.parametrize("ask", [air_index, partial(refractive_index, "N-BK7")])
def test_kelvin_and_hectopascal_are_pointed_out(ask, weather, warning, words):
    with pytest.warns(warning, match=words):
        ask(550e-9, **weather)


def test_percent_of_humidity_and_impossible_weather_are_refused():
    with pytest.raises(ValueError, match="humidity must be between 0 and 1, got 50: percent"):
        air_index(550e-9, humidity=50)
    with pytest.raises(ValueError, match="temperature must be between -273 and 1000, got 15000"):
        air_index(550e-9, 15e3)
    for ask in (air_index, partial(refractive_index, "N-BK7")):
        with pytest.raises(ValueError, match=r"temperature must be between -273 and 1000, got -273\.15"):
            ask(550e-9, temperature=-273.15)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert air_index(550e-9, -40.0, 0.0) == 1
        air_index(550e-9, torch.tensor([-40.0, 100.0]), 80e3, 1.0)


@pytest.mark.parametrize("kind", [list, np.asarray, partial(torch.tensor, dtype=torch.float64)])
def test_several_states_of_the_air_are_each_as_alone(kind):
    """Vacuum among other pressures is vacuum, with humidity too, and lists are what arrays are."""
    for states in ({"pressure": [0.0, 101325.0]}, {"temperature": [10.0, 35.0]}, {"humidity": [0.0, 0.7]}):
        ((name, values),) = states.items()
        found = air_index(633e-9, **{"humidity": 0.5, name: kind(values)})
        alone = [air_index(633e-9, **{"humidity": 0.5, name: value}) for value in values]
        np.testing.assert_allclose(np.asarray(found), alone, rtol=0, atol=1e-15)
    found = refractive_index("N-BK7", 633e-9, temperature=kind([20.0, 40.0]))
    alone = [refractive_index("N-BK7", 633e-9, temperature=value) for value in (20.0, 40.0)]
    np.testing.assert_allclose(np.asarray(found), alone, rtol=0, atol=1e-15)


def test_wavelengths_may_have_units():
    expected = refractive_index("N-BK7", 500e-9)
    assert refractive_index("N-BK7", "500nm") == pytest.approx(expected, rel=1e-15)
    assert refractive_index("N-BK7", "500nm", unit="um") == pytest.approx(expected, rel=1e-15)
    assert refractive_index("N-BK7", ["500nm", "600nm"])[0] == pytest.approx(expected, rel=1e-15)
    assert air_index("633nm") == pytest.approx(air_index(633e-9), rel=1e-15)
    assert internal_transmittance("N-BK7", "400nm", "25mm", unit="mm") == pytest.approx(
        internal_transmittance("N-BK7", 400e-9, 0.025), rel=1e-12
    )


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("glass.agf", "NM X two 0 1.5 60 0\nCD 1 2 3 4 5 6\nLD 0.4 0.7\n"),
        ("glass.agf", "NM X 1e999 0 1.5 60 0\nCD 1 2 3 4 5 6\nLD 0.4 0.7\n"),
        ("entry.yml", "DATA:\n  - type: formula 1\n    wavelength_range: 0.4 x\n    coefficients: 0 1 2\n"),
        ("entry.yml", "DATA:\n  - type: formula 1\n    wavelength_range: 0.4 0.7\n    coefficients: 0 one 2\n"),
    ],
)
def test_errors_in_numbers_of_other_programs_name_the_file(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(ValueError, match=name):
        catalog.load_materials(path)


@pytest.mark.parametrize("name", ["Optorez 1330", "zinc selenide"])
def test_a_temperature_of_what_has_no_known_change_is_told(name):
    wave, own = 10e-6 if name == "zinc selenide" else LINE_D * 1e-6, materials.material(name).measured_at
    with pytest.warns(
        odak.AccuracyWarning, match=f"dn/dT of {name} is not known and counts as 0: .* at 20 °C"
    ) as caught:
        warm = refractive_index(name, wave, temperature=60.0, medium="vacuum")
    assert len(caught) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert refractive_index(name, wave, temperature=own, medium="vacuum") == pytest.approx(warm, rel=1e-12)
        refractive_index(name, wave, pressure=9e4)
        for known in ("N-BK7", "air", "vacuum"):
            refractive_index(known, LINE_D * 1e-6, temperature=60.0)


@pytest.mark.parametrize(
    ("name", "wave", "rate"),
    [
        ("germanium", 10e-6, 427e-6),
        ("silicon", 8e-6, 186e-6),
        ("gallium arsenide", 10e-6, 203e-6),
        ("PMMA", 589.3e-9, -10e-5),
        ("polycarbonate", 589.3e-9, -12e-5),
        ("OKP4HT", 589.3e-9, -11e-5),
    ],
)
def test_the_change_of_crystals_and_plastics_with_temperature_is_that_which_was_measured(name, wave, rate):
    """Hilton's prisms at another wavelength than that of the data, within 3 %; refractometer readings of plastics."""
    warm, cold = (refractive_index(name, wave, medium="vacuum", temperature=t) for t in (60.0, 20.0))
    assert (warm - cold) / 40 == pytest.approx(rate, rel=0.03)
    # The same material used in a lens, and with a range of its own, keeps its data; one of the user has none.
    assert materials.thermal_of(materials.material(name).at(60.0))[1] > 0
    own = replace(materials.material(name), source="measured")
    assert materials.thermal_of(own)[:2] == (None, None)


def lithium_niobate(w, t):
    """Extraordinary index of G. J. Edwards and M. Lawrence, Opt. Quantum Electron. 16, 373 (1984)."""
    f = (t - 24.5) * (t + 570.5)
    pole = 0.2109 - 4.9143e-8 * f
    return (4.582 + (0.09921 + 5.2716e-8 * f) / (w * w - pole**2) + 2.2971e-7 * f - 0.02194 * w * w) ** 0.5


@pytest.mark.parametrize(
    ("name", "waves", "rate"),
    [
        # K. Kato and E. Takaoka, Appl. Opt. 41, 5040 (2002); N. Umemura and others, ASSL 1999, PD15.
        ("KTP (z)", (0.5, 1.0, 1.5), lambda w: 1e-5 * (0.9221 / w**3 - 2.922 / w**2 + 3.6677 / w - 0.1897)),
        ("CLBO (ordinary)", (0.3, 0.6, 1.2), lambda w: 1e-6 * (-12.48 - 0.328 / w)),
        (
            "lithium niobate (extraordinary)",
            (0.6, 1.0, 1.5),
            lambda w: (lithium_niobate(w, 34.5) - lithium_niobate(w, 14.5)) / 20,
        ),
        # Data sheet of Dow's CVD zinc sulfide; Schott's flyer of IRG 22; L. W. Tilton and J. K. Taylor, J. Res. Nat.
        # Bur. Stand. 20, 419 (1938), of water of 20 and 25 degrees.
        ("zinc sulfide", (1.15, 3.39, 10.6), lambda w: {1.15: 46e-6, 3.39: 43e-6, 10.6: 41e-6}[w]),
        ("schott:IRG22", (10.6,), lambda w: 67e-6),
        ("water", (0.5893,), lambda w: (1.33250 - 1.33299) / 5),
    ],
)
def test_constants_of_dn_dt_reproduce_published_formulas(name, waves, rate):
    for wave in waves:
        first = materials.material(name).measured_at if name != "water" else 20.0
        low, high = (
            refractive_index(name, wave, "um", medium="vacuum", temperature=first + change) for change in (0.0, 1.0)
        )
        # The index of water is measured relative to air: its change differs by that of air, 1.3e-6 per kelvin.
        assert high - low == pytest.approx(rate(wave), abs=4e-6 if name == "water" else 1e-6), wave


def test_sixty_materials_that_no_glass_maker_sells_change_with_temperature_by_their_sources():
    held = materials._stored("thermal")
    sources = {name: entry[3] for part in ("constant", "formula") for name, entry in held[part].items()}
    names = [*sources, "IRG22", "IRG24", "IRG26", "IRG27"]
    assert len(names) == len(set(names)) >= 60
    for name in names:
        found = materials.material(name)
        constants, expansion, _ = materials.thermal_of(found)
        assert constants is not None and all(map(math.isfinite, constants)), name
        assert expansion is None or 0 < expansion < 1e-4, name
        wave = min(max(found.range[0], 0.6), found.range[1])
        # Less than a thousandth per kelvin, as of all transparent matter, and of the source that is stated.
        low, high = (refractive_index(name, wave, "um", medium="vacuum", temperature=t) for t in (20.0, 21.0))
        assert 0 < abs(high - low) < 1e-3, name
    assert all(len(text) > 10 for text in sources.values())


@pytest.mark.parametrize("name", ["ZnGeP2 (ordinary)", "KDP (ordinary)", "N-BK7", "silicon"])
def test_the_pressure_that_is_usual_changes_no_index(name):
    """The temperature stays that of the published index, which is not 20 °C for all."""
    middle = sum(catalog.material(name).range) / 2
    usual = catalog.refractive_index(name, middle, "um", pressure=101325.0)
    assert usual == pytest.approx(catalog.refractive_index(name, middle, "um"), abs=1e-12)


def test_weather_of_another_shape_than_wavelengths_is_named():
    with pytest.raises(ValueError, match=r"wavelength \[2\], temperature \[3\]"):
        catalog.refractive_index("N-BK7", np.array([0.5, 0.6]), "um", temperature=np.array([10.0, 20.0, 30.0]))
