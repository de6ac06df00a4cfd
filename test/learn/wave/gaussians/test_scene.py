"""Scenes of complex Gaussians: single ones in closed form, occlusion, tiles, planes, propagation."""

import math
from argparse import Namespace

import pytest
import torch
from physics import gaussian_beam

from odak.learn.tools import PerspectiveCamera, get_rotation_matrix
from odak.learn.wave import Scene, complex_3d_gaussians, propagate_beam

WAVELENGTHS = [639e-9, 532e-9, 473e-9]
EYE = torch.eye(3, dtype=torch.float64)


def settings(**changes):
    values = {
        "num_planes": 2,
        "wavelengths": WAVELENGTHS,
        "pixel_pitch": 3.74e-6,
        "distances": [1e-3, 2e-3],
        "pad_size": [40, 48],
        "aperture_size": -1,
    }
    return Namespace(**(values | changes))


def camera(rotation=EYE, shift=(0.0, 0.0, 10.0), focal=(60.0, 50.0), centre=(24.0, 20.0)):
    numbers = (torch.tensor(value, dtype=torch.float64) for value in (shift, focal, centre))
    return PerspectiveCamera(rotation, *numbers)


def scene(number=30, seed=0, extent=3.0, size=0.3, **changes):
    """Return a scene in double precision whose Gaussians fill the view."""
    options = {key: changes.pop(key) for key in ("rotate_as_points",) if key in changes}
    about = settings(**changes)
    model = complex_3d_gaussians("random", "cpu", num_points=number, args_prop=about, seed=seed).double()
    draw = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        model.means.mul_(extent / 15.7)
        model.pre_act_quats.normal_(generator=draw)
        model.pre_act_scales.copy_((size * (0.3 + torch.rand(number, 3, dtype=torch.float64, generator=draw))).log())
    return Scene(model, about, **options)


def place(world, means, *, opacity=1.0, colours=1.0, phase=0.0, plane=0):
    """Put round Gaussians of standard deviation 0.2 at points."""
    held = world.gaussians
    with torch.no_grad():
        held.means.copy_(torch.as_tensor(means, dtype=torch.float64))
        held.pre_act_quats.copy_(torch.tensor([1.0, 0, 0, 0]))
        held.pre_act_scales.fill_(math.log(0.2))
        held.pre_act_opacities.copy_(torch.as_tensor(opacity, dtype=torch.float64).logit())
        held.colours.copy_(torch.as_tensor(colours, dtype=torch.float64))
        held.pre_act_phase.copy_(torch.as_tensor(phase, dtype=torch.float64))
        held.pre_act_plane_assignment.zero_()[:, plane] = 1
    return world


def test_transmittance_is_the_product_of_what_is_before():
    alphas = torch.rand(40, 3, 4, dtype=torch.float64)
    alphas[7, 1, 1] = 1.0
    passed = scene(1).compute_transmittance(alphas)
    expected, light = [], torch.ones(3, 4, dtype=torch.float64)
    for alpha in alphas:
        expected.append(light.where(light >= 1e-4, 0.0))
        light = light * (1 - alpha)
    torch.testing.assert_close(passed, torch.stack(expected))
    assert bool((passed[8:, 1, 1] == 0).all()) and bool((passed[-1] == 0).any())
    assert bool((scene(1).compute_transmittance(alphas[:1]) == 1).all())


def test_a_single_gaussian_is_its_projection():
    # At (x, y, z) a round Gaussian of deviation s has the covariance s²·J·Jᵀ + 0.3, J of the pinhole.
    world = place(
        scene(1), [[0.5, -0.4, 2.0]], opacity=0.7, colours=[[0.9, 0.5, 0.2]], phase=[[0.3, 1.0, 5.0]], plane=1
    )
    _, fields = world.render(camera())
    x, y, z, fx, fy = 0.5, -0.4, 12.0, 60.0, 50.0
    a, b = 0.04 * (fx / z) ** 2 * (1 + (x / z) ** 2) + 0.3, 0.04 * (fy / z) ** 2 * (1 + (y / z) ** 2) + 0.3
    c = 0.04 * fx * fy * x * y / z**4
    rows, columns = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (40, 48)), indexing="ij")
    dx, dy = columns - (24 - fx * x / z), rows - (20 - fy * y / z)
    bell = 0.7 * torch.exp(-(b * dx**2 - 2 * c * dx * dy + a * dy**2) / (2 * (a * b - c * c)))
    assert not bool(fields[0].any())
    for colour, (amplitude, phase) in enumerate(((0.9, 0.3), (0.5, 1.0), (0.2, 5.0))):
        expected = amplitude * bell * complex(math.cos(phase), math.sin(phase))
        torch.testing.assert_close(fields[1, colour], expected, rtol=0, atol=1e-12)
    assert world.mean_2D_for_planeprob.tolist() == [[pytest.approx(21.5), pytest.approx(20 + 5 / 3)]]


