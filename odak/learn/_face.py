"""PyTorch functions made of functions of the NumPy core: conversions, signature and documentation."""

import inspect
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
import torch
from array_api_compat import torch as torch_namespace

from odak._array import Array, ArrayT
from odak._call_forms import unknown_argument
from odak.learn._tensors import checked_device, tensors_of

_TITLES = ("Parameters", "Returns", "Yields", "Raises", "Warns", "See Also", "Notes", "References", "Examples")
_TYPED = ("Returns", "Yields", "Raises", "Warns")
_SECTION = re.compile(rf"\n\n({'|'.join(_TITLES)})\n-{{3,}}\n")
_TYPES = {"device": torch.device | str | None, "dtype": torch.dtype | None}
_ENTRIES = {
    "device": "torch.device or str, optional\n"
    "Device of the result; by default the device of the tensors given, else torch's default.",
    "dtype": "torch.dtype, optional",
}
_IN_TYPES = (
    (r"numpy\.float64 or (numpy\.ndarray|array)", "torch.Tensor"),
    (r"\b(numpy\.ndarray|array)\b", "torch.Tensor"),
)
_IN_TEXT = (
    (r"\bnumpy\.ndarray\b", "torch.Tensor"),
    (r"\b([Aa])n array\b", r"\1 tensor"),
    (r"(?<!NumPy )\barray(s?)\b", r"tensor\1"),
)
_IN_CODE = (
    (r"\bimport numpy as np\b", "import torch"),
    (r"\bnp\.(array|asarray)\b", "torch.tensor"),
    (r"\bnp\.", "torch."),
    (r"\bodak\.(?=(wave|jones|raytracing|tools)\b)", "odak.learn."),
)


