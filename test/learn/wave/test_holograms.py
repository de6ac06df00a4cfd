"""Holograms: properties of the optimizers, their call forms and their errors."""

import numpy as np
import physics
import pytest
import torch
from array_api_compat import torch as torch_namespace

import odak
from odak import DeviceWarning
from odak.learn import wave
from odak.learn.tools import iterations

WAVELENGTH, DISTANCE, DX = 532e-9, 0.01, 8e-6


@pytest.fixture
def target():
    image = torch.zeros(64, 72)
    image[20:44, 24:48] = 1.0
    return image


def error(reconstruction, target):
    return torch.nn.functional.mse_loss(reconstruction.abs() ** 2, target).item()


def descend(target, **options):
    return wave.stochastic_gradient_descent(target, WAVELENGTH, DISTANCE, DX, progress=False, seed=0, **options)


@pytest.mark.parametrize("optimizer", ["adam", "lbfgs"])
def test_gradient_descent_makes_the_image(target, optimizer):
    hologram, image = descend(target, n_iteration=40, optimizer=optimizer)
    assert hologram.shape == image.shape == target.shape
    assert hologram.dtype == image.dtype == torch.complex64
    torch.testing.assert_close(hologram.abs(), torch.ones_like(target))
    assert error(image, target) < 0.25 * error(descend(target, n_iteration=1)[1], target)
    exact = physics.extrapolated_propagation(hologram.numpy(), DISTANCE, DX, WAVELENGTH)
    assert physics.relative_error(image, exact) < 1e-4


def test_lbfgs_goes_further_than_adam_in_as_many_iterations(target):
    adam, lbfgs = (error(descend(target, n_iteration=60, optimizer=name)[1], target) for name in ("adam", "lbfgs"))
    assert lbfgs < adam


def test_seed_reproduces_and_leaves_the_callers_generator_alone(target):
    torch.manual_seed(5)
    before = torch.get_rng_state()
    one, two = (descend(target, n_iteration=3)[0] for _ in range(2))
    assert torch.equal(one, two)
    assert torch.equal(before, torch.get_rng_state())
    other = wave.stochastic_gradient_descent(target, WAVELENGTH, DISTANCE, DX, n_iteration=3, seed=1, progress=False)[0]
    assert not torch.equal(one, other)


def test_initial_phase_is_used_and_not_modified(target):
    start = torch.full_like(target, 0.3)
    hologram, _ = descend(target, n_iteration=1, initial_phase=start, learning_rate=1e-6)
    torch.testing.assert_close(hologram.angle(), start, atol=1e-5, rtol=0)
    assert (start == 0.3).all()


def test_scale_finds_the_brightness(target):
    dim = 0.2 * target
    plain = descend(dim, n_iteration=60, initial_phase=torch.zeros_like(target))[1].abs() ** 2
    scaled = descend(dim, n_iteration=60, initial_phase=torch.zeros_like(target), scale=True)[1].abs() ** 2

    def best(image):
        factor = (image * dim).sum() / (image * image).sum()
        return torch.nn.functional.mse_loss(factor * image, dim).item()

    assert best(scaled) < best(plain)


def test_loss_function_callback_and_early_stop(target):
    seen, losses = [], []

    def loss(image, wanted):
        seen.append((image.shape, wanted is not None))
        return (image - wanted).abs().mean()

    def callback(iteration, value):
        losses.append(value)
        return iteration == 4

    descend(target, n_iteration=50, loss_function=loss, callback=callback)
    assert len(losses) == len(seen) == 5
    assert losses[-1] < losses[0]
    assert not losses[0].requires_grad


def test_batches_are_independent(target):
    both = torch.stack([target, target.flip(0)])
    start = torch.zeros_like(both)
    together = descend(both, n_iteration=5, initial_phase=start, loss_function=lambda a, b: ((a - b) ** 2).sum())[0]
    alone = descend(target, n_iteration=5, initial_phase=start[0], loss_function=lambda a, b: ((a - b) ** 2).sum())[0]
    torch.testing.assert_close(together[0], alone, atol=1e-4, rtol=1e-4)


