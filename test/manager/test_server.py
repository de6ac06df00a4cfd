"""Workers of this machine, with a scheduler here and for one elsewhere: starting, ending, being killed."""

import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from manager_tasks import divide, nap
from running_cluster import TEST, program, start_scheduler, start_workers, stop, wait_for

from odak.manager import agent, start_server

pytest.importorskip("distributed")
pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no signals on this system")


def alive(process):
    try:
        with open(f"/proc/{process}/stat", encoding="utf-8") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def script(text, **options):
    environment = {**os.environ, "PYTHONPATH": str(TEST.parent)}
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


def test_a_scheduler_that_is_not_there():
    with agent(divide, "tcp://127.0.0.1:1", timeout=0.5, verbose=False) as work, pytest.raises(OSError, match="1"):
        work.connect()


@pytest.mark.slow
def test_a_plain_script_uses_all_cores_by_default_and_leaves_nothing_behind():
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
    with script(code) as running:
        processes = set(map(int, running.communicate(timeout=120)[0].split()))
    assert running.returncode == 0 and len(processes) == 2 and running.pid not in processes
    wait_for(lambda: not any(map(alive, processes)))


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
        assert len(processes) == 2 and all(map(alive, processes))
        running.kill()
    wait_for(lambda: not any(map(alive, processes)))


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
        with pytest.raises(ConnectionError, match="scheduler is gone"):
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
        work.submit((60.0, None))
        start = time.monotonic()
        work.connect()
        work._backend._server._workers._program.kill()
        with pytest.raises(ConnectionError, match="program that holds this machine's workers has ended"):
            work.run()
        assert time.monotonic() - start < 30


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl to make certificates with")
def test_certificates(tmp_path, pair):
    from distributed import Security

    key, cert = tmp_path / "key.pem", tmp_path / "cert.pem"
    made = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=odak"]
    subprocess.run([*made, "-keyout", key, "-out", cert], check=True, capture_output=True)
    files = ("--tls-ca-file", cert, "--tls-cert", cert, "--tls-key", key)
    _, address, _ = pair(("--protocol", "tls", *files), files)
    assert address.startswith("tls://")
    roles = {
        f"tls_{role}_{kind}": str(file)
        for role in ("client", "worker")
        for kind, file in (("cert", cert), ("key", key))
    }
    security = Security(tls_ca_file=str(cert), require_encryption=True, **roles)
    with agent(divide, address, security=security, verbose=False) as work:
        work.submit((3, 2))
        assert work.run() == [1.5]
    for stranger in (address.replace("tls", "tcp"), address):
        with agent(divide, stranger, timeout=1.0, verbose=False) as work, pytest.raises((OSError, TypeError)):
            work.connect()


def test_workers_that_cannot_join():
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with program("odak", "worker", "tcp://127.0.0.1:1", "--timeout", "0.3", watched=False, **pipes) as worker:
        said, wrong = worker.communicate(timeout=120)
    assert worker.returncode == 1 and not said
    assert "Workers cannot join tcp://127.0.0.1:1: Timed out" in wrong and len(wrong.splitlines()) == 1
