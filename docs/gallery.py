"""Makes the gallery: a page for each script in docs/gallery, with its figures, its output and its downloads.

    PYTHONPATH=. python docs/gallery.py [docs/gallery/group/script.py …]

runs the scripts, each in an empty folder, and stores their figures, a thumbnail and what they print. A build of the site
makes the pages from these. A script begins with a docstring: its title, an empty line, a description. A line
`# Picture: …` describes each of its figures, in order: the open figures of matplotlib, or the PNG files that it writes.
A line `# %%` begins a step, and the comment right below it is its text. A line

    # Change: `old` to `new`: What happens.

names a change to try. The script runs with it too, and its page shows the first figure and the output of that run.
"""

import ast
import contextlib
import html
import io
import json
import os
import re
import sys
import tempfile
from functools import cache
from pathlib import Path

DOCS = Path(__file__).resolve().parent
SCRIPTS = DOCS / "gallery"
PICTURES = DOCS / "pictures" / "gallery"
GROUPS = {
    "propagation": "Propagation",
    "holograms": "Holograms",
    "displays": "Displays",
    "lenses": "Lenses and rays",
    "polarisation": "Polarisation",
    "perception": "Perception",
    "learning": "Learning",
    "blender": "Renders",
}
_PICTURE = re.compile(r"^# Picture: (?P<text>.+)$", re.MULTILINE)
_CHANGE = re.compile(r"^# Change: `(?P<old>[^`]+)` to `(?P<new>[^`]+)`: (?P<text>.+)$", re.MULTILINE)
_STEP = re.compile(r"^# %%.*\n((?:#.*\n)*)", re.MULTILINE)
_NOTES = re.compile(r"^# (?:Picture|Thumbnail|Change):.*\n", re.MULTILINE)
_THUMBNAIL = re.compile(r"^# Thumbnail: ([\d.]+)(?: ([\d.]+))?(?: ([\d.]+) ([\d.]+))?$", re.MULTILINE)
_LIVE = re.compile(r"^```(?P<kind>frames|plotly) (?P<name>\w+)\n(?P<text>.*)\n```$", re.MULTILINE)
_BLOCK = re.compile(r"^```gallery(?: (?P<group>\w+))?\n```$", re.MULTILINE)


def scripts() -> list[Path]:
    """Return the scripts of the gallery, by group and name."""
    return [path for group in GROUPS for path in sorted((SCRIPTS / group).glob("*.py"))]


@cache
def described(path: Path) -> tuple[str, str, str]:
    """Return the title, the description and the code of a script."""
    source = path.read_text(encoding="utf-8")
    docstring = ast.get_docstring(ast.parse(source)) or ""
    title, _, text = docstring.partition("\n\n")
    return title.strip().rstrip("."), text.strip(), source.split('"""', 2)[2].lstrip()


def texts(path: Path) -> list[str]:
    """Return the descriptions of a script's figures."""
    return _PICTURE.findall(path.read_text(encoding="utf-8"))


def steps(path: Path) -> list[tuple[str, str]]:
    """Return the steps of a script, each as its text in Markdown and its code."""
    parts = _STEP.split(_NOTES.sub("", described(path)[2]))
    texts = ["", *(re.sub(r"^# ?", "", text, flags=re.MULTILINE).strip() for text in parts[1::2])]
    return [(text, code.strip()) for text, code in zip(texts, parts[::2], strict=True) if text or code.strip()]


@cache
def change(path: Path) -> tuple[str, str, str, str] | None:
    """Return what a script proposes to change: what stands there, what to put there, what happens, and that source."""
    source = path.read_text(encoding="utf-8")
    found = _CHANGE.search(source)
    if found is None:
        return None
    code = source.replace(found[0] + "\n", "")
    if code.count(found["old"]) != 1:
        raise ValueError(
            f"{path}: {found['old']!r} must occur once in the code; it occurs {code.count(found['old'])} times."
        )
    return found["old"], found["new"], found["text"], code.replace(found["old"], found["new"])


