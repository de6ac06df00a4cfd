"""The agent in this process, where no cluster is needed: order, failures, retries, cancelling, arguments."""

import subprocess
import sys
from concurrent.futures import CancelledError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from manager_tasks import divide, exit_quietly, fail_at_first

from odak import manager
from odak._warnings import MissingPackageWarning
from odak.manager import Failure, TaskError, agent, backends
from odak.manager.distribute import describe


def serial(compute, jobs, **options):
    work = agent(compute, cluster=False, **{"verbose": False, **options})
    for job in jobs:
        work.submit(job)
    return work


def test_results_are_in_order_of_submission_and_repeatable():
    calls = []
    work = serial(lambda value: calls.append(value) or 2 * value, [[3], [1], [2]])
    assert work.run() == [6, 2, 4] == work.results == work.run()
    assert calls == [3, 1, 2] * 2
    work.clear()
    assert work.run() == [] == work.jobs
    assert work.close() is True and work.close() is True
    with pytest.raises(RuntimeError, match="closed"):
        work.run()


def test_keywords_and_numbers():
    work = agent(divide, cluster=False, verbose=False)
    assert [work.submit((8,), {"b": 2}), work.submit((8, 4)), work.submit([8])] == [0, 1, 2]
    assert work.run() == [4, 2, 8]
    assert [(record["index"], record["failed"]) for record in work.records] == [(0, False), (1, False), (2, False)]


@given(st.lists(st.integers(-3, 3), max_size=20), st.integers(0, 2))
def test_what_fails_is_reported_and_the_rest_is_done(values, retries):
    work = serial(divide, [(1, value) for value in values], retries=retries)
    results = work.run(on_failure="return")
    for value, result in zip(values, results, strict=True):
        assert (isinstance(result, Failure) and result.attempts == retries + 1) if value == 0 else result == 1 / value
    assert len(work.records) == len(values) + retries * values.count(0)


def test_failures_carry_arguments_and_traceback():
    work = serial(divide, [(1, 1), (5, 0), (np.ones((2, 3)), np.zeros(4))])
    with pytest.raises(TaskError) as caught:
        work.run()
    first, second = caught.value.failures
    assert (first.index, first.arguments, first.attempts) == (1, (5, 0), 2)
    assert isinstance(first.error, ZeroDivisionError) and caught.value.__cause__ is first.error
    text = str(caught.value)
    for part in (
        "2 of 3 tasks failed",
        "task 1 with arguments (5, 0): ZeroDivisionError: division by zero (2 attempts, the last on this process)",
        "return a / b",
        "ndarray[2, 3] of float64, ndarray[4] of float64",
    ):
        assert part in text
    assert "odak/manager/tasks.py" not in text
    assert caught.value.results == [1.0, first, second] == work.results


def test_a_task_that_failed_once_is_tried_again(tmp_path):
    path = tmp_path / "mark"
    work = serial(fail_at_first, [(path,)])
    assert work.run() == ["the second time"]
    assert [record["failed"] for record in work.records] == [True, False]
    path.unlink()
    assert isinstance(serial(fail_at_first, [(path,)], retries=0).run("return")[0].error, RuntimeError)


def test_sys_exit_is_a_failure():
    (failure,) = serial(exit_quietly, [(3,)]).run(on_failure="return")
    assert isinstance(failure.error, SystemExit)


def test_results_come_as_they_complete():
    work = serial(divide, [(6, value) for value in (1, 2, 0)])
    seen = []
    for index, result in work.as_completed():
        seen.append((index, result if index < 2 else type(result)))
        assert work.results[index] is result
    assert seen == [(0, 6), (1, 3), (2, Failure)]


def test_cancelling_leaves_what_is_done():
    work = serial(lambda value: value if value < 2 else work.cancel(), [(value,) for value in range(9)])
    with pytest.raises(TaskError) as caught:
        work.run()
    assert work.results[:3] == [0, 1, None]
    assert [failure.index for failure in caught.value.failures] == list(range(3, 9))
    assert all(isinstance(failure.error, CancelledError) and not failure.attempts for failure in caught.value.failures)
    assert "task 3 with arguments (3): CancelledError: cancelled before it was done" in str(caught.value)
    assert "and 3 more" in str(caught.value)


def test_leaving_the_loop_ends_the_run():
    calls = []
    work = serial(calls.append, [(value,) for value in range(9)])
    for _ in work.as_completed():
        break
    assert calls == [0]
    assert work.run() == [None] * 9


