"""The scripts of the gallery, which come with the package: their list, and copies of them to change and run."""

import ast
import shutil
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import odak
from odak._call_forms import did_you_mean
from odak.cli.options import InputError

# Where an installation puts them, below the folder of Python's data; a checkout has them among its documentation.
INSTALLED = ("share", "odak", "gallery")


def scripts() -> dict[str, Path]:
    """Return the scripts by group and name, such as "lenses/double_gauss"."""
    checkout = Path(odak.__file__).resolve().parents[1] / "docs" / "gallery"
    found = list(checkout.glob("*/*.py")) or _installed()
    return {f"{path.parent.name}/{path.stem}": path for path in sorted(found)}


def _installed() -> list[Path]:
    try:
        files = distribution("odak-optics").files or []
    except PackageNotFoundError:
        return []
    # The metadata knows the folder of data of each kind of installation: of an environment, of a user, of a target.
    found = (file for file in files if file.suffix == ".py" and file.parts[-5:-2] == INSTALLED)
    return [Path(str(file.locate())) for file in found]


def title(path: Path) -> str:
    """Return the first line of a script's docstring."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n")[0]


def listing() -> list[str]:
    """Return one line for each script, its name and its title."""
    found = scripts()
    width = max((len(name) for name in found), default=0)
    return [f"{name:<{width}}  {title(path)}" for name, path in found.items()]


def copied(names: tuple[str, ...], folder: Path, again: bool) -> list[Path]:
    """Copy scripts, or all of a group, to a folder, and return the copies.

    Parameters
    ----------
    names : tuple of str
        Names as :func:`scripts` gives them, their last parts, or names of groups.
    folder : Path
        Where they are copied to.
    again : bool
        Replace files that are there already.

    Raises
    ------
    InputError
        If a name is unknown, or if a file is there already and shall not be replaced.
    """
    found = scripts()
    known = sorted({*found, *(part for name in found for part in name.split("/"))})
    chosen: list[Path] = []
    for name in names:
        wanted = name.replace("\\", "/").removesuffix(".py")
        if wanted not in known:
            raise InputError(f"no example is named {name!r}; `odak examples` lists them.{did_you_mean(wanted, known)}")
        chosen += [path for full, path in found.items() if wanted in (full, *full.split("/"))]
    targets = {folder / path.name: path for path in chosen}
    if there := [str(target) for target in targets if target.exists() and not again]:
        raise InputError(f"{', '.join(there)} exists already; --again replaces it, and --output names another folder")
    folder.mkdir(parents=True, exist_ok=True)
    for target, path in targets.items():
        shutil.copyfile(path, target)
    return list(targets)
