"""What the tests of the site share: where it is, its scripts, and when two printed texts agree."""

import importlib.util
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 0.02
# By digits: no more of them are compared than rounding leaves, and counts are equal.
ROUNDED, COUNTED = 1e-6, 1e-3
# A number after ≈ depends on the processor: what was trained by 20 %, and what is rounding by a factor of 30.
ROUGH, ROUNDING = 0.2, 30
_NUMBER = re.compile(r"(≈ *)?([-+]?\d+\.?\d*(?:e[-+]?\d+)?)")


def script(name, folder="docs"):
    """Return a script of docs/, or of another folder, as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def agrees(shown, printed, by_digits=False):
    """Say whether two texts are equal but for numbers within 2 %, or about that after ≈, spaces aside.

    By digits, a number may differ by one in the last digit that is shown. A whole number below a thousand must be the
    same then; above, it may have been rounded.
    """
    words_shown, words_printed = (_NUMBER.sub(r"\1#", text).split() for text in (shown, printed))
    numbers_shown, numbers_printed = (_NUMBER.findall(text) for text in (shown, printed))
    return words_shown == words_printed and all(
        _near(a, b, bool(rough), by_digits) for (rough, a), (_, b) in zip(numbers_shown, numbers_printed, strict=True)
    )


def _near(shown, printed, rough, by_digits):
    first, second = float(shown), float(printed)
    if rough and "e-" in shown + printed:
        return max(abs(first), abs(second)) <= ROUNDING * max(min(abs(first), abs(second)), 1e-17)
    if rough or not by_digits:
        return first == pytest.approx(second, rel=ROUGH if rough else TOLERANCE, abs=1e-12)
    digits, _, exponent = shown.partition("e")
    whole = "." not in digits and not exponent
    unit = 0.0 if whole else 1.001 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    return abs(first - second) <= max(unit, (COUNTED if whole else ROUNDED) * abs(first))
