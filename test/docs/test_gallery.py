"""Every example of the gallery runs, draws what its page shows and prints it; its figures have descriptions."""

import os
import pkgutil

import pytest
from documentation import agrees, script

gallery = script("gallery")
GROUPS = ("blender", "displays", "holograms", "learning", "lenses", "perception", "polarisation", "propagation")


def _case(path):
    name = f"{path.parent.name}/{path.stem}"
    return pytest.param(path, id=name, marks=[pytest.mark.blender] if path.parent.name == "blender" else [])


EXAMPLES = [_case(path) for path in gallery.scripts()]


def test_there_are_examples_in_every_group():
    assert len(EXAMPLES) >= 36
    assert {path.parent.name for path in gallery.scripts()} == set(GROUPS) == set(gallery.GROUPS)


# Matplotlib requests copies of tensors with an argument that torch does not accept yet.
@pytest.mark.filterwarnings("ignore:__array:DeprecationWarning")
@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("path", EXAMPLES)
def test_example_runs(path, tmp_path):
    pytest.importorskip("matplotlib")
    printed, images = gallery.run(path, tmp_path)
    place = gallery.stored(path)
    assert len(images) == len(gallery.texts(path))
    shown = place.with_suffix(".txt")
    assert agrees(shown.read_text(encoding="utf-8") if shown.exists() else "", printed, by_digits=True)


@pytest.mark.parametrize("path", gallery.scripts(), ids=lambda path: path.stem)
def test_example_has_a_title_figures_and_public_names_only(path):
    title, text, code = gallery.described(path)
    assert title and text and code
    place = gallery.stored(path)
    figures = {f"{path.stem}_{number}.webp" for number in range(1, len(gallery.texts(path)) + 1)}
    assert figures and {f.name for f in place.parent.glob(f"{path.stem}_*.webp")} == figures
    assert place.with_suffix(".webp").exists()
    assert max(len(line) for line in code.splitlines() if not line.startswith("# Picture")) <= 88
    for name in gallery.uses(path):
        assert not any(part.startswith("_") for part in name.split(".")), name
        pkgutil.resolve_name(name)


def test_notebooks_hold_the_code(tmp_path):
    pytest.importorskip("nbformat")
    path = gallery.scripts()[0]
    cells = gallery.notebook(path).cells
    assert cells[0].cell_type == "markdown" and os.linesep.join(cell.source for cell in cells[1:]).count("import") > 1
