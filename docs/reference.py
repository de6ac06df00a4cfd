"""Generates the API reference from the public names of the packages.

A page in docs/reference lists names in fenced blocks, which a build turns into a table of summaries and one entry per
name, headed by the path under which it is imported:

    ```names odak.learn.wave
    propagate_beam, angular_spectrum
    ```

A `*` stands for the package's names that no block mentions, so that a new public name needs no change here.
`former_anchors.txt` lists anchors of earlier releases, which stay.
"""

import contextlib
import html
import importlib
import inspect
import logging
import re
import sys
import types
import typing
from functools import cache
from pathlib import Path

import griffe

DOCS = Path(__file__).resolve().parent
PAGES = DOCS / "reference"
_log = logging.getLogger("mkdocs.plugins.reference")
_BLOCK = re.compile(r"^```names (?P<package>[\w.]+)\n(?P<names>.*?)^```$", re.MULTILINE | re.DOTALL)
_COMMANDS = re.compile(r"^```commands (?P<app>[\w.]+)\n```$", re.MULTILINE)
_INDEX = re.compile(r"^```index\n```$", re.MULTILINE)
_ROLE = re.compile(r":(?:py:)?(?:func|meth|class|mod|attr|data|exc|obj):`(?P<text>[^`]+)`")
_ID = re.compile(r'<(?P<tag>h[1-6])(?P<before>[^>]*) id="(?P<id>odak[^"]*)"')


def public_names(package: str) -> list[str]:
    """Return the names that a package exports, without its modules."""
    module = importlib.import_module(package)
    return sorted(name for name in module.__all__ if not inspect.ismodule(getattr(module, name)))


@cache
def blocks() -> dict[str, list[tuple[str, list[str]]]]:
    """Return, for each page, the package and the names of its blocks, as written."""
    found = {}
    for path in sorted(PAGES.glob("*.md")):
        matches = _BLOCK.finditer(path.read_text(encoding="utf-8"))
        found[path.stem] = [(match["package"], match["names"].replace(",", " ").split()) for match in matches]
    return found


def packages() -> list[str]:
    """Return the packages whose names the pages list."""
    return sorted({package for page in blocks().values() for package, _ in page})


@cache
def entries() -> dict[str, str]:
    """Return the page of each public path; a name that is listed twice raises a ValueError."""
    pages: dict[str, str] = {}
    for page, content in blocks().items():
        for package, names in content:
            for name in _expanded(package, names):
                if f"{package}.{name}" in pages:
                    raise ValueError(f"{package}.{name} is on {pages[f'{package}.{name}']} and on {page}")
                pages[f"{package}.{name}"] = page
    return pages


def _expanded(package, names):
    if "*" not in names:
        return names
    mentioned = {name for page in blocks().values() for other, listed in page if other == package for name in listed}
    rest = [name for name in public_names(package) if name not in mentioned]
    return [name for name in names if name != "*"] + rest


def summary(value) -> str:
    """Return the first sentence of a docstring, or the value of a constant."""
    if isinstance(value, (str, int, float, tuple)):
        return f"`{value!r:.60}`"
    text = " ".join((inspect.getdoc(value) or "").split("\n\n")[0].split())
    return _ROLE.sub(lambda match: f"`{_shown(match['text'])}`", text).replace("|", "\\|").replace("``", "`")


def _shown(text):
    return text.removeprefix("~").rsplit(".", 1)[-1] if text.startswith("~") else text


@cache
def _examples():
    """Return, for each public path, links to the examples of the gallery that use it."""
    if str(DOCS) not in sys.path:
        sys.path.append(str(DOCS))
    import gallery

    found: dict[str, list[str]] = {}
    for path in gallery.scripts():
        link = f"[{gallery.described(path)[0]}](../gallery/{path.parent.name}/{path.stem}.md)"
        for name in gallery.uses(path):
            found.setdefault(name, []).append(link)
    return found


def _entries_of(match):
    package, lines = match["package"], []
    names = _expanded(package, match["names"].replace(",", " ").split())
    level = 3
    if len(names) > 1:
        lines += ["| name | summary |", "|---|---|"]
    module = importlib.import_module(package)
    missing = [name for name in names if not hasattr(module, name)]
    if missing:
        _log.warning("%s has no %s: take the names out of docs/reference", package, ", ".join(missing))
    names = [name for name in names if name not in missing]
    if len(names) > 1:
        lines += [f"| [`{name}`](#{package}.{name}) | {summary(getattr(module, name))} |" for name in names]
    for name in names:
        lines += ["", f"::: {package}.{name}", "    options:", f"      heading_level: {level}"]
        if examples := _examples().get(f"{package}.{name}"):
            lines += ["", "Examples in the gallery: " + ", ".join(examples)]
    return "\n".join(lines) + "\n"


