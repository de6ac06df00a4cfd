"""Large batches go in pieces, and gradients are computed again: the same numbers, and little memory."""

import hits
import numpy as np
import pytest
import torch

import odak.raytracing as core
from odak.learn import raytracing as rt
from odak.raytracing import batches, interfaces

F64 = torch.float64
CORNERS = np.asarray([[-3.0, -3, 5], [4, -2, 6], [0, 5, 5]])


def random_rays(random, count=50):
    ends = random.normal(size=(2, count, 3)) + np.asarray([[[0, 0, 0]], [[0, 0, 6]]])
    return core.create_ray_from_two_points(*ends)


def core_cases(random):
    rays, normals = random_rays(random), random_rays(random)
    o, d, z, one = rays[:, 0], rays[:, 1], np.asarray([0, 0, 5.0]), np.asarray(1.5)
    axis = np.asarray([0.6, 0, 0.8])
    return {
        "plane": (hits.plane, (o, d, z, axis)),
        "sphere": (hits.sphere, (o, d, z, one)),
        "sphere each": (hits.sphere, (o, d, z + normals[:, 0], np.linspace(0.5, 2, 50))),
        "spheres": (hits.sphere, (o[:, None], d[:, None], z + normals[:3, 0], one)),
        "cylinder": (hits.cylinder, (o, d, z, one, axis)),
        "conic": (hits.conic, (o - z, d, np.asarray(0.2), np.asarray(-0.5), np.asarray(2.0))),
        "reflect": (interfaces.reflect_directions, (d, normals[:, 1])),
        "refract": (interfaces.refract_directions, (d, normals[:, 1], 3.0, np.linspace(1.0, 2, 50))),
    }


def flat(result):
    return result if isinstance(result, tuple) else (result,)


@pytest.mark.parametrize("name", core_cases(np.random.default_rng(0)))
def test_pieces_and_graphs_give_the_same(name, random, monkeypatch):
    function, arrays = core_cases(random)[name]
    expected = flat(function(*arrays))
    tensors = [torch.as_tensor(a).clone() for a in arrays]
    differentiable = flat(function(*(t.requires_grad_() for t in tensors)))
    monkeypatch.setattr(batches, "piece_size", lambda arrays: 16)
    with torch.no_grad():
        cut = flat(function(*tensors))
    for a, b, c, d in zip(expected, flat(function(*arrays)), cut, differentiable, strict=True):
        np.testing.assert_array_equal(a, b)
        for tensor in (c, d.detach()):
            np.testing.assert_allclose(tensor, a, rtol=1e-12, atol=1e-12)
    lost = np.isnan(np.asarray(expected[0], dtype=float)).any()
    assert lost or name in ("plane", "cylinder", "reflect")


def learn_cases(random):
    rays, normals = (torch.from_numpy(random_rays(random)).requires_grad_() for _ in range(2))
    index = torch.tensor(1.4, dtype=F64, requires_grad=True)
    each = torch.linspace(1, 1.6, 50, dtype=F64).requires_grad_()
    sphere = torch.tensor([0.1, 0.2, 5.0, 1.5], dtype=F64, requires_grad=True)
    corners = torch.from_numpy(CORNERS).requires_grad_()
    coefficients = torch.tensor([1e-3, 1e-4], dtype=F64, requires_grad=True)
    radius = torch.tensor([2.0], dtype=F64)
    return {
        "plane": (rt.intersect_w_surface, (rays, corners)),
        "triangle": (rt.intersect_w_triangle, (rays, corners)),
        "triangles": (rt.intersect_w_surface_batch, (rays, torch.stack((corners, corners + 1)))),
        "circle": (lambda r, c: rt.intersect_w_circle(r, [c, c[0], radius]), (rays, corners)),
        "sphere": (rt.intersect_w_sphere, (rays, sphere)),
        "reflect": (rt.reflect, (rays, normals)),
        "refract": (rt.refract, (rays, normals, index, each)),
        "core, with numbers": (
            lambda r: interfaces.refract_directions(r[:, 1], torch.tensor([0.0, 0.6, 0.8], dtype=F64), 3.0, 1.2),
            (rays,),
        ),
        "asphere": (lambda r, c: rt.intersect_w_sag(r, rt.EvenAsphere(0.1, 0.0, c), (0, 0, 5.0)), (rays, coefficients)),
    }


def value(function, arguments):
    parts = [part for part in flat(function(*arguments)) if part.is_floating_point()]
    return sum(
        (part.nan_to_num() * torch.linspace(1, 2, part.numel(), dtype=F64).view(part.shape)).sum() for part in parts
    )


@pytest.mark.parametrize("name", learn_cases(np.random.default_rng(0)))
def test_recomputed_gradients_are_the_graphs(name, random, monkeypatch):
    function, arguments = learn_cases(random)[name]
    expected_value = value(function, arguments)
    expected = torch.autograd.grad(expected_value, arguments, create_graph=True)
    curvature = torch.autograd.grad(sum((g * g).sum() for g in expected), arguments, allow_unused=True)
    monkeypatch.setattr(batches, "piece_size", lambda arrays: 16)
    result = value(function, arguments)
    assert torch.allclose(result, expected_value, rtol=1e-12)
    for found, wanted in zip(torch.autograd.grad(result, arguments, retain_graph=True), expected, strict=True):
        np.testing.assert_allclose(found, wanted.detach(), rtol=1e-9, atol=1e-11)
        assert wanted.abs().max() > 0
    twice = torch.autograd.grad(result, arguments, create_graph=True)
    again = torch.autograd.grad(sum((g * g).sum() for g in twice), arguments, allow_unused=True)
    for found, wanted in zip(again, curvature, strict=True):
        assert (found is None) == (wanted is None)
        if found is not None:
            np.testing.assert_allclose(found, wanted, rtol=1e-7, atol=1e-9)


