"""Every number of every public function of `odak.learn`: its gradient flows, or a warning says that it does not."""

import contextlib
import inspect
import io
import warnings

import numpy as np
import pytest
import torch
from api_sweep import contract, samples, walk

# Numbers on which the result does not depend.
WITHOUT_EFFECT = {"odak.learn.raytracing.bring_plane_to_origin: shape", "odak.learn.raytracing.refract: error"}


@pytest.mark.slow
@pytest.mark.parametrize("package", ["jones", "models", "perception", "raytracing", "tools", "wave"])
def test_gradients_of_numbers_are_not_lost_in_silence(package, tmp_path):
    lost = set()
    for path, function in walk.public_callables().items():
        if path.startswith(f"odak.learn.{package}.") and samples.is_called(path):
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
        number, argument = followed(value)
        if number is not None:
            yield name, outcome(run, samples.arguments(path, function, folder) | {name: argument}, number)


def followed(value):
    """Return a tensor in place of a number, or of the first of several, and the argument that holds it."""
    numbers = value if isinstance(value, (list, tuple)) else (value,)
    if not numbers or not all(isinstance(part, float) for part in numbers):
        return None, None
    number = torch.tensor(numbers[0], dtype=torch.float64, requires_grad=True)
    return number, number if numbers is not value else type(value)([number, *numbers[1:]])


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
