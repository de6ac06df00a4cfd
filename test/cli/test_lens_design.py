"""The lenses that `odak design` writes, read from their files and traced by the NumPy core."""

import functools
import json
import math

import numpy as np
import pytest

from odak.catalog import material_names, refractive_index
from odak.cli import lens_design, main
from odak.learn.raytracing.system import (
    automatic,
    first_order,
    in_environment,
    load_system,
    optical_system,
    read_zmx,
    rms_spot,
    save_system,
    surface,
    trace_fields,
)
from odak.raytracing import EvenAsphere, intersect_w_sag, refract


def judged(path, fields=None):
    """Return the focal length, the f-number and the RMS spot of each field of a lens in a file, by other code."""
    lens = json.loads(path.read_text())
    waves = np.array(lens["wavelengths"])
    rows, index = [], [np.ones(len(waves))]
    for item in lens["surfaces"]:
        name = item.get("material", "air")
        index.append(np.ones(len(waves)) if name == "air" else refractive_index(name, waves, lens["unit"], "air"))
        curvature = 1 / item["radius"] if item.get("radius") else 0.0
        shape = EvenAsphere(curvature, item.get("conic", 0.0), item.get("coefficients", [0.0]))
        rows.append((shape, curvature, item["thickness"]))
    n = np.array(index)[:, lens["reference"]]
    y, nu = 1.0, 0.0
    for i, (_, c, t) in enumerate(rows):
        nu -= (n[i + 1] - n[i]) * c * y
        y += t * nu / n[i + 1]
    focal = -1 / nu
    stop = next((i for i, item in enumerate(lens["surfaces"]) if item.get("stop")), 0)
    y, nu = 0.0, 1.0
    for i in range(stop - 1, -1, -1):
        _, c, t = rows[i]
        y -= t * nu / n[i + 1]
        nu += (n[i + 1] - n[i]) * c * y
    assert lens["aperture_type"] == "EPD"
    rings = [(k / lens_design.RINGS, np.arange(6 * k) * math.pi / (3 * k)) for k in range(1, lens_design.RINGS + 1)]
    pupil = [(0.0, 0.0), *((r * math.cos(a), r * math.sin(a)) for r, turn in rings for a in turn)]
    pupil = np.array(pupil) * lens["aperture"] / 2
    spots = []
    for x, angle in lens["fields"] if fields is None else fields:
        assert x == 0
        slope = math.tan(math.radians(angle))
        ends = []
        for w in range(len(waves)):
            start = np.column_stack([pupil[:, 0], pupil[:, 1] + y / nu * slope, np.zeros(len(pupil))])
            direction = np.broadcast_to(np.array([0, slope, 1]) / math.hypot(slope, 1), start.shape)
            rays = np.stack([start, direction], 1)
            for i, (shape, _, t) in enumerate(rows):
                hit = intersect_w_sag(rays, shape, ahead=False)
                rays = refract(rays, np.stack([hit.point, hit.normal], 1), index[i][w], index[i + 1][w])
                rays = rays - np.array([[0, 0, t], [0, 0, 0]])
            ends.append(rays[:, 0, :2] - rays[:, 0, 2:] * rays[:, 1, :2] / rays[:, 1, 2:])
        ends = np.concatenate(ends)
        assert np.isfinite(ends).all()
        spots.append(math.sqrt(((ends - ends.mean(0)) ** 2).sum(1).mean()))
    return focal, focal / lens["aperture"], np.array(spots)


