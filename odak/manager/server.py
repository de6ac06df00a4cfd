"""Worker processes of this machine, a scheduler for them, and the addresses and certificates that they use.

A separate program holds the workers: it starts one process per worker, assigns it its share of cores, memory and
GPUs, and replaces processes that end. A script therefore needs no ``if __name__ == "__main__":`` to use them, and the
environment of the user's process stays as it is.
"""

import asyncio
import datetime
import importlib.util
import ipaddress
import json
import logging
import os
import pickle
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from odak import _validate
from odak._python import python_command
from odak._warnings import OdakWarning, warn
from odak.manager.tasks import thread_variables
from odak.tools.file import check_directory
from odak.tools.paths import replacing, write_file

LOOPBACK = "127.0.0.1"
GPU = "GPU"
_ENCRYPTED = ("tls", "wss")
_CERTIFICATES = ("ca.pem", "cert.pem", "key.pem")
_PATIENCE, _START = 30.0, 30.0
# Results are fetched as soon as they are complete: a worker that paused at 80 % of its memory would never continue.
# Dask's profiler, which looks at every task a hundred times a second, takes up to a fifth of a core.
_IN_MEMORY = (
    "distributed.worker.memory.target",
    "distributed.worker.memory.spill",
    "distributed.worker.memory.pause",
)
_PROFILER = "distributed.worker.profile.enabled"


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
    trusted_network: bool = False,
    timeout: float = 60.0,
) -> "Server":
    """Start workers on this machine, for a scheduler elsewhere or for one that is started with them.

    Parameters
    ----------
    address : str, optional
        Address of a scheduler to work for, such as "tls://10.0.0.1:8786"; by default one is started here.
    host : str
        Address of this machine that a scheduler started here listens on. "127.0.0.1" keeps it to this machine;
        "0.0.0.0" means all networks of this machine. Anything beyond this machine needs `security`.
    port : int
        Port of a scheduler started here; 0 takes a free one.
    workers : int, optional
        Worker processes. By default one per GPU, on machines without one per core.
    threads : int, optional
        Threads that each worker's numerical libraries use; by default the cores shared evenly.
    memory_limit : int, optional
        Memory in bytes beyond which a worker is restarted; by default the memory of the machine shared evenly.
    name : str, optional
        Name of the workers; a number is added to it.
    security : distributed.Security, path or True, optional
        TLS certificates: Dask's own object, or a folder with the files ``ca.pem``, ``cert.pem`` and ``key.pem``, as
        :func:`make_certificates` writes them. True makes temporary ones, for a scheduler started here that only this
        program reaches.
    trusted_network : bool
        Accept unencrypted TCP to other machines. Anybody who can connect to the scheduler or to a worker can then run
        code on this machine.
    timeout : float
        Longest time in seconds to wait for the workers to join.

    Returns
    -------
    Server
        The workers and the scheduler; close it, or use it in a ``with`` statement.

    Raises
    ------
    ImportError
        If Dask is not installed.
    ValueError, TypeError
        If an argument is outside its range, or plain TCP would reach beyond this machine.
    OSError
        If the scheduler cannot be reached, or workers do not start in time.

    Notes
    -----
    Anybody who can connect to a scheduler can run code on its workers, with the rights of the user who started them. A
    scheduler listens on `host` alone. A worker listens on the one address of this machine from which it connects to the
    scheduler, which is 127.0.0.1 for a scheduler on 127.0.0.1.

    Examples
    --------
    >>> from odak.manager import start_server
    >>> with start_server(port=0, workers=1, threads=1) as server:
    ...     server.workers, server.alive()
    (1, True)
    """
    require_dask("start_server")
    _validate.real("timeout", timeout, positive=True)
    share = Share(workers, threads, memory_limit, name)
    security = load_security(security)
    if address is not None:
        check_transport("address", address, trusted_network)
        return Server(None, _Workers(str(address), share, security, timeout))
    if not security:
        check_transport("host", host, trusted_network)
    return serve(share, host, _validate.integer("port", port), security, timeout)


def serve(share: "Share", host: str = LOOPBACK, port: int = 0, security: Any = None, timeout: float = 60.0) -> "Server":
    """Start a scheduler and workers on this machine; see :func:`start_server`, which checks the arguments."""
    cluster = _scheduler(host, port, security)
    try:
        return Server(cluster, _Workers(cluster.scheduler_address, share, cluster.security, timeout))
    except BaseException:
        cluster.close()
        raise