def surfaces_of_each(random):
    """Return calls in which each ray has a surface of its own, or meets each of many."""
    rays, normals = (torch.from_numpy(random_rays(random)) for _ in range(2))
    corners = torch.from_numpy(CORNERS + random.normal(size=(50, 3, 3)) / 4)
    middle, radius = corners.mean(1), torch.linspace(0.5, 3, 50, dtype=F64)
    spheres, index = torch.cat((middle, radius[:, None]), 1), torch.linspace(1, 1.6, 50, dtype=F64)
    return {
        "plane": (rt.intersect_w_surface, (rays, corners)),
        "circle": (lambda r, p, c, s: rt.intersect_w_circle(r, [p, c, s]), (rays, corners, middle, radius)),
        "sphere": (lambda r, s: rt.intersect_w_sphere(r, s)[2:], (rays, spheres)),
        "refract": (lambda r, n, i, k: (rt.refract(r, n, i, k),), (rays, normals, index, 2 - index / 2)),
        "planes": (lambda r, p: [part.swapaxes(0, 1) for part in rt.intersect_w_surface_batch(r, p)], (rays, corners)),
        "triangles": (
            lambda r, t: [rt.intersect_w_triangle_batch(r, t)[i].swapaxes(0, 1) for i in (0, 4)],
            (rays, corners),
        ),
    }


@pytest.mark.parametrize("name", surfaces_of_each(np.random.default_rng(0)))
def test_pieces_of_many_surfaces(name, random, monkeypatch):
    function, arguments = surfaces_of_each(random)[name]
    expected = function(*arguments)
    crossed = name in ("planes", "triangles")
    alone = [function(arguments[0][i], *(a if crossed else a[i] for a in arguments[1:])) for i in range(50)]
    monkeypatch.setattr(batches, "piece_size", lambda arrays: 16)
    for cut, whole, *each in zip(function(*arguments), expected, *alone, strict=True):
        np.testing.assert_array_equal(cut, whole)
        each = torch.stack([one.reshape(whole.shape[1:]) for one in each])
        np.testing.assert_allclose(each, whole, rtol=1e-12, atol=1e-12)
    decided = expected[-1]
    assert name == "refract" or decided.any()


def test_an_argument_made_from_another_counts_once(random, monkeypatch):
    monkeypatch.setattr(batches, "piece_size", lambda arrays: 8)
    rays = torch.from_numpy(random_rays(random, 12)).requires_grad_()

    def turned(r):
        return rt.refract(r, r + 0.1 * r.sin(), 1.0, 1.3)

    assert torch.autograd.gradcheck(turned, (rays,), fast_mode=True)
    assert torch.autograd.gradgradcheck(turned, (rays,), fast_mode=True)


def test_what_only_decides_has_no_gradient(random, monkeypatch):
    monkeypatch.setattr(batches, "piece_size", lambda arrays: 16)
    rays, radius = torch.from_numpy(random_rays(random)), torch.tensor([2.0], dtype=F64, requires_grad=True)
    corners = torch.from_numpy(CORNERS)
    distance = rt.intersect_w_circle(rays.requires_grad_(), [corners, corners[0], radius])[1]
    of_rays, of_radius = torch.autograd.grad(distance.nansum(), (rays, radius), allow_unused=True)
    assert of_rays.isfinite().all() and (of_rays != 0).any()
    assert of_radius is None or (of_radius == 0).all()


@pytest.mark.parametrize("name", ["plane", "refract", "asphere"])
def test_little_is_saved_for_gradients(name):
    count, saved = 3 * batches.piece_size([torch.zeros(1)]), {}
    rays = torch.rand(count, 2, 3) + torch.tensor([[0.0, 0, -5], [0, 0, 9]])
    rays.requires_grad_()
    corners = torch.tensor(CORNERS, dtype=torch.float32, requires_grad=True)
    tasks = {
        "plane": lambda: rt.intersect_w_surface(rays, corners),
        "refract": lambda: rt.refract(rays, rays, 1.0, 1.5),
        "asphere": lambda: rt.intersect_w_sag(rays, rt.EvenAsphere(0.01, 0.0, torch.tensor([1e-4]))),
    }

    def keep(tensor):
        saved[tensor.untyped_storage().data_ptr()] = tensor.untyped_storage().nbytes()
        return tensor

    with torch.autograd.graph.saved_tensors_hooks(keep, lambda tensor: tensor):
        result = tasks[name]()
    saved.pop(rays.untyped_storage().data_ptr(), None)
    # Besides the rays themselves at most the distance and the status are stored, and no intermediate values.
    assert sum(saved.values()) <= 16 * count
    assert flat(result)[0].requires_grad


@pytest.mark.filterwarnings("ignore:.*torch.jit.script:DeprecationWarning")  # torch's own, in forward mode
def test_transforms_pass_through(random):
    rays = torch.from_numpy(random_rays(random, 6))
    corners = torch.from_numpy(CORNERS)

    def distance(ray, corners):
        return rt.intersect_w_surface(ray, corners)[1].sum()

    expected = torch.autograd.functional.jacobian(lambda r: rt.intersect_w_surface(r, corners)[1].sum(), rays)
    np.testing.assert_allclose(torch.func.grad(distance)(rays, corners), expected)
    np.testing.assert_allclose(torch.func.jacfwd(distance)(rays, corners), expected)
