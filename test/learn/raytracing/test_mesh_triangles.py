"""Rays against triangle meshes: closed forms, brute force, gaps, gradients, files."""

import numpy as np
import plyfile
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.raytracing import mesh, refract, triangle_mesh
from odak.raytracing import RayStatus

BACKENDS = [
    "torch",
    pytest.param("embree", marks=pytest.mark.skipif(not mesh.has_embree(), reason="no embreex")),
]


def icosphere(subdivisions, dtype=torch.float64):
    """Return vertices on the unit sphere and outward faces: every edge halved, `subdivisions` times."""
    g = (1 + 5**0.5) / 2
    vertices = np.array([[s * a, t * b, 0] for a, b in ((1, g),) for s in (-1, 1) for t in (-1, 1)])
    vertices = np.concatenate([np.roll(vertices, k, axis=1) for k in range(3)])
    near = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 2.1
    triples = [(i, j, k) for i in range(12) for j in range(i) for k in range(j) if near[i, j] & near[j, k] & near[i, k]]
    faces = np.array([t if np.linalg.det(vertices[list(t)]) > 0 else t[::-1] for t in triples])
    for _ in range(subdivisions):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        unique, where = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = len(vertices) + where.reshape(3, -1)
        (a, b, c), vertices = faces.T, np.concatenate([vertices, vertices[unique].mean(axis=1)])
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
        vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return torch.from_numpy(vertices).to(dtype), torch.from_numpy(faces)


def random_rays(count, seed, radius=3.0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    start = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)
    target = torch.rand(count, 3, generator=generator, dtype=torch.float64) * 1.6 - 0.8
    direction = torch.nn.functional.normalize(target - radius * start, dim=1)
    return torch.stack((radius * start, direction), dim=1).to(dtype)


def brute_force(vertices, faces, rays):
    """Return the distance of every ray to the nearest face ahead: one 3 × 3 system for each pair, solved by LU."""
    a, b, c = vertices[faces].unbind(1)
    start, direction = rays[:, None, 0], rays[:, None, 1]
    matrix = torch.stack(torch.broadcast_tensors(b - a, c - a, -direction), dim=-1)
    solid = torch.linalg.det(matrix).abs() > 1e-14
    matrix = torch.where(solid[..., None, None], matrix, torch.eye(3, dtype=vertices.dtype))
    u, v, t = torch.linalg.solve(matrix, start - a).unbind(-1)
    inside = solid & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9)
    distance, face = torch.where(inside, t, torch.inf).min(dim=1)
    return distance, torch.where(distance.isfinite(), face, -1)


def soup(count, seed, size=0.3):
    generator = torch.Generator().manual_seed(seed)
    centre = torch.rand(count, 1, 3, generator=generator, dtype=torch.float64) * 2 - 1
    corners = centre + size * torch.randn(count, 3, 3, generator=generator, dtype=torch.float64)
    return corners.reshape(-1, 3), torch.arange(3 * count).reshape(-1, 3)


@settings(max_examples=25)
@given(count=st.integers(1, 120), seed=st.integers(0, 10**6))
def test_random_soups_agree_with_brute_force(count, seed):
    vertices, faces = soup(count, seed)
    rays = random_rays(64, seed + 1)
    hit = triangle_mesh(vertices, faces).intersect(rays)
    distance, face = brute_force(vertices, faces, rays)
    torch.testing.assert_close(hit.face, face)
    torch.testing.assert_close(hit.distance.nan_to_num(torch.inf), distance, rtol=1e-9, atol=1e-9)


def test_many_triangles_agree_with_brute_force_whatever_budget():
    vertices, faces = soup(3000, 3, 0.05)
    rays = random_rays(300, 4)
    distance, face = brute_force(vertices, faces, rays)
    for budget in (2**16, 2**20, 2**28):
        hit = triangle_mesh(vertices, faces, memory_budget=budget).intersect(rays)
        torch.testing.assert_close(hit.face, face)
        torch.testing.assert_close(hit.distance.nan_to_num(torch.inf), distance, rtol=1e-9, atol=1e-9)


