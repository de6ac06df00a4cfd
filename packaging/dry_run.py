"""Go through a whole release without publishing anything, in a copy of the tree that is thrown away.

    python packaging/dry_run.py                    # libraries from the environment that runs this: some minutes
    python packaging/dry_run.py --clean --output released   # all libraries downloaded anew; keeps what was made

Compares what is said of the version (citation, changelog, conda recipe, paper), rewrites addresses as the release does,
builds, installs and uses the distributions (check.py), completes the conda recipe with their checksum, and builds the
site of this version beside a list of versions, from which its reader chooses. Each step prints a line; the first
one that fails ends the run.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from release import ROOT, version

ADDRESS = "https://example.org/odak/odak"
LEFT_OUT = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "output", "site", "released")


def contradictions(root: Path, number: str) -> list[str]:
    """Return what the files beside the package say otherwise about the version, or lack."""
    texts = {
        name: (root / name).read_text(encoding="utf-8")
        for name in ("CITATION.cff", "CHANGELOG.md", "packaging/conda/recipe.yaml", "paper.md", "paper.bib")
    }
    wanted = {
        "CITATION.cff": f"\nversion: {number}\n",
        "CHANGELOG.md": f"\n## [{number}]",
        "packaging/conda/recipe.yaml": f'\n  version: "{number}"\n',
    }
    found = [f"{name} lacks {text.strip()!r}" for name, text in wanted.items() if text not in texts[name]]
    section = texts["CHANGELOG.md"].partition(wanted["CHANGELOG.md"])[2].partition("\n## ")[0]
    if len(section.splitlines()) < 5:
        found.append(f"CHANGELOG.md says nothing of {number}")
    cited = set(re.findall(r"@(\w+)", texts["paper.md"].replace("@article", "")))
    found += [f"paper.bib lacks {key}" for key in sorted(cited - set(re.findall(r"@\w+\{(\w+),", texts["paper.bib"])))]
    return found


def completed(recipe: str, sdist: Path) -> str:
    """Return the conda recipe with the checksum of a source distribution."""
    return re.sub(r'sha256: "0{64}"', f'sha256: "{hashlib.sha256(sdist.read_bytes()).hexdigest()}"', recipe)


def add_version(site: Path, number: str) -> None:
    """List a version of the site, the newest first, and lead from the site's address to the newest."""
    listed = site / "versions.json"
    known = json.loads(listed.read_text(encoding="utf-8")) if listed.is_file() else []
    names = {entry["version"] for entry in known} | {number}
    ordered = sorted(names, key=lambda name: [int(part) for part in name.split(".")], reverse=True)
    entries = [{"version": name, "title": name, "aliases": ["latest"] * (name == ordered[0])} for name in ordered]
    listed.write_text(json.dumps(entries), encoding="utf-8")
    page = f'<!doctype html><title>odak</title><meta http-equiv="refresh" content="0; url={ordered[0]}/">'
    (site / "index.html").write_text(page, encoding="utf-8")


def build_site(source: Path, site: Path, number: str) -> None:
    """Build the site of a version in a folder of its own, with a menu of versions."""
    config = source / "mkdocs.release.yml"
    config.write_text("INHERIT: mkdocs.yml\nextra:\n  version:\n    provider: mike\n", encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", config, "-d", site / number]
    names = {"ODAK_SITE_URL": f"{ADDRESS}/{number}/", "ODAK_REPOSITORY": ADDRESS, "NO_MKDOCS_2_WARNING": "1"}
    subprocess.run(command, check=True, cwd=source, env=os.environ | names | {"PYTHONPATH": str(source)})
    add_version(site, number)


def main() -> None:
    """Run every step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clean", action="store_true", help="install every library anew")
    parser.add_argument("--output", type=Path, help="folder for all that was made, once it has passed")
    given = parser.parse_args()
    number, start = version(), time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - start:5.0f} s  {text}", flush=True)

    if found := contradictions(ROOT, number):
        raise SystemExit("\n".join(found))
    say(f"citation, changelog, recipe and paper speak of {number}")
    with tempfile.TemporaryDirectory() as name:
        source, made = Path(name) / "source", Path(name) / "made"
        shutil.copytree(ROOT, source, ignore=LEFT_OUT)
        script = [sys.executable, source / "packaging" / "release.py", ADDRESS, "--tag", f"v{number}"]
        subprocess.run(script, check=True)
        say("the addresses are in the README and in the metadata")
        check = [sys.executable, source / "packaging" / "check.py", "--output", made / "dist"]
        subprocess.run([*check, *(["--clean"] if given.clean else [])], check=True)
        sdist = next((made / "dist").glob("*.tar.gz"))
        recipe = completed((source / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"), sdist)
        (made / "recipe.yaml").write_text(recipe, encoding="utf-8")
        say("the distributions hold what they should, are installed and used; the recipe has their checksum")
        (made / "site").mkdir()
        build_site(source, made / "site", number)
        say("the site of this version stands beside the list of versions")
        if given.output:
            shutil.copytree(made, given.output, dirs_exist_ok=True)


if __name__ == "__main__":
    sys.exit(main())
