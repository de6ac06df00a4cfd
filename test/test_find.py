"""Search of public names, and the words that it and the search of the site share."""

import re

import pytest
from documentation import ROOT, script
from searched import found_by_title

import odak
from odak import _find


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("zmx", "odak.learn.raytracing.system.read_zmx"),
        ("load zmx", "odak.learn.raytracing.system.read_zmx"),
        ("tolerancing", "odak.learn.raytracing.system.tolerance"),
        ("visualize field", "odak.visualize.plotly.field_show"),
        ("visualise fields", "odak.visualize.plotly.field_show"),
        ("Laguerre Gauss", "odak.wave.laguerre_gaussian_beam"),
        ("colour difference", "odak.learn.perception.color_difference"),
        ("color differences", "odak.learn.perception.color_difference"),
        ("grey", "odak.learn.perception.rgb_to_gray"),
        ("optimize a hologram", "odak.learn.wave.optimise"),
        ("Optimisation of holograms", "odak.learn.wave.optimise"),
        ("LPIPS", "odak.learn.perception.LPIPS"),
        ("asm", "odak.wave.propagate_beam"),
    ],
)
def test_words_find_the_name_that_is_meant(words, name):
    found = odak.find(words)
    assert name in (found[0].name, *found[0].also)


def test_findings_show_themselves():
    found = odak.find("zmx")
    assert repr(found).splitlines()[:3] == [found[0].name, f"    {found[0].line}", f"    {found[0].page}"]
    assert found[0].line in found._repr_html_() and len(odak.find("field")) == 12
    assert repr(odak.find("zebra crossing")).startswith("Nothing found") and odak.find("") == ()
    with pytest.raises(TypeError, match="words must be a text"):
        odak.find(3)


def test_names_that_meet_all_words_leave_out_those_that_meet_fewer():
    for found in odak.find("polarised ray"):
        assert "olari" in found.name + found.line and "ay" in found.name + found.line


@pytest.mark.parametrize(
    ("one", "other"),
    [("centre", "center"), ("Centred", "centered"), ("metres", "meters"), ("colourful", "colorful"),
     ("focussing", "focusing"), ("visualise", "visualize"), ("analysing", "analyzing"), ("modelled", "modeled")],
)  # fmt: skip
def test_spellings(one, other):
    assert _find.spellings(one) == _find.spellings(other) == (other, one.lower())
    assert _find.stem(one) == _find.stem(other)


def test_words_without_a_second_spelling():
    assert [_find.spellings(word) for word in ("parameter", "focus", "model", "analysis")] == [
        ("parameter",), ("focus",), ("model",), ("analysis",)]  # fmt: skip


def test_a_word_stands_in_one_line_of_synonyms():
    stems = [stem for line in _find.SYNONYMS for stem in {_find.stem(word) for word in line.split()}]
    assert len(stems) == len(set(stems))


def test_sections_of_the_site_are_given_other_words():
    docs = [
        {
            "location": "a",
            "title": "Colour of tolerances",
            "text": "<p>Tolerancing its <b>polarisation</b>.</p>",
        },
        {"location": "b/#odak.read_zmx", "title": "<code>odak.read_zmx</code> read_zmx", "text": ""},
        {"location": "c", "title": "Nothing", "text": "besides"},
    ]
    first, second, third = script("search_words").with_more_words(docs)
    assert {"color", "tolerancing"} <= set(first["tags"][0].split()) and "colour" not in first["tags"][0].split()
    assert first["text"].endswith("<p>polarization</p>") and third["text"] == "besides" and "tags" not in third
    assert {"load", "zemax", "opticstudio"} <= set(second["tags"][0].split())
    assert second["boost"] > 1 and "boost" not in first | third
    separator = re.search(r"separator: '(.*)'", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))[1]
    index = {"config": {"separator": separator}, "docs": docs}
    assert found_by_title(index, "load zmx") == ["b/#odak.read_zmx"]
    assert found_by_title(index, "color tolerancing") == ["a"]