def test_search_holds_to_its_budget(monkeypatch):
    lists = []
    children = mesh._children

    def spy(table, beam, best, ray, node):
        lists.append(len(ray))
        return children(table, beam, best, ray, node)

    monkeypatch.setattr(mesh, "_children", spy)
    budget = 2**20
    triangle_mesh(*icosphere(3), memory_budget=budget).intersect(random_rays(5000, 0))
    assert max(lists) * mesh.PAIR_BYTES * mesh.BRANCHES <= budget
    assert len(lists) > 20


@pytest.mark.parametrize("backend", BACKENDS)
def test_sphere_mesh_converges_with_the_square_of_its_edges(backend):
    rays = random_rays(500, 5, dtype=torch.float32)
    rays = rays[torch.linalg.cross(rays[:, 0], rays[:, 1]).norm(dim=1) < 0.9]
    along = (rays[:, 0] * rays[:, 1]).sum(dim=1)
    true = -along - (along**2 - (rays[:, 0] ** 2).sum(dim=1) + 1).sqrt()
    errors = []
    for level in (2, 3, 4):
        hit = triangle_mesh(*icosphere(level, torch.float32), backend=backend).intersect(rays)
        assert bool(hit.hit.all())
        errors.append(float((hit.distance - true).abs().mean()))
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.1)


