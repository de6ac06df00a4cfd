"""The fused kernel against plain torch operations, the array core, closed forms; statuses, gradients, memory."""

import math

import numpy as np
import pytest
import torch

from odak.catalog.materials import OpticalMaterial
from odak.learn.raytracing.system import Rays, fused, launch, load_system, optical_system, surface, trace, trace_fields
from odak.learn.raytracing.system.fused import Trace, plain
from odak.learn.raytracing.system.sequence import Layout, Numbers
from odak.raytracing import Conic, EvenAsphere, Plane, RayStatus, interfaces, surfaces
from odak.raytracing.interfaces import RadialPhase
from odak.raytracing.surfaces import OddAsphere

F64 = torch.float64
LAYOUT = Layout(
    (Conic, Conic, EvenAsphere, Plane, Conic, EvenAsphere, Plane),
    ("refract", "refract", "refract", "pass", "reflect", "reflect", "pass"),
    (1, 1, 1, 1, 1, -1, 1),
    (None,) * 7,
    (None,) * 7,
    (None,) * 7,
)


@pytest.fixture
def batch():
    """Return random rays ``[2, 5]`` and two systems with every kind of surface and action."""
    torch.manual_seed(1)
    numbers = Numbers(
        torch.tensor([[0.02, -0.015, 0.01, 0.0, -0.01, 0.02, 0.0]], dtype=F64)
        * torch.tensor([[1.0], [1.05]], dtype=F64),
        torch.tensor([[0.0, -0.6, 0.4, 0.0, -1.0, 0.3, 0.0]], dtype=F64).repeat(2, 1),
        torch.tensor([[5.0, 4.0, 3.0, 2.0, 6.0, -7.0, 5.0]], dtype=F64).repeat(2, 1),
        torch.zeros(2, 7, 2, dtype=F64),
        torch.tensor([[1.0, 1.5, 1.2, 1.6, 1.6, 1.6, 1.6, 1.6]], dtype=F64).repeat(2, 1),
    )
    numbers.coefficients[:, 2] = torch.tensor([1e-4, -2e-6])
    numbers.coefficients[:, 5] = torch.tensor([-3e-4, 1e-6])
    x, y = (torch.rand(2, 2, 5, dtype=F64) - 0.5) * 8
    u, v = (torch.rand(2, 2, 5, dtype=F64) - 0.5) * 0.1
    return numbers, (x, y, torch.zeros_like(x), u, v, (1 - u * u - v * v).sqrt())


def unit(rays):
    length = sum(value.square() for value in rays[3:]).sqrt()
    return (*rays[:3], *(value / length for value in rays[3:]))


@pytest.mark.parametrize("many", [1, 10**6], ids=["floats", "broadcast"])
def test_fused_kernel_agrees_with_plain_operations(batch, many, monkeypatch):
    monkeypatch.setattr(fused, "MANY", many)
    numbers, rays = batch
    inputs = [value.clone().requires_grad_() for value in (*rays, *numbers[:5])]
    ours = Trace.apply(LAYOUT, *unit(inputs[:6]), *inputs[6:])
    plainly = plain(LAYOUT, Numbers(*inputs[6:]), unit(inputs[:6]))
    for a, b in zip(ours, plainly, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-13, atol=1e-13)
    weights = [torch.rand_like(value) for value in ours[:7]]
    gradients = [
        torch.autograd.grad(sum((a * b).sum() for a, b in zip(out[:7], weights, strict=True)), inputs)
        for out in (ours, plainly)
    ]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("many", [1, 10**6], ids=["floats", "broadcast"])
