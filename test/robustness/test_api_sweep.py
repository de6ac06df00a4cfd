"""Wrong and unusual arguments to everything public: a correct result, or an error that names the argument.

The walk finds the calls by itself. Valid arguments of a new one come from the example in its docstring; otherwise they
are entered in `test/api_sweep/examples`, unless the names of its arguments are known there already.
"""

import inspect

import pytest
import torch
from api_sweep import contract, examples, hostile, samples, walk

from odak.wave.transfer_functions import kernels

CALLABLES = walk.public_callables()


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("sweep")


@pytest.fixture(autouse=True)
def settings_stay():
    """Put back what a call may set for the whole process."""
    size, threads = kernels.maximum_bytes, torch.get_num_threads()
    yield
    kernels.resize(size)
    torch.set_num_threads(threads)


class Call:
    """A public call with its valid arguments; a method belongs to an object made from its class's arguments."""

    def __init__(self, path, root):
        self.path, self.root = path, root
        self.declared = CALLABLES[path]
        self.owner_path = path.rpartition(".")[0]
        self.owner = CALLABLES.get(self.owner_path)
        self.object, self.others = None, (None, {})

    def function(self, **arguments):
        """Call it; what refuses its arguments leaves them, and the object of a method, as they were, to serve again."""
        made, self.object = self.object, None
        others, self.others = self.others, (None, {})
        if inspect.isclass(self.owner) and made is None:
            made = contract.call(self.owner, samples.arguments(self.owner_path, self.owner, self.folder))
        try:
            return (self.declared if made is None else getattr(made, self.declared.__name__))(**arguments)
        except (ValueError, TypeError):
            self.object, self.others = made, others
            raise

    def but(self, name):
        """Return valid arguments without one, made anew unless the last call has refused them."""
        if self.others[0] != name:
            self.others = name, self.arguments(name)
        return self.others[1]

    def arguments(self, without=None):
        return samples.arguments(self.path, self.declared, self.folder, without)

    def folder(self):
        return contract.fresh_folder(self.root)

    def result(self):
        """Return what the valid arguments give, or None where that differs from call to call."""
        first = contract.call(self.function, self.arguments())
        if not contract.flat(first):  # such as a figure, which takes long and has no numbers to compare
            return first
        again = contract.call(self.function, self.arguments())
        return first if contract.same(first, again, 1e-6) else None

    def complaints(self):
        expected = self.result()
        known = self.arguments()
        for name, valid in known.items():
            strict = {
                "positive": samples.is_positive(self.path, name),
                "side": samples.is_side(self.path, name),
                "free_text": samples.is_free_text(self.path, name),
            }
            for what, wrong, verdict in hostile.wrong_values(valid, **strict):
                yield name, what, contract.judge(self.function, self.but(name) | {name: wrong}, name, verdict)
            for what, form, tolerance in hostile.other_forms(valid):
                changed = self.arguments(name) | {name: form}
                yield name, what, contract.compare(self.function, changed, name, expected, tolerance)
        tensors = [name for name, valid in known.items() if isinstance(valid, torch.Tensor)]
        for name in tensors if len(tensors) > 1 else []:
            yield name, "on another device", contract.judge_elsewhere(self.function, self.arguments, name)


@pytest.mark.usefixtures("small_judge")
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, marks=pytest.mark.slow if path in examples.SLOW else ())
        for path in CALLABLES
        if samples.is_called(path)
    ],
)
def test_each_argument_is_checked(path, root):
    complaints = [
        f"{name} = {what}: {complaint}"
        for name, what, complaint in Call(path, root).complaints()
        if complaint and not samples.is_allowed(path, name, what)
    ]
    assert not complaints, "\n" + "\n".join(complaints)


def test_calls_swept_with_the_slow_tests_exist():
    assert not examples.SLOW.difference(path for path in CALLABLES if samples.is_called(path))


def test_no_default_argument_can_be_changed():
    changeable = [
        f"{path}({parameter.name}={parameter.default!r})"
        for path, function in CALLABLES.items()
        for parameter in samples.parameters_of(function)
        if isinstance(parameter.default, (list, dict, set, bytearray))
    ]
    assert not changeable
