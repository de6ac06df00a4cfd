"""The learnable height map: its triangles, mirrors in closed form, gradients, files."""

import plyfile
import pytest
import torch

from odak.learn import raytracing as rt
from odak.learn.raytracing import planar_mesh

F64 = torch.float64


def bowl(count=5, size=2.0, dtype=F64, **options):
    mesh = planar_mesh(size=torch.tensor([size, size], dtype=dtype), number_of_meshes=[count, count], **options)
    mesh.init_heights((0.1 * (mesh.X**2 + 0.5 * mesh.Y)).detach())
    return mesh


def downwards(x, y, height=5.0, slope=(0.0, 0.0)):
    start = torch.stack((x, y, torch.full_like(x, height)), dim=-1)
    direction = torch.tensor([*slope, -1.0], dtype=x.dtype)
    return torch.stack((start, (direction / direction.norm()).expand_as(start)), dim=1)


def test_default_arguments_give_a_flat_mesh_to_learn():
    mesh = planar_mesh()
    assert mesh.heights.shape == (10, 10, 1) and mesh.heights.requires_grad and mesh.heights.is_leaf
    assert mesh.X.shape == mesh.Y.shape == (10, 10, 1)
    assert mesh.get_squares().shape == (10, 10, 3) and mesh.get_triangles().shape == (162, 3, 3)
    assert float(mesh.X.max()) == 0.5 and float(mesh.Y.min()) == -0.5


def test_triangles_of_the_specification():
    heights = torch.arange(4.0).reshape(2, 2, 1)
    mesh = planar_mesh(size=torch.tensor([2.0, 2.0]), number_of_meshes=torch.tensor([2, 2]), heights=heights)
    assert mesh.heights is heights
    first, second = mesh.get_triangles().detach()
    assert first.tolist() == [[1, -1, 2], [1, 1, 3], [-1, 1, 1]]
    assert second.tolist() == [[1, -1, 2], [-1, 1, 1], [-1, -1, 0]]


def test_order_of_triangles_is_that_of_two_nested_loops():
    mesh = planar_mesh(size=[3.0, 4.0], number_of_meshes=[3, 4], angles=[10, 20, 30], offset=[1, 2, 3])
    mesh.init_heights(torch.rand(3, 4, 1, generator=torch.Generator().manual_seed(1)))
    points = rt.define_plane(torch.zeros(3), mesh.angles).detach()
    turn = torch.stack(((points[0] - points[1]) / 10, points[1] / 10), dim=1)
    axis = torch.linalg.cross(turn[:, 0], turn[:, 1])
    squares = mesh.get_squares().detach()
    place = squares[..., :2] @ turn.T + squares[..., 2:] * axis + mesh.offset
    firsts = [[place[i + 1, j], place[i + 1, j + 1], place[i, j + 1]] for i in range(2) for j in range(3)]
    seconds = [[place[i + 1, j], place[i, j + 1], place[i, j]] for i in range(2) for j in range(3)]
    expected = torch.stack([torch.stack(corners) for corners in firsts + seconds])
    torch.testing.assert_close(mesh.get_triangles().detach(), expected)


def test_flat_normals_point_along_the_rotated_axis():
    mesh = planar_mesh(number_of_meshes=[4, 3], angles=torch.tensor([30.0, 40.0, 50.0]))
    normals = rt.get_triangle_normal(mesh.get_triangles())[:, 1]
    axis = rt.get_triangle_normal(rt.define_plane(torch.zeros(3), mesh.angles))[1]
    torch.testing.assert_close(normals.detach(), axis.expand_as(normals))


def test_mirror_reflects_as_the_plane_does():
    mesh = planar_mesh(size=torch.tensor([2.0, 2.0], dtype=F64), number_of_meshes=[6, 5], angles=[0, 45, 0])
    x, y = torch.rand(2, 50, dtype=F64, generator=torch.Generator().manual_seed(2)) - 0.5
    rays = downwards(x, y)
    reflected, normals = mesh.mirror(rays)
    assert reflected.shape == normals.shape == (50, 2, 3)
    back = rays[mesh.ray_indices]
    expected = torch.stack((back[:, 0, 0], back[:, 0, 1], -back[:, 0, 0]), dim=1)
    torch.testing.assert_close(reflected[:, 0].detach(), expected)
    torch.testing.assert_close(reflected[:, 1].detach(), torch.tensor([[-1.0, 0, 0]], dtype=F64).abs().expand(50, 3))


