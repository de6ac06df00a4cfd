"""Runs the driver inside Blender: files in, a file out."""

import collections
import os
import re
import shutil
import subprocess
import tempfile
import threading

import numpy as np
from tqdm import tqdm

from odak import _validate
from odak.log import logger
from odak.tools._atomic import replacing
from odak.tools._commands import _kill_with_children
from odak.visualize.blender import scene_files
from odak.visualize.blender.locate import BlenderError, find_blender

DRIVER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "driver.py")
TAIL = 25
_SAMPLE = re.compile(r"Sample (\d+)/(\d+)")
LIBRARIES = (
    "A library of the system is missing. On Debian and Ubuntu: apt-get install libx11-6 libxrender1 libxfixes3 libxi6 "
    "libxkbcommon0 libgl1 libsm6 libice6 libxext6 libegl1"
)


def run_for_file(document: dict, path: str, blender, timeout, verbose: bool) -> str:
    """Let Blender make a file of a scene and move it to its place when it is whole; return the path."""
    if not os.path.isdir(os.path.dirname(path)):
        raise ValueError(f"Folder {os.path.dirname(path)!r} does not exist")
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, os.path.splitext(path)[1].lower(), blender, timeout, verbose)
        with open(made, "rb") as source, replacing(path) as target:
            shutil.copyfileobj(source, target)
    return path


def run_for_array(document: dict, blender, timeout, verbose: bool) -> np.ndarray:
    """Let Blender render a scene; return linear light and opacity, float32 ``[rows, columns, 4]``, row 0 at the top."""
    with tempfile.TemporaryDirectory(prefix="odak_blender_") as folder:
        made = _run(document, folder, ".raw", blender, timeout, verbose)
        pixels = np.fromfile(made, dtype="<f4")
    rows, columns = document["render"]["resolution"]
    return pixels.reshape(rows, columns, 4)[::-1].astype(np.float32)


def _run(document: dict, folder: str, extension: str, blender, timeout, verbose: bool) -> str:
    timeout = None if timeout is None else float(_validate.real("timeout", timeout, positive=True))
    found = find_blender(blender)
    written = scene_files.write(os.path.join(folder, "scene.json"), document)
    made = os.path.join(folder, f"out{extension}")
    command = found.command(DRIVER, written, made)
    logger.info("Blender: %s", " ".join(command))
    process = subprocess.Popen(
        command,
        cwd=folder,
        env=found.environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    )
    tails = _follow(process, timeout, verbose, document["render"]["samples"])
    if process.returncode or not os.path.exists(made):
        raise BlenderError(_complaint(found, process.returncode, tails))
    return made


def _follow(process, timeout, verbose: bool, samples: int) -> list[collections.deque]:
    """Wait for a process, log what it writes and show its progress; return the last lines of its output and errors."""
    tails: list[collections.deque] = [collections.deque(maxlen=TAIL) for _ in range(2)]
    with tqdm(total=samples, desc="Blender", unit="sample", disable=not verbose, leave=False) as bar:
        readers = [
            threading.Thread(target=_read, args=(stream, tail, bar), daemon=True)
            for stream, tail in zip((process.stdout, process.stderr), tails, strict=True)
        ]
        for reader in readers:
            reader.start()
        try:
            process.wait(timeout)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"Blender was stopped after {timeout:g} s; timeout=None waits for ever") from None
        finally:
            if process.poll() is None:
                _kill_with_children(process)
                process.wait()
            for reader in readers:
                reader.join()
            process.stdout.close()
            process.stderr.close()
    return tails


def _read(stream, tail: collections.deque, bar) -> None:
    for line in stream:
        line = line.rstrip()
        if not line:
            continue
        tail.append(line)
        if line.startswith("odak: "):
            logger.warning("Blender: %s", line[6:])
            continue
        logger.debug("Blender: %s", line)
        if sample := _SAMPLE.search(line):
            bar.update(max(int(sample[1]) - bar.n, 0))


def _complaint(found, code: int, tails) -> str:
    output, errors = ("\n".join(tail) for tail in tails)
    said = errors or output or "(it wrote nothing)"
    hint = f"\n{LIBRARIES}" if "cannot open shared object file" in said else ""
    end = f"exit code {code}" if code else "without a result"
    return f"Blender ({found.path}) failed, {end}. It wrote last:\n{said}{hint}"
