"""Displays of real pixels against plain sums over frequencies, and holograms that are optimised for them."""

import math
import sys
import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from emulated_device import NAME, EmulatedDevice, copies, reads
from independent_camera import Seen, SquareStop, camera, freely

from odak import AccuracyWarning, ArgumentWarning, SamplingWarning
from odak.instruments import Calibration, Lens, SimulatedTable, save_calibration
from odak.learn.models import hologram_network
from odak.learn.wave import (
    AmplitudePanel,
    Descent,
    Display,
    Free,
    Iris,
    Modulator,
    Network,
    Observer,
    Problem,
    Run,
    multiplane_loss,
    optimise,
    propagator,
    spatial_light_modulator,
    stochastic_gradient_descent,
    training,
)
from odak.learn.wave.holograms.optimising import SOLVERS
from odak.learn.wave.holograms.starts import STARTS

pytestmark = pytest.mark.usefixtures("small_judge")

# What the weights of the network say of pixels with an area, where a test is about other things.
OF_POINTS = "ignore:the weights of .network. were trained for pixels that are points"
PITCH, WAVELENGTH = 8e-6, 532e-9
QUIET, BRIEF = Run(iterations=25, progress=False), Run(iterations=12, progress=False)


@pytest.fixture
def phases(random):
    return torch.from_numpy(random.uniform(0, 2 * np.pi, (1, 24, 20)))


@pytest.fixture
def disc():
    rows, columns = torch.meshgrid(torch.arange(40) - 20, torch.arange(48) - 24, indexing="ij")
    return 0.1 + 0.9 * ((rows**2 + columns**2) < 120).float()


