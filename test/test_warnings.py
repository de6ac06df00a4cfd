"""Warnings belong to the caller's line; earlier module paths give the modules that hold their names now."""

import importlib
import sys
import warnings

import pytest

import odak
from odak import _moved, _warnings


def test_a_warning_names_the_first_line_outside_the_package():
    code = "from odak._warnings import SamplingWarning, warn\ndef inner():\n    warn('too coarse', SamplingWarning)\n"
    namespace = {"__name__": "odak.wave.made_up"}
    exec(compile(code, _warnings.__file__.replace("_warnings", "made_up"), "exec"), namespace)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        namespace["inner"]()
    assert [(w.category, w.filename) for w in caught] == [(odak.SamplingWarning, __file__)]


def test_categories_are_warnings_of_the_package():
    for name in (name for name in odak.__all__ if name.endswith("Warning")):
        assert issubclass(getattr(odak, name), odak.OdakWarning)


@pytest.fixture
def moved(monkeypatch):
    monkeypatch.setitem(_moved.MOVED_MODULES, "odak.wave.former", ("odak.wave.sampling",))
    monkeypatch.setitem(_moved.MOVED_MODULES, "odak.wave.split", ("odak.wave.sampling", "odak.tools"))
    yield
    for name in ("odak.wave.former", "odak.wave.split"):
        sys.modules.pop(name, None)
        vars(odak.wave).pop(name.rpartition(".")[2], None)


def test_a_moved_module_is_the_module_it_moved_to(moved):
    assert importlib.import_module("odak.wave.former") is importlib.import_module("odak.wave.sampling")
    assert odak.wave.sampling.__spec__.name == "odak.wave.sampling"


def test_a_split_module_gives_names_of_all_its_parts(moved):
    split = importlib.import_module("odak.wave.split")
    assert split.sampling_report is odak.wave.sampling_report and split.zero_pad is odak.tools.zero_pad
    with pytest.raises(AttributeError, match=r"odak\.wave\.split.*nothing"):
        _ = split.nothing


@pytest.mark.parametrize("old", sorted(f"{p}.{n}" for p, names in _moved.MOVED_NAMES.items() for n in names))
def test_a_name_found_elsewhere_by_accident_says_where_it_lives(old):
    package, _, name = old.rpartition(".")
    home, _, renamed = _moved.MOVED_NAMES[package][name].partition(":")
    with pytest.warns(
        DeprecationWarning, match=rf"{package}\.{name} is deprecated: import it as {home}\.{renamed or name}"
    ):
        found = getattr(importlib.import_module(package), name)
    assert found is getattr(importlib.import_module(home), renamed or name)
    assert name not in dir(importlib.import_module(package))


@pytest.mark.parametrize("old", sorted(_moved.MOVED_MODULES))
def test_earlier_module_paths_give_names_that_live_elsewhere_now(old):
    module = importlib.import_module(old)
    for target in _moved.MOVED_MODULES[old]:
        home = importlib.import_module(target)
        assert all(getattr(module, name) is not None for name in getattr(home, "__all__", ()))
