"""What torch offers works with odak: compilation, transforms, lower precision, copies, processes."""

import copy
import functools
import io
import math
import pickle
import warnings

import numpy as np
import pytest
import representatives
import torch
from physics import relative_error
from representatives import ALL, Holograms, light_and_spot, representative
from torch import nn
from torch.utils.data import DataLoader

import odak
from odak import SamplingWarning
from odak.instruments import Lens
from odak.learn import wave
from odak.wave.propagation import propagate_beam, propagate_within_window

SPHERE = "intersect_w_sphere, refract"
NAMES = list(ALL)
QUICK = ["Bandlimited Angular Spectrum", "srgb_to_lab"]
WHOLE_GRAPHS = ["lens_phase", "BlurLoss", "CSFLoss", "PSNR", "SSIM", *representatives.FAMILIES["colour"]]
WHOLE_GRAPHS = [name for name in WHOLE_GRAPHS if name != "simulate_color_vision_deficiency"]
WHOLE_GRAPHS += list(representatives.FAMILIES["networks"])
WHOLE_GRAPHS += ["Bandlimited Angular Spectrum", "Impulse Response Fresnel", "Rayleigh-Sommerfeld"]
# What torch itself says of its own workings.
TORCHS_OWN = [r".*torch\.jit\.script.*", r".*autograd\.function\.Function.*should not be instantiated.*"]


@functools.cache
def case(name):
    """Return a function, an example, its value, and weights that make a number of it."""
    function, example = representative(name)
    value = function(example).detach()
    weights = torch.randn(value.shape, generator=torch.Generator().manual_seed(3), dtype=value.dtype)
    return function, example, value, weights


def number(function, weights):
    return lambda x: (function(x) * weights).sum()


def slope(function, example, weights):
    held = example.detach().clone().requires_grad_()
    return torch.autograd.grad(number(function, weights)(held), held)[0]


def distance(value, expected):
    value, expected = value.detach().double(), expected.detach().double()
    return float((value - expected).norm() / expected.norm().clamp_min(1e-12))


def close(value, expected, bound=2e-6):
    assert distance(value, expected) < bound


@pytest.mark.parametrize("name", [name for name in NAMES if name != SPHERE])
def test_vmap(name):
    function, example, *_ = case(name)
    two = torch.stack([example, 0.97 * example])
    close(torch.func.vmap(function)(two), torch.stack([function(one) for one in two]))


def test_vmap_where_the_size_of_the_result_depends_on_the_values():
    function, example, *_ = case(SPHERE)
    with pytest.raises(RuntimeError, match="dynamic shape"):
        torch.func.vmap(function)(torch.stack([example, 0.97 * example]))


@pytest.mark.parametrize("name", NAMES)
def test_grad_jacrev_and_forward_mode(name):
    function, example, value, weights = case(name)
    expected = slope(function, example, weights)
    close(torch.func.grad(number(function, weights))(example), expected, 2e-5)

    def part(x):
        return (function(x) * weights).reshape(-1)[: min(2, value.numel())]

    held = example.detach().clone().requires_grad_()
    rows = [torch.autograd.grad(one, held, retain_graph=True)[0] for one in part(held)]
    close(torch.func.jacrev(part)(example), torch.stack(rows), 2e-5)
    along = torch.randn(example.shape, generator=torch.Generator().manual_seed(4), dtype=example.dtype)
    with warnings.catch_warnings():
        for message in TORCHS_OWN:
            warnings.filterwarnings("ignore", message)
        _, forward = torch.func.jvp(number(function, weights), (example,), (along,))
    assert abs(forward - (expected * along).sum()) < 2e-5 * (expected * along).abs().sum()


def compiled(function, backend, **options):
    torch._dynamo.reset()
    return torch.compile(function, backend=backend, **options)


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in NAMES])
@pytest.mark.slow
def test_compile_is_correct_without_warnings(name):
    # The small grids of the cases lie outside the range of some methods, which says so in eager mode too.
    expected = (DeprecationWarning, SamplingWarning)
    function, example, value, weights = case(name)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        run = compiled(function, "aot_eager")
        close(run(example), value)
        close(slope(run, example, weights), slope(function, example, weights), 2e-5)
    assert not [str(one.message) for one in said if not issubclass(one.category, expected)]