def test_plane_mesh_is_the_plane():
    n = 12
    x, y = torch.meshgrid(torch.linspace(-2, 2, n).double(), torch.linspace(-2, 2, n).double(), indexing="ij")
    index = torch.arange(n * n).reshape(n, n)
    faces = torch.stack((index[:-1, :-1], index[1:, :-1], index[:-1, 1:]), dim=-1).reshape(-1, 3)
    faces = torch.cat((faces, torch.stack((index[1:, 1:], index[:-1, 1:], index[1:, :-1]), dim=-1).reshape(-1, 3)))
    mesh = triangle_mesh(torch.stack((x, y, 0.5 * x - 0.25 * y + 1), dim=-1).reshape(-1, 3), faces)
    rays = random_rays(400, 6)
    hit = mesh.intersect(rays)
    normal = torch.tensor([-0.5, 0.25, 1.0], dtype=torch.float64)
    distance = (1 - rays[:, 0] @ normal) / (rays[:, 1] @ normal)
    point = rays[:, 0] + distance[:, None] * rays[:, 1]
    inside = (distance > 0) & (point[:, :2].abs() <= 2).all(dim=1)
    assert torch.equal(hit.hit, inside)
    torch.testing.assert_close(hit.distance[inside], distance[inside], rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(hit.point[inside], point[inside], rtol=1e-12, atol=1e-12)
    expected = (normal / normal.norm()).expand(int(inside.sum()), 3)
    torch.testing.assert_close(hit.normal[inside], expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_ray_slips_through_edges_or_corners(dtype):
    """Rays from outside through points of edges, edge middles and corners of a closed mesh meet its near side."""
    vertices, faces = icosphere(4, dtype)
    mesh = triangle_mesh(vertices, faces, backend="torch")
    generator = torch.Generator().manual_seed(7)
    count = 100_000
    face = faces[torch.randint(len(faces), (count,), generator=generator)]
    share = torch.rand(count, 1, generator=generator, dtype=dtype)
    share[: count // 4] = 0.5
    share[count // 4 : count // 2] = 0.0
    target = vertices[face[:, 0]] * (1 - share) + vertices[face[:, 1]] * share
    start = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=dtype), dim=1)
    # From the side of the target, so that the target is the first thing met.
    start = torch.where((start * target).sum(dim=1, keepdim=True) < 0, -start, start) + 2 * target
    rays = torch.stack((start, target - start), dim=1)
    hit = mesh.intersect(rays)
    leaks = ~hit.hit | ((hit.distance - 1).abs() > 1e-3)
    assert int(leaks.sum()) == 0


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_axis_parallel_rays_in_planes_of_boxes_are_not_lost(dtype):
    """Directions with zeros, starts on grid lines: the slabs' 0/0."""
    n = 9
    x, y = torch.meshgrid(torch.arange(n, dtype=dtype), torch.arange(n, dtype=dtype), indexing="ij")
    index = torch.arange(n * n).reshape(n, n)
    quads = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    faces = torch.cat([torch.stack([quads[i] for i in c], dim=-1).reshape(-1, 3) for c in ((0, 1, 2), (0, 2, 3))])
    mesh = triangle_mesh(torch.stack((x, y, 0 * x), dim=-1).reshape(-1, 3), faces, backend="torch")
    start = torch.stack((x, y, 0 * x - 2), dim=-1).reshape(-1, 3)
    rays = torch.stack((start, torch.tensor([0.0, 0.0, 1.0], dtype=dtype).expand_as(start)), dim=1)
    hit = mesh.intersect(rays)
    torch.testing.assert_close(hit.distance, torch.full((n * n,), 2.0, dtype=dtype))
    assert not bool(mesh.intersect(rays * torch.tensor([[1.0], [-1.0]], dtype=dtype)).hit.any())


@pytest.mark.parametrize("normals", ["flat", "smooth"])
def test_gradients_in_rays_and_vertices(normals):
    vertices, faces = icosphere(0)
    rays = random_rays(3, 8)
    assert 0 < int(triangle_mesh(vertices, faces, normals).intersect(rays).hit.sum()) < 3

    def outputs(vertices, rays):
        hit = triangle_mesh(vertices, faces, normals).intersect(rays)
        return [getattr(hit, name)[hit.hit] for name in ("distance", "point", "normal", "barycentric")]

    inputs = (vertices.clone().requires_grad_(), rays.clone().requires_grad_())
    assert torch.autograd.gradcheck(outputs, inputs, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda v, r: outputs(v, r)[0].sum(), inputs, fast_mode=True)


def test_misses_leave_gradients_finite():
    vertices, faces = icosphere(1)
    vertices.requires_grad_()
    rays = torch.zeros(5, 2, 3, dtype=torch.float64)
    rays[:, 0, 2] = -3
    rays[0, 1, 2], rays[2, 1] = 1.0, torch.nan
    rays[3, 0, 0], rays[3, 1, 2], rays[4, 0, 0], rays[4, 1, 2] = torch.inf, 1, 9.0, 1.0
    rays.requires_grad_()
    hit = triangle_mesh(vertices, faces, "smooth").intersect(rays)
    assert hit.status.tolist() == [int(RayStatus.HIT)] + [int(RayStatus.MISS)] * 4
    assert bool(hit.distance[1:].isnan().all() and hit.point[1:].isnan().all() and hit.normal[1:].isnan().all())
    total = sum(torch.where(hit.hit, v.mT, 0.0).sum() for v in (hit.distance[None], hit.point, hit.normal))
    total.backward()
    assert bool(vertices.grad.isfinite().all()) and bool(rays.grad.isfinite().all())
    assert bool((vertices.grad != 0).any()) and bool((rays.grad[0] != 0).any())


def test_vertex_normals_are_exact_on_a_sphere():
    vertices, faces = icosphere(2)
    # Unequal faces: weights that only suit regular ones would show.
    vertices = torch.nn.functional.normalize(vertices * torch.tensor([1.0, 1.4, 0.7], dtype=torch.float64), dim=1)
    torch.testing.assert_close(triangle_mesh(vertices, faces).vertex_normals(), vertices, rtol=1e-12, atol=1e-12)


def test_smooth_normals_refract_as_the_sphere_does():
    rays = random_rays(500, 9)
    rays = rays[torch.linalg.cross(rays[:, 0], rays[:, 1]).norm(dim=1) < 0.7]
    along = (rays[:, 0] * rays[:, 1]).sum(dim=1, keepdim=True)
    point = rays[:, 0] + (-along - (along**2 - 8).sqrt()) * rays[:, 1]
    true = refract(rays, torch.stack((point, point), dim=1), 1.0, 1.5)[:, 1]
    errors = {}
    for kind in ("flat", "smooth"):
        for level in (3, 4):
            hit = triangle_mesh(*icosphere(level), normals=kind).intersect(rays)
            errors[kind, level] = float((refract(rays, hit.normals, 1.0, 1.5)[:, 1] - true).norm(dim=1).mean())
    assert errors["flat", 3] / errors["flat", 4] == pytest.approx(2, rel=0.1)
    assert errors["smooth", 3] / errors["smooth", 4] == pytest.approx(4, rel=0.2)
    assert errors["smooth", 4] < errors["flat", 4] / 20


def test_far_starts_lose_no_precision():
    """float32 rays from a thousand radii away meet the point that their directions allow."""
    vertices, faces = icosphere(3, torch.float32)
    near = random_rays(200, 10, dtype=torch.float64)
    direction = near[:, 1].float().double()
    far = torch.stack((near[:, 0] - 2.0**10 * direction, direction), dim=1).float()
    hit = triangle_mesh(vertices, faces, backend="torch").intersect(far)
    exact = triangle_mesh(vertices.double(), faces).intersect(far.double())
    same = hit.hit & (hit.face == exact.face)
    assert int(same.sum()) >= int(exact.hit.sum()) - 2 > 150
    assert float((hit.point - exact.point)[same].abs().max()) < 2e-6


def test_a_reflected_ray_leaves_its_face():
    vertices, faces = icosphere(3, torch.float32)
    mesh = triangle_mesh(vertices, faces, backend="torch")
    hit = mesh.intersect(random_rays(2000, 11, dtype=torch.float32))
    inwards = torch.stack((hit.point, -hit.normal), dim=1)[hit.hit]
    through = mesh.intersect(inwards)
    assert float((through.distance - 2).abs().max()) < 0.03
    assert not bool(mesh.intersect(torch.stack((hit.point, hit.normal), dim=1)[hit.hit]).hit.any())
    named = mesh.intersect(inwards, minimum_distance=-1.0, leaving=hit.face[hit.hit])
    assert not bool((named.face == hit.face[hit.hit]).any())


def test_minimum_distance_selects_the_next_face():
    mesh = triangle_mesh(*icosphere(2))
    ray = torch.tensor([[0.1, 0.2, -5.0], [0.0, 0.0, 2.0]], dtype=torch.float64)
    first, second = mesh.intersect(ray), mesh.intersect(ray, minimum_distance=2.2)
    assert 1.9 < float(first.distance) < 2.2 < float(second.distance) < 3.0
    assert float(first.point[2]) < 0 < float(second.point[2])


def test_any_batch_and_any_length_of_direction():
    mesh = triangle_mesh(*icosphere(2))
    rays = random_rays(24, 12)
    flat = mesh.intersect(rays)
    batched = mesh.intersect(rays.reshape(2, 3, 4, 2, 3))
    assert batched.point.shape == (2, 3, 4, 3) and batched.face.shape == (2, 3, 4)
    torch.testing.assert_close(batched.distance.reshape(-1), flat.distance, equal_nan=True)
    assert mesh.intersect(rays[0]).distance.shape == ()
    for factor in (1e-6, 1e6):
        scaled = mesh.intersect(rays * torch.tensor([[1.0], [factor]]))
        torch.testing.assert_close(scaled.distance * factor, flat.distance, equal_nan=True)
    assert mesh.intersect(torch.zeros(0, 2, 3)).normals.shape == (0, 2, 3)


def test_rotation_translation_and_scale_change_nothing():
    vertices, faces = soup(200, 13)
    rays = random_rays(200, 14)
    before = triangle_mesh(vertices, faces).intersect(rays)
    turn, _ = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64))
    shift = torch.tensor([30.0, -20.0, 10.0], dtype=torch.float64)
    moved = torch.stack(((rays[:, 0] @ turn + shift) * 50, rays[:, 1] @ turn), dim=1)
    after = triangle_mesh((vertices @ turn + shift) * 50, faces).intersect(moved)
    assert torch.equal(before.face, after.face)
    torch.testing.assert_close(after.distance, before.distance * 50, equal_nan=True, rtol=1e-10, atol=1e-10)


