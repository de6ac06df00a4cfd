import numpy as np
import pytest
import torch

from odak.tools import copy_dict_with_keys, create_group_tensor, validate_positive_parameter


def test_copies_of_dictionaries():
    source = {"b": [1], 2: "x", "a": 3}
    assert list(copy_dict_with_keys(source, ["a", "b", "c"]).items()) == [("a", 3), ("b", [1])]
    copy = copy_dict_with_keys(source)
    assert copy == source
    assert copy is not source
    assert copy_dict_with_keys([1, 2]) is None


@pytest.mark.parametrize(
    "value", [1, 0.5, np.float32(2), np.int64(3), np.ones(3), torch.ones(2), torch.ones(2, dtype=torch.int32)]
)
def test_positive_values_pass(value):
    assert validate_positive_parameter(value) is value


@pytest.mark.parametrize(
    "value, zero, message",
    [
        (0, False, "gap must be positive"),
        (-1, True, "gap must be non-negative"),
        (float("nan"), True, "gap must be non-negative"),
        (np.array([1.0, 0.0]), False, "gap contains negative or zero values"),
        (torch.tensor([1.0, -1.0]), True, "gap contains negative values"),
        (np.array([np.nan]), True, "gap contains negative values"),
    ],
)
def test_other_values_do_not(value, zero, message):
    with pytest.raises(ValueError, match=message):
        validate_positive_parameter(value, "gap", zero)


@pytest.mark.parametrize("count", [0, 1, 7, 10, 10000])
@pytest.mark.parametrize("shares", [[0.5, 0.3, 0.2], [0.5, 0.5, 0.0], [0.0, 1.0], [1.0], [0.35, 0.35, 0.3, 0.0]])
def test_groups_are_rising_runs_of_their_shares(count, shares):
    groups = create_group_tensor(count, shares)
    assert groups.dtype == torch.int64
    assert groups.shape == (count,)
    assert bool((groups.diff() >= 0).all())
    sizes = torch.bincount(groups, minlength=len(shares)).tolist()
    assert len(sizes) == len(shares)
    assert all(abs(size - count * share) <= 1.5 for size, share in zip(sizes, shares, strict=True))


def test_equal_groups():
    assert create_group_tensor(10, number_of_groups=4).tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 3, 3]
    assert create_group_tensor(3, [0.5, 0.5, 0.0]).tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    "arguments, kind, message",
    [
        ((10, [0.5, 0.4]), ValueError, "must sum to 1.0"),
        ((10, [1.5, -0.5]), ValueError, "between 0.0 and 1.0"),
        ((10,), ValueError, "number_of_groups must be provided"),
        ((10, None, 0), ValueError, "number_of_groups must be at least 1"),
        ((-1, [1.0]), ValueError, "number_of_elements must be at least 0"),
    ],
)
def test_groups_refuse(arguments, kind, message):
    with pytest.raises(kind, match=message):
        create_group_tensor(*arguments)
