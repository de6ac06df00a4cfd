"""Automatic design: real glasses, aspheres, lenses from flat plates."""

import math
import runpy
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
import torch

import odak
from odak.catalog import material, model_glass
from odak.catalog.materials import OpticalMaterial
from odak.learn.raytracing.system import (
    DesignSearch,
    LensDimensions,
    LensRequirements,
    Operand,
    Variable,
    automatic_design,
    distortion,
    first_order,
    launch,
    lens_design,
    lens_limits,
    load_system,
    optical_system,
    ray_paths,
    rms_spot,
    standard_design,
    surface,
    system_to_dict,
    trace_fields,
)
from odak.learn.raytracing.system.automatic import _optimised

F64 = torch.float64


@pytest.mark.slow
def test_glass_becomes_real_and_stays_good():
    triplet = load_system("cooke_triplet")
    variables = [Variable("curvature", range(6)), Variable("thickness", 5), Variable("glass", [2])]
    design = lens_design(triplet, ["spot", Operand("focal_length", 50.0)], variables, count=2)
    free = design.optimise(8)
    (name,) = design.substitute_glasses(["schott"], candidates=2, iterations=6)
    assert triplet.surfaces[2].material == material(name)
    assert "glass" not in design.places
    sizes = rms_spot(triplet, "rings", 2, vignetting=False)
    own = 0.5 * float(sizes.square().sum() + (first_order(triplet).focal_length - 50) ** 2)
    report = sum(share for _, _, share in design.report())
    assert report == pytest.approx(own, rel=1e-9)
    assert report < 3 * free.merit + 1e-6


def test_elements_can_be_ground_and_colour_is_bounded_by_default():
    """Rims and centres by diameter, of sags and rays that are computed here; an asked edge replaces the rule.

    Without its bound, axial colour is seven times as large as the depth of focus of a circle of confusion.
    """
    plates, demands = ["N-LAK33B", "stop", "SF5", "N-LAK33B"], LensRequirements(50.0, 2.8, 20.0)
    search = DesignSearch(starts=1, stages=1, iterations=5, polish=1)
    lens = automatic_design(plates, demands, search=search).system
    heights = ray_paths(lens, launch(lens, "rings", 12))[..., 1:, :2].norm(dim=-1).amax((0, 1, 2))
    for i in (0, 3, 5):
        rim = float(heights[i : i + 2].max())
        front, rear = (surface_sag(float(lens.surfaces[k].curvature), rim) for k in (i, i + 1))
        thickness = float(lens.surfaces[i].thickness)
        assert thickness > 0.98 * 2 * rim / 10 and thickness - front + rear > 0.97 * 2 * rim / 20, i
    images, circle = paraxial_images(lens), 100.0 * math.tan(math.radians(20.0)) / 1500
    assert max(images) - min(images) < 1.01 * 2 * 2.8 * circle
    rows = {(row.name, row.kind): row for row in lens_limits(lens, demands.limits())}
    assert rows["axial_color", "largest"].limit == pytest.approx(2 * 2.8 * circle)
    assert rows["axial_color", "largest"].value == pytest.approx(max(images) - min(images), rel=1e-9)
    assert rows["lateral_color", "largest"].limit == pytest.approx(circle / 2)
    assert [row for row in rows.values() if not row.met] == []
    free = LensDimensions(edge=0.05)
    assert free._ground == (0.0, 0.1) and LensDimensions(glass=(1.0, 9.0))._ground == (0.05, 0.0)


QUICK = {"starts": 1, "stages": 1, "iterations": 2, "polish": 0}


def test_cemented_elements_share_their_surface_and_can_be_ground_each():
    """A doublet has three surfaces; its colour needs both glasses, and the outer wavelengths meet within the bound."""
    demands, search = LensRequirements(100.0, 8.0, 1.0), DesignSearch(starts=1, stages=1, iterations=3, polish=0)
    lens = automatic_design(["stop", ("N-BK7", "N-SF2")], demands, search=search).system
    assert [getattr(item.material, "name", item.material) for item in lens.surfaces] == ["air", "N-BK7", "N-SF2", "air"]
    images, circle = paraxial_images(lens), 100.0 / 2 / 1500
    assert max(images) - min(images) < 1.01 * 2 * 8.0 * circle
    rim = 100.0 / 8 / 2
    for i in (1, 2):
        front, rear = (surface_sag(float(lens.surfaces[k].curvature), rim) for k in (i, i + 1))
        assert float(lens.surfaces[i].thickness) - front + rear > 0.97 * 2 * rim / 20, i
    with pytest.raises(ValueError, match="cemented elements must be two materials or more"):
        automatic_design(["stop", ("N-BK7",)], demands, search=search)


