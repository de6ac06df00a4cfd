"""What the ranks of the tests of `odak.learn.wave.devices` do, each in a process of its own."""

import torch

# Second derivatives import it. Where a group of processes exists by then, default arguments of its modules keep the
# group and its threads beyond `destroy_process_group`, and the process may abort at its end.
import torch._dynamo
import torch.distributed as dist

from odak.learn.wave import Descent, Display, Modulator, Run, across_ranks, optimise, propagate_beam

LIGHT = (None, 2e-3, 8e-6, 532e-9)


def fields(count, dtype=torch.complex64, side=24):
    """Return random fields, the same in every process."""
    generator = torch.Generator().manual_seed(count)
    return torch.randn(count, side, side, dtype=dtype, generator=generator)


class Layer(torch.nn.Module):
    """A propagation with a phase mask and a distance to learn."""

    def __init__(self, side=24):
        super().__init__()
        generator = torch.Generator().manual_seed(1)
        self.phase = torch.nn.Parameter(torch.randn(side, side, generator=generator, dtype=torch.float64))
        self.distance = torch.nn.Parameter(torch.tensor(2e-3, dtype=torch.float64))
        self.register_buffer("scale", torch.tensor(2.0, dtype=torch.float64))

    def forward(self, field, gain=1.0):
        """Return the propagated field."""
        return gain * self.scale * propagate_beam(field * torch.exp(1j * self.phase), None, self.distance, *LIGHT[2:])


def in_parts(count):
    """Return a way to call a function with parts of a batch in turn: what spreading must equal to the bit."""

    def call(function, batch, *arguments):
        return torch.cat([function(part, *arguments) for part in torch.tensor_split(batch, min(count, len(batch)))])

    return call


def loss(result):
    """Return a loss that all items of a batch share, and that is not a sum over them."""
    return (result.abs() ** 2).mean(dim=0).square().sum()


def gradients(call, field, layer, gain):
    """Return the loss and all gradients."""
    value = loss(call(layer, field, gain))
    return value.detach(), torch.autograd.grad(value, (field, gain, *layer.parameters()))


def check_rank(rank, ranks, file):
    """Compare a batch spread over the ranks with the whole batch, in one of these processes."""
    torch.set_num_threads(1)
    dist.init_process_group("gloo", init_method=f"file://{file}", rank=rank, world_size=ranks)
    try:
        for count in (1, 4, 5):
            batch = fields(count)
            spread = across_ranks(propagate_beam, batch, *LIGHT)
            assert torch.equal(spread, in_parts(ranks)(propagate_beam, batch, *LIGHT))
            torch.testing.assert_close(spread, propagate_beam(batch, *LIGHT), rtol=0, atol=1e-6)
            check_gradients(across_ranks, count, ranks)
        both = across_ranks(lambda a, b: (a + b.abs(), b[:, 0]), (fields(3), fields(3) * 2))
        assert torch.equal(both[0], fields(3) + (2 * fields(3)).abs()) and torch.equal(both[1], 2 * fields(3)[:, 0])
        check_second_derivatives()
        assert not across_ranks(propagate_beam, fields(2), *LIGHT).requires_grad
    finally:
        dist.destroy_process_group()


def check_gradients(call, count, parts):
    """Check loss and gradients: to the bit against the same parts in turn, to rounding against the whole batch."""
    field = fields(count, torch.complex128).requires_grad_()
    gain, layer = torch.tensor(0.7, dtype=torch.float64, requires_grad=True), Layer()
    spread, found = gradients(call, field, layer, gain)
    turn, expected = gradients(in_parts(parts), field, layer, gain)
    assert torch.equal(spread, turn) and torch.equal(found[0], expected[0])
    whole, exact = gradients(lambda layer, *given: layer(*given), field, layer, gain)
    torch.testing.assert_close(spread, whole, rtol=1e-14, atol=0)
    sizes = [float(b.abs().max()) for b in exact]
    # The derivative by the distance is a hundred thousandth of the terms that it sums: half a unit of their rounding.
    sizes[3] = 1e-2 * distance_terms(field, layer, gain)
    for a, b, size in zip(found, exact, sizes, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=1e-14 * size)


