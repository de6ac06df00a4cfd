"""The reference shows functions that are made at run time with their signature and docstring."""

import pathlib

import pytest

griffe = pytest.importorskip("griffe")
EXTENSION = pathlib.Path(__file__).parents[2] / "docs" / "reference.py"


@pytest.mark.slow
def test_a_face_has_its_signature_and_docstring_in_the_reference():
    package = griffe.load(
        "odak", search_paths=[EXTENSION.parents[1]], resolve_aliases=True, extensions=griffe.load_extensions(EXTENSION)
    )
    shown = package["learn.jones.retarder"]
    assert [parameter.name for parameter in shown.parameters] == ["retardance", "angle", "device", "dtype"]
    assert (
        str(shown.parameters["angle"].annotation) == "complex | Tensor" and shown.parameters["angle"].default == "0.0"
    )
    assert shown.parameters["retardance"].default is None
    kinds = [section.kind.value for section in shown.docstring.parse("numpy")]
    assert kinds[:3] == ["text", "parameters", "returns"]
    assert "number or torch.Tensor" in shown.docstring.value
