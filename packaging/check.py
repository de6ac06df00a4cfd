"""Build odak as it would be published, look at what is in it, install it and use it.

    python packaging/check.py            # libraries from the environment that runs this: under a minute
    python packaging/check.py --clean    # all of them downloaded into an empty environment for each: minutes
    python packaging/check.py --output dist   # keeps what was built, once it has passed

Builds the source distribution and from it the wheel, in a copy of the tree; compares their contents with the tree; runs
twine's check; installs each in an environment of its own and runs packaging/smoke.py there.
"""

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ["build==1.6.1", "twine==7.0.0"]
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "docs", "output", "site")
INFO = {"METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE.txt", "top_level.txt"}
BESIDE = {
    "CHANGELOG.md",
    "CITATION.cff",
    "LICENSE.txt",
    "MANIFEST.in",
    "PKG-INFO",
    "README.md",
    "THANKS.txt",
    "pyproject.toml",
}


def package_files(root: Path) -> set[str]:
    """Return the files of the package below a folder, compiled ones aside."""
    found = (path for path in (root / "odak").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return {path.relative_to(root).as_posix() for path in found}


def gallery_files(root: Path) -> set[str]:
    """Return the scripts of the gallery, which are installed beside the package."""
    return {path.relative_to(root).as_posix() for path in (root / "docs" / "gallery").glob("*/*.py")}


def difference(found: set[str], expected: set[str]) -> str:
    """Return how two sets of names differ, the empty string where they do not."""
    lines = [f"  missing: {name}" for name in sorted(expected - found)]
    return "\n".join([*lines, *(f"  too many: {name}" for name in sorted(found - expected))])


def check_wheel(path: Path, package: set[str], gallery: set[str]) -> None:
    """Require a wheel to hold the package, the gallery, its metadata, its licence, and nothing else."""
    with zipfile.ZipFile(path) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    name = "-".join(path.name.split("-")[:2])
    scripts = {f"{name}.data/data/share/odak/{script.removeprefix('docs/')}" for script in gallery}
    if wrong := difference(names, package | scripts | {f"{name}.dist-info/{item}" for item in INFO}):
        raise SystemExit(f"{path.name} is not what it should be:\n{wrong}")


def check_sdist(path: Path, package: set[str]) -> None:
    """Require a source distribution to hold the package and what builds it, and nothing else."""
    with tarfile.open(path) as archive:
        names = {member.name.split("/", 1)[1] for member in archive if member.isfile()}
    names = {name for name in names if not name.startswith("odak_optics.egg-info/") and name != "setup.cfg"}
    if wrong := difference(names, package | BESIDE):
        raise SystemExit(f"{path.name} is not what it should be:\n{wrong}")


def environment(folder: Path, borrowed: bool) -> Path:
    """Return the Python of a new environment, which sees the libraries of this one if they are borrowed."""
    venv.create(folder, with_pip=True)
    python = folder / ("Scripts" if os.name == "nt" else "bin") / "python"
    if borrowed:
        # A path alone: what makes an editable odak importable here is not followed from there.
        query = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
        site = Path(subprocess.run(query, check=True, capture_output=True, text=True).stdout.strip())
        paths = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
        (site / "borrowed.pth").write_text("\n".join(sorted(paths)) + "\n", encoding="utf-8")
    return python


def pip(python: Path, *arguments: str | Path) -> None:
    """Install quietly."""
    subprocess.run([python, "-m", "pip", "install", "-q", *arguments], check=True)


def torch_requirement() -> str:
    """Return the pinned torch of requirements.txt."""
    lines = (ROOT / "requirements.txt").read_text(encoding="utf-8").splitlines()
    return next(line for line in lines if line.startswith("torch=="))


def use(package: Path, folder: Path, borrowed: bool) -> None:
    """Install a distribution in a separate environment and run the smoke test there."""
    python = environment(folder, borrowed)
    if not borrowed:
        pip(python, torch_requirement())
    # The wheel's own metadata is read either way; --no-deps only leaves the libraries where they are.
    pip(python, *(["--no-deps", package] if borrowed else [f"{package}[figures]"]))
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    smoke = shutil.copy(ROOT / "packaging" / "smoke.py", elsewhere)
    subprocess.run([python, smoke], check=True, cwd=elsewhere, env=clean)


def main() -> None:
    """Build, look, install, use."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clean", action="store_true", help="install every library anew")
    parser.add_argument("--output", type=Path, help="folder for the distributions that have passed")
    given = parser.parse_args()
    borrowed = not given.clean
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(ROOT, folder / "source", ignore=LEFT_OUT)
        gallery = gallery_files(ROOT)
        for script in gallery:
            (folder / "source" / script).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / script, folder / "source" / script)
        tools = environment(folder / "tools", borrowed=False)
        pip(tools, *TOOLS)
        built = folder / "built"
        subprocess.run([tools, "-m", "build", "-q", "--outdir", built, folder / "source"], check=True)
        wheel, sdist = next(built.glob("*.whl")), next(built.glob("*.tar.gz"))
        package = package_files(ROOT)
        check_wheel(wheel, package, gallery)
        check_sdist(sdist, package | gallery)
        subprocess.run([tools, "-m", "twine", "check", "--strict", wheel, sdist], check=True)
        for path in (wheel, sdist):
            print(f"{path.name}, {path.stat().st_size / 1e6:.1f} MB", flush=True)
            use(path, folder / path.suffix[1:], borrowed)
        if given.output:
            shutil.copytree(built, given.output, dirs_exist_ok=True)


if __name__ == "__main__":
    sys.exit(main())
