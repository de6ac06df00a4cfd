"""Hooks of MkDocs: conversion of equations to MathML, download links of notebooks, texts of pictures as captions.

MathML is drawn by the browser itself, so pages need no script and nothing from the network. Wide figures are marked, so
that a phone scrolls them instead of making their text too small to read.
"""

import base64
import io
import logging
import posixpath
import re
from pathlib import Path
from urllib.parse import urldefrag, urlparse

import latex2mathml.converter
import nbformat
from bs4 import BeautifulSoup, NavigableString
from PIL import Image

_log = logging.getLogger("mkdocs.plugins.notebooks")
_MATHS = re.compile(r"\$\$(?P<display>.+?)\$\$|(?<!\\)\$(?P<inline>[^$\s](?:[^$]*[^$\s\\])?)\$", re.DOTALL)
_DELIMITED = re.compile(r"^\\(?P<kind>[(\[])(?P<tex>.*)\\[)\]]$", re.DOTALL)
_RUN = (
    '<p class="notebook-run"><a href="{name}" download="{name}">Download this notebook</a> and open it where odak is '
    "installed: <code>pip install jupyterlab matplotlib scikit-learn &amp;&amp; jupyter lab {name}</code></p>"
)


def on_page_content(html, page, config, files):
    """Return a page's HTML with its equations drawn; a notebook's with its download and picture texts too."""
    is_notebook = page.file.src_path.endswith(".ipynb")
    if not is_notebook and "arithmatex" not in html and "<img" not in html:
        return html
    soup = BeautifulSoup(html, "html.parser")
    for element in soup.select(".arithmatex"):
        match = _DELIMITED.match(element.get_text().strip())
        element.replace_with(_mathml(match["tex"], display=match["kind"] == "["))
    if is_notebook:
        _resolve_links(soup, page, files)
        _finish_notebook(soup, page)
    for image in soup.select("p > img:only-child, .jp-OutputArea-output img"):
        if _is_wide(image["src"], Path(config["docs_dir"]) / page.url):
            image["class"] = "wide-figure"
            image.parent["class"] = [*image.parent.get("class", []), "scrolled-figure"]
    if page.file.src_path.startswith(("guides/", "notes/")):
        _write_captions(soup)
    return str(soup)


def _write_captions(soup):
    """Show the text of each picture beneath it, unless a caption in italics follows."""
    for image in soup.select("p > img:only-child"):
        after = image.parent.find_next_sibling()
        if after is None or after.name != "p" or after.select_one("em:only-child") is None:
            caption = soup.new_tag("p", attrs={"class": "caption"})
            caption.string = image.get("alt", "").rstrip(".") + "."
            image.parent.insert_after(caption)


def _is_wide(source, folder):
    """Return whether a picture, of a file or within the page, has at least 600 pixels and is much wider than high."""
    if source.startswith("data:image/svg") or source.endswith(".svg"):
        return False
    if source.startswith("data:"):
        file = io.BytesIO(base64.b64decode(source.partition(",")[2]))
    else:
        file = Path(posixpath.normpath(folder / source))
        if not file.is_file():
            return False
    with Image.open(file) as picture:
        return picture.width >= 600 and picture.width > 1.9 * picture.height


def _finish_notebook(soup, page):
    # What is drawn is stored in the notebook; scripts would only fetch from elsewhere.
    for script in soup.find_all("script"):
        script.decompose()
    for area in soup.select(".jp-RenderedMarkdown"):
        _draw_equations(area)
    name = page.file.src_path.rsplit("/", 1)[-1]
    soup.find("h1").insert_after(BeautifulSoup(_RUN.format(name=name), "html.parser"))
    texts = _picture_texts(page.file.abs_src_path)
    for image, text in zip(soup.select(".jp-OutputArea img"), texts, strict=True):
        image["alt"] = text
        image["title"] = text


def _resolve_links(soup, page, files):
    """Point links to Markdown files and notebooks to the pages that are made of them, and drawings to their files."""
    for link in soup.select(".jp-RenderedMarkdown a[href], .jp-RenderedMarkdown img[src]"):
        key = "src" if link.name == "img" else "href"
        target, anchor = urldefrag(link[key])
        if urlparse(target).scheme or not target.endswith((".md", ".ipynb", ".svg")):
            continue
        path = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_path), target))
        file = files.get_file_from_path(path)
        if file is None:
            _log.warning("%s links to %s, which is not there", page.file.src_path, target)
        else:
            link[key] = file.url_relative_to(page.file) + (f"#{anchor}" if anchor else "")


def _draw_equations(area):
    for node in area.find_all(string=_MATHS):
        if node.find_parent(["pre", "code", "math"]) is not None:
            continue
        pieces, end = [], 0
        for match in _MATHS.finditer(node):
            tex = match["display"] or match["inline"]
            pieces += [NavigableString(node[end : match.start()]), _mathml(tex, match["display"] is not None)]
            end = match.end()
        node.replace_with(*pieces, NavigableString(node[end:]))


def _mathml(tex, display):
    markup = latex2mathml.converter.convert(tex.strip(), display="block" if display else "inline")
    if display:
        # On a phone a long equation is scrolled by itself, not the page with it.
        markup = f'<span style="display: block; overflow-x: auto">{markup}</span>'
    return BeautifulSoup(markup, "html.parser")


def _picture_texts(path):
    """Return the alternative texts of a notebook's pictures, in order."""
    notebook = nbformat.read(path, as_version=4)
    outputs = (output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs)
    pictures = (output for output in outputs if any(kind.startswith("image/") for kind in output.get("data", {})))
    return [next(iter(picture.metadata.values()), {}).get("alt", "") for picture in pictures]
