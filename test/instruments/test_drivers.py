"""Drivers that need no library of a maker: a screen, a video camera, files in a shared folder."""

import threading
import time

import numpy as np
import pytest

from odak import instruments
from odak.instruments import drivers


def test_a_pattern_fills_the_screen(monkeypatch):
    pygame = pytest.importorskip("pygame", reason="pygame-ce is not installed")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    modulator = instruments.ScreenModulator(8e-6, settling_time=0.0)
    try:
        assert isinstance(modulator, instruments.Modulator)
        columns, rows = pygame.display.get_desktop_sizes()[0]
        assert modulator.shape == (rows, columns)
        levels = np.random.default_rng(0).integers(256, size=modulator.shape)
        modulator.show(levels)
        shown = pygame.surfarray.array3d(pygame.display.get_surface())
        assert np.array_equal(shown, np.repeat(levels.T[..., None], 3, axis=-1))
        with pytest.raises(ValueError, match="levels must be 0 to 255"):
            modulator.show(levels + 1)
        with pytest.raises(ValueError, match="display must be below 1"):
            instruments.ScreenModulator(8e-6, display=1)
    finally:
        modulator.close()


def test_frames_of_a_video_are_captured(tmp_path):
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    path = str(tmp_path / "video.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"FFV1"), 10, (48, 32))
    frames = np.random.default_rng(0).integers(256, size=(8, 32, 48, 3), dtype=np.uint8)
    for frame in frames:
        writer.write(frame)
    writer.release()
    camera = instruments.VideoCamera(path, pitch=3e-6, skip=2)
    try:
        assert isinstance(camera, instruments.Camera) and camera.shape == (32, 48)
        # FFV1 keeps each value, but a conversion of colours may round.
        first = camera.capture(2)
        assert np.abs(first.astype(int) - frames[2:4, ..., 1]).max() <= 2
        camera.region = (4, 6, 10, 12)
        assert np.abs(camera.capture(1).astype(int) - frames[6:7, 4:14, 6:18, 1]).max() <= 2
        camera.exposure = 0.02
        assert camera.exposure == 0.02
        with pytest.raises(OSError, match="sent no frame"):
            camera.capture(1)
    finally:
        camera.close()
    with pytest.raises(OSError, match="cannot open the camera"):
        instruments.VideoCamera(str(tmp_path / "none.avi"), pitch=3e-6)


def serve(folder, table, stop):
    """Show the patterns of a folder on a simulated table and answer its requests, as another computer does."""
    shown, taken = "0", "0"
    while not stop.is_set():
        asked = drivers._text_in(folder / "pattern.txt") or "0"
        if asked != shown:
            table.modulator.show(np.load(folder / f"pattern_{asked}.npy"))
            shown = asked
            (folder / "partial.txt").write_text(asked)
            (folder / "partial.txt").replace(folder / "shown.txt")
        request = (drivers._text_in(folder / "request.txt") or "0 1 1").split()
        if request[0] != taken:
            taken, table.camera.exposure = request[0], float(request[2])
            np.save(folder / "partial.npy", table.camera.capture(int(request[1])))
            (folder / "partial.npy").replace(folder / f"capture_{taken}.npy")
        time.sleep(0.002)


def test_a_table_behind_a_folder(tmp_path):
    table, twin = (instruments.SimulatedTable(3, shape=(24, 24), camera_shape=(32, 40)) for _ in range(2))
    stop = threading.Event()
    server = threading.Thread(target=serve, args=(tmp_path, table, stop))
    server.start()
    try:
        modulator = instruments.FileModulator(tmp_path, (24, 24), 8e-6, settling_time=0)
        camera = instruments.FileCamera(tmp_path, (32, 40), 4e-6, exposure=0.02)
        assert isinstance(modulator, instruments.Modulator) and isinstance(camera, instruments.Camera)
        levels = np.random.default_rng(0).integers(256, size=(2, 24, 24))
        for pattern in levels:
            modulator.show(pattern)
            twin.modulator.show(pattern)
            twin.camera.exposure = 0.02
            assert np.array_equal(camera.capture(2), twin.camera.capture(2))
        camera.region = (1, 2, 3, 4)
        assert camera.capture().shape == (1, 3, 4)
    finally:
        stop.set()
        server.join()
    # Patterns that were shown are removed, and captures that were read.
    assert sorted(path.name for path in tmp_path.glob("*.npy")) == ["pattern_2.npy"]


def test_a_folder_that_does_not_answer(tmp_path):
    modulator = instruments.FileModulator(tmp_path, (4, 4), 8e-6, timeout=0.05)
    with pytest.raises(TimeoutError, match=r"shown\.txt' did not appear within 0\.05 s"):
        modulator.show(np.zeros((4, 4), int))
    camera = instruments.FileCamera(tmp_path, (4, 4), 8e-6, timeout=0.05)
    with pytest.raises(TimeoutError, match="capture_1"):
        camera.capture()
    np.save(tmp_path / "capture_2.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="cannot be read as captures"):
        camera.capture()
    np.save(tmp_path / "capture_3.npy", np.zeros((1, 4, 5), int))
    with pytest.raises(ValueError, match=r"must contain integers \[1, 4, 4\]"):
        camera.capture()


def test_drivers_of_the_package_are_registered():
    with pytest.raises(ValueError, match="'file-camera', 'file-modulator', 'screen', 'video'"):
        instruments.open_instrument("none")
