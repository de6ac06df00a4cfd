import logging
import os
import subprocess
import sys

import pytest

import odak.log
from odak.log import create_logger


@pytest.fixture
def name():
    name = "odak_test_logger"
    yield name
    target = logging.getLogger(name)
    for handler in list(target.handlers):
        target.removeHandler(handler)
        handler.close()


def test_lines_are_written_once(tmp_path, name):
    path = tmp_path / "a.log"
    first = create_logger(name, path)
    second = create_logger(name, str(path), logger_fmt="%(levelname)s %(message)s", logger_level=logging.WARNING)
    assert first is second is logging.getLogger(name)
    assert len(first.handlers) == 1
    first.warning("grüße")
    first.info("hidden")
    lines = path.read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2
    assert str(path) in lines[0]
    assert lines[1] == "WARNING grüße"


def test_two_files(tmp_path, name):
    create_logger(name, tmp_path / "a.log")
    create_logger(name, tmp_path / "b.log").info("both")
    assert all((tmp_path / f"{letter}.log").read_text().endswith("both\n") for letter in "ab")


def test_refused(tmp_path, name):
    with pytest.raises(TypeError, match="logger_name must be a string"):
        create_logger(3, tmp_path / "a.log")
    with pytest.raises(TypeError, match="must be a string"):
        create_logger(name, 3)
    with pytest.raises(ValueError, match="Path traversal"):
        create_logger(name, "../a.log")
    with pytest.raises(FileNotFoundError, match="none"):
        create_logger(name, tmp_path / "none" / "a.log")


def test_the_package_logger():
    assert odak.log.filename_logger == "odak.log"
    assert odak.log.logger is logging.getLogger("odak")
    assert odak.log.logger.level == logging.DEBUG
    assert any(isinstance(handler, logging.NullHandler) for handler in odak.log.logger.handlers)


def run(folder, **variables):
    code = "import odak; odak.log.logger.info('hello')"
    environment = {**os.environ, **variables, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True, check=True
    )


def test_import_writes_only_where_the_environment_asks(tmp_path):
    assert run(tmp_path, ODAK_LOG_FILE="").stderr == ""
    assert not list(tmp_path.iterdir())
    run(tmp_path, ODAK_LOG_FILE=str(tmp_path / "asked.log"))
    assert (tmp_path / "asked.log").read_text().endswith("hello\n")


def test_an_impossible_log_file_does_not_stop_the_import(tmp_path):
    assert "ODAK_LOG_FILE is ignored" in run(tmp_path, ODAK_LOG_FILE=str(tmp_path / "none" / "a.log")).stderr