def test_degenerate_triangles_are_not_hit():
    vertices = torch.tensor([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 1]], dtype=torch.float64)
    mesh = triangle_mesh(vertices, torch.tensor([[0, 1, 2], [1, 1, 3], [3, 3, 3]]))
    rays = torch.tensor([[[0.5, 0.0, -1.0], [0.0, 0.0, 1.0]]], dtype=torch.float64)
    assert not bool(mesh.intersect(rays).hit.any())
    mixed = triangle_mesh(vertices, torch.tensor([[0, 1, 2], [0, 1, 3]])).intersect(rays)
    assert mixed.face.tolist() == [1]
    none = triangle_mesh(vertices, torch.zeros(0, 3, dtype=torch.int64)).intersect(rays)
    assert none.status.tolist() == [int(RayStatus.MISS)] and bool(none.point.isnan().all())


def test_precision_follows_the_wider_of_rays_and_mesh():
    single, faces = icosphere(1, torch.float32)
    rays = random_rays(4, 15)
    assert triangle_mesh(single, faces).intersect(rays.float()).point.dtype == torch.float32
    assert triangle_mesh(single, faces).intersect(rays).point.dtype == torch.float64
    assert triangle_mesh(single.double(), faces).intersect(rays.float()).distance.dtype == torch.float64


