"""Choices with a gradient; flat complex Gaussians: parameters, fields against the double sum, files, a hologram."""

import math
import os
import pickle
from argparse import Namespace
from importlib.resources import files

import pytest
import torch
from physics import gaussian_beam

import odak
from odak.learn.tools import load_image
from odak.learn.wave import (
    Scene2D,
    STEFunction,
    StraightThroughEstimator,
    complex_2d_gaussians,
    complex_gaussians,
    propagate_beam,
)
from odak.learn.wave.gaussians import sets

WAVELENGTHS = [639e-9, 532e-9, 473e-9]
NAMES = ["means_2d", "pre_act_scales", "pre_act_rotation", "colours", "pre_act_phase", "pre_act_opacities"]


def settings(**changes):
    return Namespace(**({"wavelengths": WAVELENGTHS, "pad_size": [30, 41]} | changes))


def gaussians(number=20, size=(32, 24), seed=0, **options):
    """Return Gaussians in double precision, with phases."""
    result = complex_2d_gaussians(number, size, "cpu", seed=seed, **options).double()
    with torch.no_grad():
        result.pre_act_phase.normal_(generator=torch.Generator().manual_seed(seed)).mul_(4)
    return result


def test_the_choice_and_its_gradient():
    values = torch.tensor([[0.3, 0.1, 0.2], [-1.0, 2.0, 2.0]], dtype=torch.float64, requires_grad=True)
    chosen = STEFunction.apply(values, 0.2)
    assert chosen.tolist() == [[1, 0, 0], [0, 1, 0]]
    slope = torch.tensor([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]], dtype=torch.float64)
    (gradient,) = torch.autograd.grad(chosen, values, slope)
    weights = (values.detach() / 0.2).exp()
    torch.testing.assert_close(gradient, slope * weights / weights.sum(1, keepdim=True))
    estimator = StraightThroughEstimator(0.2)
    assert not list(estimator.parameters())
    (again,) = torch.autograd.grad(estimator(values), values, slope)
    torch.testing.assert_close(again, gradient)
    # The default is so sharp that the gradient goes to the largest alone.
    for default in (StraightThroughEstimator(), STEFunction.apply):
        (sharp,) = torch.autograd.grad(default(values[:1]), values, slope[:1])
        torch.testing.assert_close(sharp[0], torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64))
    with pytest.raises(ValueError, match="temperature"):
        StraightThroughEstimator(0.0)
    with pytest.raises(ValueError, match=r"x must be \[n, 1 or more\]"):
        estimator(torch.zeros(3))


def test_all_names_are_in_the_module():
    from odak.learn import wave

    for name in ("STEFunction", "StraightThroughEstimator", "complex_3d_gaussians", "Scene", "complex_2d_gaussians"):
        assert getattr(wave, name) is getattr(complex_gaussians, name)


def test_first_parameters():
    model = complex_2d_gaussians(5000, (32, 24), "cpu", seed=3)
    assert [name for name, _ in model.named_parameters()] == NAMES
    assert list(model.state_dict()) == NAMES
    assert not any(parameter.requires_grad for parameter in model.parameters())
    assert len(model) == 5000
    means = model.means_2d.tanh()
    assert float(means.abs().max()) == pytest.approx(0.999, abs=1e-4)
    assert float(means.std()) == pytest.approx(3**-0.5, rel=0.03)
    scales = model.pre_act_scales.exp()
    assert 1.5 <= float(scales.min()) < 1.51 and 4.99 < float(scales.max()) <= 5.0
    assert float(model.pre_act_rotation.abs().max()) == pytest.approx(math.pi, abs=0.01)
    assert float(model.colours.mean()) == pytest.approx(0.5, abs=0.02)
    assert not bool(model.pre_act_phase.any())
    assert model.pre_act_opacities.unique().tolist() == [-0.5]
    same = complex_2d_gaussians(5000, (32, 24), "cpu", seed=3)
    assert torch.equal(same.means_2d, model.means_2d)
    torch.manual_seed(1)
    assert not torch.equal(complex_2d_gaussians(5000, (32, 24), "cpu").means_2d, model.means_2d)


@pytest.mark.parametrize(("number", "size"), [(0, (4, 4)), (3, (0, 4)), (3, (4,)), (3, 4), (3, "ab")])
def test_what_is_refused(number, size):
    with pytest.raises(ValueError, match="num_points" if not number else "img_size"):
        complex_2d_gaussians(number, size, "cpu")


