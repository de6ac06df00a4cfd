import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest
from turns import Turn

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="no git on this machine")
OLD = ["test/wave/test_old.py", "test/wave/test_core.py", "test/learn/test_core.py", "test/wave/deep/test_deep.py"]
OLD += ["test/fit/test_a.py", "test/test_log.py", "odak/fit/unchanged.py"]
NEW = ["test/wave/test_new.py", "odak/wave/core.py", "odak/fit/nameless.py", "odak/log/__init__.pyi"]


def repository(root, *commits):
    def git(*arguments, **environment):
        subprocess.run(["git", "-C", root, *arguments], check=True, env=os.environ | environment)

    git("init", "-q")
    for date, files in commits:
        for file in files:
            (root / file).parent.mkdir(parents=True, exist_ok=True)
            (root / file).write_text("")
        git("add", ".")
        identity = ["-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
        git(*identity, "commit", "-q", "-m", "m", GIT_COMMITTER_DATE=date, GIT_AUTHOR_DATE=date)
    return root.resolve()


def test_after_the_turn_come_changed_test_files_and_then_those_of_changed_modules(tmp_path):
    root = repository(tmp_path, ("2000-01-01T00:00:00", OLD), (f"@{time.time():.0f} +0000", NEW))
    turn = Turn(0, 10**9, root)

    def place(file):
        return turn.place(file, root / file)

    assert place("test/wave/test_new.py") == 1
    # By the name of the module, in whichever folder; else by its folder.
    assert [place(file) for file in OLD[1:3]] == [2, 2]
    assert place("test/fit/test_a.py") == 2
    assert [place(file) for file in ["test/wave/test_old.py", *OLD[3:4], "test/test_log.py"]] == [None] * 3


def test_the_turns_together_take_each_test_once(tmp_path):
    turns = [Turn(k, 6, tmp_path) for k in range(6, 12)]
    names = [f"test/test_a.py::test[{i}]" for i in range(200)]
    places = [[turn.place(name, tmp_path / "test/test_a.py") for turn in turns] for name in names]
    assert all(sorted(row, key=str) == [0] + [None] * 5 for row in places)
    assert all(20 < sum(row[k] == 0 for row in places) < 50 for k in range(6))
    files = [[turn.takes_file(tmp_path / f"test/test_{i}.py") for turn in turns] for i in range(200)]
    assert all(sum(row) == 1 for row in files) and all(20 < sum(row[k] for row in files) < 50 for k in range(6))


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="one process runs all tests")
@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="the system does not tell")
def test_each_of_several_processes_has_one_thread_from_its_start():
    """NumPy reads the number when it is imported, by plugins before any file of tests."""
    assert b"OMP_NUM_THREADS=1" in Path("/proc/self/environ").read_bytes().split(b"\0")
