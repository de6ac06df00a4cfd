"""Structure of the package: light imports, dependencies one way, one place for each thing, documented names."""

import ast
import functools
import importlib
import inspect
import operator
import pathlib
import re
import subprocess
import sys

import numpy
import pytest
import structure

import odak
from odak import _lazy
from odak._moved import other_words

ROOT = pathlib.Path(odak.__file__).parent
MODULES = structure.modules()
imports = functools.cache(structure.imports)


# Several tests read the syntax trees of all modules: one process reads them.
pytestmark = pytest.mark.xdist_group("structure")


def tree_of(module):
    return structure.tree(MODULES[module])


PACKAGES = sorted(".".join(path.parent.relative_to(ROOT.parent).parts) for path in ROOT.rglob("__init__.pyi"))

# What each part may import, besides the modules of the package itself (odak._array, odak._validate, …).
PARTS = {
    "odak.log": {"odak.tools"},
    "odak.tools": {"odak.log"},
    "odak.fit": set(),
    "odak.jones": set(),
    "odak.measurement": set(),
    "odak.wave": {"odak.jones", "odak.tools"},
    "odak.raytracing": {"odak.tools"},
    "odak.catalog": {"odak.raytracing", "odak.tools", "odak.visualize"},
    "odak.manager": {"odak.tools"},
    "odak.instruments": {"odak.manager", "odak.tools", "odak.wave"},
    "odak.learn": {
        f"odak.{part}" for part in ["catalog", "instruments", "jones", "log", "raytracing", "tools", "wave"]
    },
    "odak.contrib": {"odak.learn", "odak.raytracing", "odak.tools", "odak.visualize"},
    "odak.visualize": {"odak.catalog", "odak.learn", "odak.log", "odak.raytracing", "odak.tools"},
    "odak.cli": {
        f"odak.{part}"
        for part in ["instruments", "learn", "log", "manager", "raytracing", "tools", "visualize", "wave"]
    },
}
# The same within odak.learn.
LEARN = {
    "odak.learn.jones": set(),
    "odak.learn.tools": set(),
    "odak.learn.models": {"odak.learn.tools"},
    "odak.learn.perception": {"odak.learn.tools"},
    "odak.learn.lensless": {"odak.learn.models", "odak.learn.tools"},
    "odak.learn.wave": {"odak.learn.models", "odak.learn.perception", "odak.learn.tools"},
    "odak.learn.raytracing": {"odak.learn.tools", "odak.learn.wave"},
}
# Modules of one name that are not the two faces of one thing, and the reason why they share it.
SHARED_NAMES = {
    "gaussians": "networks of Gaussians; scenes of Gaussians in wave optics",
    "loss": "losses of images; losses of holograms",
    "models": "networks; models of displays",
    "paths": "paths of files; paths of light",
    "surfaces": "surfaces of rays; surfaces in a system",
    "training": "training of networks; of holograms",
}
# Modules that import each other in a circle; this list only shrinks.
CIRCLES: list[list[str]] = []


def part_of(module, parts):
    return next((part for part in parts if module == part or module.startswith(part + ".")), None)


@pytest.mark.parametrize("parts", [PARTS, LEARN], ids=["odak", "odak.learn"])
def test_dependencies_point_one_way(parts):
    wrong = {
        f"{module} imports {other}"
        for module, imported in imports().items()
        for other in imported
        if (part := part_of(module, parts)) and (target := part_of(other, parts))
        if target not in {part, *parts[part]}
    }
    assert wrong == set()


def test_nothing_newer_imports_the_older_doors():
    """The table of moved names alone knows the modules of `odak.learn.wave.older`, which import what is newer."""
    older = "odak.learn.wave.older"
    assert {
        f"{module} imports {other}"
        for module, imported in imports().items()
        for other in imported
        if part_of(other, [older]) and not part_of(module, [older])
    } == set()
    assert "odak.learn.tools.iterations" in imports()[f"{older}.multiplane"]
    doors = [name for name, home in structure.stubs()["odak.learn.wave"].items() if part_of(home, [older])]
    assert {"propagator", "stochastic_gradient_descent", "get_angular_spectrum_kernel"} < set(doors)
    texts = {name: inspect.getdoc(getattr(odak.learn.wave, name)) for name in doors}
    assert [name for name, text in texts.items() if " : The successor" not in text] == []


