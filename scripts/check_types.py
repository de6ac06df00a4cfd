"""What pyright shows of the public names: no type is unknown, and bare Any at their doors becomes rarer.

    python scripts/check_types.py

mypy checks the package from within. This asks pyright, the checker of Pylance, what an editor shows a user of every
public name, constructor and method of the odak that is installed for this Python, an editable one as the README's too.
"""

import importlib
import inspect
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Bare Any among the parameters and results of the packages whose doors are to have none; the numbers only shrink.
MOST_ANY = {
    "odak.catalog": 0,
    "odak.jones": 0,
    "odak.learn.perception": 0,
    "odak.learn.raytracing": 1,
    "odak.learn.raytracing.system": 0,
    "odak.learn.wave": 4,
    "odak.raytracing": 0,
    "odak.wave": 0,
}
# Least share of the symbols of all modules that have a known type; the number only grows.
LEAST_KNOWN = 0.985
_BARE = re.compile(r"\w: Any(?= = |,|\)|$)|-> Any$")


def public_names() -> dict[str, str]:
    """Return how a script writes each public name, constructor and method, by its full name."""
    packages = sorted(".".join(p.parent.relative_to(ROOT).parts) for p in (ROOT / "odak").rglob("__init__.pyi"))
    written = {}
    for package in packages:
        module = importlib.import_module(package)
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if inspect.ismodule(value):
                continue
            alias = f"{package}.{name}".replace(".", "_")
            written[f"{package}.{name}"] = alias
            if inspect.isclass(value) and value.__module__.startswith("odak"):
                members = ("__init__", *(member for member in vars(value) if not member.startswith("_")))
                for member in members:
                    if inspect.isroutine(inspect.getattr_static(value, member)):
                        written[f"{package}.{name}.{member}"] = f"{alias}.{member}"
    return written


def revealed(written: dict[str, str]) -> dict[str, str]:
    """Return the type that pyright shows for each name to a user who imports it."""
    lines = []
    for name, text in written.items():
        package, _, last = name.rpartition(".")
        if "." not in text:
            lines.append(f"from {package} import {last} as {text}")
        lines.append(f"reveal_type({text})")
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "user.py"
        script.write_text("\n".join(lines) + "\n", encoding="utf-8")
        command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson", script.name]
        report = json.loads(subprocess.run(command, cwd=folder, capture_output=True, text=True).stdout)
    names, found, others = {text: name for name, text in written.items()}, {}, []
    for message in report["generalDiagnostics"]:
        text = re.fullmatch(r'Type of "(.+?)" is "(.*)"', message["message"], re.DOTALL)
        if text is None:
            others.append(message["message"])
        else:
            found[names[text[1]]] = text[2]
    if others or len(found) != len(written):
        raise SystemExit("\n".join(["pyright does not resolve all public names:", *others]))
    return found


def known_share() -> float:
    """Return the share of the symbols of all modules whose types pyright knows."""
    # It asks the first Python on the path where packages are, whatever it is told.
    paths = {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "pyright", "--verifytypes", "odak", "--ignoreexternal", "--outputjson"]
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(command, cwd=folder, env=os.environ | paths, capture_output=True, text=True)
    return json.loads(done.stdout)["typeCompleteness"]["completenessScore"]


def main() -> int:
    """Print the numbers; return 1 if a type is unknown, or a number is worse than those stated above."""
    types = revealed(public_names())
    unknown = {name for name, shown in types.items() if "Unknown" in shown}
    print(f"{len(types)} public names, constructors and methods, {len(unknown)} with unknown types; bare Any:")
    counts: Counter = Counter()
    for name, shown in types.items():
        package = max((p for p in sys.modules if name.startswith(f"{p}.")), key=len)
        counts[package] += len(_BARE.findall(shown))
    print("\n".join(f"  {package}: {count}" for package, count in sorted(counts.items()) if count))
    for name in sorted(unknown):
        print(f"{name}: {types[name]}")
    share = known_share()
    print(f"{share:.1%} of the symbols of all modules have a known type, {LEAST_KNOWN:.1%} at least")
    more = {package: most for package, most in MOST_ANY.items() if counts[package] > most}
    for package, most in more.items():
        print(f"{package} has {counts[package]} bare Any, {most} at most")
    return int(bool(unknown) or share < LEAST_KNOWN or bool(more))


if __name__ == "__main__":
    sys.exit(main())
