"""Local means in strips against torch's own pooling and enlargement; banded matrices against dense ones."""

import pytest
import scipy.sparse
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from odak.learn.perception import foveation
from odak.learn.perception.foveation import Banded, MipSampler, UniformSampler


def noise(*shape, seed=0):
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def samplers(rows, columns, largest=5.0):
    squares = (max(1, rows // 5), max(1, columns // 3))
    return {
        "mip": MipSampler(largest * noise(rows, columns, seed=7), torch.float64),
        "uniform": UniformSampler((rows, columns), squares, torch.device("cpu"), torch.float64),
    }


@pytest.mark.parametrize(("rows", "columns", "step"), [(5, 9, 2), (16, 8, 16), (1, 3, 4)])
def test_banded(rows, columns, step):
    matrix = scipy.sparse.random(rows, columns, 0.4, random_state=0).tolil()
    matrix.setdiag(1.0)
    for row in range(rows):
        matrix[row, row % columns] = 1.0
    dense, banded = torch.from_numpy(matrix.toarray()), Banded(matrix.tocsr(), step, torch.float64)
    tall, wide = noise(columns, 2, 3), noise(2, 3, columns)
    torch.testing.assert_close(banded.on_rows(tall), torch.einsum("mn,nab->mab", dense, tall))
    torch.testing.assert_close(banded.on_columns(wide), wide @ dense.T)
    tall, wide = noise(rows, 2, 3), noise(2, 3, rows)
    torch.testing.assert_close(banded.on_rows_adjoint(tall), torch.einsum("mn,mab->nab", dense, tall))
    torch.testing.assert_close(banded.on_columns_adjoint(wide), wide @ dense)


@settings(max_examples=30)
@given(rows=st.integers(1, 40), columns=st.integers(1, 40), largest=st.floats(0, 7))
def test_against_whole_levels(rows, columns, largest):
    for sampler in samplers(rows, columns, largest).values():
        picture = noise(2, 3, rows, columns).requires_grad_()
        fast, plain = sampler(picture), sampler.plainly(picture)
        torch.testing.assert_close(fast, plain)
        outer = noise(2, 3, rows, columns, seed=1)
        gradients = [torch.autograd.grad(value, picture, outer)[0] for value in (fast, plain)]
        torch.testing.assert_close(*gradients)


def test_planes_come_in_chunks_and_rows_in_strips(monkeypatch):
    picture = noise(1, 5, 40, 24).requires_grad_()
    for name, sampler in samplers(40, 24).items():
        whole = sampler(picture)
        monkeypatch.setattr(foveation, "CHUNK", 1)
        monkeypatch.setattr(foveation, "_strip_rows", lambda columns: 7)
        foveation._mip_levels.cache_clear()
        foveation._uniform_levels.cache_clear()
        small = samplers(40, 24)[name]
        assert len(small.strips) == 6
        assert len(foveation.plane_chunks(small, picture[0].movedim(0, 1))) == 5
        torch.testing.assert_close(small(picture), whole)
        torch.testing.assert_close(*[torch.autograd.grad(v.pow(2).sum(), picture)[0] for v in (small(picture), whole)])
        monkeypatch.undo()
        foveation._mip_levels.cache_clear()
        foveation._uniform_levels.cache_clear()


@pytest.mark.parametrize("name", ["mip", "uniform"])
def test_derivatives_and_transforms(name):
    sampler, picture = samplers(7, 10)[name], noise(1, 2, 7, 10).requires_grad_()
    assert torch.autograd.gradcheck(sampler, picture, fast_mode=True)
    assert torch.autograd.gradgradcheck(lambda image: sampler(image) ** 2, picture, fast_mode=True)

    def energy(image):
        return (sampler(image) ** 2).sum()

    energy(picture).backward()
    torch.testing.assert_close(torch.func.grad(energy)(picture.detach()), picture.grad)
