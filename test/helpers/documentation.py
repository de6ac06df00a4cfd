"""What the tests of the site share: where it is, its scripts, and when two printed texts agree."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 0.02
_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def script(name, folder="docs"):
    """Return a script of docs/, or of another folder, as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def agrees(shown, printed):
    """Say whether two texts are equal but for numbers within 2 %, spaces aside."""
    words_shown, words_printed = (_NUMBER.sub("#", text).split() for text in (shown, printed))
    numbers_shown, numbers_printed = (_NUMBER.findall(text) for text in (shown, printed))
    return words_shown == words_printed and all(
        float(a) == pytest.approx(float(b), rel=TOLERANCE, abs=1e-12)
        for a, b in zip(numbers_shown, numbers_printed, strict=True)
    )
