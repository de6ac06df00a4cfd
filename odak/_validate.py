"""Checks of arguments; their errors name the argument, what was given and what is accepted."""

import difflib
import importlib
import itertools
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from numbers import Integral, Number, Real
from typing import Any, TypeVar

import numpy

from odak._array import (
    cast,
    complex_dtype,
    converted,
    is_array,
    is_readable,
    is_torch,
    namespace,
    placement,
    real_dtype,
)
from odak._array import library as library
from odak._call_forms import takes_fields as takes_fields
from odak._call_forms import takes_units as takes_units
from odak._lengths import lengths_together as lengths_together
from odak._warnings import AccuracyWarning, ArgumentWarning, warn

# More samples along one axis than any memory holds along two; refused before anything is allocated.
LONGEST_SIDE = 2**31 - 1
# A picture of 0 … 255 reaches more than this, and one of 0 … 1 does not.
_OVERSHOT = 8
# Stacks of so many planes of at least so many rows, each 3 or 4 samples wide, are pictures with their colours last.
_LEAST_PICTURE = 16

# Kinds of numbers whose checks need no question about libraries.
_NUMBERS = (float, int)
# What a check returns as it was given.
T = TypeVar("T")


@contextmanager
def refusing(
    told: str | Callable[[str], str], *kinds: type[Exception], raised: type[Exception] = ValueError
) -> Iterator[None]:
    """Raise errors of these kinds as one of what was given.

    Parameters
    ----------
    told : str or callable
        What stands before the error's text, or a function that makes the message of it.
    kinds : type
        Errors that a file or a value causes; others pass.
    raised : type
        The error that is raised for them.
    """
    try:
        yield
    except kinds as error:
        text = f"{error} is missing" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise raised(told(text) if callable(told) else told + text) from error


def optional(module: str, told: str, raised: type[Exception] = ImportError) -> Any:
    """Import a module that need not be installed; where it is missing, `told` says who needs it and what to install."""
    with refusing(lambda _: told, ImportError, raised=raised):
        return importlib.import_module(module)


def one_of(name: str, value: str, options: Iterable[str]) -> str:
    """Return the option that `value` names, whatever its case; raise ValueError with the nearest match otherwise."""
    options = tuple(options)
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {type(value).__name__}; accepted: {', '.join(options)}")
    for option in options:
        if option.casefold() == value.strip().casefold():
            return option
    near = difflib.get_close_matches(value.casefold(), [option.casefold() for option in options], n=1, cutoff=0.4)
    hint = next((f" Did you mean {option!r}?" for option in options if near and option.casefold() == near[0]), "")
    raise ValueError(f"{name} must be one of {', '.join(map(repr, options))}; got {value!r}.{hint}")


def real(name: str, value: T, *, positive: bool = False, nonzero: bool = False) -> T:
    """Return `value` (a number or an array) after checking that it is real, finite and of the required sign.

    Tensors on a GPU or inside a torch.func transform are checked for their type alone: reading them would sync or fail.
    """
    given: Any = value
    if type(given) in _NUMBERS and math.isfinite(given) and (given > 0 if positive else given != 0 or not nonzero):
        return value
    listed = isinstance(given, (list, tuple)) and all(isinstance(v, Real) for v in given)
    if isinstance(given, bool) or not (isinstance(given, Real) or listed or is_array(given)):
        raise TypeError(f"{name} must be a real number or an array of them, got {type(given).__name__}")
    if listed and not given:
        raise ValueError(f"{name} must contain at least one number, got an empty {type(given).__name__}")
    if is_array(given):
        if "complex" in str(given.dtype) or not _holds_numbers(given):
            raise TypeError(f"{name} must be real, got an array of {given.dtype}")
        if not is_readable(given):
            return value
    wanted = "positive and finite" if positive else "finite and not zero" if nonzero else "finite"
    if is_array(given):
        xp = namespace(given)
        bad = ~xp.isfinite(given) | (given <= 0 if positive else given == 0 if nonzero else given != given)
        if not bool(xp.any(bad)):
            return value
    for v in numbers(given):
        if not math.isfinite(v) or (positive and v <= 0) or (nonzero and v == 0):
            raise ValueError(f"{name} must be {wanted}, got {v!r}")
    return value


