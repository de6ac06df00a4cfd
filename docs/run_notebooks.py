"""Run the course's notebooks and keep what they print and draw.

    PYTHONPATH=. python docs/run_notebooks.py [docs/course/notebook.ipynb …]

Each notebook runs top to bottom in a kernel of its own, in an empty folder. A line `# Picture: …` in a cell is the
alternative text of the picture that the cell draws. test/docs/test_notebooks.py checks that the outputs still agree.
"""

import os
import re
import sys
import tempfile
from pathlib import Path

import nbformat
from nbformat import NotebookNode

COURSE = Path(__file__).resolve().parent / "course"
SECONDS = 60
_PICTURE = re.compile(r"^# Picture: (?P<text>.+)$", re.MULTILINE)
_IMAGE_TYPES = ("image/png", "image/jpeg")


def notebooks() -> list[Path]:
    """Return the notebooks of the course, sorted."""
    return sorted(COURSE.glob("*.ipynb"))


def executed(path: Path, folder: Path) -> NotebookNode:
    """Return a notebook with the outputs of a run in `folder`; a cell that fails raises an error."""
    from nbclient import NotebookClient  # takes long, and most tests of notebooks only read them

    notebook = nbformat.read(path, as_version=4)
    os.environ.setdefault("PYDEVD_DISABLE_FILE_VALIDATION", "1")
    client = NotebookClient(
        notebook, timeout=10 * SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    client.execute()
    return notebook


def tidy(notebook: NotebookNode) -> NotebookNode:
    """Return a notebook without what differs from run to run, its pictures with their texts."""
    language = {"name": "python", "file_extension": ".py", "mimetype": "text/x-python"}
    notebook.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": language,
    }
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number:03d}"
        cell.metadata = {key: value for key, value in cell.metadata.items() if key == "tags"}
        if cell.cell_type == "code":
            _tidy_outputs(cell)
    return notebook


def printed(cell: NotebookNode) -> str:
    """Return what a code cell wrote to the standard output."""
    return "".join(output.text for output in cell.outputs if output.output_type == "stream" and output.name == "stdout")


def pictures(cell: NotebookNode) -> list[NotebookNode]:
    """Return the outputs of a code cell that are pictures."""
    return [output for output in cell.outputs if any(kind in output.get("data", {}) for kind in _IMAGE_TYPES)]


def _tidy_outputs(cell):
    described = _PICTURE.findall(cell.source)
    for output, text in zip(pictures(cell), described, strict=False):
        output.metadata = {kind: {"alt": text} for kind in _IMAGE_TYPES if kind in output.data}
    for output in cell.outputs:
        if "text/plain" in output.get("data", {}) and output in pictures(cell):
            # The address of the object in memory is in it.
            output.data.pop("text/plain")


def main(arguments: list[str]) -> None:
    """Refresh the notebooks named, or all of them."""
    for path in [Path(name).resolve() for name in arguments] or notebooks():
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(tidy(executed(path, Path(folder))), path)
        print(path.name)


if __name__ == "__main__":
    main(sys.argv[1:])
