"""Observers against plane waves and picture squares that are summed up independently."""

import math
from importlib.resources import files

import numpy as np
import pytest
import torch
from independent_camera import (
    Focus,
    Retina,
    RoundStop,
    Seen,
    SquareStop,
    after_a_panel,
    camera,
    freely,
    picture_means,
    picture_means_at,
)

from odak.instruments import Lens
from odak.learn.perception import Viewer, Viewing, ocular_modulation_transfer
from odak.learn.wave import AmplitudePanel, Display, Eyes, Iris, Modulator, Observer, Problem, Run, light_of, optimise
from odak.learn.wave.displays import judge, observers
from odak.learn.wave.displays.observers import fine_intensity, resolved

PITCH, WAVELENGTH, SQUARE = 8e-6, 532e-9, (1.0, 1.0)
GRIDS = [(0, 0), (0, 0.5), (0.5, 0), (0.5, 0.5)]


def seen_of(phases, distance=2e-3, orders=1, powers=None):
    """Return what is seen of phases ``[frames, rows, columns]`` by the independent computation."""
    transfer, reach = freely(PITCH, WAVELENGTH, distance)
    frames = np.exp(1j * np.asarray(phases, float))
    stop = SquareStop(frames.shape[1:], reach, orders)
    return Seen(frames, [1 / len(frames)] * len(frames) if powers is None else powers, stop, transfer)


@pytest.fixture
def picture():
    """Return a smooth picture with an edge in it, 40 × 36."""
    y, x = np.mgrid[:40, :36]
    return torch.from_numpy(0.5 + 0.3 * np.sin(y / 5) * np.cos(x / 7) + 0.2 * (x + y > 40)).float()


@pytest.mark.parametrize("side", [0.5, 1, 1.5, 3])
@pytest.mark.parametrize("orders", [1, 3])
def test_means_about_and_between_pixels_are_those_of_the_intensity(random, orders, side):
    seen, samples = seen_of(random.uniform(0, 6, (1, 24, 28)), orders=orders), 2 * orders
    places = [np.arange(n * samples) / samples for n in (24, 28)]
    points = torch.from_numpy(seen.on_a_grid(*places)).reshape(24, samples, 28, samples).permute(1, 3, 0, 2)[None]
    found = Observer.camera(side).recorded(points, SQUARE)[:, 0].numpy()
    inside = np.s_[6:-6, 6:-6]
    for grid, (down, across) in zip(found, GRIDS, strict=True):
        expected = seen.means(np.arange(24) + down, np.arange(28) + across, side, 12)
        assert np.linalg.norm((grid - expected)[inside]) < 2e-3 * np.linalg.norm(expected[inside])


def test_means_of_a_picture_of_squares(random):
    picture = random.random((9, 11))
    found = Observer.camera(1.5).wanted(torch.from_numpy(picture), SQUARE).numpy()
    for grid, (down, across) in zip(found, GRIDS, strict=True):
        expected = picture_means(picture, np.arange(9) + down, np.arange(11) + across, 1.5)
        assert np.abs(grid - expected)[1:-2, 1:-2].max() < 1e-12
    # A half-shifted grid has no place beyond the last pixel: it holds the mean about that pixel again.
    assert np.array_equal(found[3][-1], found[1][-1]) and np.array_equal(found[3][:, -1], found[2][:, -1])
    registered = Observer.camera(registered=True).wanted(torch.from_numpy(picture), SQUARE)
    assert registered.shape == (1, 9, 11) and np.allclose(registered[0], picture)