def test_vignetted_pupils_are_designed_for_and_limit_the_apertures():
    """At the edge of the field rays of the pupil's upper rim are lost on the rim of a lens far from its stop."""
    room = LensDimensions(air=(10.0, 15.0))
    demands = LensRequirements(100.0, 5.0, 15.0, wavelengths=[587.6e-6], vignetting=0.3)
    lens = automatic_design(["stop", "N-BK7"], demands, dimensions=room, search=DesignSearch(**QUICK)).system
    fractions = [math.tan(math.radians(y)) / math.tan(math.radians(15.0)) for _, y in lens.fields]
    wanted = [max(0.0, 0.3 * (2 * k - 1)) for k in fractions]
    assert [row[3] for row in lens.vignetting_factors] == pytest.approx(wanted, abs=1e-12)
    gap = float(lens.surfaces[0].thickness)
    # The first surface is as wide as the widest of twelve rays around the rim of the pupil of each field.
    heights = []
    for share, cut in zip(fractions, wanted, strict=True):
        for turn in range(12):
            x, y = 10.0 * math.sin(turn * math.pi / 6), 10.0 * (1 - cut) * math.cos(turn * math.pi / 6)
            height = 0.0
            for _ in range(30):
                reach = gap + surface_sag(float(lens.surfaces[1].curvature), height)
                height = math.hypot(x, y + share * math.tan(math.radians(15.0)) * reach)
            heights.append(height)
    assert lens.surfaces[1].semi_diameter == pytest.approx(1.001 * max(heights), rel=1e-9)
    points = torch.tensor([[0.0, 0.7], [0.0, 0.95]], dtype=F64)
    arrived = trace_fields(lens, points, fields=[(0.0, 15.0 + 1e-9)], vignetting=True).arrived
    assert arrived.flatten().tolist() == [True, False]
    (row,) = lens_limits(lens, {"vignetting": 0.3})
    assert row.met and 0.05 < row.value < 0.3


def paraxial_images(lens):
    """Return the paraxial image distances of all wavelengths, of sums that are not the library's."""
    images = []
    for index in lens.prescription().index.tolist():
        height, slope = 1.0, 0.0
        for item, (before, behind) in zip(lens.surfaces, pairwise(index), strict=True):
            slope = (before * slope - (behind - before) * float(item.curvature) * height) / behind
            height += slope * float(item.thickness)
        images.append(-height / slope)
    return images


def surface_sag(curvature, height):
    return curvature * height**2 / (1 + (1 - (curvature * height) ** 2) ** 0.5)


def judged_alone(lens, angles, size, bent, edge=1e-9):
    """Assert what the requirements say by rays that the library does not trace."""
    script = Path(__file__).parents[4] / "benchmarks" / "independent_trace.py"
    judged = runpy.run_path(str(script))["judged"]
    found = judged(system_to_dict(lens), lens.prescription().index.detach(), angles)
    assert found["rms"] < size and found["distortion"] < bent and found["lost"] == 0 and found["edge"] >= edge


@pytest.mark.slow
def test_lens_is_designed_from_flat_plates_and_seed_repeats_it():
    """The requirements are met for rays of another pattern; the same seed gives the same digits."""
    plates, demands = ["N-LAK33B", "stop", "SF5", "N-LAK33B"], LensRequirements(50.0, 5.6, 10.0)
    room, search = {"edge": 0.5, "back": 20.0, "track": 80.0}, DesignSearch(starts=6, iterations=8, polish=1, seed=4)
    found = automatic_design(plates, demands, dimensions=LensDimensions(**room), search=search)
    # The older form: a number that is given beside an object replaces the object's.
    again = automatic_design(plates, 50.0, 5.6, 10.0, **room, search=replace(search, seed=9), seed=4)
    lens, first = found.system, first_order(found.system)
    assert float(first.focal_length) == pytest.approx(50.0, rel=1e-9)
    assert float(first.f_number) == pytest.approx(5.6, rel=1e-9)
    fields = [(0.0, 0.0), (0.0, 5.0), (0.0, 10.0)]
    assert float(rms_spot(lens, "grid", 15, fields=fields).max()) < 0.02
    assert float(distortion(lens, fields=fields).abs().max()) < 0.02
    judged_alone(lens, [0.0, 5.0, 10.0], 0.02, 0.02)
    assert bool(trace_fields(lens, "rings", 6).arrived.all())
    assert all(float(item.thickness) > 0 for item in lens.surfaces)
    assert all(float(item.curvature) == 0 for item in found.start.surfaces)
    assert torch.equal(lens.prescription().curvature, again.system.prescription().curvature)


