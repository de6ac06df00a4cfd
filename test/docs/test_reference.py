"""The API reference lists each public name once, and tables of parameters agree with signatures."""

import dataclasses
import doctest
import importlib
import inspect
import pkgutil
import re

import pytest

pytest.importorskip("griffe", reason="what builds the site is not installed: pip install -r docs/requirements.txt")

import griffe
from documentation import script

import odak
from odak import _find

reference = script("reference")
REFERS = re.compile(r"(?:As|Those|That) (?:in|of|for) ")


def public_packages():
    """Return the packages that export names, found by walking the installed package."""
    found = {"odak"}
    for module in pkgutil.walk_packages(odak.__path__, "odak."):
        if module.ispkg and "._" not in module.name:
            content = importlib.import_module(module.name)
            if any(not inspect.ismodule(getattr(content, name)) for name in getattr(content, "__all__", ())):
                found.add(module.name)
    return found


def test_every_public_name_has_exactly_one_entry():
    listed, packages = reference.entries(), public_packages() | set(reference.packages())
    public = {f"{package}.{name}" for package in packages for name in reference.public_names(package)}
    assert public - set(listed) == set(), "list the package in docs/reference"
    assert set(listed) - public == set(), "take the names out of docs/reference"


def test_anchors_of_earlier_releases_lead_to_public_names():
    lost = {path for _, _, path in reference.former_anchors()} - set(reference.entries())
    assert not lost


def rows(value):
    """Return the documented parameters of a function or class: name, type and description."""
    text = inspect.getdoc(value) or ""
    if inspect.isclass(value):
        text = "\n\n".join(filter(None, (value.__doc__ and inspect.cleandoc(value.__doc__), _own_init_doc(value))))
    sections = griffe.parse_numpy(griffe.Docstring(text), warnings=False)
    kinds = {griffe.DocstringSectionKind.parameters, griffe.DocstringSectionKind.other_parameters}
    if dataclasses.is_dataclass(value):
        kinds.add(griffe.DocstringSectionKind.attributes)
    found = [row for section in sections if section.kind in kinds for row in section.value]
    return [(row.name.lstrip("*"), str(row.annotation or ""), row.description) for row in found]


def _own_init_doc(value):
    text = value.__init__.__doc__ if "__init__" in vars(value) else None
    return inspect.cleandoc(text) if text else ""


def complaint(value):
    """Return what is wrong with the table of parameters of a function or class, or the empty string."""
    try:
        signature = inspect.signature(value)
    except ValueError:
        return ""
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    expected = [item.name for item in signature.parameters.values() if item.name not in ("self", "cls")]
    variable = {item.name for item in signature.parameters.values() if item.kind in kinds}
    table = rows(value)
    names = [name for name, _, _ in table]
    if set(expected) - variable - set(names):
        return f"no row for {sorted(set(expected) - variable - set(names))}"
    if set(names) - set(expected) and not variable:
        return f"rows for {sorted(set(names) - set(expected))}, which it does not take"
    for name, annotation, description in table:
        if not annotation and name not in variable:
            return f"{name} has no type"
        if REFERS.match(description) or not description:
            return f"{name} is not described: {description!r}"
    grouped = re.findall(r"^\w+(?:, \w+)+ : ", inspect.getdoc(value) or "", re.MULTILINE)
    return f"grouped rows: {grouped}" if grouped else ""


def test_tables_of_parameters_agree_with_signatures():
    wrong = {}
    for path in reference.entries():
        package, _, name = path.rpartition(".")
        value = getattr(importlib.import_module(package), name)
        if callable(value) and not (inspect.isclass(value) and issubclass(value, (BaseException, int, tuple))):
            wrong[path] = complaint(value)
    assert len(wrong) > 600
    assert not any(wrong.values()), "\n".join(f"{path}: {text}" for path, text in wrong.items() if text)


# Public names without a value to print, and the reason.
WITHOUT_OUTPUT = {
    "odak.cli.app": "an object of typer",
    "odak.instruments.ScreenModulator": "needs a second screen",
    "odak.instruments.GenICamCamera": "needs a camera",
    "odak.instruments.HoloeyeModulator": "needs a modulator",
    "odak.instruments.MeadowlarkModulator": "needs a modulator",
    "odak.instruments.MicroManagerCamera": "needs a camera",
    "odak.instruments.MicroManagerModulator": "needs a modulator",
    "odak.instruments.RaspberryPiCamera": "needs a camera",
    "odak.instruments.ThorlabsCamera": "needs a camera",
    "odak.instruments.VideoCamera": "needs a camera",
    "odak.visualize.plotly.close_browser": "returns nothing",
}
# Their examples need a package that is not among the requirements, and are skipped.
OPTIONAL = {
    "odak.tools.to_xarray",
    *(
        f"odak.learn.perception.{name}"
        for name in ("CVVDP", "FVVDP", "LPIPS", "ImageQuality", "castle_contrast_sensitivity")
    ),
}