class Server:
    """Worker processes of this machine, and their scheduler if it was started here; made by :func:`start_server`.

    Parameters
    ----------
    cluster : distributed.LocalCluster or None
        The scheduler, None if it is on another machine.
    workers : object
        The worker processes.

    Attributes
    ----------
    address : str
        Address of the scheduler.
    cluster : distributed.LocalCluster
        The scheduler, None if it is somewhere else.

    Examples
    --------
    >>> from odak.manager import start_server
    >>> server = start_server(port=0, workers=1, threads=1)
    >>> server.address.startswith("tcp://127.0.0.1:")
    True
    >>> server.close()
    True
    """

    workers: int
    threads: int
    gpus: int

    def __init__(self, cluster: Any, workers: "_Workers") -> None:
        self._workers = workers
        self.cluster: Any = cluster
        self.address: str = workers.address
        try:
            self.workers, self.threads, self.gpus = workers.wait_until_joined()
        except BaseException:
            workers.close()
            raise
        # Also when nobody calls close(): at the end of the program at the latest.
        self._end = weakref.finalize(self, _close, workers, cluster)

    def alive(self) -> bool:
        """Return whether the program that holds the workers runs."""
        return self._workers.alive()

    def wait(self) -> None:
        """Wait until the workers have ended, which they do when their scheduler ends."""
        while self.alive():
            time.sleep(0.1)

    def close(self) -> bool:
        """End the workers, and the scheduler if it was started here."""
        self._end()
        return True

    def __enter__(self) -> "Server":
        return self

    def __exit__(self, *_: Any) -> None:
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
        # The page of diagnostics is left out; the rest of what is served over HTTP stays on this machine.
        scheduler_kwargs={"dashboard": False, "dashboard_address": f"{LOOPBACK}:0"},
    )


class _Workers:
    """The program that holds this machine's workers, as a child of this process."""

    def __init__(self, address: str, share: "Share", security: Any, timeout: float) -> None:
        self.address, self._timeout = address, timeout
        self._folder = tempfile.TemporaryDirectory(prefix="odak-workers-")
        self._joined = Path(self._folder.name, "joined")
        self._errors = open(Path(self._folder.name, "stderr"), "w+b")  # noqa: SIM115 - closed in close()
        settings = (address, share, security, str(self._joined), timeout)
        self._program = subprocess.Popen(
            python_command("from odak.manager.server import _hold; _hold()"),
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            # Ctrl-C interrupts the user's program, which may continue; this one ends with it, or on request.
            start_new_session=True,
        )
        # The pipe stays open: when it closes, the program knows that this process has ended, for whatever reason.
        stdin: Any = self._program.stdin
        stdin.write(pickle.dumps(settings))
        stdin.flush()

    def alive(self) -> bool:
        """Return whether the process that holds the workers is running."""
        return self._program.poll() is None

    def wait_until_joined(self) -> tuple[int, int, int]:
        """Return how many workers there are, the threads of each, and how many have a GPU, once all have joined."""
        # The program observes the limit itself once it runs.
        end = time.monotonic() + self._timeout + _START
        while not self._joined.exists():
            if not self.alive() or time.monotonic() > end:
                self._errors.seek(0)
                said = self._errors.read().decode(errors="replace").strip().splitlines()[-1:]
                reason = f"within {self._timeout:g} s" if self.alive() else "; ".join(said) or "the program ended"
                raise OSError(f"Workers cannot join {self.address}: {reason}")
            time.sleep(0.02)
        return tuple(json.loads(self._joined.read_text()))

    def close(self) -> None:
        """End the process and its workers; they are killed if they do not end in time."""
        stdin: Any = self._program.stdin
        if stdin.closed:
            return
        stdin.close()
        killed = False
        try:
            self._program.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            killed = True
            self._program.kill()
            self._program.wait()
        self._errors.close()
        self._folder.cleanup()
        # Last, because a warning may be an error.
        if killed:
            warn(f"Workers of {self.address} did not end within {_PATIENCE:g} s and were killed", OdakWarning)


def require_dask(what: str) -> None:
    """Raise ImportError, with the line that installs Dask, where it is missing."""
    if not has_dask():
        raise ImportError(f"{what} needs Dask, which is not installed: pip install 'dask[distributed]'")


def has_dask() -> bool:
    """Return whether Dask's scheduler is installed."""
    return importlib.util.find_spec("distributed") is not None


# --- Addresses and certificates


def check_transport(name: str, address: str, trusted_network: bool) -> None:
    """Raise ValueError for an address beyond this machine without encryption, unless the network is trusted."""
    _validate.flag("trusted_network", trusted_network)
    scheme, _, place = str(address).rpartition("://")
    if scheme in _ENCRYPTED or scheme == "inproc" or trusted_network or _is_loopback(place):
        return
    raise ValueError(
        f"{name} {address!r} is not an address of this machine only, and over plain TCP everybody who can connect can "
        "run code here. Use TLS certificates (security=, and an address that begins with tls://), or set "
        "trusted_network=True if nobody else is on that network"
    )


