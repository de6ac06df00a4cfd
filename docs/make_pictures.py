"""Run the Python blocks of every page: keep the pictures they write, refresh the output shown beneath them.

    PYTHONPATH=. python docs/make_pictures.py [page.md …]

The ```python blocks of a page run top to bottom in one namespace, in an empty folder. The PNG files found there
afterwards go to docs/pictures/<page>/. A ```text block right after a ```python block is that block's output and is
rewritten with what the block printed. test/docs/test_pages.py checks that both still agree.
"""

import contextlib
import io
import os
import re
import shutil
import sys
import tempfile
import textwrap
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PICTURES = DOCS / "pictures"
LARGE = 120_000  # bytes
_FENCE = re.compile(
    r"^(?P<indent> *)```(?P<language>\w+)[^\n]*\n(?P<body>.*?)^(?P=indent)```$", re.MULTILINE | re.DOTALL
)


@dataclass(frozen=True)
class Block:
    """A fenced ```python block: its code, its line in the page, and the place and text of its output (or None)."""

    code: str
    line: int
    output: tuple[int, int, str, str] | None = None

    @property
    def expected(self) -> str:
        """Output that the page shows, the empty string when it shows none."""
        return textwrap.dedent(self.output[3]) if self.output else ""


def pages() -> list[Path]:
    """Return the pages that hold ```python blocks, sorted."""
    return [path for path in sorted(DOCS.rglob("*.md")) if read_blocks(path)]


def pictures_of(path: Path) -> Path:
    """Return the folder of a page's pictures: named after the page, or after its folder for an index below the top."""
    return PICTURES / (path.parent.name if path.stem == "index" and path.parent != DOCS else path.stem)


def read_blocks(path: Path) -> list[Block]:
    """Return the ```python blocks of a page, each with the ```text block right after it."""
    text = path.read_text(encoding="utf-8")
    fences = list(_FENCE.finditer(text))
    blocks = []
    for fence, after in zip(fences, [*fences, None][1:], strict=True):
        if fence["language"] != "python":
            continue
        output = None
        if after is not None and after["language"] == "text" and not text[fence.end() : after.start()].strip():
            output = (after.start("body"), after.end("body"), after["indent"], after["body"])
        blocks.append(Block(textwrap.dedent(fence["body"]), text.count("\n", 0, fence.start()) + 2, output))
    return blocks


def run_page(path: Path, folder: Path) -> list[tuple[Block, str]]:
    """Run a page's blocks in `folder` and return each with what it printed."""
    namespace: dict = {"__name__": path.stem}
    results = []
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in read_blocks(path):
            printed = io.StringIO()
            # With the newlines in front, a traceback states line numbers of the page.
            code = compile("\n" * (block.line - 1) + block.code, str(path), "exec")
            with contextlib.redirect_stdout(printed):
                exec(code, namespace)
            results.append((block, printed.getvalue()))
    finally:
        os.chdir(before)
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")
    return results


def with_outputs(path: Path, results: list[tuple[Block, str]]) -> str:
    """Return the page's text with each shown output replaced by what its block printed."""
    text = path.read_text(encoding="utf-8")
    for block, printed in reversed(results):
        if block.output:
            start, end, indent, _ = block.output
            text = text[:start] + textwrap.indent(printed, indent) + text[end:]
    return text


def refresh(path: Path) -> list[str]:
    """Run a page, store its pictures and outputs, and return the names of the pictures."""
    target = pictures_of(path)
    with tempfile.TemporaryDirectory() as folder:
        results = run_page(path, Path(folder))
        path.write_text(with_outputs(path, results), encoding="utf-8")
        shutil.rmtree(target, ignore_errors=True)
        found = sorted(Path(folder).glob("*.png"))
        for picture in found:
            target.mkdir(parents=True, exist_ok=True)
            store(picture, target / picture.name)
    return [picture.name for picture in found]


def store(picture: Path, target: Path) -> None:
    """Copy a picture, with 256 colours if it is large and then becomes smaller."""
    from PIL import Image

    shutil.copyfile(picture, target)
    if target.stat().st_size > LARGE:
        with Image.open(picture) as image:
            smaller = image.convert("RGB").quantize(256, kmeans=8, dither=Image.Dither.NONE)
        stream = io.BytesIO()
        smaller.save(stream, "png", optimize=True)
        if stream.tell() < target.stat().st_size:
            target.write_bytes(stream.getvalue())


def main(arguments: list[str]) -> None:
    """Refresh the pages named, or all of them."""
    for path in [Path(name).resolve() for name in arguments] or pages():
        print(path.relative_to(DOCS), *refresh(path))


if __name__ == "__main__":
    main(sys.argv[1:])