def test_modules_do_not_import_each_other_in_a_circle():
    assert structure.cycles(imports()) == []


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}
    assert structure.cycles(graph) == [["b", "c"]]


def test_imports_by_strings_are_seen(tmp_path):
    (tmp_path / "box" / "inner").mkdir(parents=True)
    for name, text in {
        "__init__": "",
        "core": 'load("box.inner.face.thing")',
        "inner/__init__": "",
        "inner/face": "",
    }.items():
        (tmp_path / "box" / f"{name}.py").write_text(text)
    assert structure.imports(tmp_path / "box")["box.core"] == {"box.inner", "box.inner.face"}


def test_the_private_interface_of_torch_is_touched_in_one_module():
    private = re.compile(r"torch(\.\w+)*\._[a-z]\w*|torch\._C\b|\._(version|backward_hooks|current_level)\b")
    found = {name for name, path in MODULES.items() if private.search(path.read_text(encoding="utf-8"))}
    assert {name for name in found if not name.startswith("odak.visualize.blender")} == {"odak._torch_private"}


def test_modules_of_one_name_are_two_faces_or_have_a_reason():
    places = {}
    for name in MODULES:
        if "." in name:
            places.setdefault(name.rpartition(".")[2], set()).add(name.replace("odak.learn.", "odak."))
    assert {name for name, found in places.items() if len(found) > 1} == set(SHARED_NAMES)


def test_the_first_line_of_a_module_is_a_statement():
    asking = {
        name
        for name in MODULES
        if re.match(r"(What|Whether|Which|How|Where)\b", ast.get_docstring(tree_of(name)) or "What")
    }
    assert asking == set()


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_documented(package):
    module = importlib.import_module(package)
    assert module.__doc__
    values = {name: getattr(module, name) for name in dir(module)}
    bare = [name for name, value in values.items() if callable(value) and not inspect.getdoc(value)]
    assert bare == []


def public_definitions(node, prefix=""):
    """Return the public functions, classes, methods and properties below a node of a syntax tree, by dotted name."""
    found = {}
    for item in node.body:
        if isinstance(item, (ast.FunctionDef, ast.ClassDef)) and not item.name.startswith("_"):
            found[prefix + item.name] = item
            if isinstance(item, ast.ClassDef):
                found |= public_definitions(item, f"{prefix}{item.name}.")
    return found


def is_documented(module, name):
    """Say whether a name has a docstring, its own or one of a base class of the package (not of torch or Python)."""
    *owners, last = name.split(".")
    owner = functools.reduce(getattr, owners, importlib.import_module(module))
    if inspect.isclass(owner):
        bases = [base for base in owner.__mro__ if base.__module__.startswith("odak.")]
        return any(vars(base)[last].__doc__ for base in bases if last in vars(base))
    return bool(getattr(owner, last).__doc__)


def test_functions_methods_and_properties_are_documented():
    bare = {
        f"{module}.{name}"
        for module in MODULES
        for name, node in public_definitions(tree_of(module)).items()
        # Overloads and setters have no docstring; the function and the property may.
        if not ast.get_docstring(node) and not is_documented(module, name)
    }
    assert bare == set()


def test_a_docstring_of_python_is_none_of_the_package():
    assert is_documented("odak._warnings", "OdakWarning")
    assert is_documented("odak.learn.raytracing.system.surfaces", "surface.coating")
    assert not is_documented("odak._warnings", "OdakWarning.with_traceback")


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout


@functools.cache
def imported_anew():
    """Return the lines that a new process prints; several tests share it, since the import of torch takes longest."""
    return run(
        "import odak; print(odak.wave.wavenumber(1.0), odak.pi)\n"
        "from odak.learn.wave import training; from odak import _validate; print(training.__name__)\n"
        "print(odak.learn.wave.propagate_beam.__name__)\n"
        "import odak.learn.raytracing.detector; print(type(odak.learn.raytracing.detector).__name__)"
    ).splitlines()


def test_import_pulls_in_no_torch_no_plotly_and_writes_nothing(tmp_path):
    heavy = "{'torch', 'plotly', 'numpy', 'scipy'}"
    code = f"import os, sys; os.chdir({str(tmp_path)!r}); import odak; print(sorted({heavy} & set(sys.modules)))"
    assert run(code).strip() == "[]"
    assert not list(tmp_path.iterdir())


def test_numpy_under_its_older_name():
    assert odak.np is numpy


