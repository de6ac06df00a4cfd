import functools
import gc
import logging
import os
import time
from pathlib import Path

import array_api_strict
import hypothesis.internal.conjecture.providers
import numpy as np
import pytest
from turns import Turn

_BEGUN = time.monotonic()
# What is not run with disturbed rounding, and why.
NOT_DISTURBED = {
    "test_forward_derivatives_are_those_of_torch": "torch crashes with a mode around those of derivatives",
    "test_faces_can_be_pickled_compiled_and_transformed": "torch does not compile within a mode",
    "test_an_iteration_makes_few_calls": "the mode makes calls of its own",
}
# What imports and collection make stays to the end: nothing is gained by looking through it for garbage.
gc.disable()

# The same examples in every run, however long they take: what a run finds depends on neither chance nor the machine's
# load. `--hypothesis-profile search` draws others.
for profile, fixed in (("fixed", True), ("search", False)):
    hypothesis.settings.register_profile(
        profile, derandomize=fixed, deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
    )
hypothesis.settings.load_profile("fixed")
# Hypothesis would also draw the numbers and texts in the source of all modules that are loaded by then: seconds of
# parsing in each process, and other examples after each edit and in another order of the tests.
hypothesis.internal.conjecture.providers.is_local_module_file = lambda path: False


def pytest_addoption(parser):
    parser.addoption(
        "--turn",
        type=_turn,
        metavar="K/N",
        help="of the slow tests, take those of turn K of N, and then those of what the last day's commits changed",
    )

    parser.addoption(
        "--disturb",
        type=int,
        metavar="SEED",
        help="compute with other last digits, as other processors do (test/helpers/disturbed.py); with --turn, "
        "those of every N-th file",
    )

    parser.addoption(
        "--budget",
        type=float,
        metavar="SECONDS",
        help="skip slow tests that have not begun by then; those of the turn come first",
    )


def _turn(text):
    turn, _, turns = text.partition("/")
    return int(turn), int(turns)


def pytest_collection_finish():
    gc.freeze()
    gc.enable()


def pytest_configure(config):
    """Let the processes of `-n` take assertions as they are: to rewrite all test files takes each of them ten seconds.

    What an assertion compared is printed without `-n`, or with `--assert=rewrite`. Each of them has one thread: more
    only wait for each other. NumPy reads their number when it is imported, which a plugin may do before this file.
    """
    if config.getoption("numprocesses", None):
        os.environ["OMP_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"
        os.environ["PYTEST_ADDOPTS"] = f"--assert=plain {os.environ.get('PYTEST_ADDOPTS', '')}"
    elif config.option.disturb is not None:
        from disturbed import begin

        mode = begin(config.option.disturb)
        config.add_cleanup(lambda: mode.__exit__(None, None, None))


def pytest_xdist_make_scheduler(config, log):
    """Give the processes of `-n` whole files, or groups, of the default tests.

    Each file's fixtures are made once, and the program that gives out tests one by one looks through all of them each
    time. Of the slow tests, single ones are given out: a file of them can take longer than all others.
    """
    from xdist.scheduler import LoadGroupScheduling

    class ByFiles(LoadGroupScheduling):
        def _split_scope(self, nodeid):
            return super()._split_scope(nodeid).partition("::")[0]

    return ByFiles(config, log) if config.option.markexpr == "not slow" else None


@pytest.fixture(autouse=True)
def _fresh_state():
    """Let no test depend on those before it: kernels, random numbers, warnings and threads are as at the start."""
    import torch

    from odak import _warnings
    from odak.wave.transfer_functions import kernels

    kernels.clear()
    _warnings._issued.clear()
    torch.default_generator.manual_seed(0)  # torch.manual_seed formats the stack each time, for CUDA
    threads = torch.get_num_threads()
    yield
    if torch.get_num_threads() != threads:
        torch.set_num_threads(threads)


class Logged(logging.Handler):
    """Keeps what is logged."""

    def __init__(self):
        super().__init__()
        self.records = []
        self.emit = self.records.append

    @property
    def text(self):
        return "\n".join(record.getMessage() for record in self.records)


@pytest.fixture
def logged():
    """Records of the package, at all levels; the plugin of pytest, which is off, seeks all loggers each time."""
    logger, handler = logging.getLogger("odak"), Logged()
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    yield handler
    logger.setLevel(before)
    logger.removeHandler(handler)


@pytest.fixture
def small_judge(monkeypatch):
    """Judge holograms of small panels on smaller grids, where the accuracy of the judge is not what is tested.

    As wide grids as the judge has are compared with sums in learn/wave/test_observers.py.
    """
    monkeypatch.setattr("odak.learn.wave.displays.judge._LEAST", 128)
    monkeypatch.setattr("odak.learn.wave.displays.judge._AIRY", 16)


@pytest.fixture
def random():
    return np.random.default_rng(20261121)


@pytest.fixture(params=["numpy", "torch", "array_api_strict"])
def as_array(request):
    """Return a converter from NumPy arrays to the arrays of one library."""
    if request.param == "torch":
        import torch

        return torch.from_numpy
    return {"numpy": np.asarray, "array_api_strict": array_api_strict.asarray}[request.param]


def pytest_collection_modifyitems(config, items):
    import torch

    if config.option.turn:
        turn = Turn(*config.option.turn, Path(__file__).parents[1])
        places = {item: turn.place(item.nodeid, item.path) if item.get_closest_marker("slow") else 0 for item in items}
        # What may take longer than a whole turn is left to runs of all tests.
        places |= {item: None for item in items if (own := item.get_closest_marker("timeout")) and own.args[0] > 1200}
        if config.option.disturb is not None:
            places = {item: place if turn.takes_file(item.path) else None for item, place in places.items()}
        config.hook.pytest_deselected(items=[item for item in items if places[item] is None])
        # Those of the turn come first, so that all are run in as many turns however short the time is.
        items[:] = sorted((item for item in items if places[item] is not None), key=places.get)

    for item in items:
        if config.option.disturb is not None and item.originalname in NOT_DISTURBED:
            item.add_marker(pytest.mark.skip(reason=NOT_DISTURBED[item.originalname]))
        if "cuda" in item.keywords and not torch.cuda.is_available():
            item.add_marker(pytest.mark.skip(reason="no CUDA device on this machine"))
        if "browser" in item.keywords and (lacking := _what_figures_lack()):
            item.add_marker(pytest.mark.skip(reason=lacking))
        # Not item.keywords: they hold the names of folders too.
        if item.get_closest_marker("blender") and not _has_blender():
            item.add_marker(pytest.mark.skip(reason="no Blender: name a Python with bpy by ODAK_BLENDER_PYTHON"))


def pytest_runtest_setup(item):
    budget = item.config.option.budget
    if budget and item.get_closest_marker("slow") and time.monotonic() - _BEGUN > budget:
        pytest.skip(f"left for another turn: {budget:.0f} s are over")


@functools.cache
def _what_figures_lack():
    """Return why no image of a figure can be drawn here: a package or the browser; None where it can."""
    try:
        from odak.visualize.plotly import BrowserNotFoundError, find_browser
    except ImportError as error:
        return str(error)
    try:
        return None if find_browser() else "no Chrome or Chromium on this machine"
    except (BrowserNotFoundError, ImportError) as error:
        return str(error)


@functools.cache
def _has_blender():
    from odak.visualize.blender import BlenderNotFoundError, find_blender

    try:
        return find_blender() is not None
    except BlenderNotFoundError:
        return False
