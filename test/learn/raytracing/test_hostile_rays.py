"""Rays that should not be: no length, not normalised, parallel, none at all, arrays of many kinds; both faces."""

import hits
import numpy as np
import pytest
import torch

import odak.raytracing as core
from odak.learn import raytracing as rt
from odak.raytracing import interfaces
from odak.raytracing.intersections import RayStatus

F64 = torch.float64
SPHERE, PLANE = [0.0, 0, 5, 2], [[1.0, 0, 5], [0, 1, 5], [0, 0, 5]]
LINE = [[0.0, 0, 5], [1, 1, 5], [2, 2, 5]]
NAN, INF = float("nan"), float("inf")
LOST = {
    "no length": [[0.0, 0, 0], [0, 0, 0]],
    "NaN start": [[0.0, NAN, 0], [0, 0, 1]],
    "NaN direction": [[0.0, 0, 0], [0, NAN, 1]],
    "infinite start": [[0.0, 0, -INF], [0, 0, 1]],
    "infinite direction": [[0.0, 0, 0], [0, 0, INF]],
}
GOOD = [[0.0, 0, 0], [0, 0, 1]]


def meetings(o, d, face):
    axis, z = face([0.0, 1, 0]), face([0.0, 0, 1])
    centre, radius, low = face([0.0, 0, 5]), face(2.0), o - face([0.0, 0, 5])
    return {
        "plane": hits.plane(o, d, centre, z),
        "sphere": hits.sphere(o, d, centre, radius),
        "cylinder": hits.cylinder(o, d, centre, radius, axis),
        "conic": hits.conic(low, d, face(0.1), face(-1.0), radius),
        "glass": interfaces.refract_directions(d, z, face(1.0), face(1.5)),
    }


def tensor(value):
    return torch.as_tensor(value, dtype=F64)


def leaf(value):
    return tensor(value).requires_grad_()


@pytest.mark.parametrize("face", [np.asarray, tensor, leaf], ids=["numpy", "torch", "torch with a graph"])
@pytest.mark.parametrize("name", LOST)
def test_lost_rays_miss_and_leave_the_others_alone(name, face):
    rays = face([LOST[name], GOOD])
    for surface, hit in meetings(rays[:, 0], rays[:, 1], face).items():
        status = np.asarray(hit[-1])
        if surface == "glass" and "start" in name:
            continue
        assert status.tolist() == [RayStatus.MISS, RayStatus.HIT], surface
        for value in hit[:2] if surface != "glass" else hit[:1]:
            value = np.asarray(value.detach() if torch.is_tensor(value) else value)
            assert np.isnan(value[0]).all() and np.isfinite(value[1]).all(), surface


@pytest.mark.parametrize("name", LOST)
def test_lost_rays_leave_gradients_finite(name):
    rays, others = leaf([LOST[name], GOOD]), [leaf(2.0), leaf([0.0, 0, 5])]
    hit = hits.sphere(rays[:, 0], rays[:, 1], others[1], others[0])
    plane = hits.plane(rays[:, 0], rays[:, 1], others[1], tensor([0.0, 0, 1]))
    bent, _ = interfaces.refract_directions(rays[:, 1], hit.normal, 1.0, others[0])
    sum(v.nan_to_num().sum() for v in (*hit[:3], *plane[:2], bent)).backward()
    for value in (rays, *others):
        assert value.grad.isfinite().all()
    assert (rays.grad[0] == 0).all() and (rays.grad[1] != 0).any()