def test_subpackages_load_on_use_and_homonymous_classes_stay():
    numbers, _, function, kind = imported_anew()
    assert (numbers, function, kind) == ("6.283185307179586 3.141592653589793", "propagate_beam", "type")


def test_unknown_names_are_attribute_errors():
    for owner in (odak, odak.wave, odak.learn, odak.learn.wave):
        with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
            owner.nonsense  # noqa: B018


@pytest.mark.parametrize(
    ("package", "name", "proposed"),
    [
        ("odak", "Display", "from odak.learn.wave import Display"),
        ("odak", "load_image", "from odak.tools import load_image, or from odak.learn.tools import load_image"),
        ("odak.learn.wave", "optimize", "from odak.learn.wave import optimise"),
        ("odak.learn.wave", "optical_system", "from odak.learn.raytracing.system import optical_system"),
        ("odak.learn.raytracing", "Optimise", "from odak.learn.wave import optimise"),
        ("odak.learn.wave", "ASM", "from odak.learn.wave import propagate_beam"),
        ("odak", "SpotDiagram", "from odak.learn.raytracing.system import spot_diagram"),
        ("odak.learn.tools", "imread", "from odak.learn.tools import load_image"),
        ("odak", "set_location", "from odak.contrib.commands import set_location"),
        ("odak.tools", "create_logger", "from odak.log import create_logger"),
    ],
)
def test_the_import_of_a_name_that_a_package_lacks_is_proposed(package, name, proposed):
    module = importlib.import_module(package)
    with pytest.raises(AttributeError, match=f"no attribute '{name}'. Did you mean: {proposed}"):
        getattr(module, name)
    with pytest.raises(ImportError, match=f"cannot import name '{name}' from '{package}'. Did you mean: {proposed}"):
        exec(f"from {package} import {name}")
    assert getattr(module, name, None) is None and not hasattr(module, name)
    # The proposal is one that works, also after Python has remembered the failure.
    exec(proposed.split(", or ")[0])


def test_words_of_other_libraries_stand_for_one_public_name_each():
    homes = _lazy._homes()
    words = [word for listed in other_words().values() for word in listed.split()]
    assert len(words) == len(set(words)) and not set(words) & {name.casefold() for name in homes}
    for key, listed in other_words().items():
        if "." in key:
            assert all(hasattr(importlib.import_module(key), word) for word in listed.split())
        else:
            assert key in homes


def test_an_import_of_what_is_nowhere_and_of_submodules_is_left_to_python():
    with pytest.raises(ImportError, match=r"cannot import name 'nonsense' from 'odak.wave' \("):
        exec("from odak.wave import nonsense")
    assert imported_anew()[1] == "odak.learn.wave.training"


def test_version_is_its_parts():
    assert odak.__version__ == ".".join(map(str, odak.version_info))


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_resolves(package):
    module = importlib.import_module(package)
    public = {name: getattr(module, name) for name in dir(module)}
    assert None not in public.values()
    # A package whose parent lists its names has none of its own. No star import binds a module.
    listed = getattr(module, "__all__", None)
    assert listed is None or set(listed) == {name for name, value in public.items() if not inspect.ismodule(value)}


def test_no_new_public_name_is_also_a_submodule_of_its_package():
    names = {f"{package}.{name}" for package in PACKAGES for name in dir(importlib.import_module(package))}
    both = {name for name in names & set(MODULES) if not inspect.ismodule(operator.attrgetter(name[5:])(odak))}
    assert both == {"odak.cli.app"}


def test_star_imports_leave_names_as_they_are():
    names = {}
    exec("from odak.learn.wave import *\nkept = optimise\nfrom odak.learn.raytracing.system import *", names)
    assert names["optimise"] is names["kept"] and names["optical_system"].__name__ == "optical_system"


def test_a_stub_of_names_holds_imports_alone(tmp_path):
    from odak._lazy import attach

    (tmp_path / "__init__.pyi").write_text("from .a import b as b\nc: int\n")
    with pytest.raises(SyntaxError, match="line 2"):
        attach("odak.nowhere", str(tmp_path / "__init__.py"))


def test_stubs_are_part_of_the_package():
    tomllib = pytest.importorskip("tomllib")

    settings = tomllib.loads((ROOT.parent / "pyproject.toml").read_text())
    patterns = settings["tool"]["setuptools"]["package-data"]["odak"]
    shipped = {path for pattern in patterns for path in ROOT.glob(pattern)}
    assert {path.with_suffix(".pyi") for path in ROOT.rglob("__init__.py")} <= shipped


