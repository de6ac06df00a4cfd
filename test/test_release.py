"""What is published: links of the README that lead somewhere, addresses, the recipe's dependencies, a tag that fits."""

import hashlib
import importlib.util
import json
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


@pytest.fixture(scope="module")
def dry_run():
    folder = str(ROOT / "packaging")
    sys.path.insert(0, folder)
    try:
        spec = importlib.util.spec_from_file_location("dry_run", ROOT / "packaging" / "dry_run.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(folder)
    return module


def test_what_is_said_of_a_version_agrees(dry_run, release, tmp_path):
    assert dry_run.contradictions(ROOT, release.version()) == []
    found = dry_run.contradictions(ROOT, "9.9.9")
    assert [line.partition(" ")[0] for line in found[:3]] == [
        "CITATION.cff",
        "CHANGELOG.md",
        "packaging/conda/recipe.yaml",
    ]
    sdist = tmp_path / "odak.tar.gz"
    sdist.write_bytes(b"sources")
    recipe = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    assert hashlib.sha256(b"sources").hexdigest() in dry_run.completed(recipe, sdist)


def test_the_newest_version_of_the_site_is_the_one_that_its_address_shows(dry_run, tmp_path):
    for number in ("0.9.0", "0.10.0", "0.3.0"):
        dry_run.add_version(tmp_path, number)
    entries = json.loads((tmp_path / "versions.json").read_text(encoding="utf-8"))
    assert [(entry["version"], entry["aliases"]) for entry in entries] == [
        ("0.10.0", ["latest"]),
        ("0.9.0", []),
        ("0.3.0", []),
    ]
    assert "url=0.10.0/" in (tmp_path / "index.html").read_text(encoding="utf-8")


def test_the_paper_has_what_its_journal_asks_for_and_the_numbers_of_the_site():
    """Sections and length as the Journal of Open Source Software states them; times as *Beside other libraries* has."""
    paper = (ROOT / "paper.md").read_text(encoding="utf-8")
    body = paper.split("---\n", 2)[2]
    assert {"Summary", "Statement of need", "State of the field", "Acknowledgements", "References"} <= set(
        re.findall("^# (.*)$", body, re.MULTILINE)
    )
    assert 750 <= len(body.split()) <= 1750
    table = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
    times = re.findall(r"(\d+)\s+ms", body)
    assert len(times) == 6 and all(f"{time} ms" in table for time in times)
    assert re.search(r"```python\n(.*?)```", body, re.DOTALL)[1] in (ROOT / "README.md").read_text(encoding="utf-8")
