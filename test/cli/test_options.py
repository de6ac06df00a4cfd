"""Options that are made from the fields of dataclasses."""

import inspect
from dataclasses import dataclass, fields
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from odak.cli import options, settings
from odak.cli.job import Job
from odak.cli.options import InputError, RunSettings, argument, at_least, between, length, option

KINDS = [
    Job,
    *(kind for _, kind in inspect.getmembers(settings, inspect.isclass) if kind.__module__ == settings.__name__),
]


@dataclass(frozen=True, kw_only=True)
class Kettle(RunSettings):
    """Settings of a kettle.

    Attributes
    ----------
    leaves : tuple of str
        Leaves
        to brew.
    depth, width : float
        A side.
    sort : str
        Kind of water.
    fill : int
        Cups.
    lid : bool
        Close it.
    loud : bool
        Whistle.
    """

    leaves: tuple[str, ...] = argument(("green",), "[LEAF]...", shown="green")
    depth: float = length(0.15, "-d")
    width: float | None = length()
    sort: str = option("soft", of=("soft", "hard"))
    fill: int = option(1, "--cups", metavar="COUNT", check=between(1, 4))
    lid: bool = option(True)
    loud: bool = option(False)


def asked(*words, kind=Kettle):
    """Return the settings that typer makes of a command line, and the exit code."""
    found = []

    def run(**values):
        found.append({n: tuple(v) if isinstance(v, list) else v for n, v in values.items() if v is not None})

    run.__signature__ = inspect.Signature(options.parameters_of(kind))
    app = typer.Typer(rich_markup_mode=None)
    app.command()(run)
    result = CliRunner().invoke(app, list(map(str, words)))
    return found[0] if found else result.output


def test_fields_are_options_with_types_units_and_names():
    made = asked(
        "black", "oolong", "-d", "20cm", "--width", "3mm", "--cups", "3", "--no-lid", "--loud", "-q", "-o", "x"
    )
    assert made["leaves"] == ("black", "oolong") and made["depth"] == 0.2 and made["width"] == pytest.approx(3e-3)
    assert (made["fill"], made["lid"], made["loud"], made["quiet"], made["output"]) == (3, False, True, True, Path("x"))
    assert Kettle(**asked()) == Kettle()


def test_help_is_the_docstring_with_units_and_choices():
    text = " ".join(asked("--help").split())
    for part in ("Leaves to brew.", "[default: (15cm)]", "soft|hard", "--width LENGTH A side.", "--lid / --no-lid"):
        assert part in text
    # Of a flag that is off there is no negation, and what every run takes comes last.
    assert "--no-loud" not in text and text.index("Whistle") < text.index("Show no progress")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"depth": -1.0}, "--depth must be positive"),
        ({"sort": "salt"}, "--sort must be one of 'soft', 'hard'; got 'salt'"),
        ({"fill": 5}, "--cups must be from 1 to 4, got 5"),
    ],
)
def test_errors_name_the_option(values, message):
    with pytest.raises(InputError, match=message):
        Kettle(**values)
    assert Kettle(sort="HARD").sort == "hard"


def test_a_text_that_is_no_length_is_told():
    assert "'deep' is not a length" in asked("--depth", "deep")


@pytest.mark.parametrize(
    ("value", "text"), [(0.15, "15cm"), (8e-6, "8um"), (532e-9, "532nm"), (4e-3, "4mm"), (2.0, "2m"), (1e-2, "1cm")]
)
def test_lengths_are_written_with_units(value, text):
    assert options.in_units(value) == text and options.parse_length(text) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_option_of_every_command_has_help_and_a_default_that_holds(kind):
    told = options._help_of(kind)
    names = {item.name for item in fields(kind) if "option" in item.metadata}
    assert names and all(len(told[name]) > 4 for name in names)
    required = [p.name for p in options.parameters_of(kind) if p.default is inspect.Parameter.empty]
    words = ["1" for _ in required] + (["--schema"] if kind is settings.SimulateSettings else [])
    if kind is settings.DesignSettings:
        words = ["singlet"]
    if kind is settings.InstrumentsSettings:
        words = ["test", "1"]
    made = asked(*words, kind=kind)
    direct = {name: made[name] for name in (*required, *(["schema"] if "--schema" in words else []))}
    if kind is settings.DesignSettings:
        direct["system"] = "singlet"
    if kind is settings.InstrumentsSettings:
        direct["action"] = "test"
    assert kind(**made) == kind(**direct)


def test_counts_have_a_least_value():
    with pytest.raises(ValueError, match="--count must be at least 2, got 1"):
        at_least(2)("--count", 1)


def test_lengths_have_a_largest_value():
    for value in (0.4, 0.5):
        options.up_to(0.5)("--depth", value)
    for value in (0, -1, 0.6):
        with pytest.raises(
            ValueError, match=f"--depth must be above 0 and at most 0.5 metres, with a unit; got {value}"
        ):
            options.up_to(0.5)("--depth", value)


def test_names_are_completed_whatever_their_case():
    for names in (("Soft", "hard", "SOdium"), lambda: ["Soft", "hard", "SOdium"]):
        assert options._completing(names)("so") == ["Soft", "SOdium"]
    assert options._completing(()) is None


def test_fields_keep_what_they_are_told():
    assert Kettle.__dataclass_fields__["width"].default is None and not Kettle().quiet and not Kettle().again
    how = {item.name: item.metadata["option"] for item in fields(Kettle) if "option" in item.metadata}
    assert how["leaves"].positional and not how["depth"].positional and how["depth"].names == ("-d",)
    assert (how["depth"].shown, how["width"].shown) == ("15cm", None)
    told = length(0.15, shown="a hand", metavar="SIDE", check=options.up_to(0.2)).metadata["option"]
    assert (told.shown, told.metavar) == ("a hand", "SIDE")
    with pytest.raises(ValueError, match=r"at most 0\.2 metres"):
        told.check("--side", 0.3)


def test_options_of_every_run_come_last():
    found = [parameter.name for parameter in options.parameters_of(options.DeviceSettings)]
    assert found == ["output", "device", "quiet", "again"]
    with pytest.raises(TypeError, match="positional"):
        options.DeviceSettings(Path("x"))
    found = {p.name: p.default for p in options.parameters_of(Kettle)}
    assert list(found) == ["leaves", "output", "depth", "width", "sort", "fill", "lid", "loud", "quiet", "again"]
    assert options._nothing(()) is None and options._nothing(0) == 0 and options._nothing(False) is False