def test_activations():
    model = gaussians(7)
    with torch.no_grad():
        model.pre_act_phase[0] = torch.tensor([-1e-20, 2 * math.pi, -math.pi / 2])
        model.means_2d[:3] = torch.tensor([[0.0, 0.0], [20.0, -20.0], [-20.0, 20.0]])
    scales, rotation, phase, opacities, means = model.apply_activations()
    torch.testing.assert_close(scales, model.pre_act_scales.exp() + 0.1)
    assert rotation is model.pre_act_rotation
    torch.testing.assert_close(torch.exp(1j * phase), torch.exp(1j * model.pre_act_phase))
    assert bool(((phase >= 0) & (phase < 2 * math.pi)).all())
    assert float(phase[0, 2]) == pytest.approx(1.5 * math.pi)
    torch.testing.assert_close(opacities, torch.full((7,), 1 / (1 + math.exp(0.5)), dtype=torch.float64))
    assert means[:3].tolist() == [[16, 12], [32, 0], [0, 24]]
    assert bool((gaussians(7, merge_opacity=True).apply_activations()[3] == 1).all())
    # In single precision a tiny negative phase would be rounded up to 2π.
    tiny = torch.tensor([-1e-9, 1.0], requires_grad=True)
    wrapped = sets.wrapped(tiny)
    assert wrapped.tolist() == [0, 1]
    assert torch.autograd.grad(wrapped.sum(), tiny)[0].tolist() == [1, 1]


def test_covariances():
    model = gaussians(9)
    scales, rotation = model.apply_activations()[:2]
    c00, c01, c11 = model.compute_cov_2D(scales, rotation)
    matrix = torch.stack([c00, c01, c01, c11], -1).view(-1, 2, 2)
    turn = torch.stack([rotation.cos(), -rotation.sin(), rotation.sin(), rotation.cos()], -1).view(-1, 2, 2)
    expected = turn @ torch.diag_embed(scales**2) @ turn.mT + 0.1 * torch.eye(2)
    torch.testing.assert_close(matrix, expected)
    inverse = torch.stack(model.invert_cov_2D(c00, c01, c11), -1)[:, [0, 1, 1, 2]].view(-1, 2, 2)
    torch.testing.assert_close(inverse @ matrix, torch.eye(2, dtype=torch.float64).expand(9, 2, 2))
    flat = torch.tensor([1.0]), torch.tensor([1.0]), torch.tensor([1.0])
    assert float(model.invert_cov_2D(*flat)[0]) == pytest.approx(1e10)


def double_sum(model, width, height):
    """Return the field by the formula, one Gaussian after another."""
    scales, rotation, phase, opacities, means = model.apply_activations()
    y, x = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in (height, width)), indexing="ij")
    field = torch.zeros(3, height, width, dtype=torch.complex128)
    for n in range(len(model)):
        inverse = model.invert_cov_2D(*(c[n] for c in model.compute_cov_2D(scales, rotation)))
        dx, dy = x - means[n, 0], y - means[n, 1]
        m = inverse[0] * dx**2 + 2 * inverse[1] * dx * dy + inverse[2] * dy**2
        bell = opacities[n] * torch.exp(torch.clamp(-m / 2, min=-50))
        field = field + (model.colours[n] * torch.exp(1j * phase[n]))[:, None, None] * bell
    return field


@pytest.mark.parametrize("number", [1, 40])
@pytest.mark.parametrize("merged", [True, False])
def test_the_field_is_the_double_sum(number, merged):
    model = gaussians(number, merge_opacity=merged)
    field = Scene2D(model, settings()).render((32, 24))
    assert field.shape == (3, 30, 41)
    expected = torch.zeros(3, 30, 41, dtype=torch.complex128)
    # Sample n // 2 is the centre before and after.
    expected[:, 3:27, 4:36] = double_sum(model, 32, 24)
    torch.testing.assert_close(field, expected, rtol=0, atol=1e-13)
    single = Scene2D(model.float(), settings()).render((32, 24))
    assert single.dtype == torch.complex64
    assert float((single - expected).abs().max()) < 1e-4