def test_order_is_by_triangle_and_each_ray_comes_once():
    mesh = bowl()
    grid = torch.linspace(-0.9, 0.9, 9, dtype=F64)
    x, y = (v.reshape(-1) for v in torch.meshgrid(grid, grid, indexing="ij"))
    # The grid holds points on edges and corners, which several triangles share.
    rays = torch.cat((downwards(x, y), downwards(x, y) + torch.tensor([[9.0, 0, 0], [0, 0, 0]], dtype=F64)))
    reflected, _ = mesh.mirror(rays)
    assert sorted(mesh.ray_indices.tolist()) == list(range(81)) and len(reflected) == 81
    faces = mesh.get_mesh().intersect(rays[mesh.ray_indices]).face
    assert bool((faces.diff() >= 0).all())


def test_only_the_nearest_hit_ahead_reflects():
    mesh = planar_mesh(size=[2.0, 2.0], number_of_meshes=[3, 3], angles=[0.0, 0.0, 0.0])
    away = torch.tensor([[[0.2, 0.1, 5.0], [0.0, 0.0, 1.0]]])
    reflected, normals = mesh.mirror(away)
    assert reflected.shape == normals.shape == (0, 2, 3) and mesh.ray_indices.numel() == 0
    heights = torch.tensor([0.0, 4.0, 0.0])[:, None, None].repeat(1, 3, 1)
    steep = planar_mesh(size=[2.0, 2.0], number_of_meshes=[3, 3], heights=heights)
    along = torch.tensor([[[-3.0, 0.1, 1.5], [1.0, 0.0, 0.0]]])
    reflected, _ = steep.mirror(along)
    _, distances, *_ = rt.intersect_w_triangle_batch(along, steep.get_triangles())
    assert len(distances) > 1 and len(reflected) == 1
    assert float(reflected[0, 0, 0].detach()) == pytest.approx(min(float(d.detach()) for d in distances) - 3, abs=1e-5)


def test_gradients_reach_the_heights():
    x, y = torch.tensor([[0.21, -0.4, 0.63], [0.1, 0.33, -0.52]], dtype=F64)
    rays = downwards(x, y, slope=(0.1, -0.2))
    flat = planar_mesh(size=torch.tensor([2.0, 2.0], dtype=F64), number_of_meshes=[3, 3])

    def mirrored(heights):
        mesh = planar_mesh(size=torch.tensor([2.0, 2.0], dtype=F64), number_of_meshes=[3, 3], heights=heights)
        return mesh.mirror(rays)

    assert torch.autograd.gradcheck(mirrored, (flat.heights,), fast_mode=True)
    flat.mirror(rays)[0][:, 1, :2].sum().backward()
    assert float(flat.heights.grad.abs().max()) > 0.1


def test_gradients_reach_angles_and_offset():
    angles = torch.tensor([3.0, -4.0, 5.0], dtype=F64, requires_grad=True)
    offset = torch.tensor([0.1, 0.2, 0.3], dtype=F64, requires_grad=True)
    x, y = torch.tensor([[0.21, -0.4], [0.1, 0.33]], dtype=F64)

    def mirrored(angles, offset):
        mesh = planar_mesh(size=[2.0, 2.0], number_of_meshes=[3, 3], angles=angles, offset=offset)
        return mesh.mirror(downwards(x, y))[0]

    assert torch.autograd.gradcheck(mirrored, (angles, offset), fast_mode=True)