def test_older_call_form_falls_back_to_the_cpu_with_a_warning(target, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.warns(DeviceWarning, match="the CPU is used instead"):
        older = wave.stochastic_gradient_descent(
            target, WAVELENGTH, DISTANCE, DX, [64, 72], "TR Fresnel", 4, learning_rate=0.1, cuda=True, seed=0,
            progress=False,
        )  # fmt: skip
    newer = descend(target, propagation_type="Transfer Function Fresnel", n_iteration=4, learning_rate=0.1)
    assert torch.equal(older[0], newer[0])
    keywords = wave.stochastic_gradient_descent(
        target, wavelength=WAVELENGTH, distance=DISTANCE, dx=DX, propagation_type="TR Fresnel", iteration_number=4,
        seed=0, progress=False,
    )  # fmt: skip
    assert torch.equal(keywords[0], newer[0])
    with pytest.raises(ValueError, match="resolution must be the target's"):
        wave.stochastic_gradient_descent(target, WAVELENGTH, DISTANCE, DX, [10, 10], "TR Fresnel", 4)


@pytest.mark.parametrize(
    ("change", "error_type", "message"),
    [
        ({"target": np.zeros((4, 4))}, TypeError, "target must be a torch.Tensor"),
        ({"target": torch.zeros(4, 4, dtype=torch.complex64)}, TypeError, "target must be a torch.Tensor of real"),
        ({"target": torch.full((4, 4), torch.nan)}, ValueError, "target must be finite"),
        ({"target": -torch.ones(4, 4)}, ValueError, "target must be finite intensities of at least 0"),
        ({"initial_phase": torch.zeros(2, 2)}, ValueError, r"initial_phase must be \[4, 4\], which fits the target"),
    ],
)
def test_bad_arguments_are_named(change, error_type, message):
    arguments = {"target": torch.zeros(4, 4), "wavelength": WAVELENGTH, "distance": DISTANCE, "pixel_pitch": DX}
    with pytest.raises(error_type, match=message):
        wave.stochastic_gradient_descent(**(arguments | {"n_iteration": 1, "progress": False} | change))


def test_gerchberg_saxton_constrains_the_hologram(target):
    hologram, image = wave.gerchberg_saxton(target.to(torch.complex64), 20, DISTANCE, DX, WAVELENGTH, seed=0)
    torch.testing.assert_close(hologram.abs(), torch.ones_like(target))
    assert hologram.dtype == torch.complex64
    assert error(image, target) < 0.5 * error(
        wave.gerchberg_saxton(target, 1, DISTANCE, DX, WAVELENGTH, seed=0)[1], target
    )
    # The phase of Fresnel's kernel is up to 0.07 rad off in the corners of this band, 0.008 on average.
    assert physics.relative_error(image, physics.unwrapped_propagation(hologram, DISTANCE, DX, WAVELENGTH)) < 0.02
    turns = []
    wave.gerchberg_saxton(
        target, 9, DISTANCE, DX, WAVELENGTH, callback=lambda turn, phase: turns.append(turn) or turn == 2
    )
    assert turns == [0, 1, 2]


def field_of_squares(hologram, distance, band=0.5, padding=2):
    """Return the field in the middles of pixels drawn with 15 × 15 samples, 9 × 9 of them lit: a fill of 9/25.

    It is propagated on a window `padding` times as large, within `band`/pitch along each axis. The sum of nine samples
    differs from the integral over a pixel by up to 0.2 % along each axis.
    """
    lit = np.kron(np.asarray(hologram), np.pad(np.ones((9, 9)), 3) / 81)
    shape = [padding * n for n in lit.shape]
    fy, fx = np.fft.fftfreq(shape[0], DX / 15)[:, None], np.fft.fftfreq(shape[1], DX / 15)
    kernel = np.exp(2j * np.pi * distance * np.sqrt(1 / WAVELENGTH**2 - fx**2 - fy**2))
    for frequency in (fy, fx):
        kernel = kernel * ((frequency * DX >= -band - 1e-9) & (frequency * DX < band - 1e-9))
    field = np.fft.ifft2(np.fft.fft2(lit, shape) * kernel)[: lit.shape[0], : lit.shape[1]]
    return 225 * field[7::15, 7::15]


def scaled_error(image, target):
    image, target = abs(np.asarray(image)) ** 2, np.asarray(target)
    return ((image * (image * target).sum() / (image**2).sum() - target) ** 2).mean()


@pytest.fixture
def soft():
    """A soft picture of 24 × 28 pixels in double precision."""
    y, x = np.mgrid[-12:12, -14:14]
    return torch.from_numpy(0.2 + np.exp(-((y / 5.0) ** 2) - ((x - 2) / 6.0) ** 2))


def test_projections_and_planes_optimizer_account_for_pixel_size(soft):
    """Pixels of three fifths of the pitch, evaluated on pixels drawn as squares."""
    distance = 1.5e-3
    options = {"propagation_type": "Angular Spectrum", "initial_phase": torch.zeros_like(soft)}
    place = (20, distance, DX, WAVELENGTH, 2 * np.pi)
    blind, _ = wave.gerchberg_saxton(soft.sqrt(), *place, **options)
    hologram, image = wave.gerchberg_saxton(soft.sqrt(), *place, **options, pixel_fill=9 / 25)
    shown = field_of_squares(hologram, distance, padding=6)
    assert physics.relative_error(image, shown) < 2e-3
    assert scaled_error(shown, soft) < 0.9 * scaled_error(field_of_squares(blind, distance), soft)
    joint = wave.gerchberg_saxton_3d(soft.sqrt()[None], 20, [distance], *place[2:], **options, pixel_fill=9 / 25)
    torch.testing.assert_close(joint, hologram, rtol=0, atol=1e-9)
    start = {"initial_phase": np.zeros(soft.shape), "pixel_fill": 9 / 25}
    core = odak.wave.gerchberg_saxton(soft.sqrt().numpy(), *place, "Angular Spectrum", **start)
    np.testing.assert_allclose(core[1], image, atol=1e-9)
    made = wave.multiplane_hologram_optimizer(
        WAVELENGTH, 1e-4, 0.0, DX, soft.shape, soft[None], propagator_type="forward", number_of_planes=1,
        number_of_iterations=1, pixel_fill=9 / 25, progress=False, seed=0, aperture="open",
    )  # fmt: skip
    phase, _, images = made.optimize()
    assert physics.relative_error(images[0], abs(field_of_squares(wave.unit_phasor(phase), 1e-4)) ** 2) < 5e-3
    with pytest.raises(ValueError, match=r"pixel_fill must be at most 1, got 1\.5"):
        wave.gerchberg_saxton(soft, *place, pixel_fill=1.5)


def test_double_phase_encodes_the_field_finite_pixels_attenuate(soft):
    made = {
        fill: wave.double_phase_hologram(soft, WAVELENGTH, 5e-4, DX, "Angular Spectrum", pixel_fill=fill)
        for fill in (None, 9 / 25)
    }
    blind, aware = (scaled_error(field_of_squares(made[fill][0], 5e-4, 0.25), soft) for fill in (None, 9 / 25))
    assert aware < blind
    phase = torch.zeros_like(soft)
    pair = [
        wave.shift_w_double_phase(phase, 5e-4, DX, WAVELENGTH, "AS", 0, amplitude=soft.sqrt(), pixel_fill=fill)
        for fill in (None, 9 / 25)
    ]
    blind, aware = (scaled_error(field_of_squares(wave.unit_phasor(own), -5e-4, 0.25), soft) for own in pair)
    assert aware < blind


def test_point_wise_focuses_each_pixel():
    target = torch.zeros(64, 65)
    target[20, 40] = target[45, 12] = 1.0
    hologram = wave.point_wise(target, WAVELENGTH, DISTANCE, DX, torch.device("cpu"), lens_size=30)
    image = wave.propagate_beam(hologram, None, DISTANCE, DX, WAVELENGTH).abs()
    peaks = image.flatten().topk(2).indices.sort().values
    assert peaks.tolist() == [20 * 65 + 40, 45 * 65 + 12]
    y, x = (torch.arange(n, dtype=torch.float64)[:, None] for n in (64, 65))
    squared = (y - 20) ** 2 + ((x - 40) ** 2).T
    lens = torch.polar(torch.ones_like(squared), -torch.pi * DX**2 * squared / (WAVELENGTH * DISTANCE))
    alone = wave.point_wise(target * (torch.arange(64)[:, None] == 20), WAVELENGTH, DISTANCE, DX, "cpu", 30)
    torch.testing.assert_close(alone.to(torch.complex128), lens * (squared <= 30**2), atol=1e-5, rtol=0)


def test_double_phase_gives_back_the_field_it_encodes():
    phase = torch.linspace(0, 1, 128)[:, None].expand(128, 128) * 2
    y, x = torch.meshgrid(torch.linspace(-1, 1, 128), torch.linspace(-1, 1, 128), indexing="ij")
    amplitude = torch.exp(-4 * (x**2 + y**2))
    encoded = wave.shift_w_double_phase(phase, 0.0, DX, WAVELENGTH, kernel_length=0, amplitude=amplitude)
    assert encoded.shape == (128, 128)
    field = torch.polar(torch.ones_like(encoded), encoded)
    # The mean of the two colours of the checkerboard is amplitude·exp(iφ): a low-pass filter sees it.
    mean = torch.nn.functional.avg_pool2d(torch.view_as_real(field).permute(2, 0, 1)[None], 2, 1)[0]
    recovered = torch.complex(mean[0], mean[1])
    expected = (amplitude * torch.polar(torch.ones_like(phase), phase - phase.mean()))[:-1, :-1]
    assert (recovered - expected).abs().max() < 0.05
    assert wave.shift_w_double_phase(phase, 1e-3, DX, WAVELENGTH).isfinite().all()


def test_slopes_of_the_double_phase():
    phase = torch.rand(4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(2), requires_grad=True)

    def encoded(phase):
        return wave.shift_w_double_phase(phase, 1e-3, DX, WAVELENGTH)

    assert torch.autograd.gradcheck(encoded, phase, fast_mode=True)


def test_normalize_phase():
    phase = torch.tensor([[1.0, 3.0], [2.0, 5.0]])
    torch.testing.assert_close(wave.normalize_phase(phase, -1.0, 1.0), torch.tensor([[-1.0, 0.0], [-0.5, 1.0]]))
    torch.testing.assert_close(wave.normalize_phase(torch.ones(2, 2)), torch.full((2, 2), torch.pi))
    with pytest.raises(ValueError, match="range_max"):
        wave.normalize_phase(phase, 1.0, 1.0)


def test_light_kernels():
    arguments = ([500e-9, 600e-9], [1e-3, 2e-3, 3e-3], [8e-6])
    amplitude, phase, kernel, parameters = wave.get_light_kernels(*arguments, resolution=[6, 8], kernel_type="fourier")
    assert kernel.shape == (2, 3, 1, 6, 8)
    assert parameters.shape == (2, 3, 1, 6, 8, 5)
    expected = wave.get_propagation_kernel(6, 8, 8e-6, 600e-9, 2e-3)
    torch.testing.assert_close(kernel[1, 1, 0], expected)
    torch.testing.assert_close(torch.polar(amplitude, phase), kernel)
    torch.testing.assert_close(parameters[1, 2, 0, 0, 0], torch.tensor([600e-9, 3e-3, 8e-6, -3 * 8e-6, -4 * 8e-6]))
    spatial = wave.get_light_kernels(*arguments, resolution=[6, 8], kernel_type="spatial")[2]
    back = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(spatial, dim=(-2, -1))), dim=(-2, -1))
    torch.testing.assert_close(back, kernel, atol=1e-5, rtol=1e-5)
    fine = wave.get_light_kernels(*arguments, resolution=[6, 8], resolution_factor=2, propagation_type="IR Fresnel")[2]
    assert fine.shape == (2, 3, 1, 12, 16)
    with pytest.raises(ValueError, match="kernel_type"):
        wave.get_light_kernels(*arguments, kernel_type="fourrier")