def test_gradients_reach_every_parameter():
    model = gaussians(6, (7, 5))
    model.make_trainable()
    scene = Scene2D(model, settings(pad_size=[5, 7]))
    names = [name for name, _ in model.named_parameters()]

    def field(*values):
        for name, value in zip(names, values, strict=True):
            delattr(model, name)
            setattr(model, name, value)
        return torch.view_as_real(scene.render((7, 5))[:, 1::2, ::3])

    values = [parameter.detach().clone().requires_grad_() for parameter in model.parameters()]
    torch.autograd.gradcheck(field, values, fast_mode=True)
    for gradient in torch.autograd.grad(field(*values).square().sum() + field(*values).sum(), values):
        assert bool(gradient.any(-1).all() if gradient.ndim > 1 else gradient.all())


def test_training_switch():
    model = complex_2d_gaussians(4, (8, 8), "cpu")
    model.make_trainable()
    assert all(parameter.requires_grad for parameter in model.parameters())
    merged = complex_2d_gaussians(4, (8, 8), "cpu", merge_opacity=True)
    merged.make_trainable()
    assert [name for name, p in merged.named_parameters() if not p.requires_grad] == ["pre_act_opacities"]


def test_scene():
    model = gaussians(4)
    scene = Scene2D(model, settings(wavelengths=torch.tensor(WAVELENGTHS)))
    assert repr(scene) == "<Scene2D with 4 Gaussians>"
    assert scene.wavelengths.shape == (3,)
    pixels = scene.get_pixel_grid((4, 3))
    assert pixels.shape == (1, 12, 2)
    assert pixels[0, :5].tolist() == [[0, 0], [1, 0], [2, 0], [3, 0], [0, 1]]
    assert scene.get_pixel_grid((4, 3)) is pixels
    for wrong, message in (
        (Namespace(wavelengths=WAVELENGTHS), "missing pad_size"),
        (None, "args_prop must have"),
        (settings(pad_size=[4]), "pad_size"),
        (settings(wavelengths=[-1.0]), "wavelengths must be positive"),
        (settings(wavelengths=[5e-7] * 4), "one for each of the 3 colours of the Gaussians, got 4"),
    ):
        with pytest.raises(ValueError, match=message):
            Scene2D(model, wrong)
    with pytest.raises(ValueError, match="img_size must fit into pad_size"):
        scene.render((32, 31))


def test_a_gaussian_is_a_gaussian_beam():
    # A Gaussian of standard deviation s pixels is the waist of a beam of radius √2·s pixels.
    size, pitch, wavelength, distance = 128, 4e-6, 532e-9, 4e-3
    model = complex_2d_gaussians(1, (size, size), "cpu", merge_opacity=True).double()
    deviation = math.sqrt((math.exp(1.5) + 0.1) ** 2 + 0.1)
    with torch.no_grad():
        model.means_2d.zero_()
        model.pre_act_scales.fill_(1.5)
        model.colours.fill_(1.0)
        model.pre_act_phase.fill_(0.7)
    field = Scene2D(model, settings(pad_size=[size, size])).render((size, size))[1]
    beam = gaussian_beam((size, size), pitch, math.sqrt(2) * deviation * pitch, distance, wavelength)
    result = propagate_beam(field, None, distance, pitch, wavelength)
    expected = torch.from_numpy(beam) * complex(math.cos(0.7), math.sin(0.7))
    # The beam is paraxial: its divergence is 0.013 rad, whose square sets the difference.
    assert float((result - expected).abs().max()) < 2e-3
    assert float(result.abs().square().sum()) == pytest.approx(float(field.abs().square().sum()), rel=1e-6)
    assert float(field.abs().square().sum()) == pytest.approx(math.pi * deviation**2, rel=1e-6)


@pytest.mark.parametrize("extension", ["pth", "pt"])
def test_files(tmp_path, logged, extension):
    model, path = gaussians(5, merge_opacity=True), tmp_path / f"g.{extension}"
    other = gaussians(5, seed=1)
    means = other.means_2d
    model.save_gaussians(path)
    other.load_gaussians(path)
    assert logged.text.count(str(path)) == 2
    assert other.means_2d is means
    assert other.merge_opacity
    for name in NAMES:
        assert torch.equal(getattr(model, name), getattr(other, name))
    held = torch.load(path, weights_only=True)
    assert sorted(held) == sorted([*NAMES, "img_size", "merge_opacity"])
    with pytest.raises(ValueError, match="not allowed"):
        model.save_gaussians(tmp_path / "g.txt")


