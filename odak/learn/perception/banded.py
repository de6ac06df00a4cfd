"""Matrices whose entries lie near a diagonal, as small dense blocks, applied to rows or columns of many planes."""

from typing import NamedTuple

import scipy.sparse
import torch


class Block(NamedTuple):
    """The rows `rows` of a matrix, whose entries all lie in the columns `columns`."""

    rows: slice
    columns: slice
    entries: torch.Tensor


class Banded:
    """A matrix cut into blocks of rows, each dense where it has entries.

    A processor multiplies dense blocks many times faster than it follows the indices of a sparse matrix.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix
        The matrix.
    step : int
        Rows of a block.
    dtype : torch.dtype
        Precision of the products.
    """

    def __init__(self, matrix: scipy.sparse.csr_matrix, step: int, dtype: torch.dtype) -> None:
        self.shape, self.blocks = matrix.shape, []
        for start in range(0, matrix.shape[0], step):
            rows = slice(start, min(start + step, matrix.shape[0]))
            part = matrix[rows].tocoo()
            columns = slice(int(part.col.min()), int(part.col.max()) + 1)
            entries = torch.from_numpy(matrix[rows, columns].toarray()).to(dtype)
            self.blocks.append(Block(rows, columns, entries))

    def on_rows(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the matrix times planes ``[n, …]``, ``[m, …]``."""
        flat = planes.flatten(1)
        result = flat.new_empty(self.shape[0], flat.shape[1])
        for rows, columns, entries in self.blocks:
            torch.mm(entries, flat[columns], out=result[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_rows_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return the transpose times planes ``[m, …]``, ``[n, …]``."""
        flat = planes.flatten(1)
        result = flat.new_zeros(self.shape[1], flat.shape[1])
        for rows, columns, entries in self.blocks:
            result[columns].addmm_(entries.T, flat[rows])
        return result.unflatten(1, planes.shape[1:])

    def on_columns(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, n]`` with the matrix applied to each row, ``[…, m]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_empty(flat.shape[0], self.shape[0])
        for rows, columns, entries in self.blocks:
            torch.mm(flat[:, columns], entries.T, out=result[:, rows])
        return result.reshape(*planes.shape[:-1], -1)

    def on_columns_adjoint(self, planes: torch.Tensor) -> torch.Tensor:
        """Return planes ``[…, m]`` with the transpose applied to each row, ``[…, n]``."""
        flat = planes.flatten(0, -2)
        result = flat.new_zeros(flat.shape[0], self.shape[1])
        for rows, columns, entries in self.blocks:
            result[:, columns].addmm_(flat[:, rows], entries)
        return result.reshape(*planes.shape[:-1], -1)
