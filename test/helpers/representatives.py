"""A few functions and modules of every family, each from one real tensor to one real tensor, for tests of them all."""

import torch
from torch import nn
from torch.utils.data import Dataset

from odak.learn import jones, lensless, models, perception, raytracing, wave
from odak.learn.raytracing import system

WAVELENGTH, DX, DISTANCE = 532e-9, 8e-6, 2e-3
SIDE = 24


def pattern(*shape, seed=1, dtype=torch.float32):
    """Return numbers between 0 and 1."""
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64).to(dtype)


class Propagation(nn.Module):
    """Intensity that a phase pattern sends to a plane."""

    def __init__(self, method, distance=DISTANCE):
        super().__init__()
        self.method, self.distance = method, distance

    def forward(self, phase):
        if self.method == "Incoherent Angular Spectrum":
            return wave.propagate_beam(phase, None, self.distance, DX, WAVELENGTH, self.method)
        field = wave.unit_phasor(phase)
        return wave.intensity(wave.propagate_beam(field, None, self.distance, DX, WAVELENGTH, self.method))


class Propagator(nn.Module):
    """Intensities that a display shows on two planes in three colours."""

    def __init__(self):
        super().__init__()
        self.display = wave.propagator((SIDE, SIDE), [639e-9, 515e-9, 473e-9], DX, 1, 1, 2, aperture="open")

    def forward(self, phase):
        return self.display.reconstruct(phase[None], no_grad=False)


class Loss(nn.Module):
    """Loss of a picture against one that is held."""

    def __init__(self, loss, side=SIDE, channels=3):
        super().__init__()
        self.loss = loss
        self.register_buffer("target", pattern(1, channels, side, side, seed=2))

    def forward(self, image):
        return self.loss(image, self.target.to(image.dtype))


def lens(focal):
    """Return the phase of a lens, its focal length in decimetres."""
    return wave.lens_phase((SIDE, SIDE), focal / 10, DX, WAVELENGTH)


def sphere(center):
    """Return rays refracted at a sphere near some place."""
    rays = raytracing.create_ray_from_two_points(
        torch.zeros(1, 3, dtype=center.dtype),
        torch.tensor([[0.0, 0.0, 5.0], [0.3, 0.2, 5.0], [-0.4, 0.1, 5.0]], dtype=center.dtype),
    )
    surface = torch.cat([0.2 * center + center.new_tensor([0.0, 0.0, 5.0]), torch.ones_like(center[:1])])
    normals, *_ = raytracing.intersect_w_sphere(rays, surface)
    return raytracing.refract(rays, normals, 1.0, 1.5)


def waveplates(angle):
    """Return the Stokes vector behind two wave plates, the second at an angle in degrees."""
    chain = jones.cascade(jones.quarter_wave_plate(20.0, dtype=torch.complex64), jones.half_wave_plate(angle))
    return jones.stokes(jones.apply_matrix(chain, jones.electricfield(1.0, 0.5j)))


class Spot(nn.Module):
    """Spots of a triplet with these curvatures."""

    def __init__(self):
        super().__init__()
        self.triplet = system.load_system("cooke_triplet")

    def forward(self, curvature):
        numbers = self.triplet.prescription()._replace(curvature=curvature)
        return system.rms_spot(self.triplet, "rings", 3, prescription=numbers)


def _seeded(make):
    torch.manual_seed(5)
    return make().eval()


PICTURE = (1, 3, SIDE, SIDE)
LARGE = (1, 3, 64, 64)


def _losses():
    return {
        "MetamericLoss": (lambda: Loss(perception.MetamericLoss(n_pyramid_levels=3), 64), LARGE),
        "MetamericLossUniform": (
            lambda: Loss(perception.MetamericLossUniform(n_pyramid_levels=3, pooling_size=8), 64),
            LARGE,
        ),
        "MetamerMSELoss": (lambda: Loss(perception.MetamerMSELoss(n_pyramid_levels=3, iterations=2), 64), LARGE),
        "BlurLoss": (lambda: Loss(perception.BlurLoss(), 64), LARGE),
        "CSFLoss": (lambda: Loss(perception.CSFLoss(), 64), LARGE),
        "CVDLoss": (lambda: perception.CVDLoss(), PICTURE),
        "PSNR": (lambda: Loss(perception.PSNR()), PICTURE),
        "SSIM": (lambda: Loss(perception.SSIM()), PICTURE),
    }


