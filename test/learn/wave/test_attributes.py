"""Attributes set after construction take effect, or are refused by name."""

import copy
import pickle

import pytest
import torch

from odak.learn.perception import display_color_hvs
from odak.learn.raytracing import detector, planar_mesh
from odak.learn.wave import (
    Display,
    Modulator,
    holographic_display,
    multi_color_hologram_optimizer,
    multiplane_loss,
    propagator,
    simulated_camera,
    spatial_light_modulator,
    temporal_modulator,
)

COLOURS = [639e-9, 515e-9, 473e-9]
SHAPE = (16, 24)


def relayed(**options):
    return propagator(
        SHAPE, COLOURS, **({"number_of_frames": 3, "number_of_depth_layers": 2, "aperture": "open"} | options)
    )


def shown(**options):
    return Display(Modulator(SHAPE, 8e-6), COLOURS, [2e-3, 3e-3], **options)


@pytest.fixture
def phases():
    return torch.rand(3, *SHAPE, generator=torch.Generator().manual_seed(0))


def slm(**options):
    return spatial_light_modulator(bits=4, **options)


@pytest.mark.parametrize(
    ("make", "name", "value"),
    [
        (relayed, "wavelengths", COLOURS[::-1]),
        (relayed, "pixel_pitch", 4e-6),
        (relayed, "propagation_type", "Transfer Function Fresnel"),
        (relayed, "propagator_type", "forward"),
        (relayed, "number_of_frames", 2),
        (relayed, "slm", slm()),
        (lambda: holographic_display(COLOURS, 8e-6, SHAPE), "pixel_pitch", 4e-6),
        (shown, "wavelengths", (500e-9,) * 3),
        (shown, "distances", (1e-2,)),
        (shown, "iris", None),
        (shown, "modulator", Modulator(SHAPE, 4e-6)),
        (lambda: simulated_camera(515e-9, 1e-3, 8e-6), "wavelength", 600e-9),
        (slm, "bits", 8),
        (detector, "resolution", (10, 10)),
        (planar_mesh, "size", (2.0, 2.0)),
    ],
)
def test_attributes_that_all_depends_on_are_refused(make, name, value):
    display = make()
    before = getattr(display, name)
    with pytest.raises(AttributeError, match=f"{name} cannot be set: the whole {type(display).__name__}"):
        setattr(display, name, value)
    assert getattr(display, name) is before
    # A copy and a pickle set the attributes of a new object.
    assert type(copy.deepcopy(display)) is type(pickle.loads(pickle.dumps(display)))


@pytest.mark.parametrize(
    ("name", "value"),
    [("volume_depth", 4e-2), ("image_location_offset", 9e-3), ("number_of_depth_layers", 3)],
)
def test_planes_are_divided_anew(phases, name, value):
    display = relayed()
    display.reconstruct(phases)
    setattr(display, name, value)
    torch.testing.assert_close(display.reconstruct(phases), relayed(**{name: value}).reconstruct(phases))
    display.distances = [1e-3, 2e-3]
    assert display.distances.tolist() == pytest.approx([1e-3, 2e-3])
    with pytest.raises((TypeError, ValueError), match=name):
        setattr(display, name, "many")


def test_a_pinhole_set_later_is_used():
    display = holographic_display(COLOURS, 8e-6, SHAPE, pinhole_size=20)
    display.pinhole_size = 5
    assert display.aperture.sum() < 100


@pytest.mark.parametrize("how", ["set", "written", "loaded"])
@pytest.mark.parametrize(("make", "name"), [(relayed, "channel_power"), (shown, "powers")])
def test_powers_that_change_are_used(phases, make, name, how):
    option = "laser_channel_power" if make is relayed else name
    wanted, display = make(**{option: torch.ones(3, 3)}), make()
    look = (lambda one: one.reconstruct(phases)) if make is relayed else (lambda one: one(phases))
    assert not torch.allclose(look(display), look(wanted))
    if how == "set":
        setattr(display, name, torch.ones(3, 3))
    elif how == "written":
        getattr(display, name).fill_(1)
    else:
        display.load_state_dict(wanted.state_dict())
    torch.testing.assert_close(look(display), look(wanted))
    with torch.inference_mode():
        copied = copy.deepcopy(display)
        setattr(copied, name, torch.ones(3, 3))
        torch.testing.assert_close(look(copied), look(wanted))


def test_powers_have_all_their_gradients(phases):
    """Where frame f is lit by source f alone, the fields of the others still have a slope in their amplitudes."""
    display = relayed()
    powers = display.channel_power.clone().requires_grad_()
    display.channel_power = powers
    display.reconstruct(phases, no_grad=False, get_complex=True).real.sum().backward()
    assert (powers.grad != 0).all()


def test_a_table_of_phases_set_later_is_used(phases):
    lut = torch.linspace(0, 6, 16)
    modulator = slm()
    modulator.lut = lut
    torch.testing.assert_close(modulator(phases), slm(lut=lut)(phases))
    with pytest.raises(ValueError, match="lut must be a tensor of 16 phases"):
        modulator.lut = lut[:3]
    assert temporal_modulator(1e-3, 1e-4, slm(samples_per_pixel=2)).samples_per_pixel == 2


def test_targets_follow_what_they_are_made_from():
    picture = torch.rand(3, 16, 16, generator=torch.Generator().manual_seed(0))
    made, other = (multiplane_loss(picture, picture[0], 1.0, multiplier=m) for m in (1.0, 3.0))
    made.multiplier = 3.0
    torch.testing.assert_close(made.targets, other.targets)


def test_cone_responses_follow_the_spectrum():
    spectrum = torch.rand(3, 301, generator=torch.Generator().manual_seed(0))
    display = display_color_hvs()
    display.primaries_spectrum = spectrum
    torch.testing.assert_close(display.lms_tensor, display_color_hvs(primaries_spectrum=spectrum).lms_tensor)


def test_powers_are_learned_in_each_run_and_may_be_set(phases):
    targets = torch.rand(1, 3, *SHAPE, generator=torch.Generator().manual_seed(0))

    def optimizer(method):
        display = relayed(number_of_depth_layers=1)
        return multi_color_hologram_optimizer(COLOURS, SHAPE, targets, display, method=method, progress=False, seed=1)

    learning = optimizer("multi-color")
    first = learning.optimize(2)[4].clone()
    assert (learning.optimize(2)[4] != first).all()
    fixed = optimizer("conventional")
    fixed.channel_power = torch.eye(3).roll(1, 0)
    phase = fixed.gradient_descent(20)
    assert not torch.allclose(phase, optimizer("conventional").gradient_descent(20))
    fixed.peak_amplitude = 0.25
    assert fixed.optimize(1)[5] == 0.25