@pytest.mark.slow
def test_single_design_begins_as_best_of_several_bendings():
    """Without the choice this seed ends at 0.16 mm."""
    elements = ["N-LAK33B", "stop", "SF5", "N-LAK33B"]
    options = {"starts": 1, "stages": 1, "iterations": 4, "polish": 0, "edge": 0.5, "back": 20.0, "seed": 2}
    lens = automatic_design(elements, 50.0, 11.2, 12.0, **options).system
    assert float(rms_spot(lens, "grid", 15).max()) < 0.005


@pytest.mark.slow
@pytest.mark.parametrize(("terms", "size"), [(0, 0.0145), (2, 0.011)])
def test_glasses_that_vary_from_start_correct_colour_and_spots(terms, size):
    """A triplet of 50 mm, f/2.8 and 20 degrees, judged by rays and paraxial sums that are not the library's.

    Without the bound of lateral colour, aspheres have spots of 9.3 micrometres; with it, of 10.
    """
    options = {"glass": (1.5, 9.0), "air": (0.3, 15.0), "edge": 0.6, "back": 20.0, "track": 80.0, "polish": 1}
    lens = automatic_design(
        ["N-LAK33B", "stop", "SF5", "N-LAK33B"],
        50.0,
        2.8,
        20.0,
        makers=["schott", "ohara"],
        axial_color=0.1,
        aspheric_terms=terms,
        starts=12,
        iterations=12,
        **options,
    ).system
    names = [item.material.name for item in lens.surfaces if isinstance(item.material, OpticalMaterial)]
    assert len(names) == 3 and all(material(name).source for name in names)
    judged_alone(lens, [0.625 * k for k in range(33)], size, 0.02, edge=0.3)
    assert all(1.5 <= float(lens.surfaces[i].thickness) <= 9.0 for i in (0, 3, 5))
    images = paraxial_images(lens)
    assert max(images) - min(images) < 0.1


def test_the_usual_design_holds_its_limits():
    """Focal length and track of a triplet that exceeds both; what is not a limit is refused."""
    lens = load_system("cooke_triplet")
    track = sum(float(item.thickness) for item in lens.surfaces)
    design = standard_design(lens, 48.0, limits={"track": track - 5, "axial_color": 0.02})
    design.optimise(4)
    assert float(first_order(lens).focal_length) == pytest.approx(48.0, rel=1e-9)
    assert sum(float(item.thickness) for item in lens.surfaces) < track - 4.9
    assert [item.upper for item in design.operands if item.kind == "axial_color"] == [0.02]
    with pytest.raises(ValueError, match="name of limits must be one of"):
        standard_design(lens, limits={"length": 60.0})
    with pytest.raises(ValueError, match="no surface whose curvature could vary"):
        standard_design(optical_system([surface(thickness=3.0, material=1.5), surface(thickness=1.0)], 1.0), 50.0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: LensRequirements(50.0, 2.8, 80.0), "half_field must be below 80 degrees, got 80"),
        (lambda: LensRequirements(50.0, -2.8, 20.0), "f_number must be positive"),
        (lambda: LensRequirements(50.0, 2.8, 20.0, axial_color=0.0), "axial_color must be positive"),
        (lambda: LensRequirements(50.0, 2.8, 20.0, lateral_color=-1.0), "lateral_color must be positive"),
        (lambda: LensRequirements(50.0, 2.8, 20.0, vignetting=1.0), "vignetting must be from 0 to 0.9"),
        (lambda: LensDimensions(glass=(9.0, 1.5)), "glass must be a least and a larger thickness"),
        (lambda: LensDimensions(cover=("N-BK7", 0.0)), r"cover\[1\] must be positive"),
        (lambda: DesignSearch(stages=7), "stages must be at most 6, got 7"),
        (lambda: automatic_design(["stop", "N-BK7"], 50.0, -2.8, 20.0), "f_number must be positive"),
    ],
)
def test_numbers_that_no_lens_has_are_named(make, words):
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize(("f_number", "poor"), [(2.0, True), pytest.param(4.0, False, marks=pytest.mark.slow)])
def test_large_spots_of_aspheres_give_a_warning(f_number, poor):
    """One step of a singlet leaves large spots at f/2 and smaller ones at f/4."""
    options = {"aspheric_terms": 1, "wavelengths": [587.6e-6], "starts": 1, "stages": 1, "iterations": 1, "polish": 0}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        lens = automatic_design(["stop", "N-BK7"], 100.0, f_number, 10.0, **options).system
    largest = float(rms_spot(lens, "rings", 8).max())
    assert (largest > 100.0 / 400) == poor
    told = [item for item in caught if item.category is odak.ConvergenceWarning]
    assert [f"the largest spot is {largest:.3g} mm RMS" in str(item.message) for item in told] == [True] * poor


