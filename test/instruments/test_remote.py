"""Instruments of another computer, here of another process, over TLS."""

from dataclasses import replace

import numpy as np
import pytest
from shared_folder import served

from odak import instruments
from odak.manager import make_certificates, start_server

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow
SHAPE, CAMERA = (32, 32), (48, 48)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    certificates = make_certificates(tmp_path_factory.mktemp("remote") / "certificates")
    with start_server(port=0, workers=1, threads=1, name="bench", security=certificates) as server:
        yield {"address": server.address, "security": certificates}


def test_a_table_of_another_computer_is_measured_as_one_here(server, tmp_path):
    table, twin = (instruments.SimulatedTable(1, shape=SHAPE, distance=4e-3, camera_shape=CAMERA) for _ in range(2))
    sizes = {"folder": str(tmp_path)}
    panel = {"shape": SHAPE, "pitch": 8e-6, "settling_time": 0} | sizes
    sensor = {"shape": CAMERA, "pitch": 4e-6, "bits": twin.camera.bits, "exposure": twin.camera.exposure} | sizes
    # A client of the user's own is none of the instruments' business.
    with (
        distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        served(tmp_path, table),
        instruments.open_remote(driver="file-modulator", options=panel, **server) as modulator,
        instruments.open_remote(driver="file-camera", options=sensor, worker="bench-0", **server) as camera,
    ):
        assert isinstance(modulator, instruments.SLMDriver) and isinstance(camera, instruments.Camera)
        assert not hasattr(camera, "show")
        assert repr(camera) == f"RemoteCamera('file-camera' at {server['address']})"
        known = instruments.OpticalTable(modulator, camera, twin.wavelength, twin.truth.distance)
        phases = instruments.measure_phase_response(known, samples=8)
        here = replace(known, modulator=twin.modulator, camera=twin.camera)
        # The folder has no limits of the exposure: their noise is another, of a milliradian in each.
        assert np.abs(phases - instruments.measure_phase_response(here, samples=8)).max() < 4e-3
        camera.region = (1, 2, 3, 4)
        assert camera.region == (1, 2, 3, 4) and camera.capture().shape == (1, 3, 4)
        # What the driver raises, and what no answer within the time means.
        with pytest.raises(ValueError, match=r"levels must be integers \[32, 32\], got uint8 \[4, 4\]"):
            modulator.show(np.zeros((4, 4), np.uint8))
        with pytest.raises(ValueError, match="exposure must be positive"):
            instruments.open_remote(driver="file-camera", options=sensor | {"exposure": -1.0}, **server)
        camera._timeout = 0.01
        with pytest.raises(TimeoutError, match=r"'file-camera' at .* has not answered within 0\.01 s"):
            camera.capture(500)
        camera._timeout = 60
    camera.close()
    with pytest.raises(ConnectionError, match=f"'file-camera' at {server['address']} is closed, or its worker"):
        camera.bits  # noqa: B018 - asks for it


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"driver": "nothing"}, ValueError, "name must be one of the installed drivers"),
        ({"worker": "attic"}, ValueError, r"worker must be the name of one of the workers \(bench-0\), got 'attic'"),
        ({"address": "tcp://10.0.0.1:8786"}, ValueError, "address .* over plain TCP everybody"),
        ({"options": ["pitch"]}, TypeError, "options must be a mapping"),
        ({"timeout": 0}, ValueError, "timeout must be positive"),
    ],
)
def test_what_cannot_be_opened_is_named(server, change, error, message):
    with pytest.raises(error, match=message):
        instruments.open_remote(**{"driver": "file-camera", **server} | change)
