"""Displays: the light of frames, planes and colours, against single propagations and closed forms."""

import math

import numpy as np
import physics
import pytest
import torch

from odak import AccuracyWarning, ArgumentWarning
from odak.learn import wave
from odak.learn.tools import circular_binary_mask
from odak.learn.wave import holographic_display, propagator
from odak.wave.torch_convolution import Workspace

PITCH = 8e-6
COLOURS = [639e-9, 515e-9, 473e-9]


def display(**options):
    settings = {"number_of_frames": 3, "number_of_depth_layers": 2, "propagator_type": "forward", "volume_depth": 2e-3}
    has_stop = {"aperture", "aperture_size", "iris_radius"} & options.keys()
    settings |= {} if has_stop else {"aperture": "open"}
    return propagator([24, 32], COLOURS, PITCH, **(settings | options))


@pytest.fixture
def phases():
    return 2 * math.pi * torch.rand(3, 24, 32, generator=torch.Generator().manual_seed(0))


def unwrapped(field, distance, wavelength, **options):
    return physics.unwrapped_propagation(field.numpy(), float(distance), PITCH, wavelength, **options)


@pytest.mark.parametrize(
    "method", ["Bandlimited Angular Spectrum", "Angular Spectrum", "Transfer Function Fresnel", "auto"]
)
def test_each_plane_and_colour_is_a_propagation(method, phases):
    show = display(propagation_type=method)
    images = show.reconstruct(phases)
    assert images.shape == (3, 2, 3, 24, 32)
    for frame in range(3):
        for plane, distance in enumerate(show.distances.tolist()):
            field = wave.unit_phasor(phases[frame])
            expected = unwrapped(field, distance, COLOURS[frame])
            # The paraxial phase of Fresnel's transfer function is off by some hundredths of a radian.
            bound = 2e-2 if "Fresnel" in method else 2e-3
            assert physics.relative_error(show(field, frame, plane), expected) < bound
            assert physics.relative_error(images[frame, plane, frame], abs(expected) ** 2) < 2 * bound
        dark = [colour for colour in range(3) if colour != frame]
        assert not images[frame][:, dark].any()


def test_gaussian_beam_in_double_precision():
    waist, distance = 60e-6, 4e-3
    beam = physics.gaussian_beam((96, 128), PITCH, waist, 0.0, COLOURS[1])
    expected = physics.gaussian_beam((96, 128), PITCH, waist, distance, COLOURS[1])
    show = propagator([96, 128], COLOURS, PITCH, distances=[distance], propagator_type="forward", aperture_size=1e4)
    result = show(torch.from_numpy(beam), 1, 0)
    assert result.dtype == torch.complex128
    assert physics.relative_error(result, expected) < 2e-6


def test_relay_leaves_the_net_distance(phases):
    offset, relay = 5e-3, 1e-2
    there_and_back = display(
        propagator_type="back and forth", image_location_offset=offset, back_and_forth_distance=relay
    )
    assert there_and_back.distances.tolist() == pytest.approx([offset - 1e-3, offset + 1e-3])
    net = there_and_back.distances - offset
    field = wave.unit_phasor(phases[0])
    for plane, distance in enumerate(net.tolist()):
        expected = unwrapped(field, distance, COLOURS[0])
        assert physics.relative_error(there_and_back(field, 0, plane), expected) < 2e-3


@pytest.mark.filterwarnings("ignore:.*averages the field:odak.AccuracyWarning")
def test_relay_of_fresnel_impulse_responses_leaves_net_distance(phases):
    offset = 5e-3
    options = {"propagation_type": "Impulse Response Fresnel", "image_location_offset": offset}
    show = display(propagator_type="back and forth", aperture_samples=[1, 1, 1, 1], **options)
    field = wave.unit_phasor(phases[0])
    for plane, distance in enumerate(show.distances.tolist()):
        assert physics.relative_error(show(field, 1, plane), unwrapped(field, distance - offset, COLOURS[1])) < 3e-3
    # Averages over pixels are those of the straight way, where that is long enough for its impulse response.
    averaged = {"aperture_samples": [4, 5, 2, 3], "resolution_factor": 2, "distances": [8e-2]}
    straight = display(**(options | averaged))
    there_and_back = display(propagator_type="back and forth", **(options | averaged | {"distances": [8e-2 + offset]}))
    expected, found = (
        straight.reconstruct(phases, get_complex=True),
        there_and_back.reconstruct(phases, get_complex=True),
    )
    assert physics.relative_error(found, expected.numpy()) < 1e-5