def test_points_are_the_points(random):
    points = torch.from_numpy(random.random((2, 3, 3, 7, 8)))
    assert torch.allclose(Observer.points().recorded(points, SQUARE)[0], points[:, 0, 0])


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_means_of_a_wave_are_its_closed_form(samples):
    """Of 1 + cos(2πfx) over a side s about x: 1 + sinc(fs)·cos(2πfx), where few samples describe it."""
    f, places = 0.2 if samples == 1 else 0.7, np.arange(40 * samples) / samples
    light = 1 + 0.8 * np.cos(2 * np.pi * f * places)
    points = torch.from_numpy(light.reshape(40, samples).T.copy())[None, :, None, :, None].expand(
        1, samples, samples, 40, 9
    )
    found = Observer.camera().recorded(points, SQUARE)[:, 0, 8:-8, 4].numpy()
    for grid, (down, _) in zip(found, GRIDS, strict=True):
        expected = 1 + 0.8 * np.sinc(f) * np.cos(2 * np.pi * f * (np.arange(8, 32) + down))
        assert np.abs(grid - expected).max() < 5e-3


def test_a_product_of_spectra_takes_means_at_any_place():
    """A periodic field of few plane waves, whose intensity and means have a closed form."""
    sizes, f = (12, 10), ((2, -3), (-5, 4))
    y, x = np.meshgrid(*(np.arange(2 * n) for n in sizes), indexing="ij")
    field = 1 + sum(0.5 * np.exp(2j * np.pi * (a * y / 24 + b * x / 20)) for a, b in f)
    light = fine_intensity(torch.from_numpy(field))
    found = resolved(light, 2, sizes, (1.5, 0.7)).numpy()
    rows, columns = (np.arange(4 * n) / 4 + n - n // 2 for n in sizes)
    waves = [(1, 0, 0), *((0.5, *pair) for pair in f)]
    expected = 0
    for p, a, b in waves:
        for q, c, d in waves:
            down, across = (a - c) / 24, (b - d) / 20
            turn = np.exp(2j * np.pi * (down * rows[:, None] + across * columns))
            expected = expected + p * q * np.sinc(1.5 * down) * np.sinc(0.7 * across) * turn
    assert np.abs(found - expected.real).max() < 1e-12
    assert np.abs(resolved(light, 2, sizes, (1.5, 0.7), 1).numpy() - found[::4, ::4]).max() < 1e-12


@pytest.mark.usefixtures("small_judge")
def test_what_is_stated_holds_for_a_camera_at_any_place(picture):
    """And what is optimised for pixels that coincide does not."""
    display, run = (
        Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3, 2, torch.ones(2, 1)),
        Run(60, progress=False),
    )
    start = torch.rand(2, *picture.shape, generator=torch.Generator().manual_seed(3)) * 6
    anywhere, registered = (
        optimise(display, picture, start=start, run=run, observer=who)
        for who in (None, Observer.camera(registered=True))
    )
    target = picture.double().numpy()
    for found in (anywhere, registered):
        ratios = camera(seen_of(found.phases), target)
        assert abs(ratios.min() - float(found.psnr_of(Observer.camera()))) < 0.3
        whole = seen_of(found.phases).means(*map(np.arange, picture.shape)) * float(found.brightness)
        assert abs(-10 * np.log10(np.mean((whole - target) ** 2)) - float(found.psnr_registered)) < 0.5
    assert torch.isclose(anywhere.psnr, anywhere.psnr_of(anywhere.observer)).all()
    assert torch.isclose(registered.psnr, registered.psnr_registered).all()
    assert float(anywhere.psnr) > float(registered.psnr_of(Observer.camera())) + 5
    assert float(registered.psnr_registered) > float(anywhere.psnr_registered)
    assert "any place" in repr(anywhere) and "those of the image" in repr(registered)
    assert anywhere.table()[0]["psnr_registered_db"] == float(anywhere.psnr_registered)
    assert "registered" in anywhere._repr_html_()


@pytest.mark.parametrize(("pitch", "fill"), [(0.5, 1), (1.25, 0.8), (1.5, 1), (2, 1), (3, 0.5)])
def test_cameras_of_other_pitches(random, picture, pitch, fill):
    display = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3)
    found = optimise(display, picture, run=Run(8, progress=False))
    stated = found.psnr_of(Observer.camera(pitch * 2e-6, fill, magnification=0.25))
    quarters = round(4 * pitch)
    expected = camera(seen_of(found.phases), picture.double().numpy(), pitch, fill, quarters)
    assert abs(float(stated) - expected.min()) < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("frames", [1, 2, 4, 8])