def printed_examples(value):
    """Return the examples of a docstring that print something and run as doctests, and those that are skipped."""
    _, _, section = (inspect.getdoc(value) or "").partition("\nExamples\n--------\n")
    printing = [example for example in doctest.DocTestParser().get_examples(section) if example.want]
    skipped = [example for example in printing if example.options.get(doctest.SKIP)]
    return [example for example in printing if example not in skipped], skipped


def test_every_public_function_has_an_example_that_prints():
    without = set()
    for path in reference.entries():
        package, _, name = path.rpartition(".")
        value = getattr(importlib.import_module(package), name)
        if callable(value):
            run, skipped = printed_examples(value)
            if not run and not (skipped and path in OPTIONAL):
                without.add(path)
    assert without == set(WITHOUT_OUTPUT)


def test_methods_name_their_parameters():
    """A parameter of a public method has an entry of its own, or a sentence names it; no entry sends elsewhere."""
    unnamed, sent = set(), set()
    for path in reference.entries():
        package, _, name = path.rpartition(".")
        value = getattr(importlib.import_module(package), name)
        for method in vars(value) if inspect.isclass(value) and value.__module__.startswith("odak.") else ():
            function = inspect.unwrap(getattr(value, method))
            function = getattr(function, "__func__", function)
            if method.startswith("_") or not inspect.isfunction(function):
                continue
            text = inspect.getdoc(getattr(value, method)) or ""
            parameters = set(inspect.signature(function).parameters) - {"self", "cls"}
            unnamed |= {f"{path}.{method}: {item}" for item in parameters if not re.search(rf"\b{item}\b", text)}
            sent |= {f"{path}.{method}: {name}" for name, _, told in rows(getattr(value, method)) if REFERS.match(told)}
    assert unnamed == set() and sent == set()


def test_commands_keep_angle_brackets_and_their_defaults():
    page = reference._commands_of({"app": "odak.cli.app"})
    assert "Writes hologram_&lt;nm&gt;nm.png" in page and "<nm>" not in page
    assert "| `--pixel-pitch` | 8um | Pixel pitch of the modulator" in page


def test_complaints():
    def good(a, b=1):
        """Add.

        Parameters
        ----------
        a : float
            First summand.
        b : float
            Second summand.
        """

    def grouped(a, b=1):
        """Add.

        Parameters
        ----------
        a, b : float
            Summands.
        """

    def refers(a):
        """Do it.

        Parameters
        ----------
        a : float
            As in :func:`good`.
        """

    def lacks(a, b):
        """Do it.

        Parameters
        ----------
        a : float
            First.
        """

    assert complaint(good) == ""
    assert "grouped" in complaint(grouped)
    assert "not described" in complaint(refers)
    assert complaint(lacks) == "no row for ['b']"


def test_every_name_that_is_found_has_an_entry_and_a_line_in_the_index_of_the_reference():
    known, places = set(reference.entries()), set(re.findall(r'<a id="([^"]*)"></a>', reference._index_of(None)))
    for found, _ in _find._index():
        assert {found.name, *found.also} <= known
        assert found.page == f"reference/overview/#{found.name.rpartition('.')[2]}"
        assert found.page.rpartition("#")[2] in places
        assert ":`" not in found.line
    names = {path for found, _ in _find._index() for path in (found.name, *found.also)}
    functions = {path for path in reference.entries() if path.startswith("odak.learn.raytracing.system.")}
    assert functions <= names


def test_roles_become_links():
    links = reference._Links()
    package = griffe.Module("odak")
    function = griffe.Function("f", parent=package)
    assert links.of("odak.wave.propagate_beam", function) == "[`odak.wave.propagate_beam`][odak.wave.propagate_beam]"
    assert links.of("~odak.learn.wave.propagate_beam", function).startswith("[`propagate_beam`][odak.learn.wave.")
    assert links.of("torch.save", function) == "`torch.save`"
