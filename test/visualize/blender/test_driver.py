"""How Blender is found and run, with programs in its place that only pretend; and how the driver reads files."""

import importlib.util
import os
import re
import stat
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest
from processes import is_running, wait_for

from odak import DeviceWarning
from odak.visualize import blender
from odak.visualize.blender import scenes as blender_process

# Stands in for a Python with bpy: answers the question for it, and does what the variable PRETEND says otherwise.
PRETENDER = """#!/bin/sh
for last; do :; done
case "$last" in *"find_spec('bpy')"*) exit {probe};; esac
echo "arguments: $@"
{body}
"""


@pytest.fixture
def program(tmp_path):
    """Return a function that writes an executable of a name."""

    def write(name, body="exit 0", probe=0):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(PRETENDER.format(probe=probe, body=body))
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return str(path)

    return write


@pytest.fixture
def picture():
    picture = blender.scene(unit="mm", resolution=(4, 5), samples=4)
    picture.add_sphere()
    return picture


@pytest.fixture(autouse=True)
def _no_bpy(monkeypatch):
    """Let there be no Blender but those of a test."""
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name == "bpy" else found(name, *rest))
    for variable in (blender_process.PYTHON_VARIABLE, blender_process.PROGRAM_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("PATH", os.defpath)


def test_without_any_the_error_says_what_to_install(tmp_path):
    with pytest.raises(blender.BlenderNotFoundError) as caught:
        blender.find_blender(environ={"PATH": str(tmp_path)})
    assert isinstance(caught.value, ImportError)
    for words in ("pip install bpy==5.0.1", "python3.11 -m venv", "ODAK_BLENDER_PYTHON", "Python 3.11", sys.executable):
        assert words in str(caught.value)


def test_order_of_the_search(program, tmp_path, monkeypatch):
    on_path, named = program("path/blender"), program("other/blender-4.2")
    python, argument = program("venv/bin/python"), program("mine/python3.11")
    environ = {"PATH": str(tmp_path / "path")}
    assert blender.find_blender(environ=environ) == ("program", on_path)
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda name: types.SimpleNamespace() if name == "bpy" else None)
        assert blender.find_blender(environ=environ) == ("python", sys.executable)
        environ["ODAK_BLENDER"] = named
        assert blender.find_blender(environ=environ) == ("program", named)
    environ["ODAK_BLENDER_PYTHON"] = python
    assert blender.find_blender(environ=environ) == ("python", python)
    assert blender.find_blender(argument, environ=environ) == ("python", argument)
    assert blender.find_blender("blender", environ=environ) == ("program", on_path)
    # The folder of an environment will do.
    assert blender.find_blender(tmp_path / "venv", environ=environ) == ("python", python)
    environ["ODAK_BLENDER_PYTHON"] = str(tmp_path / "venv")
    assert blender.find_blender(environ=environ) == ("python", python)


@pytest.mark.parametrize(
    ("probe", "words"), [(3, "a Python without the package bpy"), (1, "is not a working Python interpreter")]
)
def test_what_was_named_must_have_it(program, probe, words):
    path = program("python", probe=probe)
    with pytest.raises(blender.BlenderNotFoundError, match=f"(?s)ODAK_BLENDER_PYTHON names .*{words}.*pip install"):
        blender.find_blender(environ={"ODAK_BLENDER_PYTHON": path, "PATH": os.defpath})
    with pytest.raises(blender.BlenderNotFoundError, match=r"blender names .*nowhere.*no program"):
        blender.find_blender("/nowhere/python")


def test_this_python_is_distinguished_from_one_with_bpy():
    with pytest.raises(blender.BlenderNotFoundError, match="a Python without the package bpy"):
        blender.find_blender(sys.executable)


def test_no_module_of_the_current_folder_is_imported(tmp_path, monkeypatch):
    for name in ("bpy", "json", "importlib", "site", "runpy", "uuid"):
        (tmp_path / f"{name}.py").write_text("open('poisoned', 'w').close()")
    script = tmp_path / "script.py"
    script.write_text("import json, sys, uuid\nprint(json.dumps(sys.argv[1:]), __name__)")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(blender.BlenderNotFoundError, match="without the package bpy"):
        blender.find_blender(sys.executable)
    command = blender.Blender("python", sys.executable).command(str(script), "a", "b")
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert said == '["a", "b"] __main__\n' and not (tmp_path / "poisoned").exists()


def test_a_named_one_never_gives_way_to_another(program, tmp_path):
    program("path/blender")
    with pytest.raises(blender.BlenderNotFoundError, match="ODAK_BLENDER names"):
        blender.find_blender(environ={"ODAK_BLENDER": "/nowhere/blender", "PATH": str(tmp_path / "path")})


