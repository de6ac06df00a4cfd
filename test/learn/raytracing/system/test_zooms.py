"""Configurations: zoom positions against closed forms, gradients, files, and designs over all of them."""

import math
import runpy
from pathlib import Path

import pytest
import torch

from odak.learn.raytracing.system import (
    Operand,
    Solve,
    Variable,
    configurations,
    first_order,
    load_system,
    optical_system,
    read_zmx,
    rms_spot,
    surface,
    system_from_dict,
    system_to_dict,
    trace_fields,
    write_zmx,
    zoom_design,
)
from odak.learn.raytracing.system.system_files import fields_of_image_heights
from odak.raytracing.interfaces import IdealLens

FOCAL, GAPS = (60.0, -40.0), (30.0, 38.0, 45.0)


def two_lenses(**options):
    front = surface(phase=IdealLens(FOCAL[0]), thickness=GAPS[0])
    back = surface(phase=IdealLens(FOCAL[1]), thickness=100.0)
    return optical_system([front, back], 10.0, fields=[0.0, 2.0], **options)


def images():
    """Return focal lengths of the pair and distances of the image behind it, by Gauss's formulas."""
    f1, f2 = FOCAL
    whole = [f1 * f2 / (f1 + f2 - d) for d in GAPS]
    return whole, [f * (f1 - d) / f1 for f, d in zip(whole, GAPS, strict=True)]


def test_zoom_positions_are_those_of_two_ideal_lenses():
    whole, behind = images()
    zoom = configurations(two_lenses(), [("thickness", 0, GAPS), ("thickness", 1, behind)])
    found = first_order(zoom.system, prescription=zoom.prescription())
    assert found.focal_length.tolist() == pytest.approx(whole, rel=1e-12)
    # One trace of all positions: each field lands at f·tan of its angle.
    with torch.no_grad():
        place = trace_fields(zoom.system, "rings", 2, prescription=zoom.prescription(), vignetting=False)
        sizes = zoom.each(rms_spot)
    assert place.y.shape == (3, 1, 2, 19)
    expected = torch.tensor(whole)[:, None].double() * math.tan(math.radians(2.0))
    assert torch.allclose(place.y[:, 0, 1], expected.expand(3, 19), rtol=1e-6)
    assert sizes.shape == (3, 2) and float(sizes.max()) < 1e-5


def test_gradients_of_all_positions_at_once():
    _, behind = images()
    zoom = configurations(two_lenses(), [("thickness", 0, GAPS), ("thickness", 1, behind)])
    gaps = zoom.vary("thickness", 0)
    found = first_order(zoom.system, prescription=zoom.prescription()).focal_length
    found.sum().backward()
    f1, f2 = FOCAL
    assert gaps.grad.tolist() == pytest.approx([f1 * f2 / (f1 + f2 - d) ** 2 for d in GAPS], rel=1e-10)
    # A number of the system is shared: its gradient is the sum of those of its configurations.
    lens = load_system("cooke_triplet")
    focus = configurations(lens, [("thickness", -1, [42.0, 42.3])])
    bend = lens.vary(curvature=[0])[0]
    focus.each(rms_spot).sum().backward()
    parts = []
    for i in range(2):
        alone = bend.grad.clone()
        bend.grad = None
        rms_spot(focus.view(i)).sum().backward()
        parts.append(bend.grad.clone())
        bend.grad = alone
    assert torch.allclose(bend.grad, sum(parts), rtol=1e-12)


def test_a_zoom_is_adjusted_by_its_gradients():
    """Newton's method on the gaps of three positions at once: focal lengths of 80, 110 and 140 mm."""
    zoom = configurations(two_lenses(), [("thickness", 0, [40.0, 38.0, 36.0])])
    gaps, wanted = zoom.vary("thickness", 0), torch.tensor([80.0, 110.0, 140.0], dtype=torch.float64)
    for _ in range(8):
        # The power is linear in the gap.
        miss = 1 / first_order(zoom.system, prescription=zoom.prescription()).focal_length - 1 / wanted
        (slope,) = torch.autograd.grad(miss.sum(), gaps)
        with torch.no_grad():
            gaps -= miss / slope
    f1, f2 = FOCAL
    assert gaps.tolist() == pytest.approx([f1 + f2 - f1 * f2 / f for f in wanted.tolist()], abs=1e-9)
    assert zoom.settings == (("thickness", 0, tuple(gaps.tolist())),)


