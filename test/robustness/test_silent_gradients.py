"""Every number of every public function of `odak.learn`: its gradient flows, or a warning says that it does not."""

import contextlib
import inspect
import io
import warnings

import numpy as np
import pytest
import torch
from api_sweep import contract, samples, walk

# Numbers on which the result does not depend, or only by steps: counts, limits of iterations, numbers of samples cut.
WITHOUT_EFFECT = {
    "odak.learn.raytracing.bring_plane_to_origin: shape",
    "odak.learn.raytracing.refract: error",
    "odak.learn.tools.sphere_sample: k",
    "odak.learn.tools.sphere_sample_uniform: k",
    "odak.wave.fraunhofer_equal_size_adjust: distance",
    "odak.wave.fraunhofer_equal_size_adjust: dx",
    "odak.wave.fraunhofer_equal_size_adjust: wavelength",
    "odak.wave.scattered_field: tolerance",
    # Its media have given indices; through a glass it flows: see test_nonsequential.py.
    "odak.learn.raytracing.RayScene.trace: wavelength",
    # The result is a system, whose surfaces hold the gradients: see test_environment.py.
    "odak.learn.raytracing.system.in_environment: pressure",
    "odak.learn.raytracing.system.in_environment: temperature",
}
LEARN = tuple(f"odak.learn.{name}." for name in ("jones", "models", "perception", "raytracing", "tools", "wave"))


@pytest.mark.slow
@pytest.mark.parametrize("package", [*LEARN, "odak.jones.", "odak.wave."])
def test_gradients_of_numbers_are_not_lost_in_silence(package, tmp_path):
    lost = set()
    for path, function in walk.public_callables().items():
        if path.startswith(package) and samples.is_called(path):
            for name, outcome in outcomes(path, function, tmp_path):
                lost |= {f"{path}: {name}"} if outcome == "lost" else set()
    assert lost <= WITHOUT_EFFECT


def outcomes(path, function, root):
    """Yield the name of each argument that is a number, and what becomes of its gradient."""
    owner_path = path.rpartition(".")[0]
    owner = walk.public_callables().get(owner_path) if inspect.isclass(function) is False else None

    def folder():
        return contract.fresh_folder(root)

    def run(**arguments):
        if not inspect.isclass(owner):
            return function(**arguments)
        made = contract.call(owner, samples.arguments(owner_path, owner, folder))
        return getattr(made, function.__name__)(**arguments)

    defaults = {p.name: p.default for p in samples.parameters_of(function) if isinstance(p.default, float)}
    for name, value in (defaults | samples.arguments(path, function, folder)).items():
        for number, argument in followed(value):
            given = samples.arguments(path, function, folder) | {name: argument}
            yield name, outcome(run, in_torch(given) if ".learn." not in path else given, number)


def followed(value):
    """Yield a tensor in place of a number, of the first of several and of all of them, and the argument it is in."""
    numbers = value if isinstance(value, (list, tuple)) else (value,)
    if numbers and all(isinstance(part, float) for part in numbers):
        number = torch.tensor(numbers[0], dtype=torch.float64, requires_grad=True)
        yield number, number if numbers is not value else type(value)([number, *numbers[1:]])
        several = torch.tensor(numbers, dtype=torch.float64, requires_grad=True)
        yield several, several


def in_torch(arguments):
    """Return arguments of a function for any array library with tensors in place of NumPy's arrays."""
    return {name: torch.from_numpy(v) if isinstance(v, np.ndarray) else v for name, v in arguments.items()}


def outcome(run, arguments, number):
    torch.manual_seed(7)
    with (
        warnings.catch_warnings(record=True) as caught,
        np.errstate(all="ignore"),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        warnings.simplefilter("always")
        try:
            result = run(**arguments)
        except Exception:
            return "refused"
    if any("requires a gradient" in str(warning.message) for warning in caught):
        return "reported"
    return "flows" if any(depends(value, number) for value in tensors(result, set())) else "lost"


def depends(value, number):
    if value is number or not value.requires_grad:
        return value is number
    try:
        return torch.autograd.grad(value.abs().sum(), number, allow_unused=True, retain_graph=True)[0] is not None
    except (RuntimeError, NotImplementedError):
        return False


def tensors(value, seen, depth=0):
    """Yield the tensors that a result holds, in its attributes too."""
    if isinstance(value, torch.Tensor):
        yield value
    elif id(value) not in seen and depth < 5:
        seen.add(id(value))
        if isinstance(value, (list, tuple, dict)):
            parts = value.values() if isinstance(value, dict) else value
        else:
            parts = getattr(value, "__dict__", {}).values() if not isinstance(value, type) else ()
        for part in list(parts):
            yield from tensors(part, seen, depth + 1)