def test_an_antialiased_gaussian_keeps_the_sum_of_its_opacity():
    # The 0.3 square pixels make a projection larger, and its opacity as much smaller: the sum is 2π·√|Σ|.
    world = place(scene(1), [[0.5, -0.4, 2.0]], opacity=0.7, colours=[[0.9, 0.5, 0.2]])
    _, plain = world.render(camera())
    world.gaussians.antialiased = True
    _, fields = world.render(camera())
    x, y, z, fx, fy = 0.5, -0.4, 12.0, 60.0, 50.0
    a, b = 0.04 * (fx / z) ** 2 * (1 + (x / z) ** 2), 0.04 * (fy / z) ** 2 * (1 + (y / z) ** 2)
    c = 0.04 * fx * fy * x * y / z**4
    found = fields[0].abs().sum((-2, -1))
    expected = 0.7 * 2 * math.pi * math.sqrt(a * b - c * c) * torch.tensor([0.9, 0.5, 0.2], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=0)
    share = math.sqrt((a * b - c * c) / ((a + 0.3) * (b + 0.3) - c * c))
    torch.testing.assert_close(fields, share * plain)


@pytest.mark.parametrize("front", [0, 1])
def test_what_is_opaque_hides_what_is_behind(front):
    # The nearer of two Gaussians in one line of sight, opaque at its centre, is all that is seen there.
    depths = [[0.0, 0.0, -2.0], [0.0, 0.0, 3.0]]
    colours = torch.tensor([[0.2, 0.4, 0.6], [0.7, 0.8, 0.9]], dtype=torch.float64)
    world = place(scene(2), depths if front == 0 else depths[::-1], colours=colours, opacity=1.0)
    _, fields = world.render(camera())
    torch.testing.assert_close(fields[0, :, 20, 24].real, colours[front], rtol=0, atol=1e-15)
    # Off the centre it lets through what it lacks.
    near, far = (torch.exp(torch.tensor(-0.5 * 9 / (0.04 * (60 / z) ** 2 + 0.3))).double() for z in (8, 13))
    expected = colours[front] * near + colours[1 - front] * far * (1 - near)
    torch.testing.assert_close(fields[0, :, 20, 27].real, expected, rtol=1e-6, atol=0)


def test_planes_do_not_hide_each_other():
    world = place(scene(2), [[0.0, 0.0, -2.0], [0.0, 0.0, 3.0]], colours=[[1.0, 1.0, 1.0], [0.5, 0.5, 0.5]])
    with torch.no_grad():
        world.gaussians.pre_act_plane_assignment[1] = torch.tensor([0.0, 1.0])
    _, fields = world.render(camera())
    assert fields[:, 0, 20, 24].real.tolist() == pytest.approx([1.0, 0.5])


def test_order_counts_less_the_more_is_let_through():
    gaps = []
    for opacity in (1e-2, 1e-3):
        draw = torch.Generator().manual_seed(0)
        means, colours = torch.randn(40, 3, generator=draw), torch.rand(40, 3, generator=draw)
        world = place(scene(40), means, colours=colours, opacity=opacity)
        held = world.gaussians
        about = (held.pre_act_quats, held.pre_act_scales, held.pre_act_phase, held.pre_act_opacities)
        quats, scales, phase, opacities, planes = held.apply_activations(*about, held.pre_act_plane_assignment)
        depths = world.compute_depth_values(camera())
        shown = (quats, scales, held.colours, phase, opacities, planes, world.wavelengths, (48, 40))
        forward, backward = (world.splat(camera(), held.means, sign * depths, *shown)[1] for sign in (1, -1))
        gaps.append(float((forward - backward).abs().max() / forward.abs().max()))
    assert gaps[0] > 1e-3
    assert gaps[1] == pytest.approx(gaps[0] / 10, rel=0.2)


def test_splat_sorts_by_depth():
    world = scene(20)
    held = world.gaussians
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    pictures = []
    for some in (torch.arange(20), order):
        about = (held.pre_act_quats[some], held.pre_act_scales[some], held.pre_act_phase[some])
        rest = (held.pre_act_opacities[some], held.pre_act_plane_assignment[some])
        quats, scales, phase, opacities, planes = held.apply_activations(*about, *rest)
        means, depths = held.means[some], world.compute_depth_values(camera())[some]
        shown = (means, depths, quats, scales, held.colours[some], phase, opacities, planes, world.wavelengths)
        pictures.append(world.splat(camera(), *shown, (48, 40)))
    torch.testing.assert_close(pictures[0], pictures[1])
    torch.testing.assert_close(world.render(camera()), pictures[0])


