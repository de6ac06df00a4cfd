"""Benches that a file describes, against benches of objects and closed forms."""

import json

import numpy as np
import pytest
from PIL import Image

from odak.wave import (
    CircularAperture,
    FreeSpace,
    ThinLens,
    bench_schema,
    gaussian_beam,
    optical_bench,
    simulate_bench,
)

BENCH = {"wavelength": "532nm", "resolution": [64, 48], "pixel_pitch": "8um"}
SOURCE, RECORD = {"kind": "plane_wave"}, {"kind": "record", "name": "here"}


def described(*elements):
    return {"bench": BENCH, "elements": [*elements, RECORD]}


def test_elements_are_those_of_a_bench_of_objects():
    elements = [
        {"kind": "gaussian_beam", "waist": "0.1mm", "power": 2.0},
        {"kind": "circular_aperture", "diameter": "0.2mm", "offset": [0, "16um"]},
        {"kind": "lens", "focal_length": "10cm"},
        {"kind": "propagate", "distance": "2cm", "method": "angular spectrum"},
    ]
    *_, record = simulate_bench(described(*elements))
    beam = gaussian_beam([64, 48], 8e-6, 532e-9, 1e-4, power=2.0)
    objects = [CircularAperture(1e-4, (0.0, 16e-6)), ThinLens(0.1), FreeSpace(0.02, "Angular Spectrum")]
    field, pitch = optical_bench(objects, 532e-9).propagate(beam, 8e-6)
    assert np.linalg.norm(record.field - field) < 1e-9 * np.linalg.norm(field) and record.pitch == pitch == 8e-6
    assert record.name == "here" and record.power == pytest.approx(np.sum(abs(field) ** 2) * 8e-6**2)


def test_shares_and_losses():
    source, slit, record = simulate_bench(
        described(SOURCE, {"kind": "rectangular_aperture", "size": ["0.04mm", "0.04mm"]})
    )
    assert source.lost is None and source.share_of_source == 1 and source.field is None
    assert slit.share_of_source == pytest.approx(25 / (64 * 48)) == record.share_of_source
    assert slit.lost["aperture"] == pytest.approx(1 - 25 / (64 * 48), abs=1e-6)


@pytest.mark.parametrize(("dtype", "levels"), [(np.uint8, 256), (np.uint16, 65536)])
def test_pictures_are_phases_and_intensities(dtype, levels, tmp_path, random):
    grey = random.integers(0, levels, (64, 48)).astype(dtype)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    passed = []
    for element in ({"kind": "slm", "pattern": "grey.png"}, {"kind": "mask", "picture": "grey.png"}):
        (tmp_path / "bench.json").write_text(json.dumps(described(SOURCE, element)))
        passed.append(simulate_bench(tmp_path / "bench.json")[-1].field)
    np.testing.assert_allclose(passed[0], np.exp(2j * np.pi * grey / levels), atol=1e-12)
    np.testing.assert_allclose(abs(passed[1]) ** 2, grey / (levels - 1), atol=1e-12)


def test_what_does_not_fit_is_named(tmp_path):
    Image.fromarray(np.zeros((4, 4), np.uint8)).save(tmp_path / "small.png")
    mask = {"kind": "mask", "picture": str(tmp_path / "small.png")}
    with pytest.raises(ValueError, match=r"must have the resolution of the field, 64 x 48 pixels; got 4 x 4"):
        simulate_bench(described(SOURCE, mask))
    with pytest.raises(ValueError, match="config not found"):
        simulate_bench(tmp_path / "none.toml")
    with pytest.raises(ValueError, match=r"element 2 \(lens\): focal_length must be a length such as"):
        simulate_bench(described(SOURCE, {"kind": "lens", "focal_length": "10 feet"}))
    with pytest.raises(TypeError, match="config must be a dict or the path of a file, got list"):
        simulate_bench([SOURCE])


def test_the_schema_names_what_is_required():
    elements = bench_schema()["properties"]["elements"]["items"]["oneOf"]
    required = {one["properties"]["kind"]["const"]: set(one["required"]) - {"kind"} for one in elements}
    assert required["lens"] == {"focal_length"} and required["gaussian_beam"] == {"waist"}
    for kind, names in required.items():
        if names:
            element = SOURCE if kind == "record" else {"kind": kind}
            with pytest.raises(ValueError, match=f"{min(names)}|needs"):
                simulate_bench({"bench": BENCH, "elements": [element, {"kind": kind}]})


def test_a_point_source_is_a_spherical_wave():
    """a·d/r·exp(ik(r − d)) around its offset along rows and columns; a source without light has no share."""
    source = {"kind": "point_source", "distance": "100mm", "offset": ["24um", "-16um"], "amplitude": 0.5}
    *_, record = simulate_bench(described(source))
    rows, columns = (np.arange(64) - 32) * 8e-6 - 24e-6, (np.arange(48) - 24) * 8e-6 + 16e-6
    r = np.sqrt(rows[:, None] ** 2 + columns**2 + 0.1**2)
    wanted = 0.5 * 0.1 / r * np.exp(2j * np.pi / 532e-9 * (r - 0.1))
    np.testing.assert_allclose(record.field, wanted, atol=1e-7)
    assert next(iter(simulate_bench(described(SOURCE | {"amplitude": 0})))).share_of_source is None


def test_colours_of_pictures_are_averaged_without_transparency(tmp_path):
    levels = np.zeros((64, 48, 4), np.uint8)
    levels[...] = 255, 0, 0, 128
    Image.fromarray(levels).save(tmp_path / "mask.png")
    mask = {"kind": "mask", "picture": str(tmp_path / "mask.png")}
    *_, record = simulate_bench(described(SOURCE, mask))
    np.testing.assert_allclose(abs(record.field) ** 2, 1 / 3)


def test_a_tilted_plane_wave_has_no_phase_on_the_axis():
    *_, record = simulate_bench(described(SOURCE | {"tilt": [0.5, -0.25]}))
    rows, columns = (np.arange(64) - 32) * 8e-6, (np.arange(48) - 24) * 8e-6
    slopes = np.sin(np.radians([0.5, -0.25]))
    wanted = np.exp(2j * np.pi / 532e-9 * (slopes[0] * rows[:, None] + slopes[1] * columns))
    np.testing.assert_allclose(record.field, wanted, atol=1e-9)


@pytest.mark.parametrize("wrong", [{"pixel_pitch": 0}, {"resolution": [64, 48.5]}, {"resolution": [0, 48]}])
def test_benches_without_extent_are_refused(wrong):
    with pytest.raises(ValueError, match=min(wrong)):
        simulate_bench({"bench": BENCH | wrong, "elements": [SOURCE, RECORD]})