def test_moved_vertices_refit_the_same_hierarchy():
    vertices, faces = icosphere(3)
    mesh = triangle_mesh(vertices, faces)
    bent = vertices * torch.tensor([1.0, 0.3, 1.0], dtype=torch.float64) + vertices.flip(1) ** 2 * 0.2
    rays = random_rays(300, 16)
    moved, built = mesh.moved(bent).intersect(rays), triangle_mesh(bent, faces).intersect(rays)
    assert torch.equal(moved.face, built.face)
    torch.testing.assert_close(moved.distance, built.distance, equal_nan=True)
    with pytest.raises(ValueError, match="as many rows as before, 642; got 641"):
        mesh.moved(bent[1:])


def test_every_face_is_in_one_leaf():
    for count in (1, 4, 5, 33, 1000):
        vertices, faces = soup(count, count)
        leaves = mesh.sort_faces(vertices, faces)
        assert sorted(leaves[leaves >= 0].tolist()) == list(range(count))
        assert len(leaves).bit_count() == 1 and leaves.shape[1] <= mesh.LEAF


@pytest.mark.parametrize("normals", ["flat", "smooth"])
def test_threads_and_graphs_change_nothing(normals):
    vertices, faces = soup(400, 19)
    rays = random_rays(3000, 20)
    threads = torch.get_num_threads()
    found = []
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            for graph in (False, True):
                mesh = triangle_mesh(vertices.clone().requires_grad_(graph), faces, normals)
                found.append(mesh.intersect(rays))
                assert found[-1].point.requires_grad is graph
    finally:
        torch.set_num_threads(threads)
    for hit in found[1:]:
        for name in hit._fields:
            torch.testing.assert_close(getattr(hit, name), getattr(found[0], name), rtol=0, atol=0, equal_nan=True)


@pytest.mark.skipif(not mesh.has_embree(), reason="no embreex")
def test_embree_finds_what_the_search_finds():
    vertices, faces = icosphere(4, torch.float32)
    rays = random_rays(20_000, 17, dtype=torch.float32)
    ours = triangle_mesh(vertices, faces, backend="torch").intersect(rays)
    theirs = triangle_mesh(vertices, faces, backend="embree").intersect(rays)
    assert float((ours.face != theirs.face).double().mean()) < 1e-3
    torch.testing.assert_close(ours.distance, theirs.distance, equal_nan=True, rtol=1e-5, atol=1e-5)


