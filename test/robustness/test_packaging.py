"""What is published: requirements are explained, files are packaged, versions agree."""

import ast
import re
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest
import structure

import odak

tomllib = pytest.importorskip("tomllib", reason="part of Python from 3.11 on")
ROOT = Path(__file__).resolve().parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]
PINNED = ("requirements.txt", "requirements-tests.txt", "docs/requirements.txt")


def name_of(requirement):
    return re.match(r"[A-Za-z][\w.-]*", requirement)[0]


def pinned_names(*files):
    lines = [line for file in files or PINNED for line in (ROOT / file).read_text(encoding="utf-8").splitlines()]
    return {name_of(line) for line in lines if re.match(r"[A-Za-z]", line)}


def declared_names():
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    return {name_of(requirement) for group in groups for requirement in group} - {PROJECT["name"]}


def explained_names():
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    cells = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_every_requirement_is_explained_and_none_besides():
    assert explained_names() == pinned_names() | declared_names()


def test_what_the_package_needs_is_pinned():
    needed = {name_of(requirement) for requirement in PROJECT["dependencies"]}
    assert pinned_names("requirements.txt") == needed
    tests = {name_of(requirement) for requirement in PROJECT["optional-dependencies"]["test"]}
    assert pinned_names("requirements-tests.txt") == tests


def test_every_pin_names_one_version():
    lines = [line for file in PINNED for line in (ROOT / file).read_text(encoding="utf-8").splitlines()]
    for line in lines:
        if re.match(r"[A-Za-z]", line):
            assert re.fullmatch(r"[\w.-]+(\[\w+\])?==[\w.]+(; .+)?", line), line


def test_what_builds_the_site_brings_odak():
    """The site imports the package: one command in an empty environment installs both."""
    lines = (ROOT / "docs" / "requirements.txt").read_text(encoding="utf-8").splitlines()
    assert "-r ../requirements.txt" in lines


def test_the_installation_page_lists_every_extra():
    page = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8").partition("## Extras")[2]
    assert sorted(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == sorted(PROJECT["optional-dependencies"])


@pytest.mark.xdist_group("structure")
def test_imports_are_declared():
    """What the package imports is declared in pyproject.toml, or part of Python."""
    modules = {"pillow": "PIL", "array-api-compat": "array_api_compat", "scikit-image": "skimage"}
    modules |= {"opencv-python-headless": "cv2", "pygame-ce": "pygame", "cadquery-ocp": "OCP"}
    # By dask[distributed], kaleido and torch.
    brought_along = {"distributed", "cloudpickle", "psutil", "choreographer", "typing_extensions"}
    declared = {modules.get(name, name) for name in declared_names()} | {"odak"} | brought_along
    found = set()
    for path in (ROOT / "odak").rglob("*.py"):
        for node in ast.walk(structure.tree(path)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                names = [node.module]
            found |= {(name.split(".")[0], path.relative_to(ROOT).as_posix()) for name in names}
    undeclared = {(name, path) for name, path in found if name not in declared | set(sys.stdlib_module_names)}
    # Blender's own Python has these; they are imported inside Blender alone.
    assert {(name, path) for name, path in undeclared if not path.startswith("odak/visualize/blender/")} == set()


def test_data_files_are_packaged():
    patterns = PYPROJECT["tool"]["setuptools"]["package-data"]["odak"]
    package = ROOT / "odak"
    files = (path for path in package.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc"))
    names = [path.relative_to(package).as_posix() for path in files]
    assert len(names) > 10
    assert [name for name in names if not any(fnmatch(name, pattern) for pattern in patterns)] == []


def test_versions_and_licences_agree():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(rf"^version: \"?{re.escape(odak.__version__)}\"?$", citation, re.MULTILINE)
    assert PROJECT["license"] == "MPL-2.0"
    assert re.search(r"^license: \"?MPL-2.0\"?$", citation, re.MULTILINE)
    assert (ROOT / "LICENSE.txt").read_text(encoding="utf-8").startswith("Mozilla Public License Version 2.0")


def test_an_editable_installation_is_a_path_that_checkers_follow():
    """An import hook, which setuptools writes for other layouts, hides the package from editors and type checkers."""
    editable = pytest.importorskip("setuptools.command.editable_wheel")
    distribution = pytest.importorskip("setuptools").Distribution({"src_root": str(ROOT)})
    distribution.packages = ["odak", "odak.wave", "odak.learn", "odak.learn.wave"]
    command = editable.editable_wheel(distribution)
    command.project_dir, command.mode = str(ROOT), None
    for layout, strategy in ((PYPROJECT["tool"]["setuptools"]["package-dir"], "_StaticPth"), ({}, "_TopLevelFinder")):
        command.package_dir = distribution.package_dir = layout
        assert type(command._select_strategy("odak", "tag", ROOT / "build")).__name__ == strategy
