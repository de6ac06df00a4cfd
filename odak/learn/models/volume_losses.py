"""The loss of a density of Gaussians: how far it is from the samples, and how far its parameters are from good ones."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import torch

from odak import _validate

# Not to be changed by whoever gets it as a default.
DEFAULT_WEIGHTS = MappingProxyType(
    {
        "content": MappingProxyType({"l2": 1.0, "l1": 0.0}),
        "alpha": MappingProxyType({"smaller": 0.0, "larger": 0.0, "threshold": (0.0, 1.0)}),
        "scale": MappingProxyType({"smaller": 0.0, "larger": 0.0, "threshold": (0.0, 1.0)}),
        "angle": 0.0,
        "center": 0.0,
        "utilization": MappingProxyType({"l2": 0.0, "percentile": 0}),
    }
)


def volume_loss(model, estimate, ground_truth, epoch_id: int, epoch_count: int, weights: Mapping) -> torch.Tensor:
    """Return the weighted sum of the terms whose weight is not zero.

    - content: l2·(mean squared difference) + l1·(mean absolute difference);
    - scale, alpha: smaller·Σ|p| over p < threshold[0], larger·Σp over p > threshold[1];
    - angle, center: Σ|p| over |p| > 1;
    - utilization: l2·(epoch_id/epoch_count)·(spread + gap). The spread is the sum of the standard deviations of the
      columns of the centres, of the scales, and of the alphas. The gap is the sum of the differences between the
      standard deviations, and between the means, of the `percentile` per cent of Gaussians of lowest and highest
      |alpha|, over the same seven; with fewer than two Gaussians on each side it is left out.

    Parameters
    ----------
    model : gaussian_3d_volume
        The Gaussians.
    estimate, ground_truth : torch.Tensor
        Densities ``[n]``.
    epoch_id, epoch_count : int
        Where the fit is.
    weights : dict
        As :data:`DEFAULT_WEIGHTS`, which stand for what is left out.

    Raises
    ------
    ValueError
        If a weight has an unknown name, or the percentile is not from 0 to 100.
    """
    weights = complete_weights(weights)
    content, use = weights["content"], weights["utilization"]
    terms: list[tuple[float, Callable[..., torch.Tensor]]] = [
        (content["l2"], lambda: model.l2_loss(estimate, ground_truth)),
        (content["l1"], lambda: model.l1_loss(estimate, ground_truth)),
        (weights["angle"], lambda: _outside(model.angles)),
        (weights["center"], lambda: _outside(model.centers)),
        (use["l2"], lambda: _progress(epoch_id, epoch_count) * _utilization(model, use["percentile"])),
    ]
    for name, values in (("scale", model.scales), ("alpha", model.alphas)):
        low, high = weights[name]["threshold"]
        terms.append((weights[name]["smaller"], lambda v=values, at=low: v.abs().where(v < at, 0).sum()))
        terms.append((weights[name]["larger"], lambda v=values, at=high: v.where(v > at, 0).sum()))
    # From the parameters, so that a loss of no terms has a gradient too: zero.
    loss = 0 * model.alphas.sum()
    for weight, term in terms:
        if weight != 0:
            loss = loss + weight * term()
    return loss


def complete_weights(weights: Mapping, argument: str = "weights") -> dict:
    """Return the weights with the defaults for those left out; raise TypeError or ValueError that names `argument`."""
    if not isinstance(weights, Mapping):
        raise TypeError(f"{argument} must be a dict of {', '.join(DEFAULT_WEIGHTS)}; got {type(weights).__name__}")
    _refuse_unknown(argument, weights, DEFAULT_WEIGHTS)
    whole = dict(DEFAULT_WEIGHTS)
    for name, value in weights.items():
        default = DEFAULT_WEIGHTS[name]
        if isinstance(default, Mapping):
            if not isinstance(value, Mapping):
                raise ValueError(f"{argument}[{name!r}] must be a dict of {', '.join(default)}; got {value!r}")
            _refuse_unknown(f"{argument}[{name!r}]", value, default)
            value = {**default, **value}
        whole[name] = value
    return whole


def _refuse_unknown(name, given, known):
    if unknown := sorted(set(given) - set(known)):
        raise ValueError(f"{name} must be of {', '.join(known)}; got {', '.join(map(repr, unknown))}")


def _progress(epoch_id, epoch_count) -> float:
    return epoch_id / _validate.integer("epoch_count", epoch_count, minimum=1)


def _outside(values):
    return values.abs().where(values.abs() > 1, 0).sum()


def _utilization(model, percentile):
    if not 0 <= percentile <= 100:
        raise ValueError(f"weights['utilization']['percentile'] must be from 0 to 100, got {percentile!r}")
    columns = torch.cat([model.centers, model.scales, model.alphas], dim=1)
    count = len(columns)
    total = columns.std(dim=0).sum() if count > 1 else columns.sum() * 0
    some = int(percentile / 100 * count)
    if some < 2:
        return total
    order = model.alphas.detach().abs()[:, 0].argsort()
    low, high = columns[order[:some]], columns[order[-some:]]
    return total + (low.std(0) - high.std(0)).abs().sum() + (low.mean(0) - high.mean(0)).abs().sum()