def test_what_cameras_see_of_several_frames(frames):
    """Of the photograph that pages show: sixteen places, and pixels of half and of twice the pitch."""
    shape, distance = (108, 192), 14.4e-3
    display = Display(Modulator(shape, PITCH), WAVELENGTH, distance, frames, torch.ones(frames, 1))
    photo = light_of(files("odak") / "assets" / "photo.png", display, grey=True).targets
    target = torch.nn.functional.interpolate(photo[None], shape, mode="area")[0, 0]
    found = optimise(display, target, run=Run(30, progress=False))
    seen = seen_of(found.phases, distance)
    for pitch in (0.5, 1, 2):
        expected = camera(seen, target.double().numpy(), pitch, shifts=round(4 * pitch), every=1 + (pitch < 2))
        assert abs(float(found.psnr_of(Observer.camera(pitch * PITCH))) - expected.min()) < 0.3


@pytest.mark.usefixtures("small_judge")
def test_a_camera_of_its_own_pitch_is_optimised_for(picture):
    display, run = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3), Run(40, progress=False)
    fine = Observer.camera(PITCH / 2)
    aimed, usual = optimise(display, picture, run=run, observer=fine), optimise(display, picture, run=run)
    assert float(aimed.psnr) > float(usual.psnr_of(fine)) + 0.5


def test_a_camera_whose_pixels_are_no_whole_quarters_apart_is_at_all_places(picture):
    found = Observer.camera(1.1).places(picture.shape, SQUARE)
    assert [[len(range(160)[s]) for s in axis] for axis in found] == [[147], [131]]
    assert len(Observer.camera(1.25).places(picture.shape, SQUARE)[0]) == 5
    # None of the four places reaches into the outermost pixel, ±½ about the first and the last middle.
    for places in Observer.camera().places(picture.shape, SQUARE):
        assert [(s.start, s.step) for s in places] == [(4, 4), (5, 4), (6, 4), (7, 4)]
    assert max(range(160)[s][-1] for s in Observer.camera().places(picture.shape, SQUARE)[0]) == 4 * 38


def test_other_losses_see_all_grids(picture):
    display, shapes = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3), []

    def loss(image, target):
        shapes.append(tuple(image.shape))
        return (image - target).abs().mean()

    phases = torch.rand(1, *picture.shape)
    problem = Problem(display, picture[None, None], loss, phases, Run(), False)
    images = display.recorded_by(Observer.camera(), phases)
    wanted = Observer.camera().wanted(picture, SQUARE)[:, None, None]
    assert torch.isclose(problem.loss_of(phases), (images - wanted).abs().mean())
    assert shapes == [(1, 1, 40, 36)] * 4
    assert torch.equal(images[0], display(phases))
    alone = Problem(display, picture[None, None], loss, phases, Run(), False, Observer.camera(registered=True))
    assert torch.isclose(alone.loss_of(phases), (display(phases) - picture).abs().mean())


def test_gradients_reach_the_phases_from_all_grids(random):
    display = Display(Modulator((6, 8), PITCH, None), WAVELENGTH, 1e-3, iris=Iris(1e-3, 0.1))
    phases = torch.from_numpy(random.uniform(0, 6, (1, 6, 8))).requires_grad_()
    torch.autograd.gradcheck(lambda p: display.recorded_by(Observer.camera(12e-6, 0.8), p), phases, fast_mode=True)


@pytest.mark.usefixtures("small_judge")
def test_points_of_an_image_behind_a_lens_have_their_own_pitch():
    """λ·f/(n·pitch) apart: a camera of this pitch is the camera of the image's pitch."""
    display = Display(Modulator((24, 24), PITCH), WAVELENGTH, Lens(0.1))
    target = torch.zeros(24, 24)
    target[6:14, 8:18] = 1
    found = optimise(display, target, run=Run(10, progress=False))
    apart = WAVELENGTH * 0.1 / (24 * PITCH)
    assert np.allclose(display.path.image_pitches(0), apart)
    assert torch.isclose(found.psnr, found.psnr_of(Observer.camera(apart))).all()