def _commands_of(match):
    """Return a section for each command of a typer application, with a table of its options."""
    import typer

    module, name = match["app"].rsplit(".", 1)
    application = getattr(importlib.import_module(module), name)
    application = application.app if inspect.ismodule(application) else application
    lines = []
    for name, command in typer.main.get_command(application).commands.items():
        # What stands in angle brackets is a part of a name, not an element of HTML.
        text = html.escape((command.help or "").strip(), quote=False)
        lines += [f"## odak {name}", "", text, "", "| option | default | meaning |", "|---|---|---|"]
        for parameter in command.params:
            names = " ".join(f"`{option}`" for option in (*parameter.opts, *parameter.secondary_opts))
            if parameter.param_type_name == "argument":
                names = f"`{(parameter.metavar or parameter.name).upper()}`"
            default = parameter.default
            shown = "" if default is None or default is False or callable(default) else f"`{default}`"
            if isinstance(told := getattr(parameter, "show_default", None), str):
                shown = html.escape(told, quote=False)
            meaning = " ".join((getattr(parameter, "help", "") or "").split()).replace("|", "\\|")
            meaning = html.escape(meaning, quote=False)
            lines.append(f"| {names} | {shown} | {meaning} |")
        lines.append("")
    return "\n".join(lines)


def _index_of(match):
    """Return the public names in alphabetical order, each with links to its entries."""
    by_name: dict[str, list[str]] = {}
    for path in entries():
        by_name.setdefault(path.rpartition(".")[2], []).append(path)
    lines = []
    for initial in sorted({name.strip("_")[0].upper() for name in by_name}):
        lines += [f"### {initial}", ""]
        for name in sorted(by_name, key=str.lower):
            if name.strip("_")[0].upper() == initial:
                links = ", ".join(f"[{path.rpartition('.')[0]}]({entries()[path]}.md#{path})" for path in by_name[name])
                lines.append(f'- <a id="{name}"></a>`{name}`: {links}')
        lines.append("")
    return "\n".join(lines)


def on_page_markdown(markdown, page, config, files):
    """Replace the blocks of names and of commands by their entries."""
    if not page.file.src_path.startswith("reference/"):
        return markdown
    for pattern, expanded in ((_COMMANDS, _commands_of), (_BLOCK, _entries_of), (_INDEX, _index_of)):
        markdown = pattern.sub(expanded, markdown)
    return markdown


@cache
def former_anchors() -> list[tuple[str, str, str]]:
    """Return page, anchor and present path of the entries of earlier releases."""
    found = []
    for line in (DOCS / "former_anchors.txt").read_text(encoding="utf-8").splitlines()[1:]:
        place, names = line.split(": ")
        page, module, package = place.split()
        found += [(page, f"{module}.{name}", f"{package}.{name}") for name in names.split()]
    return found


def on_page_content(html, page, config, files):
    """Give the entries of a page the anchors of earlier releases too."""
    if not page.file.src_path.startswith("reference/"):
        return html
    name = Path(page.file.src_path).stem
    present = set(re.findall(r'id="([^"]*)"', html))
    former = [(old, new) for where, old, new in former_anchors() if where == name and old not in present]

    def with_anchors(match):
        path = match["id"]
        olds = [old + path[len(new) :] for old, new in former if path == new or path.startswith(f"{new}.")]
        return "".join(f'<a id="{old}"></a>' for old in olds) + match[0]

    html = _ID.sub(with_anchors, html)
    moved = [(old, new) for old, new in former if new not in present and new in entries()]
    if moved:
        links = "".join(f'<li id="{old}"><a href="../{entries()[new]}/#{new}"><code>{new}</code></a></li>' for old, new in moved)
        html += f"<h2>Entries on other pages</h2><ul>{links}</ul>"
    return html


_SIGNATURES = "odak.learn._faces."


class PublicNames(griffe.Extension):
    """Creates an object for each public name in its package, and converts roles in docstrings to links."""

    def on_package(self, *, pkg, loader, **kwargs):
        """Complete the package that was loaded."""
        if pkg.path != "odak":
            return
        for package in packages():
            for name in public_names(package):
                _define(pkg, package, name)
                _show_defaults(pkg, package, name)
        links = _Links()
        seen: set[int] = set()
        roots = [pkg, *filter(None, (_at(pkg, path) for path in entries()))]
        for item in (item for root in roots for item in _objects(root, seen)):
            if item.docstring is not None:
                item.docstring.value = _ROLE.sub(lambda match, item=item: links.of(match["text"], item), item.docstring.value)


def _objects(item, seen):
    if id(item) in seen or item.is_alias:
        return
    seen.add(id(item))
    yield item
    for member in item.members.values():
        yield from _objects(member, seen)


def _at(pkg, path):
    try:
        found = pkg[path.removeprefix("odak.")]
        found = found.final_target if found.is_alias else found
    except (KeyError, griffe.AliasResolutionError, griffe.CyclicAliasError):
        return None
    # The signatures written for editors carry one line of docstring: the function itself has all of it.
    return None if found.path.startswith(_SIGNATURES) else found