def torch_face(
    core: Callable[..., Any],
    *,
    tensors: Iterable[str] = (),
    defaults: Mapping[str, Any] | None = None,
    through: Callable[..., Any] | None = None,
    describe: Mapping[str, str] | str | None = None,
    name: str | None = None,
) -> Callable[..., Any]:
    """Return the PyTorch function of a function of the core.

    It calls the core's function with torch as the array library (where the core has an argument `xp`, which it hides)
    and with the device checked (where there is an argument `device`). It belongs to the module that calls this
    function. Its signature and docstring are taken from the core, in terms of tensors.

    Parameters
    ----------
    core : callable
        Function of the core, written for any array library.
    tensors : iterable of str
        Arguments whose numbers, lists and NumPy arrays become tensors before the call: on the device of the first
        tensor among them and in the widest precision of the floating tensors among them, else torch's default;
        None stays None.
        Leave out what the core takes as numbers with all their digits, such as a pixel pitch.
    defaults : mapping, optional
        Defaults that differ from the core's, by argument.
    through : callable, optional
        Called as ``through(core, **arguments)`` instead of the core, to change what goes in or comes out.
    describe : mapping or str, optional
        Texts that replace the core's: a docstring of the sections that differ, under Parameters those that do;
        or a mapping: by argument its type and, from the second line on, its description; by title ("Returns", "Notes",
        "Examples") a section, left out where the text is empty; by "" the summary. Examples that are not replaced are
        taken from the core with its imports and ``np.`` replaced, so that the core's examples use only what NumPy and
        torch have in common.
    name : str, optional
        The function's name, where it differs from the core's.

    Returns
    -------
    callable
        The function; a type checker takes its signature from ``odak/learn/_faces``.
    """
    signature = _signature(core, defaults or {})
    named, keywords = tuple(signature.parameters), frozenset(signature.parameters)
    positional = [name for name, p in signature.parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    preset = dict(defaults or {})
    fixed = {"xp": torch_namespace} if "xp" in inspect.signature(core).parameters else {}
    converted = tuple(tensors)
    # What becomes a tensor here, or does not reach the core's own door, has its unit taken off first.
    units = {
        name: take_off
        for name, take_off in getattr(core, "__units__", {}).items()
        if name in converted or through is not None
    }

    # Where nothing but defaults is to be changed, a call passes through.
    plain = not (fixed or converted or units or through or "device" in keywords)
    places = [(n, positional.index(n) if n in positional else len(named), value) for n, value in preset.items()]

    def face(*args, **options):
        if plain and len(args) <= len(positional) and keywords.issuperset(options):
            for name, place, value in places:
                if place >= len(args):
                    options.setdefault(name, value)
            return core(*args, **options)
        given = {**dict(zip(positional, args, strict=False)), **options}
        if len(given) != len(args) + len(options) or not keywords.issuperset(options):
            unknown = [name for name in options if name not in named]
            if unknown:
                raise unknown_argument(face, unknown[0], named)
            signature.bind(*args, **options)  # raises the error that Python gives for such a call
        options = {**fixed, **preset, **given}
        for name, take_off in units.items():
            if name in options:
                options[name] = take_off(name, options[name])
        if converted:
            given = {name: options[name] for name in converted if options.get(name) is not None}
            options.update(zip(given, tensors_of(**given), strict=True))
        if "device" in options:
            options["device"] = checked_device("device", options["device"])
        return core(**options) if through is None else through(core, **options)

    made: Any = face
    made.__name__ = made.__qualname__ = name or core.__name__
    made.__module__ = sys._getframe(1).f_globals["__name__"]
    made.__signature__ = signature
    made.__wrapped__ = core  # so that the source is found
    made.__is_face__ = True
    made.__units__ = getattr(core, "__units__", {})
    made.__annotations__ = {name: p.annotation for name, p in signature.parameters.items()}
    made.__annotations__["return"] = signature.return_annotation
    texts = _sections(describe) if isinstance(describe, str) else describe or {}
    made.__doc__ = _documentation(core, named, preset, texts)
    return face


def face_of(core: Callable[..., Any], **options: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator for the PyTorch function of a function of the core.

    The function below it is `through` of :func:`torch_face`, its docstring `describe`, its name the name.
    """

    def made(through: Callable[..., Any]) -> Callable[..., Any]:
        described = through.__doc__ or ""
        face = torch_face(core, through=through, describe=described, name=through.__name__, **options)
        face.__module__ = through.__module__
        return face

    return made


def _sections(text: str) -> dict[str, str]:
    """Return the sections of a docstring by title, and the entries of its parameters by name."""
    summary, *parts = _SECTION.split("\n\n" + inspect.cleandoc(text))
    sections = dict(zip(parts[::2], parts[1::2], strict=True))
    for entry in re.split(r"\n(?=\S)", sections.pop("Parameters", "").strip("\n")):
        name, _, words = entry.partition(" : ")
        if name:
            sections[name] = words
    return sections | ({"": summary.strip()} if summary.strip() else {})


def _signature(core, defaults) -> inspect.Signature:
    signature = inspect.signature(core)
    hints = typing.get_type_hints(core)
    unknown = set(defaults) - set(signature.parameters)
    if unknown:
        raise ValueError(f"defaults names no argument of {core.__name__}: {', '.join(sorted(unknown))}")
    parameters = [
        p.replace(
            annotation=_TYPES.get(name, _torch_type(hints.get(name, p.annotation), Any)),
            default=defaults.get(name, p.default),
        )
        for name, p in signature.parameters.items()
        if name != "xp"
    ]
    returned = hints.get("return", signature.return_annotation)
    return signature.replace(parameters=parameters, return_annotation=_torch_type(returned))


def _torch_type(annotation, entry: Any = torch.Tensor):
    """Return a type in which arrays have become tensors, and so has Any, inside a sequence or mapping `entry`."""
    if annotation is Array or annotation is ArrayT or annotation is np.ndarray or annotation is Any:
        return torch.Tensor
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is np.ndarray:
        return torch.Tensor
    if not inner or origin is typing.Literal:
        return annotation
    changed = tuple(
        entry if part is Any else _torch_type(part, entry) if part is not Ellipsis else part for part in inner
    )
    if origin in (typing.Union, types.UnionType):
        kept = [t for t in changed if not (isinstance(t, type) and issubclass(t, np.generic))]
        return typing.Union[tuple(kept)]
    generic: Any = origin
    return generic[changed] if isinstance(origin, type) and origin is not Callable else annotation


def _documentation(core, named, defaults, describe) -> str:
    """Return the docstring of the core in terms of tensors."""
    summary, *parts = _SECTION.split(inspect.cleandoc(core.__doc__ or ""))
    sections = dict(zip(parts[::2], parts[1::2], strict=True))
    texts = {t: _in_torch(text) if t in _TYPED else _replaced(text, _IN_TEXT) for t, text in sections.items()}
    if "Parameters" in sections:
        texts["Parameters"] = _parameters(sections["Parameters"], named, defaults, describe)
    if "Examples" in sections:
        texts["Examples"] = _replaced(sections["Examples"], _IN_CODE)
    package = core.__module__.rpartition(".")[0]
    texts["See Also"] = f"{package}.{core.__name__} : The same function of the arrays of any library."
    texts.update({title: text.strip() for title, text in describe.items() if title in _TITLES})
    summary = describe.get("", _replaced(summary, _IN_TEXT))
    written = [f"{title}\n{'-' * len(title)}\n{texts[title].rstrip()}" for title in _TITLES if texts.get(title)]
    return "\n\n".join([summary, *written]) + "\n"


def _parameters(text, named, defaults, describe) -> str:
    entries = []
    for entry in re.split(r"\n(?=\S)", text.strip("\n")):
        heading, _, body = entry.partition("\n")
        names, _, kind = heading.partition(" : ")
        kept = [name for name in names.split(", ") if name.lstrip("*") in named and name not in describe]
        if not kept:
            continue
        replaced = _ENTRIES.get(kept[0], "").split("\n") if len(kept) == 1 else [""]
        kind = replaced[0] or _replaced(kind, _IN_TYPES)
        body = "    " + replaced[1] if len(replaced) > 1 else _replaced(body, _IN_TEXT)
        if kept[0] in defaults:
            kind = f"{kind.removesuffix(', optional')}, default: {defaults[kept[0]]}"
        entries.append((named.index(kept[0].lstrip("*")), f"{', '.join(kept)} : {kind}\n{body}"))
    for name, words in describe.items():
        if name in named:
            kind, _, body = words.partition("\n")
            lines = "\n".join(f"    {line}" for line in inspect.cleandoc(body).split("\n"))
            entries.append((named.index(name), f"{name} : {kind}\n{lines}"))
    return "\n".join(entry for _, entry in sorted(entries, key=lambda pair: pair[0]))


def _replaced(text: str, words) -> str:
    for pattern, replacement in words:
        text = re.sub(pattern, replacement, text)
    return text


def _in_torch(text: str) -> str:
    """Return a section whose lines at the margin are types or names."""
    return "\n".join(_replaced(line, _IN_TEXT if line.startswith(" ") else _IN_TYPES) for line in text.split("\n"))