def test_a_display_of_a_calibration_shows_what_its_table_shows(tmp_path, random):
    """The simulated table has the response, aberration, beam and distance of the file; so do the levels."""
    table = SimulatedTable(
        2, shape=(24, 20), distance=12e-3, camera_shape=(40, 36), camera_pitch=8e-6, misalignment=False, reflection=0.0
    )
    found = Calibration.nominal(table.modulator, table.camera, 532e-9, table.truth.distance)
    names = ("phases", "wavefront", "amplitude")
    save_calibration(tmp_path / "table.npz", replace(found, **{name: getattr(table.truth, name) for name in names}))
    display = Display.from_calibration(tmp_path / "table.npz", 1.0, iris=None)
    phases = torch.from_numpy(random.uniform(0, 6, (24, 20)))
    levels = display.modulator.levels(phases)
    assert torch.equal(levels, display.modulator.levels(display.modulator.shown(phases)))
    apart = abs(np.angle(np.exp(1j * (table.truth.phases[:, None, None] - phases.numpy()))))
    # Half the largest step between levels; the response ends beyond 2π.
    assert np.take_along_axis(apart, levels.numpy()[None], 0).max() <= np.diff(table.truth.phases).max() / 2
    table.modulator.show(levels.numpy())
    light, pitch = table.intensity()
    at = [light.shape[i] // 2 + (np.arange(n) - n // 2) * round(8e-6 / pitch) for i, n in enumerate((24, 20))]
    seen = display(phases)[0, 0].numpy()
    # Means at the rim of the image are less exact.
    inside, expected = np.s_[4:-4, 4:-4], light[np.ix_(*at)]
    assert np.abs(seen - expected)[inside].max() < 0.01 * expected.max()
    with pytest.raises(TypeError, match="calibration must be a Calibration or a file, got int"):
        Display.from_calibration(3)


def field_at(phases, distance, shift, fill, orders, cutoff=None, pitch=PITCH, wide=12):
    """Return the field of square pixels at points displaced by shares of a pixel: a sum over frequencies, in NumPy."""
    shape = [n * wide for n in phases.shape]
    grid = np.zeros(shape, complex)
    window = tuple(slice(m // 2 - n // 2, m // 2 - n // 2 + n) for m, n in zip(shape, phases.shape, strict=True))
    grid[window] = np.exp(1j * phases)
    spectrum = np.tile(np.fft.fft2(grid), (orders, orders))
    fy, fx = (np.fft.fftfreq(m * orders, pitch / orders) for m in shape)
    fy, fx = np.meshgrid(fy, fx, indexing="ij")
    side = math.sqrt(fill) * pitch
    transfer = np.exp(2j * np.pi * distance * np.sqrt(WAVELENGTH**-2 - fy**2 - fx**2 + 0j))
    transfer *= np.sinc(side * fy) * np.sinc(side * fx) * np.exp(2j * np.pi * pitch * (fy * shift[0] + fx * shift[1]))
    if cutoff is not None:
        transfer *= np.hypot(fy, fx) <= cutoff
    field = np.fft.ifft2(spectrum * transfer) * orders**2
    return field[::orders, ::orders][window]


@pytest.mark.parametrize("distance", [1e-3, 8e-3])
def test_fields_are_sums_over_frequencies(phases, distance):
    display = Display(Modulator((24, 20), PITCH, fill=0.8), WAVELENGTH, distance)
    found = display.fields(phases)[0, 0, 0].numpy()
    expected = field_at(phases[0].numpy(), distance, (0, 0), 0.8, 1, wide=30)
    assert np.linalg.norm(found - expected) < 3e-3 * np.linalg.norm(expected)


def test_transfer_functions_lie_in_order_in_which_they_are_read():
    for iris in ("order", None):
        display = Display(Modulator((8, 12), 8e-6), 532e-9, [2e-3, 3e-3], iris=iris)
        # On a CPU a column of the spectrum is read at a time: row by row, a step takes a third longer.
        assert display.path.kernels(display._kept, 0, torch.complex64, range(2)).stride()[-2:] == (1, 24)


def test_an_iris_cuts_the_spectrum(phases):
    iris = Iris(1e-3, 0.1)
    display = Display(Modulator((24, 20), PITCH, fill=1.0), WAVELENGTH, 2e-3, iris=iris)
    expected = field_at(phases[0].numpy(), 2e-3, (0, 0), 1.0, 1, iris.cutoff(WAVELENGTH), wide=40)
    found = display.fields(phases)[0, 0, 0].numpy()
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)


def test_deflected_light_has_the_envelope_of_a_pixel():
    ramp = (2 * torch.pi * 0.375 * torch.arange(64)).expand(1, 32, 64).double()
    display = Display(Modulator((32, 64), PITCH, bits=None, fill=1.0), WAVELENGTH, 1e-4)
    inside = display(ramp)[0, 0, 12:20, 28:36].mean()
    assert abs(inside - np.sinc(0.375) ** 2) < 0.01


def test_frames_and_colours_are_averaged_by_their_powers(random):
    phases = torch.from_numpy(random.uniform(0, 6, (2, 16, 16)))
    panel, lengths = Modulator((16, 16), PITCH), [639e-9, 515e-9]
    powers = torch.tensor([[1.0, 2.0], [3.0, 0.0]])
    both = Display(panel, lengths, 1e-3, frames=2, powers=powers)(phases)
    first, second = (Display(panel, 639e-9, 1e-3)(phase)[0, 0] for phase in phases)
    torch.testing.assert_close(both[0, 0], (first + 3 * second) / 4)
    torch.testing.assert_close(both[0, 1], Display(panel, 515e-9, 1e-3)(phases[0])[0, 0])


def test_medium_and_profile():
    phases = torch.rand(1, 16, 16, dtype=torch.float64)
    panel = Modulator((16, 16), PITCH)
    in_water = Display(panel, WAVELENGTH, 1e-3, medium=1.33, profile=torch.full((16, 16), 0.5, dtype=torch.float64))
    in_air = Display(panel, WAVELENGTH / 1.33, 1e-3)
    torch.testing.assert_close(in_water(phases), in_air(phases) / 4)


def test_gradients():
    display = Display(
        Modulator((4, 4), PITCH, response=spatial_light_modulator(bits=None)), [639e-9, 515e-9], [1e-3, 2e-3]
    )
    phases = torch.rand(2, 4, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(display, (phases,), fast_mode=True)


@pytest.mark.parametrize(
    "kind", ["round stop", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("no stop", "lens", "two panels"))]
)
def test_a_batch_is_its_patterns_one_by_one(kind, random):
    powers = torch.tensor([[1.0, 0.5], [0.0, 1.0]])
    options = {"round stop": {"iris": Iris(2e-3, 0.2)}, "no stop": {"iris": None}}.get(kind, {})
    first = AmplitudePanel(1e-4) if kind == "two panels" else None
    places = Lens(0.2) if kind == "lens" else [1e-3, 2e-3]
    panel = Modulator((8, 10), PITCH, response=spatial_light_modulator(bits=None), lit_through=first)
    display = Display(panel, [639e-9, 515e-9], places, 2, powers, torch.rand(8, 10), **options)
    phases = torch.from_numpy(random.uniform(0, 6, (3, 2, 8, 10)))
    given = {} if first is None else {"amplitudes": torch.from_numpy(random.uniform(0, 1, (3, 2, 8, 10)))}
    alone = [{name: values[i] for name, values in given.items()} for i in range(3)]
    for function in (display, display.fields):
        expected = torch.stack([function(one, **more) for one, more in zip(phases, alone, strict=True)])
        torch.testing.assert_close(function(phases, **given), expected)
        torch.testing.assert_close(function(phases.reshape(3, 1, 2, 8, 10))[1, 0], function(phases[1]))
        torch.testing.assert_close(torch.func.vmap(lambda p, more, f=function: f(p, **more))(phases, given), expected)

    with pytest.raises(ValueError, match="phases must be without a batch"):
        display.judge(phases, *given.values())

    def brightest(pattern):
        return display(pattern).square().mean()

    slopes = torch.stack([torch.autograd.grad(brightest(p), p)[0] for p in phases.clone().requires_grad_().unbind()])
    torch.testing.assert_close(torch.func.vmap(torch.func.grad(brightest))(phases), slopes)


@pytest.mark.filterwarnings("ignore:.*torch.jit.script.*:DeprecationWarning")
def test_forward_derivatives(random):
    display, phases = Display(Modulator((8, 10), PITCH), [639e-9, 515e-9], 1e-3), random.uniform(0, 6, (2, 2, 8, 10))
    place, direction = torch.from_numpy(phases)
    difference = (display(place + 1e-6 * direction) - display(place - 1e-6 * direction)) / 2e-6
    found = torch.func.jvp(display, (place,), (direction,))[1]
    torch.testing.assert_close(found, difference, rtol=1e-5, atol=1e-6)


def test_sources_that_are_on_follow_loaded_powers(random):
    phases, lengths = torch.from_numpy(random.uniform(0, 6, (2, 8, 10))), [639e-9, 515e-9]
    display, other = (Display(Modulator((8, 10), PITCH), lengths, 1e-3, 2, p) for p in (torch.eye(2), torch.ones(2, 2)))
    display.load_state_dict(other.state_dict())
    assert torch.equal(display(phases), other(phases))


def test_what_is_optimised_is_what_is_stated(disc):
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    found = optimise(display, disc, run=QUIET)
    plain, _ = stochastic_gradient_descent(disc, WAVELENGTH, 2e-3, PITCH, n_iteration=50, scale=True, progress=False)
    transfer, reach = freely(PITCH, WAVELENGTH, 2e-3)
    lights = [np.exp(1j * phase.double().numpy()) for phase in (found.phases[0], plain.angle())]
    stop = SquareStop(disc.shape, reach)
    at_best, plainly = (camera(Seen([light], [1], stop, transfer), disc.double().numpy()) for light in lights)
    assert abs(at_best.min() - float(found.psnr)) < 0.3
    assert at_best.min() > plainly.min() + 3
    assert len(found.losses) == 25 and found.losses[-1] < found.losses[0] / 4


def test_colours_planes_and_frames(disc):
    display = Display(Modulator(disc.shape, PITCH), [639e-9, 515e-9], [2e-3, 3e-3], frames=4)
    target = torch.stack([torch.stack([disc, disc.flip(1)]), torch.stack([disc.roll(5, 0), disc.roll(-6, 1)])])
    found = optimise(display, target, start="quadratic", run=BRIEF)
    assert found.images.shape == (2, 2, 40, 48) and found.levels().max() <= 255
    assert [row["wavelength"] for row in found.table()] == [639e-9, 515e-9] * 2
    worse = optimise(display, target, start="quadratic", run=Run(iterations=1, progress=False))
    assert bool((found.psnr > worse.psnr + 2).all())


def test_the_network_says_that_it_knows_points_only(disc):
    display, brief = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3), Run(iterations=10, progress=False)
    with pytest.warns(AccuracyWarning, match="trained for pixels that are points"):
        computed = optimise(display, disc, solver="network", start="flat", run=brief)
    assert optimise(display, disc, start="gs", run=brief).psnr > computed.psnr + 3
    with pytest.warns(AccuracyWarning, match="trained for pixels that are points"):
        optimise(display, disc, start="network", run=brief)
    points = Display(Modulator(disc.shape, PITCH, None, 1e-6), WAVELENGTH, 2e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimise(points, disc, solver="network", start="flat", run=brief)


@pytest.mark.filterwarnings(OF_POINTS)
@pytest.mark.parametrize("solver", ["adam", "gs", "network"])
def test_other_solvers_are_better_than_their_start(disc, solver):
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    found = optimise(display, disc, solver=solver, start="flat", run=QUIET)
    flat, _ = display.judge(torch.zeros(1, *disc.shape))
    scaled = flat * (flat * disc).sum() / flat.square().sum()
    assert found.psnr > -10 * torch.log10((scaled - disc).square().mean()) + 3


@pytest.mark.filterwarnings(OF_POINTS)
def test_names_of_solvers_and_starts(disc):
    display, brief = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3), Run(iterations=2, progress=False)
    assert set(SOLVERS) & set(STARTS) == {"gs", "double phase", "network"}

    def found(solver, start="flat"):
        return optimise(display, disc, solver=solver, start=start, run=brief)

    assert torch.equal(found("gs").phases, found("Gerchberg-Saxton").phases)
    begun = found("lbfgs", "gerchberg-saxton")
    assert torch.equal(begun.phases, found("lbfgs", "gs").phases) and begun.psnr > found("lbfgs").psnr + 3
    computed = found("network")
    assert torch.equal(computed.phases, found(Network(hologram_network(pretrained=True))).phases)
    # Two steps of descent from the network's hologram gain on it.
    assert found("lbfgs", "network").psnr > computed.psnr + 0.5
    with pytest.raises(ValueError, match="solver must be one of 'auto', 'lbfgs', 'adam', 'gs', 'double phase'"):
        found("quadratic")
    with pytest.raises(ValueError, match=r"start must be one of 'quadratic', 'flat', 'random', .*'gs', 'network'"):
        found("lbfgs", "adam")
    with pytest.raises(ValueError, match="behind a lens, got 'network'"):
        optimise(Display(display.modulator, WAVELENGTH, Lens(0.2)), disc, start="network", run=brief)


def test_double_phase_needs_its_iris(disc):
    with pytest.warns(UserWarning, match="double phase needs an iris"):
        wide = optimise(Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3), disc, solver="double phase", run=QUIET)
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3, iris=Iris(1.7e-3, 0.1))
    assert optimise(display, disc, solver="double phase", run=QUIET).psnr > wide.psnr + 3
    with pytest.raises(ValueError, match="double phase shows one colour on one plane"):
        optimise(
            Display(Modulator(disc.shape, PITCH), WAVELENGTH, [2e-3, 3e-3], iris=Iris(1.7e-3, 0.1)),
            disc.expand(2, 1, -1, -1),
            solver="double phase",
        )