@pytest.mark.parametrize("tile", [(8, 8), (7, 33), (64, 64), (0, -1), (16, 1)])
def test_tiles_do_not_change_the_picture(tile):
    world = scene(300, size=0.5)
    expected = world.render(camera(), tile_size=(48, 40))
    torch.testing.assert_close(world.render(camera(), tile_size=tile), expected, rtol=0, atol=1e-14)
    single = Scene(world.gaussians.float(), world.args_prop)
    view = PerspectiveCamera(EYE.float(), torch.tensor([0.0, 0.0, 10.0]), [60.0, 50.0], [24.0, 20.0])
    first, second = (single.render(view, tile_size=size) for size in (tile, (48, 40)))
    assert first[0].dtype == first[1].dtype == torch.complex64
    assert max(float((mine - other).abs().max()) for mine, other in zip(first, second, strict=True)) < 1e-6


def test_a_tile_is_a_part_of_the_picture():
    world = scene(60)
    held, view = world.gaussians, camera()
    _, fields = world.render(view)
    about = (held.pre_act_quats, held.pre_act_scales, held.pre_act_phase, held.pre_act_opacities)
    quats, scales, phase, opacities, planes = held.apply_activations(*about, held.pre_act_plane_assignment)
    moved = view.transform_world_to_camera_space(held.means)
    shown = (moved, moved[:, 2], quats, scales, held.colours, phase, opacities, planes)

    def tile(x, y, who):
        return world.splat_tile(
            view.R, 60.0, 50.0, 24.0, 20.0, *shown, x, y, (20, 16), who, (48, 40), world.wavelengths
        )

    everyone = torch.arange(60).flip(0)
    torch.testing.assert_close(tile(1, 0, everyone), fields[:, :, :16, 20:40])
    rim = tile(2, 2, everyone)
    assert rim.shape == (2, 3, 8, 8)
    torch.testing.assert_close(rim, fields[:, :, 32:, 40:])
    torch.testing.assert_close(tile(0, 0, everyone[:30]) + 0, tile(0, 0, torch.arange(60) >= 30))
    assert not bool(tile(0, 0, []).any())
    with pytest.raises(ValueError, match="tile_x and tile_y"):
        tile(3, 0, everyone)


@pytest.mark.parametrize("aperture", [-1, 20])
def test_the_hologram_is_the_sum_of_planes_propagated_back(aperture):
    world = scene(
        50, distances=torch.tensor([-1e-3, 0.0, 2e-3], dtype=torch.float64), num_planes=3, aperture_size=aperture
    )
    hologram, fields = world.render(camera())
    assert hologram.shape == (3, 40, 48) and fields.shape == (3, 3, 40, 48)
    mask = 1.0
    if aperture > 0:
        y, x = torch.meshgrid(torch.arange(80) - 40, torch.arange(96) - 48, indexing="ij")
        mask = (x**2 + y**2 < aperture**2).double()
    expected = torch.zeros_like(hologram)
    for plane, distance in enumerate((-1e-3, 0.0, 2e-3)):
        for colour, wavelength in enumerate(WAVELENGTHS):
            arguments = (fields[plane, colour], None, -distance, 3.74e-6, wavelength)
            expected[colour] += propagate_beam(*arguments, aperture=mask)
    torch.testing.assert_close(hologram, expected, rtol=0, atol=1e-6)
    whole = Scene(world.gaussians, Namespace(**(vars(world.args_prop) | {"aperture_size": -1}))).render(camera())[0]
    assert (float((hologram - whole).abs().max()) > 1e-2) == (aperture > 0)


def test_distances_have_a_gradient():
    distances = torch.tensor([1e-3, 2e-3], dtype=torch.float64, requires_grad=True)
    world = scene(5, distances=distances)
    hologram, _ = world.render(camera())
    (gradient,) = torch.autograd.grad(hologram.real.square().sum(), distances)
    assert bool(gradient.isfinite().all()) and bool(gradient.any())


