"""The code of the page on extensions keeps the rules that it states: lint and checks of arguments."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
from api_sweep import contract, hostile

ROOT = Path(__file__).resolve().parents[2]
CODE = "\n".join(
    re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / "extending.md").read_text(encoding="utf-8"), re.M | re.S)
)


def test_lint():
    # Blocks follow one another in a page: imports are not at its top, and results are printed.
    options = ["--config", str(ROOT / "pyproject.toml"), "--extend-ignore", "E402,T201,D100,I001,F811", "--no-cache"]
    found = subprocess.run(
        [sys.executable, "-m", "ruff", "check", *options, "--stdin-filename", "extending.py", "-"],
        input=CODE, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert found.returncode == 0, found.stdout


@pytest.fixture(scope="module")
def defined():
    """Return the classes of the page, defined without running the rest of it."""
    kinds = (ast.Import, ast.ImportFrom, ast.ClassDef)
    module = ast.Module([part for part in ast.parse(CODE).body if isinstance(part, kinds)], [])
    namespace = {"__name__": __name__}
    exec(compile(module, "extending.md", "exec"), namespace)
    return namespace


@pytest.mark.parametrize(
    ("name", "valid", "positive"),
    [("RelativeError", {"floor": 0.05}, {"floor"}), ("Momentum", {"step": 3e3, "memory": 0.9}, {"step"})],
)
def test_arguments_are_checked(defined, name, valid, positive):
    for argument, value in valid.items():
        strict = {"positive": argument in positive, "side": False, "free_text": False}
        wrong = list(hostile.wrong_values(value, **strict))
        assert wrong
        for what, given, verdict in wrong:
            complaint = contract.judge(defined[name], valid | {argument: given}, argument, verdict)
            assert complaint is None, f"{argument} = {what}: {complaint}"
