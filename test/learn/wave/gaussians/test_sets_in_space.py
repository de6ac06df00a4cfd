"""Complex Gaussians in space: first parameters, projections against closed forms, files."""

import math
import os
import pickle
from argparse import Namespace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.wave import complex_3d_gaussians
from odak.learn.wave.gaussians.sets import NAMES

PLANES = Namespace(num_planes=2)


def gaussians(number=64, seed=0, **options):
    return complex_3d_gaussians("random", "cpu", num_points=number, args_prop=PLANES, seed=seed, **options)


def test_random_parameters():
    model = gaussians(4000)
    shapes = [(4000, 4), (4000, 3), (4000, 3), (4000, 3), (4000, 3), (4000,), (4000, 2)]
    assert [(name, tuple(value.shape)) for name, value in model.state_dict().items()] == list(
        zip(NAMES, shapes, strict=True)
    )
    assert not any(parameter.requires_grad for parameter in model.parameters())
    assert len(model) == 4000
    assert float(model.means.abs().max()) == pytest.approx(15.7, rel=1e-3)
    assert float(model.means.std()) == pytest.approx(15.7 / 3**0.5, rel=0.02)
    assert float(model.colours.min()) >= 0 and float(model.colours.max()) <= 1
    offset = model.pre_act_quats - torch.tensor([1.0, 0, 0, 0])
    assert float(offset.std()) == pytest.approx(0.01, rel=0.03)
    scales = model.pre_act_scales.exp()
    assert bool((scales == scales[:, :1]).all())
    assert float(scales.max()) == pytest.approx(0.01, rel=1e-2)
    assert float(model.pre_act_phase.std()) == pytest.approx(1, rel=0.03)
    assert bool((model.pre_act_opacities == 1).all())
    assert float(model.pre_act_plane_assignment.std()) == pytest.approx(10, rel=0.03)
    assert torch.equal(gaussians(4000).means, model.means)
    assert (model.NEAR_PLANE, model.FAR_PLANE) == (1.0, 1000.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"init_type": "cloud"}, "init_type must be one of 'gaussians', 'random', 'point'; got 'cloud'"),
        ({"init_type": None}, "init_type"),
        ({"init_type": "random", "args_prop": PLANES}, "num_points is needed"),
        ({"init_type": "gaussians", "args_prop": PLANES}, "load_path is needed"),
        ({"init_type": "point", "args_prop": PLANES}, "pointcloud_data is needed"),
        ({"init_type": "random", "num_points": 3}, "args_prop must have num_planes"),
        ({"init_type": "random", "num_points": 0, "args_prop": PLANES}, "num_points must be at least 1"),
        ({"init_type": "random", "num_points": 3, "args_prop": Namespace(num_planes=0)}, "num_planes"),
        ({"init_type": "point", "pointcloud_data": {}, "args_prop": PLANES}, "missing is_outdoor"),
    ],
)
def test_what_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        complex_3d_gaussians(**{"device": "cpu", **arguments})


def cloud(count=200):
    draw = torch.Generator().manual_seed(0)
    stretch = torch.tensor([5.0, 4.0, 0.5])
    return {
        "positions": torch.randn(count, 3, generator=draw) * stretch,
        "colors": torch.rand(count, 3, generator=draw),
    }


def test_points():
    indoor = Namespace(num_planes=3, is_outdoor=False)
    data = cloud()
    model = complex_3d_gaussians("point", "cpu", args_prop=indoor, pointcloud_data=data)
    assert torch.equal(model.means, data["positions"])
    assert torch.equal(model.colours, data["colors"])
    assert model.pre_act_plane_assignment.shape == (200, 3)
    dense = complex_3d_gaussians(
        "point",
        "cpu",
        args_prop=indoor,
        pointcloud_data={name: value.numpy() for name, value in data.items()},
        generate_dense_point=2,
        densepoint_scatter=0.05,
    )
    assert len(dense) == 600
    for copy in dense.means.split(200)[1:]:
        assert float((copy - data["positions"]).std()) == pytest.approx(0.05, rel=0.1)
    assert torch.equal(dense.colours, data["colors"].repeat(3, 1))
    for wrong in ({"positions": torch.zeros(3, 3)}, {**data, "colors": torch.zeros(3, 3)}, {**data, "positions": [1]}):
        with pytest.raises(ValueError, match="pointcloud_data"):
            complex_3d_gaussians("point", "cpu", args_prop=indoor, pointcloud_data=wrong)


