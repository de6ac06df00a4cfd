"""Least squares on lens systems, sensitivities and tolerances."""

import math

import pytest
import torch

from odak import AccuracyWarning
from odak._torch_private import forward_derivative
from odak.learn.raytracing.system import (
    Perturbation,
    coordinate_break,
    first_order,
    iso_10110_tolerances,
    levenberg_marquardt,
    load_system,
    optical_system,
    optimise,
    pupil_quadrature,
    rms_spot,
    sensitivity,
    surface,
    system_from_dict,
    system_to_dict,
    tolerance,
    tolerances_for_yield,
    trace_fields,
)
from odak.learn.raytracing.system.operands import clear_heights
from odak.learn.raytracing.system.optimise import LADDER, least_squares, perturbed
from odak.raytracing.surfaces import Conic, Toroid

F64 = torch.float64


def test_levenberg_and_marquardt_find_conic_of_perfect_lens():
    n = 1.5
    lens = optical_system(
        [surface(thickness=10.0, material=n), surface(-45.0, conic=0.0, thickness=100.0, stop=True)], aperture=40.0
    )
    parameters = lens.vary(curvature=1, conic=1)

    def residuals():
        found = trace_fields(lens, "y", 11)
        return found.y.reshape(-1)

    result = levenberg_marquardt(residuals, parameters, iterations=60)
    assert float(lens.surfaces[1].radius.detach()) == pytest.approx(-(n - 1) * 100, rel=1e-7)
    assert float(lens.surfaces[1].conic.detach()) == pytest.approx(-(n**2), rel=1e-6)
    assert list(result.history) == sorted(result.history, reverse=True) and result.loss < 1e-18


def test_levenberg_and_marquardt_stay_where_nothing_is_better():
    q = torch.tensor([3.0], dtype=torch.float64, requires_grad=True)
    result = levenberg_marquardt(lambda: torch.cat((q - 3, 2 + 0 * q)), [q])
    assert result.converged and result.history == (2.0,) and q.item() == 3.0


def test_what_of_a_surface_can_be_varied():
    glass = surface(20.0, thickness=3.0, material="N-BK7")
    text = repr(glass)
    assert text == "surface(radius=20, thickness=3, material=N-BK7)"
    assert "index 1.5" in repr(surface(20.0, material=1.5))
    curvature = glass.vary("curvature")
    assert glass.vary("curvature") is curvature and curvature.requires_grad
    assert float(glass.radius.detach()) == pytest.approx(20.0, rel=1e-15)
    for name, message in (("index", "cannot be varied: its material is"), ("coefficients", "is empty; give it zeros")):
        with pytest.raises(ValueError, match=message):
            glass.vary(name)
    given = torch.nn.Parameter(torch.tensor(0.05, dtype=F64))
    assert surface(thickness=given).thickness is given
    with pytest.raises(TypeError, match="thickness must be a number, a tensor without gradient"):
        surface(thickness=given * 2)


def test_steps_meet_limits_that_they_would_exceed():
    """Squares with a steep limit that is kept at the start: the first steps end at the least, found in closed form."""
    rows = torch.tensor([[1.0, 0.0], [0.0, 1e-2], [1e3, 1e3]], dtype=F64)
    wanted = torch.tensor([1.0, 1e-2, 5e2], dtype=F64)
    least = torch.linalg.lstsq(rows, wanted).solution
    limits = torch.tensor([False, False, True])

    def losses(x):
        value = x @ rows.mT - wanted
        return 0.5 * torch.where(limits, value.clamp_min(0.0), value).square().sum(-1)

    def found(*flags):
        def linearised(x):
            value = x @ rows.mT - wanted
            kept = limits & (value[0] <= 0) if not flags else limits & False
            value, slope = torch.where(kept, 0.0, value), torch.where(kept[:, None], 0.0, rows)
            return value, slope.expand(1, -1, -1), *flags

        return least_squares(linearised, losses, torch.zeros(1, 2, dtype=F64), iterations=4, ladder=LADDER).x[0]

    torch.testing.assert_close(found(limits), least, rtol=1e-3, atol=0)
    assert float((found() - least).norm()) > 0.1