def test_commands_open_no_window_and_run_nobody_elses_settings(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    python, program = blender.Blender("python", "/p/python"), blender.Blender("program", "/p/blender")
    words = python.command("d.py", "a", "b")
    assert words[:3] == ["/p/python", "-I", "-c"] and words[-3:] == ["d.py", "a", "b"]
    words = program.command("d.py", "a", "b")
    assert words[:3] == ["/p/blender", "--background", "--factory-startup"]
    assert words[-5:] == ["--python", "d.py", "--", "a", "b"]
    assert "PYTHONPATH" not in python.environment()
    assert blender.Blender("python", sys.executable).environment()["PYTHONPATH"] == "/somewhere"


def test_file_appears_whole_and_progress_is_logged(program, picture, tmp_path, logged):
    body = 'echo "Mem: 1M | Sample 3/4"; echo "odak: the CPU renders"; printf content > "$last"'
    warns = pytest.warns(DeviceWarning, match="Blender: the CPU renders")
    with warns:
        path = picture.render(tmp_path / "a.png", blender=program("blender", body), verbose=False)
    assert (tmp_path / "a.png").read_text() == "content"
    assert path == str(tmp_path / "a.png")
    levels = {record.getMessage(): record.levelname for record in logged.records}
    assert levels["Blender: Mem: 1M | Sample 3/4"] == "DEBUG"
    (called,) = [text for text in levels if "arguments:" in text]
    assert "--background --factory-startup --python-exit-code 1 --python" in called
    assert re.search(r"driver\.py -- \S*scene\.json \S*out\.png", called)


def test_progress_bar_counts_samples(program, picture, tmp_path, capsys):
    body = 'echo "Sample 1/4"; sleep 0.4; echo "Sample 4/4"; sleep 0.2; printf content > "$last"'
    picture.render(tmp_path / "a.png", blender=program("blender", body))
    assert "4/4" in capsys.readouterr().err


def test_array_comes_top_row_first(program, picture):
    numbers = np.arange(80, dtype="<f4")
    octal = "".join(f"\\{byte:03o}" for byte in numbers.tobytes())
    body = f"printf '{octal}' > \"$last\""
    pixels = picture.render(blender=program("blender", body), verbose=False, transparent=True)
    assert np.array_equal(pixels, numbers.reshape(4, 5, 4)[::-1])
    assert picture.render(blender=program("blender", body), verbose=False).shape == (4, 5, 3)
    depth = picture.render_depth(blender=program("blender", body), verbose=False)
    assert np.array_equal(depth, numbers.reshape(4, 5, 4)[::-1, :, 0])


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("echo working; echo 'Error: no such thing' >&2; exit 7", r"exit code 7. It wrote last:\nError: no such thing"),
        ("echo working", r"without a result. It wrote last:\narguments: .*\nworking"),
        ("echo 'libXi.so.6: cannot open shared object file' >&2; exit 1", "apt-get install .*libxi6"),
        ("kill -9 $$", "exit code -9"),
    ],
)
def test_failure_tells_what_blender_wrote_and_leaves_old_file(program, picture, tmp_path, body, words):
    (tmp_path / "a.png").write_text("old")
    before = {entry.name for entry in tmp_path.iterdir()}
    with pytest.raises(blender.BlenderError, match=f"(?s){words}"):
        picture.render(tmp_path / "a.png", blender=program("blender", body), verbose=False)
    assert (tmp_path / "a.png").read_text() == "old"
    assert {entry.name for entry in tmp_path.iterdir()} == before | {"blender"}


def test_file_that_breaks_off_leaves_the_old_one(program, picture, tmp_path, monkeypatch):
    def break_off(source, target):
        target.write(source.read(3))
        raise OSError("disk full")

    (tmp_path / "a.png").write_text("old")
    path = program("blender", 'printf content > "$last"')
    monkeypatch.setattr(blender_process.shutil, "copyfileobj", break_off)
    with pytest.raises(OSError, match="disk full"):
        picture.render(tmp_path / "a.png", blender=path, verbose=False)
    assert (tmp_path / "a.png").read_text() == "old"
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["a.png", "blender"]


def test_long_complaints_are_cut(program, picture, tmp_path):
    body = "i=0; while [ $i -lt 200 ]; do echo line $i >&2; i=$((i+1)); done; exit 1"
    with pytest.raises(blender.BlenderError) as caught:
        picture.render(tmp_path / "a.png", blender=program("blender", body), verbose=False)
    assert "line 199" in str(caught.value) and "line 100" not in str(caught.value)


def test_timeout_stops_it_and_its_children(program, picture, tmp_path):
    pid = tmp_path / "pid"
    body = f"sleep 3600 & echo $! > {pid}.part; mv {pid}.part {pid}; sleep 3600"
    path = program("blender", body)
    # The program may take longer than the first limits to start its child.
    for timeout in (0.5, 5, 60):
        with pytest.raises(TimeoutError, match=f"stopped after {timeout} s"):
            picture.render(tmp_path / "a.png", blender=path, timeout=timeout, verbose=False)
        if pid.exists():
            break
    wait_for(lambda: not is_running(int(pid.read_text())))
    assert not (tmp_path / "a.png").exists()


def test_folder_must_exist(program, picture, tmp_path):
    with pytest.raises(ValueError, match=r"Folder .*nowhere.* does not exist"):
        picture.render(tmp_path / "nowhere" / "a.png", blender=program("blender"), verbose=False)


@pytest.fixture
def driver(monkeypatch):
    """Return the driver's functions, without a Blender."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    spec = importlib.util.spec_from_file_location("driver", blender_process.DRIVER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_driver_refuses_objects(driver, tmp_path, monkeypatch):
    np.savez(tmp_path / "arrays.npz", objects=np.array([{}], dtype=object))
    (tmp_path / "scene.json").write_text('{"arrays": "arrays.npz"}')
    monkeypatch.setattr(driver, "build", lambda document, arrays: arrays["objects"])
    with pytest.raises(ValueError, match="allow_pickle=False"):
        driver.main([str(tmp_path / "scene.json"), str(tmp_path / "out.png")])


def test_driver_runs_nothing_that_it_reads():
    """No eval, exec, import by name or shell; texts of a scene reach Blender as names of things alone."""
    source = Path(blender_process.DRIVER).read_text(encoding="utf-8")
    assert not re.search(r"\b(eval|exec|compile|__import__|import_module|system|subprocess|socket|pickle)\(", source)
    assert "use_scripts=False" in source
