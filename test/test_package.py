"""The house: imports stay light and dependencies point one way."""

import ast
import pathlib
import subprocess
import sys

import numpy
import pytest

import odak

ROOT = pathlib.Path(odak.__file__).parent
MODULES = sorted(path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
ROOMS = {
    "_array": set(),
    "_validate": {"_array"},
    "_lazy": set(),
    "log": {"_validate", "tools"},
    "tools": {"log", "_array", "_validate", "_lazy"},
    "wave": {"tools", "_array", "_validate", "_lazy"},
    "fit": {"_array", "_validate", "_lazy"},
    "jones": {"_array", "_validate", "_lazy"},
    "raytracing": {"tools", "_array", "_validate", "_lazy"},
    "measurement": {"tools", "_array", "_validate", "_lazy"},
    "catalog": {"raytracing", "tools", "visualize", "_array", "_validate", "_lazy"},
}
PACKAGES = [
    "odak.catalog",
    "odak.fit",
    "odak.jones",
    "odak.learn",
    "odak.learn.jones",
    "odak.learn.lensless",
    "odak.learn.models",
    "odak.learn.perception",
    "odak.learn.raytracing",
    "odak.learn.raytracing.system",
    "odak.learn.tools",
    "odak.learn.wave",
    "odak.manager",
    "odak.measurement",
    "odak.raytracing",
    "odak.tools",
    "odak.visualize",
    "odak.visualize.blender",
    "odak.visualize.plotly",
    "odak.wave",
]


def imported_rooms(path):
    tree = ast.parse((ROOT / path).read_text())
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            parts = name.split(".")
            if parts[0] == "odak" and len(parts) > 1:
                yield parts[1]


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_dependencies_point_one_way(path):
    room = path.parts[0].removesuffix(".py")
    if room in ROOMS:
        assert set(imported_rooms(path)) <= {room, *ROOMS[room]}
    elif room == "learn":
        assert not {"cli", "manager", "visualize"} & set(imported_rooms(path))
    elif room in ("visualize", "manager"):
        assert "cli" not in set(imported_rooms(path))


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


def test_import_pulls_in_neither_torch_nor_plotly_nor_writes_a_file(tmp_path):
    heavy = "{'torch', 'plotly', 'numpy', 'scipy'}"
    code = f"import os, sys; os.chdir({str(tmp_path)!r}); import odak; print(sorted({heavy} & set(sys.modules)))"
    assert run(code).strip() == "[]"
    assert not list(tmp_path.iterdir())


def test_numpy_under_its_older_name():
    assert odak.np is numpy


def test_subpackages_load_on_use():
    loaded = run("import odak; print(odak.wave.wavenumber(1.0), odak.learn.wave.propagate_beam.__name__, odak.pi)")
    assert loaded.split() == ["6.283185307179586", "propagate_beam", "3.141592653589793"]


def test_unknown_names_are_attribute_errors():
    for owner in (odak, odak.wave, odak.learn, odak.learn.wave):
        with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
            owner.nonsense  # noqa: B018


def test_version_is_its_parts():
    assert odak.__version__ == ".".join(map(str, odak.version_info))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_resolves(package):
    import importlib

    module = importlib.import_module(package)
    for name in module.__all__:
        assert getattr(module, name) is not None
    assert set(module.__all__) == set(dir(module))
