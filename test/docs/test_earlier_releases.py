"""The page of differences from earlier releases agrees with the functions, and with the table of releases."""

import json
from pathlib import Path

import pytest
from earlier_releases import all_differences, differences

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs/coming_from_odak_02.md"
# Signatures of the releases, beside the checkout where it is present.
RELEASES = HERE.parents[2] / "shared/spec/releases.json"
FACTS = json.loads((HERE / "earlier_releases.json").read_text(encoding="utf-8"))


def row(fact):
    name = fact["name"].removeprefix("odak.")
    cells = f"`{name}`", f"`{fact['argument']}`", ", ".join(fact["releases"]), fact["there"], fact["here"], fact["note"]
    code = (text if text.startswith(("argument", "by name", "accepted", "not")) else f"`{text}`" for text in cells[3:5])
    return "| " + " | ".join([*cells[:3], *code, cells[5]]) + " |"


def test_the_page_lists_every_fact():
    rows = PAGE.read_text(encoding="utf-8").split("|---|---|---|---|---|---|\n")[1].rstrip("\n")
    assert rows == "\n".join(row(fact) for fact in FACTS)


@pytest.mark.parametrize("fact", FACTS, ids=lambda fact: f"{fact['name']}:{fact['argument']}:{fact['there']}")
def test_facts_are_those_of_the_functions(fact):
    """A function of this one parameter, at its place and with its default there, differs as the fact says."""
    there, name = fact["there"], fact["argument"]
    if there.startswith("argument "):
        before = [f"other_{place}" for place in range(int(there.removeprefix("argument ")) - 1)]
        signature = f"({', '.join([*before, name])})"
    else:
        signature = f"({name})" if there == "accepted" else f"({name}={there})"
    assert differences(fact["name"], signature)[name] == (there, fact["here"])


@pytest.mark.skipif(not RELEASES.exists(), reason="the table of releases is not beside the checkout")
def test_facts_are_all_differences_from_the_releases():
    found = all_differences(json.loads(RELEASES.read_text(encoding="utf-8")))
    listed = {tuple(fact[key] for key in ("name", "argument", "there", "here")): fact["releases"] for fact in FACTS}
    assert found == listed
