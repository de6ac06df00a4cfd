"""Break a file in one place at a time and see whether its tests notice.

    python test/mutate.py odak/wave/transfer_functions.py TEST [TEST …] [-k …] [--list] [--sample N]

Each mutant changes one operator, comparison, constant or function name of the file; whatever makes a test fail kills
it. The tests are collected and run once, to see which of them run which function. Then each mutant of a function gets a
fork of that process, in which the function's code is exchanged and those tests run, quickest first. What modules do
when they are imported cannot be exchanged so: such mutants get a process of their own and all tests. Nothing is written
to the file. The last line gives killed / all; the lines above it are the survivors. POSIX only.
"""

import argparse
import ast
import copy
import difflib
import functools
import gc
import importlib.machinery
import inspect
import io
import os
import random
import signal
import sys
import time
import types
from pathlib import Path

SWAPS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
PAIRS = (
    "sin cos|minimum maximum|min max|floor ceil|any all|zeros_like ones_like|zeros ones|real imag|fft ifft|fftn ifftn"
)
NAMES = {a: b for pair in PAIRS.split("|") for a, b in (pair.split(), pair.split()[::-1])}
REMOVED = {"abs", "sqrt", "conj", "fftshift", "ifftshift", "square", "square_", "sign", "sign_"}


class Mutator(ast.NodeTransformer):
    """Apply the mutation of one number, and count them; annotations, texts and error messages are left alone."""

    def __init__(self, wanted: int):
        self.wanted, self.seen, self.line = wanted, 0, 0

    def _here(self, node) -> bool:
        self.seen += 1
        if self.seen == self.wanted:
            self.line = getattr(node, "lineno", self.line)
        return self.seen == self.wanted

    def _skip(self, node):
        return node

    visit_Raise = visit_JoinedStr = visit_Import = visit_ImportFrom = _skip

    def visit_AnnAssign(self, node):
        node.value = self.visit(node.value) if node.value else None
        return node

    def visit_arg(self, node):
        return node

    def visit_FunctionDef(self, node):
        node.args = self.visit(node.args)
        node.body = [self.visit(statement) for statement in node.body]
        return node

    def visit_BinOp(self, node):
        if type(node.op) in SWAPS and self._here(node):
            node.op = SWAPS[type(node.op)]()
        return self.generic_visit(node)

    visit_AugAssign = visit_BoolOp = visit_BinOp

    def visit_Compare(self, node):
        for i, operator in enumerate(node.ops):
            if type(operator) in SWAPS and self._here(node):
                node.ops[i] = SWAPS[type(operator)]()
        return self.generic_visit(node)

    def visit_UnaryOp(self, node):
        if self._here(node):
            return node.operand
        return self.generic_visit(node)

    def visit_If(self, node):
        if self._here(node):
            node.test = ast.UnaryOp(ast.Not(), node.test)
            return node
        return self.generic_visit(node)

    visit_IfExp = visit_If

    def visit_Constant(self, node):
        if isinstance(node.value, bool):
            return ast.Constant(not node.value) if self._here(node) else node
        if isinstance(node.value, int | float) and self._here(node):
            return ast.Constant(node.value + 1 if isinstance(node.value, int) else node.value * 1.01 or 1e-3)
        return node

    def visit_Attribute(self, node):
        if node.attr in NAMES and self._here(node):
            node.attr = NAMES[node.attr]
        return self.generic_visit(node)

    def visit_Name(self, node):
        if node.id in NAMES and self._here(node):
            node.id = NAMES[node.id]
        return node

    def visit_Call(self, node):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name in REMOVED and self._here(node):
            method = isinstance(node.func, ast.Attribute) and not node.args
            return node.func.value if method else node.args[0]
        return self.generic_visit(node)


def mutant(tree: ast.Module, wanted: int) -> tuple[ast.Module, Mutator]:
    """Return the tree with the mutation of that number, and the mutator that made it."""
    mutator = Mutator(wanted)
    return ast.fix_missing_locations(mutator.visit(copy.deepcopy(tree))), mutator


class Session:
    """Pytest plugin: run the tests once with an eye on the file, then once more for each mutant of its functions."""

    def __init__(self, path: Path, tree: ast.Module, mutants: list[tuple[int, ast.Module, str]], report):
        self.path, self.tree, self.mutants, self.report = path, tree, mutants, report

    def pytest_runtestloop(self, session):
        seen, taken = {}, {}
        for item in session.items:
            start = time.monotonic()
            seen[item] = self._functions_run(lambda item=item: _run_item(item))
            taken[item] = time.monotonic() - start
        if session.testsfailed or not _passes(lambda: self._mutated(session, self.tree, session.items), 600):
            self.report(None)
            return True
        quickest = sorted(session.items, key=taken.get)
        for number, tree, name in self.mutants:
            items = [item for item in quickest if name in seen[item]]
            limit = 20 + 10 * sum(taken[item] for item in items)
            self.report(number, _passes(lambda t=tree, i=items: self._mutated(session, t, i), limit))
        return True

    def _functions_run(self, call) -> set[str]:
        names = set()

        def trace(frame, event, arg):
            if frame.f_code.co_filename == str(self.path):
                names.add(frame.f_code.co_qualname.split(".")[0])

        sys.settrace(trace)
        try:
            call()
        finally:
            sys.settrace(None)
        return names

    def _mutated(self, session, tree: ast.Module, items) -> bool:
        for module in [m for m in sys.modules.values() if getattr(m, "__file__", None) == str(self.path)]:
            namespace = {"__name__": module.__name__, "__file__": module.__file__, "__package__": module.__package__}
            exec(compile(tree, str(self.path), "exec"), namespace)
            for name, old in list(vars(module).items()):
                _exchange(old, namespace.get(name), module.__name__)
        for cache in [kept for kept in gc.get_objects() if type(kept) is functools._lru_cache_wrapper]:
            cache.cache_clear()
        for item in items:
            _run_item(item)
            if session.testsfailed:
                return False
        return True


