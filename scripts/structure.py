"""Prints the size of the package and its parts: modules, code lines and functions; finds import cycles.

    python scripts/structure.py [folder]

Code lines are those without docstrings, comments and blank lines. Also read by the tests of the structure.
"""

import ast
import functools
import gc
import io
import re
import sys
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1] / "odak"


def modules(root: Path = ROOT) -> dict[str, Path]:
    """Return the file of each module, by its dotted name."""
    files = (path for path in root.rglob("*.py"))
    return {
        ".".join(path.relative_to(root.parent).with_suffix("").parts).removesuffix(".__init__"): path for path in files
    }


@functools.cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    # A tree has no circles; to look for them would take more time than to parse.
    collecting = gc.isenabled()
    gc.disable()
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    finally:
        if collecting:
            gc.enable()


def stubs(root: Path = ROOT) -> dict[str, dict[str, str]]:
    """Return, for each package, the module that each of its public names comes from."""
    found = {}
    for path in root.rglob("__init__.pyi"):
        package = ".".join(path.parent.relative_to(root.parent).parts)
        found[package] = {
            alias.asname or alias.name: module if node.module else f"{module}.{alias.name}"
            for node in tree(path).body
            if isinstance(node, ast.ImportFrom)
            for module in [_absolute(package, node)]
            for alias in node.names
        }
    return found


def imports(root: Path = ROOT) -> dict[str, set[str]]:
    """Return the modules of the package that each module imports, inside functions and by strings included."""
    known, names = modules(root), stubs(root)

    def home(module, name):
        if f"{module}.{name}" in known:
            return f"{module}.{name}"
        return names.get(module, {}).get(name, module)

    graph = {}
    for module, path in known.items():
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        found = set()
        for node in _statements(tree(path)):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found |= {home(_absolute(package, node), alias.name) for alias in node.names}
        # The table of moved names is what older scripts ask for, and nothing that the package itself asks for.
        if module != "odak._moved":
            found |= named(path.read_text(encoding="utf-8"), root.name)
        graph[module] = (found & set(known)) - {module, root.name}
    return graph


def named(text: str, package: str) -> set[str]:
    """Return the modules that strings in a source name, and their parents: what importlib may be given."""
    dotted = re.findall(rf"""["']({package}(?:\.\w+)+)["']""", text)
    return {name.rsplit(".", count)[0] for name in dotted for count in range(name.count("."))}


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Return the sets of modules that import each other in a circle (Tarjan, SIAM J. Comput. 1, 146 (1972))."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(module):
        number[module] = lowest[module] = len(number)
        stack.append(module)
        for other in sorted(graph[module]):
            if other not in number:
                visit(other)
                lowest[module] = min(lowest[module], lowest[other])
            elif other in stack:
                lowest[module] = min(lowest[module], number[other])
        if lowest[module] == number[module]:
            place = stack.index(module)
            component = sorted(stack[place:])
            del stack[place:]
            if len(component) > 1:
                found.append(component)

    for module in graph:
        if module not in number:
            visit(module)
    return found


def code_lines(text: str, parsed: ast.Module | None = None) -> int:
    """Return the number of lines that hold code; of a text that is parsed already, if it is given."""
    parsed = parsed or ast.parse(text)
    docstrings = [
        node.body[0]
        for node in (parsed, *_statements(parsed))
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))
        and node.body
        and isinstance(node.body[0], ast.Expr)
        and isinstance(node.body[0].value, ast.Constant)
        and isinstance(node.body[0].value.value, str)
    ]
    inside = {line for node in docstrings for line in range(node.lineno, (node.end_lineno or 0) + 1)}
    if text.count('"""') == 2 * len(docstrings) and "'''" not in text:
        # No other string has several lines, so that each line tells what it is.
        stripped = enumerate(map(str.strip, text.splitlines()), 1)
        return sum(bool(line) and not line.startswith("#") and number not in inside for number, line in stripped)
    blank = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in blank:
            lines |= set(range(token.start[0], token.end[0] + 1))
    return len(lines - inside)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements inside a node, without a look at their expressions."""
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for inner in getattr(node, name, ()):
            yield inner
            yield from _statements(inner)


def _absolute(package: str, node: ast.ImportFrom) -> str:
    base = package.rsplit(".", node.level - 1)[0] if node.level else ""
    return ".".join(part for part in (base, node.module) if part)


def _functions(text: str) -> int:
    return sum(isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) for node in ast.walk(ast.parse(text)))


def main(root: Path) -> None:
    """Print a table of the parts of the package."""
    rows: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for name, path in modules(root).items():
        text = path.read_text(encoding="utf-8")
        parts = name.split(".")
        part = (
            ".".join(parts[: 3 if parts[1:2] == ["learn"] else 2])
            if path.name == "__init__.py" or len(parts) > 2
            else parts[0]
        )
        for key in (part, "all"):
            for i, count in enumerate((1, len(text.splitlines()), code_lines(text), _functions(text))):
                rows[key][i] += count
    sys.stdout.write(f"{'':28}{'modules':>9}{'lines':>9}{'code':>9}{'functions':>11}\n")
    for key in [*sorted(set(rows) - {"all"}), "all"]:
        sys.stdout.write(f"{key:28}" + "{:9}{:9}{:9}{:11}\n".format(*rows[key]))
    for cycle in cycles(imports(root)):
        sys.stdout.write(f"cycle: {' '.join(cycle)}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve() if len(sys.argv) > 1 else ROOT)
