"""The agent on a real scheduler with two worker processes on this machine."""

import os
import signal
import sys
import threading
import types
from concurrent.futures import CancelledError

import pytest
import torch
from manager_tasks import (
    Unopenable,
    await_mark,
    crash,
    divide,
    end_process,
    exit_quietly,
    fail_at_first,
    hologram,
    nap,
    page_faults,
    raise_selfish,
    stop_at_first,
    threads,
    weighted_sum,
)
from processes import wait_for
from running_cluster import cluster, start_scheduler, start_workers, stop

from odak.manager import Failure, TaskError, agent, backends
from odak.manager.server import Share

distributed = pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no signals on this system"),
    pytest.mark.xdist_group("cluster"),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def address():
    return cluster()


@pytest.fixture
def one_thread():
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(count)


def spread(address, compute, jobs, **options):
    work = agent(compute, address, **{"verbose": False, **options})
    for job in jobs:
        work.submit(job)
    return work


def equal(results, seeds):
    """Return whether holograms are those of a serial run, bit for bit."""
    return all(torch.equal(field, hologram(seed)[0]) for (field, _), seed in zip(results, seeds, strict=True))


def test_results_equal_the_serial_run_bit_for_bit(address, one_thread):
    with spread(address, hologram, [(seed,) for seed in range(12)]) as work:
        results = work.run()
        assert work.slots() == 2
    assert equal(results, range(12))
    assert len({process for _, process in results} - {os.getpid()}) == 2
    assert all(record["worker"].startswith("tcp://127.0.0.1:") for record in work.records)
    assert sorted(record["index"] for record in work.records) == list(range(12))


def test_a_worker_killed_in_mid_run_loses_nothing(address, one_thread):
    with spread(address, hologram, [(seed,) for seed in range(40)]) as work:
        killed = None
        for _, (_, process) in work.as_completed():
            if killed is None and len(work.records) >= 4:
                killed = process
                os.kill(killed, signal.SIGKILL)
        assert equal(work.results, range(40))
        assert {process for _, process in work.results} - {killed}
        wait_for(lambda: work.slots() == 2)


def test_results_come_as_they_complete_and_end_in_order(address, tmp_path):
    mark = tmp_path / "mark"
    with spread(address, lambda function, *arguments: function(*arguments), [(await_mark, mark), (divide, 6)]) as work:
        completed = work.as_completed()
        assert next(completed) == (1, 6)
        mark.touch()
        assert list(completed) == [(0, "marked")]
        assert work.results == ["marked", 6]


@pytest.mark.parametrize("chunk", [1, 4])
def test_what_fails_is_reported_and_the_rest_is_done(address, chunk):
    jobs = [(6, value) for value in (1, 0, 2, 3, 0)]
    with spread(address, divide, jobs, chunk=chunk) as work, pytest.raises(TaskError) as caught:
        work.run()
    assert [result for result in work.results if not isinstance(result, Failure)] == [6, 3, 2]
    assert [(failure.index, failure.arguments, failure.attempts) for failure in caught.value.failures] == [
        (1, (6, 0), 2),
        (4, (6, 0), 2),
    ]
    failure = caught.value.failures[0]
    assert isinstance(failure.error, ZeroDivisionError) and failure.worker.startswith("tcp://127.0.0.1:")
    assert "return a / b" in failure.trace and "manager_tasks.py" in failure.trace


def test_a_task_that_failed_once_is_tried_again(address, tmp_path):
    with spread(address, fail_at_first, [(tmp_path / "mark",)]) as work:
        assert work.run() == ["the second time"]


def test_strange_tasks_fail_alone(address):
    jobs = [(divide, 6, 3), (raise_selfish,), (exit_quietly, 1), (threading.Lock,), (Unopenable,), (divide, 8, 2)]
    with spread(address, lambda function, *arguments: function(*arguments), jobs, retries=0) as work:
        work.submit((threading.Lock(),))
        good, selfish, left, lock, unopened, last, unsent = work.run(on_failure="return")
    assert (good, last) == (2, 4)
    assert str(selfish.error) == "SelfishError: one and two"
    assert isinstance(left.error, SystemExit)
    assert isinstance(lock.error, TypeError) and "pickle" in str(lock.error)
    assert isinstance(unopened.error, ValueError) and "on opening the result here" in unopened.trace
    assert isinstance(unsent.error, TypeError) and "pickle" in str(unsent.error)