def test_points_in_unbounded_scenes():
    data = cloud()
    outdoor = Namespace(num_planes=2, is_outdoor=True)
    model = complex_3d_gaussians("point", "cpu", args_prop=outdoor, pointcloud_data=data)
    centre = data["positions"].mean(0)
    distance = (data["positions"] - centre).norm(dim=1)
    kept = distance <= distance.sort().values[195]
    assert len(model) == 196 + int(0.8 * 196)
    assert torch.equal(model.means[:196], data["positions"][kept])
    arms = model.means[196:] - centre
    share = arms.norm(dim=1) / distance[kept].max()
    assert float(share.min()) >= 0.5 and float(share.max()) <= 0.8
    axis = torch.linalg.svd(model.means[:196] - model.means[:196].mean(0)).Vh[2]
    heights = (torch.nn.functional.normalize(arms, dim=1) @ axis).abs()
    assert 0.3 < float(heights.max()) <= 0.35 + 1e-6
    assert bool((model.colours[196:, None] == data["colors"][kept]).all(-1).any(-1).all())


def test_trainable():
    model = gaussians(3)
    with pytest.raises(RuntimeError, match=r"make_trainable\(\)"):
        model.check_if_trainable()
    model.make_trainable()
    model.check_if_trainable()
    assert all(parameter.requires_grad for parameter in model.parameters())


@settings(max_examples=30)
@given(st.integers(1, 5), st.integers(0, 10**6))
def test_covariances_in_space(number, seed):
    draw = torch.Generator().manual_seed(seed)
    quats = torch.randn(number, 4, dtype=torch.float64, generator=draw)
    scales = torch.rand(number, 3, dtype=torch.float64, generator=draw) + 0.1
    covariance = gaussians(1).compute_cov_3D(quats, scales)
    assert covariance.shape == (number, 3, 3)
    torch.testing.assert_close(covariance, covariance.mT)
    torch.testing.assert_close(torch.linalg.eigvalsh(covariance), scales.square().sort(dim=1).values)
    # Along the first axis of the Gaussian, rotated explicitly: p' = p + 2w(v × p) + 2v × (v × p).
    w, v = quats[:, :1] / quats.norm(dim=1, keepdim=True), quats[:, 1:] / quats.norm(dim=1, keepdim=True)
    first = torch.tensor([[1.0, 0, 0]], dtype=torch.float64).expand(number, 3)
    twist = torch.linalg.cross(v, first)
    axis = first + 2 * w * twist + 2 * torch.linalg.cross(v, twist)
    torch.testing.assert_close((covariance @ axis[..., None])[..., 0], scales[:, :1] ** 2 * axis)


def projection(points, fx, fy, px, py):
    return torch.stack([px - fx * points[:, 0] / points[:, 2], py - fy * points[:, 1] / points[:, 2]], dim=-1)


def test_covariances_are_those_of_the_projection():
    draw = torch.Generator().manual_seed(0)
    model = gaussians(1)
    points = torch.rand(6, 3, dtype=torch.float64, generator=draw) - 0.5
    points[:, 2] += 5
    quats, scales = torch.randn(6, 4, dtype=torch.float64, generator=draw), torch.rand(6, 3, generator=draw).double()
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=draw))[0]
    covariance = model.compute_cov_2D(points, quats, scales, 50.0, 45.0, turn[None], (320, 240))
    assert covariance.shape == (6, 2, 2)
    slopes = torch.func.vmap(torch.func.jacrev(lambda p: projection(p[None], 50.0, 45.0, 16.0, 12.0)[0]))(points)
    inside = slopes @ turn @ model.compute_cov_3D(quats, scales) @ turn.T @ slopes.mT
    torch.testing.assert_close(covariance, inside + 0.3 * torch.eye(2))
    torch.testing.assert_close(
        model.compute_means_2D(points, 50.0, 45.0, 16.0, 12.0), projection(points, 50, 45, 16, 12)
    )
    tensors = [torch.tensor(value, dtype=torch.float64) for value in (50.0, 45.0)]
    torch.testing.assert_close(model.compute_cov_2D(points, quats, scales, *tensors, turn, (320, 240)), covariance)
    inverse = model.invert_cov_2D(covariance)
    torch.testing.assert_close(inverse @ covariance, torch.eye(2, dtype=torch.float64).expand(6, 2, 2))


