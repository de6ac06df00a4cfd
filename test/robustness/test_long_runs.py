"""Hours of work in miniature: memory stays flat, caches keep their bounds, thousands of tasks come back in order."""

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

psutil = pytest.importorskip("psutil")
import long_run_tasks as tasks  # noqa: E402

MB = 1 << 20
ITERATIONS = int(os.environ.get("ODAK_LONG_RUN", "1000"))
pytestmark = pytest.mark.slow


def in_a_fresh_process(task, *arguments):
    """Return what a task returns in a process that has done nothing else."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(task, *arguments).result()


def test_one_long_optimisation():
    """ODAK_LONG_RUN=10000 makes it as long; the bound is the same."""
    growth = in_a_fresh_process(tasks.one_long_optimisation, ITERATIONS)
    assert growth["rss"] < 5 * MB and growth["objects"] < 50


def test_many_short_optimisations():
    growth = in_a_fresh_process(tasks.many_short_optimisations, 150)
    assert growth["rss"] < 5 * MB and growth["objects"] < 100


def test_thousands_of_geometries_stay_within_the_bound_of_the_kernels():
    """A kernel of the padded fields takes 24 to 40 kB, so that the 1 MB hold some thirty of them."""
    growth = in_a_fresh_process(tasks.many_geometries, 2000, MB)
    assert MB / 2 < growth["most"] <= MB
    assert growth["rss"] < 5 * MB and growth["objects"] < 1500


def test_many_targets_and_gazes():
    growth = in_a_fresh_process(tasks.many_targets, 300)
    assert growth["rss"] < 5 * MB and growth["objects"] < 100


def test_many_rays():
    growth = in_a_fresh_process(tasks.many_rays, 200)
    assert growth["rss"] < 5 * MB and growth["objects"] < 100


def test_many_figures():
    growth = in_a_fresh_process(tasks.many_figures, 60)
    assert growth["rss"] < 5 * MB and growth["objects"] < 500


def test_thousands_of_tasks_on_two_workers():
    pytest.importorskip("distributed")
    from running_cluster import cluster

    from odak.manager import agent

    with agent(tasks.square, cluster(), verbose=False) as work:
        work.connect()

        def round_of(first, count):
            work.clear()
            for number in range(first, first + count):
                work.submit((number,))
            assert work.run() == [number * number for number in range(first, first + count)]
            return {
                "scheduler": work.client.run_on_scheduler(tasks.resident),
                **work.client.run(tasks.resident),
            }, work.client.run(tasks.files_of_worker)

        before, files = round_of(0, 500)
        after, left = round_of(500, 1500)
        assert len(before) == 3 and left == files
        growth = {name: after[name] - before[name] for name in before}
        # The scheduler keeps a log of its last transitions, of bounded length.
        assert growth.pop("scheduler") < 25 * MB
        assert max(growth.values()) < 5 * MB