@cache
def uses(path: Path) -> tuple[str, ...]:
    """Return the public paths that a script imports from odak, or reaches as attributes of what it imports."""
    tree, found, modules = ast.parse(path.read_text(encoding="utf-8")), set(), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("odak"):
            found |= {f"{node.module}.{name.name}" for name in node.names}
            modules |= {name.asname or name.name: f"{node.module}.{name.name}" for name in node.names}
        elif isinstance(node, ast.Import):
            modules |= {
                name.asname or "odak": name.asname and name.name or "odak"
                for name in node.names
                if name.name.startswith("odak")
            }
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            parts = [node.attr]
            inner = node.value
            while isinstance(inner, ast.Attribute):
                parts.append(inner.attr)
                inner = inner.value
            if isinstance(inner, ast.Name) and inner.id in modules:
                found.add(".".join([modules[inner.id], *reversed(parts)]))
    return tuple(sorted(found))


def run(path: Path, folder: Path, source: str | None = None) -> tuple[str, list]:
    """Run a script, or another source in its place, in a folder; return what it prints and its figures as images."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from PIL import Image

    printed, before = io.StringIO(), Path.cwd()
    os.chdir(folder)
    try:
        with plt.style.context(["default", str(SCRIPTS / "odak.mplstyle")]), contextlib.redirect_stdout(printed):
            code = path.read_text(encoding="utf-8") if source is None else source
            exec(compile(code, str(path), "exec"), {"__name__": "__main__"})
            images = []
            for number in plt.get_fignums():
                stream = io.BytesIO()
                plt.figure(number).savefig(stream, format="png", bbox_inches="tight", pad_inches=0.1)
                images.append(Image.open(stream).convert("RGB"))
            images += [Image.open(name).convert("RGB") for name in sorted(folder.glob("*.png"))]
    finally:
        plt.close("all")
        os.chdir(before)
    return printed.getvalue(), images


def stored(path: Path) -> Path:
    """Return the folder and stem of what is stored for a script."""
    return PICTURES / path.parent.name / path.stem


def refresh(path: Path) -> int:
    """Run a script, as it is and changed; store figures, thumbnail and output, and return the number of figures."""
    with tempfile.TemporaryDirectory() as folder:
        printed, images = run(path, Path(folder))
    place = stored(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    for old in place.parent.glob(f"{path.stem}[._][0-9t]*"):
        if re.fullmatch(rf"{path.stem}(_\d+\.webp|\.txt)", old.name):
            old.unlink()
    for old in place.parent.glob(f"{path.stem}-changed.*"):
        old.unlink()
    for number, image in enumerate(images, 1):
        image.save(f"{place}_{number}.webp", quality=84, method=6)
    thumbnail(path)
    if printed:
        Path(f"{place}.txt").write_text(printed, encoding="utf-8")
    if tried := change(path):
        with tempfile.TemporaryDirectory() as folder:
            printed, others = run(path, Path(folder), tried[3])
        others[0].save(f"{place}-changed.webp", quality=84, method=6)
        Path(f"{place}-changed.txt").write_text(printed, encoding="utf-8")
    return len(images)


def thumbnail(path: Path) -> None:
    """Store a part of the first figure, 4:3: an image in it without its axes, or all of a figure that holds curves alone.

    The line `# Thumbnail: 0.2` asks for the image next to a fifth of the width instead of the largest one. A second
    number, `# Thumbnail: 0.2 0.33`, asks for a part of the whole height about that place, as wide as it says. Four
    numbers are the left, upper, right and lower side of the part, as shares of the figure.
    """
    from PIL import Image, ImageOps

    figure = Image.open(f"{stored(path)}_1.webp").convert("RGB")
    share = _THUMBNAIL.search(path.read_text(encoding="utf-8"))
    boxes = [] if share and share[2] else _images_in(figure)
    chosen = bool(share and share[4])
    if chosen:
        box = [round(float(side) * size) for side, size in zip(share.groups(), 2 * figure.size)]
    elif boxes and share:
        box = min(boxes, key=lambda box: abs((box[0] + box[2]) / 2 - float(share[1]) * figure.width))
    elif boxes:
        box = max(boxes, key=lambda box: (box[2] - box[0]) * (box[3] - box[1]))
    else:
        middle, width = (float(part) for part in (share.groups()[:2] if share and share[2] else (0.5, 1)))
        box = tuple(round(side * figure.width) for side in (middle - width / 2, 0, middle + width / 2, 0))
        box = (max(box[0], 0), 0, min(box[2], figure.width), figure.height)
    boxes = boxes or chosen
    fitted = ImageOps.fit if boxes else ImageOps.pad
    canvas = fitted(figure.crop(box), (480, 360), Image.LANCZOS, **({} if boxes else {"color": "white"}))
    canvas.save(f"{stored(path)}.webp", quality=80, method=6)


def _images_in(figure):
    """Return the boxes of the areas of a figure that are filled: images, but neither curves nor colour bars."""
    import numpy as np
    from scipy import ndimage

    filled = ndimage.binary_fill_holes(np.asarray(figure.convert("L")) < 250)
    filled = ndimage.binary_opening(filled, np.ones((15, 15)))
    boxes = []
    for rows, columns in ndimage.find_objects(ndimage.label(filled)[0]):
        height, width = rows.stop - rows.start, columns.stop - columns.start
        if min(height, width) > 60 and 0.25 < width / height < 6 and filled[rows, columns].mean() > 0.85:
            boxes.append((columns.start + 2, rows.start + 2, columns.stop - 2, rows.stop - 2))
    return boxes


def _page(path):
    """Return the Markdown of a script's page."""
    if str(DOCS) not in sys.path:
        sys.path.append(str(DOCS))
    from reference import entries

    title, text, _ = described(path)
    up = "../../pictures/gallery/" + path.parent.name
    lines = [f"# {title}", "", text, ""]
    for number, alt in enumerate(texts(path), 1):
        lines += [f"![{alt}]({up}/{path.stem}_{number}.webp)", ""]
    for words, code in steps(path):
        lines += [words, "", *(["```python", code, "```", ""] if code else [])]
    lines += _output(Path(f"{stored(path)}.txt"))
    if tried := change(path):
        old, new, words, _ = tried
        lines += ["## Change this", "", f"`{old}` to `{new}`: {words}", ""]
        lines += [
            f"![The first figure with {new.replace('[', '(').replace(']', ')')}]({up}/{path.stem}-changed.webp)",
            "",
        ]
        lines += _output(Path(f"{stored(path)}-changed.txt"))
    lines += [
        f'<p>Download: <a href="../{path.stem}.py" download>{path.stem}.py</a>, '
        f'<a href="../{path.stem}.ipynb" download>{path.stem}.ipynb</a></p>',
        "",
    ]
    listed = [name for name in uses(path) if name in entries()]
    if listed:
        lines.append("Used here: " + ", ".join(f"[`{name}`][{name}]" for name in listed) + ".")
    return "\n".join(lines) + "\n"