def test_light_kernels_have_slopes():
    lengths = [torch.tensor(v, dtype=torch.float64, requires_grad=True) for v in (8e-6, 500e-9, 2e-2)]
    pitch, wavelength, distance = lengths
    *_, kernel, parameters = wave.get_light_kernels([wavelength], [distance], [pitch], [4, 3], kernel_type="fourier")
    weights = torch.randn(4, 3, dtype=kernel.dtype, generator=torch.Generator().manual_seed(0))
    expected = wave.get_propagation_kernel(4, 3, *lengths)
    found, wanted = (torch.autograd.grad((k * weights).sum().abs(), lengths) for k in (kernel, expected))
    torch.testing.assert_close(found, wanted)
    assert torch.autograd.grad(parameters.sum(), pitch)[0].item() == pytest.approx(12)


@pytest.mark.parametrize("retrieve", ["gerchberg_saxton", "add_random_phase"])
def test_what_makes_a_random_start(target, retrieve):
    def start(seed=None):
        field = torch.complex(target, torch.zeros(64, 72))
        if retrieve == "add_random_phase":
            return wave.add_random_phase(field, seed)
        return wave.gerchberg_saxton(field, 1, DISTANCE, DX, WAVELENGTH, seed=seed, progress=False)[0]

    starts = []
    for _ in range(2):
        torch.manual_seed(1)
        starts.append((start(), start(3), start(torch.Generator().manual_seed(4))))
    for first, again in zip(*starts, strict=True):
        torch.testing.assert_close(first, again, rtol=0, atol=0)
    assert not torch.equal(starts[0][0], starts[0][1]) and not torch.equal(starts[0][1], starts[0][2])
    with pytest.raises(TypeError, match="seed must be an integer or a numpy"):
        odak.wave.add_random_phase(np.ones((2, 2)), torch.Generator())


