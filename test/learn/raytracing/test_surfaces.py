"""Surfaces given by their height: closed forms, NumPy against torch, first and second derivatives, misses."""

import numpy as np
import pytest
import torch

import odak.raytracing as core
from odak.learn import raytracing as rt
from odak.raytracing import surfaces
from odak.raytracing.intersections import RayStatus
from odak.tools import zernike_polynomial
from odak.tools.zernike import noll_to_nm, zernike_norm

F64 = torch.float64


def _surfaces(face):
    random = np.random.default_rng(7)
    spline = random.normal(size=(4, 4)) * 0.05
    return {
        "conic": face.Conic(0.1, -0.5),
        "even asphere": face.EvenAsphere(0.1, -0.5, [1e-3, -2e-3, 1e-4]),
        "toroid": face.Toroid(0.1, -0.05, -0.3, [1e-3, 2e-4]),
        "Zernike": face.ZernikeFreeform(0.05, 0.2, random.normal(size=7) * 1e-2, 3.0),
        "spline": face.SplineFreeform(spline, [8.0, 8.0], 0.05, 0.0),
        "odd asphere": face.OddAsphere(0.05, -0.3, [0.0, 1e-3, 2e-3, -1e-4]),
        "biconic": face.Biconic(0.1, -0.05, -0.5, 0.4),
        "polynomial": face.PolynomialFreeform(0.05, 0.1, random.normal(size=9) * 1e-2, 3.0),
        "Chebyshev": face.ChebyshevFreeform(0.05, 0.1, random.normal(size=(3, 4)) * 1e-2, [4.0, 4.0]),
        "Qbfs": face.QbfsAsphere(0.08, [1e-2, -2e-2, 1e-2, 5e-3], 4.0),
        "Qcon": face.QconAsphere(0.08, -0.4, [1e-2, -2e-2, 1e-2], 4.0),
    }


NAMES = list(_surfaces(core))
# The others differ from these in their heights only, the gradients of which are tested for each.
QUICK = [pytest.param(name, marks=pytest.mark.slow if name in NAMES[3:] else ()) for name in NAMES]
START = np.asarray([[0.1, 0.2, -5], [1.0, -0.3, -4], [0.4, 0.5, -3], [50, 50, -3]])
AIM = np.asarray([[0.3, -0.2, 0], [1.2, 0.4, 0], [-0.2, 0.8, 0], [150, 50, -3]])


def as_tensors(surface, grad=True):
    return [torch.as_tensor(p, dtype=F64).clone().requires_grad_(grad) for p in surface.parameters()]