@pytest.mark.parametrize("shape", [(24, 32), (32, 20)])
def test_iris_is_round_and_its_cut_off_falls_with_wavelength(shape):
    phases = 2 * math.pi * torch.rand(3, *shape, generator=torch.Generator().manual_seed(1))
    radius, focal = 0.7e-3, 0.05
    show = propagator(
        shape, COLOURS, PITCH, number_of_frames=3, distances=[2e-3, 4e-3], propagator_type="forward",
        iris_radius=radius, iris_focal_length=focal,
    )  # fmt: skip
    fields = show.reconstruct(phases, get_complex=True)
    for colour, wavelength in enumerate(COLOURS):
        cutoff = radius / (wavelength * focal)
        assert cutoff < 1 / (2 * PITCH)
        for plane, distance in enumerate((2e-3, 4e-3)):
            expected = unwrapped(wave.unit_phasor(phases[colour]), distance, wavelength, cutoff=cutoff)
            assert physics.relative_error(fields[colour, plane, colour], expected) < 0.02
    with pytest.raises(ValueError, match="must be given together"):
        show.set_aperture(iris_radius=1e-3)
    with pytest.raises(ValueError, match="iris_radius excludes"):
        show.set_aperture(aperture_size=3.0, iris_radius=1e-3, iris_focal_length=0.1)


@pytest.mark.parametrize("shape", [(24, 32), (32, 20)])
def test_a_size_in_samples_is_a_disc_of_the_padded_spectrum(shape):
    """Of the released form, round in samples on panels that are not square too."""
    options = {"distances": [2e-3], "propagator_type": "forward"}
    field = wave.unit_phasor(2 * math.pi * torch.rand(shape, generator=torch.Generator().manual_seed(1)))

    def error(show, mask):
        assert torch.equal(show.aperture, mask)
        expected = physics.behind_mask(field.numpy(), 2e-3, PITCH, COLOURS[1], mask.numpy())
        return physics.relative_error(show(field, 0, 0), expected)

    show = propagator(shape, COLOURS[1:2], PITCH, aperture_size=13, **options)
    assert error(show, circular_binary_mask(*(2 * n for n in shape), 13)[0, 0]) < 0.04
    with pytest.warns(ArgumentWarning, match='aperture="open" is a display without a stop'):
        released = propagator(shape, COLOURS[1:2], PITCH, **options)
    mask = circular_binary_mask(*(2 * n for n in shape), max(shape))[0, 0]
    assert error(released, mask) < 0.04
    # Without it the corners of the spectrum pass, a seventh of it or more.
    assert physics.relative_error(unwrapped(field, 2e-3, COLOURS[1]), released(field, 0, 0).numpy()) > 0.15
    show.set_aperture()
    assert torch.equal(show.aperture, mask)
    fine = {"resolution_factor": 2, "propagation_type": "IR Fresnel", "aperture_samples": (5, 5, 1, 1)}
    assert torch.equal(
        propagator(shape, **fine, **options).aperture,
        circular_binary_mask(*(4 * n for n in shape), 2 * max(shape))[0, 0],
    )


def test_the_stop_is_said_once_in_a_process_and_by_the_display():
    with pytest.warns(ArgumentWarning, match="round stop of earlier releases"):
        first = propagator([8, 12])
    assert "stop='round, radius 12 samples'" in repr(first)
    assert "stop='round, radius 12 samples'" in repr(propagator([8, 12]))
    for options, words in (
        ({"aperture": "open"}, "open"),
        ({"aperture": torch.ones(8, 12)}, "mask"),
        ({"iris_radius": 1e-3, "iris_focal_length": 0.1}, "iris, radius 0.001 m at 0.1 m"),
    ):
        assert f"stop='{words}'" in repr(propagator([8, 12], **options))
    first.aperture = torch.ones(16, 24)
    assert first.stop == "mask"
    shown = wave.holographic_display([515e-9], resolution=[8, 12], pinhole_size=7)
    assert shown.stop == "round, radius 7 samples of the longer axis"
    pinhole = shown.aperture
    shown.set_aperture("open")
    shown.set_aperture()
    assert torch.equal(shown.aperture, pinhole)
    with pytest.raises(ValueError, match="aperture must be one of 'open'"):
        propagator([8, 12], aperture="none")
    with pytest.raises(ValueError, match="excludes aperture_size"):
        propagator([8, 12], aperture="open", aperture_size=4)
    # Fields of methods without transfer functions have no Fourier plane here.
    assert propagator([8, 12], propagation_type="Fraunhofer").stop == "open"


