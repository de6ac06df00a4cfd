"""Pictures with sliders: each place of the sliders has the picture of its values, and pages hold all they need."""

import base64
import io
import json
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from PIL import Image

from odak.visualize import Exploration, explore


def drawn(frame):
    return np.asarray(Image.open(io.BytesIO(frame)))


def test_frames_are_in_the_order_of_the_products_of_values():
    found = explore(lambda plane, pupil: np.full((4, 6), plane + pupil), plane=[0.0, 0.5], pupil=(0.0, 0.2, 0.4))
    assert [round(float(drawn(frame).mean()) / 255, 2) for frame in found.frames] == [0.0, 0.2, 0.4, 0.5, 0.7, 0.9]
    assert repr(found) == "Exploration(6 pictures: plane of 2, pupil of 3)"
    # The place that the script of the page computes of the sliders.
    page = found._repr_html_()
    pictures = json.loads(re.search(r'application/json">(.*?)</script>', page)[1])
    place = 0
    for most, value in zip(re.findall(r'max="(\d+)"', page), (1, 2), strict=True):
        place = place * (int(most) + 1) + value
    assert base64.b64decode(pictures[place]) == found.frames[5]
    assert "place * (Number(slider.max) + 1) + Number(slider.value)" in page


def test_small_pictures_are_enlarged_in_sharp_samples():
    small, large = (explore(lambda x, n=n: np.full((4, n), x), x=[0.5])._repr_html_() for n in (319, 320))
    assert "width:320px;image-rendering:pixelated;" in small and "width:320px" not in large and "max-width" in large


def test_pictures_of_all_kinds_are_drawn():
    colours = torch.zeros(3, 5, 7, requires_grad=True) + torch.tensor([1.0, 0.5, 0.0])[:, None, None]
    assert drawn(explore(lambda x: colours, x=[1]).frames[0])[2, 3].tolist() == [255, 128, 0]
    assert drawn(explore(lambda x: colours.detach().permute(1, 2, 0), x=[1]).frames[0]).shape == (5, 7, 3)
    assert drawn(explore(lambda x: np.ones((1, 5, 7)), x=[1]).frames[0]).shape == (5, 7)
    # Three columns, or three rows of three colours: the last axis is that of colours where it can be.
    assert drawn(explore(lambda x: np.ones((3, 5, 3)), x=[1]).frames[0]).shape == (3, 5, 3)
    assert drawn(explore(lambda x: np.ones((3, 3, 7)), x=[1]).frames[0]).shape == (3, 7, 3)
    assert drawn(explore(lambda x: Figure(figsize=(2, 1), dpi=50), x=[1]).frames[0]).shape[:2] == (50, 100)


def test_figures_of_pyplot_are_closed():
    before = plt.get_fignums()
    explore(lambda x: plt.subplots()[1], x=[1, 2])
    assert plt.get_fignums() == before


def test_a_page_holds_its_pictures_and_texts_cannot_leave_their_places(tmp_path):
    found = explore(lambda word: np.zeros((2, 2)), word=["</script><b>", '"onload="x'])
    page = found.save(tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<b>" not in page and '"onload' not in page and "http" not in page.replace("http-equiv", "")
    assert page.count("<script") == 2 and page.startswith("<!DOCTYPE html>")


@pytest.mark.parametrize(
    ("draw", "values", "error", "words"),
    [
        (3, {"x": [1]}, TypeError, "draw must be a function"),
        (lambda x: 0, {"x": []}, ValueError, "x must have at least one value"),
        (lambda x, y: 0, {"x": range(20), "y": range(16)}, ValueError, "at most 300 pictures, got 20 of x · 16 of y"),
        (lambda x: "text", {"x": [1]}, TypeError, "draw must return a figure, axes or a picture, got str"),
        (lambda x: np.zeros(4), {"x": [1]}, ValueError, r"draw must return a picture .* got \[4\]"),
        (lambda x: np.zeros((2, 4, 5, 3)), {"x": [1]}, ValueError, r"draw must return a picture .* got \[2, 4, 5, 3\]"),
    ],
)
def test_what_cannot_be_drawn_is_named(draw, values, error, words):
    with pytest.raises(error, match=words):
        explore(draw, **values)


def test_each_place_of_the_sliders_has_a_picture():
    with pytest.raises(TypeError, match="frames must be a list of bytes, got list"):
        Exploration({"x": (1,)}, ["text"])
    with pytest.raises(ValueError, match="frames must be 2 pictures"):
        Exploration({"x": (1, 2)}, [b"one"])
