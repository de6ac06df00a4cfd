"""Shapes are checked against the words of the message, and numbers against bounds that the message states."""

import math

import numpy as np
import pytest

from odak import _validate


@pytest.mark.parametrize(
    ("accepted", "fitting", "others"),
    [
        ("[3]", [(3,)], [(), (4,), (1, 3)]),
        ("[..., 2, 3]", [(2, 3), (5, 2, 3), (0, 2, 3)], [(3,), (3, 2), (2, 3, 1)]),
        ("[3] or [m, 3]", [(3,), (7, 3), (0, 3)], [(2,), (3, 7), (1, 1, 3)]),
        ("[points, 2 or more], not empty", [(1, 2), (4, 9)], [(0, 2), (4, 1), (4,)]),
        ("[1 or 3, n]", [(1, 5), (3, 0)], [(2, 5), (3,)]),
        ("one number or [4]", [(), (4,)], [(1,), (4, 4)]),
        ("[..., H, W], none empty", [(1, 2), (5, 1, 2)], [(5, 0, 2), (0, 3, 3), (2,)]),
    ],
)
def test_shapes_are_those_that_the_message_states(accepted, fitting, others):
    for shape in fitting:
        array = np.zeros(shape)
        assert _validate.shaped("x", array, accepted) is array
    for shape in others:
        with pytest.raises(ValueError) as caught:
            _validate.shaped("x", np.zeros(shape), accepted)
        assert str(caught.value) == f"x must be {accepted}, got {list(shape)}"


def test_colours_that_come_last_are_pointed_out_where_they_have_an_axis():
    with pytest.raises(ValueError, match=r"colours go first, x\.movedim\(-1, -3\)"):
        _validate.shaped("x", np.zeros((1, 8, 9, 3)), "[B, 1 or 3, H, W]")


@pytest.mark.parametrize(
    ("bounds", "inside", "outside", "message"),
    [
        ({"least": 0}, [0, 2.5], [-1e-9], "at least 0"),
        ({"most": 1}, [1, -4], [1.5], "at most 1"),
        ({"least": 0, "most": 1}, [0, 0.5, 1], [-0.1, 1.1], "from 0 to 1"),
        ({"least": 0, "below": 90}, [0, 89.9], [90, -1], "at least 0 and below 90"),
    ],
)
def test_numbers_are_within_the_bounds_that_the_message_states(bounds, inside, outside, message):
    for value in inside:
        assert _validate.number("x", value, **bounds) == value
    for value in outside:
        with pytest.raises(ValueError, match=f"^x must be {message}, got {value!r}$"):
            _validate.constant("x", value, **bounds)
    with pytest.raises(ValueError, match="x must be finite"):
        _validate.number("x", math.nan, **bounds)
    assert _validate.integer("x", 3, minimum=3, most=3) == 3
    with pytest.raises(ValueError, match="x must be at least 0 and below 3, got 3"):
        _validate.integer("x", 3, below=3)
