"""Decorators of public functions: lengths with units, words for one thing, fields of dataclasses as arguments."""

import difflib
import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields, replace
from typing import Any, ParamSpec, TypeVar

from odak._lengths import in_degrees, in_metres, lengths_together

F = TypeVar("F", bound=Callable)
P = ParamSpec("P")
R = TypeVar("R")


def takes_units(*lengths: str, degrees: Sequence[str] = ()) -> Callable[[F], F]:
    """Return a decorator by which named arguments are lengths in metres, or angles in degrees.

    Lengths may be numbers, texts such as "15cm" and "532nm", quantities with a method ``to(unit)`` as in pint and
    astropy, or lists of these; the function gets numbers. A wavelength, a pixel pitch and a distance that cannot belong
    together are refused, with what was probably meant. Keywords that the function does not have are named, with the
    nearest one. Tensors are left alone: a GPU is never waited for.

    Parameters
    ----------
    *lengths : str
        Names of arguments in metres; the wavelength, the pitch and the distance are recognised by their names.
    degrees : sequence of str
        Names of arguments in degrees.

    Returns
    -------
    callable
        Decorator of a function, of a method, or of a class by its constructor.
    """

    def decorated(function):
        if isinstance(function, type):
            function.__init__ = decorated(function.__init__)
            return function
        parameters = inspect.signature(function).parameters
        own, kinds = list(parameters), [parameter.kind for parameter in parameters.values()]
        keywords = None if inspect.Parameter.VAR_KEYWORD in kinds else frozenset(own)
        places = [(name, own.index(name), in_metres) for name in lengths]
        places += [(name, own.index(name), in_degrees) for name in degrees]
        told = tuple(next((n for n in lengths if n in names), "") for names in _ROLES)
        compared = bool(told[0])
        (wave, pitch, distance), usual = told, {name: parameters[name].default if name else None for name in told}

        @functools.wraps(function)
        def run(*args, **options):
            if keywords is not None and not keywords.issuperset(options):
                options = _by_known_names(function, own, options)
            found = usual.copy()
            for name, place, converted_by in places:
                if name in options:
                    made = value = options[name]
                    if type(value) is not float or converted_by is in_degrees:
                        made = options[name] = converted_by(name, value)
                elif place < len(args):
                    made = converted_by(name, args[place])
                    if made is not args[place]:
                        args = (*args[:place], made, *args[place + 1 :])
                else:
                    continue
                found[name] = made
            if compared:
                lengths_together(found[wave], found[pitch], found[distance], names=told)
            return function(*args, **options)

        run.__units__ = {name: converted_by for name, _, converted_by in places}
        return run

    return decorated


# Names of the wavelength, of the pitch and of the distance, which are compared.
_ROLES = (("wavelength", "wavelengths"), ("dx", "pixel_pitch", "pitch", "slm_pixel_pitch"), ("distance", "distances"))


# Words for one thing: a function takes each of them for the one that it has itself.
_WORDS = (
    ("iterations", "n_iteration", "n_iterations", "number_of_iterations"),
    ("pitch", "pixel_pitch", "slm_pixel_pitch", "dx"),
    ("focal_length", "focal"),
    ("center", "centre"),
    ("color", "colour"),
)
# Words of other programs for what an argument holds: the argument, the words, and what to give if not the argument.
_ITERATIONS = (*_WORDS[0], "epochs", "steps", "n_steps", "max_iterations", "max_iter", "n_iter")
_WAVES = ("lam", "lamda", "lambda_", "wl", "wvl", "wavelength", "wavelengths")
_FAR = ("z", "r", "d", "propagation_distance", "distance")
_ELSEWHERE = (
    ("run", _ITERATIONS, "run=Run(iterations=...)"),
    ("run", ("progress", "callback", "checkpoint", "checkpoint_every", "seed", "memory_budget"), "run=Run({}=...)"),
    ("run", ("verbose", "quiet"), "run=Run(progress=...)"),
    ("solver", ("learning_rate", "lr"), "solver=Descent('adam', learning_rate=...)"),
    ("solver", ("method", "algorithm", "optimizer", "optimiser"), "solver, such as solver='adam'"),
    ("start", ("init", "initial_phase", "phase_init", "phase"), ""),
    ("n_iteration", _ITERATIONS, ""),
    ("n_iterations", _ITERATIONS, ""),
    ("powers", (*_WORDS[1], "slm", "resolution", "bits", "fill"), "modulator=Modulator(resolution, pitch, ...)"),
    ("display", ("device",), "a display on that device, display.to(device)"),
    ("powers", ("device",), "the device afterwards, display.to(device)"),
    ("propagation_type", ("method", "propagator", "kernel_type"), ""),
    ("material", ("glass", "n", "index", "medium"), ""),
    ("radius", ("r", "R", "roc"), ""),
    ("thickness", ("t", *_FAR), ""),
    ("surfaces", ("glass", "n", "r", "R", "radii", "radius", "t"), "it to surface(radius, thickness=...)"),
    ("aperture_type", ("epd", "EPD", "entrance_pupil_diameter"), "aperture=SystemAperture(..., 'EPD')"),
    ("aperture_type", ("f_number", "fno"), "aperture=SystemAperture(..., 'F-number')"),
    ("object_distance", ("z", "d", "distance"), ""),
    ("distance", _FAR, ""),
    ("distances", _FAR, ""),
    ("wavelength", _WAVES, ""),
    ("wavelengths", _WAVES, ""),
    ("focal_length", ("f", "efl"), ""),
    ("display", (*_FAR, *_WAVES, *_WORDS[1]), "it to the display, Display(modulator, wavelengths, distances)"),
    ("", ("device",), "tensors on that device: results are on the device of what is given"),
)


