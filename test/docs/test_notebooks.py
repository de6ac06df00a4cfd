"""Every notebook of the course runs, in time, and prints what it shows; its pictures have words."""

import pytest

pytest.importorskip("nbformat", reason="what builds the site is not installed: pip install -r docs/requirements.txt")

import nbformat
from documentation import agrees, script

run_notebooks = script("run_notebooks")
NOTEBOOKS = [pytest.param(path, id=path.stem) for path in run_notebooks.notebooks()]
CHAPTERS = range(9)


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_all_chapters_are_there():
    assert {path.stem[:2] for path in run_notebooks.notebooks()} == {f"{number:02d}" for number in CHAPTERS}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("path", NOTEBOOKS)
def test_notebook_prints_what_it_shows(path, tmp_path):
    pytest.importorskip("nbclient")
    stored = nbformat.read(path, as_version=4)
    fresh = run_notebooks.executed(path, tmp_path)
    for shown, ran in zip(code_cells(stored), code_cells(fresh), strict=True):
        assert agrees(run_notebooks.printed(shown), run_notebooks.printed(ran)), shown.source
        assert len(run_notebooks.pictures(shown)) == len(run_notebooks.pictures(ran)), shown.source


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_pictures_have_words(path):
    for cell in code_cells(nbformat.read(path, as_version=4)):
        for picture in run_notebooks.pictures(cell):
            texts = [entry.get("alt", "") for entry in picture.metadata.values()]
            assert texts and all(texts), f"no '# Picture: …' line in\n{cell.source}"


@pytest.mark.parametrize("path", NOTEBOOKS)
def test_chapter_has_goals_exercises_and_challenges(path):
    text = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "markdown")
    assert text.count("<summary>Solution") >= 3
    for heading in ("## Goals", "## Exercises", "## Challenges", "## Sources"):
        assert heading in text
