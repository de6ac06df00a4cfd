"""Prisms, periscopes, off-axis paraboloids and pancake optics against closed forms."""

import math

import pytest
import torch

from odak.learn.raytracing.system import (
    coordinate_break,
    first_order,
    launch,
    layout_figure,
    optical_system,
    polarized_trace,
    read_zmx,
    rms_spot,
    surface,
    system_from_dict,
    system_to_dict,
    trace,
    trace_fields,
    wavefront,
    write_zmx,
)
from odak.raytracing import RayStatus
from odak.raytracing.apertures import CircularAperture

F64 = torch.float64


def turn(x=0.0, y=0.0, thickness=0.0, **options):
    return coordinate_break(tilt=(x, y, 0.0), thickness=thickness, **options)


def global_rays(system, rays):
    """Return the points and directions behind a system in the frame of the first vertex."""
    found = trace(system, rays)
    matrix, origin = (part[-1] for part in system.frames(own=False))
    point = torch.stack(found[:3], -1) @ matrix.mT + origin
    return point, torch.stack(found[3:6], -1) @ matrix.mT, found


@pytest.mark.parametrize("index, apex", [(1.5168, 60.0), (1.72, 45.0)])
def test_a_prism_at_minimum_deviation(index, apex):
    """n = sin((A + D)/2)/sin(A/2), and any other angle of incidence deviates more."""
    least = 2 * math.degrees(math.asin(index * math.sin(math.radians(apex / 2)))) - apex

    def deviation(incidence):
        prism = optical_system(
            [
                turn(incidence),
                surface(material=index),
                turn(-apex / 2, thickness=20.0),
                turn(-apex / 2),
                surface(),
                turn(thickness=5.0),
            ],
            1.0,
        )
        _, way, _ = global_rays(prism, torch.tensor([[0.0, 0, 0], [0.0, 0, 1]], dtype=F64))
        return math.degrees(math.acos(float(way[0, 0, 0, 2])))

    symmetric = (least + apex) / 2
    assert abs(deviation(symmetric) - least) < 1e-9
    assert min(deviation(symmetric + side) for side in (-2.0, 2.0)) > least + 0.01


def test_a_pentaprism_turns_by_90_degrees_however_it_stands():
    """Two mirrors at 45° to each other: the deviation does not change when both are tilted together."""
    for tilt in (0.0, 3.0, -5.0):
        system = optical_system(
            [
                turn(tilt, thickness=20.0),
                turn(22.5),
                surface(material="mirror"),
                turn(22.5, thickness=-20.0),
                turn(22.5),
                surface(material="mirror"),
                turn(22.5, thickness=20.0),
            ],
            2.0,
        )
        _, way, found = global_rays(system, launch(system, "y", 3))
        assert bool(found.arrived.all())
        assert torch.allclose(way[..., 2].abs(), torch.zeros_like(way[..., 2]), atol=1e-12)


def test_a_periscope_displaces_and_keeps_the_direction():
    """Two parallel mirrors at 45°: rays go on in parallel, a height lower, and all paths are equal."""
    height = 30.0
    system = optical_system(
        [
            surface(thickness=10.0),
            turn(45.0),
            surface(material="mirror"),
            turn(45.0, thickness=-height),
            turn(-45.0),
            surface(material="mirror"),
            turn(-45.0, thickness=10.0),
        ],
        4.0,
        fields=[0.0, 1.0],
    )
    rays = launch(system, "rings", 2)
    point, way, found = global_rays(system, rays)
    assert torch.allclose(way, torch.stack([value.expand(found.x.shape) for value in rays[3:]], -1), atol=1e-12)
    assert torch.allclose(found.path[0, 0], torch.tensor(10.0 + height + 10.0, dtype=F64), atol=1e-12)
    start = torch.stack([value.expand(found.x.shape) for value in rays[:3]], -1)[0, 0]
    shift = point[0, 0] - start
    assert torch.allclose(shift[:, 1].abs(), torch.tensor(height, dtype=F64), atol=1e-12)
    assert torch.allclose(shift[:, 0], torch.zeros(19, dtype=F64), atol=1e-12)
    # Ideal mirrors in one plane: no retardance, no loss.
    polarised = polarized_trace(system, rays)
    assert float(polarised.retardance.max()) < 1e-7
    again = system_from_dict(system_to_dict(system))
    assert torch.equal(trace(again, rays).y, found.y)
    assert layout_figure(system).axes


def test_media_are_named_beside_elements_whose_axis_is_turned():
    turn = {"tilt": (45.0, 0.0, 0.0)}
    plate = [surface(material="N-BK7", thickness=-2.0), surface(thickness=-20.0)]
    fold = [coordinate_break(**turn), surface(material="mirror"), coordinate_break(thickness=-10.0, **turn)]
    first = [surface(80.0, material="N-SF11", thickness=3.0), surface(thickness=10.0)]
    figure = layout_figure(optical_system([*first, *fold, *plate], 4.0))
    names = {text.get_text(): text for text in figure.axes[0].texts}
    assert (names["N-SF11"].get_rotation(), names["N-BK7"].get_rotation()) == (90.0, 0.0)
    # The light turns upwards behind the mirror, 13 mm behind the first vertex.
    assert names["N-BK7"].xy[0] > 13 and names["N-BK7"].xy[1] == pytest.approx(11.0)
    assert figure.get_figheight() > figure.get_figwidth()


