"""Run the Python blocks of every page: keep the pictures they write, refresh the output shown beneath them.

    PYTHONPATH=. python docs/make_pictures.py [page.md …]

The ```python blocks of a page run top to bottom in one namespace, in an empty folder. The PNG files found there
afterwards go to docs/pictures/<page>/. A ```text block right after a ```python block is that block's output and is
rewritten with what the block printed. A ```bash block before a ```text block is run too: its commands are `odak …`, and
a ```toml block that begins with `# name.toml` is a file that they find. test/docs/test_pages.py checks that outputs
still agree.
"""

import contextlib
import io
import os
import re
import shlex
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
_FILE = re.compile(r"# (\w+\.toml)\n")


@dataclass(frozen=True)
class Block:
    """A fenced block: its code, its line in the page, the place and text of its output (or None), and its language."""

    code: str
    line: int
    output: tuple[int, int, str, str] | None = None
    language: str = "python"

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
    """Return the ```python blocks of a page, each with the ```text block right after it, and what else is run."""
    text = path.read_text(encoding="utf-8")
    fences = list(_FENCE.finditer(text))
    blocks = []
    for fence, after in zip(fences, [*fences, None][1:], strict=True):
        output, language, code = None, fence["language"], textwrap.dedent(fence["body"])
        if after is not None and after["language"] == "text" and not text[fence.end() : after.start()].strip():
            output = (after.start("body"), after.end("body"), after["indent"], after["body"])
        if language == "python" or (language == "bash" and output) or (language == "toml" and _FILE.match(code)):
            blocks.append(Block(code, text.count("\n", 0, fence.start()) + 2, output, language))
    return blocks


def commands(code: str) -> list[list[str]]:
    """Return the words of each command of a ```bash block, without comments."""
    lines = code.replace("\\\n", " ").replace("&&", "\n").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def _run(block: Block, path: Path, namespace: dict) -> None:
    """Run the code of a block, its commands, or write the file that it is."""
    if block.language == "python":
        # With the newlines in front, a traceback states line numbers of the page.
        exec(compile("\n" * (block.line - 1) + block.code, str(path), "exec"), namespace)
    elif block.language == "toml":
        Path(_FILE.match(block.code)[1]).write_text(block.code, encoding="utf-8")
    else:
        from odak.cli import main

        for words in commands(block.code):
            if words[0] != "odak" or main(words[1:]) != 0:
                raise RuntimeError(f"{path}:{block.line}: {shlex.join(words)} fails, or is no command of odak")


def run_page(path: Path, folder: Path) -> list[tuple[Block, str]]:
    """Run a page's blocks in `folder` and return each with what it printed."""
    namespace: dict = {"__name__": path.stem}
    results = []
    before = Path.cwd()
    os.chdir(folder)
    try:
        for block in read_blocks(path):
            printed = io.StringIO()
            with contextlib.redirect_stdout(printed):
                _run(block, path, namespace)
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