def test_a_solver_is_one_class(disc):
    class Flat:
        def solve(self, problem):
            return torch.zeros_like(problem.start)

    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    assert not optimise(display, disc, solver=Flat()).phases.any()


@pytest.mark.filterwarnings(OF_POINTS)
@pytest.mark.parametrize("solver", ["gs", "double phase", "network"])
def test_solvers_make_up_for_the_aberration_of_a_panel(disc, solver):
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, n) for n in disc.shape), indexing="ij")
    aberration = 4 * (x**2 - y**2) + 3 * x * y
    plain, bent = (
        optimise(
            Display(Modulator(disc.shape, PITCH, None, response=panel), WAVELENGTH, 2e-3, iris=Iris(2e-3, 0.12)),
            disc,
            solver=solver,
            start="quadratic",
            run=Run(iterations=5, progress=False),
        )
        for panel in (None, spatial_light_modulator(bits=None, aberration=aberration))
    )
    # What leaves the panel is the same light; rounding grows from one iteration to the next.
    difference = torch.polar(torch.ones_like(plain.phases), bent.phases + aberration - plain.phases)
    torch.testing.assert_close(difference, torch.ones_like(difference), rtol=0, atol=1e-3)


@pytest.mark.parametrize(("solver", "iris"), [("gs", "order"), ("double phase", Iris(2e-3, 0.12))])
def test_solvers_make_up_for_uneven_light(disc, solver, iris):
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, n) for n in disc.shape), indexing="ij")
    lit = {"profile": torch.exp(-0.7 * (x**2 + y**2)), "iris": iris}
    even = optimise(Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3, iris=iris), disc, solver=solver, run=QUIET)

    class Even:
        def solve(self, problem):
            return even.phases

    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3, **lit)
    known, ignored = (optimise(display, disc, solver=one, run=QUIET).psnr for one in (solver, Even()))
    assert known > ignored + 2


def test_a_run_is_continued_bit_for_bit(disc, tmp_path):
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    whole = optimise(display, disc, solver=Descent("adam"), run=Run(iterations=6, progress=False))
    options = {"iterations": 6, "progress": False, "checkpoint": tmp_path / "run.pt"}
    stop = Run(callback=lambda iteration, loss: iteration == 2, **options)
    optimise(display, disc, solver=Descent("adam"), run=stop)
    assert torch.equal(optimise(display, disc, solver=Descent("adam"), run=Run(**options)).phases, whole.phases)
    panel, light = Modulator(disc.shape, PITCH), torch.full(disc.shape, 0.5)
    dim = spatial_light_modulator(bits=None, amplitude=light)
    for other in (
        Display(panel, WAVELENGTH, 2.00001e-3),
        Display(panel, WAVELENGTH, 2e-3, medium=1.33),
        Display(panel, WAVELENGTH, 2e-3, profile=light),
        Display(panel, WAVELENGTH, 2e-3, powers=torch.tensor([[0.5]])),
        Display(Modulator(disc.shape, PITCH, bits=4), WAVELENGTH, 2e-3),
        Display(Modulator(disc.shape, PITCH, response=dim), WAVELENGTH, 2e-3),
    ):
        with pytest.raises(ValueError, match="is of another run: its display"):
            optimise(other, disc, solver=Descent("adam"), start=whole.phases, run=Run(**options))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"target": torch.full((40, 48), 200.0)}, "divide by 255"),
        ({"target": torch.zeros(3, 40, 48)}, "target must be"),
        ({"solver": "magic"}, "solver must be"),
        ({"start": torch.zeros(2, 2)}, "start must be"),
    ],
)
def test_what_does_not_fit_is_named(disc, arguments, message):
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    with pytest.raises((ValueError, TypeError), match=message):
        optimise(display, **{"target": disc, **arguments})


def test_levels_are_no_phases_and_black_is_no_target(disc):
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3)
    levels = torch.full(disc.shape, 128, dtype=torch.int32)
    for given in (levels, levels.numpy(), levels.to(torch.uint8)):
        with pytest.raises(ValueError, match="phases must be in radians, got integers up to 128: levels of the panel"):
            display(given)
    assert torch.equal(display(0 * levels), display(torch.zeros(disc.shape)))
    with pytest.warns(ArgumentWarning, match="target is black"):
        optimise(display, torch.zeros_like(disc), start="flat", run=Run(1, progress=False))


def test_planes_too_far_for_the_panel_are_named(phases):
    """Against one-dimensional sums with Fresnel's phases, of which light of so few pixels is made at such distances."""
    cycles = (np.arange(25_000) + 0.5) / 50_000  # and as many below zero, where everything is the same
    waves = np.cos(2 * np.pi * cycles[:, None] * np.arange(24))
    light = np.exp(1j * phases[0].numpy())
    panel = Modulator((24, 20), PITCH, bits=None, fill=1.0)
    for distance, known in ((1.0, True), (3.0, False)):
        if known:
            display = Display(panel, WAVELENGTH, distance)
            found = display.fields(phases)[0, 0, 0].numpy()
        else:
            with pytest.warns(ArgumentWarning, match="distances are in metres: over 3 m .* did you mean 3mm"):
                display = Display(panel, WAVELENGTH, distance)
            with pytest.warns(SamplingWarning, match=r"24 × 20 samples, 8e-06 m apart, at a distance of 3 m is known"):
                found = display.fields(phases)[0, 0, 0].numpy()
        chirp = np.sinc(cycles) * np.exp(-1j * np.pi * WAVELENGTH * distance * (cycles / PITCH) ** 2)
        response = chirp @ waves / len(cycles)
        down, across = (response[np.abs(np.arange(n)[:, None] - np.arange(n))] for n in (24, 20))
        exact = np.abs(down @ light @ across)
        assert (np.abs(np.abs(found) - exact).max() < 0.02 * exact.max()) == known


def test_millimetres_for_metres_are_named_once_where_a_display_is_made(recwarn):
    Display(Modulator((1080, 1920), PITCH), WAVELENGTH, 150)
    assert len(recwarn) == 1 and recwarn[0].filename == __file__
    assert "over 150 m the first order of the pixels becomes 649 times as wide as the panel" in str(recwarn[0].message)
    recwarn.clear()
    for distance in (0.15, 5.0, -0.2):
        Display(Modulator((1080, 1920), PITCH), WAVELENGTH, distance)
    assert not recwarn.list