def _is_loopback(place: str) -> bool:
    host = place[1:].partition("]")[0] if place.startswith("[") else place
    host = host.rpartition(":")[0] if host.count(":") == 1 else host
    try:
        found = {str(entry[4][0]).partition("%")[0] for entry in socket.getaddrinfo(host or "0.0.0.0", None)}
    except OSError:
        return False
    return all(ipaddress.ip_address(entry).is_loopback for entry in found)


def load_security(security: Any) -> Any:
    """Convert a folder of certificates to Dask's security object; return anything else unchanged."""
    if not isinstance(security, (str, os.PathLike)):
        return security
    files = [Path(security).expanduser() / name for name in _CERTIFICATES]
    missing = [path.name for path in files if not path.is_file()]
    if missing:
        raise ValueError(
            f"security must be a folder with {', '.join(_CERTIFICATES)}; {str(security)!r} lacks {', '.join(missing)}"
        )
    return tls_security(*map(str, files))


def tls_security(ca_file: str, cert: str, key: str) -> Any:
    """Return Dask's security object for PEM files that all roles use, with encryption required."""
    from distributed import Security

    roles = ("client", "scheduler", "worker")
    return Security(
        tls_ca_file=ca_file,
        require_encryption=True,
        **{f"tls_{role}_cert": cert for role in roles},
        **{f"tls_{role}_key": key for role in roles},
    )


def make_certificates(folder: str | os.PathLike[str], days: int = 365) -> Path:
    """Make TLS certificates for a cluster. Only those who hold them can run code on it.

    Writes ``ca.pem`` (the certificate of an authority that signs nothing else), ``cert.pem`` and ``key.pem``. Copy the
    folder to each machine, and give it as ``security=`` to :func:`start_server` and :class:`agent`, or its files as
    ``--tls-ca-file``, ``--tls-cert`` and ``--tls-key`` to ``odak worker``, ``odak hologram`` and ``dask scheduler``.

    Parameters
    ----------
    folder : path
        Folder to write to, created if it does not exist. Existing files are never replaced.
    days : int
        Number of days for which the certificates are valid.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    ImportError
        If the package cryptography is not installed.
    ValueError
        If the folder holds certificates already.

    Examples
    --------
    >>> import tempfile
    >>> from odak.manager import make_certificates
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     sorted(path.name for path in make_certificates(folder).iterdir())
    ['ca.pem', 'cert.pem', 'key.pem']
    """
    _validate.integer("days", days, minimum=1)
    folder = Path(folder).expanduser()
    existing = [name for name in _CERTIFICATES if (folder / name).exists()]
    if existing:
        raise ValueError(f"folder {str(folder)!r} holds {', '.join(existing)} already; certificates are not replaced")
    told = "make_certificates needs the package cryptography: pip install cryptography"
    x509 = _validate.optional("cryptography.x509", told)
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import NameOID

    def signed(name: str, public_key, issuer: str, issuer_key, *, authority: bool):
        now = datetime.datetime.now(datetime.timezone.utc)
        subject, signer = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)]) for text in (name, issuer))
        return (
            x509.CertificateBuilder(signer, subject, public_key, x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(hours=1))
            .not_valid_after(now + datetime.timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer_key.public_key()), critical=False)
            .sign(issuer_key, hashes.SHA256())
        )

    # The authority's key signs one certificate and is not stored.
    authority_key, key = (ec.generate_private_key(ec.SECP256R1()) for _ in range(2))
    authority = signed("odak cluster authority", authority_key.public_key(), "odak cluster authority", authority_key,
                       authority=True)  # fmt: skip
    certificate = signed("odak cluster", key.public_key(), "odak cluster authority", authority_key, authority=False)
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    check_directory(str(folder), validate=False)
    for name, content in zip(
        _CERTIFICATES, (*(part.public_bytes(serialization.Encoding.PEM) for part in (authority, certificate)), private),
        strict=True,
    ):  # fmt: skip
        with replacing(str(folder / name)) as stream:
            if hasattr(os, "fchmod"):
                os.fchmod(stream.fileno(), 0o600)
            stream.write(content)
    return folder


# --- The machine, and the program that holds its workers