@pytest.mark.slow
def test_the_hologram_of_a_gaussian_is_a_gaussian_beam():
    # A deviation of s pixels on the plane is the waist of a beam of radius √2·s pixels, seen from a distance.
    size, pitch, distance = 128, 4e-6, 4e-3
    changes = {"pad_size": [size, size], "pixel_pitch": pitch, "distances": [distance, 1.0]}
    world = place(scene(1, **changes), [[0.0, 0.0, 0.0]], opacity=1 - 1e-15)
    view = camera(focal=(240.0, 240.0), centre=(64.0, 64.0))
    hologram, _ = world.render(view)
    deviation = math.sqrt((0.2 * 24) ** 2 + 0.3)
    for colour, wavelength in enumerate(WAVELENGTHS):
        beam = gaussian_beam((size, size), pitch, math.sqrt(2) * deviation * pitch, -distance, wavelength)
        assert float((hologram[colour] - torch.from_numpy(beam)).abs().max()) < 3e-3
        assert float(hologram[colour].abs().square().sum()) == pytest.approx(math.pi * deviation**2, rel=1e-6)


def test_directions_and_depths():
    world = scene(12)
    turn = get_rotation_matrix([10.0, 20.0, 30.0]).double().T
    view = camera(turn, (1.0, -2.0, 9.0))
    depths = world.compute_depth_values(view)
    torch.testing.assert_close(depths, view.transform_world_to_camera_space(world.gaussians.means)[:, 2])
    directions = world.calculate_gaussian_directions(world.gaussians.means, view)
    torch.testing.assert_close(directions.norm(dim=1), torch.ones(12, dtype=torch.float64))
    seen = view.transform_world_to_camera_space(world.gaussians.means)
    # The rotation is one of single precision.
    rounding = 4 * torch.finfo(torch.float32).eps
    torch.testing.assert_close(directions @ turn, seen / seen.norm(dim=1, keepdim=True), rtol=0.0, atol=rounding)
    assert world.get_idxs_to_filter_and_sort(torch.tensor([3.0, -1.0, 0.0, 2.0])).tolist() == [2, 3, 0]


def test_a_turned_camera_sees_the_turned_world():
    turn = get_rotation_matrix(torch.tensor([15.0, -25.0, 40.0], dtype=torch.float64)).T
    still, turned = (scene(40, size=0.8) for _ in range(2))
    held = turned.gaussians
    # Quaternion of the rotation that takes a point p, as a row, to p·R.
    w = math.sqrt(1 + float(turn.trace())) / 2
    axis = [float(turn[i, j] - turn[j, i]) / (4 * w) for i, j in ((1, 2), (2, 0), (0, 1))]
    a, b = torch.tensor([w, *axis], dtype=torch.float64), held.pre_act_quats.clone()
    vector = a[0] * b[:, 1:] + b[:, :1] * a[1:] + torch.linalg.cross(a[1:].expand(40, 3), b[:, 1:])
    with torch.no_grad():
        held.means.copy_(held.means @ turn)
        held.pre_act_quats.copy_(torch.cat([a[0] * b[:, :1] - (a[1:] * b[:, 1:]).sum(1, keepdim=True), vector], dim=1))
    expected = turned.render(camera())[1]
    torch.testing.assert_close(still.render(camera(turn))[1], expected, rtol=0, atol=1e-10)
    # The older form takes R from the other side, and differs unless R is symmetric.
    plain = Scene(still.gaussians, still.args_prop, rotate_as_points=False)
    assert float((plain.render(camera(turn))[1] - expected).abs().max()) > 1e-2
    torch.testing.assert_close(plain.render(camera())[1], still.render(camera())[1])


def test_projected_covariances_are_those_of_projected_samples():
    turn = get_rotation_matrix(torch.tensor([20.0, -30.0, 50.0], dtype=torch.float64)).T
    world, view = scene(4, extent=0.5, size=0.05), camera(turn)
    held = world.gaussians
    quats, scales, *_ = held.apply_activations(*(getattr(held, f"pre_act_{n}") for n in ("quats", "scales")))
    points = view.transform_world_to_camera_space(held.means)
    projected = world._project(points, 60.0, 50.0, quats, scales, (48, 40), view) - 0.3 * torch.eye(2)
    draw = torch.Generator().manual_seed(0)
    for i, covariance in enumerate(held.compute_cov_3D(quats, scales)):
        samples = torch.randn(100_000, 3, dtype=torch.float64, generator=draw) @ torch.linalg.cholesky(covariance).T
        seen = view.transform_world_to_camera_space(held.means[i] + samples)
        found = torch.cov(held.compute_means_2D(seen, 60.0, 50.0, 24.0, 20.0).T)
        # The affine approximation leaves out terms of the order (size/distance)², 1e-4; sampling errors are below 1 %.
        assert float((found - projected[i]).norm()) < 0.02 * float(found.norm())


