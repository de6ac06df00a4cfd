"""Apertures, fields, wavelengths and conjugates of systems: as objects, and as arguments of their own."""

import math
from pathlib import Path

import pytest
import torch

from odak.learn.raytracing.system import (
    Conjugates,
    Fields,
    SystemAperture,
    SystemRecord,
    Wavelengths,
    load_system,
    optical_system,
    read_len,
    read_seq,
    read_zmx,
    sample_systems,
    surface,
    trace_fields,
)
from odak.learn.raytracing.system.specification import PARTS
from odak.learn.raytracing.system.system_files import own_surfaces

FOLDER = Path(__file__).resolve().parents[5] / "shared" / "lenses"
READERS = {".zmx": read_zmx, ".seq": read_seq, ".len": read_len}
FILES = sorted(path for path in FOLDER.rglob("*") if path.suffix in READERS and path.stat().st_size < 1 << 17)
ROWS = surface(40.0, thickness=4.0, material=1.5), surface(thickness=70.0)


def lens(aperture=10.0, *form, **options):
    return optical_system([*ROWS], aperture, *form, **options)


def parts_of(system):
    return [kind(*(getattr(system, name) for name in kind.__dataclass_fields__)) for kind in PARTS]


def same(a, b):
    assert a.state_dict().keys() == b.state_dict().keys()
    for kind in PARTS:
        for name in kind.__dataclass_fields__:
            assert getattr(a, name) == getattr(b, name), name
    aim = "real" if a.at_infinity and any(max(map(abs, point)) >= 90 for point in a.fields) else "paraxial"
    first, second = (trace_fields(system, "rings", 2, aim=aim) for system in (a, b))
    assert all(torch.equal(p.nan_to_num(), q.nan_to_num()) for p, q in zip(first[:7], second[:7], strict=True))


def both_forms_agree(system):
    """Build a system again from objects and from arguments; each ray has the same bits."""
    rows, shared = own_surfaces(system), {"image": system.image, "unit": system.unit}
    aperture, fields, wavelengths, conjugates, name = parts_of(system)
    same(
        system,
        optical_system(
            rows, aperture, fields=fields, wavelengths=wavelengths, conjugates=conjugates, name=name, **shared
        ),
    )
    options = {key: value for part in parts_of(system) for key, value in vars(part).items()}
    same(system, optical_system(rows, options.pop("aperture"), options.pop("aperture_type"), **options, **shared))


@pytest.mark.parametrize("name", sample_systems())
def test_both_forms_give_same_rays(name):
    both_forms_agree(load_system(name))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_both_forms_give_same_rays_of_lens_files(path):
    try:
        found = READERS[path.suffix](path)
    except ValueError:
        pytest.skip("a file that is not read")
    both_forms_agree(found if isinstance(found, optical_system) else found[0])


def test_all_parts_of_a_system_are_arguments_of_their_own_too():
    old = lens(
        0.1,
        "NA",
        fields=[0.0, (1.0, 2.0)],
        field_weights=[1, 2],
        vignetting_factors=[(0, 0, 0, 0), (0, 0.1, 0, 0.2)],
        wavelengths=[5e-4, 6e-4],
        reference=0,
        wavelength_weights=[1, 3],
        object_distance=120.0,
        object_material=1.33,
        telecentric=True,
        afocal=True,
        name="a",
        source="b",
        settings=[("thickness", 0, [4.0, 5.0])],
    )
    new = lens(
        SystemAperture(0.1, "NA", telecentric=True),
        fields=Fields([0.0, (1.0, 2.0)], [1, 2], [(0, 0, 0, 0), (0, 0.1, 0, 0.2)]),
        wavelengths=Wavelengths([5e-4, 6e-4], 0, [1, 3]),
        conjugates=Conjugates(120.0, 1.33, afocal=True),
        name=SystemRecord("a", "b", [("thickness", 0, [4.0, 5.0])]),
    )
    same(old, new)
    assert old.reference == 0 and old.settings == (("thickness", 0, (4.0, 5.0)),) and len(old.surfaces) == 3