def test_learning_the_heights_focuses_a_mirror():
    """An optimizer deforms the mesh so that its rays meet in one point."""
    mesh = planar_mesh(size=torch.tensor([1.1, 1.1]), number_of_meshes=torch.tensor([9, 9]), device=torch.device("cpu"))
    grid = torch.linspace(-0.5, 0.5, 11)
    x, y = (v.reshape(-1) for v in torch.meshgrid(grid, grid, indexing="ij"))
    rays = rt.create_ray_from_two_points(torch.tensor([2.0, 2.0, 10.0]), torch.stack((x, y, 0 * x), dim=1))
    target = torch.tensor([-2.0, -2.0, 10.0])
    plane = rt.define_plane(point=target)
    optimizer = torch.optim.AdamW([mesh.heights], lr=2e-3)
    losses = []
    for _ in range(25):
        optimizer.zero_grad()
        reflected, _ = mesh.mirror(rays)
        points, _ = rt.intersect_w_surface(reflected, plane)
        loss = torch.nn.functional.mse_loss(points[:, 0], target.expand(len(points), 3))
        loss.backward(retain_graph=True)
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.2 * losses[0]


def test_precision_follows_heights_and_rays():
    assert bowl(dtype=torch.float32).get_triangles().dtype == torch.float32
    mesh = planar_mesh(heights=torch.zeros(10, 10, 1, dtype=F64))
    assert mesh.get_triangles().dtype == F64
    assert planar_mesh().mirror(downwards(*torch.zeros(2, 1, dtype=F64)))[0].dtype == F64


def test_heights_round_trip(tmp_path):
    mesh = bowl()
    mesh.save_heights(filename=str(tmp_path / "heights.pt"))
    back = torch.load(tmp_path / "heights.pt", weights_only=True)
    assert torch.equal(back, mesh.heights) and not back.requires_grad


def test_ply_holds_the_triangles(tmp_path):
    mesh = bowl(dtype=torch.float32, angles=torch.tensor([10.0, 0.0, 0.0]))
    mesh.save_heights_as_PLY(filename=str(tmp_path / "mesh.ply"))
    data = plyfile.PlyData.read(str(tmp_path / "mesh.ply"))
    points = torch.stack([torch.from_numpy(data["vertex"][axis].copy()) for axis in "xyz"], dim=1)
    torch.testing.assert_close(points.reshape(-1, 3, 3), mesh.get_triangles().detach(), rtol=0, atol=0)
    assert data.text and [path.name for path in tmp_path.iterdir()] == ["mesh.ply"]


def test_files_of_heights_are_where_files_may_be():
    for write in (bowl().save_heights, bowl().save_heights_as_PLY):
        for name in ("../out.pt", "../out.ply", "out.exe", "no such folder/a.pt"):
            with pytest.raises(ValueError, match=r"out|folder"):
                write(name)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"size": [1.0]}, ValueError, "size must be 2 numbers"),
        ({"number_of_meshes": [0, 3]}, ValueError, r"number_of_meshes\[0\] must be at least 1"),
        ({"angles": [1.0, 2.0]}, ValueError, "angles must be 3 numbers"),
        ({"heights": torch.zeros(10, 10)}, ValueError, r"heights must be \[10, 10, 1\]"),
    ],
)
def test_wrong_arguments_are_named(options, error, message):
    with pytest.raises(error, match=message):
        planar_mesh(**options)


def test_one_row_of_vertices_has_no_triangle():
    mesh = planar_mesh(number_of_meshes=[1, 5])
    assert mesh.get_triangles().shape == (0, 3, 3)
    assert mesh.mirror(torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]))[0].shape == (0, 2, 3)


def test_heights_made_in_inference_mode_can_be_learned():
    with torch.inference_mode():
        heights = torch.zeros(3, 3, 1)
    mesh = planar_mesh(number_of_meshes=[3, 3], heights=heights)
    mesh.get_triangles().sum().backward()
    assert mesh.heights.grad.any()


def test_mirrors_rays_of_any_batch():
    rays = torch.tensor([[[0.2, -0.3, 5.0], [0.0, 0.0, -1.0]]] * 4)
    rays[:, 0, 0] += torch.linspace(0, 0.2, 4)
    flat, batch = (planar_mesh().mirror(value)[0] for value in (rays, rays.reshape(2, 2, 2, 3)))
    assert torch.equal(flat, batch)