@pytest.mark.usefixtures("small_judge")
def test_colours_and_planes_have_a_number_each(picture):
    display = Display(Modulator(picture.shape, PITCH), [639e-9, 515e-9], [2e-3, 3e-3])
    found = optimise(display, picture.expand(2, 2, 40, 36), run=Run(4, progress=False))
    assert found.psnr.shape == found.psnr_registered.shape == (2, 2)
    assert torch.allclose(found.psnr, found.psnr_of(found.observer), atol=1e-3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Observer.camera(-1e-6), "pitch must be positive"),
        (lambda: Observer.camera(fill=1.5), "fill must be from 0 to 1, got 1.5"),
        (lambda: Observer.camera(magnification=0), "magnification must be positive"),
        (lambda: Observer.camera(3e-6, registered=True), "pitch must be None, magnification 1 and turned 0 for a"),
        (lambda: Observer.camera(turned=60), "turned must be from -45 to 45 degrees, got 60"),
        (lambda: Observer.camera(40.0).places((40, 36), SQUARE), "observer must have pixels within an image of 40"),
    ],
)
def test_what_no_observer_can_be(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_an_observer_is_an_observer(picture):
    display = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3)
    with pytest.raises(TypeError, match=r"observer must be an odak.learn.wave.Observer, got str"):
        optimise(display, picture, observer="camera")
    with pytest.raises(ValueError, match="observer must have pixels within an image of 40 pixels"):
        optimise(display, picture, observer=Observer.camera(1e-3))


def of_iris(share, shape, distance):
    """Return an iris that passes a share of one order across its diameter, and the quadrature over it."""
    radius = share / 2
    reach = freely(PITCH, WAVELENGTH, distance)[1]
    return Iris(radius / PITCH * WAVELENGTH * 0.1, 0.1), RoundStop(shape, radius, 2 * radius * reach)


@pytest.mark.parametrize("distance", [0.0, 3e-3])
@pytest.mark.parametrize(("shape", "share"), [((32, 28), 0.9), ((32, 28), 0.05), ((48, 64), 0.3), ((64, 48), 0.1)])
def test_the_judge_is_right_behind_a_round_iris(random, shape, share, distance):
    """Against polar quadrature over the stop: all pixels, edges and corners among them, and the brightness."""
    phases, (iris, stop) = random.uniform(0, 6, shape), of_iris(share, shape, distance)
    display = Display(Modulator(shape, PITCH, bits=None), WAVELENGTH, distance, iris=iris)
    found, points = (image[0, 0].numpy() for image in display.judge(torch.from_numpy(phases)))
    truth = Seen([np.exp(1j * phases)], [1], stop, freely(PITCH, WAVELENGTH, distance)[0])
    places = [np.arange(n) for n in shape]
    expected = truth.means(*places)
    assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)
    assert abs(found.mean() / expected.mean() - 1) < 2e-3
    middles = truth.on_a_grid(*places)
    assert np.linalg.norm(points - middles) < 2e-3 * np.linalg.norm(middles)


