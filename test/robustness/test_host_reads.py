"""Numbers are read from a device where a reason is stated, and nowhere else."""

from fnmatch import fnmatchcase

import pytest
from host_reads import AT_RUN_TIME, host_reads, is_permitted, permitted

# With other tests that read the syntax trees of all modules, in one process.
pytestmark = pytest.mark.xdist_group("structure")


@pytest.fixture(scope="module")
def places():
    return host_reads()


def test_numbers_are_read_where_a_reason_is_stated_only(places):
    # `test_devices` adds what only a run shows.
    assert sorted(place for place in places if not is_permitted(place)) == []


def test_no_reason_is_left_of_code_that_has_gone(places):
    unused = {pattern for pattern in permitted() if not any(fnmatchcase(place, pattern) for place in places)}
    assert unused == AT_RUN_TIME
    assert len(set(permitted())) == len(permitted())


@pytest.mark.parametrize(
    "line",
    (
        "x.sum().item()",
        "y = [x.cpu() for x in y]",
        "while not x.any() and y: pass",
        "y = 1 if x.all() else 2",
        "float(x[0] - x.max())",
        "bool(torch.equal(x, y))",
        "x.detach().numpy()",
        "{'a': x.tolist()}",
    ),
)
def test_a_read_is_found(line, tmp_path):
    (tmp_path / "one.py").write_text(f"def outer(x, y):\n    def inner(x):\n        {line}\n", encoding="utf-8")
    assert host_reads(tmp_path) == {"one:inner"}


@pytest.mark.parametrize(
    "line",
    (
        "raise ValueError(f'got {x.min().item()}')",
        "int(torch.randint(2**62, ()))",
        "torch.randperm(4, generator=y).tolist()",
        "float(math.sqrt(x))",
        "x.to('cpu', non_blocking=True)",
        "if any(x): pass",
    ),
)
def test_what_reads_nothing_is_not_found(line, tmp_path):
    (tmp_path / "one.py").write_text(f"def outer(x, y):\n    {line}\n", encoding="utf-8")
    assert host_reads(tmp_path) == set()