def test_an_off_axis_paraboloid_is_stigmatic():
    """A part of a paraboloid beside its axis: one point, one path; rays beside the aperture are vignetted."""
    focal, offset = 100.0, 40.0
    mirror = surface(
        -2 * focal,
        conic=-1.0,
        material="mirror",
        thickness=-focal,
        aperture=CircularAperture(radius=12.0, center=(0.0, offset)),
    )
    system = optical_system([surface(thickness=120.0), mirror], 2 * (offset + 15.0))
    found = trace_fields(system, "grid", 31)
    arrived = found.arrived
    assert 0.02 < float(arrived.double().mean()) < 0.1
    assert set(found.status.unique().tolist()) == {RayStatus.HIT, RayStatus.VIGNETTED}
    assert float(torch.where(arrived, torch.hypot(found.x, found.y), 0.0).max()) < 1e-12
    path = found.path[arrived]
    assert torch.allclose(path, torch.tensor(120.0 + focal, dtype=F64), atol=1e-11)
    assert float(wavefront(system, "grid", 21).rms) < 1e-7
    # The same by a shifted beam: a decentred stop in front of the mirror.
    shifted = optical_system(
        [
            surface(thickness=120.0, stop=True, shift=(0.0, offset)),
            surface(-2 * focal, conic=-1.0, material="mirror", thickness=-focal),
        ],
        24.0,
    )
    assert float(rms_spot(shifted)) < 1e-12
    angle = trace_fields(shifted, torch.zeros(1, 2, dtype=F64)).v.flatten()[0]
    assert abs(float(angle) + math.sin(2 * math.atan(offset / (2 * focal)))) < 1e-12


def test_pancake_optics_pass_the_same_surfaces_three_times():
    """A curved half mirror and a flat reflecting polariser: focal length R/2, rays those of the mirror alone."""
    radius, gap = 120.0, 8.0
    folded = optical_system(
        [
            surface(radius, thickness=gap),
            surface(material="mirror", thickness=-gap),
            surface(radius, material="mirror", thickness=gap),
            surface(thickness=60.0 - gap),
        ],
        10.0,
        fields=[0.0, 8.0],
    )
    properties = first_order(folded)
    assert abs(float(properties.focal_length.abs()) - 60.0) < 1e-10
    assert abs(float(properties.back_focal_distance) - (60.0 - gap)) < 1e-10
    # The flat mirror unfolded: the curved one is met from the other side, twice the gap behind.
    straight = optical_system(
        [
            surface(thickness=2 * gap),
            surface(-radius, material="mirror", thickness=-gap),
            surface(thickness=gap - 60.0),
        ],
        10.0,
        fields=[0.0, 8.0],
    )
    rays = launch(folded, "rings", 3)
    found, expected = trace(folded, rays), trace(straight, rays)
    assert torch.allclose(found.y.flatten(), expected.y.flatten(), atol=1e-11)
    assert torch.allclose(found.path.flatten(), expected.path.flatten(), atol=1e-11)


def test_a_doubly_passed_lens_with_glass():
    """A mirror behind a lens, passed back through the same faces: twice the lens's power and the mirror's."""
    index, faces, thick = 1.5, (80.0, -120.0), 1e-9
    items = [
        surface(faces[0], thickness=thick, material=index),
        surface(faces[1], thickness=thick),
        surface(-500.0, material="mirror", thickness=-thick),
        surface(faces[1], thickness=-thick, material=index),
        surface(faces[0], thickness=-10.0),
    ]
    lens = (index - 1) * (1 / faces[0] - 1 / faces[1])
    power = 2 * lens + 2 / 500.0
    assert abs(float(first_order(optical_system(items, 5.0)).focal_length) * power - 1) < 1e-6


def test_telecentric_objects_send_parallel_chief_rays(tmp_path):
    """The flag of FTYP: chief rays along the axis, cones of the same aperture; JSON and .zmx keep it."""
    lens = optical_system(
        [surface(40.0, thickness=4.0, material="N-BK7", stop=True), surface(-40.0, thickness=90.0)],
        0.05,
        "NA",
        object_distance=60.0,
        fields=[0.0, 3.0],
        telecentric=True,
    )
    rays = launch(lens, "y", 3)
    assert float(rays.v[0, :, 1].abs().max()) == 0.0
    assert torch.allclose(rays.v[0, :, 2], torch.tensor(0.05, dtype=F64), atol=1e-12)
    assert bool(torch.isinf(first_order(lens).entrance_pupil_diameter))
    write_zmx(lens, tmp_path / "lens.zmx")
    for again in (system_from_dict(system_to_dict(lens)), read_zmx(tmp_path / "lens.zmx")[0]):
        assert again.telecentric
        assert torch.allclose(trace_fields(again).y, trace_fields(lens).y, atol=1e-10)
    with pytest.raises(ValueError, match="telecentric needs a near object"):
        optical_system([surface(40.0)], 5.0, telecentric=True)
