"""The PyTorch operator: blocks, adjoint, transforms, threads and devices."""

import itertools
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from odak._array import convolve_plainly
from odak.learn.wave import intensity, propagate_beam
from odak.wave import torch_convolution as convolution
from odak.wave.torch_convolution import Workspace


@pytest.fixture
def blocked(monkeypatch):
    """Send even small fields through the blocked path, in blocks of a few columns."""
    monkeypatch.setattr(convolution, "BLOCKED_FROM", 0)
    monkeypatch.setattr(convolution, "ONE_BLOCKED_FROM", 0)
    monkeypatch.setattr(convolution, "_BLOCK_BYTES", 700)
    monkeypatch.setattr(convolution, "_COLUMNS", 3)


def pair(*shape, kernel=(24, 31), dtype=torch.complex128):
    generator = torch.Generator().manual_seed(1)
    return (torch.randn(*size, dtype=dtype, generator=generator) for size in (shape, kernel))


@pytest.mark.parametrize("shape", [(12, 15), (24, 31), (2, 3, 12, 15), (2, 1, 12, 15)])
@pytest.mark.parametrize("kernel", [(24, 31), (3, 24, 31), (2, 1, 24, 31)])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.complex64, 1e-5), (torch.complex128, 1e-13)])
def test_blocks_equal_whole_transforms(blocked, shape, kernel, dtype, tolerance):
    field, factor = pair(*shape, kernel=kernel, dtype=dtype)
    expected = convolve_plainly(field, factor)
    torch.testing.assert_close(convolution.convolve(field, factor), expected, rtol=tolerance, atol=tolerance)
    columns = factor.mT.contiguous().mT
    torch.testing.assert_close(convolution.convolve(field, columns), expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("kernel", [(24, 31), (1, 1, 24, 31)])
@pytest.mark.parametrize("shape", [(5, 12, 15), (2, 3, 12, 15)])
@pytest.mark.parametrize("at_once", [1, 2])
def test_batches_in_parts_equal_whole_ones(shape, kernel, at_once, monkeypatch):
    field, factor = pair(*shape, kernel=kernel)
    expected = torch.fft.ifft2(torch.fft.fft2(field, s=(24, 31)) * factor)[..., :12, :15]
    # Several threads would take smaller parts.
    torch.set_num_threads(1)
    counts, filtered = [], convolution._convolve_whole

    def counting(part, *arguments):
        counts.append(part.shape[:-2].numel())
        return filtered(part, *arguments)

    monkeypatch.setattr(convolution, "_convolve_whole", counting)
    monkeypatch.setattr(convolution, "_BLOCK_BYTES", at_once * 24 * 31 * 16)
    torch.testing.assert_close(convolution.convolve(field, factor), expected, rtol=0, atol=1e-12)
    assert max(counts) == at_once and sum(counts) == field[..., 0, 0].numel()
    result = convolution.convolve(field.requires_grad_(), factor)
    (back,) = torch.autograd.grad(result, field, result.detach())
    (wanted,) = torch.autograd.grad(convolve_plainly(field, factor), field, result.detach())
    torch.testing.assert_close(back, wanted, rtol=0, atol=1e-10)


@pytest.mark.parametrize("path", ["whole", "blocked"])
@pytest.mark.parametrize("shape", [(12, 15), (2, 1, 12, 15)])
@pytest.mark.parametrize("kernel", [(24, 31), (3, 24, 31)])
def test_adjoint_is_the_transpose(path, shape, kernel, request):
    if path == "blocked":
        request.getfixturevalue("blocked")
    field, factor = pair(*shape, kernel=kernel)
    field.requires_grad_()
    small = field.detach()[..., :2, :3].requires_grad_()
    assert torch.autograd.gradcheck(lambda u: convolution.convolve(u, factor[..., :5, :6]), (small,), fast_mode=True)
    assert torch.autograd.gradgradcheck(
        lambda u: convolution.convolve(u, factor[..., :5, :6]), (small,), fast_mode=True
    )
    result = convolution.convolve(field, factor)
    other = torch.randn_like(result)
    (back,) = torch.autograd.grad(result, field, other)
    there, here = (
        torch.vdot(a.flatten(), b.flatten()).item() for a, b in ((other, result.detach()), (back, field.detach()))
    )
    assert there == pytest.approx(here)


def test_one_field_through_many_kernels_is_transformed_once(blocked, monkeypatch):
    field, factor = pair(2, 1, 12, 15, kernel=(5, 24, 31))
    # Additions from several threads could be lost.
    torch.set_num_threads(1)
    lines = {"fft": 0, "ifft": 0}

    def counting(name, transform):
        def counted(array, *args, **options):
            lines[name] += array[..., 0].numel()
            return transform(array, *args, **options)

        return counted

    for name in lines:
        monkeypatch.setattr(torch.fft, name, counting(name, getattr(torch.fft, name)))
    result = convolution.convolve(field.requires_grad_(), factor)
    assert lines == {"fft": 2 * (12 + 31), "ifft": 2 * 5 * (31 + 12)}
    lines.update(fft=0, ifft=0)
    result.backward(torch.ones_like(result))
    assert sum(lines.values()) == 2 * 5 * (12 + 31) + 2 * (31 + 12)


def test_nothing_but_the_kernel_is_saved():
    field, factor = pair(12, 15)
    saved = []
    with torch.autograd.graph.saved_tensors_hooks(lambda tensor: saved.append(tensor) or tensor, lambda tensor: tensor):
        convolution.convolve(field.requires_grad_(), factor)
    assert [tensor.data_ptr() for tensor in saved] == [factor.data_ptr()] * len(saved)


def loss(field, distance=1e-3):
    # Not "auto": its rule depends on numbers that vmap hides.
    return propagate_beam(field, None, distance, 8e-6, 532e-9, "BLAS").abs().square().sum()


def test_functional_transforms():
    fields, _ = pair(3, 6, 7)
    values = torch.stack([loss(field) for field in fields])
    torch.testing.assert_close(torch.func.vmap(loss)(fields), values)
    grads = torch.stack([torch.func.grad(loss)(field) for field in fields])
    torch.testing.assert_close(torch.func.vmap(torch.func.grad(loss))(fields), grads)
    distances = torch.tensor([1e-3, 2e-3], dtype=torch.float64)
    swept = torch.func.vmap(lambda z: loss(fields[0], z))(distances)
    torch.testing.assert_close(swept, torch.stack([loss(fields[0], float(z)) for z in distances]))


@pytest.mark.parametrize("in_dims", [(0, None), (None, 0), (0, 0), (2, 1)])
def test_vmap_over_field_and_kernel(in_dims):
    fields, kernels = pair(3, 4, 5, kernel=(3, 8, 10))
    fields = fields if in_dims[0] is None else fields.movedim(0, in_dims[0])
    kernels = kernels if in_dims[1] is None else kernels.movedim(0, in_dims[1])
    result = torch.func.vmap(convolution.convolve, in_dims)(fields, kernels)
    for index in range(3):
        field = fields if in_dims[0] is None else fields.select(in_dims[0], index)
        kernel = kernels if in_dims[1] is None else kernels.select(in_dims[1], index)
        torch.testing.assert_close(result[index], convolve_plainly(field, kernel))


@pytest.mark.filterwarnings("ignore:.*torch.jit.*:DeprecationWarning")
def test_forward_mode_agrees_with_reverse_mode():
    (field, _), (tangent, _) = pair(6, 7), pair(6, 7)
    tangent = tangent * 1j + 1
    value, slope = torch.func.jvp(loss, (field,), (tangent,))
    gradient = torch.func.grad(loss)(field)
    assert value == pytest.approx(float(loss(field)))
    assert slope == pytest.approx(float((gradient.conj() * tangent).real.sum()))


def test_kernels_built_in_inference_mode_serve_autograd_later():
    field, _ = pair(6, 7)
    with torch.inference_mode():
        propagate_beam(field, None, 1e-3, 8e-6, 532e-9)
    field = field.clone().requires_grad_()
    loss(field).backward()
    assert field.grad.abs().sum() > 0


def test_threads_do_not_share_scratch(blocked):
    field, factor = pair(40, 50, kernel=(80, 100))
    expected = convolution.convolve(field, factor)
    results = []
    threads = [threading.Thread(target=lambda: results.append(convolution.convolve(field, factor))) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(torch.equal(result, expected) for result in results)


@pytest.mark.parametrize("kernel", [(24, 31), (3, 24, 31)])
@pytest.mark.parametrize("mode", [torch.enable_grad, torch.no_grad, torch.inference_mode])
def test_parts_on_several_threads(blocked, kernel, mode):
    field, factor = pair(2, 1, 12, 15, kernel=kernel)
    torch.set_num_threads(3)
    expected = convolve_plainly(field, factor)
    with mode():
        result = convolution.convolve(field.clone().requires_grad_(mode is torch.enable_grad), factor)
    torch.testing.assert_close(result.detach(), expected, rtol=0, atol=1e-13)


def test_a_constant_beside_mapped_tensors_keeps_its_gradient():
    field, factor = pair(12, 15)
    field.requires_grad_()

    def powers(weights):
        return torch.func.vmap(lambda weight: intensity(weight * convolution.convolve(field, factor)).sum())(weights)

    weights = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    (found,) = torch.autograd.grad(powers(weights).sum(), field)
    (expected,) = torch.autograd.grad(14 * intensity(convolve_plainly(field, factor)).sum(), field)
    torch.testing.assert_close(found, expected)


def test_a_part_that_fails_ends_the_call(blocked, monkeypatch):
    field, factor = pair(12, 15)
    torch.set_num_threads(2)
    padded, calls = convolution._padded, itertools.count()

    def failing(*arguments):
        if next(calls) == 3:
            raise MemoryError("of one part")
        return padded(*arguments)

    monkeypatch.setattr(convolution, "_padded", failing)
    with pytest.raises(MemoryError, match="of one part"):
        convolution.convolve(field, factor)
    torch.testing.assert_close(convolution.convolve(field, factor), convolve_plainly(field, factor))


def test_calls_from_several_threads_at_once(blocked):
    field, factor = pair(12, 15)
    torch.set_num_threads(2)
    expected = convolve_plainly(field, factor)
    with ThreadPoolExecutor(4) as callers:
        results = callers.map(lambda number: convolution.convolve(number * field, factor), range(40))
        for number, result in enumerate(results):
            torch.testing.assert_close(result, number * expected, rtol=0, atol=1e-11)


def test_a_batch_on_several_threads():
    field, factor = pair(5, 12, 15)
    torch.set_num_threads(3)
    with torch.inference_mode():
        result = convolution._convolve_by_fields(field, factor, False, (5,))
    torch.testing.assert_close(result, convolve_plainly(field, factor), rtol=0, atol=1e-13)


@pytest.mark.parametrize("blocked_from", [0, 1 << 20])
def test_conjugate_views_and_strides_are_read_right(blocked_from, monkeypatch):
    monkeypatch.setattr(convolution, "BLOCKED_FROM", blocked_from)
    field, factor = pair(15, 12)
    turned = field.conj().mT
    expected = convolve_plainly(turned.resolve_conj().contiguous(), factor)
    torch.testing.assert_close(convolution.convolve(turned, factor), expected)
    (back,) = torch.autograd.grad(convolution.convolve(turned.requires_grad_(), factor), turned, turned.detach())
    torch.testing.assert_close(back, convolve_plainly(turned.detach().resolve_conj(), factor.conj()))
    assert not back.is_conj() and back.is_contiguous()


@pytest.mark.cuda
def test_cuda_agrees_with_the_cpu():
    field, _ = pair(64, 70)
    expected = propagate_beam(field, None, 1e-3, 8e-6, 532e-9)
    result = propagate_beam(field.cuda(), None, 1e-3, 8e-6, 532e-9)
    assert result.is_cuda
    torch.testing.assert_close(result.cpu(), expected)
    # A length on a GPU is not read for a rule of its own, as one inside a transform is not.
    distances = torch.tensor([1e-3], dtype=torch.float64)
    unread = torch.func.vmap(lambda distance: propagate_beam(field, None, distance, 8e-6, 532e-9))(distances)[0]
    of_tensor = propagate_beam(field.cuda(), None, distances[0].cuda(), 8e-6, 532e-9)
    torch.testing.assert_close(of_tensor.cpu(), unread)
    assert not torch.allclose(unread, expected)


def test_a_workspace_holds_the_result(blocked):
    field, factor = pair(1, 12, 15, kernel=(3, 24, 31))
    workspace = Workspace()
    first = convolution.convolve(field, factor, workspace)
    expected = convolution.convolve(field, factor)
    torch.testing.assert_close(first, expected)
    again = convolution.convolve(2 * field, factor, workspace)
    assert again.data_ptr() == first.data_ptr()
    torch.testing.assert_close(again, 2 * expected)


@pytest.mark.slow
def test_the_operator_is_found_with_the_first_tensor():
    code = (
        "import odak, torch; field = torch.ones(8, 8, requires_grad=True);"
        "before = odak.wave.angular_spectrum(field, None, 1e-4, 8e-6, 532e-9).grad_fn.name(); import odak.learn.wave;"
        "print(before, odak.wave.angular_spectrum(field, None, 1e-4, 8e-6, 532e-9).grad_fn.name())"
    )
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert printed.split() == ["_LinearBackward"] * 2
