"""Pages, the gallery, the course and the scripts of the site compute holograms in one way: by Display and optimise.

The doors of Odak 0.2 stand on "Coming from Odak 0.2" and in the reference alone.
"""

import ast
import json
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
OLDER = {
    "stochastic_gradient_descent",
    "gerchberg_saxton",
    "gerchberg_saxton_3d",
    "multiplane_hologram_optimizer",
    "multi_color_hologram_optimizer",
    "mixed_color_hologram_optimizer",
    "eyebox_hologram",
    "propagator",
    "holographic_display",
}
# What states the older doors, and pages on what they alone do.
ALLOWED = {
    "coming_from_odak_02.md": "the table of successors",
    "changelog.md": "what earlier releases changed",
    "guides/real_displays.md": "panels that settle while they are lit",
}
PAGES = [
    path
    for path in sorted([*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb"), *DOCS.rglob("*.py"), DOCS.parent / "README.md"])
    if "reference" not in path.relative_to(DOCS.parent).parts and str(path.relative_to(DOCS.parent))[5:] not in ALLOWED
]


def parts(path):
    """Return the code and the prose of a page, a notebook or a script."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text, ast.get_docstring(ast.parse(text)) or ""
    if path.suffix == ".ipynb":
        cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]
        return tuple("\n".join(one for kind, one in cells if (kind == "code") is code) for code in (True, False))
    blocks = re.compile(r"^ *```python\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
    return "\n".join(blocks.findall(text)), blocks.sub("", text)


def older_in(path):
    """Return the older doors that a page calls, or names as code."""
    code, prose = parts(path)
    called = set(re.findall(r"\w+", code))
    # In prose they are code or links: "propagator" is a word, too.
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`[^`]+`|\[[^]]+\]", prose))))
    return OLDER & (called | named)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(DOCS.parent)))
def test_no_page_calls_an_older_door(path):
    assert not older_in(path)


def test_the_pages_that_may_do_so_do(tmp_path):
    assert all(older_in(DOCS / name) for name in ("coming_from_odak_02.md", "guides/real_displays.md"))
    (tmp_path / "page.md").write_text(
        "```python\nfrom odak.learn.wave import propagator\n```\nA propagator, `optimise`."
    )
    assert older_in(tmp_path / "page.md") == {"propagator"}
    (tmp_path / "page.md").write_text("A propagator, and `weighted_gerchberg_saxton`.")
    assert not older_in(tmp_path / "page.md")
