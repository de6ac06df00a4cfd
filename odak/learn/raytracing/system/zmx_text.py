"""The text of a .zmx file: decoding, and its lines sorted by surface. Nothing of it is ever executed."""

import codecs
from pathlib import Path
from typing import NamedTuple

MAXIMUM_BYTES = 4 << 20
MAXIMUM_SURFACES = 1000
_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"), (codecs.BOM_UTF8, "utf-8-sig"))


class Line(NamedTuple):
    """A line: its number, its first word, and the rest as words."""

    number: int
    key: str
    words: tuple[str, ...]

    def value(self, place: int = 0) -> float:
        """Return one of the words as a finite number or an infinity; ValueError, naming the line, for anything else."""
        if place >= len(self.words):
            raise ValueError(f"line {self.number}: {self.key} lacks a number")
        word = self.words[place]
        if word.upper() in ("INFINITY", "-INFINITY"):
            return float(word)
        try:
            found = float(word)
        except ValueError:
            raise ValueError(f"line {self.number}: {self.key} must have a number, got {word!r}") from None
        if found != found:
            raise ValueError(f"line {self.number}: {self.key} is not a number")
        return found

    def whole(self, place: int = 0) -> int:
        """Return one of the words as an integer."""
        found = self.value(place)
        if found != int(found) if abs(found) < 1e9 else True:
            raise ValueError(f"line {self.number}: {self.key} must have a whole number, got {self.words[place]!r}")
        return int(found)

    def counts(self, number: int) -> bool:
        """Say whether the first of the words is this whole number."""
        try:
            return self.whole() == number
        except ValueError:
            return False


def read_lines(path) -> tuple[list[Line], list[list[Line]]]:
    """Return the lines that concern the whole system, and those of each surface.

    Parameters
    ----------
    path : str or pathlib.Path
        UTF-16 with its mark, UTF-8 with or without, or Latin-1.

    Raises
    ------
    ValueError
        If the file is too large, holds no surfaces, or its surfaces are not numbered 0, 1, 2, …
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"path must be a file, got {str(path)!r}")
    if path.stat().st_size > MAXIMUM_BYTES:
        raise ValueError(f"{path.name}: larger than {MAXIMUM_BYTES} bytes")
    general: list[Line] = []
    surfaces: list[list[Line]] = []
    for number, text in enumerate(_decoded(path.read_bytes(), path.name).splitlines(), start=1):
        words = text.split()
        if not words:
            continue
        line = Line(number, words[0].upper(), tuple(words[1:]))
        if line.key == "SURF":
            if not line.counts(len(surfaces)) or len(surfaces) >= MAXIMUM_SURFACES:
                accepted = f"SURF must count 0, 1, 2, … below {MAXIMUM_SURFACES}"
                raise ValueError(f"{path.name}, line {number}: {accepted}, got {text.strip()[:80]!r}")
            surfaces.append([])
        # What belongs to a surface is indented.
        elif surfaces and text[0] in " \t":
            surfaces[-1].append(line)
        else:
            general.append(line)
    if len(surfaces) < 3:
        raise ValueError(
            f"{path.name}: must hold an object, at least one surface and an image, got {len(surfaces)} SURF"
        )
    return general, surfaces


def _decoded(data: bytes, name: str) -> str:
    encoding = next((encoding for mark, encoding in _MARKS if data.startswith(mark)), "utf-8")
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            raise ValueError(f"{name}: not valid {encoding}") from None
        return data.decode("latin-1")
