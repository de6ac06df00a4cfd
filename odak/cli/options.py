"""Options of the command line, made from the fields of dataclasses of settings: names, types, units, defaults and help.

A class of settings states its options once: the help of each is its entry under "Attributes" in the docstring of the
class, its default is that of the field, and :func:`option` states the rest.
"""

# Fields are made by functions.
# ruff: noqa: RUF009

import inspect
import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin, get_type_hints

import typer

from odak import _validate
from odak._lengths import parse_length

LENGTH = "LENGTH"
UNITS = (("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9))
_ENTRY = re.compile(r"^(\w+(?:, \w+)*) : .*\n((?: {4}.*\n?|\n)+)", re.MULTILINE)


class InputError(Exception):
    """An argument of the command line is not valid; the message states what is accepted."""


# Raises errors of what a user gave as InputError.
refusing = partial(_validate.refusing, raised=InputError)


@dataclass(frozen=True)
class Option:
    """How a field of settings is given on the command line.

    Attributes
    ----------
    names : tuple of str
        Names, such as ``("--output", "-o")``; of the first one the name of the field is made if it is left out.
    metavar : str, optional
        What stands for the value in the help.
    parse : callable, optional
        Function from the text to the value, which raises ValueError.
    shown : str, optional
        Default in words.
    of : collection of str
        Names among which the value is.
    check : callable, optional
        ``check("--name", value)`` raises ValueError or TypeError for a value that will not do.
    listed : collection of str, or callable
        Names that the help lists, beside which other values are possible; or a function that returns names, which are
        only completed.
    positional : bool
        Whether it is an argument without a name.
    """

    names: tuple[str, ...] = ()
    metavar: str | None = None
    parse: Callable[[Any], Any] | None = None
    shown: str | None = None
    of: Collection[str] = ()
    check: Callable[[str, Any], Any] | None = None
    listed: Collection[str] | Callable[[], Collection[str]] = ()
    positional: bool = False


def option(default: Any, *names: str, **how: Any) -> Any:
    """Return a field that is an option; `how` holds the other parameters of :class:`Option`."""
    return field(default=default, metadata={"option": Option(names, **how)})


def argument(default: Any, metavar: str, **how: Any) -> Any:
    """Return a field that is an argument without a name; ``...`` stands for one that must be given."""
    known = {} if default is ... else {"default": default}
    return field(**known, metadata={"option": Option((), metavar, positional=True, **how)})


def length(default: Any = None, *names: str, shown: str | None = None, **how: Any) -> Any:
    """Return a field that is a positive length, in metres or with a unit."""
    known = {"metavar": LENGTH, "parse": parse_length, "check": positive}
    return option(default, *names, shown=shown or in_units(default), **(known | how))


def in_units(value: float | None) -> str | None:
    """Return a length in metres with the largest unit of which it is one or more, such as ``15cm``."""
    if value is None:
        return None
    unit, factor = next(((u, f) for u, f in UNITS if value >= 0.999 * f), UNITS[-1])
    return f"{value / factor:g}{unit}"


def positive(name: str, value: Any) -> None:
    """Raise ValueError unless a value is a finite number above 0."""
    _validate.real(name, value, positive=True)


def at_least(least: int) -> Callable[[str, Any], Any]:
    """Return a check for integers from the least one."""
    return partial(_validate.integer, minimum=least)


def between(least: int, most: int) -> Callable[[str, Any], Any]:
    """Return a check for integers from the least to the largest one."""
    return partial(_validate.integer, minimum=least, most=most)


def up_to(largest: float) -> Callable[[str, Any], Any]:
    """Return a check for lengths in metres up to the largest one."""

    def check(name: str, value: float) -> None:
        if not 0 < value <= largest:
            raise ValueError(f"{name} must be above 0 and at most {largest:g} metres, with a unit; got {value:g}")

    return check


def option_name(name: str) -> str:
    """Return the option of the command line that the name of a parameter gives."""
    return "--" + name.replace("_", "-")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a command, which are checked when they are made.

    Attributes
    ----------
    given : frozenset of str
        Names of the fields that were given on the command line.
    """

    given: frozenset[str] = field(default=frozenset(), repr=False, compare=False)
    # Whether a command makes the settings itself, of the values and of what else it knows.
    deferred: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Check each field by itself, then what they say together; the messages name options of the command line."""
        with refusing("", TypeError, ValueError):
            for item, how in _options(type(self)):
                self._check_field(item.name, _named(item, how), how)
            self.check()

    def _check_field(self, name: str, named: str, how: Option) -> None:
        value = getattr(self, name)
        if value is None:
            return
        if how.of and isinstance(value, str):
            self._set(name, _validate.one_of(named, value, tuple(how.of)))
        for one in value if isinstance(value, tuple) else (value,):
            if how.check is not None:
                how.check(named, one)

    def check(self) -> None:
        """Raise ValueError, TypeError or InputError unless the settings go together."""

    def _set(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)

    def values(self, *without: str) -> dict[str, Any]:
        """Return the settings by name, but for some, and but for what has no effect on the result."""
        left_out = {"given", "output", "quiet", "again", *without}
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name not in left_out}


@dataclass(frozen=True, kw_only=True)
class RunSettings(Settings):
    """Settings of a command that writes a folder of results.

    Attributes
    ----------
    output : Path
        Folder to write to; created if it does not exist.
    quiet : bool
        Show no progress and no summary; warnings and errors still go to stderr.
    again : bool
        Compute results that exist already again, and replace others without asking.
    """

    output: Path = option(Path("output"), "-o")
    quiet: bool = option(False, "-q")
    again: bool = option(False)


@dataclass(frozen=True, kw_only=True)
class DeviceSettings(RunSettings):
    """Settings of a command that computes on a device.

    Attributes
    ----------
    device : str
        auto (the GPU if there is one), cpu, cuda, cuda:1, ...
    """

    device: str = option("auto")


def _options(kind: type) -> Iterator[tuple[Field, Option]]:
    """Yield the fields of a class that are options: arguments first, those of its own before those of every run."""
    found = [(item, item.metadata["option"]) for item in fields(kind) if "option" in item.metadata]
    last = {"output": -1, "device": 1, "quiet": 2, "again": 3}
    yield from sorted(found, key=lambda pair: (not pair[1].positional, last.get(pair[0].name, 0)))


def _named(item: Field, how: Option) -> str:
    """Return the name of an option in messages."""
    if how.positional:
        return str(how.metavar).strip("[].")
    return how.names[0] if how.names and how.names[0].startswith("--") else option_name(item.name)


def parameters_of(kind: type) -> list[inspect.Parameter]:
    """Return the parameters that typer makes the options of a class of settings from."""
    hints, told = get_type_hints(kind), _help_of(kind)
    found = []
    for item, how in _options(kind):
        default = inspect.Parameter.empty if item.default is MISSING else item.default or _nothing(item.default)
        kind_of: Any = Annotated[_type_of(hints[item.name], how), _typer_option(item, how, told[item.name])]  # type: ignore[valid-type]
        found.append(inspect.Parameter(item.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind_of))
    return found


def _nothing(default: Any) -> Any:
    """Return a default that is false as typer takes it: no values are None, which the command line leaves out."""
    return None if default == () else default


def _type_of(hint: Any, how: Option) -> Any:
    """Return the type of a field as typer takes it."""
    if get_origin(hint) is tuple and get_args(hint)[-1] is ...:
        return list[get_args(hint)[0]] | None  # type: ignore[misc, valid-type]
    # A parser returns what it likes; unions of several types would be refused.
    mixed = get_origin(hint) in (Union, UnionType) and len([one for one in get_args(hint) if one is not type(None)]) > 1
    return Any if mixed else hint


def _typer_option(item: Field, how: Option, told: str) -> Any:
    shown, named = how.shown, list(how.names)
    known: dict[str, Any] = {
        "metavar": how.metavar or ("|".join(how.of) if how.of else None),
        "parser": how.parse and _usage_errors(how.parse),
        **({} if shown is None else {"show_default": shown}),
    }
    if how.listed and not callable(how.listed):
        told = f"{told} Names: {', '.join(sorted(how.listed))}."
    if how.positional:
        return typer.Argument(help=told, **known)
    if (named and not named[0].startswith("--")) or (item.default is False and not named):
        named = [option_name(item.name), *named]
    return typer.Option(*named, help=told, autocompletion=_completing(how.of or how.listed), **known)


def _usage_errors(parse: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a parser whose errors typer reports as usage errors."""

    def parsed(text: Any) -> Any:
        with _validate.refusing("", ValueError, raised=typer.BadParameter):
            return parse(text) if isinstance(text, str) else text

    return parsed


def _completing(names: Collection[str] | Callable[[], Collection[str]]) -> Callable[[str], list[str]] | None:
    """Return a function that completes one of some names."""

    def completed(incomplete: str) -> list[str]:
        known = names() if callable(names) else names
        return [name for name in known if name.casefold().startswith(incomplete.casefold())]

    return completed if names else None


def _help_of(kind: type) -> dict[str, str]:
    """Return the help of each field: its entry in the docstring of its class, or of one that this is derived from."""
    told: dict[str, str] = {}
    for one in reversed(kind.__mro__):
        for names, text in _ENTRY.findall(inspect.cleandoc(one.__doc__ or "") + "\n"):
            told |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return told