def test_projection_at_the_limits():
    model = gaussians(1)
    depths = torch.tensor([0.0, -5.0, 1.0, 1.5, 999.0, 1000.0, 2000.0])
    points = torch.stack([torch.zeros(7), torch.zeros(7), depths], dim=-1).requires_grad_()
    means = model.compute_means_2D(points, 50.0, 45.0, 16.0, 12.0)
    seen = torch.tensor([False, False, False, True, True, False, False])
    assert bool((means[~seen] == 1e6).all())
    assert means[seen].tolist() == [[16, 12]] * 2
    quats, scales = torch.tensor([[1.0, 0, 0, 0]]).expand(7, 4), torch.ones(7, 3)
    covariance = model.compute_cov_2D(points, quats, scales, 50.0, 45.0, torch.eye(3), (32, 24))
    assert torch.equal(covariance[~seen], (0.3 * torch.eye(2)).expand(5, 2, 2))
    (gradient,) = torch.autograd.grad(means.sum() + covariance.sum(), points)
    assert bool(gradient.isfinite().all())
    # Outside the view the slope is that of a direction 1.3 times the half angle.
    aside = torch.tensor([[30.0, -40.0, 2.0]])
    slope = torch.tensor([[25.0, 0.0, -25.0 * 1.3 * 16 / 50], [0.0, 22.5, 22.5 * 1.3 * 12 / 45]])
    held = model.compute_cov_2D(aside, quats[:1], scales[:1], 50.0, 45.0, torch.eye(3), (32, 24))
    torch.testing.assert_close(held[0], slope @ slope.T + 0.3 * torch.eye(2))


def test_bounds():
    means = torch.tensor([[10.0, 8.0], [-50.0, 300.0]])
    covariance = torch.tensor([[[4.0, 1.0], [1.0, 9.0]], [[1.0, 0.0], [0.0, 1.0]]])
    bounds = complex_3d_gaussians.calculate_gaussian_bounds(means, covariance, (32, 24), confidence=2.0)
    assert bounds.tolist() == [[6, 2, 14, 14], [0, 23, 0, 23]]
    assert complex_3d_gaussians.calculate_gaussian_bounds(means[:1], covariance[:1], (32, 24)).tolist() == [
        [4, 0, 16, 17]
    ]


def test_activations():
    model = gaussians(9)
    activate = complex_3d_gaussians.apply_activations
    quats, scales, phase, opacities, planes = activate(*_pre(model))
    torch.testing.assert_close(quats.norm(dim=1), torch.ones(9))
    torch.testing.assert_close(scales, model.pre_act_scales.exp())
    assert bool(((phase >= 0) & (phase < 2 * math.pi)).all())
    torch.testing.assert_close(torch.exp(1j * phase), torch.exp(1j * model.pre_act_phase))
    torch.testing.assert_close(opacities, torch.sigmoid(model.pre_act_opacities))
    assert torch.equal(planes.argmax(1), model.pre_act_plane_assignment.argmax(1))
    assert planes.sum(1).tolist() == [1] * 9 and set(planes.unique().tolist()) <= {0.0, 1.0}
    assert activate(model.pre_act_quats, model.pre_act_scales)[2:] == (None, None, None)
    assert activate(*_pre(model)[:3], step=3, max_step=9)[3:] == (None, None)


def _pre(model):
    names = ("pre_act_quats", "pre_act_scales", "pre_act_phase", "pre_act_opacities", "pre_act_plane_assignment")
    return [getattr(model, name) for name in names]


def load(path, planes=2):
    return complex_3d_gaussians("gaussians", "cpu", load_path=path, args_prop=Namespace(num_planes=planes))