def distance_terms(field, layer, gain, step=1e-10):
    """Return the sum of the magnitudes of the terms of the loss's derivative by the distance."""
    with torch.no_grad():
        moved = []
        for sign in (1, -1):
            layer.distance += sign * step
            moved.append(layer(field, gain))
            layer.distance -= sign * step
    result = layer(field.detach(), gain.detach()).detach().requires_grad_()
    (weight,) = torch.autograd.grad(loss(result), result)
    return float((weight.abs() * (moved[0] - moved[1]).abs()).sum()) / (2 * step)


def check_second_derivatives():
    """Check them against autograd on the whole batch."""
    x = fields(3, torch.complex128, 4).real.clone().requires_grad_()
    weight = torch.tensor(0.3, dtype=torch.float64, requires_grad=True)
    found = []
    for call in (lambda function, *given: function(*given), across_ranks):
        value = loss(call(lambda part, weight: (weight * part).sin(), x, weight))
        first = torch.autograd.grad(value, (x, weight), create_graph=True)
        found.append(torch.autograd.grad(sum(part.square().sum() for part in first), (x, weight)))
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-12, atol=1e-15)


def colour_display():
    """Return a display of two colours, two planes and two frames, both colours in both frames."""
    powers = torch.rand(2, 2, generator=torch.Generator().manual_seed(2)) + 0.1
    panel = Modulator((12, 16), 8e-6, bits=None)
    return Display(panel, [639e-9, 473e-9], [2e-3, 3e-3], 2, powers)


def pictures(count):
    """Return targets for it in double precision, the same in every process."""
    generator = torch.Generator().manual_seed(5)
    return [torch.rand(2, 2, 12, 16, dtype=torch.float64, generator=generator) for _ in range(count)]


def check_shared_holograms(rank, ranks, file):
    """Compare holograms that the ranks share with those of one process, in one of these processes."""
    torch.set_num_threads(1)
    dist.init_process_group("gloo", init_method=f"file://{file}", rank=rank, world_size=ranks)
    try:
        display, run, solver = colour_display(), Run(iterations=3, progress=False), Descent(powers=True)
        targets = pictures(3)
        alone = [optimise(display, target, solver=solver, run=run) for target in targets]
        shared = optimise(display, targets[0], solver=solver, run=run, devices="distributed")
        torch.testing.assert_close(torch.tensor(shared.losses), torch.tensor(alone[0].losses), rtol=1e-12, atol=0)
        torch.testing.assert_close(shared.images, alone[0].images, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(shared.display.powers, alone[0].display.powers, rtol=1e-9, atol=0)
        found = optimise(display, targets, solver=solver, run=run, devices="distributed")
        for one, other in zip(alone, found, strict=True):
            assert torch.equal(one.phases, other.phases) and one.losses == other.losses
            assert torch.equal(one.display.powers, other.display.powers)
        check_stops_and_failures(rank, ranks, display, targets)
    finally:
        dist.destroy_process_group()


def check_stops_and_failures(rank, ranks, display, targets):
    """Check that one rank stops or fails for all, and that ranks without a part take part all the same."""
    stopping = Run(iterations=5, progress=False, callback=lambda i, loss: rank == 1 and i == 1)
    assert len(optimise(display, targets[0], run=stopping, devices="distributed").losses) == 2
    small = Display(Modulator((12, 16), 8e-6), 532e-9, 2e-3)
    picture = targets[0][0, 0]
    one, other = (optimise(small, picture, run=stopping, devices=devices) for devices in ("distributed", ["cpu"]))
    torch.testing.assert_close(torch.tensor(one.losses), torch.tensor(other.losses)[:2], rtol=1e-12, atol=0)
    broken = [torch.full_like(picture, 200.0) if number == 0 else picture for number in range(ranks)]
    try:
        optimise(small, broken, run=Run(iterations=1, progress=False), devices="distributed")
    except (ValueError, RuntimeError) as error:
        assert "divide by 255" in str(error) and isinstance(error, RuntimeError) == (rank != 0)
        assert rank == 0 or f"rank 0 of {ranks} failed" in str(error)
    else:
        raise AssertionError("a picture of 0 … 255 was accepted")
