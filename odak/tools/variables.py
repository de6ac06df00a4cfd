"""Copies of parts of dictionaries, checks of positive numbers, and random assignment to groups."""

import math
from collections.abc import Iterable, Sequence
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from odak import _array, _validate

if TYPE_CHECKING:
    import torch

# What is checked is returned.
Value = TypeVar("Value", bound="float | _array.Array")


def copy_dict_with_keys(d: dict[Any, Any], keys: Iterable[Any] | None = None) -> dict[Any, Any] | None:
    """Return a new dictionary with some of the keys of another.

    Parameters
    ----------
    d : dict
        Dictionary to copy from; the values themselves are not copied.
    keys : iterable, optional
        Keys to copy, in this order; those that `d` lacks are passed over. All by default.

    Returns
    -------
    dict or None
        The copy; None if `d` is not a dictionary.

    Examples
    --------
    >>> from odak.tools import copy_dict_with_keys
    >>> copy_dict_with_keys({"a": 1, "b": 2}, ["b", "c"])
    {'b': 2}
    """
    if isinstance(keys, (str, bytes)) or not isinstance(keys, (Iterable, type(None))):
        raise TypeError(f"keys must be an iterable of keys, got {keys!r:.80}")
    if not isinstance(d, dict):
        return None
    return dict(d) if keys is None else {key: d[key] for key in keys if key in d}


def validate_positive_parameter(value: Value, name: str = "value", allow_zero: bool = False) -> Value:
    """Return a number or an array after checking that it is positive.

    Parameters
    ----------
    value : float or array
        Value to check; infinity is accepted, NaN is not.
    name : str
        Name for the message.
    allow_zero : bool
        Accept zero.

    Returns
    -------
    float or array
        `value` itself.

    Raises
    ------
    TypeError
        If it is neither a real number nor an array of them; booleans are not.
    ValueError
        If it is negative, zero without `allow_zero`, or not a number.

    Examples
    --------
    >>> from odak.tools import validate_positive_parameter
    >>> validate_positive_parameter(3.5)
    3.5
    """
    _validate.instance("name", name, str, "a string")
    allow_zero = _validate.flag("allow_zero", allow_zero)
    if not isinstance(value, (float, int, np.generic)) and _array.is_array(value):
        xp = _array.namespace(value)
        if not xp.isdtype(value.dtype, ("real floating", "integral")):
            raise TypeError(f"{name} must be numeric and real, got an array of {value.dtype}")
        if not bool(xp.all(value >= 0 if allow_zero else value > 0)):
            raise ValueError(f"{name} contains {'negative values' if allow_zero else 'negative or zero values'}")
        return value
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, Real):
        raise TypeError(f"{name} must be numeric, got {type(value).__name__}")
    if math.isnan(value) or value < 0 or (value == 0 and not allow_zero):
        raise ValueError(f"{name} must be {'non-negative' if allow_zero else 'positive'}, got {value!r}")
    return value


def create_group_tensor(
    number_of_elements: int, group_percentages: Sequence[float] | None = None, number_of_groups: int | None = None
) -> "torch.Tensor":
    """Return the group number of each element; the groups are consecutive and ascending.

    Parameters
    ----------
    number_of_elements : int
        Elements, at least 0.
    group_percentages : sequence of float, optional
        Share of each group, 0 to 1, of sum 1.
    number_of_groups : int, optional
        Number of groups of equal share, where no shares are given.

    Returns
    -------
    torch.Tensor
        int64 ``[number_of_elements]``. A group has the rounded share (half to even) but no more than remains; the
        last one takes the rest.

    Raises
    ------
    TypeError
        If a count is not an integer.
    ValueError
        If a count is out of range, or the shares are, or do not sum to 1, or both are missing.

    Examples
    --------
    >>> from odak.tools import create_group_tensor
    >>> create_group_tensor(10, number_of_groups=4).tolist()
    [0, 0, 1, 1, 2, 2, 3, 3, 3, 3]
    """
    import torch

    count = _validate.integer("number_of_elements", number_of_elements)
    if group_percentages is None:
        if number_of_groups is None:
            raise ValueError("number_of_groups must be provided where group_percentages are not")
        groups = _validate.integer("number_of_groups", number_of_groups, minimum=1)
        shares = [1 / groups] * groups
    else:
        shares = _validate.numbers(_validate.real("group_percentages", group_percentages))
        if not abs(sum(shares) - 1) <= 1e-6:
            raise ValueError(f"group_percentages must sum to 1.0, got a sum of {sum(shares)}")
        if not all(0 <= share <= 1 for share in shares):
            raise ValueError(f"group_percentages must be between 0.0 and 1.0, got {shares}")
    sizes: list[int] = []
    for share in shares[:-1]:
        sizes.append(min(round(count * share), count - sum(sizes)))
    sizes.append(count - sum(sizes))
    return torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
