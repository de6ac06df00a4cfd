"""Scripts of the page on other tools, which need packages that the tests' set lacks: each runs where they are there."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

import odak

PAGE = Path(__file__).parents[2] / "docs" / "guides" / "ecosystem.md"
SCRIPTS = dict(re.findall(r"^```py\n# (\w+)\.py\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL))
RUNS = {
    "labelled": ("xarray", [], "Frozen({'z': 2, 'wavelength': 3, 'y': 128, 'x': 128})"),
    "logged": ("tensorboard", [], ""),
    "train": ("lightning", [], "loss 0."),
    "hologram": ("hydra", ["picture=PHOTO", "iterations=2", "distance=4e-3"], "plane at 4 mm"),
}


def test_every_script_is_run():
    assert set(SCRIPTS) == set(RUNS)


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_script(name, tmp_path):
    package, arguments, printed = RUNS[name]
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    (tmp_path / f"{name}.py").write_text(SCRIPTS[name], encoding="utf-8")
    photo = Path(odak.__file__).parent / "assets" / "photo.png"
    arguments = [one.replace("PHOTO", str(photo)) for one in arguments]
    run = subprocess.run(
        [sys.executable, f"{name}.py", *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=280, check=False
    )
    assert run.returncode == 0, run.stderr[-2000:]
    assert printed in run.stdout