@pytest.mark.parametrize("distance", [0.0, 1e-3, 5e-3])
@pytest.mark.parametrize("orders", [1, 3])
def test_the_judge_is_right_behind_a_square_stop_and_of_nine_orders(random, orders, distance, monkeypatch):
    if orders == 3:
        # On a grid a quarter as wide it is right too.
        monkeypatch.setattr(judge, "_LEAST", judge._LEAST // 4)
    phases = random.uniform(0, 6, (32, 28))
    iris = "order" if orders == 1 else None
    display = Display(Modulator((32, 28), PITCH, bits=None), WAVELENGTH, distance, iris=iris)
    found = display.judge(torch.from_numpy(phases))[0][0, 0].numpy()
    expected = seen_of([phases], distance, orders).means(np.arange(32), np.arange(28), points=5 * orders)
    assert np.linalg.norm(found - expected) < 5e-4 * np.linalg.norm(expected)


def test_the_judge_holds_the_orders_asked_for_and_says_what_they_leave_out(random, monkeypatch):
    # On a grid an eighth as wide the judge is right too.
    monkeypatch.setattr(judge, "_LEAST", judge._LEAST // 8)
    phases = random.uniform(0, 6, (2, 12, 10)) * [[[0.1]], [[1.0]]]
    powers = torch.tensor([[0.3, 0.9], [0.7, 0.1]])
    display = Display(Modulator((12, 10), PITCH, bits=None), [WAVELENGTH, 639e-9], 2e-3, 2, powers, iris=None)
    for orders in (2,):
        transfer, reach = freely(PITCH, WAVELENGTH, 2e-3)
        truth = Seen(np.exp(1j * phases), [0.3, 0.7], SquareStop((12, 10), orders * reach, orders), transfer)
        seen = truth.means(np.arange(12), np.arange(10), points=5 * orders)
        judged, _ = display.judge(torch.from_numpy(phases), orders=orders)
        assert np.linalg.norm(judged[0, 0].numpy() - seen) < 5e-4 * np.linalg.norm(seen)
    default, least = display.judge(torch.from_numpy(phases))[0], display.light_beyond(torch.from_numpy(phases))
    assert torch.equal(default, display.judge(torch.from_numpy(phases), orders=3)[0])
    # Energies by quadrature over frequencies; all light is the lit area.
    width = 0.9**0.5
    for orders in (1, 3, 4):
        stop, within = SquareStop((12, 10), orders=orders), []
        weights = np.outer(*(w for _, w in stop.nodes))
        for frame in phases:
            waves = stop.spectrum(np.exp(1j * frame), lambda y, x: width**2 * np.sinc(width * y) * np.sinc(width * x))
            within.append((abs(waves) ** 2 / weights).sum() / (width**2 * frame.size))
        found = display.light_beyond(torch.from_numpy(phases), orders=orders)
        assert np.abs(found.numpy() - (1 - powers.numpy().T @ within)).max() < 2e-5
        assert orders != 3 or torch.equal(found, least)
    for other in (Display(Modulator((12, 10), PITCH), WAVELENGTH, space) for space in (2e-3, Lens(0.1))):
        with pytest.raises(ValueError, match="orders must be None but for one panel without a stop"):
            other.judge(torch.zeros(1, 12, 10), orders=5)
    with pytest.raises(ValueError, match="orders must be"):
        display.judge(torch.zeros(2, 12, 10), orders=0)


def of_stop(stop, shape, distance):
    """Return a stop by its name, or the share of an order that a round one passes, and the quadrature over it."""
    if isinstance(stop, float):
        return of_iris(stop, shape, distance)
    orders = 3 if stop is None else 1
    return stop, SquareStop(shape, orders * freely(PITCH, WAVELENGTH, distance)[1], orders)


def through_space(light, _, distance, stop="order", medium=1.0):
    iris, nodes = of_stop(stop, light.shape, distance / medium)
    display = Display(Modulator(light.shape, PITCH, None), WAVELENGTH, distance, iris=iris, medium=medium)
    return display, Seen([light], [1], nodes, freely(PITCH, WAVELENGTH / medium, distance)[0])


def behind_a_lens(light, _, lens):
    a, b = lens.ray_matrix
    display = Display(Modulator(light.shape, PITCH, None), WAVELENGTH, lens)
    return display, Seen([light], [1], Focus(light.shape, a * PITCH**2 / (2 * WAVELENGTH * b)))


def in_an_eye(light, _, diameter, way=0.08, iris=None, place=(0.0, 0.0), focus=None):
    display = Display(Modulator(light.shape, PITCH, None), WAVELENGTH, Eyes(way, [place], diameter, focus), iris=iris)
    # From the panel to the pupil: freely, or through a lens and on.
    matrix = (1.0, way, 1.0)
    if isinstance(way, Lens):
        f, before, after = way.focal_length, way.before, way.after
        matrix = 1 - after / f, before + after - before * after / f, 1 - before / f
    retina = Retina(light.shape, PITCH, WAVELENGTH, matrix, diameter, place, focus, iris == "order")
    return display.double(), Seen([light], [1], retina)


def through_two_panels(light, amplitudes, gap, between, distance, stop):
    iris, nodes = of_stop(between, light.shape, gap)
    last, behind = of_stop(stop, light.shape, distance)
    panel = Modulator(light.shape, PITCH, None, lit_through=AmplitudePanel(gap, None, iris=iris))
    there, places = after_a_panel(amplitudes, light, nodes, freely(PITCH, WAVELENGTH, gap)[0])
    # The pixels of the second panel have their width already.
    seen = Seen([there], [1], behind, freely(PITCH, WAVELENGTH, distance, 1e-12)[0], places)
    return Display(panel, WAVELENGTH, distance, iris=last), seen


SIGHTS = {
    "at the panel": (through_space, (32, 28), 0.0),
    "near": (through_space, (32, 28), 1e-3),
    "far": (through_space, (32, 28), 2e-2),
    "larger": (through_space, (64, 48), 5e-3),
    "in glass": (through_space, (32, 28), 3e-3, "order", 1.5),
    "without a stop": (through_space, (32, 28), 1e-3, None),
    "a wide iris": (through_space, (32, 28), 3e-3, 0.9),
    "a narrow iris": (through_space, (32, 28), 3e-3, 0.1),
    "lens": (behind_a_lens, (32, 28), Lens(0.2)),
    "beside the focus": (behind_a_lens, (32, 28), Lens(0.02, before=0.03, after=0.0203)),
    "eye": (in_an_eye, (32, 28), 1e-3),
    "wide pupil": (in_an_eye, (64, 48), 3e-3),
    "eye that is focused nearer": (in_an_eye, (32, 28), 2e-3, 0.08, None, (0.0, 4e-4), 0.07),
    "eye behind a stop": (in_an_eye, (16, 14), 6e-4, 0.05, "order", (0.0, 2e-4)),
    "eyepiece": (in_an_eye, (32, 28), 1.5e-3, Lens(0.04, 0.03, 0.025)),
    "panels that touch": (through_two_panels, (32, 28), 0.0, "order", 5e-4, "order"),
    "panels apart": (through_two_panels, (24, 20), 5e-4, None, 2e-3, "order"),
    "panels and irises": (through_two_panels, (24, 20), -3e-4, 0.6, 5e-4, 0.4),
}


@pytest.mark.filterwarnings("ignore:the blur of the focus")
@pytest.mark.parametrize(
    "sight",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in ("wide pupil", "panels apart"))) for name in SIGHTS],
)
def test_images_and_their_judge_are_right_to_the_rim(random, sight, monkeypatch):
    """Against quadrature over stops and pupils: all pixels, in the image as a whole and in its outermost ones."""
    if sight == "without a stop" or "panels" in sight:
        # They have many samples in a pixel: on a grid half as wide the judge is right too.
        monkeypatch.setattr(judge, "_LEAST", judge._LEAST // 2)
    monkeypatch.setattr(judge, "_AIRY", 16)
    way, shape, *numbers = SIGHTS[sight]
    phases, amplitudes = random.uniform(0, 6, shape), random.uniform(0, 1, shape)
    display, seen = way(np.exp(1j * phases), amplitudes, *numbers)
    given = (torch.from_numpy(phases), torch.from_numpy(amplitudes))[: 1 + (way is through_two_panels)]
    expected, rim = seen.means(*map(np.arange, shape), points=12), np.ones(shape, bool)
    rim[1:-1, 1:-1] = False
    seen, shown, errors = display.judge(*given), display(given[0], None, *given[1:]), []
    for found, bound in ((seen.areas, 1e-3), (shown, 2e-3)):
        error = found[0, 0].numpy() - expected
        errors.append(np.linalg.norm(error) / np.linalg.norm(expected))
        assert errors[-1] < bound
        assert np.linalg.norm(error[rim]) < 2 * bound * np.linalg.norm(expected[rim])
    # What is stated is not less than what is true of the judge, and not much more than of the worse of both.
    assert errors[0] < 1.2 * float(seen.error) < 2 * max(errors)


LARGE = {
    "one order": ((270, 480), through_space, 3e-2),
    "at the panel": ((270, 480), through_space, 0.0),
    "in glass": ((270, 480), through_space, 2e-2, "order", 1.5),
    "a wide iris": ((270, 480), through_space, 3e-2, 0.6),
    "an iris": ((270, 480), through_space, 0.0, 0.3),
    "a narrow iris": ((270, 480), through_space, 3e-2, 0.1),
    "lens": ((270, 480), behind_a_lens, Lens(0.2)),
    "eye": ((270, 480), in_an_eye, 1e-3),
    "wide pupil": ((270, 480), in_an_eye, 3e-3, 0.075),
    "panels and irises": ((270, 480), through_two_panels, 1e-3, 0.3, 5e-3, 0.3),
    "full size": ((1080, 1920), through_space, 5e-2),
    "full size, an iris": ((1080, 1920), through_space, 5e-2, 0.3),
    "full size, lens": ((1080, 1920), behind_a_lens, Lens(0.2)),
    "full size, in glass": ((1080, 1920), through_space, 5e-2, "order", 1.5),
    "full size, eye": ((1080, 1920), in_an_eye, 3e-3, 0.3),
}


@pytest.mark.slow
@pytest.mark.parametrize("sight", LARGE)
def test_large_images_and_their_judge(random, sight):
    """At pixels drawn by a seed, edges and corners among them, against sums over all pixels."""
    shape, way, *numbers = LARGE[sight]
    phases, amplitudes = random.uniform(0, 6, shape).astype(np.float32), random.uniform(0, 1, shape).astype(np.float32)
    display, seen = way(np.exp(1j * phases.astype(float)), amplitudes, *numbers)
    rows, columns = (np.unique(np.r_[0, n - 1, random.integers(0, n, 14)]) for n in shape)
    expected = seen.means(rows, columns)
    assert expected.size >= 200
    given = (torch.from_numpy(phases), torch.from_numpy(amplitudes))[: 1 + (way is through_two_panels)]
    for found in (display.judge(*given)[0], display(given[0], None, *given[1:])):
        error = found[0, 0].numpy()[np.ix_(rows, columns)] - expected
        assert np.linalg.norm(error) < 2e-3 * np.linalg.norm(expected)


@pytest.mark.parametrize(("samples", "size"), [(2, 16), (3, 24), (6, 24)])
def test_points_are_those_of_the_intensity_on_a_finer_grid_too(samples, size):
    """The highest frequency of an even number of samples counted twice where the grid was refined."""
    light = torch.rand(size, size, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    shape = (size // samples // 2 * 2 - 2,) * 2
    found = observers.resolved(light, samples, shape, (0.0, 0.0))[:: observers.PLACES, :: observers.PLACES]
    torch.testing.assert_close(found, light[observers.pixels_of(light, samples, shape)], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("wide", "angle"), [(1, 3.0), (1.5, -20.0)])
@pytest.mark.usefixtures("small_judge")
def test_a_turned_camera(random, picture, wide, angle):
    display = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3)
    found = optimise(display, picture, run=Run(3, progress=False))
    who = Observer.camera(magnification=1 / wide, turned=angle)
    seen, target = seen_of(found.phases), picture.double().numpy()
    # Quarters of pixels, of which some are drawn.
    y, x = (random.integers(12, 4 * n - 16, 60) for n in picture.shape)
    expected = picture_means_at(target, y / 4, x / 4, wide, angle, 200)
    assert np.abs(who.picture(picture.double(), SQUARE).numpy()[y, x] - expected).max() < 3e-3
    between = who.wanted(picture.double(), SQUARE).numpy()
    assert (
        np.abs(between[3][8:-8, 8:-8] - who.picture(picture.double(), SQUARE).numpy()[2::4, 2::4][8:-8, 8:-8]).max()
        < 1e-6
    )
    light = torch.from_numpy(seen.on_a_grid(*(np.arange(4 * n) / 2 - n / 2 for n in picture.shape)))
    shown = who.image(light, 2, picture.shape, SQUARE).numpy()
    expected = seen.means_at(y / 4, x / 4, wide, angle, 8)
    assert np.abs(shown[y, x] - expected).max() < 2e-3 * expected.max()


def test_what_an_eye_sees_of_a_wave():
    """Of 1 + cos(2πf·x) with the transfer of eyes at this frequency: 1 + M·cos(2πf·x)."""
    seen, viewer = Viewing(0.02, 0.7, peak_luminance=200), Viewer(pupil=3)
    who, shape = Observer.eye(seen, viewer), (48, 64)
    density = 64 * 0.7 / 0.02 * math.pi / 180
    cycles = (0.25, 0.375)
    transfer = float(ocular_modulation_transfer(math.hypot(*cycles) * density, 3.0))
    assert 0.2 < transfer < 0.5

    def wave(y, x, depth):
        return 1 + depth * np.cos(2 * np.pi * (cycles[0] * y[:, None] + cycles[1] * x))

    light = torch.from_numpy(wave(*(np.arange(4 * n) / 2 - n / 2 for n in shape), 0.8))
    places = [np.arange(4 * n) / 4 for n in shape]
    expected = wave(*places, 0.8 * transfer)
    assert np.abs(who.image(light, 2, shape, SQUARE).numpy() - expected).max() < 1e-9
    points = torch.from_numpy(wave(*(np.arange(2 * n) / 2 for n in shape), 0.8))
    found = who.recorded(points.reshape(48, 2, 64, 2).permute(1, 3, 0, 2)[None], SQUARE)[:, 0].numpy()
    for grid, (down, across) in zip(found, GRIDS, strict=True):
        expected = wave(np.arange(48) + down, np.arange(64) + across, 0.8 * transfer)
        assert np.abs(grid - expected)[12:-12, 12:-12].max() < 5e-3
    # Of bars of squares, the mean of each wave of their series.
    bars = torch.from_numpy(np.tile(np.repeat([1.0, 0.0], 4), 8) + np.zeros((48, 1)))
    series = 0.5 + sum(
        2 / (np.pi * k) * (-1) ** (k // 2) * float(ocular_modulation_transfer(k / 8 * density, 3.0))
        * np.cos(2 * np.pi * k / 8 * (places[1] - 1.5))
        for k in range(1, 200, 2)
    )  # fmt: skip
    assert np.abs(who.picture(bars, SQUARE).numpy()[96] - series)[64:-64].max() < 4e-3
    assert np.abs(who.wanted(bars, SQUARE).numpy()[1][24] - series[2::4])[16:-16].max() < 4e-3


@pytest.mark.usefixtures("small_judge")
def test_an_eye_looks_at_a_hologram(picture):
    """The nearer it is, the more it sees; what is optimised for it is good for it; it is stated by all."""
    display = Display(Modulator(picture.shape, PITCH), WAVELENGTH, 2e-3)
    run = Run(15, progress=False)
    far, near = (Observer.eye(Viewing(0.01, distance), Viewer(pupil=3)) for distance in (0.7, 0.2))
    usual = optimise(display, picture, run=run)
    assert float(usual.psnr_of(far)) > float(usual.psnr_of(near)) + 3
    aimed = optimise(display, picture, run=run, observer=near)
    assert float(aimed.psnr) > float(usual.psnr_of(near)) + 0.3 and "an eye with a pupil of 3 mm" in repr(aimed)
    worst = usual.psnr_of(Observer.cameras())
    each = [float(usual.psnr_of(who)) for who in Observer.cameras()]
    assert float(worst) == pytest.approx(min(each))
    assert Observer.cameras()[-1].turned == 3
    with pytest.raises(ValueError, match=r"observer must see 0\.1 degrees of the image at each rim"):
        near.places((2, 40), SQUARE)