def test_focus_positions_differ_in_object_fields_and_glasses():
    lens = load_system("singlet")
    settings = [
        ("object_distance", None, [math.inf, 300.0]),
        ("fields", None, [[0.0, 3.0], [0.0, -15.0]]),
        ("aperture", None, [10.0, 5.0]),
        ("material", 0, ["N-BK7", "N-SF6"]),
    ]
    views = [configurations(lens, settings).view(i) for i in range(2)]
    assert [view.at_infinity for view in views] == [True, False]
    assert views[1].fields == ((0.0, 0.0), (0.0, -15.0)) and views[1].aperture == 5.0
    apart = load_system("singlet")
    apart.surfaces[0].material = views[1].surfaces[0].material
    assert float(first_order(views[1]).focal_length) == float(first_order(apart).focal_length)
    assert lens.at_infinity and lens.surfaces[0].material is not views[1].surfaces[0].material


def test_configurations_travel_in_files(tmp_path):
    whole, behind = images()
    settings = [("thickness", 0, GAPS), ("thickness", 1, behind), ("aperture", None, [10.0, 9.0, 8.0])]
    lens = two_lenses(settings=[*settings, ("fields", None, [[0.0, 2.0], [0.0, 1.5], [0.0, 1.0]])])
    assert system_from_dict(system_to_dict(lens)).settings == lens.settings
    write_zmx(lens, tmp_path / "zoom.zmx")
    again, report = read_zmx(tmp_path / "zoom.zmx")
    assert sorted(again.settings, key=str) == sorted(lens.settings, key=str) and report.ignored == ()
    found = configurations(again).each(first_order)
    assert found.focal_length.tolist() == pytest.approx(whole, rel=1e-12)
    # Fields by image height are found for each position.
    text = (tmp_path / "zoom.zmx").read_text().replace("FTYP 0", "FTYP 3").replace("YFIE 2", "MOFF 2")
    (tmp_path / "zoom.zmx").write_text(text.replace("SURF 0", "PRAM 1 1 2.0 0\nSURF 0"))
    heights, report = read_zmx(tmp_path / "zoom.zmx")
    assert any("PRAM" in note for note in report.notes)
    zoom = configurations(heights)
    for i, f in enumerate(whole):
        assert zoom.view(i).fields[1][1] == pytest.approx(math.degrees(math.atan(2.0 / f)), rel=1e-6)
    write_zmx(heights, tmp_path / "heights.zmx")
    assert configurations(read_zmx(tmp_path / "heights.zmx")[0]).view(2).fields == zoom.view(2).fields


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ([], "at least one entry"),
        ([("thickness", 0, [1.0, 2.0]), ("conic", 0, [1.0])], "one value for each configuration"),
        ([("thickness", 7, [1.0])], "place in settings"),
        ([("length", 0, [1.0])], "name in settings"),
        ([("aperture", 0, [1.0])], "place in settings must be None"),
        ([("index", 0, [-1.0])], "index in settings"),
    ],
)
def test_settings_that_are_none_are_refused(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        configurations(two_lenses(), settings)


def two_singlets():
    """Two lenses of glass with three distances between them, and fields that become smaller."""
    rows = [(60.0, 4.0, "N-BK7"), (-90.0, 30.0, "air"), (-40.0, 2.0, "N-SF5"), (200.0, 60.0, "air")]
    lens = optical_system([surface(r, thickness=t, material=m) for r, t, m in rows], 6.0, fields=[0.0, 2.0])
    return configurations(lens, [("thickness", 1, GAPS), ("fields", None, [[0.0, 3.0], [0.0, 2.0], [0.0, 1.0]])])


def test_a_zoom_design_finds_the_positions_of_two_ideal_lenses():
    """Distances for three focal lengths, by Gauss's formulas."""
    whole, behind = images()
    zoom = configurations(two_lenses(), [("thickness", 0, [30.5, 37.5, 45.5]), ("thickness", 1, [90.0, 50.0, 30.0])])
    wanted = [Operand("focal_length", target=whole), "spot"]
    result = zoom_design(zoom, wanted, [Variable("thickness", 0)], solves=[Solve("marginal_height", 1)]).optimise()
    assert result.values.tolist() == pytest.approx(GAPS, rel=1e-7)
    found = [list(values) for _, _, values in zoom.settings]
    assert found[0] == pytest.approx(GAPS, rel=1e-7) and found[1] == pytest.approx(behind, rel=1e-7)


def test_a_merit_of_all_configurations_is_the_sum_of_theirs():
    """Shared curvatures are one variable, distances three; the Jacobian is that of central differences."""
    zoom = two_singlets()
    operands = ["spot", Operand("focal_length", target=[70.0, 80.0, 90.0], weight=0.1)]
    design = zoom_design(zoom, operands, [Variable("curvature", [0, 2]), Variable("thickness", 1)], count=2)
    assert design.values.tolist() == pytest.approx([1 / 60, -1 / 40, *GAPS], rel=1e-12)
    value, jacobian = design.linearised(design.values)
    own = 0.0
    for i, target in enumerate((70.0, 80.0, 90.0)):
        with torch.no_grad():
            view = zoom.view(i)
            spots = rms_spot(view, "rings", 2, vignetting=False).square().sum()
            own += float(spots + 0.01 * (first_order(view).focal_length - target) ** 2)
    assert float(value.square().sum()) == pytest.approx(own, rel=1e-10)
    for j, size in enumerate((1e-6, 1e-6, 1e-3, 1e-3, 1e-3)):
        step = torch.zeros_like(design.values)
        step[j] = size
        slope = (design.residuals(design.values + step) - design.residuals(design.values - step)) / (2 * size)
        torch.testing.assert_close(slope, jacobian[:, j], rtol=1e-5, atol=1e-6 * float(jacobian[:, j].abs().amax()))
    several = design.prescription(design.values.expand(2, -1))
    assert several.thickness.shape == (2, 3, 4) and several.thickness[0, :, 1].tolist() == list(GAPS)
    design.optimise(2)
    shared = float(zoom.system.surfaces[0].curvature)
    assert float(design.values[0]) == pytest.approx(shared, rel=1e-14) and shared != pytest.approx(1 / 60, rel=1e-3)
    assert all(float(zoom.view(i).surfaces[0].curvature) == shared for i in range(3))


def test_real_glasses_of_a_zoom_are_the_same_in_all_positions():
    zoom = two_singlets()
    variables = [Variable("curvature", range(4)), Variable("glass", [0, 2])]
    operands = ["spot", Operand("focal_length", target=[70.0, 80.0, 90.0], weight=0.1)]
    design = zoom_design(zoom, operands, variables, count=1)
    names = design.substitute_glasses(["schott"], candidates=1, iterations=1)
    for system in (zoom.system, *(zoom.view(i) for i in range(3))):
        assert tuple(system.surfaces[i].material.name for i in (0, 2)) == names
    own = sum(share for _, _, share in design.report())
    assert own == pytest.approx(0.5 * float(design.residuals(design.values).square().sum()), rel=1e-12)
    fresh = zoom_design(zoom, operands, variables[:1], count=1)
    assert float(fresh.residuals(fresh.values).square().sum()) == pytest.approx(2 * own, rel=1e-9)


def test_zoom_designs_that_make_no_sense_are_refused():
    zoom = two_singlets()
    with pytest.raises(TypeError, match="zoom must be configurations"):
        zoom_design(zoom.system, "spot", Variable("curvature", 0))
    with pytest.raises(ValueError, match="solves must be for what the settings have, got one for the curvature"):
        zoom_design(zoom, "spot", Variable("thickness", 1), solves=[Solve("focal_length", 3, 80.0)])
    with pytest.raises(ValueError, match="target of an operand must have 3 numbers, got 2"):
        zoom_design(zoom, Operand("focal_length", target=[1.0, 2.0]), Variable("thickness", 1))


@pytest.mark.slow
def test_thin_lenses_become_a_threefold_zoom():
    """Focal lengths of 12 to 21 mm become 20 to 60 mm; spots and focal lengths by a trace that is not the library's."""
    judged = runpy.run_path(str(Path(__file__).parents[4] / "benchmarks" / "independent_trace.py"))["judged"]

    def lens(power, shape, glass, index, thickness, gap):
        bend = power / (index - 1) / 2
        front = surface(curvature=bend * (shape + 1), thickness=thickness, material=glass)
        return [front, surface(curvature=bend * (shape - 1), thickness=gap)]

    crown, flint = ("N-LAK33B", 1.755), ("SF5", 1.673)
    rows = [*lens(-1 / 26, 0.6, *crown, 1.5, 4.0), *lens(1 / 62, 2.0, *flint, 3.0, 49.0)]
    rows += [
        surface(thickness=0.5, stop=True),
        *lens(1 / 26, 0.5, *crown, 3.0, 0.5),
        *lens(1 / 36, 0.7, *crown, 3.0, 1.5),
    ]
    rows += [*lens(-1 / 18, -0.3, *flint, 1.5, 4.0), *lens(1 / 26, -0.3, *crown, 3.0, 40.0)]
    form = optical_system(rows, 8.0, aperture_type="F-number", wavelengths=[486.1327e-6, 587.5618e-6, 656.2725e-6])
    focal, last = [20.0, 34.6, 60.0], len(rows) - 1
    fields = [[math.degrees(math.atan(2.5 * k / f)) for k in (0, 0.7, 1)] for f in focal]
    settings = [("thickness", 3, [48.0, 25.0, 8.0]), ("thickness", last, [40.0, 50.0, 68.0]), ("fields", None, fields)]
    zoom = configurations(form, settings)
    assert float(zoom.each(first_order).focal_length.max()) < 22
    operands = [
        Operand("spot"),
        Operand("focal_length", target=focal, weight=0.1),
        Operand("edge_thickness", lower=0.3, options={"surfaces": range(last)}),
    ]
    variables = [
        Variable("curvature", [i for i in range(last + 1) if i != 4], -0.15, 0.15),
        Variable("thickness", [0, 2, 5, 7, 9, 11], 1.0, 5.0),
        Variable("thickness", [1, 6, 8, 10], 0.3, 8.0),
        Variable("thickness", 3, 0.5, 70.0),
        Variable("thickness", last),
    ]
    zoom_design(zoom, operands, variables, solves=[Solve("marginal_height", last)], count=2).optimise(15)
    for i, f in enumerate(focal):
        view = zoom.view(i)
        numbers = system_to_dict(view) | {"aperture": f / 8}
        found = judged(numbers, view.prescription().index.detach(), [y for _, y in view.fields])
        assert found["focal_length"] == pytest.approx(f, rel=5e-3) and found["lost"] == 0 and found["edge"] > 0.25
        assert found["rms"] < 0.025


@pytest.mark.parametrize("aim", ["paraxial", "real"])
def test_chief_rays_of_image_heights_land_there_off_both_axes(aim):
    """Fields are angles in x and in y: their ratio is not that of the heights, which their tangents have."""
    lens, heights = load_system("cooke_triplet"), [(0.0, 0.0), (6.0, 12.0), (-14.0, 3.0)]
    fields = fields_of_image_heights(lens, heights, True, aim)
    met = trace_fields(lens, torch.zeros(1, 2), fields=fields, aim=aim, vignetting=False)
    found = torch.stack([met.x, met.y], -1)[lens.reference, :, 0]
    torch.testing.assert_close(found, torch.tensor(heights, dtype=torch.float64), rtol=0, atol=1e-9)
