"""Numbers of systems as tensors: batches, one system of them, one wavelength, and the rows that are traced."""

import pytest
import torch

from odak.learn.raytracing.system import (
    Prescription,
    axial_color,
    distortion,
    first_order,
    load_system,
    optical_system,
    rms_spot,
    surface,
    wavefront,
)
from odak.learn.raytracing.system.prescriptions import checked_prescription, padded
from odak.raytracing.interfaces import RadialPhase
from odak.raytracing.surfaces import Toroid

LENS = load_system("cooke_triplet")


def batch_of(bends):
    p = LENS.prescription()
    return p._replace(curvature=p.curvature + torch.tensor(bends, dtype=torch.float64)[:, None])


def test_a_system_of_a_batch_is_traced_as_that_system_alone():
    p = batch_of([0.0, 1e-5, -2e-5])
    assert p.batch == (3,)
    with torch.no_grad():
        together = rms_spot(LENS, prescription=p)
        for i in range(3):
            one = p.select(i)
            assert one.batch == ()
            torch.testing.assert_close(rms_spot(LENS, prescription=one), together[i], rtol=1e-9, atol=0)
    assert not torch.allclose(together[0], together[2], rtol=1e-3)


def test_shapes_of_a_batch_are_selected_with_their_system():
    rotation = torch.tensor([0.01, 0.02], dtype=torch.float64)
    p = optical_system([surface(shape=Toroid(0.0, 0.005), thickness=1.0, material=1.5), surface()], 1.0).prescription()
    p = p._replace(shapes=(Toroid(rotation, 0.005), None))
    assert p.batch == (2,)
    assert [float(p.select(i).shape(0).curvature_x) for i in range(2)] == rotation.tolist()
    assert not p.requires_grad()
    assert p._replace(shapes=(Toroid(rotation.requires_grad_(), 0.005), None)).requires_grad()


def test_one_wavelength_and_the_rows_of_all():
    p = batch_of([0.0, 1e-5])
    count, surfaces = len(LENS.wavelengths), len(LENS.surfaces)
    middle = p.at(1)
    assert torch.equal(middle.index[..., 0, :], p.index[..., 1, :])
    assert middle.at(2) is middle
    rows = p.numbers()
    assert rows.curvature.shape == (2 * count, surfaces + 1)
    # Systems first, then their wavelengths; the plane image behind, in the last medium.
    torch.testing.assert_close(rows.index[:, :-1], p.index.expand(2, count, -1).flatten(0, 1), rtol=0, atol=0)
    assert torch.equal(rows.curvature[count], torch.cat([p.curvature[1], torch.zeros(1, dtype=torch.float64)]))
    assert torch.equal(rows.distance[0, 1:], p.thickness)
    bent = p.numbers(image=surface(-30.0, conic=0.5))
    assert bent.curvature[0, -1] == -1 / 30
    assert bent.conic[0, -1] == 0.5


def test_padded_and_checked():
    assert padded(torch.ones(2), 3).tolist() == [1, 1, 0]
    assert checked_prescription(None) is None
    assert isinstance(LENS.prescription(), Prescription)
    with pytest.raises(TypeError, match="prescription must be a Prescription, got dict"):
        checked_prescription({})


@pytest.mark.parametrize("quantity", ["spot", "wavefront", "color", "focus"])
def test_derivatives_by_the_wavelengths_are_those_of_differences(quantity):
    """Through glasses, a diffractive surface and the unit of path differences, which is the wavelength."""
    lens = load_system("cooke_triplet")
    rows = [*[*lens.surfaces][:-1], surface(-20.4942, thickness=41.0, phase=RadialPhase([-3.0, 0.4], 6.0))]
    hybrid = optical_system(rows, 8.0, fields=[0.0, 10.0], wavelengths=["500nm", "600nm"])

    def value(waves):
        if quantity == "color":
            return axial_color(hybrid, waves)[0]
        numbers = hybrid.prescription(waves)
        if quantity == "spot":
            return rms_spot(hybrid, prescription=numbers).sum()
        if quantity == "focus":
            return first_order(hybrid, prescription=numbers).focal_length
        return wavefront(hybrid, prescription=numbers).path.square().sum()

    waves = torch.tensor([500e-6, 600e-6], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(value(waves), waves)
    step = 1e-9 * torch.eye(2, dtype=torch.float64)
    expected = torch.stack([(value(waves.detach() + d) - value(waves.detach() - d)) / 2e-9 for d in step])
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-6 * float(expected.abs().max()))
    assert float(found.abs().max()) > 0


@pytest.mark.parametrize("quantity", [rms_spot, distortion])
def test_derivatives_by_the_fields_are_those_of_differences(quantity):
    lens = load_system("cooke_triplet")
    fields = torch.tensor([[1.0, 9.0], [2.0, 16.0]], dtype=torch.float64, requires_grad=True)
    (found,) = torch.autograd.grad(quantity(lens, fields=fields).sum(), fields)
    for place in ((0, 1), (1, 0)):
        step = torch.zeros_like(found)
        step[place] = 1e-3
        ends = [float(quantity(lens, fields=fields.detach() + side * step).sum()) for side in (1, -1)]
        assert float(found[place]) == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-4)
