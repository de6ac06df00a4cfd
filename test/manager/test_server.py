"""Workers of this machine, with a scheduler here and for one elsewhere: starting, ending, being killed."""

import ast
import contextlib
import ipaddress
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import structure
from manager_tasks import divide, nap, search_path
from processes import is_running, wait_for
from running_cluster import ROOT, start_scheduler, start_workers, stop, tls_options

from odak import OdakWarning
from odak.cli import main
from odak.manager import agent, make_certificates, start_server
from odak.manager.server import check_transport

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no signals on this system")


def script(text, **options):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", textwrap.dedent(text)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        **options,
    )


@pytest.fixture
def pair():
    """Return a function that starts a scheduler and a worker, which end with the test."""
    started = []

    def start(scheduler_options=(), worker_options=()):
        scheduler, address = start_scheduler(*scheduler_options)
        started.append(scheduler)
        started.extend(start_workers(address, 1, *worker_options))
        return scheduler, address, started[-1]

    yield start
    stop(*started)


@pytest.mark.slow
def test_a_scheduler_that_is_not_there():
    with agent(divide, "tcp://127.0.0.1:1", timeout=0.5, verbose=False) as work, pytest.raises(OSError, match="1"):
        work.connect()


@pytest.mark.slow
def test_plain_script_uses_all_cores_and_leaves_nothing_behind():
    code = """
        import os
        from odak.manager import agent

        def square(value):
            return value * value, os.getpid()

        work = agent(square, workers=2, verbose=False)
        for value in range(40):
            work.submit((value,))
        results = work.run()
        assert [square for square, _ in results] == [value**2 for value in range(40)]
        print(*{process for _, process in results}, *work.client.run(os.getpid).values())
    """
    # Two workers, and the process beside each in which its tasks run.
    with script(code) as running:
        processes = set(map(int, running.communicate(timeout=120)[0].split()))
    assert running.returncode == 0 and len(processes) == 4 and running.pid not in processes
    wait_for(lambda: not any(map(is_running, processes)))


@pytest.mark.slow
def test_workers_end_with_a_program_that_is_killed():
    code = """
        import os, time
        from odak.manager import agent

        work = agent(abs, workers=2, verbose=False)
        work.connect()
        print(*work.client.run(os.getpid).values(), flush=True)
        time.sleep(600)
    """
    with script(code) as running:
        processes = list(map(int, running.stdout.readline().split()))
        assert len(processes) == 2 and all(map(is_running, processes))
        running.kill()
    wait_for(lambda: not any(map(is_running, processes)))


@pytest.mark.slow
def test_a_server_that_other_agents_use():
    with start_server(port=0, workers=1, threads=3) as server:
        assert server.address.startswith("tcp://127.0.0.1:") and server.alive()
        for _ in range(2):
            with agent(os.getenv, server.address, verbose=False) as work:
                work.submit(("OMP_NUM_THREADS",))
                assert work.run() == ["3"]
        with agent(divide, server.address, server=True, workers=1, verbose=False) as work:
            work.connect()
            assert work.slots() == 2
        assert server.close() is True and not server.alive()


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_run_with_what_is_done(pair):
    scheduler, address, worker = pair()
    with agent(nap, address, verbose=False, timeout=5.0) as work:
        for value in range(100):
            work.submit((0.05, value))
        with pytest.raises(ConnectionError, match="scheduler does not answer"):
            for _ in work.as_completed():
                if len(work.records) == 5:
                    scheduler.kill()
        done = [result[0] for result in work.results if result is not None]
        assert done == list(range(len(done))) and 5 <= len(done) < 100
    assert worker.stdout.readline() == f"the scheduler at {address} has ended\n"
    assert worker.wait(60) == 0


@pytest.mark.slow
def test_a_machine_leaves_when_asked(pair):
    _, address, worker = pair()
    worker.send_signal(signal.SIGINT)
    assert worker.stdout.readline() == f"left {address}\n"
    assert worker.wait(60) == 0


@pytest.mark.slow
def test_the_program_of_the_workers_killed():
    with agent(nap, workers=1, verbose=False) as work:
        # Longer than pytest lets any test take: the task does not end before its process.
        work.submit((3600.0, None))
        work.connect()
        work._backend._server._workers._program.kill()
        with pytest.raises(ConnectionError, match="program that holds this machine's workers has ended"):
            work.run()