@pytest.mark.parametrize("start", [None, "gs", "double phase"])
def test_a_start_that_nobody_chose_warns_of_no_method(start, recwarn):
    """Far from a small panel the band-limited method keeps a tenth of the band: the exact one gives the start."""
    display = Display(Modulator((48, 48), PITCH), WAVELENGTH, 0.14)
    options = {} if start is None else {"start": start}
    optimise(display, torch.rand(48, 48), run=Run(iterations=1, progress=False), **options)
    assert not [str(warning.message) for warning in recwarn]


def test_displays_that_cannot_be_are_named():
    panel = Modulator((16, 16), PITCH)
    with pytest.raises(ValueError, match="powers must light each wavelength"):
        Display(panel, [639e-9, 515e-9], 1e-3, frames=1)
    lit = Display(panel, [639e-9, 515e-9], 1e-3, profile=torch.ones(16, 16))
    lit.powers[:, 1] = 0
    for use in (lit, lit.judge, lambda phases: optimise(lit, torch.ones(1, 2, 16, 16), solver="gs")):
        with pytest.raises(ValueError, match=r"powers must light each wavelength in a frame, got \[1.0, 0.0\]"):
            use(torch.zeros(2, 16, 16))
    with pytest.warns(AccuracyWarning, match=r"passes 0\.24 periods across the modulator.* radius of 2e-05 m right"):
        Display(panel, WAVELENGTH, 1e-3, iris=Iris(20e-6, 0.02))
    with pytest.raises(ValueError, match="iris must be"):
        Display(panel, WAVELENGTH, 1e-3, iris="round")
    with pytest.raises(ValueError, match="fill"):
        Modulator((16, 16), PITCH, fill=1.2)
    with pytest.raises(ValueError, match="response must have a fill factor of 1"):
        Modulator((16, 16), PITCH, response=spatial_light_modulator(fill_factor=0.9))


def test_powers_that_do_not_fit_the_frames_of_a_display_are_named():
    display, phases = Display(Modulator((16, 16), PITCH), [639e-9, 515e-9], 2e-3), torch.zeros(2, 16, 16)
    others = torch.tensor([[0.0, 1.0], [1.0, 0.0]])
    with pytest.warns(ArgumentWarning, match=r"where it stays off: make a display of these powers by lit_by"):
        assert not display(phases, others).any()
    assert display.lit_by(others)(phases).min() > 0
    with pytest.raises(ValueError, match="powers must light each wavelength"):
        display(phases, torch.tensor([[1.0, 0.0], [0.0, 0.0]]))


def test_powers_of_the_sources_are_found(disc):
    target = torch.stack([disc.roll(-9, 1), 0.5 * disc.roll(9, 1), disc.roll(9, 0)])
    display = Display(Modulator(disc.shape, PITCH), [639e-9, 515e-9, 473e-9], 2e-3, frames=3, powers=torch.ones(3, 3))
    fixed, found = (
        optimise(display, target, start="random", solver=Descent(powers=powers), run=QUIET) for powers in (False, True)
    )
    assert found.psnr.mean() > fixed.psnr.mean() + 5
    powers = found.display.powers
    assert powers.max() == 1 and not torch.equal(fixed.display.powers, powers)
    # The sources of a colour are as bright as its image.
    torch.testing.assert_close(powers.sum(0) / powers.sum(), found.brightness / found.brightness.sum())
    areas, _ = found.display.judge(found.phases)
    torch.testing.assert_close(areas * found.brightness[:, None, None], found.images)


def test_slopes_of_powers_and_sources_that_are_off():
    powers = torch.tensor([[0.5, 1.5], [0.7, 0.0]], dtype=torch.float64, requires_grad=True)
    display = Display(Modulator((4, 4), PITCH, bits=None), [639e-9, 515e-9], 1e-3, 2, powers.detach())
    phases = torch.rand(2, 4, 4, dtype=torch.float64, requires_grad=True)
    torch.testing.assert_close(display.lit_by(3 * powers)(phases), display(phases))
    assert torch.autograd.gradcheck(
        lambda p, a: display(p, torch.cat([a[:3], a[3:] * 0]).reshape(2, 2)),
        (phases, powers.detach().flatten().requires_grad_()),
        fast_mode=True,
    )
    problem = Problem(display, torch.rand(1, 2, 4, 4).double(), torch.nn.functional.mse_loss, phases.detach(), QUIET)
    assert Descent(powers=True).solve(problem)[1][1, 1] == 0


@pytest.mark.parametrize("method", ["lbfgs", "adam"])
def test_a_replayed_graph_gives_the_same(disc, method, monkeypatch):
    """The graph is emulated: what is captured is computed again into the same tensors, as a replay does."""
    captured = []

    def capture(compute, device):
        outputs = compute()
        captured.append(outputs)

        def replay():
            for kept, found in zip(outputs, compute(), strict=True):
                kept.copy_(found)

        return replay, outputs

    monkeypatch.setattr(training, "_captured", capture)
    display = Display(Modulator(disc.shape, PITCH), [639e-9, 515e-9], 2e-3, 2, torch.ones(2, 2))
    target, run = torch.stack([disc, disc.flip(0)]), Run(iterations=6, progress=False)
    plain, replayed = (
        optimise(display, target, solver=Descent(method, powers=True, graph=graph), run=run) for graph in (False, True)
    )
    assert len(captured) == 1 and plain.losses == replayed.losses and len(set(plain.losses)) == 6
    assert torch.equal(plain.phases, replayed.phases) and torch.equal(plain.display.powers, replayed.display.powers)


@pytest.mark.parametrize("space", [2e-3, Lens(0.1)])
def test_a_recorded_step_waits_for_nothing(space):
    """Which a graph of CUDA cannot do. Before one is recorded, the first step makes the transfer functions."""
    with EmulatedDevice():
        display = Display(Modulator((8, 12), PITCH), WAVELENGTH, space).to(NAME)
        target, phases = torch.rand(1, 1, 8, 12).to(NAME), torch.rand(1, 8, 12).to(NAME).detach().requires_grad_()
        problem = Problem(display, target, torch.nn.functional.mse_loss, phases, QUIET)
        found = []
        for _ in range(2):
            before = reads + copies
            torch.autograd.grad(problem.loss_of(phases, display.powers), phases)
            found.append(reads + copies - before)
        before = reads + copies
        display.powers.tolist()
        torch.ones(2).to(NAME)
        # What is counted is counted.
        assert sum((reads + copies - before).values()) == 2
    assert found[0] and not found[1]


def test_where_no_graph_can_be_recorded(disc):
    display, brief = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3), Run(iterations=1, progress=False)
    solver = Descent("adam", graph=True)
    with pytest.raises(ValueError, match="graph must be False where the display is not on a CUDA device, got cpu"):
        optimise(display, disc, solver=solver, run=brief)
    with pytest.raises(ValueError, match="graph must be False where parts of the picture are computed apart"):
        optimise(display, disc, solver=solver, run=brief, devices=["cpu", "cpu"])
    with pytest.raises(ValueError, match="graph must be False where random numbers are drawn"):
        optimise(display, disc, lambda images, target, generator=None: images.mean(), solver, run=brief)
    with pytest.raises(TypeError, match="graph"):
        Descent(graph="yes")


