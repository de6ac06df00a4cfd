"""A real cluster on this machine for the tests: a scheduler and two `odak worker`, each a program of its own."""

import atexit
import functools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from processes import LIMIT, wait_for

HELPERS = Path(__file__).resolve().parent
ROOT = HELPERS.parents[1]


# Runs a module, and ends when the pipe closes: with the tests, however these end.
WATCHED = """
import os, runpy, sys, threading
threading.Thread(target=lambda: (os.read(0, 1), os._exit(1)), daemon=True).start()
sys.argv = sys.argv[1:]
runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
"""


def program(*arguments, watched=True, **options):
    """Start a Python program that can import odak and the functions of the tests."""
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(HELPERS), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]),
    }
    start = ["-c", WATCHED] if watched else ["-m"]
    options = {"stdin": subprocess.PIPE, **options} if watched else options
    return subprocess.Popen([sys.executable, *start, *map(str, arguments)], env=environment, text=True, **options)


def start_scheduler(*options):
    """Start a scheduler and return its program and its address."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scheduler.json"
        where = ("--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0", "--no-dashboard")
        scheduler = program("dask", "scheduler", *where, "--scheduler-file", file, *options, stderr=subprocess.DEVNULL)
        return scheduler, json.loads(wait_for(lambda: file.exists() and file.read_text(), scheduler))["address"]


def start_workers(address, count=1, *options):
    """Let some `odak worker`, each with one process of one thread, join, and return their programs."""
    arguments = ("worker", address, "--workers", 1, "--threads", 1, *options)
    workers = [program("odak", *arguments, stdout=subprocess.PIPE) for _ in range(count)]
    try:
        for worker in workers:
            line = worker.stdout.readline()
            assert line == f"1 worker of 1 thread joined {address}; Ctrl-C to leave\n", line
    except BaseException:
        stop(*workers)
        raise
    return workers


def tls_options(folder):
    """Return the options of `dask scheduler` and of odak for the certificates in a folder."""
    files = (("--tls-ca-file", "ca.pem"), ("--tls-cert", "cert.pem"), ("--tls-key", "key.pem"))
    return tuple(part for option, name in files for part in (option, str(folder / name)))


def stop(*programs):
    """End programs, the last first."""
    for one in reversed(programs):
        one.terminate()
        try:
            one.wait(LIMIT)
        except subprocess.TimeoutExpired:
            one.kill()
            one.wait()
        for pipe in (one.stdin, one.stdout):
            if pipe:
                pipe.close()


@functools.cache
def cluster():
    """Return the address of a scheduler with two workers, the same for all tests of this process.

    Tests that use it are of one group (`xdist_group`), so that one process of pytest runs them and starts it once.
    """
    scheduler, address = start_scheduler()
    started = [scheduler]
    atexit.register(lambda: stop(*started))
    started += start_workers(address, 2)
    return address
