"""The drawings of the course agree with their script, have words, and no two labels overlap."""

import itertools
import json
import re
import xml.etree.ElementTree as ElementTree

import pytest
from documentation import ROOT, script

make_drawings = script("make_drawings")
COURSE = ROOT / "docs" / "course"
DRAWINGS = [pytest.param(draw, id=draw.__name__) for draw in make_drawings.DRAWINGS]


def overlapping(labels):
    return [
        (a.text, b.text)
        for a, b in itertools.combinations(labels, 2)
        if a.left < b.right and b.left < a.right and a.top < b.bottom and b.top < a.bottom
    ]


@pytest.mark.parametrize("draw", DRAWINGS)
def test_drawing_is_that_of_the_script(draw):
    pytest.importorskip("torch")
    stored = (make_drawings.FOLDER / f"{draw.__name__}.svg").read_text(encoding="utf-8")
    drawing = draw()
    assert stored == drawing.svg(), "run docs/make_drawings.py"
    assert ElementTree.fromstring(stored).find("{*}title").text == drawing.title
    assert not overlapping(drawing.labels)
    for label in drawing.labels:
        assert label.left >= 0 and label.right <= drawing.width, label
        assert label.top >= 0 and label.bottom <= drawing.height, label


def test_overlaps_are_found():
    drawing = make_drawings.Drawing("Two labels", 100)
    drawing.text(50, 50, "one")
    drawing.text(60, 55, "two")
    assert overlapping(drawing.labels) == [("one", "two")]


def test_all_drawings_are_shown_with_words():
    shown = {}
    for path in sorted([*COURSE.glob("*.ipynb"), *COURSE.glob("*.md")]):
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".ipynb":
            text = "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])
        for words, name in re.findall(r"!\[([^\]]*)\]\(drawings/([a-z0-9_]+)\.svg\)", text):
            shown.setdefault(name, []).append(words)
    assert set(shown) == {draw.__name__ for draw in make_drawings.DRAWINGS}
    assert all(len(words) > 20 for texts in shown.values() for words in texts)
