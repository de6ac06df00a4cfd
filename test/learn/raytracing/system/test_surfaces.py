"""Any shape, aperture and phase in a lens: one class is all that it takes."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from odak.learn.raytracing.system import (
    Conjugates,
    Rays,
    coordinate_break,
    first_order,
    ghost_system,
    launch,
    optical_system,
    ray_paths,
    rms_spot,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    wavefront,
)
from odak.learn.raytracing.system.surfaces import drawn_radii
from odak.raytracing import Conic, EvenAsphere, RayStatus, SplineFreeform, Toroid, ZernikeFreeform
from odak.raytracing.apertures import CircularAperture, EllipticAperture, PolygonAperture, RectangularAperture
from odak.raytracing.interfaces import IdealLens, LinearGrating, PolynomialPhase, RadialPhase, ZernikePhase
from odak.raytracing.surfaces import Sag, Shape, conic_sag, intersection

F64 = torch.float64


@dataclass(frozen=True)
class CubicAsphere(Shape):
    """A conic plus cubic·r³: what a user writes."""

    curvature: Any = 0.0
    cubic: Any = 0.0

    def sag(self, x, y):
        base = conic_sag(x, y, self.curvature, 0.0)
        radius = (x * x + y * y + 1e-30) ** 0.5
        slope = 3 * self.cubic * radius
        height = base.height + self.cubic * radius**3
        return Sag(height, base.slope_x + slope * x, base.slope_y + slope * y, base.defined)

    def base(self):
        return self.curvature, 0.0


@dataclass(frozen=True)
class PlainConic(Conic):
    """A conic that the fused kernel does not support."""


@dataclass(frozen=True)
class PlainAsphere(EvenAsphere):
    """An even asphere that the fused kernel does not support."""


SHAPES = {
    "toroid": Toroid(0.02, 0.015, -0.3, [1e-6, 1e-8]),
    "Zernike": ZernikeFreeform(0.02, 0.2, [0.0, 0.0, 0.0, 1e-3, 2e-3, -1e-3, 1e-3], 8.0),
    "spline": SplineFreeform(np.random.default_rng(3).normal(size=(5, 5)) * 0.02, [24.0, 24.0], 0.02, 0.0),
    "cubic": CubicAsphere(0.02, 1e-5),
}


def lens_of(shape, **options):
    front = surface(shape=shape, thickness=5.0, material=1.5)
    return optical_system(
        [front, surface(-60.0, thickness=55.0, stop=True)], aperture=10.0, fields=[0.0, (2.0, 5.0)], **options
    )


@pytest.mark.parametrize("name", SHAPES)
def test_any_shape_in_a_lens(name):
    """Points on the surface, Snell's law there, gradients of all parameters, writing and reading of files."""
    shape = SHAPES[name]
    lens = lens_of(shape)
    rays = launch(lens, "rings", 2)
    found = trace(lens, rays, until=0)
    assert bool(found.arrived.all())
    held = lens.surfaces[0].shape
    sag = held.sag(found.x, found.y)
    torch.testing.assert_close(sag.height, found.z, atol=1e-13, rtol=0)
    normal = torch.stack([-sag.slope_x, -sag.slope_y, torch.ones_like(sag.height)], -1)
    normal = normal / normal.square().sum(-1, keepdim=True).sqrt()
    before = torch.stack([value.expand(found.x.shape) for value in rays[3:]], -1)
    behind = torch.stack(list(trace(lens, rays)[3:6]), -1)
    inside = (before - (before * normal).sum(-1, keepdim=True) * normal) / 1.5
    root = (1 - inside.square().sum(-1, keepdim=True)).sqrt() * normal + inside
    again = optical_system([surface(-60.0, thickness=55.0, material=1.0)], aperture=10.0)
    start = torch.stack([torch.stack([found.x, found.y, found.z - 5.0], -1), root], -2).reshape(-1, 2, 3)
    numbers = again.prescription()
    numbers = numbers._replace(index=torch.tensor([[1.5, 1.0]], dtype=F64))
    second = trace(again, start, prescription=numbers)
    torch.testing.assert_close(torch.stack(second[3:6], -1).reshape(-1, 3), behind.reshape(-1, 3), atol=1e-13, rtol=0)
    copied = system_from_dict(system_to_dict(lens))
    assert torch.equal(trace_fields(copied).y, trace_fields(lens).y)
    assert "kind" in system_to_dict(lens)["surfaces"][0]["shape"]