def number(name: str, value: T, *, positive: bool = False, unit: str = "", **bounds: float) -> T:
    """Return `value`, one real number or an array of one, after checking it as :func:`real` and `within` do."""
    given: Any = value
    if isinstance(given, (list, tuple)):
        raise TypeError(f"{name} must be one number, got a {type(given).__name__}")
    if is_array(given) and math.prod(given.shape) != 1:
        raise ValueError(f"{name} must be one number, got an array of shape {tuple(given.shape)}")
    real(name, given, positive=positive)
    return within(name, value, unit, **bounds) if bounds and (not is_array(value) or is_readable(value)) else value


def within(
    name: str, value, unit: str = "", *, least: float = -math.inf, most: float = math.inf, below: float = math.inf
):
    """Return a number after checking that it is from `least` to `most`, and below `below`, with the unit of both."""
    if least <= value <= most and (value < below or below == math.inf):
        return value
    words = [f"at least {least}"] * (least > -math.inf) + [f"at most {most}"] * (most < math.inf)
    words = [f"from {least} to {most}"] if len(words) > 1 else words
    words += [f"below {below}"] * (below < math.inf)
    raise ValueError(f"{name} must be {' and '.join(words)}{unit and ' ' + unit}, got {value!r:.80}")


def ends(value) -> tuple[float, float] | None:
    """Return the least and the largest of numbers, None where there are none or they are not known yet."""
    if not is_array(value):
        found = numbers(value)
        return (min(found), max(found)) if found else None
    if not is_readable(value) or 0 in value.shape:
        return None
    xp = namespace(value)
    return numbers(xp.min(value))[0], numbers(xp.max(value))[0]


def inside(name: str, value: T, unit: str = "", **bounds: float) -> T:
    """Return numbers after checking the bounds of all of them, where they are known."""
    for number in ends(value) or ():
        within(name, number, unit, **bounds)
    return value


def constant(
    name: str, value, *, positive: bool = False, nonzero: bool = False, unit: str = "", **bounds: float
) -> float:
    """Return `value`, one real number or an array of one, as a float that carries no derivative.

    A tensor that requires a gradient is reported by an AccuracyWarning: the result will not depend on it.
    """
    value = number(name, real(name, value, nonzero=nonzero), positive=positive, unit=unit, **bounds)
    (value,) = constants(**{name: value})
    return float(value)


def constants(**values) -> tuple[Any, ...]:
    """Return arguments without their derivatives, in the order given.

    Tensors that require a gradient are reported by an AccuracyWarning, in lists and tuples too: the result will not
    depend on them. What is no tensor stays as it is.
    """

    def plain(name, value):
        if isinstance(value, (list, tuple)):
            parts = [plain(name, part) for part in value] if any(map(is_torch, value)) else value
            return tuple(parts) if isinstance(value, tuple) else parts
        if not is_torch(value):
            return value
        if value.requires_grad and sys.modules["torch"].is_grad_enabled():
            warn(
                f"{name} requires a gradient, which is lost here: it is taken as a plain number; pass a number, or "
                "value.detach(), if no gradient is wanted",
                AccuracyWarning,
            )
        return value.detach()

    return tuple(plain(name, value) for name, value in values.items())


def numbers(value) -> list[float]:
    """Return a number, a sequence or an array of numbers as a flat list of floats."""
    if type(value) in _NUMBERS:
        return [float(value)]
    if is_torch(value):
        # The whole list at once: a tensor of each number takes microseconds.
        return [float(v) for v in value.detach().reshape(-1).tolist()]
    if is_array(value):
        return [float(v) for v in namespace(value).reshape(value, (-1,))]
    if isinstance(value, Iterable) and not isinstance(value, (str, bytes)):
        return [number for v in value for number in numbers(v)]
    return [float(value)]


