"""What is published: links of the README that lead somewhere, addresses, the recipe's dependencies, a tag that fits."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://example.org/owner/odak"


@pytest.fixture(scope="module")
def release():
    spec = importlib.util.spec_from_file_location("release", ROOT / "packaging" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_readme_on_a_package_index_has_no_dead_link(release):
    readme = release.absolute((ROOT / "README.md").read_text(encoding="utf-8"), REPOSITORY, "v1")
    links = re.findall(r"\]\(([^)\s]+)\)", readme)
    assert all(link.startswith("https://") for link in links)
    ours = [link.removeprefix(REPOSITORY) for link in links if link.startswith(REPOSITORY)]
    assert len(ours) > 10
    for kind, tag, path in (link[1:].split("/", 2) for link in ours):
        assert tag == "v1" and (ROOT / path).is_file()
        assert kind == ("raw" if path.endswith((".webp", ".svg", ".png")) else "blob")


def test_metadata_get_the_addresses(release):
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f'[project.urls]\nSource = "{REPOSITORY}"\n' in release.with_addresses(text, REPOSITORY)


def test_a_tag_of_another_version_is_refused():
    command = [sys.executable, ROOT / "packaging" / "release.py", REPOSITORY, "--tag", "v0.0.1"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2 and "'v0.0.1' is not that of odak/_version.py" in run.stderr


def test_conda_recipe_asks_for_the_same_packages(release):
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^dependencies = \[(.*?)^\]", text, re.MULTILINE | re.DOTALL)[1]
    names = {"torch": "pytorch", "matplotlib": "matplotlib-base"}
    wanted = {(names.get(name, name), least) for name, least in re.findall(r'"([\w-]+)>=([\w.]+)', listed)}
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    assert set(re.findall(r"- ([\w-]+) >=([\w.]+)", run)) == wanted
    assert f'version: "{release.version()}"' in recipe