@pytest.mark.cuda
def test_a_graph_on_cuda(disc):
    display, run = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3).cuda(), Run(iterations=8, progress=False)
    for method in ("lbfgs", "adam"):
        plain, graph = (optimise(display, disc, solver=Descent(method, graph=g), run=run) for g in (False, True))
        assert len(set(graph.losses)) == 8
        torch.testing.assert_close(torch.tensor(graph.losses), torch.tensor(plain.losses), rtol=1e-3, atol=0)
        here = optimise(display.cpu(), disc, solver=Descent(method), run=run)
        torch.testing.assert_close(torch.tensor(graph.losses), torch.tensor(here.losses), rtol=1e-2, atol=0)
        display = display.cuda()


def test_a_picture_with_depth_is_sharp_on_its_own_plane(disc):
    depth = (torch.arange(48) > 24).float().expand(40, -1)
    display = Display(Modulator(disc.shape, PITCH), WAVELENGTH, [2e-3, 4e-3])
    loss = multiplane_loss(disc, depth, blur_ratio=2.0, number_of_planes=2)
    near, far = optimise(display, loss, run=BRIEF), optimise(display, loss.targets, loss=loss, run=BRIEF)
    assert torch.equal(near.phases, far.phases) and far.psnr_in_focus is None
    assert bool((near.psnr_in_focus > near.psnr.min() - 3).all())
    alike = optimise(display, loss, run=BRIEF, observer=Observer.camera(registered=True))
    sharp = torch.where(depth[None] == 0, alike.images[0], alike.images[1])
    torch.testing.assert_close(alike.psnr_in_focus, -10 * (sharp - disc).square().mean((1, 2)).log10())
    by_geometry = optimise(display, (disc, depth), run=BRIEF)
    assert torch.equal(by_geometry.target[0, 0, :, :25], disc[:, :25])
    assert by_geometry.target[0, 0, :, 25:].std() < disc[:, 25:].std() and by_geometry.psnr_in_focus > 15


def test_defocus_of_an_iris_in_a_medium_is_that_of_the_same_light_in_air(disc):
    depth = (torch.arange(48) > 24).float().expand(40, -1)
    panel, run = Modulator(disc.shape, PITCH), Run(iterations=1, progress=False)
    in_water = Display(panel, WAVELENGTH, [2e-3, 4e-3], iris=Iris(1e-3, 0.05), medium=1.33)
    # Waves of the wavelength in the medium; the iris passes the same frequencies.
    in_air = Display(panel, WAVELENGTH / 1.33, [2e-3, 4e-3], iris=Iris(1e-3 / 1.33, 0.05))
    wet, dry = (optimise(display, (disc, depth), run=run).target for display in (in_water, in_air))
    torch.testing.assert_close(wet, dry)


def test_a_seed_reaches_the_random_numbers_of_a_loss(disc):
    def noisy(images, target, generator=None):
        return (images - target - 0.1 * torch.randn(target.shape, generator=generator)).square().mean()

    display, seeds = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 2e-3), (1, 1, 2)
    runs = [Run(iterations=3, seed=seed, progress=False) for seed in seeds]
    one, again, other = (optimise(display, disc, noisy, "adam", "flat", run).phases for run in runs)
    assert torch.equal(one, again) and not torch.equal(one, other)


