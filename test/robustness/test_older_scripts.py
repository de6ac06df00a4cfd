"""What scripts for Odak 0.2 do, at small size, in their call forms: each ends at a number.

The numbers follow from physics or from the definition of what is computed. Where there is none but that of this
library, the case says so.
"""

import math

import numpy as np
import pytest
import torch
from torch import nn

import odak
from odak import learn

pytestmark = pytest.mark.filterwarnings("ignore::odak.OdakWarning")

COLOURS = [639e-9, 515e-9, 473e-9]


def noise(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def grid(rows, columns):
    axes = torch.linspace(0, 1, rows), torch.linspace(0, 1, columns)
    return torch.meshgrid(*axes, indexing="ij")


def psnr(one, two):
    return -10 * math.log10(float(((one - two) ** 2).mean()))


def test_realistic_defocus():
    """Two planes, relayed over 0.3 m: with the released stop light can leave; without one the error stays above 0.4."""
    (y, x), size = grid(160, 200), [160, 200]
    picture = (0.35 + 0.25 * torch.sin(40 * x) * torch.cos(30 * y))[None]
    loss = learn.wave.multiplane_loss(
        target_image=picture, target_depth=(x > 0.5).float(), target_blur_size=10, number_of_planes=2, blur_ratio=3,
        weights=[1.0, 1.0, 1.0, 0.0], scheme="defocus", multiplier=1.0, device=torch.device("cpu"),
    )  # fmt: skip
    targets, _, _ = loss.get_targets()
    targets = targets[:, 0]
    optimizer = learn.wave.multiplane_hologram_optimizer(
        wavelength=515e-9, image_location=0.0, image_spacing=1e-3, slm_pixel_pitch=8e-6, slm_resolution=size,
        targets=targets, propagation_type="Bandlimited Angular Spectrum", number_of_iterations=30, learning_rate=0.1,
        number_of_planes=2, mask_limits=[0.0, 1.0, 0.0, 1.0], zero_mode_distance=0.3, loss_function=loss, seed=0,
        progress=False,
    )  # fmt: skip
    phase, amplitude, seen = optimizer.optimize()
    assert ((seen - targets) ** 2).mean() < 0.02
    assert float(seen.mean()) == pytest.approx(0.35, abs=0.06)
    torch.testing.assert_close(optimizer.reconstruct(amplitude, phase), seen)


def test_a_display_is_learned_as_one_complex_kernel():
    """Of 16 captures of a display with a defocus that nobody told, a kernel predicts captures that it has not seen."""
    shape, pitch, wavelength, distance = [24, 24], 8e-6, 515e-9, 1.2e-3
    k = odak.learn.wave.wavenumber(wavelength)
    ideal = learn.wave.get_propagation_kernel(
        shape[0], shape[1], pitch, wavelength, 1.0e-3, propagation_type="Transfer Function Fresnel"
    )
    phases = 2 * math.pi * noise(20, *shape)

    def capture(phase):
        field = learn.wave.generate_complex_field(torch.ones_like(phase), phase)
        shown = learn.wave.propagate_beam(
            field, k, distance, pitch, wavelength, "Transfer Function Fresnel", zero_padding=[False, False, False]
        )
        return learn.wave.calculate_amplitude(shown) ** 2

    images = torch.stack([capture(phase) for phase in phases])
    amplitude = learn.wave.calculate_amplitude(ideal).clone().requires_grad_()
    angle = learn.wave.calculate_phase(ideal).clone().requires_grad_()
    optimizer = torch.optim.Adam([amplitude, angle], lr=0.05)

    def predicted(phase):
        field = learn.wave.generate_complex_field(torch.ones_like(phase), phase)
        kernel = learn.wave.generate_complex_field(amplitude, angle)
        shown = learn.wave.propagate_beam(
            field, None, None, None, None, propagation_type="custom", kernel=kernel, zero_padding=[False, False, False]
        )
        return learn.wave.calculate_amplitude(shown) ** 2

    def error(numbers):
        return torch.stack([(predicted(phases[i]) - images[i]).pow(2).mean() for i in numbers]).mean()

    before = float(error(range(16, 20)).detach())
    for _ in range(60):
        optimizer.zero_grad()
        error(range(16)).backward()
        optimizer.step()
    assert float(error(range(16, 20)).detach()) < 0.02 * before


def test_multi_colour_holograms():
    """Three frames that all colours light: what the optimizer claims is what the display shows, at its powers."""
    targets = noise(2, 3, 8, 8).repeat_interleave(4, -1).repeat_interleave(4, -2)
    display = learn.wave.propagator(
        resolution=[32, 32], wavelengths=COLOURS, pixel_pitch=8e-6, resolution_factor=1, number_of_frames=3,
        number_of_depth_layers=2, volume_depth=1e-3, image_location_offset=0.0,
        propagation_type="Bandlimited Angular Spectrum", propagator_type="back and forth",
        back_and_forth_distance=0.3, method="multi-color", device=torch.device("cpu"),
    )  # fmt: skip
    optimizer = learn.wave.multi_color_hologram_optimizer(
        wavelengths=COLOURS, resolution=[32, 32], targets=targets, propagator=display, number_of_frames=3,
        number_of_depth_layers=2, learning_rate=4e-2, double_phase=True, method="multi-color",
        device=torch.device("cpu"), seed=0,
    )  # fmt: skip
    amplitudes, phases, shown, powers, _, peak = optimizer.optimize(
        number_of_iterations=40, weights={"image": 1.0, "light": 1.0, "eyebox": 0.0, "phase": 0.0}, bits=8
    )
    again = display.reconstruct(phases, amplitude=amplitudes)
    torch.testing.assert_close(again, shown, rtol=1e-4, atol=1e-5)
    levels = phases / (2 * math.pi) * 256
    torch.testing.assert_close(levels, levels.round(), rtol=0, atol=1e-2)
    # A pixel of a frame cannot be brighter on average than the light that the powers send in.
    assert (shown.mean((-1, -2)).sum((0, 1)) <= 2 * (powers**2).sum(0) * 1.001).all()
    # No published number at this size: a blank image is 4 dB.
    assert psnr(shown.sum(0) / peak, targets) > 7


def test_a_network_for_many_holograms_at_once():
    """HoloBeam's network learns two patterns by heart; its double-phase pattern keeps its values after a file."""
    torch.manual_seed(0)
    network = learn.wave.holobeam_multiholo(
        n_input=1, n_hidden=8, n_output=2, device=torch.device("cpu"), reduction="sum"
    )
    pictures, patterns = noise(2, 1, 16, 16), 2 * math.pi * noise(2, 1, 16, 16, seed=1)
    optimizer = torch.optim.AdamW(network.parameters(), lr=5e-3)
    losses = []
    for _ in range(60):
        optimizer.zero_grad()
        loss = network.evaluate(network.forward(pictures), patterns, weights=[1.0, 0.1])
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    # No published number at this size.
    assert losses[-1] < 0.5 * losses[0]


def test_metameric_holography():
    """A hologram whose picture differs from the target only where the eye does not see it."""
    y, x = grid(64, 64)
    target = (0.5 + 0.3 * torch.sin(60 * x) * torch.cos(50 * y))[None, None]
    kernel = learn.wave.get_propagation_kernel(
        64, 64, 8e-6, 515e-9, 1e-3, propagation_type="Bandlimited Angular Spectrum"
    )
    loss = learn.perception.MetamericLoss(
        device=torch.device("cpu"), alpha=0.2, real_image_width=0.3, real_viewing_distance=0.6, n_pyramid_levels=3
    )
    phase = noise(64, 64).requires_grad_()
    optimizer = torch.optim.Adam([phase], lr=0.1)
    losses = []
    for _ in range(40):
        optimizer.zero_grad()
        field = learn.wave.generate_complex_field(torch.ones_like(phase), phase)
        image = learn.wave.propagate_beam(
            field, None, None, None, None, propagation_type="custom", kernel=kernel, zero_padding=[False, False, False]
        )
        value = loss(0.5 * learn.wave.calculate_amplitude(image)[None, None] ** 2, target, gaze=[0.5, 0.5])
        value.backward()
        optimizer.step()
        losses.append(float(value.detach()))
    assert float(loss(target, target, gaze=[0.5, 0.5])) == 0.0
    assert losses[-1] < 0.2 * losses[0]


def test_a_lensless_camera():
    """Behind a circular hole of one Fresnel zone the light on the axis is four times the light that falls in."""
    wavelength, pitch, count, radius = 532e-9, 4e-6, 300, 400e-6
    distance, k = radius**2 / wavelength, 2 * 3.14 / wavelength
    steps = (torch.arange(count) - count // 2) * pitch
    hole = (steps[:, None] ** 2 + steps**2 <= radius**2).to(torch.complex64)
    flags = [True, False, True]
    # Two public scripts write the flags in the kernel's place.
    with pytest.raises(TypeError, match=r"zero_padding=\[True, False, True\]"):
        learn.wave.propagate_beam(hole, k, distance, pitch, wavelength, "Bandlimited Angular Spectrum", flags)
    seen = learn.wave.propagate_beam(
        hole, k, distance, pitch, wavelength, "Bandlimited Angular Spectrum", zero_padding=flags
    )
    light = learn.wave.calculate_amplitude(seen) ** 2
    assert float(light[count // 2, count // 2]) == pytest.approx(4, rel=0.05)


def test_an_in_line_hologram_is_focused_by_numbers():
    """The distance of a particle is where the refocused picture is darkest, to a quarter of the depth of its focus."""
    wavelength, pitch, count, radius, distance = 632.8e-9, 3.45e-6, 128, 20e-6, 5e-3
    k = odak.wave.wavenumber(wavelength)
    steps = (np.arange(count) - count // 2) * pitch
    particle = 1.0 - (steps[:, None] ** 2 + steps**2 <= radius**2).astype(complex)
    hologram = np.abs(odak.wave.propagate_beam(particle, k, distance, pitch, wavelength, "Angular Spectrum")) ** 2
    distances = distance + np.arange(-10, 11) * 1e-4
    middle = count // 2
    darkness = []
    for one in distances:
        seen = odak.wave.propagate_beam(np.sqrt(hologram) + 0j, k, -one, pitch, wavelength, "Angular Spectrum")
        darkness.append(np.abs(seen[middle - 3 : middle + 4, middle - 3 : middle + 4]).mean())
    depth = 2 * radius**2 / wavelength
    assert distances[int(np.argmin(darkness))] == pytest.approx(distance, abs=depth / 4)


def test_a_hologram_of_a_point_cloud():
    """Points that spherical waves come from are the brightest of the plane that the hologram is focused on."""
    wavelength, pitch, distance, size = 515e-9, 8e-6, 20e-3, 128
    target = torch.zeros(size, size)
    places = [(40, 40), (40, 90), (88, 64)]
    for row, column in places:
        target[row, column] = 1.0
    field = learn.wave.point_wise(target, wavelength, distance, pitch, torch.device("cpu"), lens_size=101)
    hologram = learn.wave.generate_complex_field(torch.ones(size, size), learn.wave.calculate_phase(field))
    seen = learn.wave.propagate_beam(
        hologram, None, distance, pitch, wavelength, "Bandlimited Angular Spectrum", zero_padding=[True, False, True]
    )
    light = learn.wave.calculate_amplitude(seen) ** 2
    brightest = light.flatten().topk(3).indices
    assert sorted((int(one) // size, int(one) % size) for one in brightest) == places
    assert light.flatten()[brightest].min() > 20 * light.median()


class OlderModule(nn.Module):
    """A network in the form of Lightning, which is not needed: a step, an optimizer, and whoever calls them."""

    def __init__(self):
        super().__init__()
        self.model = learn.models.unet(depth=1, dimensions=8, input_channels=2, output_channels=1)
        self.criterion = nn.MSELoss()

    def training_step(self, batch, _):
        given, wanted = batch
        return self.criterion(self.model(given), wanted)

    def configure_optimizers(self):
        optimizer = torch.optim.Adam(self.parameters(), lr=5e-3)
        return [optimizer], [torch.optim.lr_scheduler.StepLR(optimizer, 80, 0.5)]


def test_a_network_in_the_form_of_lightning():
    """It learns to halve the first of two channels, with a tenth of the error that the mean has."""
    torch.manual_seed(0)
    module, given = OlderModule(), noise(4, 2, 16, 16) * 2 - 1
    wanted = given[:, :1] / 2
    (optimizer,), (scheduler,) = module.configure_optimizers()
    for number in range(100):
        optimizer.zero_grad()
        loss = module.training_step((given, wanted), number)
        loss.backward()
        optimizer.step()
        scheduler.step()
    assert float(loss.detach()) < 0.1 * float(wanted.var())


def test_a_picture_is_trained_where_the_eye_looks():
    """Of a picture that starts grey, details come back at the gaze first: the other side may stay blurred."""
    target = noise(1, 3, 64, 96)
    loss = learn.perception.BlurLoss(
        device=torch.device("cpu"), alpha=0.6, real_image_width=0.6, real_viewing_distance=0.4, blur_source=True
    )
    picture = torch.full_like(target, 0.5).requires_grad_()
    optimizer = torch.optim.Adam([picture], lr=0.05)
    for _ in range(80):
        optimizer.zero_grad()
        loss(picture, target, gaze=[0.15, 0.5]).backward()
        optimizer.step()
    error = (picture.detach() - target).square().mean((0, 1))
    assert error[24:40, 10:19].mean() < 0.3 * error[:, -24:].mean()
    assert float(loss(target, target, gaze=[0.15, 0.5])) == 0.0


def test_homework_two_slits():
    """Fringes behind two slits are λz/d apart."""
    wavelength, pitch, count, apart, distance = 632e-9, 8e-6, 512, 16, 0.2
    k = odak.wave.wavenumber(wavelength)
    slits = np.zeros((count, count), complex)
    for place in (count // 2 - apart // 2, count // 2 + apart // 2):
        slits[:, place - 1 : place + 2] = 1
    seen = odak.wave.propagate_beam(
        slits, k, distance, pitch, wavelength, "Bandlimited Angular Spectrum", zero_padding=[True, False, True]
    )
    row = odak.wave.calculate_intensity(seen)[count // 2]
    peaks = 1 + np.flatnonzero((row[1:-1] > row[:-2]) & (row[1:-1] > row[2:]) & (row[1:-1] > 0.5 * row.max()))
    assert len(peaks) >= 3
    fringe = np.diff(peaks).mean() * pitch
    assert fringe == pytest.approx(wavelength * distance / (apart * pitch), rel=0.05)


def test_homework_gerchberg_and_saxton():
    """The error of the picture does not grow from one iteration to the next, as Fienup showed in 1982."""
    target = torch.zeros(64, 64)
    target[24:40, 24:40] = 1.0
    errors = []
    for count in (1, 4, 16):
        _, picture = learn.wave.gerchberg_saxton(
            target, count, 0.05, 8e-6, 515e-9, np.pi * 2, "Transfer Function Fresnel"
        )
        found = learn.wave.calculate_amplitude(picture)
        share = (found * target).sum() / (found**2).sum()
        errors.append(float((share * found - target).square().sum() / target.square().sum()))
    assert errors[0] >= errors[1] >= errors[2]
    assert errors[2] < 0.25


def test_speckle_is_tracked_by_a_network(tmp_path):
    """SpecTrack: three angles from five speckle patterns; a file brings back every number. No published number here."""
    torch.manual_seed(0)
    network = learn.lensless.spec_track(reduction="sum", device=torch.device("cpu"))
    assert sum(values.numel() for values in network.parameters()) == 16_260_419
    network.eval()
    patterns = noise(1, 5, 180, 320)
    with torch.no_grad():
        angles = network(patterns)
        assert float(network.evaluate(angles, angles, weights=[100.0, 1.0])) == 0.0
        network.save_weights(filename=str(tmp_path / "weights.pt"))
        torch.manual_seed(1)
        other = learn.lensless.spec_track(reduction="sum", device=torch.device("cpu"))
        other.load_weights(filename=str(tmp_path / "weights.pt"))
        assert torch.equal(other.eval()(patterns), angles)


def test_a_focal_surface():
    """The field that enters the network is that of the hologram: unit amplitude and the phase that is shown."""
    torch.manual_seed(0)
    network = learn.wave.focal_surface_light_propagation(depth=2, device=torch.device("cpu")).eval()
    hologram = noise(1, 3, 32, 32)
    field = network.generate_input_field(hologram)
    assert field.shape == (1, 6, 32, 32)
    torch.testing.assert_close(field[:, :3].square() + field[:, 3:].square(), torch.ones(1, 3, 32, 32))
    surface = noise(1, 1, 32, 32, seed=1).requires_grad_()
    assert network(surface, hologram).shape == (1, 3, 32, 32)
    # No published number at this size: the field follows the surface.
    (slope,) = torch.autograd.grad(network(surface, hologram).sum(), surface)
    assert slope.abs().max() > 0


def test_gaussian_splats():
    """A Gaussian has e^(−1/2) of its height at one width, and ten of them fit the picture of one to 35 dB."""
    points = torch.tensor([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.5, 0.5]])
    values = learn.tools.evaluate_3d_gaussians(points, centers=torch.zeros(1, 3), scales=0.5 * torch.ones(1, 3))
    relative = values.flatten() / values.flatten()[0]
    torch.testing.assert_close(relative, torch.exp(torch.tensor([0.0, -0.5, -1.0])))
    torch.manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(-1, 1, 20), torch.linspace(-1, 1, 20), indexing="ij")
    picture = torch.exp(-((x - 0.2) ** 2 + (y + 0.1) ** 2) / 0.1)
    model = learn.models.gaussians_2d(10)
    optimizer = torch.optim.AdamW(model.parameters(), lr=2e-2)
    for _ in range(300):
        optimizer.zero_grad()
        loss = nn.functional.mse_loss(model(x, y)[..., 0], picture)
        loss.backward()
        optimizer.step()
    assert psnr(model(x, y)[..., 0].detach(), picture) > 35