def _define(pkg, package, name):
    """Make `package.name` the object that an import gives: an alias of its source where static analysis finds one."""
    value = getattr(importlib.import_module(package), name)
    parent = pkg if package == "odak" else _at(pkg, package)
    home = getattr(value, "__module__", None) if callable(value) else None
    source = _at(pkg, f"{home}.{value.__qualname__}") if home and hasattr(value, "__qualname__") else None
    kind = griffe.Kind.CLASS if inspect.isclass(value) else griffe.Kind.FUNCTION
    stated = _at(pkg, f"{package}.{name}")
    if callable(value) and stated is not None and stated.kind is kind and stated.name == name == value.__name__:
        return
    if source is not None and source.kind is kind and (source.docstring or not value.__doc__) and source.name == name:
        if source.path != f"{package}.{name}":
            parent.set_member(name, griffe.Alias(name, target=source, parent=parent))
        return
    if inspect.isfunction(value):
        parent.set_member(name, _function(name, value, parent))
    elif inspect.isclass(value) and source is not None:
        parent.set_member(name, griffe.Alias(name, target=source, parent=parent))
    else:
        docstring = stated.docstring if stated is not None else None
        shown = repr(value) if isinstance(value, (str, int, float)) else None
        attribute = griffe.Attribute(name, value=shown, parent=parent, docstring=docstring)
        parent.set_member(name, attribute)


def _show_defaults(pkg, package, name):
    """Replace defaults that are names of constants by their values."""
    value, shown = getattr(importlib.import_module(package), name), _at(pkg, f"{package}.{name}")
    if shown is None or not (inspect.isfunction(value) or inspect.isclass(value)):
        return
    with contextlib.suppress(ValueError, TypeError):
        signature = inspect.signature(value).parameters
        for item in shown.parameters:
            if item.default and re.fullmatch(r"[A-Z_]{2,}", str(item.default)) and item.name in signature:
                item.default = repr(signature[item.name].default)


def _function(name, value, parent):
    """Return the description of a function that exists only at run time, from its signature and docstring."""
    signature = inspect.signature(value)
    kinds = {
        inspect.Parameter.POSITIONAL_ONLY: griffe.ParameterKind.positional_only,
        inspect.Parameter.POSITIONAL_OR_KEYWORD: griffe.ParameterKind.positional_or_keyword,
        inspect.Parameter.VAR_POSITIONAL: griffe.ParameterKind.var_positional,
        inspect.Parameter.KEYWORD_ONLY: griffe.ParameterKind.keyword_only,
        inspect.Parameter.VAR_KEYWORD: griffe.ParameterKind.var_keyword,
    }
    parameters = [
        griffe.Parameter(
            item.name,
            annotation=_annotation(item.annotation),
            kind=kinds[item.kind],
            default=None if item.default is item.empty else getattr(item.default, "__name__", None) or repr(item.default),
        )
        for item in signature.parameters.values()
    ]
    text = inspect.getdoc(value)
    function = griffe.Function(
        name,
        parameters=griffe.Parameters(*parameters),
        returns=_annotation(signature.return_annotation),
        parent=parent,
        docstring=griffe.Docstring(text, parser="numpy") if text else None,
    )
    if function.docstring:
        function.docstring.parent = function
    return function


def _annotation(value):
    if value is inspect.Parameter.empty:
        return None
    if typing.get_origin(value) in (typing.Union, types.UnionType):
        return " | ".join(_annotation(member) for member in typing.get_args(value))
    text = "None" if value is type(None) else inspect.formatannotation(value) if not isinstance(value, str) else value
    return re.sub(r"\b(?:typing|collections\.abc|numpy|torch)\.(?=[A-Z])|~", "", text)


class _Links:
    """Links from roles in docstrings to entries of the reference."""

    def __init__(self):
        self.paths = set(entries())
        self.by_name = {}
        for path in sorted(self.paths):
            self.by_name.setdefault(path.rsplit(".", 1)[1], []).append(path)

    def of(self, text, item):
        shown, target = _shown(text), text.removeprefix("~").removesuffix("()")
        path = self.resolve(target, item)
        return f"[`{shown}`][{path}]" if path else f"`{shown}`"

    def resolve(self, target, item):
        owner = item if item.is_class else item.parent
        if owner is not None and owner.is_class and "." not in target:
            if target in owner.members or target in owner.inherited_members:
                paths = self.nearest(owner.name, item)
                return f"{paths}.{target}" if paths and target in owner.members else None
        head, _, member = target.partition(".") if not target.startswith("odak.") else (target, "", "")
        if target in self.paths:
            return target
        if target.startswith("odak."):
            head, _, last = target.rpartition(".")
            if head in self.paths:
                return target
            return self.nearest(last, item, within=target.rsplit(".", 2)[0])
        path = self.nearest(head, item)
        return path and (f"{path}.{member}" if member else path)

    def nearest(self, name, item, within=None):
        """Return the path of a public name, on the face of the object that mentions it if there are two."""
        learn = (within or item.path).startswith("odak.learn")
        paths = self.by_name.get(name, [])
        same_package = [path for path in paths if (within or item.path).startswith(path.rsplit(".", 1)[0] + ".")]
        same = [path for path in paths if path.startswith("odak.learn.") == learn]
        return next(iter([*same_package, *same, *paths]), None)
