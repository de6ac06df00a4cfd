"""Public names found by words: an index of names, first lines of docstrings, and other words for both."""

import ast
import functools
import re
from pathlib import Path
from typing import NamedTuple

from odak._lazy import _homes, _read_stub
from odak._moved import other_words

# Beginnings of words in British and in American spelling: readers use either, and so do names and texts.
_SPELLINGS = (
    "analyse:analyze analysing:analyzing apodis:apodiz behaviour:behavior catalogue:catalog centred:centered "
    "centring:centering centre:center characteris:characteriz colour:color digitis:digitiz discretis:discretiz "
    "equalis:equaliz fibre:fiber focussed:focused focussing:focusing grey:gray initialis:initializ labelled:labeled "
    "linearis:lineariz metre:meter micrometre:micrometer millimetre:millimeter minimis:minimiz modelled:modeled "
    "modelling:modeling nanometre:nanometer neighbour:neighbor normalis:normaliz optimis:optimiz organis:organiz "
    "parametris:parametriz polaris:polariz quantis:quantiz randomis:randomiz rasteris:rasteriz regularis:regulariz "
    "summaris:summariz synchronis:synchroniz tokenis:tokeniz travelling:traveling visualis:visualiz"
)
SPELLINGS = [(british, american) for british, _, american in (pair.partition(":") for pair in _SPELLINGS.split())]

# Words that stand for each other in a search. A word is in one line only.
SYNONYMS = (
    "load read open import parse",
    "save write export store",
    "show plot draw visualize view render figure",
    "picture image photo photograph",
    "tolerance tolerancing yield montecarlo",
    "zmx zemax opticstudio",
    "slm modulator panel lcos",
    "hologram cgh",
    "compute calculate solve",
    "propagate propagation diffraction diffract",
    "speed fast faster",
    "glass material dispersion sellmeier",
    "lens objective",
    "optimize minimize",
    "aberration zernike seidel",
    "vortex oam",
    "calibrate calibration",
    "gaze foveated foveation fovea",
)

# Words of a search that say nothing of what is sought.
_EMPTY = {"a", "an", "and", "by", "for", "from", "how", "in", "is", "of", "on", "or", "the", "to", "with"}
_ENDINGS = re.compile(r"(?:ations?|ators?|ing|ions?|ian|ors?|ers?|ed|es|s|e|y|ic|al)$")
_MOST = 12


class Finding(NamedTuple):
    """A public name that a search has found.

    Attributes
    ----------
    name : str
        Path under which it is imported.
    line : str
        First line of its docstring.
    page : str
        Its line in the index of the reference, relative to the address of the site.
    also : tuple of str
        Further paths, of the same function for tensors for instance.
    """

    name: str
    line: str
    page: str
    also: tuple[str, ...] = ()


class Findings(tuple[Finding, ...]):
    """What a search has found, best first; it prints as names with their descriptions and pages."""

    def __repr__(self) -> str:
        rows = (f"{', '.join((found.name, *found.also))}\n    {found.line}\n    {found.page}" for found in self)
        return "\n".join(rows) or "Nothing found: try fewer or other words."

    def _repr_html_(self) -> str:
        from odak._show import View, to_html

        rows = [(", ".join((found.name, *found.also)), found.line, found.page) for found in self]
        return to_html(View(f"{len(self)} found", table=[("name", "what it is", "page"), *rows]))


def spellings(word: str) -> tuple[str, ...]:
    """Return a word in small letters and, where it has one, in American and in British spelling.

    Parameters
    ----------
    word : str
        The word.
    """
    word = word.casefold()
    for british, american in SPELLINGS:
        for one in (british, american):
            if word.startswith(one):
                return american + word[len(one) :], british + word[len(one) :]
    return (word,)


def stem(word: str) -> str:
    """Return what the forms of a word have in common: its American spelling without its ending.

    Parameters
    ----------
    word : str
        The word.
    """
    word = spellings(word)[0]
    shorter = _ENDINGS.sub("", word)
    return shorter if len(shorter) >= 3 else word


@functools.cache
def _groups() -> dict[str, str]:
    """Return, for the stem of each synonym, the first stem of its line."""
    return {stem(word): stem(line.split()[0]) for line in SYNONYMS for word in line.split()}


