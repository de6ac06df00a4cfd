"""A batch spread over devices and over processes gives what the whole batch gives, gradients included."""

import pytest
import torch
from rank_tasks import LIGHT, check_gradients, check_rank, fields, in_parts

from odak.learn.wave import across_devices, across_ranks, propagate_beam

TWICE = ["cpu", "cpu"]


@pytest.mark.parametrize("count", [1, 4, 5])
@pytest.mark.parametrize(("dtype", "rounding"), [(torch.complex64, 1e-6), (torch.complex128, 1e-14)])
def test_a_batch_over_two_devices_is_the_whole_batch(count, dtype, rounding):
    batch = fields(count, dtype)
    spread = across_devices(propagate_beam, batch, *LIGHT, devices=TWICE)
    assert spread.dtype == dtype and torch.equal(spread, in_parts(2)(propagate_beam, batch, *LIGHT))
    torch.testing.assert_close(spread, propagate_beam(batch, *LIGHT), rtol=0, atol=rounding)


@pytest.mark.parametrize("count", [1, 5])
def test_gradients_are_those_of_the_whole_batch(count):
    check_gradients(lambda *given: across_devices(*given, devices=TWICE), count, 2)


def test_gradcheck():
    field = fields(3, torch.complex128, 3).requires_grad_()
    millimetres = torch.tensor(1.0, dtype=torch.float64, requires_grad=True)

    def spread(field, millimetres):
        return across_devices(propagate_beam, field, None, 1e-3 * millimetres, *LIGHT[2:], devices=TWICE)

    assert torch.autograd.gradcheck(spread, (field, millimetres), fast_mode=True)


def test_each_device_gets_its_share():
    seen = []
    across_devices(lambda part: seen.append(len(part)) or part, torch.zeros(7, 2), devices=["cpu"] * 3)
    assert seen == [3, 2, 2]
    seen.clear()
    assert across_devices(
        lambda part: seen.append(len(part)) or part, torch.zeros(2, 2), devices=["cpu"] * 3
    ).shape == (2, 2)
    assert seen == [1, 1]


def test_several_tensors_in_and_out():
    a, b = fields(5), fields(5) * 2
    first, second = across_devices(lambda x, y, scale: (x + y, scale * y[:, 0]), (a, b), scale=3.0, devices=TWICE)
    assert torch.equal(first, a + b) and torch.equal(second, 3.0 * b[:, 0])


def test_without_more_devices_the_function_is_called():
    batch = fields(3)
    assert torch.equal(across_devices(propagate_beam, batch, *LIGHT, devices=["cpu"]), propagate_beam(batch, *LIGHT))
    assert torch.equal(across_ranks(propagate_beam, batch, *LIGHT), propagate_beam(batch, *LIGHT))


@pytest.mark.parametrize("spread", [across_devices, across_ranks])
def test_batches_are_checked(spread):
    with pytest.raises(TypeError, match="batch must be a tensor or a tuple of them, got str"):
        spread(torch.abs, "field")
    with pytest.raises(ValueError, match=r"same length for all its tensors; got \(2,\), \(3,\)"):
        spread(torch.add, (torch.zeros(2), torch.zeros(3)))
    with pytest.raises(ValueError, match=r"batch must have a first axis.*got \(\)"):
        spread(torch.abs, torch.tensor(1.0))


def test_devices_are_checked():
    with pytest.raises(ValueError, match="devices must name at least one device"):
        across_devices(torch.abs, torch.zeros(2), devices=[])


def test_one_rank(tmp_path):
    check_rank(0, 1, tmp_path / "meet")


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_a_batch_over_processes_is_the_whole_batch(ranks, tmp_path):
    torch.multiprocessing.spawn(check_rank, (ranks, tmp_path / "meet"), nprocs=ranks)


@pytest.mark.cuda
def test_on_cuda_devices():
    batch = fields(6).cuda()
    spread = across_devices(propagate_beam, batch, *LIGHT, devices=[0] * 2 + list(range(torch.cuda.device_count())))
    assert spread.device == batch.device
    torch.testing.assert_close(spread, propagate_beam(batch, *LIGHT), rtol=1e-5, atol=1e-6)
    from_cpu = across_devices(propagate_beam, batch.cpu(), *LIGHT)
    assert from_cpu.device.type == "cpu"
    torch.testing.assert_close(from_cpu, spread.cpu(), rtol=1e-5, atol=1e-6)
