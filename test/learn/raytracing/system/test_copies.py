"""Systems that are scaled and turned around: laws of similarity, and the two sides of a lens."""

import math

import pytest
import torch

from odak.learn.raytracing.system import (
    Coating,
    configurations,
    first_order,
    flipped_system,
    load_system,
    optical_system,
    rms_spot,
    scaled_system,
    surface,
    system_to_dict,
)
from odak.raytracing import OddAsphere
from odak.raytracing.interfaces import IdealLens


def doublet(**options):
    return optical_system(
        [
            surface(60.0, thickness=6.0, material="N-BK7", coefficients=[0.0, 1e-6], semi_diameter=11.0),
            surface(-45.0, thickness=2.0, material=1.7, coating=Coating([1.4, 2.0], ["90nm", "60nm"]), stop=True),
            surface(-130.0, conic=-0.5, thickness=95.0),
        ],
        16.0,
        fields=[0.0, 3.0],
        **options,
    )


@pytest.mark.parametrize("options", [{}, {"object_distance": 400.0, "image": surface(-80.0)}])
def test_lengths_of_a_scaled_system_grow_by_the_factor(options):
    """Geometric optics is homogeneous: with fixed indices all lengths scale, spots too, and ratios stay."""
    lens = doublet(settings=[("thickness", 2, [95.0, 96.0]), ("aperture", None, [16.0, 8.0])], **options)
    large = scaled_system(lens, 2.5)
    one, two = first_order(lens), first_order(large)
    for name in ("focal_length", "back_focal_distance", "entrance_pupil_diameter", "image_distance"):
        assert float(getattr(two, name)) == pytest.approx(2.5 * float(getattr(one, name)), rel=1e-12)
    assert float(two.f_number) == pytest.approx(float(one.f_number), rel=1e-12)
    torch.testing.assert_close(rms_spot(large), 2.5 * rms_spot(lens), rtol=1e-9, atol=0)
    assert large.surfaces[0].semi_diameter == 27.5 and large.wavelengths == lens.wavelengths
    spots = [configurations(system).each(rms_spot) for system in (lens, large)]
    torch.testing.assert_close(spots[1], 2.5 * spots[0], rtol=1e-9, atol=0)
    assert lens.aperture == 16.0


def test_odd_aspheres_of_a_scaled_system_grow_with_it():
    shape = OddAsphere(1 / 60, -0.3, [0.0, 1e-3, 2e-5, -1e-6])
    lens = optical_system(
        [surface(shape=shape, thickness=6.0, material=1.5), surface(-80.0, thickness=90.0)], 16.0, fields=[0.0, 3.0]
    )
    lens.vary(coefficients=0)
    large = scaled_system(lens, 2.5)
    torch.testing.assert_close(rms_spot(large), 2.5 * rms_spot(lens), rtol=1e-9, atol=0)
    assert isinstance(large.surfaces[0].own_shape.coefficients, torch.nn.Parameter)
    both = surface(shape=shape, phase=IdealLens(50.0), thickness=50.0)
    with pytest.raises(ValueError, match=r"surfaces\[0\] has a IdealLens, which cannot be scaled"):
        scaled_system(optical_system([both, surface()], 5.0), 2.0)


def test_a_lens_turned_around_has_its_other_focal_distance():
    lens = doublet()
    turned = flipped_system(lens)
    here, there = first_order(lens), first_order(turned)
    assert float(there.focal_length) == pytest.approx(float(here.focal_length), rel=1e-12)
    assert float(there.back_focal_distance) == pytest.approx(-float(here.front_focal_distance), rel=1e-9)
    assert [item.stop for item in turned.surfaces] == [False, True, False] and turned.stop == 1
    assert float(turned.surfaces[0].curvature) == pytest.approx(1 / 130.0) and turned.surfaces[0].conic == -0.5
    assert float(turned.surfaces[2].coefficients[1]) == -1e-6 and turned.surfaces[2].semi_diameter == 11.0
    assert turned.surfaces[1].coating.media == (2.0, 1.4)
    again = flipped_system(turned)
    assert system_to_dict(again) == system_to_dict(lens)


def test_an_element_is_turned_within_a_system():
    """A group keeps the media and the distances around it: the symmetric element of a triplet changes nothing."""
    triplet = load_system("cooke_triplet")
    found = flipped_system(triplet, 2, 3)
    assert [float(item.thickness) for item in found.surfaces] == [float(item.thickness) for item in triplet.surfaces]
    radii = [float(item.radius) for item in found.surfaces]
    assert radii[2:4] == pytest.approx([-21.896, 24.456]) and found.stop == 2 and found.surfaces[2].stop
    assert found.surfaces[2].material.name == "N-SF5" and found.surfaces[3].material == "air"
    alone = flipped_system(triplet, 0, 0)
    assert float(alone.surfaces[0].radius) == -float(triplet.surfaces[0].radius)
    assert math.isclose(float(alone.surfaces[0].thickness), 4.831)


def test_what_cannot_be_scaled_or_flipped_is_named():
    ideal = optical_system([surface(phase=IdealLens(50.0), thickness=50.0), surface()], 5.0)
    with pytest.raises(ValueError, match=r"surfaces\[0\] has a IdealLens, which cannot be scaled"):
        scaled_system(ideal, 2.0)
    with pytest.raises(ValueError, match="which cannot be flipped"):
        flipped_system(ideal)
    with pytest.raises(ValueError, match="factor must be positive"):
        scaled_system(doublet(), -1.0)
    with pytest.raises(ValueError, match="first must be at most last"):
        flipped_system(doublet(), 2, 1)
    with pytest.raises(ValueError, match="is a mirror"):
        flipped_system(optical_system([surface(-100.0, material="mirror", thickness=-50.0)], 5.0))
    with pytest.raises(ValueError, match="have settings of configurations"):
        flipped_system(doublet(settings=[("thickness", 2, [95.0, 96.0])]))
