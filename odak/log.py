"""Logger of the package, silent until a file is named, here or by the environment variable ODAK_LOG_FILE."""

import logging
import os

from odak._warnings import ArgumentWarning, warn
from odak.tools.paths import validate_path

__all__ = ["create_logger", "filename_logger", "logger"]

filename_logger = "odak.log"
logger: logging.Logger = logging.getLogger("odak")
logger.addHandler(logging.NullHandler())
logger.setLevel(logging.DEBUG)


def create_logger(
    logger_name: str,
    logger_filename: str | os.PathLike[str],
    logger_fmt: str = "%(asctime)s - %(message)s",
    logger_datefmt: str = "%d-%b-%y %H:%M:%S",
    logger_level: int = logging.DEBUG,
) -> logging.Logger:
    """Let a logger write to a file; a second call for the same file changes its format and adds no second line.

    Parameters
    ----------
    logger_name : str
        Name of the logger; ``"odak"`` is the package's own.
    logger_filename : str or os.PathLike
        File to append to, such as :data:`filename_logger`.
    logger_fmt : str
        Format of a line, in the style of :class:`logging.Formatter`.
    logger_datefmt : str
        Format of the date, in the style of :func:`time.strftime`.
    logger_level : int
        Least level that is written.

    Returns
    -------
    logging.Logger
        The logger, after one line that names the file.

    Raises
    ------
    TypeError
        If the name or the file name is not a string.
    ValueError
        If the path is not acceptable.
    OSError
        If the file cannot be opened.

    Examples
    --------
    >>> import os, tempfile
    >>> from odak.log import create_logger
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = os.path.join(folder, "experiment.log")
    ...     experiment = create_logger("experiment", path, logger_fmt="%(levelname)s: %(message)s")
    ...     experiment.info("exposure 20 ms")
    ...     handler = experiment.handlers[0]
    ...     experiment.removeHandler(handler)
    ...     handler.close()
    ...     with open(path) as stream:
    ...         print(stream.readlines()[-1].strip())
    INFO: exposure 20 ms
    """
    if not isinstance(logger_name, str):
        raise TypeError(f"logger_name must be a string, got {type(logger_name).__name__}")
    formatter = _formatter(logger_fmt, logger_datefmt)
    level = _level(logger_level)
    path = validate_path(logger_filename, name="logger_filename")
    target = logging.getLogger(logger_name)
    handler = next((h for h in target.handlers if getattr(h, "baseFilename", None) == path), None)
    if handler is None:
        handler = logging.FileHandler(path, mode="a", encoding="utf-8")
        target.addHandler(handler)
    handler.setFormatter(formatter)
    target.setLevel(level)
    target.info("Logging to %s", path)
    return target


def _formatter(logger_fmt, logger_datefmt) -> logging.Formatter:
    for name, value in (("logger_fmt", logger_fmt), ("logger_datefmt", logger_datefmt)):
        if not isinstance(value, str):
            raise TypeError(f"{name} must be a string, got {type(value).__name__}")
    try:
        return logging.Formatter(logger_fmt, logger_datefmt)
    except ValueError as error:
        raise ValueError(f"logger_fmt must be a format of the logging module: {error}") from None


def _level(logger_level) -> int:
    known = logging.getLevelName(logger_level) if isinstance(logger_level, str) else logger_level
    if isinstance(known, bool) or not isinstance(known, int) or known < 0:
        raise TypeError(f"logger_level must be a level of the logging module, at least 0; got {logger_level!r:.80}")
    return known


def _start_from_environment() -> None:
    """Write to the file that ODAK_LOG_FILE names, if any; importing odak never fails for it."""
    filename = os.environ.get("ODAK_LOG_FILE")
    if not filename:
        return
    try:
        create_logger(logger.name, filename)
    except (OSError, ValueError) as error:
        warn(f"ODAK_LOG_FILE is ignored: {error}", ArgumentWarning)


_start_from_environment()