@pytest.mark.parametrize("name", SHAPES)
def test_gradients_of_every_number_of_a_shape(name):
    lens = lens_of(SHAPES[name])
    held = lens.surfaces[0].own_shape
    names = [n for n, value in held.named_buffers() if value.numel() and n not in ("size", "radius")]
    parameters = [lens.surfaces[0].vary(n) for n in names]
    with torch.no_grad():
        rays = launch(lens, "random", 4)
    values = [p.detach().clone() for p in parameters]

    def loss(*given):
        shape = held.kind(**dict(zip(names, given, strict=True)), **dict(held.named_buffers()))
        numbers = lens.prescription()._replace(shapes=(shape, None))
        found = trace(lens, rays, prescription=numbers)
        return found.y.sum() + found.path.square().sum()

    inputs = [value.requires_grad_() for value in values]
    assert torch.autograd.gradcheck(loss, inputs, fast_mode=True)
    direct = trace(lens, rays)
    (direct.y.sum() + direct.path.square().sum()).backward()
    for p, expected in zip(parameters, torch.autograd.grad(loss(*inputs), inputs), strict=True):
        torch.testing.assert_close(p.grad, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("mirror", [False, True])
def test_fused_and_plain_paths_agree_for_every_shape_and_mode(mirror):
    """Numbers, gradients, statuses, batches of systems, single precision: with and without the fused kernel."""
    shapes = [(Conic(0.02, 0.0),), (Conic(-0.015, -0.7),), (EvenAsphere(0.01, 0.3, [1e-4, -2e-6]),), (Conic(0.0, 0.0),)]
    plain = {Conic: PlainConic, EvenAsphere: PlainAsphere}
    systems = []
    for kinds in ({}, plain):
        items = []
        for i, (shape,) in enumerate(shapes):
            kind = kinds.get(type(shape), type(shape))
            shape = kind(*shape.parameters())
            items.append(surface(shape=shape, thickness=4.0, material=1.5 if i % 2 == 0 else 1.2, semi_diameter=6.0))
        if mirror:
            shape = kinds.get(Conic, Conic)(-0.01, -1.0)
            items.append(surface(shape=shape, thickness=-30.0, material="mirror"))
        systems.append(optical_system([*items, surface(thickness=-20.0 if mirror else 20.0)], 11.0, fields=[0.0, 8.0]))
    results = []
    for system in systems:
        items = system.surfaces
        varied = [items[i].vary("curvature") for i in range(3)] + [items[2].vary("coefficients")]
        varied += [items[1].vary("conic"), items[0].vary("thickness"), items[2].vary("index")]
        rays = launch(system, "rings", 4)
        rays = type(rays)(*(value.detach().requires_grad_() for value in rays))
        length = sum(value.square() for value in rays[3:]).sqrt()
        found = trace(system, type(rays)(*rays[:3], *(value / length for value in rays[3:])))
        loss = torch.where(found.arrived, found.y, 0.0).square().sum() + found.path.nansum()
        gradients = torch.autograd.grad(loss, [*varied, *rays])
        narrow = trace(system, type(rays)(*(value.detach().float() for value in rays)))
        results.append((found, gradients, narrow))
    (a, ga, na), (b, gb, nb) = results
    assert torch.equal(a.status, b.status) and int(a.arrived.sum()) < a.status.numel()
    for one, other in zip(a[:7], b[:7], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-12, atol=1e-12, equal_nan=True)
    for one, other in zip(ga, gb, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(na.y, nb.y, atol=2e-5, rtol=0, equal_nan=True)


def test_a_fold_and_a_periscope():
    """A plane mirror at 45° sends the axis along y, a second one brings it back; lengths are those of the drawing."""
    turn = {"tilt": (45.0, 0.0, 0.0)}
    fold = optical_system(
        [
            surface(thickness=10.0),
            coordinate_break(**turn),
            surface(material="mirror"),
            coordinate_break(**turn, thickness=-20.0),
            coordinate_break(tilt=(-45.0, 0.0, 0.0)),
            surface(material="mirror"),
            coordinate_break(tilt=(-45.0, 0.0, 0.0), thickness=7.0),
        ],
        aperture=2.0,
        fields=[0.0],
    )
    rays = launch(fold, "y", 3)
    found = trace(fold, rays)
    torch.testing.assert_close(found.path, torch.full_like(found.path, 37.0), atol=1e-12, rtol=0)
    paths = ray_paths(fold, rays)[0, 0]
    chief = paths[1]
    expected = torch.tensor([[0, 0, 0], [0, 0, 10.0]], dtype=F64)
    torch.testing.assert_close(chief[[1, 3]], expected, atol=1e-12, rtol=0)
    side = torch.sign(chief[6, 1])
    torch.testing.assert_close(
        chief[6],
        torch.tensor([0.0, 20.0, 10.0], dtype=F64) * torch.stack([side * 0, side, side * side]),
        atol=1e-12,
        rtol=0,
    )
    torch.testing.assert_close(chief[-1][2], torch.tensor(17.0, dtype=F64), atol=1e-12, rtol=0)
    origins = fold.frames()[1]
    torch.testing.assert_close(origins[-1], chief[-1], atol=1e-12, rtol=0)
    copied = system_from_dict(system_to_dict(fold))
    assert torch.equal(trace(copied, rays).y, found.y)


def test_a_fold_without_breaks_is_refused():
    lens = optical_system([surface(material="mirror", tilt=(45.0, 0.0), thickness=-50.0)], aperture=2.0)
    with pytest.raises(ValueError, match="coordinate_break"):
        trace_fields(lens)


def test_orders_of_breaks_are_inverses_and_frames_return():
    """A break of order "tilt" with the signs changed undoes one of order "shift", as does a return to the frame."""
    move = {"shift": (1.0, -2.0), "tilt": (10.0, 20.0, 30.0)}
    back = {"shift": (-1.0, 2.0), "tilt": (-10.0, -20.0, -30.0), "order": "tilt"}
    for undo in (coordinate_break(**back), coordinate_break(return_to=0)):
        lens = optical_system(
            [surface(thickness=0.0), coordinate_break(**move), surface(), undo, surface(thickness=5.0)], aperture=2.0
        )
        rotation, origin = lens.frames()
        torch.testing.assert_close(rotation[-1], torch.eye(3, dtype=F64), atol=1e-14, rtol=0)
        torch.testing.assert_close(origin[-1], torch.tensor([0, 0, 5.0], dtype=F64), atol=1e-13, rtol=0)
        found = trace_fields(lens, "rings", 1)
        torch.testing.assert_close(found.path, torch.full_like(found.path, 5.0), atol=1e-12, rtol=0)


def test_gradients_of_breaks():
    lens = optical_system(
        [
            surface(40.0, thickness=5.0, material=1.5),
            coordinate_break((0.1, 0.2), (3.0, -2.0, 5.0), 4.0),
            surface(shape=Toroid(-0.02, -0.01), thickness=30.0),
        ],
        aperture=8.0,
    )
    rays = launch(lens, "random", 3)
    numbers = lens.prescription()

    def values(shift, tilt, thickness):
        found = trace(lens, rays, prescription=numbers._replace(shift=shift, tilt=tilt, thickness=thickness))
        return found.x, found.y, found.path

    inputs = [value.clone().requires_grad_() for value in (numbers.shift, numbers.tilt, numbers.thickness)]
    assert torch.autograd.gradcheck(values, inputs, fast_mode=True)
    assert torch.autograd.gradgradcheck(values, inputs, fast_mode=True)


def test_apertures():
    cases = {
        RectangularAperture(half_width=2.0, half_height=1.0): lambda x, y: (abs(x) <= 2) & (abs(y) <= 1),
        EllipticAperture(half_width=2.0, half_height=1.0): lambda x, y: (x / 2) ** 2 + y**2 <= 1,
        CircularAperture(radius=3.0, inner=1.0): lambda x, y: (x * x + y * y <= 9) & (x * x + y * y >= 1),
        CircularAperture((0.5, 0.0), True, 1.0): lambda x, y: (x - 0.5) ** 2 + y * y > 1,
        PolygonAperture(corners=((0, 2), (-2, -1), (2, -1))): lambda x, y: (y >= -1) & (abs(x) <= (2 - y) * 2 / 3),
    }
    x, y = torch.from_numpy(np.random.default_rng(0).uniform(-3, 3, (2, 500)))
    for aperture, expected in cases.items():
        lens = optical_system([surface(aperture=aperture, thickness=1.0)], aperture=6.0)
        ray = torch.stack([torch.stack([x, y, 0 * x], -1), torch.tensor([0, 0, 1.0], dtype=F64).expand(500, 3)], -2)
        status = trace(lens, ray).status.reshape(-1)
        assert torch.equal(status == 0, expected(x, y))
        assert set(status.tolist()) == {0, int(RayStatus.VIGNETTED)}
        assert bool(trace(lens, ray, vignetting=False).arrived.all())
        assert system_from_dict(system_to_dict(lens)).surfaces[0].apertures == lens.surfaces[0].apertures


@pytest.mark.parametrize("reflects", [False, True])
def test_gratings_obey_the_grating_equation(reflects):
    wavelength, frequency, order, index = 0.5e-3, 300.0, -2.0, 1.0 if reflects else 1.5
    grating = surface(
        phase=LinearGrating(0.0, frequency, order),
        material="mirror" if reflects else index,
        thickness=-10.0 if reflects else 10.0,
    )
    lens = optical_system([grating], aperture=1.0, wavelengths=wavelength)
    angles = torch.linspace(-0.3, 0.3, 7, dtype=F64)
    directions = torch.stack([0 * angles, angles.sin(), angles.cos()], -1)
    found = trace(lens, torch.stack([torch.zeros_like(directions), directions], -2))
    torch.testing.assert_close(
        found.v.reshape(-1) * index, angles.sin() + order * wavelength * frequency, atol=1e-14, rtol=0
    )
    assert bool((torch.sign(found.w) == (-1 if reflects else 1)).all())
    # Beyond 90 degrees there is no such order.
    grating = surface(phase=LinearGrating(0.0, 1900.0, 2.0), thickness=10.0)
    lost = trace(
        optical_system([grating], aperture=1.0, wavelengths=wavelength), torch.stack([0 * directions, directions], -2)
    )
    assert int(lost.status.max()) == RayStatus.TOTAL_INTERNAL_REFLECTION


def test_a_diffractive_lens_focuses_and_keeps_fermat():
    """A parabolic phase of focal length f: paraxially a lens; exactly, the paths of all rays agree at its focus."""
    f, wavelength = 100.0, 0.5e-3
    first = -np.pi / (wavelength * f)
    flat = surface(phase=RadialPhase([first], 1.0), thickness=f)
    lens = optical_system([flat], aperture=1.0, wavelengths=wavelength)
    assert float(first_order(lens).focal_length) == pytest.approx(f, rel=1e-12)
    assert float(rms_spot(lens)[0]) < 1e-4
    same = optical_system(
        [surface(phase=PolynomialPhase([0, 0, first, 0, first]), thickness=f)], 1.0, wavelengths=wavelength
    )
    torch.testing.assert_close(trace_fields(same).y, trace_fields(lens).y, atol=1e-13, rtol=0)
    # The exact phase of a stigmatic flat lens: −2π/λ·(√(r² + f²) − f), as its series.
    exact = [-2 * np.pi / wavelength * c for c in (0.5 / f, -1 / (8 * f**3), 1 / (16 * f**5), -5 / (128 * f**7))]
    lens = optical_system([surface(phase=RadialPhase(exact), thickness=f)], 12.0, wavelengths=wavelength)
    found = trace_fields(lens)
    assert float(found.y.abs().max()) < 1e-8
    # Along a ray, k·∂(path)/∂x = direction: the path's gradient is that of the wave (Malus).
    torch.testing.assert_close(found.path, torch.full_like(found.path, f), atol=1e-7, rtol=0)


def test_zernike_phases_are_polynomial_phases():
    root = 3**0.5
    zernike = surface(phase=ZernikePhase([0, 0, 0, 20.0], 5.0), thickness=50.0)
    radial = surface(phase=RadialPhase([2 * root * 20.0], 5.0), thickness=50.0)
    a, b = (trace_fields(optical_system([item], 8.0)) for item in (zernike, radial))
    torch.testing.assert_close(a.y, b.y, atol=1e-13, rtol=0)


def test_an_ideal_lens_has_no_aberrations():
    lens = optical_system([surface(phase=IdealLens(50.0), thickness=50.0)], 30.0, fields=[0.0, 20.0, (10.0, -15.0)])
    found = trace_fields(lens)
    torch.testing.assert_close(rms_spot(lens), torch.zeros(3, dtype=F64), atol=1e-12, rtol=0)
    torch.testing.assert_close(found.y[0, 1, 0], torch.tensor(50 * np.tan(np.radians(20)), dtype=F64))
    assert float(wavefront(lens).rms.max()) < 1e-6
    assert float(first_order(lens).focal_length) == pytest.approx(50.0)
    near = optical_system([surface(phase=IdealLens(50.0), thickness=150.0)], 10.0, object_distance=75.0, fields=[3.0])
    torch.testing.assert_close(trace_fields(near).y, torch.full((1, 1, 127), -6.0, dtype=F64), atol=1e-11, rtol=0)


def test_the_path_of_an_ideal_lens_from_its_focal_point():
    """Of a lens for distant objects (2f² + h²)/√(f² + h²) − f at the height h, h⁴/(4f³) more than on the axis."""
    f = 50.0
    lens = optical_system([surface(phase=IdealLens(f), thickness=30.0)], 0.2, "NA", object_distance=f)
    found = trace_fields(lens, "y", 5)
    h = found.y
    # That of a system is one for its own object.
    torch.testing.assert_close(found.path, torch.full_like(h, f + 30.0), atol=1e-11, rtol=0)
    distant = lens.prescription()._replace(phases=(IdealLens(torch.tensor(f, dtype=F64), torch.zeros((), dtype=F64)),))
    found = trace_fields(lens, "y", 5, prescription=distant)
    torch.testing.assert_close(found.path, (2 * f * f + h * h) / (f * f + h * h).sqrt() - f + 30.0, atol=1e-11, rtol=0)
    torch.testing.assert_close(found.path - 80.0, h**4 / (4 * f**3), atol=0, rtol=0.05)


@pytest.mark.parametrize("second", [None, -30.0, 70.0])
def test_ideal_lenses_are_stigmatic_at_conjugates_of_system(second):
    """Between an object and its image all paths are equal, behind another lens and a mirror too."""
    rows = [surface(phase=IdealLens(50.0), thickness=30.0)]
    rows += [] if second is None else [surface(phase=IdealLens(second), thickness=10.0)]
    for system in (
        optical_system(rows, 20.0, object_distance=100.0, fields=[0.0, 20.0], wavelengths=500e-6),
        optical_system([surface(-200.0, conic=-1.0, thickness=-60.0, material="mirror"), *rows[1:]], 20.0),
    ):
        system.surfaces[-1].thickness.fill_(float(first_order(system).image_distance))
        assert float(wavefront(system).path.abs().max()) < 1e-6
        assert float(rms_spot(system).max()) < 1e-10
    # Lagrange's point: 2f to 2f, at a numerical aperture where a lens for distant objects has 0.1 waves.
    system = optical_system([surface(phase=IdealLens(50.0), thickness=100.0)], 20.0, object_distance=100.0)
    assert float(wavefront(system).rms) < 1e-9


def test_a_ghost_is_two_reflections_traced_by_hand():
    """Two reflections inside a plate: three times its path; in a lens, the focus by explicit matrices."""
    plate = optical_system([surface(thickness=4.0, material=1.5), surface(thickness=10.0)], 2.0, fields=[0.0, 5.0])
    ghost = ghost_system(plate, 0, 1)
    found, direct = trace_fields(ghost, "y", 3), trace_fields(plate, "y", 3)
    inside = 4.0 / np.cos(np.arcsin(np.sin(np.radians(5.0)) / 1.5))
    expected = torch.full((1, 3), 2 * 1.5 * inside, dtype=F64)
    torch.testing.assert_close((found.path - direct.path)[:, 1], expected, atol=1e-12, rtol=0)
    c, n, t = 0.02, 1.6, 5.0
    for front in (1.0, 1.33):
        lens = [surface(1 / c, thickness=t, material=n), surface(-1 / c, thickness=40.0)]
        lens = optical_system(lens, 0.02, conjugates=Conjugates(object_material=front))
        y, u = 1.0, -(n - front) * c / n
        y, u = y + t * u, u
        # Reflected at the rear face, at the front face, then refracted: signed indices −n, n, 1.
        u, index = (n * u - (-n - n) * -c * y) / -n, -n
        y = y - t * u
        u = (index * u - (n - index) * c * y) / n
        y = y + t * u
        u = n * u - (1 - n) * -c * y
        ghost = ghost_system(lens, 0, 1)
        assert float(first_order(ghost).image_distance) == pytest.approx(-y / u, rel=1e-12)
        assert ghost.surfaces[0].stop and len(ghost.surfaces) == 4
    with pytest.raises(ValueError, match="first must be below second"):
        ghost_system(lens, 1, 0)


def test_surfaces_are_drawn_up_to_their_rims_or_the_rays():
    near, far = surface(50.0, thickness=2.0, material=1.5), surface(-50.0)
    stop = surface(aperture=CircularAperture(radius=3.0))
    rimmed = surface(40.0, material=1.5, semi_diameter=4.0)
    radii = drawn_radii([near, far, stop, rimmed, None], [1.0, 2.0, 9.0, 9.0, 10.0])
    assert radii == pytest.approx([2.1, 2.1, 3.0, 4.0, 10.5])
    assert drawn_radii([surface(), far, near], [0.0, 2.0, 1.0]) == pytest.approx([1.0, 2.1, 1.05])


@pytest.mark.parametrize(
    ("curvature", "coefficients", "height", "angle", "near"),
    [
        (-0.4194, (0.0, 0.10863, -0.03797, -0.0064), 0.7734, -56.034, 4.75),
        (0.44023, (0.0, -0.098535, 0.013387, 0.007559), 0.82778, 53.477, 5.25),
    ],
)
def test_rays_that_meet_the_base_conic_far_from_the_asphere(curvature, coefficients, height, angle, near):
    """The iteration from there diverges; the intersection is found by bisection in the plane x = 0."""
    y, z = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    shape = EvenAsphere(curvature, -1.0, coefficients)
    start, direction = np.asarray([[0.0, height - 5 * y, -5 * z]]), np.asarray([[0.0, y, z]])

    def above(t):
        place = start + t * direction
        return float(place[0, 2] - shape.sag(place[:, 0], place[:, 1]).height[0])

    expected = brentq(above, near - 0.1, near + 0.1, xtol=1e-14)
    assert abs(start[0, 1] + expected * y) < 1.2
    found, status = intersection(start, direction, shape, select="through")
    assert status.tolist() == [RayStatus.HIT]
    assert found.distance.tolist() == pytest.approx([expected], abs=1e-12)
    front = surface(curvature=curvature, conic=-1.0, coefficients=list(coefficients), stop=True)
    rays = Rays(*(torch.tensor([[[value]]], dtype=F64) for value in (*start[0], *direction[0])))
    traced = trace(optical_system([front], 2.0), rays, until=0)
    assert traced.y.item() == pytest.approx(start[0, 1] + expected * y, abs=1e-12)


def test_a_system_shows_its_surfaces_and_conditions():
    surfaces = [
        surface(50.0, conic=-1.5, coefficients=[0.0, 2e-6], thickness=4.0, material=1.5, semi_diameter=6.0, stop=True),
        surface(shape=Toroid(0.1, 0.2), phase=IdealLens(80.0), thickness=40.0, tilt=(1.0, 0.0)),
    ]
    lens = optical_system(surfaces, 0.1, "NA", fields=[0.0, (1.0, 2.0)], object_distance=30.0, name="bench")
    assert repr(lens).splitlines() == [
        "optical_system(",
        "  'bench'",
        "  lengths in mm",
        "  aperture=0.1 (NA)",
        "  fields=[0, (1, 2)] mm",
        "  wavelengths=[0.000587562] mm",
        "  object_distance=30 mm",
        "  (surfaces): Row(",
        "    (0): surface(radius=50, conic=-1.5, coefficients=[0, 2e-06], thickness=4, material=index 1.5, "
        "semi_diameter=6, stop=True)",
        "    (1): surface(shape=Toroid, thickness=40, material=air, phase=IdealLens, tilt=[1, 0])",
        "  )",
        ")",
    ]