@pytest.mark.parametrize(
    "name", [n if n in ("SSIM", QUICK[0]) else pytest.param(n, marks=pytest.mark.slow) for n in WHOLE_GRAPHS]
)
def test_compile_without_a_break(name):
    function, example, value, _ = case(name)
    with warnings.catch_warnings():
        for message in TORCHS_OWN:
            warnings.filterwarnings("ignore", message)
        close(compiled(function, "eager", fullgraph=True)(example), value)


@pytest.mark.filterwarnings(f"ignore:{TORCHS_OWN[1]}")
def test_a_step_of_gradient_descent_is_one_graph():
    target, phase = torch.rand(16, 16), torch.rand(16, 16, requires_grad=True)

    def loss(phase):
        field = wave.propagate_beam(wave.unit_phasor(phase), None, 1e-3, 8e-6, 532e-9)
        return ((wave.intensity(field) - target) ** 2).mean()

    found, expected = compiled(loss, "aot_eager", fullgraph=True)(phase), loss(phase)
    close(found, expected)
    close(*(torch.autograd.grad(value, phase)[0] for value in (found, expected)), 2e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings(f"ignore:{TORCHS_OWN[1]}")
@pytest.mark.parametrize("kind", ["colours and planes", "lens", "eyes", "two panels"])
def test_a_step_of_a_display_is_one_graph(kind):
    """Also of two displays in one graph, and of a second one where the first has been compiled."""
    first = wave.AmplitudePanel(1e-4) if kind == "two panels" else None
    panel, powers = wave.Modulator((16, 12), 8e-6, lit_through=first), torch.tensor([[1.0, 0.5], [0.0, 1.0]])
    places = [Lens(1e-2), Lens(1e-2, after=1.3e-2)] if kind == "lens" else [[2e-3, 3e-3], [4e-3, 5e-3]]
    if kind == "eyes":
        looks = {"positions": [(0.0, 0.0), (1e-4, 2e-4)], "diameter": 2e-4}
        places = [wave.Eyes(2e-2, focus=math.inf, **looks), wave.Eyes(Lens(2e-2, after=1e-2), **looks)]
    displays = [wave.Display(panel, [639e-9, 515e-9], place, 2, powers) for place in places]
    target, phase = torch.rand(displays[0].shape), 6 * torch.rand(2, 16, 12)

    def loss(phase, display):
        return (display(phase) - target).square().mean()

    def both(phase):
        return loss(phase, displays[0]) + 2 * loss(phase, displays[1])

    step = compiled(torch.func.grad(loss), "aot_eager", fullgraph=True)
    slopes = [torch.func.grad(loss)(phase, display) for display in displays]
    assert distance(*slopes) > 0.1
    for display, slope in zip(displays, slopes, strict=True):
        close(step(phase, display), slope, 2e-5)
    held = phase.clone().requires_grad_()
    value = compiled(both, "aot_eager", fullgraph=True)(held)
    close(value, both(phase))
    close(torch.autograd.grad(value, held)[0], slopes[0] + 2 * slopes[1], 2e-5)


@pytest.mark.slow
@pytest.mark.filterwarnings(f"ignore:{TORCHS_OWN[1]}")
def test_two_propagations_and_their_gradient_in_one_graph():
    def light(phase):
        field = wave.unit_phasor(phase)
        return sum(
            wave.intensity(wave.propagate_beam(field, None, z, 8e-6, 532e-9)).square().mean() for z in (1e-3, 2e-3)
        )

    phase = 6 * torch.rand(16, 16)
    close(compiled(torch.func.grad(light), "aot_eager", fullgraph=True)(phase), torch.func.grad(light)(phase), 2e-5)


@pytest.mark.slow
def test_errors_of_a_compiled_propagation_name_the_argument():
    with pytest.raises(ValueError, match="dx must be positive"):
        compiled(lambda field: wave.propagate_beam(field, None, 1e-3, -8e-6, 532e-9), "eager")(torch.ones(8, 8) + 0j)


NETWORKS = list(representatives.FAMILIES["networks"])


@pytest.mark.parametrize("name", NAMES)
def test_autocast(name):
    """Physics, colour and losses keep their precision under autocast; networks have that of bfloat16."""
    function, example, value, weights = case(name)
    held = example.detach().clone().requires_grad_()
    with torch.autocast("cpu", dtype=torch.bfloat16):
        result = function(held)
    gradient = torch.autograd.grad((result * weights).sum(), held)[0]
    if name in NETWORKS:
        close(result, value, 2e-2)
    else:
        assert result.dtype == value.dtype
        close(result, value, 1e-5)
        close(gradient, slope(function, example, weights), 1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_inference_mode_leaves_nothing_behind(name):
    _, example, value, weights = case(name)
    odak.wave.clear_kernel_cache()
    function, _ = representative(name)
    with torch.inference_mode():
        close(function(example.clone()), value)
    with torch.no_grad():
        assert not function(example).requires_grad
    close(slope(function, example, weights), slope(case(name)[0], example, weights))


MODULES = [name for name in NAMES if isinstance(representative(name)[0], nn.Module)]


@pytest.mark.parametrize("name", MODULES)
def test_copies_pickles_and_state_dicts_after_use(name):
    function, example, value, _ = case(name)
    fresh, _ = representative(name)
    fresh.load_state_dict(function.state_dict())
    stream = io.BytesIO()
    torch.save({"state": function.state_dict(), "result": function(example)}, stream)
    stream.seek(0)
    stored = torch.load(stream, weights_only=True)
    assert torch.equal(stored["result"].detach(), value)
    for other in (copy.deepcopy(function), pickle.loads(pickle.dumps(function)), fresh):
        assert torch.equal(other(example).detach(), value)
        assert all(torch.equal(v, stored["state"][k]) for k, v in other.state_dict().items())


def _used_before():
    """Fill the caches and start the threads that a forked child inherits."""
    for item in range(2):
        Holograms()[item]
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    large = torch.ones(1024, 1024, dtype=torch.complex64)
    wave.propagate_beam(large, None, 1e-3, 8e-6, 532e-9)
    case("rms_spot")[0](case("rms_spot")[1])
    torch.set_num_threads(threads)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["fork", "spawn", "forkserver"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_workers_of_a_data_loader(start):
    _used_before()
    found = list(DataLoader(Holograms(), 2, num_workers=2, multiprocessing_context=start, timeout=120))
    here = list(DataLoader(Holograms(), 2))
    for batch, expected in zip(found, here, strict=True):
        for value, own in zip(batch, expected, strict=True):
            close(value, own)


@pytest.mark.slow
@pytest.mark.parametrize("start", ["fork", "spawn"])
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_processes_started_after_use(start):
    _used_before()
    with torch.multiprocessing.get_context(start).Pool(1) as pool:
        found = pool.apply_async(light_and_spot).get(timeout=120)
    threads = torch.get_num_threads()
    for value, own in zip(found, light_and_spot(), strict=True):
        close(value, own)
    torch.set_num_threads(threads)


def test_a_fork_while_the_kernels_are_being_looked_up():
    """The child of a process whose other thread held the lock of the kernels does not wait for it for ever."""
    from odak.wave.transfer_functions import kernels

    cache = kernels.on("cpu")
    held = cache._lock
    with held:
        kernels.after_fork()
        assert cache._lock is not held
        assert cache.get("anything", lambda: torch.zeros(1)).shape == (1,)


@pytest.mark.parametrize("of_torch", ["export", "compile"])
@pytest.mark.parametrize("function", [propagate_beam, propagate_within_window])
def test_kernels_that_recorded_call_keeps_are_those_of_plain_one(function, of_torch):
    field = torch.randn(20, 24, dtype=torch.complex128, generator=torch.Generator().manual_seed(0))
    # Each case has a distance of its own, whose kernel no call before has kept.
    distance = 1e-3 * (1 + 0.1 * (function is propagate_beam) + 0.01 * (of_torch == "export"))
    lengths = {"distance": distance, "dx": 8e-6, "wavelength": 532e-9, "propagation_type": "Angular Spectrum"}

    class Module(torch.nn.Module):
        def forward(self, field):
            return function(field, **lengths)

    if of_torch == "export":
        recorded = torch.export.export(Module(), (field,)).module()
    else:
        recorded = torch.compile(Module(), backend="eager")
    found = recorded(field)
    expected = torch.as_tensor(np.asarray(function(field.numpy(), **lengths)))
    assert relative_error(found, expected) < 1e-12
    assert relative_error(function(field, **lengths), expected) < 1e-12
