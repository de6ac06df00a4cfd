"""Graded-index media in optical systems: stigmatic balls, rods of a pitch, breaks and mirrors, gradients, files."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch

from odak.learn.raytracing.system import (
    Solve,
    Variable,
    coordinate_break,
    curved_paths,
    distortion,
    exit_field,
    first_order,
    huygens_point_spread_function,
    launch,
    layout_figure,
    lens_design,
    optical_system,
    ray_paths,
    seidel_sums,
    sequence,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    wavefront,
)
from odak.raytracing import RayStatus
from odak.raytracing.gradients import AxialGradient, FunctionGradient, Gradient, RadialGradient

F64 = torch.float64
RAYS = torch.tensor([[[0.5, 0.2, 0.0], [0.0, 0, 1]], [[0.3, -0.4, 0.0], [0.1, 0.05, math.sqrt(1 - 0.0125)]]], dtype=F64)


@dataclass(frozen=True)
class Constant(Gradient):
    """A medium of the index of its material and more: what a user writes."""

    more: Any = 0.0

    def index(self, x, y, z, base):
        return base + self.more + 0 * (x + y + z)


def rod_of(length=7.0, **options):
    front = surface(9.0, thickness=length, material=1.6, gradient=RadialGradient([-0.09]), **options)
    return optical_system([front, surface(-15.0, thickness=2.0)], 1.0, fields=[0.0, 3.0])


def test_a_luneburg_ball_focuses_parallel_light_on_its_rear():
    """n² = 2 − r²: every ray ends in the antipode after a path of (1 + π/2)·R from the tangent plane."""
    ball = FunctionGradient.of(lambda x, y, z, base: (2 - x * x - y * y - (z - 1) ** 2).clamp(min=0.1) ** 0.5)
    lens = optical_system([surface(1.0, thickness=2.0, material=1.0, gradient=ball), surface(-1.0)], 1.9)
    found = trace_fields(lens, "rings", 4)
    assert bool(found.arrived.all())
    assert float(torch.stack([found.x, found.y, found.z]).abs().max()) < 1e-12
    assert float((found.path - (1 + math.pi / 2)).abs().max()) < 1e-11


def test_a_medium_without_a_gradient_is_plain_glass():
    """The curved path through a constant index is the straight one, fold and tilts included, with all derivatives."""

    def system_of(**options):
        glass = {"material": 1.5, **options}
        return optical_system(
            [
                surface(30.0, thickness=5.0, tilt=(2.0, 1.0), **glass),
                coordinate_break(tilt=(45.0, 0.0, 0.0)),
                surface(material="mirror"),
                coordinate_break(tilt=(45.0, 0.0, 0.0), thickness=-6.0),
                surface(25.0, thickness=-20.0, shift=(0.1, 0.2)),
            ],
            2.0,
        )

    plain = system_of()
    curved = system_of(gradient=Constant(0.0))
    for name, found in trace(curved, RAYS)._asdict().items():
        assert torch.allclose(found, getattr(trace(plain, RAYS), name), rtol=0, atol=1e-11), name
    for system in (plain, curved):
        for item in system.surfaces:
            item.vary("tilt"), item.vary("thickness")
        system.surfaces[0].vary("index"), system.surfaces[0].vary("curvature"), system.surfaces[4].vary("curvature")
        sum(value.sum() for value in trace(system, RAYS)[:7]).backward()
    ours, expected = (dict(system.named_parameters()) for system in (curved, plain))
    for name, value in expected.items():
        assert torch.allclose(ours[name].grad, value.grad, rtol=1e-8, atol=1e-8), name


def test_first_order_of_graded_media_is_the_limit_of_rays():
    for gradient in (AxialGradient([0.05, -0.004]),):
        front = surface(20.0, thickness=4.0, material=1.6, gradient=gradient)
        lens = optical_system([front, surface(-30.0, thickness=3.0)], 2e-3)
        edge = trace_fields(lens, "y", 3)
        focal = -1e-3 * edge.w[0, 0, 2] / edge.v[0, 0, 2]
        properties = first_order(lens)
        assert torch.allclose(properties.focal_length, focal, rtol=1e-6)
        back = 3.0 - edge.y[0, 0, 2] * edge.w[0, 0, 2] / edge.v[0, 0, 2]
        assert torch.allclose(properties.back_focal_distance, back, rtol=1e-6)
    # A quarter pitch, π/(2g): focal length 1/(n₀g), and the focus on the rear face.
    flat = surface(thickness=math.pi / 0.6, material=1.6, gradient=RadialGradient([-0.09]))
    quarter = first_order(optical_system([flat, surface()], 1.0))
    assert abs(float(quarter.focal_length) - 1 / 0.48) < 1e-7
    assert abs(float(quarter.back_focal_distance)) < 1e-7


def _landing(system, names):
    from torch.func import functional_call

    class Whole(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.lens = system

        def forward(self, rays):
            found = trace(self.lens, rays, until=1)
            return torch.cat([found.x.flatten(), found.v.flatten(), found.path.flatten()])

    return lambda rays, *values: functional_call(Whole(), dict(zip(names, values, strict=True)), (rays,))


def _varied():
    lens = rod_of(2.0)
    values = [lens.surfaces[0].vary(name) for name in ("index", "thickness", "curvature")]
    values += [
        lens.surfaces[0].own_gradient and lens.surfaces[0].vary("coefficients"),
        lens.surfaces[1].vary("curvature"),
    ]
    held = {id(value): name for name, value in lens.named_parameters()}
    return lens, values, [f"lens.{held[id(value)]}" for value in values]


def test_gradients_through_a_medium():
    """By the ray, the medium, the base index, and the surfaces at both ends, against finite differences."""
    lens, values, names = _varied()
    assert torch.autograd.gradcheck(_landing(lens, names), (RAYS.clone().requires_grad_(), *values), fast_mode=True)


@pytest.mark.slow
def test_second_derivatives_through_a_medium():
    lens, values, names = _varied()
    ray = RAYS[:1].clone().requires_grad_()
    assert torch.autograd.gradgradcheck(_landing(lens, names), (ray, *values), fast_mode=True)


def test_the_memory_of_the_graph_does_not_grow_with_the_steps():
    """What autograd saves for a rod of one pitch is what it saves for one of twenty."""

    def saved(length):
        sizes = []
        lens = rod_of(length)
        lens.surfaces[0].vary("coefficients")
        with torch.autograd.graph.saved_tensors_hooks(lambda t: sizes.append(t.numel()) or t, lambda t: t):
            trace(lens, RAYS, until=1)
        return sum(sizes)

    assert saved(2.0) == saved(100.0)


def test_functions_of_ones_own_take_part_in_gradients():
    lens = optical_system(
        [
            surface(
                thickness=3.0,
                material=1.5,
                gradient=FunctionGradient.of(lambda x, y, z, n, a, b: n + a * (x * x + y * y) + b * z, [-0.02, 0.01]),
            ),
            surface(thickness=4.0),
        ],
        1.0,
    )
    given = lens.surfaces[0].vary("parameters_of_function")
    trace(lens, RAYS).y[0, 0, 1].backward()
    step = 1e-5
    for i in range(2):
        ends = []
        for side in (1, -1):
            with torch.no_grad():
                given[i] += side * step
                ends.append(float(trace(lens, RAYS).y[0, 0, 1]))
                given[i] -= side * step
        assert abs((ends[0] - ends[1]) / (2 * step) - float(given.grad[i])) < 1e-7
    with pytest.raises(ValueError, match="given by a function cannot be written"):
        system_to_dict(lens)


def test_files_ways_of_rays_and_what_is_refused():
    lens = rod_of()
    again = system_from_dict(system_to_dict(lens))
    assert torch.equal(trace_fields(again).y, trace_fields(lens).y)
    rays = launch(lens, "y", 3)
    paths = ray_paths(lens, rays)
    within = curved_paths(lens, rays, 0, paths[..., 2, :], 16)
    assert torch.allclose(within[..., 0, :], paths[..., 1, :], rtol=0, atol=1e-12)
    assert torch.allclose(within[..., -1, :], paths[..., 2, :], rtol=0, atol=1e-9)
    assert len(layout_figure(lens, count=3).axes[0].lines) > 6
    with pytest.raises(ValueError, match="not to a mirror"):
        surface(material="mirror", gradient=RadialGradient([0.1]))
    with pytest.raises(TypeError, match="gradient must be a Gradient"):
        surface(gradient=0.1)


def test_rays_that_turn_around_are_lost_without_gradients():
    """A medium that reverses a steep ray: its status is an error, the others have finite gradients."""
    front = surface(thickness=5.0, material=1.6, gradient=AxialGradient([-0.2]))
    lens = optical_system([front, surface(thickness=1.0)], 1.0)
    front.vary("coefficients")
    steep = torch.tensor(
        [[[0.0, 0, 0], [0, 0.9, math.sqrt(0.19)]], [[0.0, 0, 0], [0, 0.1, math.sqrt(0.99)]]], dtype=F64
    )
    found = trace(lens, steep)
    assert found.status[0, 0].tolist() == [RayStatus.NOT_CONVERGED, RayStatus.HIT]
    torch.where(found.arrived, found.y, 0.0).sum().backward()
    assert bool(torch.isfinite(front.own_gradient.coefficients.grad).all())


def test_focal_length_solve_includes_graded_media_on_both_sides():
    for place in (0, 1):
        lens = rod_of()
        design = lens_design(
            lens, "spot", Variable("thickness", 1), solves=[Solve("focal_length", place, 5.0)], count=2
        )
        design.apply(design.values)
        edge = trace_fields(lens, torch.tensor([[0.0, 1e-3]], dtype=F64), fields=[(0.0, 0.0)])
        assert -0.5e-3 * float(edge.w / edge.v) == pytest.approx(5.0, rel=1e-6)
    with pytest.raises(ValueError, match="thickness of surface 0 cannot be solved for: the medium behind it is graded"):
        lens_design(rod_of(), "spot", Variable("thickness", 1), solves=[Solve("marginal_height", 0, 0.1)])


def test_images_in_graded_media_are_refused_those_behind_right():
    def lens_of(*more):
        graded = surface(20.0, thickness=7.0, material=1.5, gradient=RadialGradient([-0.03]))
        return optical_system([surface(9.0, thickness=1.0, material=1.6), graded, *more], 2e-3, fields=[0.0, 1.0])

    within = lens_of()
    edge = trace_fields(within, "y", 3)
    for function in (first_order, wavefront, exit_field):
        with pytest.raises(ValueError, match=r"surfaces\[1\] has a graded medium behind it that reaches the image"):
            function(within)
    with pytest.raises(ValueError, match="reaches the image"):
        huygens_point_spread_function(within, 8, 8, pitch=1e-3)
    # The paraxial chief ray at the image within the medium is that of a small field.
    small = 1e-3
    assert abs(float(distortion(within, fields=[(0.0, small)]))) < 1e-6
    # An end plane of the base index in front of the image: real and paraxial image agree.
    ended = lens_of(surface(thickness=1.0, material=1.5))
    ray = trace_fields(ended, "y", 3, until=2)
    expected = -ray.y[0, 0, 2] * ray.w[0, 0, 2] / ray.v[0, 0, 2]
    assert float(first_order(ended).image_distance) == pytest.approx(float(expected), rel=1e-5)
    assert torch.allclose(ray.y, edge.y, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("folded", "kind"),
    [(surface(material="mirror", thickness=-3.0), "mirror"), (coordinate_break(), "coordinate break")],
)
def test_paraxial_matrices_refuse_graded_media_behind_mirrors(folded, kind):
    front = surface(9.0, thickness=3.0, material=1.6, gradient=RadialGradient([-0.09]))
    lens = optical_system([front, folded, surface(thickness=-2.0)], 1.0, fields=[0.0, 1.0])
    for function in (first_order, distortion):
        with pytest.raises(ValueError, match=f"continues behind a {kind}"):
            function(lens)
    lens.aperture_type, lens.aperture = "F-number", 4.0
    with pytest.raises(ValueError, match=f"continues behind a {kind}"):
        launch(lens, "y", 3)


def richardson(coarse, fine):
    """Return the limit of two values whose errors are quadratic in steps of 2 and 1."""
    return (4 * fine - coarse) / 3


@pytest.mark.parametrize("distance", [math.inf, pytest.param(150.0, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_third_order_sums_of_graded_media_are_limit_of_real_rays(distance):
    """All transverse aberrations and colours, for an axial and a radial gradient between curved surfaces."""
    waves = [0.588e-3, 0.587e-3, 0.5875e-3]

    def lens(focus):
        return optical_system(
            [
                surface(40.0, thickness=4.0, material="N-BK7", gradient=AxialGradient([0.02, 0.003])),
                surface(-60.0, thickness=6.0),
                surface(thickness=3.0, stop=True),
                surface(-30.0, thickness=5.0, material="SF5", gradient=RadialGradient([-2e-3, 5e-6])),
                surface(-25.0, thickness=focus),
            ],
            0.8,
            "stop",
            wavelengths=waves,
            reference=2,
            object_distance=distance,
            fields=[0.1],
        )

    system = lens(float(first_order(lens(80.0)).image_distance))
    sums = {name: float(value) for name, value in seidel_sums(system).transverse.items()}
    # One trace: fields 4, 2, 0.1, 0.05 and 0 by pupil points of radius 1, 1/2, 1/4 and 1/8.
    sizes = [1.0, 0.5, 0.25, 0.125]
    points = [(0.0, 0.0)] + [pair for r in sizes for pair in ((0.0, r), (0.0, -r), (r, 0.0), (-r, 0.0))]
    sizes_of_fields = [4.0, 2.0, 0.1, 0.05, 0.0]
    traced = trace_fields(
        system, torch.tensor(points, dtype=torch.float64), fields=[(0.0, f) for f in sizes_of_fields], vignetting=False
    )
    x, y = (value[2].tolist() for value in (traced.x, traced.y))
    far = math.isinf(distance)
    heights = [math.tan(math.radians(f)) if far else f for f in sizes_of_fields]
    properties = first_order(system)
    scale = float(properties.focal_length if far else properties.magnification)

    def odd(i, j):
        """Return the linear part of the tangential and the sagittal fan at field i from the j-th size on."""
        tangential = [(y[i][1 + 4 * k] - y[i][2 + 4 * k]) / (2 * sizes[k]) for k in (j, j + 1)]
        sagittal = [(x[i][3 + 4 * k] - x[i][4 + 4 * k]) / (2 * sizes[k]) for k in (j, j + 1)]
        return np.asarray([richardson(*tangential), richardson(*sagittal)])

    def even(j):
        """Return the coma of the j-th size over field and size squared."""
        found = [((y[i][1 + 4 * j] + y[i][2 + 4 * j]) / 2 - y[i][0]) / heights[i] / sizes[j] ** 2 for i in (2, 3)]
        return richardson(*found)

    largest = heights[2]
    bent = [(odd(i, 2) - odd(4, 2)) / heights[i] ** 2 for i in (0, 1)]
    tangential, sagittal = richardson(*bent) * largest**2
    distorted = [(y[i][0] - scale * heights[i]) / heights[i] ** 3 for i in (0, 1)]
    found = {
        "SA": richardson(*(y[4][1 + 4 * k] / sizes[k] ** 3 for k in (0, 1))),
        "TCO": richardson(even(0), even(1)) * largest,
        "TAS": tangential,
        "SAS": sagittal,
        "DST": richardson(*distorted) * largest**3,
        "AX": float(traced.y[1, 4, 13] - traced.y[0, 4, 13]) / sizes[3],
        "LAT": float(traced.y[1, 2, 0] - traced.y[0, 2, 0]),
    }
    for name, value in found.items():
        assert sums[name] == pytest.approx(value, rel=1e-4 if name not in ("AX", "LAT") else 1e-3), name


def test_third_order_sums_of_graded_media_are_differentiable():
    rod = [surface(30.0, material=1.6, gradient=RadialGradient([-1e-3, 1e-6]), thickness=4.0), surface(thickness=40.0)]
    lens = optical_system(rod, 4.0, fields=[3.0])
    numbers = lens.prescription()

    def total(curvature, thickness):
        found = seidel_sums(lens, prescription=numbers._replace(curvature=curvature, thickness=thickness))
        return (found.seidel * torch.arange(1, 11, dtype=F64).reshape(5, 2)).sum()

    at = [numbers.curvature.requires_grad_(), numbers.thickness.requires_grad_()]
    parts = torch.autograd.grad(total(*at), at)
    along, step = [torch.tensor([0.1, 0.3], dtype=F64), torch.tensor([0.7, 0.2], dtype=F64)], 1e-4
    with torch.no_grad():
        ends = [total(*(value + side * step * way for value, way in zip(at, along, strict=True))) for side in (1, -1)]
    slope = sum(float((part * way).sum()) for part, way in zip(parts, along, strict=True))
    assert slope == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)
    curvature = at[0].detach()
    batch = numbers._replace(curvature=torch.stack([curvature, 1.1 * curvature]).detach())
    found = seidel_sums(lens, prescription=batch).seidel
    assert found.shape == (2, 5, 2)
    torch.testing.assert_close(found[0], seidel_sums(lens).seidel.detach(), atol=1e-14, rtol=0)
    own = FunctionGradient.of(lambda x, y, z, base, parameters: base + 0 * x)
    with pytest.raises(ValueError, match=r"surfaces\[0\] must have a radial or an axial gradient"):
        seidel_sums(optical_system([surface(30.0, material=1.6, gradient=own, thickness=4.0), surface()], 4.0))


def test_gradients_of_parts_of_the_rays_add_up(monkeypatch):
    def gradients():
        system = optical_system(
            [surface(radius=50.0, thickness=5.0, material=1.6, gradient=RadialGradient([-5e-3, 1e-6]), stop=True)], 10.0
        )
        numbers = [system.surfaces[0].vary(name) for name in ("curvature", "thickness", "coefficients")]
        traced = trace(system, launch(system, "rings", 6))
        return torch.autograd.grad(traced.x.square().sum() + traced.path.sum(), numbers)

    whole = gradients()
    monkeypatch.setattr(sequence, "FLOWING", 1)
    for part, of_all in zip(gradients(), whole, strict=True):
        torch.testing.assert_close(part, of_all, rtol=1e-10, atol=0)
        assert bool(of_all.any())