@pytest.mark.parametrize("length", [1e-3, 2.0, 1e3])
def test_directions_of_any_length_meet_the_same_points(length, random):
    ends = random.normal(size=(2, 40, 3)) + np.asarray([[[0, 0, 0]], [[0, 0, 5]]])
    rays = core.create_ray_from_two_points(*ends)
    one = meetings(rays[:, 0], rays[:, 1], np.asarray)
    for surface, hit in meetings(rays[:, 0], rays[:, 1] * length, np.asarray).items():
        if surface == "glass":
            np.testing.assert_allclose(hit[0], one[surface][0] * length, rtol=1e-12, atol=1e-15)
            continue
        np.testing.assert_array_equal(hit.status, one[surface].status)
        assert hit.hit.any()
        np.testing.assert_allclose(hit.point, one[surface].point, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(hit.distance * length, one[surface].distance, rtol=1e-9)


@pytest.mark.parametrize("grad", [False, True])
def test_parallel_rays_and_degenerate_triangles(grad):
    parallel = torch.tensor([[[0.0, 0, 0], [1, 0, 0]], [[0, 0, 5], [0.6, 0.8, 0]]], requires_grad=grad)
    normal, distance = rt.intersect_w_surface(parallel, PLANE)
    assert distance.isnan().all() and normal[:, 0].isnan().all()
    np.testing.assert_allclose(normal[:, 1].detach(), [[0, 0, 1], [0, 0, 1]])
    ray = torch.tensor([GOOD], requires_grad=grad)
    _, distance, rays, _, check = rt.intersect_w_triangle(ray, LINE)
    assert distance.isnan().all() and not check.any() and rays.shape == (0, 2, 3)
    assert rt.get_triangle_normal(torch.tensor(LINE))[1].isnan().all()
    assert not rt.is_it_on_triangle(torch.tensor([[0.5, 0.5, 5.0]]), torch.tensor(LINE)).any()
    cylinder = core.define_cylinder([0, 0, 0], 1.0)
    np.testing.assert_array_equal(core.intersect_w_cylinder([GOOD, GOOD], cylinder)[1], [np.nan, np.nan])


def test_no_rays_at_all():
    rays, arrays = torch.zeros(0, 2, 3), np.zeros((0, 2, 3))
    circle = [torch.tensor(PLANE), torch.zeros(3), torch.tensor([1.0])]
    assert [v.shape for v in rt.intersect_w_circle(rays, circle)] == [(0, 2, 3), (0, 1)]
    assert [v.shape for v in rt.intersect_w_surface(rays, PLANE)] == [(0, 2, 3), (0, 1)]
    assert [v.shape for v in rt.intersect_w_surface_batch(rays, PLANE)] == [(1, 0, 2, 3), (1, 0)]
    assert rt.intersect_w_triangle_batch(rays, PLANE)[4].shape == (1, 0)
    assert rt.propagate_ray(rays, 1.0).shape == rt.reflect(rays, rays).shape == (0, 2, 3)
    assert core.intersect_w_cylinder(arrays, core.define_cylinder([0, 0, 0], 1))[1].shape == (0,)
    assert core.intersect_w_surface(arrays, PLANE)[0].shape == core.reflect(arrays, arrays).shape == (0, 2, 3)
    assert core.intersect_w_sag(arrays, core.EvenAsphere(0.1, 0.0, [0.01])).distance.shape == (0,)
    assert rt.intersect_w_sag(rays, rt.EvenAsphere(0.1, 0.0, [0.01])).distance.shape == (0,)


def test_devices_and_precisions_mix():
    single, double = torch.tensor([GOOD]), torch.tensor([GOOD], dtype=F64)
    assert rt.refract(single, double, 1.0, 1.5).dtype == F64
    assert rt.refract(single, single, 1.0, torch.tensor(1.5)).dtype == torch.float32
    assert rt.intersect_w_sphere(single, np.asarray(SPHERE, dtype=np.float32))[2].dtype == torch.float32
    assert rt.intersect_w_triangle(torch.tensor([[[0, 0, 0], [0, 0, 1]]]), PLANE)[1].dtype == torch.float32
    # The first tensor says where: the others follow.
    assert rt.reflect(single.to("meta"), double).device.type == "meta"
    assert rt.reflect(single, core.create_ray([0, 0, 0], [90, 90, 0])).device.type == "cpu"
    with pytest.raises(NotImplementedError):  # torch's own: a tensor without data cannot come to a real device
        rt.reflect(single, double.to("meta"))
    assert core.refract(np.float32(GOOD), np.float32(GOOD), 1, 1.5).dtype == np.float32


def test_a_single_triangle_is_asked_for():
    with pytest.raises(ValueError, match=r"triangle must be one triangle \[3, 3\] or \[1, 3, 3\], got \(2, 3, 3\)"):
        rt.intersect_w_triangle(GOOD, [PLANE, PLANE])
