"""Perceptrons against their formula, the statistics of their initialization, and the fit of a picture."""

import math

import pytest
import torch

from odak.learn import models


@pytest.fixture(autouse=True)
def _seed():
    torch.manual_seed(0)


@pytest.fixture(autouse=True)
def _one_thread():
    """Leave these small products to one thread: several of them mostly wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def by_formula(network, x, activations):
    """Return the output, one matrix product and activation after another."""
    linear = [layer for layer in network.model if isinstance(layer, torch.nn.Linear)]
    for position, layer in enumerate(linear):
        x = x @ layer.weight.T + (0 if layer.bias is None else layer.bias)
        if position < len(linear) - 1:
            x = activations(position, x)
    return x


@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize(
    ("model_type", "activation"),
    [
        ("conventional", lambda n, x, alpha: x.tanh()),
        ("swish", lambda n, x, alpha: x / (1 + torch.exp(-x))),
        ("SIREN", lambda n, x, alpha: torch.sin(7.0 * x)),
        ("FILM SIREN", lambda n, x, alpha: torch.sin(alpha[0] * x + alpha[1])),
        ("Gaussian", lambda n, x, alpha: torch.exp(-((alpha[0] * x) ** 2))),
    ],
)
def test_the_output(model_type, activation, bias):
    network = models.multi_layer_perceptron(
        [2, 6, 5, 3], torch.nn.Tanh(), bias, model_type, siren_multiplier=7.0, input_multiplier=1.5
    ).double()
    for parameter in network.parameters():
        parameter.data.uniform_(-1, 1)
    x = torch.randn(4, 2, dtype=torch.float64)
    alphas = [getattr(layer, "alpha", None) for layer in network.model[1::2]]
    wanted = by_formula(network, network.input_multiplier * x, lambda n, y: activation(n, y, alphas[n]))
    assert torch.allclose(network(x), wanted)
    assert torch.autograd.gradcheck(network, (x.requires_grad_(),), fast_mode=True)
    assert network(x[:, None]).shape == (4, 1, 3)


def test_attributes():
    network = models.multi_layer_perceptron((2, 8, 3), bias=True, model_type="siren", uniform_flag=False)
    assert network.dimensions == [2, 8, 3] and network.model_type == "SIREN" and network.siren_multiplier == 30.0
    assert network.bias is True and network.uniform_flag is False and network.input_multiplier is None


def test_the_input_multiplier_starts_at_its_value_and_is_learned():
    network = models.multi_layer_perceptron([3, 4, 1], input_multiplier=2.5)
    assert torch.equal(network.input_multiplier, torch.full((1, 3), 2.5)) and network.input_multiplier.requires_grad
    assert next(iter(network.state_dict())) == "input_multiplier"


def test_no_activation_leaves_its_place_out():
    network = models.multi_layer_perceptron([2, 4, 4, 1], activation=None)
    assert [type(layer) for layer in network.model] == [torch.nn.Linear] * 3
    assert list(network.state_dict()) == ["model.0.weight", "model.1.weight", "model.2.weight"]


def test_two_dimensions_are_one_linear_layer():
    network = models.multi_layer_perceptron([5, 2], model_type="SIREN")
    assert len(network.model) == 1 and network.model[0].weight.shape == (2, 5)


@pytest.mark.parametrize("dimensions", [[2, 1], [2, 4, 1]])
def test_an_unknown_type_is_named_with_the_nearest_one(dimensions):
    with pytest.raises(ValueError, match=r"model_type must be one of .*Did you mean 'Gaussian'\?"):
        models.multi_layer_perceptron(dimensions, model_type="gaussan")


@pytest.mark.parametrize(("model_type", "frequency"), [("SIREN", 12.0), ("FILM SIREN", 1.0)])
def test_weights_of_sines_are_spread_as_published(model_type, frequency):
    network = models.multi_layer_perceptron([7, 300, 200, 100], bias=True, model_type=model_type, siren_multiplier=12.0)
    linear = [layer for layer in network.model if isinstance(layer, torch.nn.Linear)]
    limits = [1 / 7, math.sqrt(6 / 300) / frequency, math.sqrt(6 / 200) / frequency]
    for layer, limit in zip(linear, limits, strict=True):
        weight = layer.weight.detach()
        assert weight.abs().max() <= limit and weight.abs().max() > 0.995 * limit
        assert weight.std() == pytest.approx(limit / math.sqrt(3), rel=0.06)
        bound = 1 / math.sqrt(layer.in_features)
        least, most = layer.bias.detach().aminmax()
        assert 0.9 * bound < -least <= bound and 0.9 * bound < most <= bound


def test_without_the_flag_weights_start_as_torch_has_them():
    torch.manual_seed(3)
    network = models.multi_layer_perceptron([2, 8, 1], model_type="SIREN", uniform_flag=False)
    torch.manual_seed(3)
    assert torch.equal(network.model[0].weight, torch.nn.Linear(2, 8, bias=False).weight)


def distance_to_arcsine(values):
    """Return the largest difference between the distribution of values and that of a sine of a uniform phase."""
    ordered = values.flatten().sort().values
    wanted = 0.5 + torch.asin(ordered.clamp(-1, 1)) / math.pi
    steps = torch.arange(1, len(ordered) + 1, dtype=ordered.dtype) / len(ordered)
    return float((steps - wanted).abs().max())


def test_activations_of_sines_are_spread_alike_in_all_layers():
    network = models.multi_layer_perceptron([2, 1024, 1024, 1024, 1024, 1], model_type="SIREN").double()
    x = torch.rand(256, 2, dtype=torch.float64) * 2 - 1
    phases, values = [], []
    with torch.no_grad():
        for layer in network.model[:-1]:
            x = layer(x)
            (phases if isinstance(layer, torch.nn.Linear) else values).append(x)
    # In the first layer phases reach several turns: ω·(w₁x₁ + w₂x₂), w and x uniform, has the variance 2·(ω/2)²/9.
    first = 30 * phases[0]
    assert first.std() == pytest.approx(15 * math.sqrt(2) / 3, rel=0.05)
    assert distance_to_arcsine(values[0]) < 0.03
    # Then ω·w·x is a sum of many terms: normal, with twice the mean square of the layer before as its variance, and
    # the sine of a normal phase of variance v has the mean square (1 − exp(−2v)) / 2.
    variance = 1.0
    for phase, value in zip(phases[1:], values[1:], strict=True):
        phase = 30 * phase
        assert phase.var() == pytest.approx(variance, rel=0.08)
        assert (phase.pow(4).mean() / phase.var() ** 2) == pytest.approx(3, rel=0.1)
        assert value.square().mean() == pytest.approx((1 - math.exp(-2 * variance)) / 2, rel=0.06)
        # No longer quite that of a uniform phase, but far from the flat one, which is 0.09 away.
        assert distance_to_arcsine(value) < 0.08
        variance = 1 - math.exp(-2 * variance)


def test_activations_of_modulated_sines_stay_between_the_layers():
    network = models.multi_layer_perceptron([2, 512, 512, 512, 512, 1], model_type="FILM SIREN").double()
    x = torch.rand(256, 2, dtype=torch.float64) * 2 - 1
    values = []
    with torch.no_grad():
        for layer in network.model[:-1]:
            x = layer(x)
            if not isinstance(layer, torch.nn.Linear):
                values.append(float(x.square().mean()))
    assert all(0.2 < value < 0.6 for value in values)


def picture_with_edges(size):
    """Return coordinates and a picture of rings, a disc and a ramp."""
    y, x = torch.meshgrid(*[torch.linspace(-1, 1, size)] * 2, indexing="ij")
    rings = 0.5 + 0.5 * torch.cos(12 * (x**2 + y**2))
    disc = ((x - 0.3) ** 2 + (y + 0.2) ** 2 < 0.2).float()
    return torch.stack([x, y], -1).reshape(-1, 2), (0.5 * rings + 0.3 * disc + 0.1 * (x + 1)).reshape(-1, 1)


def fitted(network, steps):
    """Return the peak signal-to-noise ratio in decibels of a network that learned a picture."""
    coordinates, picture = picture_with_edges(48)
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    for _ in range(steps):
        optimizer.zero_grad()
        loss = torch.nn.functional.mse_loss(network(coordinates), picture)
        loss.backward()
        optimizer.step()
    return -10 * math.log10(loss.item())


def test_a_network_of_sines_learns_a_picture_to_more_than_35_db():
    network = models.multi_layer_perceptron([2, 64, 64, 64, 1], bias=True, model_type="SIREN")
    assert fitted(network, 80) > 35
    rectified = models.multi_layer_perceptron([2, 64, 64, 64, 1], bias=True)
    assert fitted(rectified, 80) < 25


def test_other_types_learn():
    coordinates, picture = picture_with_edges(8)
    for model_type in ("swish", "FILM SIREN", "Gaussian"):
        network = models.multi_layer_perceptron([2, 16, 1], bias=True, model_type=model_type, input_multiplier=2.0)
        optimizer = torch.optim.AdamW(network.parameters(), lr=1e-2)
        losses = []
        for _ in range(60):
            optimizer.zero_grad()
            loss = torch.nn.functional.mse_loss(network(coordinates), picture)
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
        assert losses[-1] < 0.6 * losses[0]


def test_features_of_positions_as_input():
    encoder = models.positional_encoder(L=50)
    network = models.multi_layer_perceptron([2 + 2 * 2 * 50, 64, 64, 64, 3], bias=True)
    assert network(encoder(torch.rand(5, 2))).shape == (5, 3)


def test_a_dense_level_is_bilinear_interpolation():
    encoder = models.hash_grid_encoder(2, levels=2, features=3, table_size=1 << 12, coarsest=4, finest=16).double()
    with torch.no_grad():
        encoder.table.normal_(generator=torch.Generator().manual_seed(0))
    points = 2 * torch.rand(50, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) - 1
    points[:3] = torch.tensor([[1.0, 1.0], [-1.0, 1.0], [0.5, -0.5]])
    expected, start = [], 0
    for cells in (4, 16):
        # The first coordinate runs fastest.
        grid = encoder.table[start : start + (cells + 1) ** 2].detach().T.reshape(1, 3, cells + 1, cells + 1)
        start += (cells + 1) ** 2
        sampled = torch.nn.functional.grid_sample(grid, points[None, None], align_corners=True)
        expected.append(sampled[0, :, 0].T)
    torch.testing.assert_close(encoder(points).detach(), torch.cat(expected, -1))
    assert encoder.output_features == 6 and len(encoder.table) == start
    outside = torch.tensor([[3.0, -7.0]], dtype=torch.float64)
    torch.testing.assert_close(encoder(outside), encoder(outside.clamp(-1, 1)))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_levels_too_fine_for_the_table_share_hashed_entries(dimensions):
    size, cells = 19, 32
    encoder = models.hash_grid_encoder(dimensions, 1, 2, size, cells, cells, low=0.0, high=1.0).double()
    with torch.no_grad():
        encoder.table.copy_(torch.arange(2.0 * size).reshape(size, 2))
    primes = (1, 2654435761, 805459861)
    for corner in ([3, 30, 7], [32, 31, 0], [17, 0, 32]):
        corner = corner[:dimensions]
        number = 0
        for place, prime in zip(corner, primes, strict=False):
            number ^= place * prime
        entry = number % size
        seen = encoder(torch.tensor(corner, dtype=torch.float64) / cells).detach()
        torch.testing.assert_close(seen, encoder.table[entry].detach())


def test_levels_of_a_hash_grid_grow_by_one_factor():
    """From the coarsest to the finest (Müller et al. 2022, equations 2 and 3); the table holds what fits of each."""
    grid = models.hash_grid_encoder(dimensions=2, levels=4, features=3, table_size=1000, coarsest=4, finest=108)
    assert grid.resolutions.tolist() == [4, 12, 36, 108]
    assert grid.sizes.tolist() == [25, 169, 1000, 1000] and grid.starts.tolist() == [0, 25, 194, 1194]
    assert grid.table.shape == (2194, 3) and grid.output_features == 12
    least, most = grid.table.detach().aminmax()
    assert 0.9e-4 < most <= 1e-4 and 0.9e-4 < -least <= 1e-4
    usual = models.hash_grid_encoder()
    assert len(usual.resolutions) == 16 and usual.resolutions[[0, -1]].tolist() == [16, 512]
    assert usual.table.shape[1] == 2 and int(usual.sizes.max()) == 2**14
    assert models.hash_grid_encoder(levels=1, coarsest=5, finest=80).resolutions.tolist() == [5]


def test_the_sizes_that_are_refused():
    for sizes in ([2, 0, 3], [2, 3.0], [2, True]):
        with pytest.raises(ValueError, match="dimensions"):
            models.multi_layer_perceptron(sizes)
    assert models.positional_encoder(1000)(torch.zeros(1, 1)).shape == (1, 2001)
    with pytest.raises(ValueError, match="L must be"):
        models.positional_encoder(1001)


def test_gradients_and_refusals_of_the_hash_grid():
    encoder = models.hash_grid_encoder(2, 3, 2, 23, 3, 9).double()
    points = 1.8 * torch.rand(6, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2)) - 0.9
    points.requires_grad_()
    assert torch.autograd.gradcheck(encoder, (points,), fast_mode=True)
    table = encoder.table.detach().clone().requires_grad_()
    assert torch.autograd.gradcheck(
        lambda table: torch.func.functional_call(encoder, {"table": table}, (points.detach(),)),
        (table,),
        fast_mode=True,
    )
    assert list(encoder.state_dict()) == ["table"]
    for wrong, message in (
        ({"dimensions": 8}, "dimensions must be at most 7"),
        ({"coarsest": 64, "finest": 32}, "finest must be at least 64"),
        ({"low": 1.0, "high": 1.0}, "low and high must be two rising numbers"),
        ({"levels": 0}, "levels must be at least 1"),
    ):
        with pytest.raises(ValueError, match=message):
            models.hash_grid_encoder(**wrong)
    with pytest.raises(ValueError, match=r"x must be \[\.\.\., 2\]"):
        encoder(torch.zeros(4, 3, dtype=torch.float64))


@pytest.mark.slow
def test_a_hash_grid_learns_fine_detail_sooner_than_coordinates():
    y, x = torch.meshgrid(torch.linspace(-1, 1, 40), torch.linspace(-1, 1, 40), indexing="ij")
    image = (torch.sin(25 * x) * torch.sin(31 * y)).reshape(-1, 1)
    points = torch.stack([x, y], -1).reshape(-1, 2)
    torch.manual_seed(0)
    encoder = models.hash_grid_encoder(2, 4, 2, 2048, 8, 40)
    errors = []
    for network in (
        torch.nn.Sequential(encoder, models.multi_layer_perceptron([8, 16, 1], bias=True)),
        models.multi_layer_perceptron([2, 64, 64, 1], bias=True),
    ):
        loss = [(points, image)]
        history = models.train(
            network,
            lambda m, b: torch.nn.functional.mse_loss(m(b[0]), b[1]),
            loss,
            150,
            learning_rate=1e-2,
            progress=False,
        )
        errors.append(history.training[-1])
    assert errors[0] < 0.02 < 0.2 < errors[1]
