"""`odak examples` lists the scripts of the gallery and copies them."""

from importlib import metadata
from pathlib import Path, PurePosixPath

import pytest

from odak.cli import examples, main

ROOT = Path(__file__).resolve().parents[2]


def test_every_script_of_the_gallery_is_listed_with_its_title(capsys):
    assert main(["examples"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [f"{path.parent.name}/{path.stem}" for path in sorted((ROOT / "docs" / "gallery").glob("*/*.py"))]
    assert [line.split()[0] for line in lines] == names and len(names) > 50
    assert "lenses/glass_map" in names and all(len(line.split(maxsplit=1)[1]) > 5 for line in lines)


def test_scripts_and_groups_are_copied_and_not_replaced(tmp_path, capsys):
    assert main(["examples", "talbot_carpet", "polarisation/malus", "--output", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["malus.py", "talbot_carpet.py"]
    original = ROOT / "docs" / "gallery" / "polarisation" / "malus.py"
    (tmp_path / "malus.py").write_text("mine", encoding="utf-8")
    capsys.readouterr()
    assert main(["examples", "polarisation", "--output", str(tmp_path)]) == 2
    assert "malus.py exists already; --again" in capsys.readouterr().err
    assert (tmp_path / "malus.py").read_text(encoding="utf-8") == "mine" and len(list(tmp_path.iterdir())) == 2
    assert main(["examples", "polarisation", "--output", str(tmp_path), "--again"]) == 0
    assert (tmp_path / "malus.py").read_bytes() == original.read_bytes()
    assert len(list(tmp_path.iterdir())) == 1 + len(list(original.parent.glob("*.py")))


def test_an_unknown_name_is_answered_with_the_nearest(tmp_path, capsys):
    assert main(["examples", "talbot_carpets", "--output", str(tmp_path / "new")]) == 2
    assert "no example is named 'talbot_carpets'" in (said := capsys.readouterr().err) and "'talbot_carpet'?" in said
    assert not (tmp_path / "new").exists()


def test_an_installation_knows_its_scripts_by_its_metadata(monkeypatch, tmp_path):
    listed = ["share/odak/gallery/lenses/glass_map.py", "odak/__init__.py", "share/odak/gallery/lenses/readme.md"]
    files = [metadata.PackagePath("../../.." if name.startswith("share") else ".", name) for name in listed]

    class Distribution:
        pass

    for file in files:
        file.dist = Distribution()
        file.dist.locate_file = lambda path: tmp_path / "lib" / "python3" / "site-packages" / path
    Distribution.files = files
    monkeypatch.setattr(examples, "distribution", lambda name: Distribution())
    (found,) = examples._installed()
    assert found.parts[-5:] == PurePosixPath(listed[0]).parts


def test_every_group_is_packaged():
    tomllib = pytest.importorskip("tomllib", reason="part of Python from 3.11 on")
    packaged = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["data-files"]
    groups = {path.parent.name for path in (ROOT / "docs" / "gallery").glob("*/*.py")}
    assert packaged == {f"share/odak/gallery/{group}": [f"docs/gallery/{group}/*.py"] for group in groups}