def test_missing_embree_says_what_to_install(monkeypatch):
    monkeypatch.setattr(mesh, "has_embree", lambda: False)
    vertices, faces = icosphere(0, torch.float32)
    with pytest.raises(ImportError, match=r"pip install embreex"):
        triangle_mesh(vertices, faces, backend="embree")
    assert bool(triangle_mesh(vertices, faces).intersect(random_rays(50, 18, dtype=torch.float32)).hit.any())


@pytest.mark.parametrize("text", [True, False])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_ply_round_trip(tmp_path, text, dtype):
    vertices, faces = icosphere(1, dtype)
    triangle_mesh(vertices, faces).write_PLY(str(tmp_path / "ball.ply"), text)
    back = triangle_mesh.read_PLY(str(tmp_path / "ball.ply"))
    assert back.vertices.dtype == dtype and torch.equal(back.vertices, vertices) and torch.equal(back.faces, faces)
    # Read by plyfile alone.
    data = plyfile.PlyData.read(str(tmp_path / "ball.ply"))
    np.testing.assert_array_equal(np.stack(list(data["face"]["vertex_indices"])), faces.numpy())
    np.testing.assert_array_equal(data["vertex"]["y"], vertices[:, 1].numpy())
    assert [path.name for path in tmp_path.iterdir()] == ["ball.ply"]


def test_ply_written_by_hand(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    header += "property uchar red\nelement face 2\nproperty list uchar int vertex_index\nend_header\n"
    body = "0 0 0 9\n1 0 0 9\n1 1 0 9\n0 1 0 9\n0 0 1 9\n4 0 1 2 3\n3 0 1 4\n"
    (tmp_path / "hand.ply").write_text(header + body)
    mesh = triangle_mesh.read_PLY(str(tmp_path / "hand.ply"))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    (tmp_path / "bad.ply").write_text(header + body.replace("3 0 1 4", "3 0 1 7"))
    (tmp_path / "noise.ply").write_bytes(b"not a mesh")
    for name in ("bad.ply", "noise.ply"):
        with pytest.raises(ValueError, match=name):
            triangle_mesh.read_PLY(str(tmp_path / name))
    with pytest.raises(FileNotFoundError):
        triangle_mesh.read_PLY(str(tmp_path / "none.ply"))
    with pytest.raises(ValueError, match=r"\.ply"):
        mesh.write_PLY(str(tmp_path / "mesh.obj"))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"vertices": torch.zeros(4, 2)}, ValueError, r"vertices must be \[v, 3\]"),
        ({"vertices": torch.full((4, 3), torch.nan)}, ValueError, "finite"),
        ({"faces": torch.zeros(1, 3)}, TypeError, "faces must be integers"),
        ({"faces": torch.zeros(1, 4, dtype=torch.int64)}, ValueError, r"faces must be \[t, 3\]"),
        ({"faces": torch.tensor([[0, 1, 4]])}, ValueError, r"vertices 0 … 3, got 0 … 4"),
        ({"faces": torch.tensor([[0, 1, -1]])}, ValueError, "got -1"),
        ({"normals": "smoth"}, ValueError, "Did you mean 'smooth'"),
        ({"normals": torch.zeros(3, 3)}, ValueError, "normals must be"),
        ({"backend": "optix"}, ValueError, "backend must be one of"),
        ({"memory_budget": 100}, ValueError, "memory_budget must be at least"),
    ],
)
def test_wrong_arguments_are_named(change, error, message):
    good = {"vertices": torch.rand(4, 3), "faces": torch.tensor([[0, 1, 2]])}
    with pytest.raises(error, match=message):
        triangle_mesh(**{**good, **change})


def test_wrong_rays_are_named():
    mesh = triangle_mesh(*icosphere(0))
    with pytest.raises(ValueError, match=r"rays must be \[\.\.\., 2, 3\]"):
        mesh.intersect(torch.zeros(5, 3))
    with pytest.raises(TypeError, match="rays must be real"):
        mesh.intersect(torch.zeros(5, 2, 3, dtype=torch.complex64))
    with pytest.raises(ValueError, match="leaving must be a number or"):
        mesh.intersect(torch.zeros(5, 2, 3), leaving=torch.zeros(4, dtype=torch.int64))
