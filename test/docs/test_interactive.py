"""The figures that can be explored: their files are there, small, whole and shown."""

import json
import re

import pytest
from documentation import ROOT
from PIL import Image

FOLDER = ROOT / "docs" / "pictures" / "interactive"
FENCE = re.compile(r"^```(frames|plotly) (\w+)\n.{20,}\n```$", re.MULTILINE)
LABELS = json.loads((FOLDER / "labels.json").read_text(encoding="utf-8"))


def test_every_figure_is_shown_and_small():
    shown = set()
    for page in (ROOT / "docs").rglob("*.md"):
        shown |= set(FENCE.findall(page.read_text(encoding="utf-8")))
    stored = {("frames", path.stem) for path in FOLDER.glob("*.webp")}
    stored |= {("plotly", path.stem) for path in FOLDER.glob("*.json") if path.stem != "labels"}
    assert shown == stored
    assert {name for kind, name in shown if kind == "frames"} == set(LABELS)
    assert max(path.stat().st_size for path in FOLDER.iterdir()) <= 300_000


@pytest.mark.parametrize("name", sorted(LABELS))
def test_a_slider_has_a_frame_for_each_label(name):
    figure = LABELS[name]
    with Image.open(FOLDER / f"{name}.webp") as picture:
        assert picture.size == (figure["width"], figure["height"] * len(figure["labels"]))
        frames = [
            picture.crop((0, k * figure["height"], figure["width"], (k + 1) * figure["height"])).tobytes()
            for k in range(len(figure["labels"]))
        ]
    assert len(set(frames)) == len(set(figure["labels"])) == len(frames)