def test_defaults_do_not_depend_on_what_is_left_out():
    plain = lens()
    same(plain, lens(fields=None, wavelengths=None, conjugates=None, name=None))
    same(plain, lens(SystemAperture(10.0), fields=Fields(), wavelengths=Wavelengths(), conjugates=Conjugates()))
    assert plain.wavelengths == pytest.approx((587.5618e-6,)) and plain.fields == ((0.0, 0.0),)
    assert plain.object_distance == math.inf and plain.object_material == "air" and not plain.afocal


def test_arguments_beside_an_object_replace_its_own():
    given = Wavelengths([5e-4, 6e-4, 7e-4], wavelength_weights=[1, 2, 3])
    changed = lens(SystemAperture(0.1), aperture_type="NA", wavelengths=given, reference=2, object_distance=90.0)
    assert (changed.aperture_type, changed.reference, changed.object_distance) == ("NA", 2, 90.0)
    assert changed.wavelength_weights == (1.0, 2.0, 3.0) and given.reference is None


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: SystemAperture(-1.0), ValueError, "aperture must be positive"),
        (lambda: SystemAperture(1.0, "size"), ValueError, "aperture_type must be one of"),
        (lambda: SystemAperture(1.0, telecentric=True), ValueError, "telecentric needs .* got 'EPD'"),
        (lambda: SystemAperture(1.0, "NA", telecentric="no"), TypeError, "telecentric"),
        (lambda: Fields("abc"), TypeError, "fields must be a sequence"),
        (lambda: Fields([(1.0, 2.0, 3.0)]), ValueError, "fields must be numbers y or pairs"),
        (lambda: Fields([0.0, 1.0], field_weights=[0, 0]), ValueError, "field_weights must have one above 0"),
        (lambda: Fields([0.0], vignetting_factors=[(0, 0, 1, 0)]), ValueError, "vignetting_factors .*VCX and VCY"),
        (lambda: Wavelengths([5e-4, -1.0]), ValueError, "wavelengths must be positive"),
        (lambda: Wavelengths([5e-4], reference=1), ValueError, "reference must be at least 0 and below 1"),
        (lambda: Wavelengths(5e-4, wavelength_weights=[1, 2]), ValueError, "wavelength_weights must have 1 numbers"),
        (lambda: Conjugates(-5.0), ValueError, "object_distance must be positive or infinite"),
        (lambda: Conjugates(object_material="mirror"), ValueError, "object_material must be"),
        (lambda: Conjugates(object_material="N-BK"), ValueError, "object_material: "),
        (lambda: Conjugates(afocal="no"), TypeError, "afocal"),
        (lambda: SystemRecord(3), TypeError, "name must be a string"),
        (lambda: SystemRecord(source=3), TypeError, "source must be a string"),
        (lambda: lens(name=SystemRecord(settings=[("thickness", 7, [1.0])])), ValueError, "place in settings"),
        (lambda: lens(conjugates=50.0), TypeError, "conjugates must be Conjugates, got 50.0"),
        (lambda: lens(fields=3.0), TypeError, "fields must be a sequence"),
        (lambda: optical_system([*ROWS], 10.0, aperture=9.0), TypeError, "got aperture twice"),
        (lambda: optical_system([*ROWS]), TypeError, "'aperture'"),
        (lambda: lens(feilds=[0.0]), TypeError, "feilds"),
        (lambda: lens(SystemAperture(0.1, "NA", telecentric=True)), ValueError, "telecentric needs a near object"),
        (lambda: lens("F", conjugates=Conjugates(afocal=True)), TypeError, "aperture must be"),
        (
            lambda: lens(SystemAperture(4.0, "F-number"), conjugates=Conjugates(afocal=True)),
            ValueError,
            "afocal needs an aperture of the object's side .* 'F-number'",
        ),
    ],
)
def test_what_does_not_fit_is_named(make, error, message):
    with pytest.raises(error, match=message):
        make()
