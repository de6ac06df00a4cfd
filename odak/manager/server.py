"""The machines' side: a scheduler on this machine, and workers that join one.

Workers run in a program of their own (this module as ``python -m``), which starts one process per worker, gives each
its share of cores, memory and GPUs, and starts anew the ones that die. So a script needs no ``if __name__ ==
"__main__":`` to use them, and the environment of the user's process stays as it is.
"""

import logging
import os
import pickle
import subprocess
import sys
import tempfile
import time
import weakref
from typing import Any

from odak import _validate
from odak.log import logger
from odak.manager.machine import Share, require_dask

__all__ = ["Server", "start_server"]

LOOPBACK = "127.0.0.1"
_PATIENCE = 5.0


def start_server(
    address: str | None = None,
    *,
    host: str = LOOPBACK,
    port: int = 8786,
    workers: int | None = None,
    threads: int | None = None,
    memory_limit: int | None = None,
    name: str | None = None,
    security: Any = None,
    timeout: float = 60.0,
) -> "Server":
    """Let this machine work: for a scheduler on another machine, or with a scheduler of its own.

    Parameters
    ----------
    address : str, optional
        Address of a scheduler to work for, such as "tcp://10.0.0.1:8786"; by default one is started here.
    host : str
        Address of this machine that a scheduler started here listens on. "127.0.0.1" keeps it to this machine;
        "0.0.0.0" opens it to every network.
    port : int
        Port of a scheduler started here; 0 takes a free one.
    workers : int, optional
        Worker processes. By default one per GPU, on machines without one per core.
    threads : int, optional
        Threads that each worker's numerical libraries use; by default the cores shared evenly.
    memory_limit : int, optional
        Bytes that each worker may take before it is started anew; by default the memory shared evenly.
    name : str, optional
        Name of the workers, a number is added to it.
    security : distributed.Security or True, optional
        TLS certificates; True makes temporary ones for a scheduler started here (with the package `cryptography`).
    timeout : float
        Seconds that the workers may take to join.

    Returns
    -------
    Server
        To be closed, or used in a ``with`` statement.

    Raises
    ------
    ImportError
        If Dask is not installed.
    ValueError, TypeError
        If an argument is outside its range.
    OSError
        If the scheduler cannot be reached, or workers do not start in time.

    Notes
    -----
    Whoever reaches a scheduler runs code on its workers, with the rights of the user who started them. Open one only to
    machines that you trust, or use TLS.
    """
    require_dask("start_server")
    _validate.real("timeout", timeout, positive=True)
    share = Share(workers, threads, memory_limit, name)
    if address is not None:
        return Server(None, _Workers(str(address), share, security, timeout))
    cluster = _scheduler(host, _validate.integer("port", port), security)
    try:
        return Server(cluster, _Workers(cluster.scheduler_address, share, cluster.security, timeout))
    except BaseException:
        cluster.close()
        raise


class Server:
    """What :func:`start_server` started on this machine.

    Attributes
    ----------
    address : str
        Address of the scheduler.
    cluster : distributed.LocalCluster
        The scheduler, None if it is somewhere else.
    """

    def __init__(self, cluster: Any, workers: "_Workers") -> None:
        self.cluster, self._workers = cluster, workers
        self.address = workers.address
        try:
            workers.wait()
        except BaseException:
            workers.close()
            raise
        # Also when nobody calls close(): at the end of the program at the latest.
        self._end = weakref.finalize(self, _close, workers, cluster)

    def alive(self) -> bool:
        """Return whether the program that holds the workers runs."""
        return self._workers.alive()

    def close(self) -> bool:
        """End the workers, and the scheduler if it was started here."""
        self._end()
        return True

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *_) -> None:
        self.close()


def _close(workers: "_Workers", cluster: Any) -> None:
    if cluster is not None:
        cluster.close()
    workers.close()


def _scheduler(host: str, port: int, security: Any):
    import distributed

    return distributed.LocalCluster(
        n_workers=0,
        processes=False,
        protocol="tls://" if security else "tcp://",
        host=host,
        scheduler_port=port,
        silence_logs=logging.ERROR,
        security=security,
        # The page of diagnostics is left out, and what is served over HTTP besides takes a free port of the same host.
        scheduler_kwargs={"dashboard": False, "dashboard_address": f"{host}:0"},
    )


class _Workers:
    """The program that holds this machine's workers, as a child of this process."""

    def __init__(self, address: str, share: Share, security: Any, timeout: float) -> None:
        self.address, self._timeout = address, timeout
        self._ready = tempfile.TemporaryDirectory(prefix="odak-workers-")
        self._said = open(os.path.join(self._ready.name, "stderr"), "w+b")  # noqa: SIM115 - closed in close()
        settings = {"address": address, "share": share, "security": security, "ready": self._mark, "timeout": timeout}
        self._program = subprocess.Popen(
            [sys.executable, "-m", "odak.manager.server"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._said,
            # Ctrl-C is for the user's program, which may go on; this one ends with it, or when it is told to.
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)},
        )
        # The pipe stays open: its end tells the program that this process is gone, however it ended.
        stdin: Any = self._program.stdin
        stdin.write(pickle.dumps(settings))
        stdin.flush()

    @property
    def _mark(self) -> str:
        return os.path.join(self._ready.name, "ready")

    def alive(self) -> bool:
        return self._program.poll() is None

    def wait(self) -> None:
        """Wait until all workers have joined."""
        end = time.monotonic() + self._timeout
        while not os.path.exists(self._mark):
            if not self.alive() or time.monotonic() > end:
                self._said.seek(0)
                said = self._said.read().decode(errors="replace").strip().splitlines()[-5:]
                reason = f"within {self._timeout:g} s" if self.alive() else f"(exit code {self._program.returncode})"
                raise OSError(
                    f"Workers could not join {self.address} {reason}: {' / '.join(said) or 'nothing was said'}"
                )
            time.sleep(0.02)

    def close(self) -> None:
        stdin: Any = self._program.stdin
        if stdin.closed:
            return
        stdin.close()
        try:
            self._program.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            logger.warning("Workers of %s did not end within %g s and are killed", self.address, _PATIENCE)
            self._program.kill()
            self._program.wait()
        self._said.close()
        self._ready.cleanup()


def _main() -> None:
    from odak.manager.machine import work

    work(**pickle.load(sys.stdin.buffer), until_closed=sys.stdin.buffer)


if __name__ == "__main__":
    _main()
