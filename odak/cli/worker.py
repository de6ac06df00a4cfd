"""`odak worker`: this machine works for a scheduler on the network."""

from collections.abc import Callable
from dataclasses import dataclass

from odak import _validate
from odak.cli.errors import InputError
from odak.manager.machine import Share, require_dask, work


@dataclass(frozen=True)
class Certificates:
    """Files of TLS certificates in PEM format, all of them or none.

    Attributes
    ----------
    ca_file, cert, key : str, optional
        The authority's certificate, this machine's certificate, and its key.
    """

    ca_file: str | None = None
    cert: str | None = None
    key: str | None = None

    def security(self):
        """Return Dask's form of them, None without any."""
        given = [self.ca_file, self.cert, self.key]
        if not any(given):
            return None
        if not all(given):
            raise InputError("--tls-ca-file, --tls-cert and --tls-key go together")
        from distributed import Security

        return Security(
            tls_ca_file=self.ca_file,
            require_encryption=True,
            **{f"tls_{role}_cert": self.cert for role in ("client", "scheduler", "worker")},
            **{f"tls_{role}_key": self.key for role in ("client", "scheduler", "worker")},
        )


def share(workers: int | None, threads: int | None, memory_limit: float | None, name: str | None) -> Share:
    """Return how this machine is divided; the memory limit is in GiB.

    Raises
    ------
    InputError
        If a number is out of range.
    """
    try:
        if memory_limit is not None:
            memory_limit = int(2**30 * _validate.real("memory-limit", memory_limit, positive=True))
        return Share(workers, threads, memory_limit, name)
    except (TypeError, ValueError) as error:
        raise InputError(f"--{error}") from None


def run(address: str, share: Share, certificates: Certificates, timeout: float, say: Callable[[str], None]) -> None:
    """Work for a scheduler until it ends or a signal comes.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as "tcp://10.0.0.1:8786".
    share : Share
        How this machine is divided among workers.
    certificates : Certificates
        For TLS.
    timeout : float
        Seconds to wait for the scheduler.
    say : callable
        Called with a line of text when the workers have joined and when they leave.

    Raises
    ------
    InputError
        If the address will not do, or Dask is missing.
    OSError
        If the scheduler is not there.
    """
    if ":" not in address:
        raise InputError(f"ADDRESS must be that of a scheduler, such as tcp://10.0.0.1:8786; got {address!r}")
    try:
        require_dask("odak worker")
    except ImportError as error:
        raise InputError(str(error)) from None
    asked = work(
        address,
        share,
        certificates.security(),
        joined=lambda parts: say(f"{_described(parts)} joined {address}; Ctrl-C to leave"),
        timeout=timeout,
    )
    say(f"left {address}" if asked else f"the scheduler at {address} has ended")


def _described(parts: list[dict]) -> str:
    gpus = sum(part["resources"] is not None for part in parts)
    threads = parts[0]["env"]["OMP_NUM_THREADS"]
    workers = f"{len(parts)} worker{'s' * (len(parts) > 1)} of {threads} thread{'s' * (threads != '1')}"
    return workers + (f", {gpus} with a GPU," if gpus else "")