# Code lines of the package: what is new takes the place of what it is better than.
MOST_LINES = 63_390


def test_the_package_does_not_grow():
    lines = sum(
        structure.code_lines(path.read_text(encoding="utf-8"), structure.tree(path)) for path in MODULES.values()
    )
    assert lines <= MOST_LINES, "delete what a better way has replaced, before the limit is raised"


# Modules whose tests stand in a file of another name; those of internal modules are the tests of what uses them.
TESTED_IN = {
    "odak.cli.eye_settings": "cli/test_eyebox.py",
    "odak.cli.eyebox_views": "cli/test_eyebox.py",
    "odak.cli.job": "cli/test_hologram.py",
    "odak.cli.light_field": "cli/test_eyebox.py",
    "odak.cli.settings": "cli/test_options.py",
    "odak.cli.target": "cli/test_hologram.py",
    "odak.instruments.array_files": "instruments/test_captures.py",
    "odak.instruments.mapping": "instruments/test_registration.py",
    "odak.learn.raytracing.primitives": "learn/raytracing/test_ray.py",
    "odak.learn.raytracing.system.fused": "learn/raytracing/system/test_tracing.py",
    "odak.learn.raytracing.system.sequence": "learn/raytracing/system/test_tracing.py",
    "odak.learn.raytracing.system.sketches": "visualize/test_system_figures.py",
    "odak.learn.raytracing.system.system_files": "learn/raytracing/system/test_zemax.py",
    "odak.learn.wave.displays.judge": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.panels": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.parts": "learn/wave/test_shared_out.py",
    "odak.learn.wave.displays.paths.base": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.paths.choice": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.paths.free": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.paths.retina": "learn/wave/test_eyes.py",
    "odak.learn.wave.displays.paths.two_panels": "learn/wave/test_displays.py",
    "odak.learn.wave.displays.sections": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.eyeboxes": "learn/wave/test_scenery.py",
    "odak.learn.wave.holograms.optimising": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.problem": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.result": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.solvers.descent": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.solvers.double_phase": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.solvers.network": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.solvers.projections": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.starts": "learn/wave/test_displays.py",
    "odak.learn.wave.holograms.targets": "learn/wave/test_displays.py",
    "odak.learn.wave.older.single_plane": "learn/wave/test_holograms.py",
    "odak.learn.wave.older.multi_color": "learn/wave/test_optimizers.py",
    "odak.learn.wave.older.multiplane": "learn/wave/test_optimizers.py",
    "odak.learn.wave.older.terms": "learn/wave/test_optimizers.py",
    "odak.manager.tasks": "manager/test_distribute.py",
    "odak.raytracing.apertures": "learn/raytracing/system/test_surfaces.py",
    "odak.raytracing.arguments": "raytracing/test_ray.py",
    "odak.raytracing.batches": "learn/raytracing/test_large_batches.py",
    "odak.raytracing.components": "raytracing/test_ray.py",
    "odak.raytracing.intersections": "raytracing/test_boundary.py",
    "odak.raytracing.primitives": "raytracing/test_ray.py",
    "odak.raytracing.recompute": "learn/raytracing/test_large_batches.py",
    "odak.tools.paths": "tools/test_file.py",
    "odak.visualize.blender.items": "visualize/blender/test_scenes.py",
    "odak.visualize.blender.shapes": "visualize/blender/test_meshes.py",
    "odak.wave.fourier": "wave/test_sampling.py",
    "odak.wave.linear_kernels": "wave/test_propagation.py",
    "odak.wave.methods": "wave/test_propagation.py",
    "odak.wave.quadrature": "wave/test_propagation.py",
    "odak.wave.viewing": "learn/wave/test_eyebox.py",
}


def test_each_module_has_a_file_of_tests():
    tests = pathlib.Path(__file__).parent
    files = {str(path.relative_to(tests)) for path in tests.rglob("test_*.py")}
    names = [pathlib.Path(file).stem for file in files]
    public = {name for name in MODULES if "._" not in name and not MODULES[name].name.startswith("__")}
    without = {name for name in public if not any(test.startswith(f"test_{name.rpartition('.')[2]}") for test in names)}
    assert without == set(TESTED_IN)
    assert set(TESTED_IN.values()) <= files