def test_levenberg_marquardt_of_fewer_residuals_than_parameters():
    p = torch.tensor([1.0, 2.0, -1.0], dtype=F64, requires_grad=True)
    result = levenberg_marquardt(lambda: (p.sum() - 5).reshape(1), [p])
    assert float(p.sum().detach()) == pytest.approx(5, abs=1e-9) and result.loss < 1e-16
    with pytest.raises(ValueError, match="leaf tensors that require grad"):
        levenberg_marquardt(lambda: p, [])
    with pytest.raises(ValueError, match="finite at the start"):
        levenberg_marquardt(lambda: p * math.nan, [p])
    with pytest.raises(ValueError, match="depend on the parameters"):
        levenberg_marquardt(lambda: torch.ones(3), [p])


def test_any_torch_optimizer_improves_a_lens():
    system = load_system("singlet")
    optimizer = torch.optim.Adam(system.vary(curvature=[0, 1]), lr=1e-4)
    sizes = []
    for _ in range(30):
        optimizer.zero_grad()
        loss = rms_spot(system, "rings", 3).square().mean() + 1e-4 * (first_order(system).focal_length - 99.65).square()
        loss.backward()
        optimizer.step()
        sizes.append(float(loss.detach()))
    assert sizes[-1] < 0.8 * sizes[0]


def test_tolerances_are_reproducible_systems_of_their_own():
    system = load_system("cooke_triplet")
    off = [
        Perturbation("radius", [0, 1], 2e-3, relative=True),
        Perturbation("thickness", [0], 0.05, distribution="uniform"),
        Perturbation("index", 2, 1e-3),
        Perturbation("shift", [2, 3], 0.02, together=True),
        Perturbation("tilt", [0], 0.05),
    ]
    first, again = (tolerance(system, off, samples=8, seed=4) for _ in range(2))
    assert torch.equal(first.merit, again.merit)
    assert not torch.equal(first.merit, tolerance(system, off, samples=8, seed=5).merit)
    numbers = first.prescription
    one = numbers.select(3)
    torch.testing.assert_close(rms_spot(system, prescription=one), first.merit[3], rtol=1e-10, atol=0)
    torch.testing.assert_close(numbers.shift[:, 2], numbers.shift[:, 3])
    assert float((numbers.thickness[:, 0] - 4.831).abs().max()) <= 0.05
    ratio = numbers.curvature[:, 0] * 23.713
    assert 0 < float((1 / ratio - 1).std()) < 6e-3
    assert not bool((numbers.index[:, :, 3] - system.prescription().index[:, 3]).eq(0).any())
    with pytest.raises(ValueError, match="Did you mean"):
        tolerance(system, [Perturbation("tlt", 0, 1.0)])


def test_radii_are_off_by_what_was_asked_for():
    system = load_system("cooke_triplet")
    by_length, by_share = (
        tolerance(system, [Perturbation("radius", [0], size, relative=relative)], samples=5).prescription.curvature[
            :, 0
        ]
        for size, relative in ((2.0, False), (0.1, True))
    )
    drawn = (1 / by_length - 23.713) / 2.0
    torch.testing.assert_close((1 / by_share / 23.713 - 1) / 0.1, drawn, rtol=1e-10, atol=0)
    generator = torch.Generator().manual_seed(0)
    expected = torch.randn(5, 1, 1, generator=generator, dtype=F64).flatten()
    torch.testing.assert_close(drawn, expected, rtol=1e-10, atol=0)


def test_equal_pictures_have_no_loss():
    system = load_system("cooke_triplet")
    result = tolerance(system, [Perturbation("radius", [0], 0.0), Perturbation("tilt", [1], 0.0)], samples=2)
    torch.testing.assert_close(result.merit, result.nominal.expand(2, 3), rtol=1e-12, atol=0)