def _words(text: str) -> list[str]:
    """Return the stems of a text's words; those of CamelCase and snake_case apart."""
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", text)
    return [stem(part) for part in parts if part.casefold() not in _EMPTY]


@functools.cache
def _first_lines(module: str) -> dict[str, str]:
    """Return the first line of the docstring of each function and class of a module or package, without its import."""
    path = Path(__file__).parents[1].joinpath(*module.split("."))
    if path.is_dir():
        home = _read_stub(module, path / "__init__.pyi")
        return {name: _first_lines(place).get(own or "", "") for name, (place, own) in home.items()}
    found = {}
    for node in ast.parse(path.with_suffix(".py").read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            line = (ast.get_docstring(node) or "").partition("\n")[0]
            found[node.name] = re.sub(r":\w+:`~?([^`]*)`", r"\1", line)
    return found


@functools.cache
def _index() -> list[tuple[Finding, dict[str, float]]]:
    """Return every public function and class with the weights of the words under which it is found."""
    entries = []
    for name, places in _homes().items():
        stub = Path(__file__).parents[1].joinpath(*places[0].split("."), "__init__.pyi")
        module, attribute = _read_stub(places[0], stub)[name]
        line = _first_lines(module).get(attribute or name, "")
        # Constants and second names have no line; the packages of displays serve the one above.
        if not line or places[0].startswith(("odak.learn.wave.displays", "odak.learn.wave.holograms")):
            continue
        texts = ((f"{line} {places[0].rpartition('.')[2]}", 2.0), (other_words().get(name, ""), 4.0), (name, 5.0))
        words = {word: weight for text, weight in texts for word in _words(text)}
        if ".older." in module:  # what has a successor comes after it
            words = {word: 0.5 * weight for word, weight in words.items()}
        paths = [f"{place}.{name}" for place in places]
        entries.append((Finding(paths[0], line, f"reference/overview/#{name}", tuple(paths[1:])), words))
    return entries


def _weight(sought: str, words: dict[str, float]) -> float:
    """Return how well a word meets those of an entry: itself, one that begins with it, or one that stands for it."""
    if sought in words:
        return words[sought]
    begun = max((weight for word, weight in words.items() if len(sought) > 2 and word.startswith(sought)), default=0)
    group = _groups().get(sought)
    meant = max((weight for word, weight in words.items() if group and _groups().get(word) == group), default=0)
    return max(0.5 * begun, 0.7 * meant)


def find(words: str) -> Findings:
    """Find public functions and classes by words, as in a search box.

    Names, the first lines of docstrings and words that other libraries use are searched, in British and in American
    spelling and in any form of the words. Nothing is imported.

    Parameters
    ----------
    words : str
        What is sought: "zmx", "visualize field", "Laguerre Gauss".

    Returns
    -------
    found : Findings
        At most twelve named tuples of a name, its description and its page on the site, best first: those that meet
        all of the words, or as many as any does. They print as a list.

    Raises
    ------
    TypeError
        If ``words`` is no text.

    Examples
    --------
    >>> import odak
    >>> odak.find("load zmx")[0].name
    'odak.learn.raytracing.system.read_zmx'
    >>> odak.find("Laguerre Gauss")
    odak.wave.laguerre_gaussian_beam, odak.learn.wave.laguerre_gaussian_beam
        Return a Laguerre–Gauss mode, which carries an optical vortex, at a distance from its waist.
        reference/overview/#laguerre_gaussian_beam
    """
    if not isinstance(words, str):
        raise TypeError(f"words must be a text such as 'load zmx', not {type(words).__name__}")
    sought = list(dict.fromkeys(_words(words)))
    scored = []
    for found, known in _index():
        weights = [_weight(word, known) for word in sought]
        met = sum(weight > 0 for weight in weights)
        if met:
            # Among names that meet the same words, the one that says least besides comes first.
            scored.append((-met, -sum(weights), len(found.name), found))
    most = min((entry[0] for entry in scored), default=0)
    return Findings(entry[-1] for entry in sorted(scored)[:_MOST] if entry[0] == most)