def test_the_fused_kernel_takes_rays_from_beside_and_behind(many, monkeypatch):
    """Rays at 60 to 100 degrees onto a dome, without the plain operations: points, paths and gradients as by these."""
    monkeypatch.setattr(fused, "MANY", many)
    layout = LAYOUT.first(2)
    numbers = Numbers(
        torch.tensor([[1 / 30, 1 / 60]], dtype=F64),
        torch.tensor([[-0.2, 0.1]], dtype=F64),
        torch.tensor([[1.0, 2.0]], dtype=F64),
        torch.zeros(1, 2, 0, dtype=F64),
        torch.tensor([[1.0, 1.8, 1.0]], dtype=F64),
    )
    angle = torch.linspace(60, 100, 9, dtype=F64).deg2rad()
    turn = torch.linspace(0.1, 0.3, 9, dtype=F64)
    ways = (angle.sin() * turn.sin(), angle.sin() * turn.cos(), angle.cos())
    # Through points near the second vertex, from 50 in front of them.
    starts = (0.1 - 50 * ways[0], -10.0 - 50 * ways[1], 2.5 - 50 * ways[2])
    rays = tuple(value[None] for value in (*starts, *ways))
    inputs = [value.clone().requires_grad_() for value in (*rays, *numbers[:5])]
    expected = plain(layout, Numbers(*inputs[6:]), unit(inputs[:6]))
    monkeypatch.setattr(fused, "plain", None)
    found = Trace.apply(layout, *unit(inputs[:6]), *inputs[6:])
    assert not bool(found[7].any()) and float(rays[5].min()) < -0.17
    for a, b in zip(found, expected, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=1e-12)
    wanted = [*inputs[:9], inputs[10]]
    gradients = [
        torch.autograd.grad(sum(((i + 1) * out[i]).sum() for i in range(7)), wanted) for out in (found, expected)
    ]
    for a, b in zip(*gradients, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-11, atol=1e-11)


@pytest.mark.slow
def test_gradients_of_rays_and_all_numbers(batch):
    numbers, rays = batch
    inputs = [value[:1].clone().requires_grad_() for value in (*rays, *numbers[:5])]

    def values(*given):
        return Trace.apply(LAYOUT, *unit(given[:6]), *given[6:])[:7]

    assert torch.autograd.gradcheck(values, inputs, fast_mode=True)
    few = [value[:, :2] if i < 6 else value for i, value in enumerate(inputs)]
    few = [value.detach().requires_grad_() for value in few]

    def weighted(*given):
        parts = torch.stack(values(*given))
        return (parts * torch.linspace(1, 2, parts.numel(), dtype=parts.dtype).reshape(parts.shape)).sum()

    assert torch.autograd.gradgradcheck(weighted, few, fast_mode=True)


def test_transforms_of_torch_func_agree_with_autograd():
    system = load_system("cooke_triplet")
    rays, numbers = launch(system, "rings", 1), system.prescription()

    def size(curvature):
        return trace(system, rays, prescription=numbers._replace(curvature=curvature)).y.square().sum()

    reverse = torch.func.grad(size)(numbers.curvature)
    held = numbers.curvature.clone().requires_grad_()
    (direct,) = torch.autograd.grad(size(held), held)
    torch.testing.assert_close(reverse, direct, rtol=1e-11, atol=1e-11)
    two = torch.stack([numbers.curvature, 1.01 * numbers.curvature])
    torch.testing.assert_close(torch.func.vmap(size)(two), torch.stack([size(value) for value in two]))


def test_steps_agree_with_the_array_core():
    """Spheres, conics and aspheres, step by step, with `odak.raytracing`."""
    shapes = [(0.02, 0.0, ()), (-0.01, -0.7, ()), (0.015, 0.2, (1e-4, -1e-6))]
    indices, gap = [1.0, 1.6, 1.3, 1.0], 3.0
    system = optical_system(
        [
            surface(curvature=c, conic=k, coefficients=a, thickness=gap, material=n)
            for (c, k, a), n in zip(shapes, indices[1:], strict=True)
        ],
        aperture=10.0,
    )
    rays = launch(system, "rings", 2, fields=[(3.0, 5.0)])
    traced = trace(system, rays)
    point, direction = (value.numpy().reshape(-1, 3) for value in rays.to_tensor().unbind(-2))
    path = 0.0
    for (c, k, a), before, behind in zip(shapes, indices, indices[1:], strict=False):
        shape = surfaces.EvenAsphere(np.asarray(c), np.asarray(k), np.asarray(a or (0.0,)))
        with np.errstate(all="ignore"):
            hit, status = surfaces.intersection(point, direction, shape, None, "through")
        distance = hit.distance
        assert (np.asarray(status) == 0).all()
        point = point + distance[:, None] * direction
        path = path + before * distance
        slopes = shape.sag(point[:, 0], point[:, 1])
        normal = np.stack([-slopes.slope_x, -slopes.slope_y, np.ones_like(distance)], -1)
        direction, _ = interfaces.refract_directions(direction, normal, before, behind)
        point = point - [0, 0, gap]
    last = -point[:, 2] / direction[:, 2]
    point, path = point + last[:, None] * direction, path + indices[-1] * last
    np.testing.assert_allclose(torch.stack(traced[:2], -1).reshape(-1, 2), point[:, :2], atol=1e-12)
    np.testing.assert_allclose(torch.stack(traced[3:6], -1).reshape(-1, 3), direction, atol=1e-13)
    np.testing.assert_allclose(traced.path.reshape(-1), path, atol=1e-12)