def test_sensitivities_are_those_of_systems_with_one_number_off():
    lens = load_system("cooke_triplet")
    found = sensitivity(
        lens, [Perturbation("thickness", [1, 3], 0.05), Perturbation("tilt", [4, 5], 0.1, together=True)]
    )
    assert found.names == (
        "thickness of surface 1",
        "thickness of surface 3",
        "tilt of surfaces 4, 5 about x",
        "tilt of surfaces 4, 5 about y",
    )
    for row, sign in enumerate((1.0, -1.0)):
        entry = system_to_dict(lens)
        entry["surfaces"][3]["thickness"] += sign * 0.05
        torch.testing.assert_close(found.merit[row, 1], rms_spot(system_from_dict(entry)), rtol=1e-9, atol=0)
        # The last element as a body about its first vertex, by coordinate breaks.
        items = list(system_from_dict(system_to_dict(lens)).surfaces)
        back = coordinate_break(return_to=4, thickness=float(items[4].thickness + items[5].thickness))
        items[5].thickness.fill_(0.0)
        rows = [*items[:4], coordinate_break(), coordinate_break(tilt=(0.0, sign * 0.1, 0.0)), *items[4:], back]
        options = {"wavelengths": lens.wavelengths, "fields": lens.fields}
        broken = optical_system(rows, lens.aperture, lens.aperture_type, **options)
        torch.testing.assert_close(found.merit[row, 3], rms_spot(broken), rtol=1e-9, atol=0)
    focused = sensitivity(lens, [Perturbation("thickness", -1, 0.1)], compensators=[("thickness", -1)])
    assert float((focused.merit - focused.nominal).abs().max()) < 1e-5
    result = tolerance(lens, [Perturbation("thickness", [1, 3], 0.05)], 40)
    good = [bool((merit <= 0.022).all()) for merit in result.merit]
    assert float(result.yield_within(0.022)) == sum(good) / 40 and 0 < sum(good) < 40


def image_heights(system, prescription=None):
    """Return the heights of the chief rays in the image, which a tilted ball moves."""
    return trace_fields(system, torch.zeros(1, 2, dtype=F64), prescription=prescription).y[..., 0, :, 0]


def test_a_ball_is_turned_as_a_body():
    """A ball of radius R turned about its front vertex moves its centre, and the image, by R·sin θ; about its centre
    nothing."""
    radius = 5.0
    ball = optical_system([surface(radius, thickness=2 * radius, material=1.5), surface(-radius, thickness=2.5)], 1.0)
    for pivot, expected in ((0.0, radius * math.sin(math.radians(1))), (radius, 0.0)):
        for name in ("tilt", "wedge"):
            off = [Perturbation(name, [0, 1], 1.0, together=True, pivot=pivot)]
            found = sensitivity(ball, off, merit=image_heights).merit[:, :, 0]
            # To the spherical aberration of the ray that leaves out the centre by as much.
            expected_rows = torch.tensor([[-expected, 0.0], [expected, 0.0]], dtype=F64)
            torch.testing.assert_close(found, expected_rows, rtol=0, atol=3e-5)
    with pytest.raises(ValueError, match="coordinate break among them"):
        rows = [surface(thickness=1.0), coordinate_break(), surface(thickness=9.0)]
        tolerance(optical_system(rows, 1.0), [Perturbation("tilt", [0, 2], 1.0, together=True)], 2)


def test_a_toroid_rolls_about_its_axis():
    toroid = surface(shape=Toroid(0.02, 0.03), thickness=4.0, material=1.5)
    turned = surface(shape=Toroid(0.02, 0.03), thickness=4.0, material=1.5, tilt=(0.0, 0.0, 20.0))
    lenses = [optical_system([front, surface(thickness=60.0)], 5.0, fields=[3.0]) for front in (toroid, turned)]
    found = sensitivity(lenses[0], [Perturbation("roll", 0, 20.0)], merit=image_heights).merit
    torch.testing.assert_close(found[0, 0], image_heights(lenses[1])[0:], rtol=1e-9, atol=1e-12)


