import pytest

import odak.tools

LATEX = r"""\documentclass{article}
% a comment
   We measure light.

\begin{equation}
E = mc^2
% aside
\end{equation}
	tabs stay
See \label{eq}.
\begin{align} a \end{align}
and text again.
"""

MARKDOWN = """# Title
   Some text.
```python
x = 1

   y = 2
```
Text after the fence with `code`.
```inline``` fences close at once.
Plain.
<!-- hidden -->
"""


@pytest.fixture
def written(tmp_path):
    def write(name, content):
        (tmp_path / name).write_text(content, encoding="utf-8")
        return str(tmp_path / name)

    return write


def test_latex_lines(written):
    text = odak.tools.latex(written("a.tex", LATEX))
    assert " ".join(text.content_type) == ("latex comment text empty latex latex comment latex text latex latex text")
    assert text.get_line_count() == text.line_count == 12
    assert text.get_line(2) == ("We measure light.", "text")
    assert text.get_line(8) == ("\ttabs stay", "text")
    text.set_latex_dictonaries(["We"], ["tabs"], ["again"])
    assert " ".join(text.content_type) == "text comment latex empty latex latex comment latex latex text text latex"
    with pytest.raises(IndexError):
        text.get_line(12)


def test_markdown_lines(written):
    text = odak.tools.markdown(written("a.md", MARKDOWN))
    labels = "markdown text markdown markdown empty markdown markdown text text text comment"
    assert " ".join(text.content_type) == labels
    assert text.get_line(5) == ("y = 2", "markdown")
    assert text.get_line_count() == 11
    text.set_dictonaries([":::"], [":::"], ["Plain"])
    assert text.content_type.count("markdown") == 1


def test_the_module_and_its_class_are_both_reached_by_one_name(written):
    import odak.tools.latex
    from odak.tools.latex import latex

    assert latex is odak.tools.latex
    name = written("a.tex", "x\n")
    assert isinstance(odak.tools.latex(name), odak.tools.latex.latex)
    with pytest.raises(FileNotFoundError):
        odak.tools.markdown.markdown(name + "x")


def test_a_line_beyond_the_end_is_named(tmp_path):
    (tmp_path / "text.md").write_text("one\ntwo\n", encoding="utf-8")
    document = odak.tools.markdown(tmp_path / "text.md")
    assert document.get_line(-1)[0] == "two"
    with pytest.raises(IndexError, match="line_id must be 0 to 1, got 2"):
        document.get_line(2)