@pytest.mark.parametrize(
    ("name", "asked"),
    [
        ("singlet", {"focal-length": ("60mm", 60.0), "f-number": (8, 8.0), "field": (2, 2.0), "iterations": (2, 2)}),
        pytest.param(
            "cooke_triplet",
            {"focal-length": ("35mm", 35.0), "f-number": (3.5, 3.5), "field": (16, 16.0), "iterations": (8, 8)},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_lens_is_improved_to_what_is_asked(name, asked, tmp_path, capsys):
    start = load_system(name)
    save_system(start, tmp_path / "start.json")
    words = [word for option, (text, _) in asked.items() for word in (f"--{option}", str(text))]
    assert main(["design", name, "--zmx", "--output", str(tmp_path), *words]) == 0
    out = capsys.readouterr()
    report = json.loads((tmp_path / "report.json").read_text())
    assert all((tmp_path / file).stat().st_size for file in report["files"])
    assert "varied" in out.out and "step" in out.err
    assert "field 0°: RMS spot" in out.out and f"-> {1e3 * report['fields'][0]['rms_spot']:.3g} µm" in out.out
    focal, speed, spots = judged(tmp_path / "lens.json")
    assert focal == pytest.approx(asked["focal-length"][1], rel=1e-12)
    assert speed == pytest.approx(asked["f-number"][1], rel=1e-12)
    lens = load_system(tmp_path / "lens.json")
    assert lens.fields[-1] == pytest.approx((0.0, asked["field"][1]))
    np.testing.assert_allclose(spots, [field["rms_spot"] for field in report["fields"]], rtol=1e-7)
    # The start, scaled to the focal length, with the same relative aperture and field.
    lens = json.loads((tmp_path / "start.json").read_text())
    lens["aperture"] *= judged(tmp_path / "start.json")[1] / asked["f-number"][1]
    lens["fields"] = [[x, y * asked["field"][1] / lens["fields"][-1][1]] for x, y in lens["fields"]]
    (tmp_path / "start.json").write_text(json.dumps(lens))
    before, _, worse = judged(tmp_path / "start.json")
    worse *= focal / before
    np.testing.assert_allclose(worse, [field["rms_spot_at_start"] for field in report["fields"]], rtol=1e-7)
    assert (spots**2).sum() < 0.9 * (worse**2).sum()
    assert report["merit"][-1] < report["merit"][0]
    # The sizes of the elements: those of the file, and diameters of a beam whose semi-diameters it holds.
    items = load_system(str(tmp_path / "lens.json")).surfaces
    for element in report["elements"]:
        i = element["surface"]
        assert element["center"] == float(items[i].thickness) and element["material"] in items[i].material.name
        widest = 2 * max(items[k].semi_diameter for k in (i, i + 1))
        assert element["diameter"] == pytest.approx(widest, rel=2e-3) and element["edge"] > 0
    assert f"element of {report['elements'][0]['material']}: diameter" in out.out
    limits = {row["name"]: row for row in report["limits"]}
    assert limits["edge"]["value"] == pytest.approx(min(item["edge"] for item in report["elements"]), rel=0.05)
    for row in limits.values():
        assert f"limit of {row['name']}: {row['kind']}" in out.out
        room = row["value"] - row["limit"] if row["kind"] == "least" else row["limit"] - row["value"]
        assert row["met"] == (room >= -0.01 * row["limit"])
    again, _ = read_zmx(tmp_path / "lens.zmx")
    thicknesses = [float(item.thickness) for item in again.surfaces]
    assert thicknesses == [item["thickness"] for item in json.loads((tmp_path / "lens.json").read_text())["surfaces"]]


@pytest.mark.slow
def test_a_lens_is_designed_over_temperatures(tmp_path, capsys):
    words = ["--temperature", "-20,60", "--mount", "1e-5", "--iterations", "2"]
    assert main(["design", "singlet", "--output", str(tmp_path), *words]) == 0
    out, report = capsys.readouterr().out, json.loads((tmp_path / "report.json").read_text())
    lens = load_system(tmp_path / "lens.json")
    assert [row["temperature"] for row in report["temperatures"]] == [-20.0, 60.0]
    for row in report["temperatures"]:
        warm = in_environment(lens, row["temperature"], mount=1e-5)
        spots = rms_spot(warm, "rings", 8, vignetting=False)
        assert row["rms_spot"] == pytest.approx(float(spots.square().mean().sqrt()), rel=1e-9)
        assert f"{row['temperature']:g} °C: RMS spot" in out
    assert sum(row["rms_spot"] ** 2 for row in report["temperatures"]) < sum(
        row["rms_spot_at_start"] ** 2 for row in report["temperatures"]
    )


@pytest.mark.parametrize("full", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_lens_of_first_order_demands(full, tmp_path, monkeypatch):
    """One run with a stage and no polish, a slow one with all of them."""
    if not full:
        short = functools.partial(lens_design.lenses.automatic_design, stages=1, polish=0)
        monkeypatch.setattr(lens_design.lenses, "automatic_design", short)
        monkeypatch.setattr(automatic, "SCREENINGS", 1)
    asked = ["--elements", "1", "--focal-length", "80mm", "--f-number", "10", "--field", "2", "--seed", "3"]
    files = []
    for name in ("a", "b"):
        out = tmp_path / name
        assert main(["design", *asked, "--starts", "2", "--iterations", "2", "-q", "--output", str(out)]) == 0
        files.append((out / "lens.json").read_text())
        if full:
            break
    assert len(set(files)) == 1, "the same seed gives the same lens"
    focal, speed, spots = judged(tmp_path / "a" / "lens.json")
    assert focal == pytest.approx(80.0, rel=1e-12) and speed == pytest.approx(10.0, rel=1e-12)
    lens = json.loads(files[0])
    assert lens["fields"][-1] == pytest.approx([0, 2]) and lens["surfaces"][1]["material"] == "N-BK7"
    # A single lens of f/10 has axial colour f/V of 1.2 mm: the blur of the outer wavelengths is some 0.06 mm wide.
    assert spots.max() < 0.04
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    np.testing.assert_allclose(spots, [field["rms_spot"] for field in report["fields"]], rtol=1e-7)
    assert report["asked"]["seed"] == 3 and len(report["merit"]) == (7 if full else 1)


@pytest.mark.parametrize(
    ("name", "makers", "iterations"),
    [("singlet", "schott", 2), pytest.param("cooke_triplet", "schott,ohara", 6, marks=pytest.mark.slow)],
)
@pytest.mark.slow
def test_glasses_are_replaced_by_those_of_makers(name, makers, iterations, tmp_path):
    """The lens in the file has glasses of the catalogues, smaller spots, and the focal length that it had."""
    asked = ["--substitute", makers, "--iterations", str(iterations), "-q", "--output", str(tmp_path)]
    assert main(["design", name, *asked]) == 0
    lens = json.loads((tmp_path / "lens.json").read_text())
    own = [item.get("material", "air") for item in lens["surfaces"]]
    listed = {entry.partition(":")[2] or entry for maker in makers.split(",") for entry in material_names(maker)}
    glasses = [entry.partition(":")[2] or entry for entry in own if entry != "air"]
    assert glasses and set(glasses) <= listed
    report = json.loads((tmp_path / "report.json").read_text())
    assert all(entry in " ".join(report["did"]) for entry in glasses)
    focal, _, spots = judged(tmp_path / "lens.json")
    assert focal == pytest.approx(float(first_order(load_system(name)).focal_length), rel=1e-9)
    np.testing.assert_allclose(spots, [field["rms_spot"] for field in report["fields"]], rtol=1e-7)
    before = [field["rms_spot_at_start"] for field in report["fields"]]
    assert (spots**2).sum() < 0.7 * np.square(before).sum()


@pytest.mark.slow
def test_plates_of_glasses_that_vary_become_a_lens_of_real_ones(tmp_path, monkeypatch):
    """A doublet of 100 mm at f/8 whose colours meet within 0.1 mm; two equal glasses leave f/V, 1.6 mm."""
    short = functools.partial(lens_design.lenses.automatic_design, stages=2, polish=0)
    monkeypatch.setattr(lens_design.lenses, "automatic_design", short)
    asked = ["--focal-length", "100mm", "--f-number", "8", "--field", "1", "--elements", "stop,N-BK7,N-BK7"]
    asked += ["--substitute", "schott", "--axial-color", "0.1mm", "--starts", "4", "--iterations", "8"]
    assert main(["design", *asked, "-q", "--output", str(tmp_path)]) == 0
    lens = load_system(tmp_path / "lens.json")
    names = [item.get("material", "air") for item in json.loads((tmp_path / "lens.json").read_text())["surfaces"]]
    names = [name for name in names if name != "air"]
    assert len(set(names)) == 2 and all(name in str(material_names("schott")) for name in names)
    found = []
    for lens.reference in range(3):
        found.append(float(first_order(lens).image_distance))
    assert max(found) - min(found) < 0.1
    assert f"replaced the glasses by {', '.join(names)}" in (tmp_path / "report.json").read_text()


@pytest.mark.slow
def test_real_rays_fill_the_stop_for_all_fields(tmp_path):
    """With --aim real the spots of the report are of rays that pass the stop at the same points for all fields."""
    asked = ["--aim", "real", "--iterations", "3", "-q", "--output", str(tmp_path)]
    assert main(["design", "double_gauss", *asked]) == 0
    report, lens = json.loads((tmp_path / "report.json").read_text()), load_system(tmp_path / "lens.json")
    at_stop = trace_fields(lens, "rings", lens_design.RINGS, aim="real", until=lens.stop, vignetting=False)
    middle = lens.reference
    for name in ("x", "y"):
        reached = getattr(at_stop, name)[middle]
        np.testing.assert_allclose(reached, reached[:1].expand_as(reached), atol=1e-6)
    ends = trace_fields(lens, "rings", lens_design.RINGS, aim="real", vignetting=False)
    spread = sum((value - value.mean((0, 2), keepdim=True)) ** 2 for value in (ends.x, ends.y)).mean((0, 2)).sqrt()
    np.testing.assert_allclose(spread.detach(), [field["rms_spot"] for field in report["fields"]], rtol=1e-9)
    assert report["merit"][-1] < report["merit"][0]


def test_an_unknown_maker_is_named(tmp_path, capsys):
    assert main(["design", "singlet", "--substitute", "acme", "--output", str(tmp_path / "out")]) == 2
    assert "--substitute" in capsys.readouterr().err and not (tmp_path / "out" / "lens.json").exists()


DEMANDS = ["--focal-length", "50mm", "--f-number", "4", "--field", "10"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "missing are --focal-length, --f-number, --field, --elements"),
        (DEMANDS, "missing are --elements"),
        ([*DEMANDS, "--elements", "7"], "--elements must be 1 to 6 or materials, got 7"),
        ([*DEMANDS, "--elements", "stop,N-BK8"], "--elements: "),
        ([*DEMANDS[:4], "--field", "95", "--elements", "1"], "--field must be below 80 degrees, got 95"),
        ([*DEMANDS[:2], "--f-number", "0.2", "--field", "1", "--elements", "1"], "--f-number must be at least 0.5"),
        ([*DEMANDS, "--elements", "N-BK7,SF5"], '"stop"'),
        ([*DEMANDS, "--elements", "stop,N-BK7+SF5", "--vignetting", "1"], "--vignetting must be from 0 to 0.9"),
        (["singlet", "--vignetting", "0.3"], "--vignetting has no effect with a SYSTEM"),
        (["singlet", "--elements", "2"], "--elements has no effect with a SYSTEM"),
        (["singlet", "--focal-length", "-1mm"], "--focal-length"),
        (["singlet", "--f-number", "0"], "--f-number must be positive"),
        (["singlet", "--field", "-3"], "--field must be at least 0"),
        (["singlet", "--iterations", "0"], "--iterations must be at least 1"),
        (["singlet", "--glasses", "none.agf"], "--glasses 'none.agf'"),
        (["nothing"], "SYSTEM must be one of"),
        (["singlet", "--f-number", "0.4", "--iterations", "1"], "rays are lost beyond"),
        (["singlet", "--output", "/proc/none"], "--output cannot be written to"),
        (["singlet", "--temperature", "0,warm"], "--temperature must be degrees separated by commas"),
        (["singlet", "--temperature", "0,-300"], "--temperature"),
        (["singlet", "--temperature", "0,60", "--substitute", "schott"], "--temperature keeps the glasses"),
        ([*DEMANDS, "--elements", "3", "--temperature", "0,60"], "--temperature needs a SYSTEM"),
        (["singlet", "--mount", "1e-5"], "--mount needs --temperature"),
    ],
)
def test_what_will_not_do_is_said_in_line_and_nothing_is_written(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["design", "--quiet", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


@pytest.mark.parametrize(
    ("surfaces", "options", "arguments", "message"),
    [
        ([surface(50.0, thickness=3.0, material=1.5, tilt=(1.0, 0.0)), surface()], {}, [], "surface 0 is not centred"),
        (
            [surface(50.0, thickness=3.0, material=1.5), surface(thickness=150.0)],
            {"object_distance": 300.0},
            ["--focal-length", "40mm"],
            "--focal-length needs an object at infinity",
        ),
        ([surface(thickness=3.0, material=1.5), surface()], {}, [], "is afocal"),
    ],
)
def test_lenses_that_cannot_be_designed(surfaces, options, arguments, message, tmp_path, capsys):
    path = tmp_path / "start.json"
    save_system(optical_system(surfaces, 5.0, **options), path)
    assert main(["design", str(path), "--quiet", "--output", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err and not any((tmp_path / "out").iterdir())


def test_a_mirror_becomes_a_paraboloid(tmp_path):
    mirror = optical_system([surface(-200.0, conic=-0.5, material="mirror", thickness=-99.0)], 20.0)
    save_system(mirror, tmp_path / "mirror.json")
    assert main(["design", str(tmp_path / "mirror.json"), "-q", "--output", str(tmp_path)]) == 0
    found = load_system(tmp_path / "lens.json")
    assert float(found.surfaces[0].conic) == pytest.approx(-1, abs=1e-4)
    assert float(found.surfaces[0].thickness) == pytest.approx(-100, abs=1e-4)


def test_near_objects_keep_their_distance_aspheres_their_terms(tmp_path):
    relay = [surface(60.0, thickness=4.0, material="N-BK7"), surface(-60.0, thickness=118.0)]
    save_system(optical_system(relay, 6.0, object_distance=115.0, fields=[0.0, 1.0]), tmp_path / "relay.json")
    arguments = ["--f-number", "7", "--aspheric-terms", "1", "--field", "2", "--iterations", "3", "-q"]
    assert main(["design", str(tmp_path / "relay.json"), *arguments, "--output", str(tmp_path)]) == 0
    found, report = load_system(tmp_path / "lens.json"), json.loads((tmp_path / "report.json").read_text())
    assert found.object_distance == 115.0 and found.fields[-1] == (0.0, 2.0)
    assert report["first_order"]["f_number"] == pytest.approx(7, rel=1e-12)
    assert bool(found.surfaces[0].coefficients.any())
    assert sum(f["rms_spot"] ** 2 for f in report["fields"]) < sum(
        f["rms_spot_at_start"] ** 2 for f in report["fields"]
    )


def test_lengths_not_reached_and_doubtful_ones_are_warned_of(tmp_path, capsys):
    # A singlet of 100 mm cannot have its image within 1 mm.
    options = ["--iterations", "1", "--quiet", "-o", str(tmp_path)]
    assert main(["design", "singlet", "--track", "1mm", *options]) == 0
    assert "--track was not reached: largest 1 was asked for, the lens has " in capsys.readouterr().err
    assert main(["design", "singlet", "--focal-length", "50", *options]) == 0
    assert "--focal-length 50 is 50 metres; did you mean 50mm?" in capsys.readouterr().err