def test_irregularities_and_abbe_numbers_are_off_as_asked():
    lens = load_system("cooke_triplet")
    off = [Perturbation("irregularity", 2, 1e-3), Perturbation("abbe", 2, 0.1, True)]
    numbers = perturbed(lens, lens.prescription(), off, 400, 0)
    points, weights = pupil_quadrature(lens, 8, vignetting=False)
    reach = lens.surfaces[2].semi_diameter or float(clear_heights(lens, lens.prescription())[2])
    flat = Conic(lens.surfaces[2].curvature).sag(*(reach * points.T)).height
    shape = numbers.shapes[2]
    parts = (value[:, None] for value in (shape.curvature, shape.conic, shape.coefficients))
    error = type(shape)(*parts, shape.radius).sag(*(reach * points.T)).height - flat
    each = (weights * error.square()).sum(-1)
    assert float(each.mean().sqrt()) == pytest.approx(1e-3, rel=0.1)
    assert float((weights * error).sum(-1).abs().max()) < 1e-9
    index, drawn = lens.prescription().index[:, 3], numbers.index[..., 3]
    ratio = (index[0] - index[2]) / (drawn[:, 0] - drawn[:, 2])
    assert float((ratio - 1).std()) == pytest.approx(0.1, rel=0.1)
    torch.testing.assert_close(drawn[:, 1], index[1].expand(400), rtol=0, atol=1e-15)


def test_a_linear_focus_is_the_best_one_in_two_or_three_traces(monkeypatch):
    lens = load_system("cooke_triplet")
    off = [Perturbation("thickness", [0, 2, 4], 0.05), Perturbation("wedge", range(6), 0.05)]
    calls = []

    def counted(*arguments, **options):
        calls.append(options["prescription"].batch)
        return trace_fields(*arguments, **options)

    monkeypatch.setattr(optimise, "trace_fields", counted)
    found = tolerance(lens, off, 2, compensators=[("thickness", -1)])
    assert 2 <= sum(batch == (2,) for batch in calls) <= 3
    torch.testing.assert_close(rms_spot(lens, prescription=found.prescription), found.merit, rtol=1e-12, atol=0)
    p = tolerance(lens, off, 2).prescription
    shifts = torch.linspace(-0.5, 0.5, 201, dtype=F64)
    for row in range(2):
        one = p.select(row)
        thickness = one.thickness + shifts[:, None] * torch.eye(6, dtype=F64)[-1]
        best = rms_spot(lens, prescription=one._replace(thickness=thickness)).square().sum(-1).min().sqrt()
        assert float(found.merit[row].square().sum().sqrt()) == pytest.approx(float(best), rel=1e-3)


def test_sizes_for_a_yield_are_the_largest():
    lens, limit = load_system("cooke_triplet"), 0.024
    off = [Perturbation("curvature", [0, 5], 1e-5), Perturbation("spacing", [1, 3], 0.05)]
    sizes, found = tolerances_for_yield(lens, off, limit, 0.8, samples=60)
    assert float(found.yield_within(limit)) >= 0.8
    wider = [item._replace(size=1.05 * item.size) for item in sizes]
    assert float(tolerance(lens, wider, 60).yield_within(limit)) < 0.8
    # Both add about the same, where neither came to the end of its range.
    with pytest.raises(ValueError, match="limit must be one that the system as drawn keeps"):
        tolerances_for_yield(lens, off, 0.001, 0.8, samples=4)


