"""What the protocols promise, of the simulated instruments and of real ones that environment variables name.

ODAK_TEST_SLM and ODAK_TEST_CAMERA hold the name of a driver and, after a space, its arguments as JSON. A real camera
must see light; with both, that of the modulator.
"""

import json
import os

import pytest

from odak import instruments


def opened(variable):
    """Return the instrument that an environment variable names; skip the test if there is none."""
    name, _, options = os.environ.get(variable, "").strip().partition(" ")
    if not name:
        pytest.skip(f"{variable} names no driver")
    return instruments.open_instrument(name, **json.loads(options or "{}"))


@pytest.mark.filterwarnings("ignore::odak.AccuracyWarning")
@pytest.mark.parametrize("kind", ["simulated", "modulator", "camera", "both"])
def test_instruments_do_what_their_protocols_say(kind):
    table, found = instruments.SimulatedTable(1, shape=(24, 32), camera_shape=(32, 40)), {}
    if kind == "simulated":
        found = {"camera": table.camera, "modulator": table.modulator}
    try:
        if kind in ("modulator", "both"):
            found["modulator"] = opened("ODAK_TEST_SLM")
        if kind in ("camera", "both"):
            found["camera"] = opened("ODAK_TEST_CAMERA")
        findings = instruments.check_instruments(**found, captures=30)
        assert not [finding for finding in findings if finding.passed is False]
    finally:
        for instrument in found.values():
            getattr(instrument, "close", lambda: None)()