def test_gradients():
    world = scene(8, size=0.6)
    held = world.gaussians
    depths = world.compute_depth_values(camera())
    probabilities = torch.rand(8, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    about = (held.pre_act_quats, held.pre_act_scales, held.pre_act_phase, held.pre_act_opacities)
    quats, scales, phase, opacities, _ = held.apply_activations(*about)
    inputs = [held.means, quats, scales, held.colours, phase, opacities, probabilities]
    inputs = [value.detach().clone().requires_grad_() for value in inputs]

    def picture(means, *rest):
        hologram, fields = world.splat(camera(), means, depths, *rest, world.wavelengths, (48, 40))
        return torch.view_as_real(hologram[:, ::8, ::8]), torch.view_as_real(fields[..., 1::8, 2::8])

    torch.autograd.gradcheck(picture, inputs, fast_mode=True)
    # A choice of planes gives the planes not chosen their gradient too.
    chosen = torch.zeros(8, 2, dtype=torch.float64)
    chosen[:, 0] = 1
    chosen.requires_grad_()
    fields = picture(*inputs[:-1], chosen)[1]
    weights = torch.randn(fields.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    (slope,) = torch.autograd.grad((fields * weights).sum(), chosen)
    step = torch.zeros(8, 2, dtype=torch.float64)
    step[2, 1] = 1e-6
    ahead = [(picture(*inputs[:-1], (chosen + sign * step).detach())[1] * weights).sum() for sign in (1, -1)]
    assert float(slope[2, 1]) == pytest.approx(float((ahead[0] - ahead[1]).detach() / 2e-6), rel=1e-5)
    assert bool(slope[:, 1].all())


def test_training_moves_every_parameter_and_keeps_no_graph():
    world = scene(60)
    world.gaussians.make_trainable()
    target = scene(60, seed=5).render(camera())[0].abs()
    optimizer = torch.optim.Adam(world.gaussians.parameters(), lr=0.02)
    before = {name: value.detach().clone() for name, value in world.gaussians.named_parameters()}
    losses = []
    for _ in range(15):
        optimizer.zero_grad()
        loss = torch.nn.functional.mse_loss(world.render(camera())[0].abs(), target)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
    for name, value in world.gaussians.named_parameters():
        assert not torch.equal(value, before[name]), name
    assert not world.mean_2D_for_planeprob.requires_grad
    assert all(value.grad_fn is None for value in vars(world).values() if isinstance(value, torch.Tensor))


def test_what_is_out_of_range_is_not_seen():
    world = place(scene(3), [[0.0, 0.0, -9.5], [0.0, 0.0, -30.0], [0.0, 0.0, 995.0]])
    hologram, fields = world.render(camera())
    assert hologram.shape == (3, 40, 48) and fields.shape == (2, 3, 40, 48)
    assert not bool(hologram.any()) and not bool(fields.any())
    world.gaussians.make_trainable()
    hologram, _ = world.render(camera())
    hologram.abs().sum().backward()


def test_arguments():
    world = scene(4)
    assert repr(world) == "<Scene with 4 Gaussians>"
    assert world.wavelengths.tolist() == pytest.approx(WAVELENGTHS)
    assert world.mean_2D_for_planeprob is None
    torch.testing.assert_close(
        world.render(camera(), (48, 40), (1.0, 0.0, 0.0), (32, 32), 1, 2), world.render(camera())
    )
    one = PerspectiveCamera(
        EYE, torch.tensor([0.0, 0.0, 10.0]).double(), torch.tensor([55.0]), torch.tensor([[24.0, 20.0]])
    )
    both = camera(focal=(55.0, 55.0))
    torch.testing.assert_close(world.render(one), world.render(both))
    for call, message in (
        (lambda: world.render(camera(), (40, 48)), "img_size must be"),
        (lambda: world.render(camera(), (-1, 40)), "img_size must be two positive integers"),
        (lambda: scene(4, distances=[1e-3]).render(camera()), "1 distances and 3 wavelengths"),
        (lambda: scene(4, wavelengths=[5e-7]).render(camera()), "2 distances and 1 wavelengths"),
        (lambda: Scene(world.gaussians, Namespace(num_planes=2)), "missing wavelengths, pixel_pitch"),
        (lambda: scene(4, aperture_size=0), "aperture_size must be positive, or -1"),
        (lambda: scene(4, pixel_pitch=-1.0), "pixel_pitch"),
        (lambda: scene(4, pad_size=[3]), "pad_size"),
        (lambda: world.render(camera(focal=(1.0, 2.0, 3.0))), "camera.focal_length must be one number or two"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