def integer(
    name: str, value, *, minimum: float = 0, most: float = math.inf, below: float = math.inf, unit: str = ""
) -> int:
    """Return `value` as an int after checking that it is a whole number within bounds, as `within` does."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {type(value).__name__}")
    return int(within(name, value, unit, least=minimum, most=most, below=below))


def image(name: str, value, *, axes: int = 2):
    """Return an array of at least `axes` axes whose last two are not empty."""
    if not is_array(value):
        raise TypeError(f"{name} must be an array or a tensor, got {type(value).__name__}")
    if not _holds_numbers(value):
        raise TypeError(f"{name} must be numeric, got an array of {value.dtype}")
    if value.ndim < axes or 0 in value.shape[-2:]:
        raise ValueError(
            f"{name} must have at least {axes} axes [..., rows, columns], none empty; got {tuple(value.shape)}"
        )
    return value


def planes(name: str, value):
    """Return an array as :func:`image` does; warn of one that looks like ``[rows, columns, channels]``."""
    value = image(name, value)
    if value.ndim == 3 and value.shape[-1] in (3, 4) and min(value.shape[:2]) >= _LEAST_PICTURE:
        stack, rows, columns = value.shape
        warn(
            f"{name} must be [..., rows, columns]: {tuple(value.shape)} is taken as {stack} planes of {rows} x "
            f"{columns} samples; if its last axis holds colours, move it to the front",
            ArgumentWarning,
        )
    return value


def size(name: str, value) -> tuple[int, int]:
    """Return a pair of positive integers (rows, columns)."""
    pair = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str) else (value,)
    if len(pair) != 2:
        raise ValueError(f"{name} must be two integers [rows, columns], got {value!r}")
    return side(f"{name}[0]", pair[0]), side(f"{name}[1]", pair[1])


def side(name: str, value) -> int:
    """Return the number of samples along an axis: a whole number from 1 to `LONGEST_SIDE`."""
    return within(name, whole(name, value, minimum=1), most=LONGEST_SIDE)


def whole(name: str, value, *, minimum: float = 0, most: float = math.inf) -> int:
    """Return `value` as :func:`integer` does; floats and tensors of one whole number count too."""
    if is_array(value) and math.prod(value.shape) == 1 and _holds_numbers(value):
        value = numbers(value)[0]
    if isinstance(value, Real) and not isinstance(value, (bool, Integral)):
        given: Any = value
        if not math.isfinite(given) or given != int(given):
            raise ValueError(f"{name} must be a whole number, got {value!r}")
        value = int(given)
    return integer(name, value, minimum=minimum, most=most)


def array(name: str, value, *, like=None):
    """Return `value` as an array of numbers: arrays and tensors as they are, numbers and nested lists as NumPy arrays.

    Parameters
    ----------
    name : str
        The argument's name.
    value : array, number or nested sequence of numbers
        What came.
    like : array, optional
        Lists and numbers become arrays of this one's library, device and precision (complex stays complex).
    """
    if is_array(value):
        if not _holds_numbers(value):
            raise TypeError(f"{name} must be numeric, got an array of {value.dtype}")
        return value
    if isinstance(value, (str, bytes, bool)) or not isinstance(value, (Number, Sequence)):
        raise TypeError(f"{name} must be an array, a tensor or a list of numbers, got {type(value).__name__}")
    try:
        made = numpy.asarray(value)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{name} must be a regular array of numbers, got lists that differ in length") from error
    if not _holds_numbers(made):
        raise TypeError(f"{name} must be numeric, got {value!r:.100}")
    return made if like is None else cast(made, like, (complex_dtype if made.dtype.kind == "c" else real_dtype)(like))


def given(name: str, value, *, rows: bool = False):
    """Return a finite number as it is, an array of numbers too, and a list of finite ones as an array.

    With `rows`, nested lists may hold NaN, as arrays do: rays that missed something.
    """
    if type(value) in (int, float, complex):
        if not abs(value) < math.inf:
            raise ValueError(f"{name} must be finite, got {value!r}")
        return value
    made = array(name, value)
    if made is not value and not (made.size and ((rows and made.ndim > 1) or numpy.isfinite(made).all())):
        raise ValueError(f"{name} must contain at least one number, all finite; got {value!r:.100}")
    return made


def reals(**values) -> list[Any]:
    """Return arguments as real floating arrays of one library, on one device and in one precision.

    Numbers must be finite, but for those in nested lists; they take the library, device and precision of
    the arrays among the arguments, as :func:`odak._array.placement` finds them. What is not a number in an array
    spreads to the result.
    """
    given_values = list(values.values())
    floating = all(is_torch(value) and value.is_floating_point() for value in given_values)
    if floating and len({(value.dtype, value.device) for value in given_values}) == 1:
        return given_values
    xp, device, dtype = placement(*given_values)
    made = []
    for name, value in values.items():
        value = array(name, value) if is_array(value) else converted(given(name, value, rows=True), xp, device)
        if "complex" in str(value.dtype) or str(value.dtype).endswith("bool"):
            raise TypeError(f"{name} must be real numbers, got {value.dtype}")
        made.append(converted(value, xp, device, dtype))
    return made


def shaped(name: str, value, accepted: str):
    """Return an array after checking its shape against the words in which the message states it.

    Parameters
    ----------
    name : str
        The argument's name.
    value : array
        What came.
    accepted : str
        Shapes in brackets, such as ``"[3] or [m, 3]"``: a number is that length, ``2 or more`` and ``1 or 3`` are
        these, a name is any length, and ``...`` in front is any number of axes. The word "empty" behind them excludes
        axes of no length, and "number" before them lets an array without axes through.
    """
    shape, forms = value.shape, _FORMS.get(accepted)
    if forms is None:
        forms = _FORMS[accepted] = _forms_of(accepted)
    if not any(_matches(shape, *form) for form in forms) or (0 in shape and "empty" in accepted):
        coloured = "C, H, W" in accepted or "3, H, W" in accepted
        came = in_order(name, shape) if coloured else f"got {list(shape)}"
        raise ValueError(f"{name} must be {accepted}, {came}")
    return value


def _matches(shape: Sequence[int], free: bool, lengths: list[Sequence[int] | None]) -> bool:
    """Return whether the axes of a shape, or its last ones where others may come in front, have these lengths."""
    last = shape[max(len(shape) - len(lengths), 0) :] if free else shape
    pairs = zip(last, lengths, strict=False)
    return len(last) == len(lengths) and all(wanted is None or n in wanted for n, wanted in pairs)


# What texts of shapes state, which is read once; in plain Python, which torch.compile can follow.
_FORMS: dict[str, list[tuple[bool, list[Sequence[int] | None]]]] = {}


def _forms_of(accepted: str) -> list[tuple[bool, list[Sequence[int] | None]]]:
    """Return whether axes may come in front, and the lengths of the last ones, of each shape that a text states."""
    before, *texts = accepted.split("[")
    forms: list[tuple[bool, list[Sequence[int] | None]]] = [(False, [])] if "number" in before.split() else []
    for text in texts:
        entries = [entry.strip() for entry in text.partition("]")[0].split(",")]
        free = entries[0] == "..."
        forms.append((free, [_lengths_of(entry) for entry in entries[free:]]))
    return forms


def _lengths_of(entry: str) -> Sequence[int] | None:
    """Return the lengths that an entry of a shape stands for; None for any."""
    words = entry.split(" or ")
    if not words[0].isdigit():
        return None
    return range(int(words[0]), sys.maxsize) if words[-1] == "more" else [int(word) for word in words]


def fitting(**arrays) -> tuple[int, ...]:
    """Return the shape that arrays, shapes and numbers broadcast to; raise ValueError that names them if none fits."""
    one_device(**arrays)
    shapes = {
        name: value if isinstance(value, tuple) else tuple(getattr(value, "shape", ()))
        for name, value in arrays.items()
    }
    # In plain Python, which torch.compile can follow.
    aligned = itertools.zip_longest(*(reversed(shape) for shape in shapes.values()), fillvalue=1)
    sides = [[n for n in column if n != 1] for column in aligned]
    if any(n != column[0] for column in sides for n in column):
        listed = ", ".join(f"{name} {list(shape)}" for name, shape in shapes.items())
        raise ValueError(f"these shapes cannot be broadcast together: {listed}")
    return tuple(column[0] if column else 1 for column in reversed(sides))


def one_device(**arrays) -> None:
    """Raise ValueError that names tensors on different devices; numbers on the CPU are compatible with any device."""
    tensors = {name: value for name, value in arrays.items() if is_torch(value)}
    places = {name: v.device for name, v in tensors.items() if v.ndim or v.device.type != "cpu"}
    first, *others = places.values() or [None]
    if any(place != first for place in others):
        listed = ", ".join(f"{name} {device}" for name, device in places.items())
        raise ValueError(f"these must be on one device: {listed}")


def in_order(name: str, shape: Sequence[int], last: Sequence[int] = ()) -> str:
    """Return the end of a message on a shape ``[..., rows, columns]``: what it is, and the order that fits if one does.

    Parameters
    ----------
    name : str
        The argument's name.
    shape : sequence of int
        Its shape.
    last : sequence of int, optional
        The rows and columns wanted, if they are known.
    """
    shape = tuple(shape)
    got = f"got {list(shape)}"
    if len(shape) > 2 and shape[-1] in (3, 4) and shape[-3] not in (1, 3, 4):
        return f"{got}: colours go first, {name}.movedim(-1, -3)"
    if len(last) == 2 and shape[-2:] == (last[1], last[0]) != tuple(last):
        return f"{got}: rows go before columns, {name}.mT"
    return got


def alike(**arrays) -> None:
    """Raise ValueError that names arrays unless all have one shape, and tensors one device."""
    shapes = {name: tuple(value.shape) for name, value in arrays.items()}
    first, *others = shapes.values()
    if any(shape != first for shape in others):
        raise ValueError(
            f"{' and '.join(shapes)} must have the same shape, got {' and '.join(map(str, shapes.values()))}"
        )
    one_device(**arrays)


def flag(name: str, value) -> bool:
    """Return `value` as a bool after checking that it is one (NumPy's count, and numbers equal to 0 or 1)."""
    if isinstance(value, (bool, numpy.bool_)) or (isinstance(value, Real) and value in (0, 1)):
        return bool(value)
    raise TypeError(f"{name} must be True or False, got {value!r:.100}")


def seed(name: str, value):
    """Return a seed: None, a whole number of at least 0 or a generator of NumPy or torch."""
    if value is None or isinstance(value, numpy.random.Generator) or type(value).__name__ == "Generator":
        return value
    return integer(name, value)


def function_or_none(name: str, value: T) -> T:
    """Return a function, or anything that can be called; None, which stands for no function, stays None."""
    if value is None or callable(value):
        return value
    raise TypeError(f"{name} must be a function, got {value!r:.80}")


def several(name: str, value, count: int | None = None, *, positive: bool = False) -> tuple[Any, ...]:
    """Return a sequence of real numbers, or of arrays of them, as a tuple; `count` of them where that is given."""
    listed = isinstance(value, Iterable) and not isinstance(value, (str, bytes, dict))
    if not listed or getattr(value, "ndim", 1) == 0:
        raise TypeError(f"{name} must be a sequence of real numbers, got {type(value).__name__}")
    values = tuple(value)
    if count is not None and len(values) != count:
        raise ValueError(f"{name} must have {count} numbers, got {len(values)}")
    return tuple(real(name, v, positive=positive) for v in values)


def pair(name: str, value, *, positive: bool = False) -> tuple[Any, ...]:
    """Return one real number twice, or the two of a tuple, list or array (rows, columns) as a tuple."""
    if is_array(value) and math.prod(value.shape) != 1:
        if tuple(value.shape) != (2,):
            raise ValueError(f"{name} must be one number or two, got an array of shape {tuple(value.shape)}")
        value = value[0], value[1]
    return several(name, value if isinstance(value, (tuple, list)) else (value, value), 2, positive=positive)


def few(name: str, value, count: int | None = None, *, positive: bool = False, rising: bool = False) -> list[float]:
    """Return constants in a row, of a list, an array or a tensor of any shape: `count` of them, or two or more."""
    (value,) = constants(**{name: value})
    for part in value if isinstance(value, (list, tuple)) else (value,):
        real(name, part, positive=positive)
    found = numbers(value)
    falls = rising and any(after <= before for before, after in itertools.pairwise(found))
    if falls or (len(found) < 2 if count is None else len(found) != count):
        words = [{None: "two or more", 2: "two", 3: "three"}.get(count, str(count))]
        words += ["positive"] * positive + ["rising"] * rising
        raise ValueError(f"{name} must be {' '.join(words)} numbers, got {value!r:.100}")
    return found


def instance(name: str, value: Any, kind: type[T] | tuple[type[T], ...], accepted: str) -> T:
    """Return a value after checking that it is an instance of a class, or of one of several."""
    if not isinstance(value, kind):
        raise TypeError(f"{name} must be {accepted}, got {type(value).__name__}")
    return value


def listed(name: str, value: T, accepted: str) -> T:
    """Return a sequence, or what else can be iterated, after checking that it is no string."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be {accepted}, got {type(value).__name__}")
    return value


def known(name: str, given: Iterable[Any], names: Iterable[str]) -> None:
    """Check that all that is named, such as the keys of a dictionary, is among some names."""
    if unknown := sorted(set(map(str, given)) - set(names)):
        raise ValueError(f"{name} must be of {', '.join(names)}; got {', '.join(map(repr, unknown))}")


def function(name: str, value: T) -> T:
    """Return a function after checking that it can be called."""
    if not callable(value):
        raise TypeError(f"{name} must be a function, got {value!r:.80}")
    return value


def text(name: str, value) -> str:
    """Return a string after checking that it is one."""
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {value!r:.80}")
    return value


def texts(name: str, value) -> list[str]:
    """Return a sequence of strings as a list; a single string is refused, it would be taken letter by letter."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise TypeError(f"{name} must be a sequence of strings, got {value!r:.80}")
    entries = list(value)
    for entry in entries:
        if not isinstance(entry, str):
            raise TypeError(f"{name} must contain strings, got {entry!r:.80}")
    return entries


def check_white(name: str, brightest: float, white: float, remedy: str) -> None:
    """Warn where a picture looks like one of 0 … 1 though 255 or more is white, or of far more than white.

    Parameters
    ----------
    name : str
        Name of the picture.
    brightest : float
        Its largest value; none of a picture that is black.
    white : float
        Value of white.
    remedy : str
        What to do, with which the message ends.
    """
    # Room for the overshoot of a picture of 0 … 1.
    if (white >= 255 and 0 < brightest <= _OVERSHOT) or _OVERSHOT * white < brightest < math.inf:
        warn(f"{name} reaches {brightest:g} where {white:g} is white: {remedy}", ArgumentWarning)


def check_values(name: str, values, remedy: str | None = None, *, refuse: bool = True, white: float = 1) -> None:
    """Name NaN and infinite values of a picture, a field or a pattern, and, with a remedy, values of 0 … 255.

    Values that torch.func hides are not looked at. A GPU is waited for: once for an optimisation or a report.

    Parameters
    ----------
    name : str
        Name of the argument.
    values : array
        What came; of complex values, the modulus counts.
    remedy : str, optional
        What to do about values of 0 … 255, with which the warning ends.
    refuse : bool
        Raise ValueError for what is not finite; a warning otherwise.
    white : float
        Value of white.
    """
    if is_torch(values):
        if values.is_meta or not (values.is_cuda or is_readable(values)):
            return
        values = values.detach()
    if is_torch(values) and not values.is_complex():
        # A third of the time of the maximum of a modulus.
        low, high = (float(value) for value in values.aminmax())
        largest = -low if -low > high else high
    else:
        largest = float(namespace(values).max(abs(values)))
    if not math.isfinite(largest):
        message = f"{name} must be finite, got NaN or infinite values"
        if refuse:
            raise ValueError(message)
        warn(message, ArgumentWarning)
    elif remedy is not None:
        check_white(name, largest, white, remedy)


def place_in(name: str, value, count: int) -> int:
    """Return the place of one of `count` things, 0 to count − 1, of a place or of one counted from the end."""
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {type(value).__name__}")
    if not -count <= int(value) < count:
        raise ValueError(f"{name} must be {-count} to {count - 1}, got {value}")
    return int(value) % count


def _holds_numbers(value) -> bool:
    """Return whether an array's values are numbers or truth values, not texts or Python objects."""
    return not isinstance(value, (numpy.ndarray, numpy.generic)) or value.dtype.kind in "biufc"