def test_files_that_do_not_fit(tmp_path, capsys):
    model, path = gaussians(5), tmp_path / "g.pth"
    model.save_gaussians(path)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with pytest.raises(ValueError, match="means_2d of shape"):
        gaussians(6).load_gaussians(path)
    with pytest.raises(ValueError, match=r"picture of \(32, 24\), not of \(24, 32\)"):
        gaussians(5, (24, 32)).load_gaussians(path)
    held = torch.load(path, weights_only=True)
    torch.save({name: held[name] for name in NAMES[1:]}, path)
    with pytest.raises(ValueError, match="missing means_2d"):
        model.load_gaussians(path)
    torch.save([1], path)
    with pytest.raises(ValueError, match="contains no Gaussians"):
        model.load_gaussians(path)
    with pytest.raises(FileNotFoundError):
        model.load_gaussians(tmp_path / "nothing.pth")
    # A file without the size, of an older writer.
    torch.save({name: held[name] for name in NAMES}, path)
    model.load_gaussians(path)
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())
    assert capsys.readouterr().out == ""


class _Command:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


def test_broken_and_hostile_files_are_refused(tmp_path):
    model, path = gaussians(5), tmp_path / "g.pth"
    model.save_gaussians(path)
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"nonsense", pickle.dumps(_Command(tmp_path / "done"))):
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"g\.pth"):
            model.load_gaussians(path)
    torch.save({name: _Command(tmp_path / "done") for name in NAMES}, path)
    with pytest.raises(ValueError, match=r"g\.pth"):
        model.load_gaussians(path)
    assert not (tmp_path / "done").exists()


@pytest.mark.slow
def test_a_hologram_is_fitted():
    picture = load_image(str(files("odak") / "assets" / "photo.png"), torch_style=True)
    target = torch.nn.functional.interpolate(picture[None], (64, 64), mode="area")[0]
    model = complex_2d_gaussians(1000, (64, 64), "cpu", seed=0)
    model.make_trainable()
    with torch.no_grad():
        model.colours.mul_(0.2)
    scene = Scene2D(model, settings(pad_size=[64, 64]))
    wavelengths = torch.tensor(WAVELENGTHS, dtype=torch.float64)
    optimizer = torch.optim.Adam(model.parameters(), lr=0.03)
    scheduler = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, 400)
    for _ in range(400):
        optimizer.zero_grad()
        seen = propagate_beam(scene.render((64, 64)), None, 1e-3, 8e-6, wavelengths).abs().square()
        loss = torch.nn.functional.mse_loss(seen, target)
        loss.backward()
        optimizer.step()
        scheduler.step()
    assert -10 * math.log10(float(loss.detach())) > 30


def test_a_choice_may_be_masked():
    assert STEFunction.apply(torch.tensor([[1.0, float("-inf")]])).tolist() == [[1.0, 0.0]]
    assert STEFunction.apply(torch.tensor([[1.0, float("nan")]])).isnan().any()


@pytest.mark.parametrize(("count", "used"), [(1, "colour 0 is used"), (2, "colours 0 to 1 are used")])
def test_fewer_wavelengths_than_colours_take_the_first(count, used):
    model = complex_2d_gaussians(4, (32, 24), "cpu", seed=2)
    whole = Scene2D(model, settings()).render((32, 24))
    with pytest.warns(odak.ArgumentWarning, match=f"{count} for 3 colours of the Gaussians: {used}"):
        scene = Scene2D(model, settings(wavelengths=WAVELENGTHS[:count]))
    torch.testing.assert_close(scene.render((32, 24)), whole[:count])


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_field_for_each_wavelength(count):
    model = complex_2d_gaussians(4, (32, 24), "cpu", seed=2, channels=count)
    wavelengths = [4e-7 + 1e-7 * i for i in range(count)]
    field = Scene2D(model, settings(wavelengths=wavelengths)).render((32, 24))
    assert field.shape == (count, 30, 41)
    one = complex_2d_gaussians(4, (32, 24), "cpu", seed=2, channels=1)
    with torch.no_grad():
        for name, value in model.named_parameters():
            last = name in ("colours", "pre_act_phase")
            getattr(one, name).copy_(value[:, -1:] if last else value)
    alone = Scene2D(one, settings(wavelengths=wavelengths[-1:])).render((32, 24))
    torch.testing.assert_close(field[-1:], alone)