def _output(file):
    """Return the lines that show what a script printed, none where it printed nothing."""
    printed = file.read_text(encoding="utf-8").rstrip() if file.exists() else ""
    return ["Output:", "", "```text", printed, "```", ""] if printed else []


def notebook(path: Path):
    """Return a script as a notebook: its description, then the text and the code of each step, then what to change."""
    import nbformat

    title, text, _ = described(path)
    cells = [nbformat.v4.new_markdown_cell(f"# {title}\n\n{text}")]
    for words, code in steps(path):
        cells += [nbformat.v4.new_markdown_cell(words)] if words else []
        cells += [nbformat.v4.new_code_cell(code)] if code else []
    if tried := change(path):
        cells.append(nbformat.v4.new_markdown_cell(f"Change this: `{tried[0]}` to `{tried[1]}`: {tried[2]}"))
    for number, cell in enumerate(cells):
        cell.id = f"cell-{number}"
    return nbformat.v4.new_notebook(
        cells=cells, metadata={"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    )


def thumbnails(group: str, up: str = "") -> str:
    """Return the thumbnails of a group as HTML; `up` is the path from the page to the gallery's folder."""
    items = []
    for path in scripts():
        if path.parent.name == group:
            title = described(path)[0]
            picture = f"{up}../pictures/gallery/{group}/{path.stem}.webp"
            items.append(
                f'<a href="{up}{group}/{path.stem}/"><img src="{picture}" alt="{texts(path)[0]}" loading="lazy" width="480" height="360"><span>{title}</span></a>'
            )
    return '<div class="gallery">\n' + "\n".join(items) + "\n</div>"


def on_config(config):
    """List the pages of the scripts by group in the menu, behind the gallery's own page."""
    (section,) = (entry["Gallery"] for entry in config.nav if "Gallery" in entry)
    for place, (group, title) in enumerate(GROUPS.items(), 1 + section.index("gallery/index.md")):
        section.insert(
            place, {title: [f"gallery/{group}/{path.stem}.md" for path in scripts() if path.parent.name == group]}
        )
    return config


def on_files(files, config):
    """Add the pages of the scripts to the site."""
    from mkdocs.structure.files import File

    for path in scripts():
        files.append(File.generated(config, f"gallery/{path.parent.name}/{path.stem}.md", content=_page(path)))
    import plotly

    script = Path(plotly.__file__).parent / "package_data" / "plotly.min.js"
    files.append(File.generated(config, "assets/plotly.min.js", abs_src_path=str(script)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Insert the thumbnails requested by a page."""

    def expanded(match):
        if match["group"]:
            return thumbnails(match["group"])
        return "\n\n".join(f"## {title}\n\n{thumbnails(group)}" for group, title in GROUPS.items())

    if page.file.src_path == "gallery/index.md":
        return _BLOCK.sub(expanded, markdown)
    up = "../" * page.url.count("/")
    return _LIVE.sub(lambda match: _slider(match, up) if match["kind"] == "frames" else _figure(match, up), markdown)


def _slider(match, up):
    """Return a figure with a slider for the frames that docs/make_frames.py computed."""
    folder = DOCS / "pictures" / "interactive"
    figure = json.loads((folder / "labels.json").read_text(encoding="utf-8"))[match["name"]]
    middle = len(figure["labels"]) // 2
    labels = html.escape(json.dumps(figure["labels"], ensure_ascii=False), quote=True)
    picture = f"{up}pictures/interactive/{match['name']}.webp"
    return (
        f'<div class="frames" data-labels="{labels}"><div class="frame" role="img" aria-label="{match["text"]}" '
        f'style="aspect-ratio: {figure["width"]} / {figure["height"]}; background-image: url({picture})"></div>'
        f'<input type="range" min="0" max="{len(figure["labels"]) - 1}" value="{middle}" aria-label="{match["text"]}">'
        f"<output>{figure['labels'][middle]}</output></div>"
    )


def _figure(match, up):
    """Return the place of a figure of plotly, which docs/assets/frames.js draws."""
    source = f"{up}pictures/interactive/{match['name']}.json"
    return f'<div class="plotly-figure" data-figure="{source}" role="img" aria-label="{match["text"]}"></div>'


def on_post_build(config):
    """Write the notebooks beside the scripts."""
    import nbformat

    for path in scripts():
        nbformat.write(notebook(path), Path(config["site_dir"]) / "gallery" / path.parent.name / f"{path.stem}.ipynb")


def main(arguments: list[str]) -> None:
    """Run the scripts named, or all of them."""
    import time

    for path in [Path(name).resolve() for name in arguments] or scripts():
        start = time.perf_counter()
        print(path.relative_to(SCRIPTS), refresh(path), f"{time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