@pytest.mark.parametrize("name", NAMES)
def test_hits_lie_on_the_surface_and_faces_agree(name):
    surface = _surfaces(core)[name]
    rays = core.create_ray_from_two_points(START, AIM)
    hit = core.intersect_w_sag(rays, surface)
    assert [RayStatus(s).name for s in hit.status] == ["HIT"] * 3 + ["MISS"]
    assert np.isnan(hit.distance[3]) and np.isnan(hit.point[3]).all() and np.isnan(hit.normal[3]).all()
    point = hit.point[:3]
    held = type(surface)(*map(np.asarray, surface.parameters()))
    np.testing.assert_allclose(held.sag(point[:, 0], point[:, 1]).height, point[:, 2], atol=2e-15)
    np.testing.assert_allclose(np.linalg.norm(hit.normal[:3], axis=-1), 1)
    twin = rt.intersect_w_sag(torch.from_numpy(rays), surface)
    for a, b in zip(hit, twin, strict=True):
        np.testing.assert_allclose(b.numpy(), a, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("name", NAMES)
def test_gradients_are_the_derivatives_of_the_height(name, random):
    surface = _surfaces(rt)[name]
    x, y = (torch.from_numpy(v).requires_grad_() for v in random.uniform(-1.5, 1.5, (2, 20)))
    values = type(surface)(*as_tensors(surface)).sag(x, y)
    slopes = torch.autograd.grad(values.height.sum(), (x, y))
    np.testing.assert_allclose(values.slope_x.detach(), slopes[0], atol=1e-13)
    np.testing.assert_allclose(values.slope_y.detach(), slopes[1], atol=1e-13)


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch's own, in forward mode
@pytest.mark.parametrize("name", QUICK)
def test_gradients_of_rays_and_parameters(name):
    surface = _surfaces(rt)[name]
    kind, parameters = type(surface), as_tensors(surface)
    rays = torch.from_numpy(core.create_ray_from_two_points(START, AIM)).requires_grad_()

    def values(ray, *theta):
        hit = rt.intersect_w_sag(ray, kind(*theta))
        return hit.distance.nan_to_num(), hit.normal.nan_to_num()

    arguments = (rays, *parameters)
    assert torch.autograd.gradcheck(values, arguments, check_forward_ad=name in NAMES[:2], fast_mode=True)


@pytest.mark.parametrize("name", QUICK)
def test_second_derivatives(name):
    surface = _surfaces(rt)[name]
    rays = torch.from_numpy(core.create_ray_from_two_points(START[2:], AIM[2:])).requires_grad_()

    def distance(ray, *theta):
        return rt.intersect_w_sag(ray, type(surface)(*theta)).distance.nan_to_num()

    assert torch.autograd.gradgradcheck(distance, (rays, *as_tensors(surface)), fast_mode=True)


@pytest.mark.parametrize("name", NAMES)
def test_missed_rays_have_no_gradient(name):
    surface = _surfaces(rt)[name]
    parameters = as_tensors(surface)
    rays = torch.from_numpy(core.create_ray_from_two_points(START, AIM)).requires_grad_()
    hit = rt.intersect_w_sag(rays, type(surface)(*parameters))
    (hit.distance.nansum() + hit.normal.nansum()).backward()
    assert all(p.grad.isfinite().all() for p in (rays, *parameters))
    assert (rays.grad[3] == 0).all()


def test_placement_is_differentiable():
    center, angles = (torch.tensor(v, dtype=F64, requires_grad=True) for v in ([0.1, 0.2, 3.0], [5.0, -8.0, 20.0]))
    rays = torch.from_numpy(core.create_ray_from_two_points(START[:3], AIM[:3]))
    surface = _surfaces(rt)["toroid"]
    assert torch.autograd.gradcheck(
        lambda c, a: rt.intersect_w_sag(rays, surface, c, a)[:3], (center, angles), fast_mode=True
    )
    hit = core.intersect_w_sag(rays.numpy(), surface, [0.1, 0.2, 3.0], [5.0, -8.0, 20.0])
    np.testing.assert_allclose(hit.point, rt.intersect_w_sag(rays, surface, center, angles).point.detach(), atol=1e-14)


def test_conic_is_the_sphere_and_the_paraboloid(random):
    rays = core.create_ray_from_two_points(random.normal(size=(50, 3)) - [0, 0, 30], random.normal(size=(50, 3)))
    hit = core.intersect_w_sag(rays, core.Conic(0.1, 0.0))
    np.testing.assert_allclose(hit.distance, core.intersect_w_sphere(rays, [0, 0, 10, 10])[1], rtol=1e-12)
    np.testing.assert_allclose(hit.normal[:, 2] > 0, True)
    # Parallel light on a paraboloid of vertex curvature c meets at 1/(2c).
    x = np.linspace(-8, 8, 9)
    mirror = core.create_ray(np.stack((x, 0 * x, 0 * x - 20), -1), [90, 90, 0])
    hit = core.intersect_w_sag(mirror, core.Conic(-0.05, -1.0))
    back = core.reflect(mirror, np.stack((hit.point, hit.normal), axis=1))
    focus = core.propagate_a_ray(back, (-10 - hit.point[:, 2]) / back[:, 1, 2])[:, 0]
    np.testing.assert_allclose(focus, np.tile([0, 0, -10], (9, 1)), atol=1e-12)


def test_newton_finds_what_the_closed_form_finds(random):
    rays = core.create_ray_from_two_points(
        random.normal(size=(200, 3)) * 2 - [0, 0, 9], random.normal(size=(200, 3)) * 2
    )
    for curvature, conic in ((0.15, 0.0), (-0.1, -1.0), (0.2, -3.0), (0.0, 0.0)):
        exact = core.intersect_w_sag(rays, core.Conic(curvature, conic))
        solved = core.intersect_w_sag(rays, core.EvenAsphere(curvature, conic, [0.0]))
        np.testing.assert_array_equal(solved.status == 0, exact.status == 0)
        np.testing.assert_allclose(solved.distance, exact.distance, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_many_rays_all_converge(name, dtype, random):
    start = np.concatenate((random.uniform(-2, 2, (3000, 2)), np.full((3000, 1), -5.0)), axis=1)
    rays = core.create_ray_from_two_points(start, start * [0.5, 0.5, 0] + random.normal(size=(3000, 3)) * 0.2)
    hit = core.intersect_w_sag(rays.astype(dtype), _surfaces(core)[name])
    assert (hit.status == 0).all() and hit.distance.dtype == dtype


@pytest.mark.parametrize("batch", [(), (1, 1), (2, 1)])
@pytest.mark.parametrize("name", QUICK[1:])
def test_the_iteration_is_the_same_by_numpy_and_by_torch(name, batch, random):
    """Few tensors are iterated by NumPy, which sets rays aside that are done; the shape of a user by torch."""
    surface = _surfaces(core)[name]
    kind = type(surface)
    values = [torch.as_tensor(value, dtype=F64) for value in surface.parameters()]
    if "size" not in kind.ranks:
        values = [
            value.expand((*batch, *value.shape[value.ndim - rank :])).contiguous()
            for value, rank in zip(values, kind.ranks_of_parameters(), strict=True)
        ]
    start = torch.from_numpy(random.normal(size=(5000, 3)) * 3.0 - np.asarray([0.0, 0.0, 5.0])).unbind(-1)
    aim = torch.from_numpy(random.normal(size=(5000, 3)) * [0.3, 0.3, 0.0] + [0.0, 0.0, 1.0]).unbind(-1)
    found, states = surfaces.intersection(start, aim, kind(*values))
    own, same = surfaces.intersection(start, aim, type("Own", (kind,), {"__module__": __name__})(*values))
    assert found.distance.shape == own.distance.shape and found.distance.dtype == own.distance.dtype
    assert torch.equal(states, same) and 0 < int((states == 0).sum()) < states.numel()
    torch.testing.assert_close(found.distance, own.distance, rtol=1e-11, atol=1e-11, equal_nan=True)


def test_heights_whose_terms_cancel_are_met():
    """Every ray ends at the rounding of the terms, far above that of the height: 1 + T14(r/25), terms of 1e5."""
    powers = np.polynomial.chebyshev.cheb2poly([0.0] * 14 + [1.0])[2::2]
    shape = core.EvenAsphere(0.0, 0.0, powers * 25.0 ** -np.arange(2.0, 15.0, 2.0))
    start = np.stack([np.linspace(-26, -20, 301), np.full(301, 0.3), np.full(301, -5.0)], -1)
    rays = np.stack([start, np.broadcast_to([0.1, 0.02, 1.0], start.shape)], -2)
    for hit in (core.intersect_w_sag(rays, shape), rt.intersect_w_sag(torch.as_tensor(rays), shape)):
        x, y, z = np.asarray(hit.point).T
        assert (np.asarray(hit.status) == 0).all()
        height = 1 + np.polynomial.chebyshev.chebval(np.hypot(x, y) / 25, [0.0] * 14 + [1.0])
        np.testing.assert_allclose(z, height, rtol=0, atol=1e-9)


def test_statuses():
    ray = [[[0, 0, -5], [0, 0, 1]], [[3, 0, -5], [0, 0, 1]], [[0, 0, 5], [0, 0, 1]], [[11, 0, -5], [0, 0, 1]]]
    for surface in (core.Conic(0.1), core.EvenAsphere(0.1, 0.0, [0.0])):
        hit = core.intersect_w_sag(ray, surface, aperture=2.0)
        assert [RayStatus(s).name for s in hit.status] == ["HIT", "VIGNETTED", "MISS", "MISS"]
        assert np.isfinite(hit.distance).tolist() == [True, False, False, False]
        behind = core.intersect_w_sag(ray, surface, ahead=False)
        np.testing.assert_allclose(behind.distance[[0, 2]], [5, -5])
    spline = core.SplineFreeform(np.zeros((3, 3)), [4.0, 4.0])
    hit = core.intersect_w_sag(ray, spline)
    assert [RayStatus(s).name for s in hit.status] == ["HIT", "VIGNETTED", "MISS", "VIGNETTED"]
    start, direction = ([np.asarray([v]) for v in value] for value in ((1.0, 0, -5), (0, 0, 1.0)))
    _, found, crossed = surfaces.newton(
        tuple(start), tuple(direction), core.EvenAsphere(0.1, 0.0, (0.01,)), np.zeros(1), limit=1
    )
    assert not found.any() and not crossed.any()


def test_a_start_on_the_surface_is_not_a_hit(random):
    start = random.uniform(-3, 3, (300, 3)) - [0, 0, 8]
    direction = random.normal(size=(300, 3)) * [0.1, 0.1, 0] + [0, 0, 1]
    for surface in (core.Conic(-0.1), core.Conic(-0.1, -1.0), core.EvenAsphere(-0.1, 0.0, [0.0])):
        first = core.intersect_w_sag(np.stack((start, direction), axis=1), surface, aperture=9.0)
        assert (first.status == 0).all()
        again = core.intersect_w_sag(np.stack((first.point, direction), axis=1), surface, aperture=9.0)
        assert (again.status == RayStatus.MISS).all()


@pytest.mark.parametrize("face", [core, rt])
def test_chords_of_a_sphere_meet_the_half_that_is_the_surface(face, random):
    """Rays start on either half of a sphere of radius 10 and end on the half that is the conic, or on the other."""
    ends = random.normal(size=(2, 500, 3))
    ends = 10 * (ends / np.linalg.norm(ends, axis=-1, keepdims=True) + [0.0, 0.0, 1.0])
    rays = core.create_ray_from_two_points(*ends)
    given = rays if face is core else torch.from_numpy(rays)
    hit = face.intersect_w_sag(given, face.Conic(0.1), aperture=10.0 + 1e-9)
    np.testing.assert_array_equal(np.asarray(hit.status) == RayStatus.HIT, ends[1][:, 2] < 10)
    met = ends[1][:, 2] < 10
    np.testing.assert_allclose(np.asarray(hit.point)[met], ends[1][met], atol=1e-12)


def test_zernike_sag_is_the_polynomials(random):
    x, y = random.uniform(-1.4, 1.4, (2, 30))
    coefficients = random.normal(size=22)
    value = surfaces.zernike_sag(x, y, 0.0, 0.0, coefficients, 2.0).height
    expected = 0
    for j, c in enumerate(coefficients, start=1):
        n, m = noll_to_nm(j)
        expected = expected + c * zernike_norm(n, m) * zernike_polynomial(n, m, np.hypot(x, y) / 2, np.arctan2(y, x))
    np.testing.assert_allclose(value, expected, atol=1e-12)


def test_spline_sag_is_scipys(random):
    from scipy.interpolate import BSpline

    control = random.normal(size=(7, 6))
    x, y = random.uniform(-1, 1, 40), random.uniform(-2, 2, 40)
    padded = np.pad(control, 1, mode="edge")
    basis = []
    for value, n, extent in ((x, 7, 2.0), (y, 6, 4.0)):
        knots = np.arange(-3, n + 3)
        place = (value / extent + 0.5) * (n - 1)
        basis.append(BSpline(knots, np.eye(n + 2), 3, extrapolate=False)(place))
    expected = np.einsum("ki,ij,kj->k", basis[0], padded, basis[1])
    np.testing.assert_allclose(surfaces.SplineFreeform(control, (2.0, 4.0)).sag(x, y).height, expected, atol=1e-13)


def test_toroid_contains_the_torus(random):
    # A circle of radius 4 in y about z = 4, turned about the axis z = 10.
    x, y = random.uniform(-2, 2, (2, 20))
    z = surfaces.Toroid(0.1, 0.25).sag(x, y).height
    across = np.hypot(x, 10 - z) - 6
    np.testing.assert_allclose(np.hypot(across, y), 4, rtol=1e-13)


def test_surfaces_without_coefficients():
    ray = torch.tensor([[0.3, 0.2, -5.0], [0.1, -0.05, 1.0]], dtype=F64)
    for surface in (core.Toroid(0.1, 0.05), core.EvenAsphere(0.1), core.EvenAsphere(0.1, 0.0, [])):
        found = rt.intersect_w_sag(ray, surface).distance.item()
        assert found == pytest.approx(float(core.intersect_w_sag(ray.numpy(), surface).distance), rel=1e-12)


def test_tangent_ray_leaves_derivatives_of_others_unchanged():
    rays = torch.tensor([[[0, -20.0, 0], [0, 1.0, 0]], [[0, 1.0, -5], [0, 0, 1.0]]], dtype=F64)
    curvature = torch.tensor(0.1, dtype=F64, requires_grad=True)
    rt.intersect_w_sag(rays, core.Conic(curvature)).distance[1].backward()
    together, curvature.grad = curvature.grad, None
    rt.intersect_w_sag(rays[1], core.Conic(curvature)).distance.backward()
    assert together.item() == pytest.approx(curvature.grad.item())


def test_forbes_polynomials_are_the_published_ones():
    """Q_0 … Q_2 of the slope-orthogonal set (Forbes 2007, eq. 2.13), and the norm by which they are orthogonal."""
    v = np.linspace(0, 1, 11)
    expected = (1 + 0 * v, (13 - 16 * v) / 19**0.5, (2 / 95) ** 0.5 * (29 - 4 * v * (25 - 19 * v)))
    for m, polynomial in enumerate(expected):
        np.testing.assert_allclose(surfaces._qbfs(v, [0.0] * m + [1.0])[0], polynomial, atol=1e-13)
    # Slopes of u²(1 − u²)Q_m(u²), weighted by 1/√(u²(1 − u²))/u... on the disc: ⟨S_m S_n⟩ = δ.
    nodes = 400
    theta = (np.arange(nodes) + 0.5) * np.pi / nodes
    u = (1 + np.cos(theta)) / 2
    # ∫ f(u) du/√(1 − u²) over 0 … 1 by the substitution u = sin a.
    a = (np.arange(nodes) + 0.5) * (np.pi / 2 / nodes)
    u = np.sin(a)
    slopes = []
    for m in range(5):
        q, dq = surfaces._qbfs(u * u, [0.0] * m + [1.0])
        slopes.append((2 * u - 4 * u**3) * q + (u**2 - u**4) * dq * 2 * u)
    gram = np.asarray([[np.mean(s * t / 1.0) for s in slopes] for t in slopes])
    assert np.abs(gram - np.diag(np.diag(gram))).max() < 1e-10
    np.testing.assert_allclose(np.diag(gram), gram[0, 0], rtol=1e-10)


def test_special_cases_of_the_freeforms_are_conics(random):
    x, y = random.uniform(-2, 2, (2, 50))
    sphere = core.Conic(0.1, -0.4).sag(x, y)
    for shape in (
        core.Biconic(0.1, 0.1, -0.4, -0.4),
        core.OddAsphere(0.1, -0.4, [0.0, 0.0]),
        core.PolynomialFreeform(0.1, -0.4, [0.0] * 5, 2.0),
        core.QconAsphere(0.1, -0.4, [0.0], 3.0),
        core.ChebyshevFreeform(0.1, -0.4, [[0.0]], [4.0, 4.0]),
    ):
        for a, b in zip(shape.sag(x, y), sphere, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-15)
    # T_2(x/A) = 2x²/A² − 1, x²/R²: one surface in two forms.
    chebyshev = core.ChebyshevFreeform(0.0, 0.0, np.asarray([[0.1, 0.0], [0.0, 0.0], [0.1, 0.0]]), [4.0, 4.0])
    polynomial = core.PolynomialFreeform(0.0, 0.0, [0.0, 0.0, 0.2], 4.0)
    np.testing.assert_allclose(chebyshev.sag(x, y).height, polynomial.sag(x, y).height, atol=1e-14)
    np.testing.assert_allclose(chebyshev.curvatures(), polynomial.curvatures(), atol=1e-8)


def test_a_grid_of_heights_is_interpolated(random):
    heights = random.normal(size=(6, 5))
    grid = core.SplineFreeform.through(heights, [10.0, 8.0])
    x, y = np.meshgrid(np.linspace(-5, 5, 6), np.linspace(-4, 4, 5), indexing="ij")
    np.testing.assert_allclose(grid.sag(x, y).height, heights, atol=1e-12)
