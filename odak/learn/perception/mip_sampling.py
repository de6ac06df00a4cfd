"""Trilinear sampling of a MIP chain at one level per pixel: a fixed linear map, applied to many planes at once."""

import warnings

import numpy as np
import scipy.sparse
import torch
from torch.nn import functional


class MipSampler:
    """Sampling of pictures of one size at one level of their MIP chain per pixel.

    Parameters
    ----------
    lod : torch.Tensor
        Levels ``[H, W]`` in float64, 0 or more; beyond the last level counts as the last.
    dtype : torch.dtype
        Precision of the pictures.

    Notes
    -----
    Level l + 1 holds the 2 × 2 means of level l, down to one pixel; levels are enlarged bilinearly. On a CPU a pixel's
    eight weights are a row of a sparse matrix, and so are the means of the chain: several times faster than enlarging
    whole levels, and the transposes are the gradient. Elsewhere levels are enlarged and weighted one by one.
    """

    def __init__(self, lod: torch.Tensor, dtype: torch.dtype) -> None:
        self.dtype, self.device, self.size = dtype, lod.device, tuple(lod.shape)
        self.weights = level_weights(lod)
        self.matrices, self.halvings = None, []
        if lod.device.type == "cpu" and torch.backends.mkl.is_available() and dtype in (torch.float32, torch.float64):
            self.matrices = _matrices(self.weights, dtype)
            self.halvings = _halvings(self.size, len(self.weights) - 1, dtype)
        self.weights = self.weights.to(dtype)

    def __call__(self, image: torch.Tensor) -> torch.Tensor:
        """Return the sampled pictures ``[B, C, H, W]``; differentiable."""
        if len(self.weights) == 1:
            return image * self.weights[0]
        if self.matrices is None:
            return _weighted_levels(image, self.weights)
        # Planes last: a row of a matrix then gathers whole vectors.
        level = image.flatten(0, 1).permute(1, 2, 0).flatten(0, 1)
        chain = [level]
        for pair in self.halvings:
            level = _Product.apply(level, *pair)
            chain.append(level)
        sampled = _Product.apply(torch.cat(chain), *self.matrices)
        return sampled.T.reshape(image.shape)


def level_weights(lod: torch.Tensor) -> torch.Tensor:
    """Return the share of each level in each pixel ``[levels, H, W]``, no more levels than are needed."""
    lod = lod.clamp(max=max(lod.shape).bit_length() - 1)
    levels = torch.arange(int(torch.ceil(lod.max())) + 1, dtype=lod.dtype, device=lod.device)
    return (1 - (lod - levels[:, None, None]).abs()).clamp_min(0)


def _halved(size):
    return [max(1, side // 2) for side in size]


def _weighted_levels(image, weights):
    size = image.shape[-2:]
    result = image * weights[0]
    for weight in weights[1:]:
        image = functional.adaptive_avg_pool2d(image, _halved(image.shape[-2:]))
        enlarged = functional.interpolate(image, size, mode="bilinear", align_corners=False)
        result = torch.addcmul(result, enlarged, weight)
    return result


def _matrices(weights, dtype):
    """Return the matrix ``[H·W, pixels of the chain]`` and its transpose, both in compressed rows."""
    size, offset = list(weights.shape[-2:]), 0
    here, rows, columns, values = list(size), [], [], []
    pixels = torch.arange(weights[0].numel()).reshape(size)
    for weight in weights:
        down, across = (_line(fine, coarse) for fine, coarse in zip(size, here, strict=True))
        for row, share_down in down:
            for column, share_across in across:
                value = weight * share_down[:, None] * share_across
                kept = value != 0
                rows.append(pixels[kept])
                columns.append((offset + row[:, None] * here[1] + column)[kept])
                values.append(value[kept])
        offset += here[0] * here[1]
        here = _halved(here)
    entries = (torch.cat(values).numpy(), (torch.cat(rows).numpy(), torch.cat(columns).numpy()))
    matrix = scipy.sparse.coo_matrix(entries, shape=(weights[0].numel(), offset)).tocsr()
    return _pair(matrix, dtype)


def _halvings(size, count, dtype):
    """Return the matrices, with their transposes, that make each level of the chain of the last one."""
    matrices = []
    for _ in range(count):
        down, across = (_means(fine, coarse) for fine, coarse in zip(size, _halved(size), strict=True))
        matrices.append(_pair(scipy.sparse.kron(down, across), dtype))
        size = _halved(size)
    return matrices


def _means(fine, coarse):
    """Return the matrix of the means over the windows of adaptive pooling: pairs, overlapping where a side is odd."""
    index = np.arange(coarse)
    starts, ends = index * fine // coarse, -(-(index + 1) * fine // coarse)
    pixels = np.arange(fine)
    inside = (pixels >= starts[:, None]) & (pixels < ends[:, None])
    return scipy.sparse.csr_matrix(inside / (ends - starts)[:, None])


def _pair(matrix, dtype):
    return _as_tensor(matrix.tocsr(), dtype), _as_tensor(matrix.T.tocsr(), dtype)


def _as_tensor(matrix, dtype):
    parts = [torch.from_numpy(part) for part in (matrix.indptr, matrix.indices, matrix.data)]
    with warnings.catch_warnings():
        # Torch says once that compressed rows are in beta; only their product with a matrix is used here.
        warnings.simplefilter("ignore", UserWarning)
        return torch.sparse_csr_tensor(parts[0], parts[1], parts[2].to(dtype), matrix.shape)


def _line(fine, coarse):
    """Return, for each pixel of a fine line, its two neighbours on a coarse one and their bilinear shares."""
    place = (torch.arange(fine, dtype=torch.float64) + 0.5) * (coarse / fine) - 0.5
    place = place.clamp_min(0)
    lower = place.floor().long().clamp(max=coarse - 1)
    share = (place - lower).clamp(0, 1)
    return [(lower, 1 - share), ((lower + 1).clamp(max=coarse - 1), share)]


class _Product(torch.autograd.Function):
    """Product of a sparse matrix with planes, whose gradient is that of its transpose."""

    @staticmethod
    def forward(planes, matrix, transpose):
        return matrix @ planes

    @staticmethod
    def setup_context(context, inputs, output):
        context.matrices = inputs[1:]

    @staticmethod
    def backward(context, gradient):
        matrix, transpose = context.matrices
        return _Product.apply(gradient.contiguous(), transpose, matrix), None, None
