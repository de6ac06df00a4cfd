"""Fixtures of the tests of commands."""

import pytest

from odak.cli import eyebox_views, light_field, report


@pytest.fixture
def sheets():
    """Let sheets be drawn."""


@pytest.fixture(autouse=True)
def no_sheets(request, monkeypatch):
    """Write the first picture of a sheet, which takes as long as the patterns here, unless a test looks at it."""
    if "sheets" not in request.fixturenames:
        for module in (report, eyebox_views, light_field):
            monkeypatch.setattr(module, "sheet", lambda rows, *_: rows[0][0].image.convert("RGB"))