@dataclass(frozen=True)
class Share:
    """How a machine is divided among its workers.

    Attributes
    ----------
    workers : int, optional
        Worker processes; one per GPU, or one per core where there is none.
    threads : int, optional
        Threads of each; the cores shared evenly.
    memory_limit : int, optional
        Bytes for each; the memory shared evenly.
    name : str, optional
        Name of the workers.
    spill : str, optional
        Folder that takes what does not fit in memory; workers keep all in memory without one.
    """

    workers: int | None = None
    threads: int | None = None
    memory_limit: int | None = None
    name: str | None = None
    spill: str | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        for name in ("workers", "threads", "memory_limit"):
            if getattr(self, name) is not None:
                _validate.integer(name, getattr(self, name), minimum=1)

    def parts(self) -> list[dict[str, Any]]:
        """Return the settings of each worker on this machine, as arguments of a Dask nanny."""
        from distributed.system import MEMORY_LIMIT

        gpus = visible_gpus()
        count = self.workers or len(gpus) or cores()
        threads = self.threads or max(1, cores() // count)
        parts = []
        for index in range(count):
            gpu = gpus[index] if index < len(gpus) else None
            environment = thread_variables(threads)
            if gpus:
                environment["CUDA_VISIBLE_DEVICES"] = gpu or ""
            parts.append(
                {
                    "nthreads": 1,
                    "memory_limit": self.memory_limit or int(MEMORY_LIMIT / count),
                    "name": None if self.name is None else f"{self.name}-{index}",
                    **({} if self.spill is None else {"local_directory": self.spill}),
                    "resources": {GPU: 1} if gpu else None,
                    "env": environment,
                    "silence_logs": logging.ERROR,
                    "dashboard": False,
                    "dashboard_address": f"{LOOPBACK}:0",
                }
            )
        return parts


def cores() -> int:
    """Return the number of cores that this process may use."""
    from dask.system import CPU_COUNT

    return CPU_COUNT


def visible_gpus() -> list[str]:
    """Return the names by which CUDA_VISIBLE_DEVICES selects each CUDA device of this machine."""
    if not (shutil.which("nvidia-smi") or os.path.exists("/proc/driver/nvidia")):
        return []
    import torch

    count = torch.cuda.device_count()
    named = [name.strip() for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name.strip()]
    return named[:count] if named else [str(index) for index in range(count)]


def _hold() -> None:
    """Hold this machine's workers: the program that :func:`start_server` starts."""
    import dask
    import distributed  # noqa: F401 - sets the level of its log, which is set again below

    address, share, security, joined, timeout = pickle.load(sys.stdin.buffer)
    logging.getLogger("distributed").setLevel(logging.ERROR)
    off = dict.fromkeys([_PROFILER, *(_IN_MEMORY if share.spill is None else ())], False)
    with dask.config.set({"distributed.comm.timeouts.connect": timeout, **off}):
        try:
            asyncio.run(_work(address, share.parts(), security, joined))
        except OSError as error:
            raise SystemExit(" ".join(str(error).split())) from None


async def _work(address: str, parts: list[dict[Any, Any]], security: Any, joined: str) -> None:
    from distributed import Nanny
    from distributed.comm import get_address_host
    from distributed.utils import get_ip

    stop = asyncio.Event()
    _stop_on_signals(stop)
    _stop_at_end(sys.stdin.buffer, stop)
    try:
        # Without `host`, a worker would listen on every network of this machine.
        host = get_ip(get_address_host(address))
    except OSError as error:
        raise OSError(f"there is no network on which {address} could be reached: {error}") from None
    nannies = [Nanny(address, security=security, host=host, **part) for part in parts]
    started = asyncio.gather(*nannies)
    asked = asyncio.create_task(stop.wait())
    try:
        first: list[asyncio.Future] = [started, asked]
        await asyncio.wait(first, return_when=asyncio.FIRST_COMPLETED)
        if started.done():
            await _check_joined(started)
            threads, gpus = int(parts[0]["env"]["OMP_NUM_THREADS"]), sum(bool(part["resources"]) for part in parts)
            write_file(joined, json.dumps([len(parts), threads, gpus]).encode())
            gone = asyncio.gather(*(nanny.finished() for nanny in nannies))
            last: list[asyncio.Future] = [gone, asked]
            await asyncio.wait(last, return_when=asyncio.FIRST_COMPLETED)
    finally:
        await asyncio.gather(*(nanny.close(timeout=2) for nanny in nannies), return_exceptions=True)


async def _check_joined(started: asyncio.Future) -> None:
    try:
        await started
    except Exception as error:
        reason: BaseException = error
        while reason.__cause__ is not None and not isinstance(reason, OSError):
            reason = reason.__cause__
        raise OSError(str(reason) or type(reason).__name__) from error


def _stop_on_signals(stop: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    for name in (signal.SIGINT, signal.SIGTERM):
        signal.signal(name, lambda *_: loop.call_soon_threadsafe(stop.set))


def _stop_at_end(pipe: BinaryIO, stop: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()

    def read() -> None:
        # Not pipe.read(): its lock, held at the end of the program, would be a fatal error.
        while os.read(pipe.fileno(), 1024):
            pass
        with suppress(RuntimeError):
            loop.call_soon_threadsafe(stop.set)

    threading.Thread(target=read, daemon=True).start()