def _known_name(word: str, own: list[str]) -> str:
    """Return the parameter that a word stands for, or the word where that is not one."""
    same = [name for words in _WORDS if word in words for name in words if name in own]
    return word if word in own or len(same) != 1 else same[0]


def unknown_argument(function: Callable[..., Any], word: str, own: Iterable[str]) -> TypeError:
    """Return the error of a keyword that a function does not have, with what to give in its place."""
    callee, own = function.__qualname__.removesuffix(".__init__"), list(own)
    places = [entry for entry in _ELSEWHERE if word in entry[1] and (entry[0] in own or not entry[0])]
    name, _, place = places[0] if places else ("", (), "")
    named = f" Did you mean {name!r}?" if name else did_you_mean(word, own)
    hint = f" Give {place.format(word)}." if place else named
    return TypeError(f"{callee} has no argument {word!r}.{hint}")


def _by_known_names(function, own: list[str], options) -> dict[str, Any]:
    """Return keyword arguments by the names of a function's parameters."""
    found = {}
    for word, value in options.items():
        name = _known_name(word, own)
        if name not in own:
            raise unknown_argument(function, word, own)
        if name in found or (name != word and name in options):
            raise TypeError(f"{name} and {word} are one argument; give one of them")
        found[name] = value
    return found


def takes_fields(older: str, **kinds: type[Any]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Return a decorator by which fields of dataclasses may be arguments of their own, which is the older form.

    Fields that are given beside an object of the class replace those of the object. Where None is the default of an
    argument, the function gets the object of no arguments in its place.

    Parameters
    ----------
    older : str
        Names of the positional arguments of the older form.
    **kinds : type
        Dataclasses by the names of the arguments that are objects of them.
    """

    def decorated(function):
        parameters = inspect.signature(function).parameters
        newer = [name for name, parameter in parameters.items() if parameter.kind is not inspect.Parameter.KEYWORD_ONLY]
        known = [*dict.fromkeys((*parameters, *(field.name for kind in kinds.values() for field in fields(kind))))]

        @functools.wraps(function)
        def form(*args, **options):
            names = newer if any(isinstance(arg, tuple(kinds.values())) for arg in args) else older.split()
            if len(args) > len(names):
                raise TypeError(f"{function.__name__} takes at most {len(names)} positional arguments, got {len(args)}")
            placed = dict(zip(names, args, strict=False))
            if twice := placed.keys() & options.keys():
                raise TypeError(f"{function.__name__} got {', '.join(sorted(twice))} twice")
            options = _by_known_names(function, known, options) | placed
            for name, kind in kinds.items():
                optional = parameters[name].default is None
                if optional and options.get(name, name) is None:
                    del options[name]
                own = [field.name for field in fields(kind) if field.name in options]
                numbers = {key: options.pop(key) for key in own if not isinstance(options[key], kind)}
                given = options.get(name)
                if given is None and (numbers or optional):
                    options[name] = kind(**numbers)
                elif name in options and not isinstance(given, kind):
                    raise TypeError(f"{name} must be {kind.__name__}, got {given!r:.80}")
                elif numbers:
                    options[name] = replace(given, **numbers)
            return function(**options)

        return form

    return decorated


def did_you_mean(value: str, names: Iterable[str]) -> str:
    """Return a question with the name nearest to a misspelt one, empty if none is near."""
    names, value = list(names), value.casefold()
    near = difflib.get_close_matches(value, names, n=1, cutoff=0.6)
    near = near or [name for name in names if len(value) > 2 and name.casefold().startswith(value)]
    return f" Did you mean {near[0]!r}?" if near else ""
