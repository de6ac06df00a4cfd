"""A simulated table behind a folder, as the program of another computer serves one."""

import contextlib
import threading
import time

import numpy as np

from odak.instruments import drivers


@contextlib.contextmanager
def served(folder, table):
    """Show the patterns of a folder on a simulated table and answer its requests, as long as the context lasts."""
    stop = threading.Event()
    server = threading.Thread(target=_serve, args=(folder, table, stop))
    server.start()
    try:
        yield
    finally:
        stop.set()
        server.join()


def _serve(folder, table, stop):
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