def test_modules_that_workers_lack_are_sent(address, tmp_path, monkeypatch):
    (tmp_path / "far_away.py").write_text("FACTOR = 3\n\n\ndef triple(value):\n    return FACTOR * value\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    import far_away

    assert isinstance(far_away, types.ModuleType)
    with spread(address, far_away.triple, [(2,)], retries=0) as work:
        (failure,) = work.run(on_failure="return")
    assert isinstance(failure.error, ModuleNotFoundError) and "depends=" in str(failure)
    for depends in ([far_away], [far_away.triple], tmp_path / "far_away.py"):
        with spread(address, far_away.triple, [(2,)], depends=depends) as work:
            assert work.run() == [6]


def test_large_functions_are_sent_once(address):
    table = os.urandom(2**20)
    with spread(address, lambda index: table[index], [(index,) for index in range(50)]) as work:
        assert work.run() == list(table[:50])


def test_large_arguments_are_sent_without_a_warning(address, recwarn):
    picture = torch.rand(2000, 2000)
    with spread(address, torch.flip, [(picture, (0,)), (picture, (1,))]) as work:
        rows, columns = work.run()
    assert torch.equal(rows, picture.flip(0)) and torch.equal(columns, picture.flip(1))
    # Garbage of earlier tests may give warnings of other kinds.
    assert not [said for said in recwarn.list if issubclass(said.category, UserWarning)]


def ended_in_mid_run(work, action, mark):
    """Return the results of three tasks and of many that wait for a mark, ended from another thread before it comes."""
    for job in [(divide, index) for index in range(3)] + [(await_mark, mark)] * 97:
        work.submit(job)

    def wait_and_act():
        wait_for(lambda: len(work.records) == 3)
        action()

    other = threading.Thread(target=wait_and_act)
    other.start()
    try:
        return work.run(on_failure="return")
    finally:
        other.join()
        mark.touch()


def test_cancelling_from_another_thread(address, tmp_path):
    with spread(address, lambda function, *arguments: function(*arguments), []) as work:
        results = ended_in_mid_run(work, work.cancel, tmp_path / "mark")
        assert results[:3] == [0, 1, 2]
        assert len(results) == 100 and all(isinstance(result.error, CancelledError) for result in results[3:])
        work.clear()
        work.submit((divide, 5))
        assert work.run() == [5]


def test_closing_from_another_thread(address, tmp_path):
    work = spread(address, lambda function, *arguments: function(*arguments), [])
    results = ended_in_mid_run(work, work.close, tmp_path / "mark")
    assert results[:3] == [0, 1, 2]
    assert len(results) == 100 and all(isinstance(result.error, CancelledError) for result in results[3:])


def test_closing_leaves_a_cluster_that_was_there(address):
    for _ in range(2):
        with spread(address, divide, [(1, 1)]) as work:
            assert work.run() == [1]
    assert work.client is None


def test_clients_and_clusters_of_dask(address):
    with distributed.Client(address, set_as_default=False) as client:
        with spread(client, divide, [(1, 2)]) as work:
            assert work.run() == [0.5] and work.client is client
        assert client.status == "running"


def test_workers_use_the_threads_that_they_were_given(address):
    with spread(address, threads, [()]) as work:
        assert work.run() == [(1, "1")]
    with spread(address, threads, [()], threads=2) as work:
        assert work.run() == [(2, "2")]
    with spread(address, threads, [()], threads=1) as work:
        assert work.run() == [(1, "1")]


@pytest.mark.skipif(sys.platform != "linux", reason="a matter of glibc")
def test_workers_keep_the_memory_of_freed_arrays(address):
    with spread(address, page_faults, [(16, 10)]) as work:
        assert work.run()[0] < 10 * 16 * 256 / 4


def test_tasks_for_a_gpu_wait_for_one(address):
    # The scheduler may take longer than the first limits to answer.
    for timeout in (0.5, 5.0, 60.0):
        with spread(address, threads, [()], gpu=True, timeout=timeout) as work, pytest.raises(OSError) as caught:
            work.run()
        if "No worker" in str(caught.value):
            break
    assert caught.type is TimeoutError and "No worker with a GPU has joined tcp" in str(caught.value)


@pytest.mark.slow
def test_tasks_for_a_gpu_go_to_the_worker_that_has_it():
    worker = {"cls": distributed.Worker, "options": {"nthreads": 1, "dashboard": False}}
    with_gpu = {"cls": distributed.Worker, "options": {**worker["options"], "resources": {"GPU": 1}}}
    scheduler = {"cls": distributed.Scheduler, "options": {"port": 0, "dashboard_address": "127.0.0.1:0"}}
    with distributed.SpecCluster(scheduler=scheduler, workers={"cpu": worker, "gpu": with_gpu}) as there:
        with spread(there, nap, [(0.01, index) for index in range(20)], gpu=True) as work:
            assert [value for value, _ in work.run()] == list(range(20))
            assert {record["worker"] for record in work.records} == {there.workers["gpu"].address}
        assert there.status.name == "running"


@pytest.mark.parametrize(
    ("gpus", "workers", "expected"),
    [
        ([], 2, [(None, None), (None, None)]),
        (["0", "1"], None, [("0", {"GPU": 1}), ("1", {"GPU": 1})]),
        (["4", "7"], 3, [("4", {"GPU": 1}), ("7", {"GPU": 1}), ("", None)]),
    ],
)
def test_each_gpu_has_one_worker(gpus, workers, expected, monkeypatch):
    monkeypatch.setattr("odak.manager.server.visible_gpus", lambda: gpus)
    monkeypatch.setattr("odak.manager.server.cores", lambda: 12)
    parts = Share(workers, name="desk").parts()
    assert [(part["env"].get("CUDA_VISIBLE_DEVICES"), part["resources"]) for part in parts] == expected
    assert [part["name"] for part in parts] == [f"desk-{index}" for index in range(len(parts))]
    assert {part["env"]["MKL_NUM_THREADS"] for part in parts} == {str(12 // len(parts))}
    assert all(part["nthreads"] == 1 for part in parts)


def test_gpus_are_named_as_the_environment_names_them(monkeypatch):
    from odak.manager import server as machine

    monkeypatch.setattr(machine.shutil, "which", lambda _: "/usr/bin/nvidia-smi")
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert machine.visible_gpus() == ["0", "1"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "GPU-abc, GPU-def")
    assert machine.visible_gpus() == ["GPU-abc", "GPU-def"]


def test_a_task_that_ends_its_process_is_named_and_isolated(address):
    jobs = [(index, index == 17) for index in range(60)]
    with spread(address, end_process, jobs) as work:
        results = work.run(on_failure="return")
    (failure,) = [result for result in results if isinstance(result, Failure)]
    assert [result for result in results if not isinstance(result, Failure)] == [i for i in range(60) if i != 17]
    assert (failure.index, failure.arguments) == (17, (17, True)) and isinstance(failure.error, ChildProcessError)
    assert "exit code 3" in str(failure.error) and failure.attempts == 2
    # Nothing else was computed twice.
    assert sorted(record["index"] for record in work.records) == sorted([*range(60), 17])


@pytest.mark.slow
def test_the_tasks_of_the_same_group_are_not_charged(address, tmp_path):
    jobs = [(99, tmp_path / "always"), *((0, tmp_path / f"never {index}") for index in range(5))]
    with spread(address, crash, jobs, retries=0, chunk=3) as work:
        always, *never = work.run(on_failure="return")
    assert isinstance(always, Failure) and "SIGKILL" in str(always.error) and always.attempts == 4
    assert never == [0] * 5
    assert sorted(record["index"] for record in work.records) == [0, 0, 0, 0, 1, 2, 3, 4, 5]


def test_a_task_whose_process_is_killed_runs_again(address, tmp_path):
    with spread(address, crash, [(2, tmp_path / "twice")], retries=0) as work:
        assert work.run() == [2]


@pytest.mark.slow
def test_a_stopped_process_is_replaced(address, tmp_path):
    with spread(address, stop_at_first, [(tmp_path / "mark",)], retries=0) as work:
        assert work.run() == ["the second time"]


def test_lost_groups_are_no_attempts():
    class Forgetful(backends.Serial):
        def wait(self):
            group, jobs = self._started.popleft()
            if len(group) > 1:
                return [(group, backends.Lost("gone"))]
            self._started.appendleft((group, jobs))
            return super().wait()

    work = agent(divide, cluster=False, retries=0, chunk=4, verbose=False)
    work._backend = Forgetful()
    for index in range(10):
        work.submit((index,))
    assert work.run() == list(range(10))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGKILL", "SIGSTOP"])
def test_workers_killed_from_outside_lose_nothing(name):
    scheduler, address = start_scheduler()
    workers = start_workers(address, 3)
    try:
        with spread(address, nap, [(0.05, index) for index in range(200)]) as work:
            work.connect()
            processes = list(work.client.run(os.getpid).values())
            for _ in work.as_completed():
                if len(work.records) in (20, 60):
                    os.kill(processes.pop(), getattr(signal, name))
            assert [value for value, _ in work.results] == list(range(200))
    finally:
        stop(scheduler, *workers)


@pytest.mark.slow
def test_all_workers_but_one_gone_for_good(address):
    scheduler, address = start_scheduler()
    workers = start_workers(address, 3)
    try:
        with spread(address, nap, [(0.05, index) for index in range(200)]) as work:
            for _ in work.as_completed():
                if len(work.records) in (30, 80):
                    gone = workers.pop()
                    gone.kill()
                    stop(gone)
            assert [value for value, _ in work.results] == list(range(200))
    finally:
        stop(scheduler, *workers)


def test_shared_arguments_are_sent_once(address):
    picture = torch.randint(8, (500, 500), dtype=torch.float64)  # whole numbers: sums are exact in any order
    with spread(address, None, []) as work:
        sums = work.map(weighted_sum, range(40), shared={"picture": picture})
    assert sums == [float((index * picture).sum()) for index in range(40)]