@pytest.mark.slow
def test_certificates(tmp_path, pair):
    pytest.importorskip("cryptography")
    folder = make_certificates(tmp_path / "certificates")
    assert {path.name: path.stat().st_mode & 0o777 for path in folder.iterdir()} == dict.fromkeys(
        ("ca.pem", "cert.pem", "key.pem"), 0o600
    )
    with pytest.raises(ValueError, match=r"holds ca\.pem, cert\.pem, key.pem already"):
        make_certificates(folder)
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="file' exists and is not a directory"):
        make_certificates(tmp_path / "file")
    files = tls_options(folder)
    _, address, _ = pair(("--protocol", "tls", *files), files)
    assert address.startswith("tls://")
    with agent(divide, address, security=folder, verbose=False) as work:
        work.submit((3, 2))
        assert work.run() == [1.5]
    other = make_certificates(tmp_path / "other")
    for stranger, security in ((address.replace("tls", "tcp"), None), (address, None), (address, other)):
        with (
            agent(divide, stranger, timeout=1.0, security=security, verbose=False) as work,
            pytest.raises((OSError, TypeError)),
        ):
            work.connect()
    with pytest.raises(ValueError, match=r"lacks ca\.pem, cert\.pem"):
        agent(divide, address, security=tmp_path)


@pytest.mark.parametrize(
    ("address", "refused"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://[::1]:8786", False),
        ("localhost:8786", False),
        ("inproc://10.1.2.3/7/1", False),
        ("tls://10.1.2.3:8786", False),
        ("127.3.2.1", False),
        ("0.0.0.0", True),
        ("", True),
        ("::", True),
        ("tcp://[2001:db8::1]:8786", True),
        ("tcp://10.1.2.3:8786", True),
        ("10.1.2.3:8786", True),
        ("ws://10.1.2.3:8786", True),
        ("tcp://no.such.host.invalid:8786", True),
    ],
)
def test_plain_tcp_stays_local_unless_the_network_is_trusted(address, refused):
    check_transport("address", address, trusted_network=True)
    if refused:
        with pytest.raises(ValueError, match="is not an address of this machine only, and over plain TCP"):
            check_transport("address", address, trusted_network=False)
    else:
        check_transport("address", address, trusted_network=False)


def test_a_server_beyond_this_machine_needs_certificates():
    with pytest.raises(ValueError, match=r"host '0\.0\.0\.0' is not an address of this machine only"):
        start_server(host="0.0.0.0", port=0, workers=1)
    with agent(divide, server=True, host="0.0.0.0", verbose=False) as work, pytest.raises(ValueError, match="host"):
        work.connect()


def descendants(process):
    """Return a process and all that it started, directly or not."""
    parents = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                stat = (folder / "stat").read_text()
            except OSError:
                continue
            parents[int(folder.name)] = int(stat.rpartition(")")[2].split()[1])
    found = {process}
    while grown := {child for child, parent in parents.items() if parent in found} - found:
        found |= grown
    return found


def listening(processes):
    """Return the addresses on which processes listen, from the tables of the kernel."""
    sockets = set()
    for process in processes:
        # Files, and processes, may be gone by now.
        with contextlib.suppress(OSError):
            for entry in os.listdir(f"/proc/{process}/fd"):
                with contextlib.suppress(OSError):
                    target = os.readlink(f"/proc/{process}/fd/{entry}")
                    if target.startswith("socket:["):
                        sockets.add(target[8:-1])
    found = []
    for table in ("tcp", "tcp6"):
        file = Path(f"/proc/net/{table}")
        for line in file.read_text().splitlines()[1:] if file.exists() else ():
            words = line.split()
            if words[3] == "0A" and words[9] in sockets:
                data = bytes.fromhex(words[1].partition(":")[0])
                quads = [data[start : start + 4][::-1] for start in range(0, len(data), 4)]
                found.append(str(ipaddress.ip_address(b"".join(quads))))
    return found


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="no /proc")
def test_all_that_is_started_listens_on_loopback_alone():
    code = """
        import sys, time
        from odak.manager import agent

        work = agent(abs, "local", workers=1, verbose=False)
        work.submit((-3,))
        assert work.run() == [3]
        print("ready", flush=True)
        time.sleep(600)
    """
    with script(code) as running:
        assert running.stdout.readline() == "ready\n"
        processes = descendants(running.pid)
        found = listening(processes)
        running.kill()
    # The script, the program of the workers, a worker, and a process for the task.
    assert len(processes) >= 4 and len(found) >= 3
    assert set(found) == {"127.0.0.1"}


POISON = "raise SystemExit(open('poisoned', 'a').write(__name__ + chr(10)) and 'poisoned')"
POISONED = (
    *("uuid", "json", "pickle", "multiprocessing", "asyncio", "socket", "logging", "tempfile", "random", "struct"),
    *("numpy", "torch", "dask", "distributed", "tornado", "msgpack", "cloudpickle", "psutil", "yaml", "typing"),
    *("runpy", "importlib", "zipfile", "array", "bpy", "mathutils", "site", "sitecustomize", "usercustomize", "odak"),
)


