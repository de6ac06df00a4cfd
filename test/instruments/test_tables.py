"""A table as far as it is known is what measurements take; the form with an argument for each part gives the same."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from odak import instruments
from odak.instruments import Lens, OpticalTable, Registration, SimulatedTable

POINTS = np.array([[-4e-5, -4e-5], [0.0, 3e-5], [5e-5, -2e-5]])
START = np.zeros((32, 32))
# Name, parts that the older form takes by position and by name, what follows the table, and options.
MEASUREMENTS = [
    (
        "measure_wavefront",
        ("phases", "registration"),
        ("amplitude",),
        (),
        {"iterations": 1, "start": START},
    ),
    ("equalise_spots", ("phases", "registration"), ("wavefront",), (POINTS,), {"turns": 1}),
    *(
        pytest.param(*call, marks=pytest.mark.slow)
        for call in (
            ("measure_phase_response", (), (), (), {"samples": 9, "captures": 1}),
            ("measure_regional_response", ("registration",), ("wavefront",), (), {"regions": (2, 1), "samples": 9}),
            ("register_camera", ("phases",), ("wavefront",), (), {"grid": (4, 4), "middle": True}),
            ("measure_distance", ("phases", "registration"), ("wavefront",), (), {"samples": 9}),
            ("measure_illumination", ("phases", "registration"), ("wavefront",), (), {"patterns": 40}),
            ("calibrate_table", (), (), (), {"rounds": 1}),
        )
    ),
]


def drawn():
    """Return a simulated table of one seed, and its truth as a table that is known."""
    hidden = SimulatedTable(1, shape=(32, 32), distance=4e-3, camera_shape=(90, 90), aberration=0.1)
    truth = hidden.truth
    mapping = Registration(truth.homography, truth.distortion, hidden.camera.shape)
    known = (truth.distance, truth.phases, mapping, truth.wavefront, truth.amplitude)
    return OpticalTable(hidden.modulator, hidden.camera, 532e-9, *known)


def values(found):
    """Return all numbers of a result."""
    if is_dataclass(found):
        return [number for field in fields(found) for number in values(getattr(found, field.name))]
    return list(found.values()) if isinstance(found, dict) else np.ravel([] if found is None else found).tolist()


@pytest.mark.filterwarnings("ignore::odak.AccuracyWarning")
@pytest.mark.parametrize(("name", "placed", "named", "others", "options"), MEASUREMENTS)
def test_parts_of_a_table_are_arguments_of_the_older_form(name, placed, named, others, options):
    measure, table, twin = getattr(instruments, name), drawn(), drawn()
    newer = measure(table, *others, **options)
    there = (twin.modulator, twin.camera, twin.wavelength, twin.distance, *others)
    by_name = {part: getattr(twin, part) for part in named}
    older = measure(*there, *(getattr(twin, part) for part in placed), **by_name, **options)
    assert values(older) == values(newer) and len(values(newer)) > 0


def test_a_part_beside_a_table_replaces_its_own():
    table = drawn()
    first = instruments.register_camera(replace(table, wavefront=0.0), captures=1)
    second = instruments.register_camera(drawn(), wavefront=0.0, captures=1)
    assert np.array_equal(first.homography, second.homography)


def test_a_calibration_is_a_table_again():
    table = drawn()
    found = instruments.Calibration.nominal(table.modulator, table.camera, 532e-9, 5e-3)
    again = replace(found, regional_phases=np.zeros((1, 2, 256))).table(table.modulator, table.camera)
    assert again.phases.shape == (1, 2, 256) and (again.wavelength, again.distance) == (532e-9, 5e-3)
    assert again.registration is found.registration and again.wavefront is found.wavefront


def test_what_a_table_lacks_is_named():
    table = drawn()
    there = (table.modulator, table.camera, "532nm", "5mm")
    bare = OpticalTable(*there)
    assert (bare.wavelength, bare.distance) == (532e-9, 5e-3)
    with pytest.raises(ValueError, match="table must have phases and registration: measure first"):
        instruments.measure_wavefront(bare)
    with pytest.raises(TypeError, match=r"register_camera has no argument 'grids'\. Did you mean 'grid'\?"):
        instruments.register_camera(table, grids=(4, 4))
    with pytest.raises(TypeError, match="register_camera takes at most 5 positional arguments, got 6"):
        instruments.register_camera(*there, table.phases, table.registration)
    with pytest.raises(TypeError, match="register_camera got phases twice"):
        instruments.register_camera(*there, table.phases, phases=table.phases)
    with pytest.raises(ValueError, match="wavelength must be positive and finite, got -1"):
        replace(table, wavelength=-1.0)
    with pytest.raises(ValueError, match="distance must be finite, got nan"):
        replace(table, distance=float("nan"))
    with pytest.raises(TypeError, match="behind a lens every pixel sends light to all places"):
        instruments.equalise_spots(replace(table, distance=Lens(0.1)), POINTS)