def _run_item(item) -> None:
    item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)


def _exchange(old, new, module: str) -> None:
    """Give a function, or the methods of a class, the code of another."""
    old, new = (inspect.unwrap(f) if callable(f) else f for f in (old, new))
    if isinstance(old, type) and isinstance(new, type) and old.__module__ == module:
        for name in set(vars(old)) & set(vars(new)):
            _exchange(vars(old)[name], vars(new)[name], module)
    for part in ("__func__", "fget", "func"):
        if hasattr(old, part) and hasattr(new, part):
            _exchange(getattr(old, part), getattr(new, part), module)
    if isinstance(old, types.FunctionType) and isinstance(new, types.FunctionType) and old.__module__ == module:
        old.__code__, old.__defaults__, old.__kwdefaults__ = new.__code__, new.__defaults__, new.__kwdefaults__


def _passes(call, limit: float) -> bool:
    """Say whether a call returns True within a time limit, in a fork of this process."""
    child = os.fork()
    if child == 0:
        os.setpgid(0, 0)
        try:
            passed = call()
        except BaseException:
            passed = False
        os._exit(0 if passed else 1)
    until = time.monotonic() + limit
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return status == 0
        time.sleep(0.01)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return False


def _pytest(tests: list[str], *plugins) -> bool:
    import pytest

    sys.stdout = sys.stderr = io.StringIO()
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--capture=no"]
    return pytest.main([*options, *tests], plugins=list(plugins)) == 0


def _imported(path: Path, tree: ast.Module, tests: list[str]) -> bool:
    """Run the tests with `tree` for what the file holds when it is imported."""
    original = importlib.machinery.SourceFileLoader.get_code

    def get_code(loader, name):
        return compile(tree, str(path), "exec") if Path(loader.path).resolve() == path else original(loader, name)

    importlib.machinery.SourceFileLoader.get_code = get_code
    return _pytest(tests)


def _owner(tree: ast.Module, line: int) -> str:
    """Return the function or class at the top of a file that holds a line, the empty string where none does."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.lineno <= line <= node.end_lineno:
            return node.name
    return ""


def main() -> None:
    """Run every mutant of a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("tests", nargs="*")
    parser.add_argument("-k", default="", help="choose among the tests, as pytest does")
    parser.add_argument("--sample", type=int, help="draw this many of the mutants")
    parser.add_argument("--seed", type=int, default=55, help="seed of that draw, 55 by default")
    parser.add_argument("--list", action="store_true", help="show the mutants and run nothing")
    arguments = parser.parse_args()
    tests = [*arguments.tests, "-k", arguments.k] if arguments.k else arguments.tests
    path = arguments.file.resolve()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    count = mutant(tree, 0)[1].seen
    numbers = range(1, count + 1)
    if arguments.sample and arguments.sample < count:
        numbers = sorted(random.Random(arguments.seed).sample(numbers, arguments.sample))
    found = [(number, *mutant(tree, number)) for number in numbers]
    mutants = [(number, changed, _owner(tree, mutator.line)) for number, changed, mutator in found]
    lines = {n: f"{n}: line {mutator.line}: {_difference(tree, changed)}" for n, changed, mutator in found}
    if arguments.list:
        return print(*lines.values(), sep="\n")
    survivors = _survivors(path, tree, mutants, tests)
    print(*(lines[number] for number in survivors), sep="\n")
    print(f"{path.name}: {len(found) - len(survivors)} of {len(found)} killed")


def _survivors(path: Path, tree: ast.Module, mutants: list, tests: list[str]) -> list[int]:
    """Return the numbers of the mutants that no test notices."""
    os.environ["OMP_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"
    sys.path[:0] = [os.getcwd()]
    import pytest  # noqa: F401
    import scipy.special  # noqa: F401
    import torch

    torch.set_num_threads(1)
    # Before any test: these processes must not know odak yet.
    alone = [
        number
        for number, changed, name in mutants
        if not name and _passes(lambda changed=changed: _imported(path, changed, tests), 300)
    ]
    read, write = os.pipe()

    def report(number, survived=True):
        if survived:
            os.write(write, f"{number or 0}\n".encode())

    ended = _passes(lambda: _pytest(tests, Session(path, tree, [m for m in mutants if m[2]], report)), 3600)
    os.close(write)
    with os.fdopen(read) as stream:
        numbers = [int(line) for line in stream]
    if 0 in numbers or not ended:
        sys.exit("the tests fail without any mutation")
    return sorted(alone + numbers)


def _difference(before: ast.Module, after: ast.Module) -> str:
    lines = difflib.ndiff(ast.unparse(before).splitlines(), ast.unparse(after).splitlines())
    return " ⟶ ".join(line[2:].strip() for line in lines if line[:2] in ("- ", "+ "))


if __name__ == "__main__":
    main()