def _networks():
    return {
        "multi_layer_perceptron": (lambda: models.multi_layer_perceptron([6, 8, 3], bias=True), (5, 6)),
        "siren": (lambda: models.multi_layer_perceptron([6, 8, 3], bias=True, model_type="siren"), (5, 6)),
        "unet": (lambda: models.unet(depth=2, dimensions=4, input_channels=3, output_channels=3), PICTURE),
        "residual_layer": (lambda: models.residual_layer(input_channels=3, mid_channels=4), PICTURE),
        "non_local_layer": (lambda: models.non_local_layer(3, 2), PICTURE),
        "convolutional_block_attention": (lambda: models.convolutional_block_attention(3, 1), PICTURE),
        "positional_encoder": (lambda: models.positional_encoder(3), (5, 6)),
        "holobeam_multiholo": (lambda: wave.holobeam_multiholo(1, 4, 2), (1, 1, SIDE, SIDE)),
    }


def _colours():
    names = (
        "rgb_to_linear_rgb linear_rgb_to_rgb rgb_2_ycrcb ycrcb_2_rgb rgb_to_hsv hsv_to_rgb linear_rgb_to_xyz "
        "srgb_to_lab simulate_color_vision_deficiency pq_encode"
    )
    return {name: (lambda name=name: getattr(perception, name), PICTURE) for name in names.split()}


def _waves():
    methods = (
        "Bandlimited Angular Spectrum",
        "Transfer Function Fresnel",
        "Impulse Response Fresnel",
        "Incoherent Angular Spectrum",
        "Fraunhofer",
        "Rayleigh-Sommerfeld",
        "Adaptive Sampling Angular Spectrum",
    )
    return {
        **{name: (lambda name=name: Propagation(name), (SIDE, SIDE)) for name in methods},
        "propagator": (Propagator, (SIDE, SIDE)),
        "lens_phase": (lambda: lens, ()),
    }


FAMILIES = {
    "propagation": _waves(),
    "perception": _losses(),
    "colour": _colours(),
    "rays": {"rms_spot": (Spot, None), "intersect_w_sphere, refract": (lambda: sphere, (3,))},
    "networks": _networks(),
    "polarisation": {"wave plates": (lambda: waveplates, ())},
}
ALL = {name: (family, *entry) for family, entries in FAMILIES.items() for name, entry in entries.items()}
TRACKER = (lambda: lensless.spec_track().network, (1, 5, 256, 256))


def representative(name, dtype=torch.float32):
    """Return a function or module and an example of what it takes."""
    _, make, shape = ALL[name]
    function = make()
    if isinstance(function, nn.Module):
        function = _seeded(make)
        function.to(dtype)
    if name == "rms_spot":
        return function, function.triplet.prescription().curvature
    return function, pattern(*shape, dtype=dtype)


class Holograms(Dataset):
    """Phase patterns and what they show: propagation, colour, a loss and rays inside the worker."""

    def __len__(self):
        return 4

    def __getitem__(self, index):
        field = torch.polar(torch.ones(16, 16), pattern(16, 16, seed=index))
        light = wave.propagate_beam(field, None, 1e-3, 8e-6, 532e-9).abs()
        picture = perception.rgb_2_ycrcb(light.expand(1, 3, 16, 16).clone())
        loss = perception.SSIM()(picture, picture.flip(-1))
        return light, loss, sphere(torch.tensor([0.1 * index, 0.0, 0.0]))


def light_and_spot():
    """Return values of functions that keep threads, kernels or both."""
    torch.set_num_threads(1)
    large = torch.ones(1024, 1024, dtype=torch.complex64)
    light = wave.propagate_beam(large, None, 1e-3, 8e-6, 532e-9)[::64, ::64].abs()
    lens_system = system.load_system("cooke_triplet")
    return light, system.rms_spot(lens_system, "rings", 3)