def test_a_run_within_a_run_is_refused():
    work = serial(lambda: work.run(), [()], retries=0)
    (failure,) = work.run(on_failure="return")
    assert "running already" in str(failure.error)


def test_progress_is_shown_unless_it_is_not_wanted(capsys):
    serial(divide, [(1, 1), (1, 0)], verbose=True).run(on_failure="return")
    shown = capsys.readouterr().err
    assert "divide" in shown and "2/2" in shown and "failed=1" in shown
    serial(divide, [(1, 1)]).run()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"compute": 3}, TypeError, "compute must be a function, got 3"),
        ({"cluster": "slurm"}, ValueError, "'local', the address of a scheduler .* got 'slurm'"),
        ({"cluster": 3}, TypeError, "cluster must be a string, a Dask cluster or client, or False; got int"),
        ({"retries": -1}, ValueError, "retries must be at least 0"),
        ({"chunk": 0}, ValueError, "chunk must be at least 1"),
        ({"in_flight": 0}, ValueError, "in_flight must be at least 1"),
        ({"timeout": -1.0}, ValueError, "timeout must be positive"),
        ({"workers": 0}, ValueError, "workers must be at least 1"),
        ({"workers": 2, "cluster": False}, ValueError, "workers must be left out"),
        ({"workers": 2, "cluster": "tcp://127.0.0.1:1"}, ValueError, "unless cluster='local' or server=True"),
        ({"threads": 1.5}, TypeError, "threads must be an integer"),
        ({"cluster": "tcp://10.1.2.3:8786"}, ValueError, "not an address of this machine only, and over plain TCP"),
        ({"cluster": "10.1.2.3:8786"}, ValueError, "or set trusted_network=True"),
        ({"security": 3}, TypeError, "security must be a distributed.Security, a folder or True, got int"),
        ({"depends": [3]}, TypeError, "depends must be modules, functions or paths, got int"),
        ({"depends": "missing.py"}, ValueError, "depends must name existing files, got"),
        ({"depends": "notes.txt"}, ValueError, "not allowed"),
    ],
)
def test_arguments_are_checked(arguments, error, message):
    with pytest.raises(error, match=message):
        agent(**{"compute": divide, **arguments})


def test_map_with_shared_arguments():
    with agent(cluster=False, verbose=False) as work:
        assert work.map(divide, [6, 8], shared={"b": 2}) == [3, 4] == work.results
        assert work.map(abs, iter([-1, 2])) == [1, 2] and work.jobs == []
        with pytest.raises(TaskError, match="1 of 2 tasks failed"):
            work.map(divide, [1, "one"], shared={"b": 2})
        with pytest.raises(ValueError, match="compute must be given"):
            work.submit((1,))
        for arguments, message in (((3, [1]), "function must be a function"), ((abs, 1), "items must be an iterable")):
            with pytest.raises(TypeError, match=message):
                work.map(*arguments)


def test_without_dask_tasks_run_here(monkeypatch):
    monkeypatch.setattr(backends, "has_dask", lambda: False)
    monkeypatch.setattr("odak.manager.server.has_dask", lambda: False)
    with pytest.warns(MissingPackageWarning, match="Dask is not installed"):
        work = agent(divide, verbose=False)
    work.submit((6, 3))
    assert work.run() == [2]
    assert work.client is None and work.slots() == 1
    for call in (lambda: agent(divide, "local"), lambda: agent(divide, "tcp://127.0.0.1:1"), manager.start_server):
        with pytest.raises(ImportError, match=r"pip install 'dask\[distributed\]'"):
            call()


def test_nothing_of_dask_is_loaded_before_it_is_needed():
    code = (
        "import sys, odak.manager; work = odak.manager.agent(abs, cluster=False, verbose=False); work.submit((-1,));"
        "assert work.run() == [1]; print(sorted({'dask', 'distributed', 'torch', 'cloudpickle'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_descriptions_are_short():
    assert describe(np.zeros((2, 3), np.float32)) == "ndarray[2, 3] of float32"
    assert len(describe("x" * 1000)) < 50 and len(describe(list(range(1000)))) < 50


def test_a_cluster_set_later_is_refused():
    work = agent(cluster=False)
    with pytest.raises(AttributeError, match="cluster cannot be set: the whole agent"):
        work.cluster = "local"