def test_gradient_descent_within_inference_mode(target):
    arguments = (WAVELENGTH, DISTANCE, DX)
    plain = wave.stochastic_gradient_descent(target, *arguments, n_iteration=3, seed=0, progress=False)[0]
    with torch.inference_mode():
        inside = wave.stochastic_gradient_descent(target.clone(), *arguments, n_iteration=3, seed=0, progress=False)[0]
    torch.testing.assert_close(inside, plain, rtol=0, atol=0)
    assert not torch.is_inference_mode_enabled()


def test_older_form_takes_a_resolution_of_any_kind(target):
    for resolution in ([64, 72], np.array([64, 72]), torch.Size([64, 72])):
        hologram, _ = wave.stochastic_gradient_descent(
            target, WAVELENGTH, DISTANCE, DX, resolution, "TR Fresnel", 1, progress=False
        )
        assert hologram.shape == (64, 72)


def test_utilities_on_the_face_of_torch():
    assert isinstance(wave.wavenumber([5e-7, 6e-7]), torch.Tensor)
    assert wave.rotationspeed([5e-4]).item() == pytest.approx(2 * np.pi * 3e11 / 5e-4)
    assert wave.rayleigh_resolution(torch.tensor(5.0)).item() == pytest.approx(1.22 * 0.0005 / 5)
    angle = torch.tensor(0.7, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(
        lambda a: odak.wave.prism_grating(3, 4, 1e5, a, 8e-6, xp=torch_namespace), angle, fast_mode=True
    )
    assert wave.prism_grating(3, 4, 1e5, angle, 8e-6).requires_grad
    for name in ("dx", "wavelength", "distance"):
        with pytest.raises(ValueError, match=f"{name} must be one number"):
            wave.get_seperable_impulse_response_fresnel_kernel(
                4, 4, **{"distance": 1e-3, name: torch.tensor([1e-5] * 2)}
            )


def test_separable_kernel_parts_multiply_to_the_response():
    kernel, response, h_x, h_y = wave.get_seperable_impulse_response_fresnel_kernel(
        6, 9, distance=0.1, scale=2, aperture_samples=(4, 3, 2, 1), dtype=torch.complex128
    )
    assert h_x.shape == (18,)
    assert h_y.shape == (12,)
    constant = response[6, 9] / (h_y[6] * h_x[9])
    torch.testing.assert_close(response, constant * h_y[:, None] * h_x[None])
    spectrum = torch.fft.fftshift(torch.fft.fft2(torch.fft.ifftshift(response))) * 3.74e-6**2
    torch.testing.assert_close(kernel, spectrum)


def test_point_wise_kernel_is_the_fresnel_sum(monkeypatch):
    generator = torch.Generator().manual_seed(0)
    sources = torch.rand(7, 3, generator=generator, dtype=torch.float64) * 1e-4
    targets = torch.rand(2 * 2 * 3 * 2, 2, generator=generator, dtype=torch.float64) * 1e-4
    field = torch.randn(7, dtype=torch.complex128, generator=generator)
    kept = targets.clone()
    arguments = (sources, field, targets, [2, 3])
    result = wave.get_point_wise_impulse_response_fresnel_kernel(*arguments, 2, WAVELENGTH, 0.05)
    squared = ((targets[:, None] - sources[None, :, :2]) ** 2).sum(-1)
    expected = (torch.exp(1j * torch.pi * squared / (WAVELENGTH * 0.05)) @ field) / (1j * WAVELENGTH * 0.05)
    torch.testing.assert_close(result, expected.reshape(4, 6))
    jittered = wave.get_point_wise_impulse_response_fresnel_kernel(
        *arguments, 2, WAVELENGTH, 0.05, randomization=True, generator=generator
    )
    assert not torch.allclose(jittered, result)
    assert torch.equal(targets, kept)
    with pytest.raises(ValueError, match="target_points must contain 6 points"):
        wave.get_point_wise_impulse_response_fresnel_kernel(*arguments, distance=0.05)


def test_a_modulator_of_finer_samples_is_refused(target):
    slm = wave.spatial_light_modulator(samples_per_pixel=2)
    with pytest.raises(ValueError, match="slm must have one sample per pixel"):
        wave.stochastic_gradient_descent(target, WAVELENGTH, DISTANCE, DX, slm=slm, progress=False)


def test_adam_is_torchs_adam():
    generator = torch.Generator().manual_seed(0)
    start, weights = (torch.randn(5, 4, dtype=torch.float64, generator=generator) for _ in range(2))
    ours, theirs = start.clone().requires_grad_(), start.clone().requires_grad_()
    reference = torch.optim.Adam([theirs], lr=0.05)

    @torch.enable_grad()
    def gradient(phase):
        phase.grad = None
        loss = (weights * torch.cos(3 * phase)).sum()
        loss.backward()
        return loss

    solver = iterations.Adam([ours])
    for _ in range(12):
        assert solver.step(lambda: gradient(ours).detach(), 0.05) == pytest.approx(
            reference.step(lambda: gradient(theirs)).item()
        )
    torch.testing.assert_close(ours, theirs)


def test_gradients_are_taken_even_where_caller_switched_them_off(target):
    with torch.no_grad():
        inside = descend(target, n_iteration=3)[0]
    assert torch.equal(inside, descend(target, n_iteration=3)[0])


def test_lbfgs_moves_on_large_pictures_and_reports_the_mean():
    picture = torch.rand(200, 300, generator=torch.Generator().manual_seed(0))
    losses = []
    image = descend(
        picture,
        n_iteration=8,
        optimizer="lbfgs",
        scale=True,
        initial_phase=torch.zeros_like(picture),
        callback=lambda _, loss: losses.append(loss.item()),
    )[1]
    assert losses[-1] < 0.7 * losses[0]
    # A flat hologram lights the picture evenly, so that the first loss is about the picture's variance.
    assert losses[0] == pytest.approx(picture.var().item(), rel=0.2)
    assert image.isfinite().all()


def test_gerchberg_saxton_takes_arguments_of_gradient_descent(target):
    own = wave.gerchberg_saxton(target.sqrt(), 3, DISTANCE, DX, WAVELENGTH, propagation_type="TR Fresnel", seed=1)
    place = (target, WAVELENGTH, DISTANCE, DX)
    with pytest.warns(odak.ArgumentWarning, match="no use for learning_rate"):
        older = wave.gerchberg_saxton(*place, [64, 72], "TR Fresnel", 3, learning_rate=0.1, cuda=False, seed=1)
    present = wave.gerchberg_saxton(*place, "TR Fresnel", 3, seed=1)
    named = wave.gerchberg_saxton(
        target=target, wavelength=WAVELENGTH, distance=DISTANCE, pixel_pitch=DX, propagation_type="TR Fresnel",
        n_iteration=3, progress=False, seed=1,
    )  # fmt: skip
    for other in (older, present, named):
        assert torch.equal(other[0], own[0])
    with pytest.raises(ValueError, match="resolution must be the field's"):
        wave.gerchberg_saxton(*place, [10, 10], "TR Fresnel", 3)
    with pytest.raises(TypeError, match="more than one value"):
        wave.gerchberg_saxton(*place, "TR Fresnel", 3, dx=DX)


def test_gerchberg_saxton_leaves_the_random_state_alone(target):
    state = torch.random.get_rng_state()
    for seed in (3, np.random.default_rng(3), torch.Generator().manual_seed(3)):
        wave.gerchberg_saxton(target, 2, DISTANCE, DX, WAVELENGTH, seed=seed)
        wave.weighted_gerchberg_saxton(target, 2, seed=seed)
    assert torch.equal(state, torch.random.get_rng_state())


def test_gerchberg_saxton_by_keywords():
    field = torch.rand(16, 16) + 0j
    named = wave.gerchberg_saxton(field=field, n_iterations=2, distance=1e-3, dx=8e-6, wavelength=532e-9, seed=1)
    placed = wave.gerchberg_saxton(field, 2, 1e-3, 8e-6, 532e-9, seed=1)
    assert torch.equal(named[0], placed[0])