@pytest.mark.parametrize("lens", [Lens(0.2), Lens(0.02, before=0.03, after=0.0203, block=1e-5)])
def test_images_behind_a_lens_are_sums_over_the_pixels(lens):
    """Fourier sums within the envelope of square pixels; the mean over a point's area; both computations of it."""
    profile = torch.rand(24, 30, generator=torch.Generator().manual_seed(0), dtype=torch.float64) + 0.5
    display = Display(Modulator((24, 30), 8e-6, bits=None, fill=0.81), 532e-9, lens, profile=profile)
    phases = 6.3 * torch.rand(24, 30, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    a, b = lens.ray_matrix
    y, x = ((np.arange(n) - n // 2) * 8e-6 for n in (24, 30))
    light = profile.numpy() * np.exp(1j * phases.numpy() + 1j * np.pi * a / (532e-9 * b) * (y[:, None] ** 2 + x**2))

    def point(i, j):
        fy, fx = (i - 12) / 24, (j - 15) / 30
        field = np.exp(-2j * np.pi * fy * y / 8e-6) @ light @ np.exp(-2j * np.pi * fx * x / 8e-6)
        seen = abs(field * np.sinc(0.9 * fy) * np.sinc(0.9 * fx)) ** 2 / (24 * 30)
        return seen * (np.hypot(fy, fx) * 532e-9 * b / 8e-6 >= lens.block)

    fields, images = display.fields(phases)[0, 0, 0], display(phases)[0, 0]
    areas, middles = (part[0, 0] for part in display.judge(phases))
    for i, j in ((0, 0), (5, 9), (14, 20), (12, 15)):
        assert abs(fields[i, j].item()) ** 2 == pytest.approx(point(i, j), abs=1e-12)
    assert torch.allclose(fields.abs() ** 2, middles, atol=1e-12)
    inside = (np.arange(20) + 0.5) / 20 - 0.5
    for i, j in ((5, 9), (14, 20)):
        mean = np.mean([[point(i + down, j + across) for across in inside] for down in inside])
        assert areas[i, j].item() == pytest.approx(mean, rel=5e-3)
        assert images[i, j].item() == pytest.approx(mean, rel=1e-2)


def test_holograms_behind_a_lens(tmp_path):
    """Those of a calibrated table correct its aberration: the table shows them, on the points of their images."""
    lens = Lens(20e-3)
    options = {"misalignment": False, "distance_error": 0.0, "reflection": 0.0, "camera_pitch": 4e-6}
    table = SimulatedTable(3, shape=(32, 32), distance=lens, aberration=0.5, camera_shape=(300, 300), **options)
    truth = table.truth
    known = Calibration.nominal(table.modulator, table.camera, 532e-9, lens)
    known = replace(known, phases=truth.phases, wavefront=truth.wavefront, amplitude=truth.amplitude)
    save_calibration(tmp_path / "lens.h5", known)
    target = torch.zeros(32, 32)
    target[6:12, 8:24] = 1
    display = Display.from_calibration(tmp_path / "lens.h5", fill=1.0)
    assert "lens of 20 mm" in repr(display)
    found = optimise(display, target, run=Run(iterations=60, progress=False))
    assert found.psnr.item() > 25 and found.psnr_registered.item() > 27
    table.modulator.show(found.levels()[0].numpy())
    light, pitch = table.intensity()
    spots = [
        np.rint((np.arange(32) - 16) * 532e-9 * 20e-3 / (32 * 8e-6) / pitch).astype(int) + n // 2 for n in light.shape
    ]
    seen = torch.as_tensor(light[np.ix_(*spots)])
    points = (display.fields(found.phases)[0, 0, 0].abs() ** 2).float()
    assert torch.corrcoef(torch.stack([seen.flatten(), points.flatten()]))[0, 1] > 0.98
    with pytest.raises(ValueError, match="needs a display without a lens"):
        optimise(display, target, solver="gerchberg-saxton")
    with pytest.raises(ValueError, match="start must be 'gs', 'quadratic'"):
        optimise(display, target, start="double phase")


def field_of_two_panels(amplitudes, phases, gap, distance, width, between, after):
    """Return the field at the middles of the pixels, in NumPy: squares, plane waves, and a finely sampled mask.

    Pixels emit in the inner squares of a width in pixels; `between` and `after` are what stops pass, a function of the
    frequencies along rows and columns in cycles per pixel.
    """
    fine, side = 16, 12 * max(phases.shape)
    places = ((np.arange(side * fine) + 0.5) / fine - side // 2) * PITCH
    cycles = np.fft.fftfreq(side * fine, 1 / fine)
    down, across = cycles[:, None], cycles[None]
    axial = np.sqrt(WAVELENGTH**-2 - (down**2 + across**2) / PITCH**2)
    pixels = [(np.arange(n) - n // 2) for n in phases.shape]
    waves = [np.exp(-2j * np.pi * cycles[:, None] * at) * np.sinc(width * cycles)[:, None] for at in pixels]
    spectrum = waves[0] @ amplitudes @ waves[1].T * between(down, across) * np.exp(2j * np.pi * gap * axial)
    turn = np.exp(2j * np.pi * cycles / PITCH * places[0])
    light = np.fft.ifft2(spectrum * turn[:, None] * turn) * fine**2
    mask, inner = np.zeros_like(light), round(width * fine) // 2
    for (i, j), phase in np.ndenumerate(phases):
        row, column = ((side // 2 + at[k]) * fine for at, k in zip(pixels, (i, j), strict=True))
        mask[row - inner : row + inner, column - inner : column + inner] = np.exp(1j * phase) / width**2
    spectrum = np.fft.fft2(light * mask) / (turn[:, None] * turn) * np.exp(2j * np.pi * distance * axial)
    left, right = (np.exp(2j * np.pi * at[:, None] * cycles) for at in pixels)
    return left @ (spectrum * after(down, across)) @ right.T / (side * fine) ** 2


def passes(half):
    def stop(down, across):
        each = [0.5 * (abs(f) < half) + 0.5 * (abs(f) <= half) for f in (down, across)]
        return each[0] * each[1]

    return stop


def within(radius):
    return lambda down, across: down**2 + across**2 <= radius**2


ROUND = {radius: Iris(radius / PITCH * WAVELENGTH * 0.1, 0.1) for radius in (0.6, 0.4)}


@pytest.mark.parametrize(
    ("gap", "iris", "between", "last", "after"),
    [
        (0.0, "order", passes(0.5), "order", passes(0.5)),
        pytest.param(5e-4, None, passes(1.5), "order", passes(0.5), marks=pytest.mark.slow),
        (-3e-4, ROUND[0.6], within(0.6), ROUND[0.4], within(0.4)),
    ],
)
def test_two_panels_in_series(gap, iris, between, last, after, random):
    amplitudes, phases = random.uniform(0, 1, (8, 6)), random.uniform(0, 6, (8, 6))
    width = 6 / 8
    panel = Modulator((8, 6), PITCH, None, width**2, lit_through=AmplitudePanel(gap, None, width**2, iris))
    display = Display(panel, WAVELENGTH, 5e-4, iris=last)
    given = torch.from_numpy(phases), torch.from_numpy(amplitudes)
    found = display.fields(*given)[0, 0, 0].numpy()
    expected = field_of_two_panels(amplitudes, phases, gap, 5e-4, width, between, after)
    assert np.linalg.norm(found - expected) < 0.007 * np.linalg.norm(expected)


def test_a_clear_panel_at_the_modulator_changes_nothing_but_edges(random):
    phases = torch.from_numpy(random.uniform(0, 6, (1, 40, 40)))
    alone = Modulator((40, 40), PITCH, None)
    both = replace(alone, lit_through=AmplitudePanel(0.0, None, 1.0, None))
    found, expected = (Display(panel, WAVELENGTH, 5e-4)(phases) for panel in (both, alone))
    assert (found - expected)[..., 8:-8, 8:-8].abs().max() < 0.05 * expected.max()


def test_gradients_of_two_panels(random):
    panel = Modulator((4, 5), PITCH, None, lit_through=AmplitudePanel(2e-4, iris=None))
    powers = torch.tensor([[1.0, 0.3], [0.0, 1.0]], dtype=torch.float64)
    display = Display(panel, [WAVELENGTH, 639e-9], [3e-4, 5e-4], 2, powers, profile=torch.rand(4, 5).double())
    phases, amplitudes = (torch.from_numpy(random.uniform(0, 1, (2, 4, 5))).requires_grad_() for _ in range(2))
    assert torch.autograd.gradcheck(lambda p, a: display(p, amplitudes=a), (phases, amplitudes), fast_mode=True)


def test_a_picture_on_two_panels(disc):
    found = []
    for first in (None, AmplitudePanel(1e-3)):
        display = Display(Modulator(tuple(disc.shape), PITCH, lit_through=first), WAVELENGTH, 3e-3)
        found.append(optimise(display, disc, start="flat", run=BRIEF))
    alone, both = found
    assert float(both.psnr) > float(alone.psnr) + 3 and alone.amplitudes is None
    levels = both.display.modulator.lit_through.levels(both.amplitudes)
    assert levels.dtype == torch.int32 and torch.equal(levels / 255, both.amplitudes) and levels.max() <= 255
    again = both.display(both.phases, amplitudes=both.amplitudes) * both.brightness[:, None, None]
    assert ((again - both.images)[..., 4:-4, 4:-4]).abs().max() < 0.05


def test_what_does_not_fit_two_panels(disc):
    panel = Modulator(tuple(disc.shape), PITCH, lit_through=AmplitudePanel())
    with pytest.raises(ValueError, match="where more than one order passes the iris of the display, got iris=None"):
        Display(panel, WAVELENGTH, 3e-3, iris=None)
    with pytest.raises(ValueError, match="got a display behind a lens"):
        Display(panel, WAVELENGTH, Lens(20e-3))
    display = Display(panel, WAVELENGTH, 3e-3)
    with pytest.raises(ValueError, match="needs a modulator without lit_through"):
        optimise(display, disc, solver="gerchberg-saxton", run=QUIET)
    with pytest.raises(ValueError, match="devices must be None for one picture on two panels"):
        optimise(display, disc, devices=["cpu", "cpu"], run=QUIET)
    with pytest.raises(ValueError, match=r"amplitudes must be 0 … 1, got 0\.0 to 2\.0"):
        display(disc, amplitudes=2 * (disc > 0.5).float())
    with pytest.raises(ValueError, match=r"amplitudes must be \[frames, rows, columns\] = \[1, 40, 48\]"):
        display(disc, amplitudes=disc[1:])
    with pytest.raises(ValueError, match="amplitudes must be None for a modulator without lit_through"):
        Display(replace(panel, lit_through=None), WAVELENGTH, 3e-3)(disc, amplitudes=disc)
    with pytest.raises(TypeError, match="lit_through must be an AmplitudePanel or None, got float"):
        replace(panel, lit_through=1e-3)
    with pytest.raises(ValueError, match="iris must be 'order', an Iris or None"):
        AmplitudePanel(iris="round")


def test_alternating_projections_know_the_iris():
    """Their image is one of the frequencies that pass: better through the iris than what the whole order would show."""
    target = torch.zeros(1, 1, 64, 64)
    target[..., 15:50, 20:30] = 1
    target[..., 25:40, 35:50] = 0.5
    iris = Iris(0.2 * WAVELENGTH * 0.2 / PITCH, 0.2)
    through, open_ = (Display(Modulator((64, 64), PITCH), WAVELENGTH, 1e-2, iris=stop) for stop in (iris, "order"))
    errors = []
    for display in (through, open_):
        image = through(optimise(display, target, solver="gs", run=replace(QUIET, seed=1)).phases)
        scale = (image * target).sum() / image.square().sum()
        errors.append(float((scale * image - target).square().mean()))
    assert errors[0] < 0.7 * errors[1]


def test_each_colour_in_sequence_has_its_own_table():
    """Each frame is what a display of its colour and table alone shows, and its levels are those of its table."""
    colours, shape = [639e-9, 515e-9, 473e-9], (16, 24)
    tables = [span * torch.linspace(0, 1, 16) ** power for span, power in ((5.0, 1.0), (6.0, 1.3), (7.0, 0.8))]
    panels = [spatial_light_modulator(bits=4, lut=table) for table in tables]
    phases = 7 * torch.rand(3, *shape, generator=torch.Generator().manual_seed(0))
    display = Display(Modulator(shape, PITCH, 4, response=panels), colours, [2e-3])
    for f, (colour, panel) in enumerate(zip(colours, panels, strict=True)):
        alone = Display(Modulator(shape, PITCH, 4, response=panel), colour, [2e-3])
        torch.testing.assert_close(display(phases)[:, f], alone(phases[f])[:, 0])
        assert torch.equal(display.modulator.levels(phases)[f], panel.levels(phases[f]))
        torch.testing.assert_close(display.modulator.shown(phases)[f], tables[f][panel.levels(phases[f]).long()])
    found = optimise(display, torch.rand(1, 3, *shape), run=replace(QUIET, seed=1, iterations=3))
    assert found.levels().shape == (3, *shape) and int(found.levels().max()) <= 15
    assert (
        display.fingerprint() != Display(Modulator(shape, PITCH, 4, response=panels[::-1]), colours, 2e-3).fingerprint()
    )
    with pytest.raises(ValueError, match="one for each of 3 frames, got 2"):
        Display(Modulator(shape, PITCH, 4, response=panels[:2]), colours, [2e-3])
    with pytest.raises(TypeError, match="response"):
        Modulator(shape, PITCH, response=[1, 2])


def test_an_iris_takes_lengths_with_units():
    assert Iris("2mm", "20cm") == Iris(2e-3, 0.2)


def older(distances, **options):
    """Return the older display of planes with the panel and the colours of the tests below."""
    return propagator(
        (16, 20),
        [639e-9, 515e-9],
        PITCH,
        1,
        2,
        len(distances),
        distances=distances,
        pixel_fill=0.9,
        **({"aperture": "open"} | options),
    )


@pytest.mark.parametrize(
    ("method", "relay"), [("Transfer Function Fresnel", 0.0), ("Bandlimited Angular Spectrum", 0.3), ("auto", 0.0)]
)
def test_free_space_by_other_methods_and_relays_is_that_of_the_older_display(method, relay, random):
    phases = torch.from_numpy(random.uniform(0, 6, (2, 16, 20)))
    mask = torch.from_numpy(random.uniform(0, 1, (32, 40)))
    distances = [relay + 2e-3, relay + 3e-3]
    kind = "back and forth" if relay else "forward"
    old = older(distances, propagation_type=method, aperture=mask, propagator_type=kind, image_location_offset=relay)
    # Frame f in the light of source f.
    expected = old.reconstruct(phases, get_complex=True).diagonal(dim1=0, dim2=2)
    display = Display(Modulator((16, 20), PITCH, None), [639e-9, 515e-9], Free(distances, relay, method, mask), 2)
    torch.testing.assert_close(display.fields(phases).diagonal(dim1=0, dim2=2), expected)
    assert display.distances == pytest.approx((2e-3, 3e-3))


@pytest.mark.parametrize("response", [None, spatial_light_modulator(bits=4)])
def test_phases_scale_with_the_wavelength_as_in_the_older_display(response, random):
    phases, scale = torch.from_numpy(random.uniform(0, 6.2, (1, 16, 20))), [1.0, 639 / 515]
    old = propagator(
        *((16, 20), [639e-9, 515e-9], PITCH), distances=[2e-3], propagator_type="forward", pixel_fill=0.9,
        slm=response, laser_channel_power=torch.ones(1, 2), aperture="open",
    )  # fmt: skip
    old.phase_scale = torch.tensor(scale, dtype=torch.float64)
    panel = Modulator((16, 20), PITCH, None, response=response, phase_scale=scale)
    display = Display(panel, [639e-9, 515e-9], 2e-3, 1, torch.ones(1, 2))
    # Each within the tolerance of its kernels, which are for windows of their own.
    torch.testing.assert_close(display.fields(phases), old.reconstruct(phases, get_complex=True), rtol=0, atol=3e-4)
    turned = phases + 2 * torch.pi * (phases > 3)
    torch.testing.assert_close(display(turned), display(phases), rtol=1e-5, atol=1e-5)
    inside = np.s_[..., 3:-3, 3:-3]
    assert (display.judge(phases)[0] - display(phases))[inside].abs().max() < 0.03 * display(phases).max()
    torch.testing.assert_close(display(phases.expand(3, 1, 16, 20))[2], display(phases))


def test_holograms_of_a_panel_whose_phases_scale(disc):
    """What a solver asks for at the colour of a frame is what the panel shows there."""
    scale = [1.0, 639 / 515]
    scaled, plain = (
        Display(Modulator(disc.shape, PITCH, None, phase_scale=s), [639e-9, 515e-9], 2e-3) for s in (scale, None)
    )
    target = disc.expand(1, 2, -1, -1)
    for solver in ("gs", "lbfgs"):
        found, expected = (optimise(display, target, solver=solver, run=BRIEF) for display in (scaled, plain))
        torch.testing.assert_close(found.psnr, expected.psnr, rtol=0, atol=0.01 if solver == "gs" else 5.0)
    assert scaled.fingerprint() != plain.fingerprint()
    wanted = torch.linspace(0, 6.2, 50)
    near = Modulator((1, 50), PITCH, phase_scale=[0.8]).asked(wanted, 0) * 0.8
    apart = (near - wanted + torch.pi).remainder(2 * torch.pi) - torch.pi
    # A fifth of the circle is out of reach, and half of it from the nearer end.
    assert apart.abs().max() < 0.1 * 2 * torch.pi + 1e-4 and near.max() < 0.8 * 2 * torch.pi
    with pytest.raises(ValueError, match="phase_scale must have 2 factors"):
        Display(Modulator((4, 4), PITCH, phase_scale=[1.0]), [639e-9, 515e-9], 1e-3)


def test_a_mask_is_in_what_is_judged(random):
    """Of random phases: the judge computes with a grid and a method of its own, and the mask makes a difference."""
    phases = torch.from_numpy(random.uniform(0, 6, (1, 32, 32)))
    panel, mask = Modulator((32, 32), PITCH), torch.ones(32, 20).double()
    masked, open_ = (
        Display(panel, WAVELENGTH, Free(2e-3, mask=m)) for m in (torch.nn.functional.pad(mask, (6, 6)), None)
    )
    inside = np.s_[..., 4:-4, 4:-4]
    areas, _ = masked.judge(phases)
    shown = masked(phases)
    assert (areas - shown)[inside].abs().max() < 0.02 * shown.max()
    assert (shown - open_(phases))[inside].abs().max() > 0.2 * shown.max()
    assert masked.fingerprint() != open_.fingerprint()


def test_gradients_of_distances_are_those_of_the_older_display(random):
    phases = torch.from_numpy(random.uniform(0, 6, (2, 16, 20)))
    slopes = []
    for new in (True, False):
        distances = torch.tensor([2e-3, 3e-3], dtype=torch.float64, requires_grad=True)
        if new:
            display = Display(Modulator((16, 20), PITCH, None), [639e-9, 515e-9], Free(distances), 2)
            light = display.fields(phases).abs().square()
            light = torch.stack([light[0, :, 0], light[1, :, 1]])
        else:
            light = older(distances, propagator_type="forward", aperture="open").reconstruct(phases, no_grad=False)
            light = torch.stack([light[0, :, 0], light[1, :, 1]])
        slopes.append(torch.autograd.grad(light.square().mean(), distances)[0])
    torch.testing.assert_close(*slopes, rtol=1e-4, atol=0)
    image = display(phases)
    assert float(torch.autograd.grad(image.square().mean(), display.path.ends.distances)[0].abs().min()) > 0


def test_distances_jitter_as_in_the_older_display(random):
    phases, distances = torch.from_numpy(random.uniform(0, 6, (2, 16, 20))), [2e-3, 3e-3]
    errors = {"vaccination": True, "vaccination_scale": 2e-4, "seed": 7}
    old = older(distances, propagator_type="forward", aperture="open", **errors)
    display = Display(Modulator((16, 20), PITCH, None), [639e-9, 515e-9], Free(distances, jitter=2e-4), 2)
    display._seeded(7)
    found = []
    for _ in range(2):
        expected = old.reconstruct(phases, get_complex=True).diagonal(dim1=0, dim2=2)
        found.append(display.fields(phases).diagonal(dim1=0, dim2=2))
        torch.testing.assert_close(found[-1], expected, rtol=0, atol=3e-4)
    assert (found[0] - found[1]).abs().max() > 0.1 * found[0].abs().max()
    still = Display(display.modulator, [639e-9, 515e-9], Free(distances), 2)
    assert torch.equal(display.judge(phases)[0], still.judge(phases)[0])


def test_a_hologram_that_bears_misplacement(disc, tmp_path):
    """By a seed the same each time, also by a run that is taken up and in parts; off its plane it loses less."""
    panel, run = Modulator(disc.shape, PITCH), Run(iterations=8, progress=False, seed=3)
    bearing, plain = (Display(panel, WAVELENGTH, Free(6e-3, jitter=j)) for j in (4e-4, 0.0))
    found, again, other = (optimise(d, disc, solver="adam", run=run) for d in (bearing, bearing, plain))
    assert torch.equal(found.phases, again.phases) and bearing.fingerprint() != plain.fingerprint()
    off = Display(panel, WAVELENGTH, 6.5e-3)
    errors = []
    for hologram in (found, other):
        image = off.judge(hologram.phases)[0][0, 0]
        errors.append((image * ((image * disc).sum() / image.square().sum()) - disc).square().mean())
    assert errors[0] < 0.8 * errors[1]
    kept = replace(run, checkpoint=tmp_path / "run.pt", callback=lambda i, _: i == 3)
    optimise(bearing, disc, solver="adam", run=kept)
    assert torch.equal(optimise(bearing, disc, solver="adam", run=replace(kept, callback=None)).phases, found.phases)
    few = replace(run, iterations=3)
    both = [optimise(bearing, disc, solver="adam", run=replace(few, memory_budget=b)).losses for b in (None, 1)]
    assert both[0] == pytest.approx(both[1], rel=1e-5)
    with pytest.raises(ValueError, match="devices must be None for one picture with jitter"):
        optimise(bearing, disc, solver="adam", run=run, devices=["cpu", "cpu"])
    # A line search needs a loss that stays as it is: the solver that is chosen by itself is Adam.
    assert torch.equal(optimise(bearing, disc, run=few).phases, optimise(bearing, disc, solver="adam", run=few).phases)
    with pytest.raises(ValueError, match="method must be 'adam' for distances with jitter"):
        optimise(bearing, disc, solver="lbfgs", run=few)


def test_projections_tell_their_progress_and_can_be_ended(disc):
    """The first loss is the error of the image's amplitude at points, which fields state too; a stop ends all frames.

    The two propagate by other transfer functions, whose edges of the band differ.
    """
    display, told = Display(Modulator(disc.shape, PITCH), WAVELENGTH, 6e-3, frames=2), []
    start = torch.zeros(2, *disc.shape)
    run = Run(4, progress=False, callback=lambda *given: told.append(given))
    found = optimise(display, disc, solver="gs", start=start, run=run)
    assert [number for number, _ in told] == list(range(8)) and len(found.losses) == 8
    wanted = (display.fields(start)[0, 0, 0].abs() - disc.sqrt()).square().mean()
    assert told[0][1] == pytest.approx(float(wanted), rel=0.02) and told[3][1] < 0.7 * told[0][1]
    ended = optimise(display, disc, solver="gs", start=start, run=replace(run, callback=lambda i, _: i == 1))
    assert len(ended.losses) == 3
    alone = optimise(display, disc, solver="gs", start=start, run=Run(2, progress=False))
    assert torch.equal(ended.phases[0], alone.phases[0]) and not torch.equal(ended.phases[1], alone.phases[1])

    def interrupted(iteration, _):
        if iteration == 1:
            raise KeyboardInterrupt

    assert torch.equal(
        optimise(display, disc, solver="gs", start=start, run=replace(run, callback=interrupted)).phases, ended.phases
    )


def test_what_does_not_fit_free_space():
    panel = Modulator((16, 20), PITCH)
    with pytest.raises(ValueError, match="without a mask or method where more than one order passes the iris"):
        Display(panel, WAVELENGTH, Free(1e-3, method="Transfer Function Fresnel"), iris=None)
    message = r"mask must be \[16, 20\] or \[32, 40\], at least 8 along each axis, for one panel, got \[16, 16\]"
    with pytest.raises(ValueError, match=message):
        Display(panel, WAVELENGTH, Free(1e-3, mask=torch.ones(16, 16)))
    with pytest.raises(ValueError, match="for one panel, got two panels"):
        Display(replace(panel, lit_through=AmplitudePanel()), WAVELENGTH, Free(1e-3, mask=torch.ones(16, 20)))
    with pytest.raises(ValueError, match=r"distances must be \[planes\] where it is a tensor"):
        Free(torch.ones(1, 1, requires_grad=True))


@pytest.mark.parametrize(("colours", "most"), [([532e-9], 640), ([639e-9, 515e-9, 473e-9], 1280)])
def test_an_iteration_makes_few_calls(colours, most):
    """Of Python and C alike: arguments are checked once, at the door, and nothing constant is computed again."""
    display, counts, made = Display(Modulator((64, 64), PITCH), colours, 2e-3), [], 0

    def count(frame, event, argument):
        nonlocal made
        made += event in ("call", "c_call")

    run = Run(iterations=3, progress=False, callback=lambda iteration, loss: counts.append(made))
    before = sys.getprofile()
    sys.setprofile(count)
    try:
        optimise(display, torch.rand(display.shape), start="flat", run=run)
    finally:
        sys.setprofile(before)
    assert counts[1] - counts[0] <= most