def test_files(tmp_path, capsys):
    model, path = gaussians(7), tmp_path / "scene.pth"
    model.save_gaussians(str(path))
    other = load(path)
    assert len(other) == 7
    assert all(torch.equal(getattr(other, name), getattr(model, name)) for name in NAMES)
    assert list(torch.load(path, weights_only=True)) == list(NAMES)
    assert not any(parameter.requires_grad for parameter in other.parameters())
    for call, message in (
        (lambda: model.save_gaussians(tmp_path / "scene.txt"), "not allowed"),
        (lambda: model.save_gaussians("../scene.pth"), "Path traversal"),
        (lambda: load(tmp_path / "scene.obj"), "not allowed"),
        (lambda: load(path, planes=3), r"pre_act_plane_assignment as .* \[7, 2\], not \[7, 3\]"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "nothing.pth")
    assert capsys.readouterr().out == ""


class _Command:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_broken_and_hostile_files_are_refused(tmp_path):
    model, path = gaussians(7), tmp_path / "scene.pth"
    model.save_gaussians(path)
    held = torch.load(path, weights_only=True)
    for content in (path.read_bytes()[:900], b"nonsense", pickle.dumps(_Command(tmp_path / "done"))):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"scene\.pth"):
            load(path)
    for wrong in (
        {**held, "means": _Command(tmp_path / "done")},
        {name: held[name] for name in NAMES[1:]},
        {**held, "colours": torch.zeros(6, 3)},
        {**held, "means": torch.zeros(7, 3, dtype=torch.int64)},
        {**held, "means": torch.tensor(1.0)},
        torch.zeros(3),
    ):
        torch.save(wrong, path)
        with pytest.raises(ValueError, match=r"scene\.pth"):
            load(path)
    assert not (tmp_path / "done").exists()


def test_clones_show_what_their_original_did():
    model = gaussians(5)
    with torch.no_grad():
        model.pre_act_opacities.copy_(torch.tensor([-2.0, 0.0, 1.0, 3.0, 0.5]))
    opacity, means = model.pre_act_opacities.sigmoid(), model.means.clone()
    model.make_trainable()
    origin = model.densify(torch.tensor([0.0, 2.0, 0.0, 3.0, 0.5]), 1.0, split_scale=1.0)
    assert origin.tolist() == [0, 1, 2, 3, 4, 1, 3]
    assert torch.equal(model.means, means[origin])
    now = model.pre_act_opacities.detach().sigmoid()
    for original, copy in ((1, 5), (3, 6)):
        assert float((1 - now[original]) * (1 - now[copy])) == pytest.approx(float(1 - opacity[original]), rel=1e-5)
    assert torch.allclose(now[[0, 2, 4]], opacity[[0, 2, 4]])
    model.check_if_trainable()
    assert model.pre_act_quats.shape == (7, 4)


def test_split_gaussians_are_drawn_from_their_original():
    model = gaussians(4000)
    with torch.no_grad():
        model.means.zero_()
        model.pre_act_scales.copy_(torch.tensor([2.0, 0.5, 1.0]).log().expand(4000, 3))
        model.pre_act_quats.copy_(torch.tensor([0.5**0.5, 0.0, 0.0, 0.5**0.5]).expand(4000, 4))
    model.densify(torch.ones(4000), 0.5, split_scale=1.0, seed=1)
    assert len(model) == 8000
    # A quarter turn about z: the long axis lies along y.
    assert model.means.std(0).tolist() == pytest.approx([0.5, 2.0, 1.0], rel=0.04)
    assert model.pre_act_scales[0].exp().tolist() == pytest.approx([2 / 1.6, 0.5 / 1.6, 1 / 1.6])
    again = gaussians(4)
    other = gaussians(4)
    for one in (again, other):
        one.densify(torch.ones(4), 0.5, split_scale=1e-6, seed=7)
    assert torch.equal(again.means, other.means)


def test_pruning_takes_faint_and_large_ones():
    model = gaussians(4)
    with torch.no_grad():
        model.pre_act_opacities.copy_(torch.tensor([-9.0, 1.0, 1.0, 2.0]))
        model.pre_act_scales[2] = 5.0
    assert model.prune().tolist() == [1, 2, 3]
    assert model.prune(largest_scale=1.0).tolist() == [0, 2]
    assert float(model.pre_act_opacities[1]) == 2.0
    with pytest.raises(ValueError, match="leave no Gaussian"):
        model.prune(least_opacity=1.0)
    with pytest.raises(ValueError, match="one for each Gaussian"):
        model.densify(torch.ones(5), 1.0, 1.0)
