"""Torch functions that are made of functions of the core: conversions, signatures, documentation."""

import inspect
import pickle
import typing

import numpy as np
import pytest
import torch
from documentation import script

import odak
from odak import _array
from odak._array import Array
from odak.learn import jones, tools
from odak.learn._face import torch_face
from odak.learn.wave import holograms


def scaled(field: Array, factor: float | Array = 2.0, *, xp=None, device=None, dtype=None) -> np.ndarray | Array:
    """Return an array times a factor.

    Parameters
    ----------
    field : array
        An array of any shape.
    factor : number or array
        Factor of the arrays.
    xp : module, optional
        Array library.
    device : optional
        Device.
    dtype : optional
        Real dtype.

    Returns
    -------
    numpy.ndarray
        The array scaled.

    Examples
    --------
    >>> odak.wave.wavenumber(np.array(2 * np.pi))
    """
    xp, device, dtype = _array.placement(field, factor, xp=xp, device=device, dtype=dtype)
    return _array.converted(field, xp, device, dtype) * _array.converted(factor, xp, device, dtype)


face = torch_face(scaled, tensors=("field",), defaults={"factor": 3.0})


def test_numbers_lists_and_arrays_become_tensors():
    for value in (2.0, [2.0, 4.0], np.asarray([2.0, 4.0])[::-1]):
        result = face(value)
        assert isinstance(result, torch.Tensor) and result.dtype == torch.float32
        np.testing.assert_array_equal(result.numpy(), 3 * np.asarray(value))
    assert face(torch.ones(2, dtype=torch.float64), [1.0, 2.0]).tolist() == [1.0, 2.0]
    assert face(1.0, dtype=torch.float64).dtype == torch.float64
    assert face(1.0, device="meta").device.type == "meta"
    assert isinstance(scaled([1.0]), np.ndarray)


def test_precision_is_widest_of_tensors_and_gradients_pass():
    field = torch.tensor([1.0, 2.0], requires_grad=True)
    assert (
        tools.distance_between_two_points(field.new_zeros(3), torch.ones(3, dtype=torch.float64)).dtype == torch.float64
    )
    face(field, factor=torch.tensor(5.0)).sum().backward()
    assert field.grad.tolist() == [5.0, 5.0]


def test_signature_is_that_of_the_core_in_terms_of_tensors():
    signature = inspect.signature(face)
    assert list(signature.parameters) == ["field", "factor", "device", "dtype"]
    assert signature.parameters["factor"].default == 3.0
    assert signature.parameters["factor"].annotation == float | torch.Tensor
    assert signature.return_annotation is torch.Tensor
    assert face.__module__ == __name__ and face.__name__ == "scaled"


def test_documentation_speaks_of_tensors_and_of_defaults_of_face():
    text = face.__doc__
    assert "Return a tensor times a factor." in text
    assert "field : torch.Tensor\n    A tensor of any shape." in text
    assert "factor : number or torch.Tensor, default: 3.0\n    Factor of the tensors." in text
    assert "torch.device or str, optional" in text and "xp :" not in text
    assert "Returns\n-------\ntorch.Tensor\n    The tensor scaled." in text
    assert ">>> odak.learn.wave.wavenumber(torch.tensor(2 * torch.pi))" in text
    assert "test_face" not in text.split("See Also")[0]


def test_wrong_calls_are_type_errors():
    for arguments, options in (((1, 2, 3), {}), ((1,), {"field": 1}), ((), {"xp": np, "field": 1}), ((), {"fild": 1})):
        with pytest.raises(TypeError):
            face(*arguments, **options)
    with pytest.raises(ValueError, match="device must be"):
        face(1.0, device="nonsense")
    with pytest.raises(ValueError, match="defaults names no argument"):
        torch_face(scaled, defaults={"facter": 1})


def test_faces_can_be_pickled_compiled_and_transformed():
    assert pickle.loads(pickle.dumps(jones.retarder)) is jones.retarder
    angles = torch.linspace(0, 90, 5, dtype=torch.float64)
    expected = jones.polarizer(angles)
    assert torch.allclose(torch.func.vmap(jones.polarizer)(angles), expected)
    explanation = torch._dynamo.explain(jones.polarizer)(angles)
    assert explanation.graph_break_count == 0


def test_sections_of_a_docstring_replace_those_of_the_core():
    text = torch_face(
        scaled,
        tensors=("field",),
        name="halved",
        describe="""
        Return half of it.

        Parameters
        ----------
        factor : float
            Half of what it was.

        Returns
        -------
        torch.Tensor
            Less.

        Examples
        --------
        >>> 1 + 1
        2
        """,
    )
    assert text.__name__ == "halved" and text.__doc__.startswith("Return half of it.\n\nParameters\n")
    assert (
        "factor : float\n    Half of what it was.\ndevice :" in text.__doc__ and "field : torch.Tensor" in text.__doc__
    )
    assert "Returns\n-------\ntorch.Tensor\n    Less.\n" in text.__doc__ and text.__doc__.endswith(">>> 1 + 1\n2\n")


def test_type_checkers_are_told_the_signatures_at_run_time():
    stubs = script("make_face_stubs", "scripts")
    texts = stubs.stub_texts()
    assert {path: path.read_text(encoding="utf-8") for path in stubs.STUBS.iterdir()} == texts, (
        "run scripts/make_face_stubs.py"
    )
    written = "".join(texts.values())
    assert "xp:" not in written
    assert sum(map(len, stubs.faces().values())) == written.count("\ndef ")


def test_the_source_of_a_face_is_found():
    assert "def propagate_beam(" in inspect.getsource(odak.learn.wave.propagate_beam)
    assert inspect.getsource(odak.learn.wave.stochastic_gradient_descent).startswith("@accepts_older_form")


@pytest.mark.parametrize("decorator", [holograms.accepts_older_form, holograms.accepts_descent_form])
def test_checkers_see_the_signature_under_older_forms(decorator):
    hints = typing.get_type_hints(decorator)
    parameters, _ = typing.get_args(hints["function"])
    assert isinstance(parameters, typing.ParamSpec)
    assert hints["function"] == hints["return"]