def ray(*pairs):
    return torch.tensor(pairs, dtype=F64)


def test_statuses_say_what_befell_a_ray_first():
    ball = optical_system(
        [surface(5.0, thickness=6.0, material=3.0, semi_diameter=4.6), surface(thickness=5.0)], aperture=2.0
    )
    up = [0.0, 0.0, 1.0]
    steep = [0.0, math.sin(0.9), math.cos(0.9)]
    cases = ray(
        [[0, 0, 0], up],
        [[0, 6, 0], up],
        [[0, 4.8, 0], up],
        [[0, -4.5, 0], up],
        [[0, 0, 0], steep],
        [[0, 0, 0], [0, 0, -1.0]],
        [[0, 0, 0], [0, 0, 0.0]],
        [[math.nan, 0, 0], up],
    )
    traced = trace(ball, cases)
    names = [RayStatus(int(value)).name for value in traced.status.reshape(-1)]
    lost = ["MISS"] * 3
    assert names == ["HIT", "MISS", "VIGNETTED", "TOTAL_INTERNAL_REFLECTION", "HIT", *lost]
    for value in traced[:7]:
        assert value.isfinite().reshape(-1).tolist() == [name == "HIT" for name in names]
    # Again in two forms: with the plain operations for every block, and alone.
    for i in range(len(cases)):
        assert int(trace(ball, cases[i]).status) == int(traced.status.reshape(-1)[i])
    free = trace(ball, cases, vignetting=False)
    assert int(free.status.reshape(-1)[2]) == RayStatus.TOTAL_INTERNAL_REFLECTION


@pytest.mark.parametrize("systems", [1, 2])
@pytest.mark.parametrize("side", [1, -1])
def test_the_other_half_of_a_sphere_is_no_part_of_the_surface(systems, side):
    """A ray inside the sphere that leaves it, both ways, on the half that is turned away from the vertex."""
    ball = optical_system([surface(-5.0 * side, material=1.2)], aperture=1.0)
    numbers = ball.prescription()
    numbers = numbers._replace(curvature=numbers.curvature * torch.ones(systems, 1, dtype=F64))
    middle, back = -5.0 * side, -2.0 * side
    steep, flat = math.sqrt(1 - 0.312**2), 0.312
    rays = ray([[0, 4 * side, middle + back], [0, steep, flat]], [[0, 0, middle + back], [0, 0, 1]])
    status = trace(ball, rays, prescription=numbers).status
    assert status[:, 0, 0].tolist() == [[RayStatus.MISS, RayStatus.HIT]] * systems


