"""Make the sources ready for a package index: an address in the metadata, and a README whose links lead somewhere.

    python packaging/release.py https://github.com/owner/odak --tag v0.3.0

Rewrites README.md and pyproject.toml in place, in a clean checkout that is thrown away afterwards; then
`python packaging/check.py --output dist` builds and checks what is published. The tag must name the version.
"""

import argparse
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!https?:|#|mailto:)[^)\s]+)\)")


def absolute(text: str, repository: str, tag: str) -> str:
    """Return a Markdown text with its relative links and pictures pointing into a tag of a repository."""

    def pointing(match):
        kind = "raw" if match["picture"] else "blob"
        return f"{match['picture']}[{match['text']}]({repository}/{kind}/{tag}/{match['path']})"

    # Badges are links around pictures: the pictures first, then what is around them.
    return _LINK.sub(pointing, text)


def with_addresses(text: str, repository: str) -> str:
    """Return the text of pyproject.toml with the addresses of a repository."""
    pages = {"Source": "", "Issues": "/issues", "Changelog": "/blob/main/CHANGELOG.md"}
    lines = "\n".join(f'{name} = "{repository}{path}"' for name, path in pages.items())
    return text.replace("[project.scripts]", f"[project.urls]\n{lines}\n\n[project.scripts]", 1)


def version(root: Path = ROOT) -> str:
    """Return the version of the package."""
    text = (root / "odak" / "_version.py").read_text(encoding="utf-8")
    return re.search(r'^__version__ = "(.+)"$', text, re.MULTILINE)[1]


def main() -> None:
    """Rewrite the README and the metadata."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("repository", help="the repository's address, https://…")
    parser.add_argument("--tag", required=True, help="the tag that is released, v and the version")
    given = parser.parse_args()
    repository = given.repository.rstrip("/")
    if not repository.startswith("https://"):
        parser.error(f"repository must be an address that begins with https://, got {repository!r}")
    if given.tag != f"v{version()}":
        parser.error(f"the tag {given.tag!r} is not that of odak/_version.py, v{version()}")
    for name, change in (
        ("README.md", lambda text: absolute(text, repository, given.tag)),
        ("pyproject.toml", lambda text: with_addresses(text, repository)),
    ):
        path = ROOT / name
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
