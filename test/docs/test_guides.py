"""Guides begin with a picture, say beneath each what it shows, and print numbers rather than verdicts on them."""

import re
import unicodedata

import pytest
from documentation import script

make_pictures = script("make_pictures")
GUIDES = sorted((make_pictures.DOCS / "guides").glob("*.md"))
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]*)\)")
FIRST, WORDS = 10, 6  # last line of the first picture, fewest words of its caption


@pytest.mark.parametrize("path", GUIDES, ids=lambda path: path.stem)
def test_a_guide_begins_with_a_picture_and_leads_to_its_code(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    first = next(number for number, line in enumerate(lines, 1) if PICTURE.search(line))
    caption, target = PICTURE.search(lines[first - 1]).groups()
    assert first <= FIRST and len(caption.split()) >= WORDS
    # Shown again where its code stands.
    assert sum(target in line for line in lines) == 2
    link = re.fullmatch(r"\[The code of this picture\]\(#(.*)\) is below\.", lines[first + 1])
    titles = [line.lstrip("# ").lower() for line in lines if line.startswith("##")]
    # The site makes anchors of letters without their accents.
    titles = [unicodedata.normalize("NFKD", title).encode("ascii", "ignore").decode() for title in titles]
    assert link and link[1] in [re.sub(r"[^\w\s-]", "", title).replace(" ", "-") for title in titles]


@pytest.mark.parametrize("path", GUIDES, ids=lambda path: path.stem)
def test_a_guide_prints_numbers_instead_of_true_and_false(path):
    lines = [line for block in make_pictures.read_blocks(path) for line in block.expected.splitlines()]
    verdicts = [line for line in lines if re.search(r"\b(True|False)$", line.rstrip(" .,;)"))]
    assert not verdicts


def test_the_page_of_faults_folds_the_table_that_it_simulates_away():
    text = (make_pictures.DOCS / "guides" / "your_table_in_an_afternoon.md").read_text(encoding="utf-8")
    before = text[: text.index("## Too bright")]
    assert "??? note" in before and not re.search("^```python", before, re.MULTILINE)