def test_an_asphere_that_runs_away_is_reported_and_never_wrong():
    wild = optical_system([surface(20.0, coefficients=[0.0, 0.5], thickness=5.0, material=1.5)], aperture=2.0)
    y = torch.linspace(-4, 4, 41, dtype=F64)
    slant = torch.stack(
        [torch.zeros(41, dtype=F64), torch.full((41,), 0.6, dtype=F64), torch.full((41,), 0.8, dtype=F64)], -1
    )
    cases = torch.stack([torch.stack([0 * y, y, 0 * y], -1), slant], -2)
    traced = trace(wild, cases, until=0)
    kept = traced.arrived.reshape(-1)
    assert 0 < int(kept.sum()) < 41
    assert set(traced.status.reshape(-1)[~kept].tolist()) <= {RayStatus.MISS, RayStatus.NOT_CONVERGED}
    squared = (traced.x.square() + traced.y.square()).reshape(-1)[kept]
    height = squared / 20 / (1 + (1 - squared / 400).sqrt()) + 0.5 * squared**2
    torch.testing.assert_close(traced.z.reshape(-1)[kept], height, atol=1e-11, rtol=0)


@pytest.mark.parametrize("plain", [False, True])
def test_lost_rays_send_no_nan_into_gradients(plain):
    ball = optical_system([surface(5.0, thickness=6.0, material=1.6), surface(thickness=5.0)], aperture=2.0)
    if plain:
        ball.vary(tilt=1)
    curvature = ball.vary(curvature=0)[0]
    up = [0.0, 0.0, 1.0]
    rays = ray([[0, 0, 0], up], [[0, 6, 0], up], [[0, -4.9, 0], up], [[0, 1, 0], up]).requires_grad_()
    traced = trace(ball, rays)
    loss = torch.where(traced.arrived, traced.y, 0.0).square().sum()
    found, of_rays = torch.autograd.grad(loss, (curvature, rays), create_graph=True)
    assert bool(found.isfinite()) and bool(of_rays.isfinite().all())
    assert float(found.detach().abs()) > 0 and not bool(of_rays[1:3].any())
    (second,) = torch.autograd.grad(found, curvature)
    assert bool(second.isfinite())


def test_light_runs_back_the_way_it_came():
    system = load_system("double_gauss")
    traced = trace_fields(system, "rings", 3, vignetting=False)
    radii = [item.radius for item in system.surfaces][::-1]
    gaps = [float(item.thickness) for item in system.surfaces][::-1]
    media = ["air", *(item.material for item in system.surfaces)][::-1]
    back = optical_system(
        [surface(-r, thickness=t, material=m) for r, t, m in zip(radii, [*gaps[1:], 0.0], media[1:], strict=True)],
        aperture=50.0,
        wavelengths=system.wavelengths,
    )
    start = Rays(traced.x, traced.y, torch.full_like(traced.x, -gaps[0]), -traced.u, -traced.v, traced.w)
    returned = trace(back, start)
    rays = launch(system, "rings", 3)
    torch.testing.assert_close(returned.x, rays.x.expand_as(returned.x), atol=1e-11, rtol=0)
    torch.testing.assert_close(returned.y, rays.y.expand_as(returned.y), atol=1e-11, rtol=0)
    torch.testing.assert_close(-returned.v, rays.v.expand_as(returned.v), atol=1e-12, rtol=0)
    torch.testing.assert_close(returned.path, traced.path, atol=1e-10, rtol=0)


def test_turning_the_rays_about_the_axis_turns_the_image():
    system = load_system("cooke_triplet")
    rays = launch(system, "rings", 2)
    c, s = math.cos(0.7), math.sin(0.7)
    turned = rays._replace(
        x=c * rays.x - s * rays.y, y=s * rays.x + c * rays.y, u=c * rays.u - s * rays.v, v=s * rays.u + c * rays.v
    )
    a, b = trace(system, rays), trace(system, turned)
    torch.testing.assert_close(b.x, c * a.x - s * a.y, atol=1e-13, rtol=0)
    torch.testing.assert_close(b.path, a.path, atol=1e-12, rtol=0)