@pytest.mark.parametrize(
    ("diameter", "thickness", "form", "centring", "area"),
    [
        (10.0, 0.1, "3/5(1)", "4/30", None),
        (10.1, 0.2, "3/10(2)", "4/20", None),
        (30.0, 0.2, "3/10(2)", "4/20", None),
        (30.1, 0.4, "3/10(2)", "4/10", 30.0),
        (100.1, 0.8, "3/10(2)", "4/10", 60.0),
        (300.0, 0.8, "3/10(2)", "4/10", 60.0),
    ],
)
def test_tolerances_of_drawings_without_any(diameter, thickness, form, centring, area):
    """Table 1 of ISO 10110-11:1996 in the notation of drawings: 3/A(B) of form in fringes, 4/σ of tilt in minutes."""
    fringes, ripple = (int(part) for part in form[2:-1].split("("))
    half, radius = diameter / 2, 6 * diameter
    front = surface(radius, thickness=diameter / 5, material="N-BK7", semi_diameter=half)
    lens = optical_system([front, surface(-radius, thickness=5.8 * diameter, semi_diameter=half)], 1.5 * half)
    found = {(item.name, item.surfaces): item for item in iso_10110_tolerances(lens)}
    assert found[("thickness", 0)].size == thickness
    assert all(item.distribution == "uniform" for (name, _), item in found.items() if name != "irregularity")
    for i in (0, 1):
        assert 60 * found[("wedge", i)].size == pytest.approx(int(centring[2:]))
        # A fringe is half a wave of sag: c·h²/2 over the test area.
        sag = found[("curvature", i)].size * (min(diameter, area or diameter) / 2) ** 2 / 2
        assert sag == pytest.approx(fringes * 546.07e-6 / 2)
        assert 5 * found[("irregularity", i)].size == pytest.approx(ripple * 546.07e-6 / 2)


def test_elements_beyond_the_table_are_told():
    front = surface(3000.0, thickness=60.0, material="N-BK7", semi_diameter=200.0)
    with pytest.warns(AccuracyWarning, match="ends at a diameter of 300 mm; its last column is taken for 400 mm"):
        iso_10110_tolerances(optical_system([front, surface(-3000.0, thickness=2900.0)], 300.0))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64, torch.complex128])
def test_forward_derivatives_are_those_of_torch(dtype, monkeypatch):
    """Whatever meets the variable: numbers, tensors of other kinds and shapes, another derivative within, 0 and -0."""
    at, way = torch.rand(5).to(dtype) + 0.5, torch.rand(3, 5).to(dtype)
    constants = [
        torch.rand(5),
        torch.rand(2, 1).double(),
        torch.rand(1).expand(5),
        torch.arange(1, 6),
        torch.tensor(0.3),
        2,
        0.7,
        -0.0,
    ]

    def function(value):
        parts = [value * torch.arange(5).eq(2), torch.add(value, 1.0, alpha=3)]
        for one in constants:
            parts += [value * one, one * value, value + one, one + value, value - one, one - value, one / value]
            parts += [value / (one + 1), torch.mul(value, one), torch.sub(one, value) if is_tensor(one) else value]
        slope = torch.func.jvp(lambda other: other * value * 2.0, (value.detach(),), (value,))[1]
        return torch.cat(
            [part.expand(2, 5).reshape(-1) for part in [*parts, slope, torch.where(value.real > 1, value, 0)]]
        )

    is_tensor = torch.is_tensor
    made, make = [], torch.autograd.forward_ad.make_dual
    with monkeypatch.context() as patch:
        patch.setattr(torch.autograd.forward_ad, "make_dual", lambda *a, **o: made.append(a) or make(*a, **o))
        found = torch.func.vmap(lambda d: forward_derivative(function, at, d), out_dims=(None, -1))(way)
    expected = torch.func.vmap(lambda d: torch.func.jvp(function, (at,), (d,)), out_dims=(None, -1))(way)
    assert torch.equal(found[0], expected[0]) and torch.equal(found[1], expected[1])
    assert torch.equal(found[0].signbit(), expected[0].signbit()) if dtype.is_floating_point else True
    assert len(made) > 50