@pytest.fixture
def poisoned(tmp_path, monkeypatch):
    """Make the current folder one whose modules leave a mark when they are imported; return it."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for name in POISONED:
        (folder / f"{name}.py").write_text(POISON)
    monkeypatch.chdir(folder)
    yield folder
    assert not (folder / "poisoned").exists(), (folder / "poisoned").read_text()


@pytest.mark.slow
def test_modules_of_the_current_folder_are_sent_not_imported(poisoned, monkeypatch):
    (poisoned / "my_helpers.py").write_text("FACTOR = 3\n\n\ndef triple(value):\n    return FACTOR * value\n")
    monkeypatch.syspath_prepend("")
    with agent(workers=1, verbose=False) as work:
        assert [value for value, _ in work.map(nap, [0.01], shared={"value": 3})] == [3]
        path = work.map(search_path, [0])[0]
        monkeypatch.syspath_prepend(str(poisoned))
        # What the test itself imports from now on must not come from there first.
        sys.path.append(sys.path.pop(0))
        import my_helpers

        try:
            assert work.map(lambda value: my_helpers.triple(value), [2]) == [6]
        finally:
            del sys.modules["my_helpers"]
    assert "" not in path and str(poisoned) not in map(os.path.realpath, path)


@pytest.mark.slow
def test_command_line_worker_imports_nothing_from_its_folder(poisoned):
    options = {"host": "127.0.0.1", "port": 0, "dashboard_address": "127.0.0.1:0"}
    with distributed.SpecCluster(scheduler={"cls": distributed.Scheduler, "options": options}, workers={}) as there:
        command = [sys.executable, "-I", "-m", "odak", "worker", there.scheduler_address, "--workers", "1"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as worker:
            try:
                assert "joined" in worker.stdout.readline()
                with agent(lambda: __import__("sys").path, there.scheduler_address, verbose=False) as work:
                    work.submit(())
                    assert str(poisoned) not in map(os.path.realpath, work.run()[0])
            finally:
                # Not an interrupt, which a test run in the background ignores and its children with it.
                worker.terminate()


@pytest.mark.slow
def test_workers_of_a_picture_in_tiles_import_nothing_from_its_folder(poisoned, tmp_path):
    pytest.importorskip("zarr")
    np.save(poisoned / "picture.npy", np.linspace(0, 1, 1024).reshape(32, 32))
    options = "--tiles --cluster local --workers 1 --iterations 1 --distance 0.005 --pixel-pitch 8e-6 --quiet"
    # As the command `odak` of an installation: a script in another folder, which begins the search path.
    script = tmp_path / "odak-command"
    script.write_text("import sys\nfrom odak.cli import main\nsys.exit(main())\n")
    command = [sys.executable, str(script), "hologram", "picture.npy", *options.split(), "-o", "made"]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == 0, done.stderr
    assert (poisoned / "made" / "report.json").exists()


# What starts a process of Python: the interpreter's name, and classes that start it themselves.
STARTERS = {
    "executable",
    "multiprocessing",
    "ProcessPoolExecutor",
    "LocalCluster",
    "Nanny",
    "SubprocessCluster",
    "fork",
}


def test_processes_are_started_in_one_way():
    """A process started otherwise would import what lies in the current folder."""
    found = {}
    for name, path in structure.modules().items():
        text = path.read_text(encoding="utf-8")
        if not any(word in text for word in STARTERS):
            continue
        words = {getattr(node, "attr", getattr(node, "id", "")) for node in ast.walk(structure.tree(path))}
        imported = (node for node in ast.walk(structure.tree(path)) if isinstance(node, (ast.Import, ast.ImportFrom)))
        words |= {part for node in imported for alias in node.names for part in alias.name.split(".")}
        if words & STARTERS:
            found[name] = words & STARTERS
    # The scheduler is a thread of its process, the nannies are started by a program of python_command, and scenes give
    # the interpreter to other_python_command.
    assert found == {
        "odak._python": {"executable"},
        "odak.manager.server": {"LocalCluster", "Nanny"},
        "odak.visualize.blender.scenes": {"executable"},
    }


@pytest.mark.slow
def test_workers_that_cannot_join(capfd):
    assert main(["worker", "tcp://127.0.0.1:1", "--timeout", "0.3"]) == 1
    said, wrong = capfd.readouterr()
    assert not said
    assert "Workers cannot join tcp://127.0.0.1:1: Timed out" in wrong and len(wrong.splitlines()) == 1


@pytest.mark.slow
def test_workers_that_do_not_end_are_killed_and_nothing_is_left(monkeypatch):
    monkeypatch.setattr("odak.manager.server._PATIENCE", 0.5)
    server = start_server(port=0, workers=1)
    workers = server._workers
    os.kill(workers._program.pid, signal.SIGSTOP)
    with pytest.warns(OdakWarning, match=r"did not end within 0.5 s and were killed"):
        server.close()
    assert not workers.alive() and workers._errors.closed and not os.path.exists(workers._folder.name)
