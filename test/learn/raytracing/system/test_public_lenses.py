"""Public Zemax files beside the project: all are read, and agree with a second opinion on them."""

import json
from pathlib import Path

import pytest
import torch

from odak.learn.raytracing.system import first_order, read_zmx, rms_spot

FOLDER = Path(__file__).resolve().parents[5] / "shared" / "lenses"
EXPECTED = json.loads((FOLDER / "expected.json").read_text()) if (FOLDER / "expected.json").is_file() else {}
# Files in inches are read as millimetres, and a glass that only its index and Abbe number describe differs at 1.55 µm.
SCALES = {"circular_aperture_example_with_aperture.zmx": 25.4}
TOLERANCES = {"354710-C-Zemax(ZMX).zmx": 5e-3}
pytestmark = pytest.mark.skipif(not EXPECTED, reason="no folder of public lenses beside the project")


@pytest.mark.parametrize("name", sorted(EXPECTED) or ["none"])
def test_a_public_file_is_read(name):
    system, report = read_zmx(FOLDER / name)
    assert len(system.surfaces) >= 1 and system.wavelengths
    assert all(isinstance(text, str) and text for text in report.ignored)
    with torch.no_grad():
        assert bool(torch.isfinite(first_order(system).focal_length)) or "mirror" in name or "grating" in name


FOCAL = {name: entry["efl"] for name, entry in EXPECTED.items() if entry.get("efl")}


@pytest.mark.parametrize("name", sorted(FOCAL) or ["none"])
def test_its_focal_length_is_that_of_the_second_opinion(name):
    system, _ = read_zmx(FOLDER / name)
    primary = EXPECTED[name]["primary_um"] / 1000
    with torch.no_grad():
        found = float(first_order(system, wavelength=primary).focal_length)
        sizes = rms_spot(system, "rings", 6)
    expected = abs(FOCAL[name]) * SCALES.get(name, 1.0)
    assert abs(found) == pytest.approx(expected, rel=TOLERANCES.get(name, 1e-3))
    assert sizes.shape == (len(system.fields),)
