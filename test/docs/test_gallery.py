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


@pytest.mark.filterwarnings("ignore:__array:DeprecationWarning")
@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("path", [_case(path) for path in gallery.scripts() if gallery.change(path)])
def test_example_runs_with_what_it_proposes_to_change(path, tmp_path):
    pytest.importorskip("matplotlib")
    printed, images = gallery.run(path, tmp_path, gallery.change(path)[3])
    shown = gallery.stored(path).with_name(f"{path.stem}-changed.txt").read_text(encoding="utf-8")
    assert images and agrees(shown, printed, by_digits=True)


@pytest.mark.parametrize(
    "path", [path for path in gallery.scripts() if gallery.change(path)], ids=lambda path: path.stem
)
def test_what_an_example_proposes_to_change_makes_a_difference(path):
    image = pytest.importorskip("PIL.Image")
    old, new, words, _ = gallery.change(path)
    assert old != new and words[0].isupper() and words.endswith(".")
    place = gallery.stored(path)
    first, changed = (image.open(f"{place}{end}.webp").convert("RGB") for end in ("_1", "-changed"))
    assert first.size != changed.size or first.tobytes() != changed.tobytes()


def test_steps_have_texts_and_keep_the_code():
    path = gallery.SCRIPTS / "lenses" / "cooke_triplet.py"
    code = "\n".join(code for _, code in gallery.steps(path))
    left = [line for line in code.splitlines() if line.strip()]
    assert left == [
        line for line in gallery.described(path)[2].splitlines() if line.strip() and not line.startswith("# ")
    ]
    assert any(words for words, _ in gallery.steps(path))


def test_a_change_that_fits_no_place_or_two_is_refused(tmp_path):
    path = tmp_path / "example.py"
    path.write_text('"""A\n\nB"""\n\nx = 1\ny = 1\n# Change: `1` to `2`: More.\n', encoding="utf-8")
    with pytest.raises(ValueError, match="it occurs 2 times"):
        gallery.change(path)


@pytest.mark.parametrize("path", gallery.scripts(), ids=lambda path: path.stem)
def test_example_has_a_title_figures_and_public_names_only(path):
    title, text, code = gallery.described(path)
    assert title and text and code
    place = gallery.stored(path)
    figures = {f"{path.stem}_{number}.webp" for number in range(1, len(gallery.texts(path)) + 1)}
    assert figures and {f.name for f in place.parent.glob(f"{path.stem}_*.webp")} == figures
    changed = {f.name for f in place.parent.glob(f"{path.stem}-changed.*")}
    assert changed == ({f"{path.stem}-changed.webp", f"{path.stem}-changed.txt"} if gallery.change(path) else set())
    assert place.with_suffix(".webp").exists()
    assert max(len(line) for line in code.splitlines() if not line.startswith("# ")) <= 88
    for name in gallery.uses(path):
        assert not any(part.startswith("_") for part in name.split(".")), name
        pkgutil.resolve_name(name)


def test_notebooks_hold_the_code(tmp_path):
    pytest.importorskip("nbformat")
    path = gallery.scripts()[0]
    cells = gallery.notebook(path).cells
    assert cells[0].cell_type == "markdown" and os.linesep.join(cell.source for cell in cells[1:]).count("import") > 1