@pytest.mark.slow
def test_aspheres_are_designed_without_running_away():
    """Three plastic aspheres of 50 degrees at f/4: spots by rays of another pattern, also between the fields."""
    low, high = model_glass(1.5445, 55.99), model_glass(1.6613, 20.37)
    options = {"aspheric_terms": 3, "glass": (0.25, 1.0), "air": (0.05, 1.0), "edge": 0.05, "back": 0.4, "track": 7.0}
    lens = automatic_design(
        ["stop", low, high, low], 4.55, 4.0, 25.0, starts=3, iterations=6, polish=0, **options
    ).system
    assert float(first_order(lens).focal_length) == pytest.approx(4.55, rel=1e-9)
    assert float(rms_spot(lens, "grid", 15).max()) < 0.01
    assert float(distortion(lens).abs().max()) < 0.02
    judged_alone(lens, [2.5 * k for k in range(11)], 0.01, 0.02)
    assert bool(trace_fields(lens, "rings", 6).arrived.all())
    for item in lens.surfaces[1:]:
        y = torch.linspace(0.0, 1.1 * item.semi_diameter, 50, dtype=F64)
        assert float(item.shape.sag(0 * y, y).slope_y.abs().max()) < 1.4


@pytest.mark.parametrize(("height", "lost"), [(0.9, False), (3.0, False), (10.0, True), (67.0, True)])
def test_designs_with_a_ray_far_from_the_axis_are_dropped(height, lost):
    """A ray that is nearly lost intersects at 10 or more, whose powers leave few digits of the values: rays are lost.

    The slope 0.01·14·h¹³ of the term of r¹⁴ is 2.2e5 at 3 and 1.4e12 at 10; the limit is 1e8, so that no rounding
    decides. Growing aspheres take a shorter step then.
    """
    shape = {"conic": -1.0, "coefficients": [0.0] + [0.01] * 6}
    rows = [
        surface(thickness=1.0, stop=True),
        surface(curvature=0.5, material=1.5, thickness=1.0, **shape),
        surface(thickness=1.0, **shape),
    ]
    system = optical_system(rows, 0.1, fields=[0.0, 30.0], wavelengths=[5e-4])
    operands = [Operand("spot", options={"lost": 0.1}), Operand("distortion", lower=-0.1, upper=0.1)]
    coefficients = [Variable("coefficients", [1, 2], terms=[k]) for k in range(1, 7)]
    design = lens_design(system, operands, [Variable("curvature", [1, 2]), *coefficients])
    design.clear_heights = lambda values: torch.full((len(values), 3), height, dtype=F64)
    values = design.values[None]
    assert bool(torch.isfinite(design.residuals(values)).all())
    assert (_optimised(design, values, 1, steep=True) is None) == lost
    # A design of which no height is known is dropped as well.
    design.clear_heights = lambda values: torch.full((len(values), 3), torch.nan, dtype=F64)
    assert _optimised(design, values, 1, steep=True) is None
