import torch

from odak._torch_private import linear


class Rotation:
    """Two tensors turned into each other; None stands for zero."""

    def forward(self, x, y, sign=1):
        x, y = (0.0 if value is None else value for value in (x, y))
        return 0.6 * x - sign * 0.8 * y, sign * 0.8 * x + 0.6 * y

    def adjoint(self, x, y):
        return self.forward(x, y, -1)


def turned(x, y):
    return linear(Rotation(), False, x, y)


def test_a_linear_map_of_several_tensors_is_differentiable():
    x, y = (torch.rand(2, 3, dtype=torch.float64, requires_grad=True) for _ in "xy")
    assert torch.autograd.gradcheck(turned, (x, y))
    assert torch.autograd.gradgradcheck(turned, (x, y))
    turned(x, y)[0].sum().backward()
    torch.testing.assert_close((x.grad, y.grad), (torch.full_like(x, 0.6), torch.full_like(y, -0.8)))


def test_a_linear_map_of_several_tensors_is_batched():
    x, y = (torch.rand(3, 2, 5) for _ in "xy")
    for dims in ((0, 0), (0, None), (None, 0), (2, 0)):
        given = [value[0] if dim is None else value.movedim(0, dim) for value, dim in zip((x, y), dims, strict=True)]
        found = torch.func.vmap(turned, dims)(*given)
        for index in range(3):
            one = [v if d is None else v.select(d, index) for v, d in zip(given, dims, strict=True)]
            torch.testing.assert_close(tuple(part[index] for part in found), Rotation().forward(*one))