def test_tilted_system_is_the_system_seen_from_rays_moved_back():
    tilt, shift = (0.8, -0.5), (0.3, -0.2)
    straight = optical_system([surface(30.0, material=1.5)], aperture=5.0)
    moved = optical_system([surface(30.0, material=1.5, tilt=tilt, shift=shift)], aperture=5.0)
    rays = launch(straight, "rings", 2, fields=[(1.0, 2.0)])
    a, b = (math.radians(value) for value in tilt)
    rx = np.asarray([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    ry = np.asarray([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    matrix = torch.from_numpy(ry @ rx)
    points, directions = rays.to_tensor().unbind(-2)
    place = torch.tensor([*shift, 0.0], dtype=F64)
    local = torch.stack([(points - place) @ matrix, directions @ matrix], -2)
    expected = trace(straight, local, until=0).to_tensor()
    found = trace(moved, rays, until=0).to_tensor().reshape(expected.shape)
    torch.testing.assert_close(found[..., 0, :], expected[..., 0, :] @ matrix.T + place, atol=1e-12, rtol=0)
    torch.testing.assert_close(found[..., 1, :], expected[..., 1, :] @ matrix.T, atol=1e-12, rtol=0)


def test_a_batch_of_systems_is_each_of_them():
    system = load_system("cooke_triplet")
    numbers = system.prescription()
    scale = torch.tensor([0.99, 1.0, 1.02], dtype=F64)[:, None]
    batch = numbers._replace(curvature=scale * numbers.curvature)
    together = trace_fields(system, "rings", 2, prescription=batch)
    assert together.x.shape == (3, 3, 3, 19)
    for i in range(3):
        one = trace_fields(system, "rings", 2, prescription=numbers._replace(curvature=batch.curvature[i]))
        torch.testing.assert_close(together.y[i], one.y, rtol=1e-13, atol=1e-13)


def test_blocks_and_threads_change_nothing(monkeypatch):
    system = load_system("cooke_triplet")
    curvature = system.vary(curvature=[0, 3])
    rays = launch(system, "random", 3000)
    rays = Rays(*(value.detach() for value in rays))

    def run():
        traced = trace(system, rays)
        return traced.y, torch.stack(torch.autograd.grad(traced.y.square().sum(), curvature))

    whole = run()
    monkeypatch.setattr(fused, "BLOCK_BYTES", 8 * 700)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        first, second = run(), run()
    finally:
        torch.set_num_threads(before)
    assert torch.equal(first[1], second[1]) and torch.equal(first[0], whole[0])
    torch.testing.assert_close(first[1], whole[1], rtol=1e-12, atol=0)


def test_single_precision_stays_near_double():
    system = load_system("double_gauss")
    wide, narrow = (trace_fields(system, dtype=dtype, vignetting=False) for dtype in (F64, torch.float32))
    assert narrow.x.dtype == torch.float32
    # Eleven surfaces round coordinates of a track of 140 mm, each time by up to three units in the last place.
    assert float((narrow.y - wide.y).abs().max()) < 3 * 11 * 140 * torch.finfo(torch.float32).eps


def test_memory_kept_for_gradients():
    """At most 300 bytes a ray through six surfaces in float32, rays and results included."""
    system = load_system("cooke_triplet")
    system.vary(curvature=range(6))
    kept = {}
    count = 20000
    with torch.autograd.graph.saved_tensors_hooks(
        lambda value: kept.update({value.untyped_storage().data_ptr(): value.untyped_storage().nbytes()}) or value,
        lambda value: value,
    ):
        traced = trace_fields(system, "random", count, fields=[(0.0, 10.0)], dtype=torch.float32)
    rays = traced.x.numel()
    total = sum(kept.values()) + sum(value.nbytes for value in traced)
    assert rays == 3 * count
    assert total / rays < 150


def test_empty_batches_are_empty():
    system = load_system("singlet")
    traced = trace(system, torch.zeros(0, 2, 3, dtype=F64))
    assert traced.x.shape == (3, 1, 0)
    traced = trace(system, launch(system, torch.zeros(0, 2)))
    assert traced.status.shape == (3, 3, 0)


def test_what_is_no_ray_is_refused():
    system = load_system("singlet")
    with pytest.raises(ValueError, match=r"ray must be \[\.\.\., 2, 3\]"):
        trace(system, torch.zeros(4, 3))
    with pytest.raises(TypeError, match="rays must be Rays or a tensor"):
        trace(system, [1.0])
    with pytest.raises(TypeError, match="must all be float32 or all float64"):
        trace(system, torch.zeros(4, 2, 3, dtype=torch.float16))
    rays = launch(system)
    with pytest.raises(TypeError, match="must all be float32 or all float64"):
        trace(system, rays._replace(x=rays.x.float()))
    with pytest.raises(ValueError, match="must match the systems and wavelengths"):
        trace(system, Rays(*(value.expand(2, 3, *value.shape[-1:]) for value in rays)))


def test_numbers_are_field_points_along_y():
    """Two numbers were taken for one point, where the system itself takes them for two."""
    system = load_system("cooke_triplet")
    for one, two in zip(launch(system, fields=[0.0, 2.0]), launch(system, fields=[(0, 0), (0, 2)]), strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize("fields", [[(0.0, 1.0, 2.0)], [(0.0, math.nan)], "12"])
def test_field_points_are_pairs(fields):
    with pytest.raises((ValueError, TypeError), match="fields must"):
        launch(load_system("cooke_triplet"), fields=fields)


def test_field_points_as_a_tensor():
    system = load_system("cooke_triplet")
    pairs = [(0.0, 0.0), (0.0, 10.0)]
    for one, two in zip(launch(system, fields=pairs), launch(system, fields=torch.tensor(pairs)), strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize("until", [99, -99, 1.5, "last"])
def test_surface_that_is_not_there(until):
    system = load_system("cooke_triplet")
    with pytest.raises((ValueError, TypeError), match="until must be"):
        trace(system, launch(system, count=1), until=until)


def test_apertures_and_fields_beyond_a_right_angle_are_refused():
    glass = [surface(50.0, thickness=1.0, material=1.5)]
    with pytest.raises(ValueError, match="aperture must be below 1"):
        optical_system(glass, aperture=1.5, aperture_type="NA", object_distance=50.0)
    for angle in (195.0, -180.0):
        with pytest.raises(ValueError, match="fields must be below 90 degrees"):
            optical_system(glass, aperture=5.0, fields=[angle])
    with pytest.raises(ValueError, match="fields must be below 90 degrees"):
        launch(optical_system(glass, aperture=5.0), "y", 3, fields=[[0.0, 95.0]])


def test_media_are_distinguished_by_index_not_by_name():
    def heights(media):
        faces = [surface(radius, thickness=2.0, material=m) for radius, m in zip((20, -20, 1e9), media, strict=True)]
        lens = optical_system([*faces, surface(thickness=10.0)], aperture=2.0)
        return trace_fields(lens, "y", 5).y

    indices = (1.5, 1.7, 1.7)
    named = [OpticalMaterial("mine", "cauchy", {"A": (n,)}, (0.3, 2.0), "air", "test") for n in indices]
    torch.testing.assert_close(heights(named), heights(indices), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_few_rays_are_the_same_as_with_a_graph(dtype):
    """Few rays without derivatives are traced by NumPy, others by torch: mirrors, odd aspheres and lost rays too."""
    steep = OddAsphere(0.02, -0.8, [0.0, 1e-3, -4e-5, 1e-6, 2e-8])
    items = [
        surface(30.0, thickness=4.0, material="N-BK7", semi_diameter=9.0),
        surface(shape=steep, thickness=6.0, material=1.6),
        surface(phase=RadialPhase([-20.0]), thickness=8.0),
        surface(-40.0, thickness=-12.0, material="mirror"),
        surface(shape=steep, thickness=-9.0, material=1.5),
    ]
    lens = optical_system(items, 20.0, fields=[0.0, 25.0, 55.0], wavelengths=["480nm", "650nm"])
    rays = launch(lens, "rings", 5, dtype=dtype)
    few = trace(lens, rays)
    many = trace(lens, Rays(*(value.clone().requires_grad_() for value in rays)))
    assert few.x.dtype == dtype and torch.equal(few.status, many.status) and len(few.status.unique()) > 2
    close = 1e-9 if dtype == torch.float64 else 2e-3
    for one, other in zip(few[:7], many[:7], strict=True):
        assert torch.allclose(one, other.detach(), rtol=close, atol=close, equal_nan=True)
