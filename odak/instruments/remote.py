"""Instruments of another computer, which its workers hold."""

import inspect
import os
import weakref
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from odak import _validate
from odak.instruments.protocols import Camera, Laser, Rotator, SLMDriver, Stage, open_instrument
from odak.manager.server import check_transport, load_security, require_dask

_KINDS: dict[type, tuple[str, ...]] = {
    SLMDriver: ("show",),
    Camera: ("capture",),
    Laser: (),
    Stage: ("move",),
    Rotator: ("turn",),
}
# What some instruments have beyond their protocol, which measurements read.
_BESIDE = ("exposure_limits",)


class RemoteInstrument:
    """An instrument of another computer; :func:`open_remote` adds the attributes and methods of its protocol."""

    address: str
    driver: str
    _held: Any
    _client: Any
    _timeout: float

    def _ask(self, what: str, *given: Any) -> Any:
        """Return what the holder of the instrument answers."""
        place = f"the instrument {self.driver!r} at {self.address}"
        ended = f"{place} is closed, or its worker has ended"
        late = f"{place} has not answered within {self._timeout:g} s"
        with _validate.refusing(lambda _: ended, RuntimeError, raised=ConnectionError):
            asked = getattr(self._held, what)
        with _validate.refusing(lambda _: late, TimeoutError, raised=TimeoutError):
            return asked(*given).result(timeout=self._timeout)

    def close(self) -> None:
        """Close the instrument and the connection."""
        try:
            self._ask("close")
        except ConnectionError:
            # Closed already.
            return
        finally:
            self._client.close()

    def __enter__(self) -> "RemoteInstrument":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.driver!r} at {self.address})"


def open_remote(
    address: str,
    driver: str,
    options: Mapping[str, Any] | None = None,
    security: str | os.PathLike[str] | Any = None,
    worker: str | None = None,
    trusted_network: bool = False,
    timeout: float = 60.0,
) -> Any:
    """Open an instrument of another computer, which serves it as a worker of odak's.

    Use it where the table's computer is not the one with the GPU: measurements take what is returned as they take an
    instrument of this computer. There, ``odak worker`` or :func:`odak.manager.start_server` runs, with the package that
    holds the driver installed.

    Parameters
    ----------
    address : str
        Address of the scheduler that the worker has joined, such as "tls://10.0.0.7:8786".
    driver : str
        Its name, as in :func:`odak.instruments.open_instrument`.
    options : mapping, optional
        Arguments of the driver.
    security : path or distributed.Security, optional
        TLS certificates: a folder that :func:`odak.manager.make_certificates` wrote, or Dask's own object.
    worker : str, optional
        Name of the worker; needed where there are several.
    trusted_network : bool
        Accept unencrypted TCP to another computer. Anybody who can connect to it can then run code there.
    timeout : float
        Longest time in seconds to wait for an answer: exposures must be shorter.

    Returns
    -------
    SLMDriver, Camera, Laser, Stage or Rotator
        Instrument with the attributes and methods of its protocol, and ``close()``. A driver's other attributes are
        left out.

    Raises
    ------
    ImportError
        If Dask is not installed.
    ValueError, TypeError
        If an argument is outside its range, the driver is not installed there, or plain TCP would reach beyond this
        computer.
    OSError
        If the scheduler cannot be reached.

    Notes
    -----
    All calls of an instrument run in one thread of the worker, in their order. It is closed when the connection ends.
    Each call is a message: over a network, frames take their size over its rate.

    Examples
    --------
    >>> from odak.instruments import open_remote
    >>> from odak.manager import start_server
    >>> import tempfile
    >>> with start_server(port=0, workers=1) as server, tempfile.TemporaryDirectory() as folder:
    ...     options = {"folder": folder, "shape": [4, 6], "pitch": 8e-6}
    ...     with open_remote(server.address, "file-modulator", options) as modulator:
    ...         modulator.shape
    (4, 6)
    """
    require_dask("open_remote")
    from distributed import Client, Security

    options = {} if options is None else options
    _validate.instance("options", options, Mapping, "a mapping")
    timeout = float(_validate.number("timeout", timeout, positive=True))
    check_transport("address", _validate.text("address", address), trusted_network)
    security = load_security(security)
    secure = {"security": security} if isinstance(security, Security) else {}
    client = Client(address, set_as_default=False, timeout=timeout, **secure)
    try:
        place = _place_of(client, worker, timeout)
        # No cache: two instruments of one driver are two.
        opening: Any = client.submit(
            _Held, _validate.text("driver", driver), dict(options), actor=True, pure=False, workers=[place]
        )
        # What holds an actor calls it through the client that is current when it arrives.
        with client.as_current():
            held: Any = opening.result(timeout=timeout)
            kind, attributes, methods = held.protocol().result(timeout=timeout)
    except BaseException:
        client.close()
        raise
    members: dict[str, Any] = {attribute: _forwarded(attribute) for attribute in attributes}
    members |= {method: _called(method) for method in methods}
    # A class for each, since protocols look for attributes there.
    found: Any = type(f"Remote{kind}", (RemoteInstrument,), members)()
    found.address, found.driver, found._timeout = address, driver, timeout
    found._held, found._client = held, client
    return found


def _place_of(client: Any, worker: str | None, timeout: float) -> str:
    """Return the address of the worker of a name, or of the only one."""
    client.wait_for_workers(1, timeout=timeout)
    every = "n_workers" in inspect.signature(client.scheduler_info).parameters
    about = client.scheduler_info(**({"n_workers": -1} if every else {}))
    known = {str(worker["name"]): place for place, worker in about["workers"].items()}
    if worker is None and len(known) == 1:
        return next(iter(known.values()))
    if worker not in known:
        raise ValueError(f"worker must be the name of one of the workers ({', '.join(sorted(known))}), got {worker!r}")
    return known[worker]


def _forwarded(attribute: str) -> property:
    return property(
        lambda self: self._ask("get", attribute), lambda self, value: self._ask("set", attribute, value)
    )  # fmt: skip


def _called(method: str):
    def call(self, *given, **options):
        return self._ask("call", method, given, options)

    call.__name__ = method
    return call


class _Held:
    """What a worker holds: an instrument, in a thread of its own, since drivers of windows and cameras need one."""

    def __init__(self, name: str, options: dict[str, Any]):
        self._thread = ThreadPoolExecutor(1)
        self._instrument = self._thread.submit(open_instrument, name, **options).result()
        # Also when the connection ends without close().
        self._end = weakref.finalize(self, _closed, self._instrument, self._thread)

    def protocol(self) -> tuple[str, list[str], list[str]]:
        """Return the name of the protocol that the instrument has, its attributes and methods."""
        kind = next(kind for kind in _KINDS if isinstance(self._instrument, kind))
        beside = [name for name in _BESIDE if hasattr(self._instrument, name)]
        return kind.__name__, [*kind.__annotations__, *beside], list(_KINDS[kind])

    def get(self, attribute: str) -> Any:
        return self._thread.submit(getattr, self._instrument, attribute).result()

    def set(self, attribute: str, value: Any) -> None:
        self._thread.submit(setattr, self._instrument, attribute, value).result()

    def call(self, method: str, given: tuple[Any, ...], options: dict[str, Any]) -> Any:
        return self._thread.submit(getattr(self._instrument, method), *given, **options).result()

    def close(self) -> None:
        self._end()


def _closed(instrument: Any, thread: ThreadPoolExecutor) -> None:
    if hasattr(instrument, "close"):
        thread.submit(instrument.close).result()
    thread.shutdown()