def test_an_open_display_leaves_fields_as_they_are():
    for shape in ((24, 32), (8, 96)):
        show = propagator(shape, distances=[0.0], propagator_type="forward", aperture="open")
        field = wave.unit_phasor(2 * math.pi * torch.rand(shape, generator=torch.Generator().manual_seed(2)))
        torch.testing.assert_close(show(field, 0, 0), field, rtol=1e-5, atol=1e-5)


def test_finite_pixels_have_their_own_spectrum():
    phase, fill, s, distance = (
        2 * math.pi * torch.rand(12, 16, generator=torch.Generator().manual_seed(1)),
        0.7,
        16,
        2e-3,
    )
    iris = {"iris_radius": 1.2e-3, "iris_focal_length": 0.05}
    slm = wave.spatial_light_modulator(bits=None, fill_factor=fill, dead_area_amplitude=0.0)
    show = propagator([12, 16], [COLOURS[1]], PITCH, distances=[distance], propagator_type="forward", slm=slm, **iris)
    found = show.reconstruct(phase, get_complex=True)[0, 0, 0]
    # Pixels drawn by many samples, seen at their middles.
    drawn = wave.spatial_light_modulator(bits=None, fill_factor=fill, dead_area_amplitude=0.0, samples_per_pixel=s)
    cutoff = iris["iris_radius"] / (COLOURS[1] * iris["iris_focal_length"])
    fine = physics.unwrapped_propagation(drawn(phase).numpy(), distance, PITCH / s, COLOURS[1], cutoff, padding=8)
    middles = (fine[s // 2 - 1 :: s] + fine[s // 2 :: s]) / 2
    middles = (middles[:, s // 2 - 1 :: s] + middles[:, s // 2 :: s]) / 2
    assert physics.relative_error(found, middles) < 0.02
    points = propagator([12, 16], [COLOURS[1]], PITCH, distances=[distance], propagator_type="forward", **iris)
    assert physics.relative_error(fill * points.reconstruct(phase, get_complex=True)[0, 0, 0], middles) > 0.05
    with pytest.warns(AccuracyWarning, match="orders beyond"):
        propagator([12, 16], [COLOURS[1]], PITCH, slm=slm, aperture="open")
    with pytest.raises(ValueError, match="pixel_fill must be at most 1"):
        propagator([12, 16], [COLOURS[1]], PITCH, pixel_fill=1.2, **iris)


@pytest.mark.parametrize("budget", [1, 600_000, None])
@pytest.mark.parametrize("method", ["conventional", "multi-color"])
def test_chunks_make_no_difference(budget, method, phases):
    powers = torch.eye(3) if method == "conventional" else torch.rand(3, 3)
    whole = display(method=method, laser_channel_power=powers)
    chunked = display(method=method, laser_channel_power=powers, memory_budget=budget)
    torch.testing.assert_close(whole.reconstruct(phases), chunked.reconstruct(phases))
    exposed = [chunked.exposures(chunked.holograms(phases), planes) for planes in chunked.plane_chunks()]
    torch.testing.assert_close(torch.cat(exposed), whole.reconstruct(phases).sum(0))
    assert len(exposed) == (2 if budget == 1 else 1)
    # Kernels beyond the budget are built anew.
    assert bool(chunked.generated_kernels.all()) == (budget != 1)


def test_one_source_per_frame_is_the_general_case(phases):
    special = display()
    general = display(laser_channel_power=torch.eye(3) + 1e-20)
    torch.testing.assert_close(special.reconstruct(phases), general.reconstruct(phases))
    torch.testing.assert_close(
        special.reconstruct(phases, get_complex=True), general.reconstruct(phases, get_complex=True)
    )
    lit = special.exposures(special.holograms(phases), slice(None))
    torch.testing.assert_close(lit, general.exposures(general.holograms(phases), slice(None)))


def test_powers_of_another_kind_than_the_display_was_made_for(phases):
    show, each = display(), torch.rand(4, 3, 3)
    holograms = show.holograms(phases)
    expected = torch.stack([display(laser_channel_power=one).reconstruct(phases) for one in each])
    given = [show.exposures(holograms, slice(None), one) for one in each]
    torch.testing.assert_close(torch.stack(given), expected.sum(1))
    for whole, run in (
        (expected, show.reconstruct),
        (expected.sum(1), lambda p: show.exposures(holograms, slice(None))),
    ):

        def with_powers(one, run=run):
            show.set_laser_powers(one)
            return run(phases)

        torch.testing.assert_close(torch.func.vmap(with_powers)(each), whole)

    def of_a_corner(one):
        return with_powers(one)[..., :2, :2]

    slopes = torch.autograd.functional.jacobian(of_a_corner, each[0])
    torch.testing.assert_close(torch.func.jacrev(of_a_corner)(each[0]), slopes)


@pytest.mark.parametrize("frames", [1, 2, 5])
def test_more_or_fewer_frames_than_colours(frames):
    show = display(number_of_frames=frames)
    images = show.reconstruct(torch.zeros(frames, 24, 32))
    lit = images.sum((1, 3, 4)) > 0
    assert torch.equal(lit, torch.eye(frames, 3).bool())


def test_complex_fields_and_amplitude(phases):
    show = display(method="multi-color", laser_channel_power=torch.rand(3, 3))
    amplitude = torch.rand(3, 24, 32)
    fields = show.reconstruct(phases, amplitude, get_complex=True)
    torch.testing.assert_close(wave.intensity(fields), show.reconstruct(phases, amplitude))
    powers = show.get_laser_powers()
    torch.testing.assert_close(powers, show.channel_power.cos().abs())
    one = powers[2, 1] * show(amplitude[1] * wave.unit_phasor(phases[2]), 1, 0)
    torch.testing.assert_close(fields[2, 0, 1], one)


def test_phase_scale_is_seen_by_each_colour(phases):
    show = display()
    show.phase_scale.copy_(torch.tensor([1.0, 0.8, 0.7]))
    other = display()
    images = show.reconstruct(phases)
    torch.testing.assert_close(images[1, :, 1], other.reconstruct(0.8 * phases)[1, :, 1])
    torch.testing.assert_close(images[0], other.reconstruct(phases)[0])


@pytest.mark.filterwarnings("ignore:.*averages the field:odak.AccuracyWarning")
@pytest.mark.parametrize("method", ["Impulse Response Fresnel", "Seperable Impulse Response Fresnel"])
def test_samples_between_pixels(method, phases):
    show = display(propagation_type=method, resolution_factor=2, aperture_samples=[4, 4, 2, 2])
    images = show.reconstruct(phases)
    assert images.shape == (3, 2, 3, 48, 64)
    spread = torch.zeros(48, 64)
    spread[::2, ::2] = 1
    # The default amplitude is one at every second sample.
    torch.testing.assert_close(images, show.reconstruct(phases, spread.expand(3, -1, -1)))
    assert display(resolution_factor=2).resolution_factor == 1


def test_gradients():
    show = propagator(
        [4, 5], COLOURS[:2], PITCH, number_of_frames=2, number_of_depth_layers=2, propagator_type="forward",
        method="multi-color", laser_channel_power=torch.tensor([[0.3, 0.5], [0.8, 0.2]], dtype=torch.float64),
        aperture="open",
    )  # fmt: skip
    phases = torch.rand(2, 4, 5, dtype=torch.float64, requires_grad=True)
    powers = torch.rand(2, 2, dtype=torch.float64, requires_grad=True)

    def images(phases, powers):
        show.set_laser_powers(powers)
        return show.reconstruct(phases, no_grad=False)

    assert torch.autograd.gradcheck(images, (phases, powers), fast_mode=True)

    def exposed(phases, powers):
        return show.exposures(show.holograms(phases), slice(0, 2), powers)

    assert torch.autograd.gradcheck(exposed, (phases, powers), fast_mode=True)
    assert torch.autograd.gradgradcheck(exposed, (phases, powers), fast_mode=True)
    assert not show.reconstruct(phases).requires_grad


def test_gradients_of_distances_wavelengths_and_pitch():
    phase = torch.rand(4, 5, dtype=torch.float64)

    def images(shift, stretch, widening):
        colours, pitch = [515e-9 * stretch, 473e-9], PITCH * widening
        show = propagator([4, 5], colours, pitch, distances=1e-4 * shift, propagator_type="forward", aperture="open")
        return show.reconstruct(phase, no_grad=False)

    arguments = [torch.tensor(values, dtype=torch.float64, requires_grad=True) for values in ([1.0, 2.0], 1.0, 1.0)]
    assert torch.autograd.gradcheck(images, arguments, eps=1e-6, atol=1e-5, fast_mode=True)


def test_vaccination_draws_anew_each_time(phases):
    first, again = (display(vaccination=True, vaccination_scale=1e-3, seed=3) for _ in range(2))
    one, two = first.reconstruct(phases), first.reconstruct(phases)
    assert (one - two).abs().max() > 0.1
    torch.testing.assert_close(one, again.reconstruct(phases))
    torch.testing.assert_close(
        display(vaccination=True, vaccination_scale=1e-12, seed=3).reconstruct(phases),
        display().reconstruct(phases),
        rtol=1e-3, atol=1e-4,
    )  # fmt: skip


def test_vaccination_may_be_turned_on_later(phases):
    show = display(vaccination_scale=1e-3, seed=3)
    assert show.vaccination_scale == 1e-3
    torch.testing.assert_close(show.reconstruct(phases), show.reconstruct(phases), rtol=0, atol=0)
    show.vaccination = True
    assert (show.reconstruct(phases) - show.reconstruct(phases)).abs().max() > 0.1


def test_distances_of_one_plane_and_of_many():
    assert display(number_of_depth_layers=1, image_location_offset=0.01).distances.tolist() == [0.01]
    many = display(number_of_depth_layers=3, volume_depth=0.02, image_location_offset=0.1).distances
    np.testing.assert_allclose(many, [0.09, 0.1, 0.11], rtol=1e-12)
    assert many.dtype == torch.float64
    given = display(distances=torch.tensor([0.1, 0.2, 0.3, 0.4]))
    assert given.number_of_depth_layers == 4


def test_module_moves_and_keeps_its_distances(phases):
    show = display()
    before = show.reconstruct(phases)
    assert isinstance(show, torch.nn.Module)
    assert not any("transfer" in name or "kernel" in name for name in show.state_dict())
    show.to(torch.float64)
    assert show.distances.dtype == torch.float64
    torch.testing.assert_close(show.reconstruct(phases.double()).float(), before, rtol=1e-4, atol=1e-5)


def test_kernels_are_centred_and_inverse_to_the_impulse_response():
    show = display(aperture=torch.ones(48, 64))
    kernels = show.kernels
    assert kernels.shape == (2, 3, 48, 64)
    middle = 2 * math.pi * (show.distances[1].double() / COLOURS[2] % 1)
    assert torch.angle(kernels[1, 2, 24, 32]).item() % (2 * math.pi) == pytest.approx(middle.item(), abs=0.15)
    amplitude, phase = show.get_kernels()
    field = torch.zeros(24, 32)
    field[12, 16] = 1
    expected = show(field, 2, 1)
    window = torch.polar(amplitude, phase)[1, 2, 12:36, 16:48]
    torch.testing.assert_close(window, expected, atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(show.propagate(field, kernels[1, 2]), expected, atol=1e-6, rtol=1e-4)


def test_kernels_are_built_once_for_planes_that_are_asked_for(phases):
    show, field = display(number_of_depth_layers=3), wave.unit_phasor(phases[0])
    assert not show.generated_kernels.any()
    first = show(field, 1, 2)
    assert show.generated_kernels.tolist() == [[False] * 3, [False] * 3, [True] * 3]
    assert show.kernels is show.kernels
    torch.testing.assert_close(show.reconstruct(phases, get_complex=True)[0, 2, 0], show(field, 0, 2))
    assert show.generated_kernels.all()
    torch.testing.assert_close(show(field, 1, 2), first, rtol=0, atol=0)
    show.init_distances([1e-3, 2e-3])
    assert not show.generated_kernels.any() and show.kernels.shape[0] == 2


def test_another_aperture_is_seen(phases):
    mask = display(aperture_size=10).aperture
    show, other, field = display(), display(aperture=mask), wave.unit_phasor(phases[0])
    show(field, 0, 0)
    show.aperture = mask
    torch.testing.assert_close(show(field, 0, 0), other(field, 0, 0), rtol=0, atol=0)


def test_methods_of_powers_are_checked_when_they_are_set_later():
    show = display()
    show.method = "full_complex multi-color"
    torch.testing.assert_close(show.get_laser_powers(), torch.eye(3).cos().abs())
    show.method = "nonsense"
    with pytest.raises(ValueError, match="method must be one of 'conventional'"):
        show.get_laser_powers()


def test_a_small_stop_leaves_the_light_of_a_flat_pattern(phases):
    show = display(aperture_size=10)
    flat = show(torch.ones(48, 64)[:24, :32], 0, 0)
    field = show(wave.unit_phasor(phases[0]), 0, 0)
    assert field.abs().square().mean() < 0.5 * flat.abs().square().mean() + 0.5
    with pytest.raises(ValueError, match="aperture must fit"):
        show.set_aperture(torch.ones(49, 64))


def test_padding_of_ones_own(phases):
    show, field = display(aperture=torch.ones(48, 64)), wave.unit_phasor(phases[0])
    torch.testing.assert_close(show(field, 0, 0, [48, 64]), show(field, 0, 0))
    wide = show(field, 0, 0, zero_padding_size=[72, 96])
    padded = torch.nn.functional.pad(field, (32, 32, 24, 24))
    expected = wave.propagate_beam(
        padded, None, show.distances[0].item(), PITCH, COLOURS[0], "BLAS", zero_padding=[False, False, False]
    )[24:48, 32:64]
    assert wide.shape == field.shape
    torch.testing.assert_close(wide, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"number_of_frames": 0}, "number_of_frames"),
        ({"propagator_type": "sideways"}, "propagator_type"),
        ({"propagation_type": "custom"}, "propagation_type"),
        ({"method": "monochrome"}, "method"),
        ({"laser_channel_power": torch.ones(2, 3)}, "laser_channel_power must be"),
        ({"laser_channel_power": -torch.eye(3)}, "laser_channel_power must not be negative"),
        ({"distances": []}, "distances must contain"),
        ({"memory_budget": -1}, "memory_budget"),
        ({"volume_depth": math.inf}, "volume_depth"),
    ],
)
def test_bad_options_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        display(**change)


def test_bad_arguments_are_named(phases):
    show = display()
    with pytest.raises(ValueError, match=r"hologram_phases must be \[frames"):
        show.reconstruct(phases[:2])
    with pytest.raises(TypeError, match="hologram_phases"):
        show.reconstruct(phases + 1j)
    with pytest.raises(ValueError, match="depth_id must be from 0 to 1, got 2"):
        show(phases[0] + 0j, 0, 2)
    with pytest.raises(ValueError, match="channel_id must be from 0 to 2, got 3"):
        show(phases[0] + 0j, 3, 0)
    with pytest.raises(ValueError, match="input_field"):
        show(phases[0, :20] + 0j, 0, 0)
    with pytest.raises(ValueError, match="amplitude must have 3 colours"):
        show.reconstruct(phases, torch.ones(2, 24, 32))
    with pytest.raises(ValueError, match="wavelengths"):
        propagator([24, 32], [])
    with pytest.raises(ValueError, match="zero_padding_size"):
        show(phases[0] + 0j, 0, 0, [10, 10])


def test_display_without_relay(phases):
    illumination = torch.rand(24, 32)
    show = holographic_display(
        COLOURS, PITCH, [24, 32], 2e-3, 2, 5e-3, pinhole_size=100, illumination=illumination
    )  # fmt: skip
    powers = torch.rand(3, 3)
    images = show.reconstruct(phases, powers)
    assert images.shape == (3, 2, 3, 24, 32)
    shown = illumination * wave.unit_phasor(phases[1])
    field = unwrapped(shown, 6e-3, COLOURS[2])
    assert physics.relative_error(images[1, 1, 2], powers[1, 2].item() ** 2 * abs(field) ** 2) < 4e-3
    assert physics.relative_error(show(shown, 2, 1), field) < 2e-3


def test_display_with_and_without_padding(phases):
    field = wave.unit_phasor(phases[0])
    bare = holographic_display(COLOURS, PITCH, [24, 32], 2e-3, 1, 5e-3, pad=[False, True])
    expected = wave.propagate_beam(field, None, 5e-3, PITCH, COLOURS[0], "BLAS", zero_padding=[False, False, False])
    torch.testing.assert_close(bare(field, 0, 0), expected, rtol=1e-4, atol=1e-5)
    uncut = holographic_display(COLOURS, PITCH, [24, 32], 2e-3, 1, 5e-3, pad=[True, False])(field, 0, 0)
    whole = holographic_display(COLOURS, PITCH, [24, 32], 2e-3, 1, 5e-3)(field, 0, 0)
    assert uncut.shape == (48, 64)
    # On the whole padded grid waves wrap around.
    assert 1e-3 < physics.relative_error(uncut[12:36, 16:48], whole.numpy()) < 0.3


def test_display_checks(phases):
    show = holographic_display(COLOURS, PITCH, [24, 32], number_of_depth_layers=1)
    with pytest.raises(ValueError, match="laser_powers"):
        show.reconstruct(phases, torch.ones(3, 2))
    with pytest.raises(ValueError, match="hologram_phases"):
        show.reconstruct(phases[0], torch.ones(1, 3))
    with pytest.raises(ValueError, match="wavelength_id"):
        show(phases[0] + 0j, 3, 0)
    with pytest.raises(ValueError, match="illumination"):
        holographic_display(COLOURS, PITCH, [24, 32], illumination=torch.ones(24, 31))
    pinhole = holographic_display(COLOURS, PITCH, [24, 32], number_of_depth_layers=1, pinhole_size=0.05)
    # Zero frequency alone: a flat field.
    flat = pinhole.reconstruct(phases, torch.ones(3, 3))
    assert flat.std((-2, -1)).max() < 1e-4 * flat.mean()


def test_exposures_in_a_workspace_have_one_backward_pass(phases):
    show = display(method="multi-color", laser_channel_power=torch.rand(3, 3))
    gradients = []
    for workspace in (None, Workspace()):
        phase = phases.clone().requires_grad_()
        powers = show.get_laser_powers().clone().requires_grad_()
        images = show.exposures(show.holograms(phase), slice(None), powers, workspace=workspace)
        images.square().sum().backward(retain_graph=True)
        gradients.append((phase.grad, powers.grad))
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-4)
    with pytest.raises(RuntimeError, match="one backward pass"):
        images.sum().backward()


def test_planes_may_be_moved(phases):
    field = wave.unit_phasor(phases[0])
    show, other = (holographic_display(COLOURS, PITCH, [24, 32], 2e-3, 2, place) for place in (5e-3, 7e-3))
    show.generate_kernels()
    before = show(field, 0, 1)
    show.image_location_offset = 7e-3
    show.init_distances()
    assert torch.equal(show.distances, other.distances)
    torch.testing.assert_close(show(field, 0, 1), other(field, 0, 1))
    assert not torch.allclose(show(field, 0, 1), before)
    volume = display(image_location_offset=5e-3, aperture=torch.ones(48, 64))
    volume(field, 0, 0)
    volume.init_distances([1e-3, 2e-3, 4e-3])
    assert volume.number_of_depth_layers == 3 and volume.distances.tolist() == pytest.approx([1e-3, 2e-3, 4e-3])
    assert physics.relative_error(volume(field, 1, 2), unwrapped(field, 4e-3, COLOURS[1])) < 2e-3
