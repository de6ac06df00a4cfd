"""Filtering of tensors by a transfer function: two transforms and a product, with an explicit adjoint.

A = C·F⁻¹·H·F·P with P the continuation by zeros and C the cut, so A^H = C·F⁻¹·conj(H)·F·P: the adjoint is the same
operator with the conjugate kernel. Nothing but the kernel is saved for the backward pass.
"""

import collections
import itertools
import math
import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import fft

from odak import _array, _torch_private
from odak._array import convolve_plainly
from odak._threads import each

# From this many samples on, spectra are computed in blocks; the spectrum of a single field from the second number on.
# Smaller ones stay in the cache, where one call for all lines of an axis is quicker. Between the two that call is as
# quick as blocks at best, and twice as slow where columns of a power of two collide in the cache or the cores are busy.
BLOCKED_FROM, ONE_BLOCKED_FROM = 1 << 20, 1 << 18
# What a thread takes at once: it stays in the cache, and the system's allocator gives its memory out again without
# returning it first. Columns are copied in pieces of the block's width, which must not be less than some cache lines.
_BLOCK_BYTES = 3 << 19
_COLUMNS = 32
_CACHE_LINE = 64
# Fresh memory is cleared page by page by the system, which takes as long as a transform.
_KEPT_LINES = 12

_scratch = threading.local()


class Workspace:
    """Memory for results that are computed repeatedly: each replaces the earlier one of its name.

    Fresh memory is cleared page by page by the system, which takes as long as a transform.
    """

    def __init__(self):
        self._memory = {}

    def take(self, name: str, shape: Sequence[int], dtype: torch.dtype, device: torch.device) -> torch.Tensor:
        """Return a tensor of that shape with undefined content."""
        held, count = self._memory.get(name), math.prod(shape)
        if held is None or held.dtype != dtype or held.device != device or held.numel() < count:
            # The old one is released first, so that memory never holds both.
            held = self._memory[name] = None
            held = self._memory[name] = torch.empty(count, dtype=dtype, device=device)
        return held[:count].view(shape)


def allocate_like(workspace: Workspace | None, name: str, shape: Sequence[int], like: torch.Tensor) -> torch.Tensor:
    """Return memory of the dtype and on the device of `like`: from a workspace, or fresh without one."""
    if workspace is None:
        return like.new_empty(shape)
    return workspace.take(name, shape, like.dtype, like.device)


def convolve(field: torch.Tensor, kernel: torch.Tensor, workspace: Workspace | None = None) -> torch.Tensor:
    """Return the field filtered by `kernel` on its own window; see :func:`odak.wave.transfer_functions.convolve`.

    Differentiable any number of times in `field` and, when it requires grad, in `kernel`. One field through several
    kernels (planes, colours) is transformed once, and so is the sum of what comes back to it. The result may be written
    to a workspace.
    """
    # What is kept between calls has no place in a graph of torch.compile.
    if torch.compiler.is_compiling():
        return convolve_plainly(field, kernel)
    return _array.outside_graphs(_convolve, field, kernel, workspace)


def _convolve(field, kernel, workspace):
    if kernel.requires_grad or _torch_private.is_wrapped(kernel):
        return convolve_plainly(field, kernel)
    batch = field.shape[:-2]
    whole = batch if kernel.ndim == 2 else np.broadcast_shapes(batch, kernel.shape[:-2])
    if (field.requires_grad and torch.is_grad_enabled()) or _torch_private.is_transformed(field):
        return _torch_private.linear(_Convolution(kernel, batch, whole, workspace), False, field)
    return _filtered(field, kernel, False, whole, workspace)


def _filtered(field, kernel, adjoint, batch, workspace):
    count, size = math.prod(batch), math.prod(kernel.shape[-2:])
    one = kernel.ndim == 2 or kernel.numel() == size
    if not field.is_cpu:
        return _convolve_whole(field, kernel, adjoint, batch)
    if size >= (ONE_BLOCKED_FROM if one and count == 1 else BLOCKED_FROM):
        return _convolve_in_blocks(field, kernel, adjoint, batch, workspace)
    if not one or count == 1 or count * size * field.element_size() <= 2 * _BLOCK_BYTES:
        return _convolve_whole(field, kernel, adjoint, batch)
    return _convolve_by_fields(field, kernel.reshape(kernel.shape[-2:]), adjoint, batch)


@dataclass
class _Convolution:
    """The linear map of fields with the leading axes `batch` to filtered ones with those of `whole`."""

    # Kernels are shared between calls and never written to, so keeping a reference is safe.
    kernel: torch.Tensor
    batch: tuple[int, ...]
    whole: tuple[int, ...]
    workspace: Workspace | None = None

    def forward(self, field):
        # What is computed again for derivatives must not replace the result.
        workspace, self.workspace = self.workspace, None
        return _filtered(field, self.kernel, False, self.whole, workspace)

    def adjoint(self, field):
        return _filtered(field, self.kernel, True, self.batch, None)

    def over(self, count: int, adjoint: bool, field):
        """Return the map, or its adjoint, of fields with an axis of `count` in front of their own."""
        own = self.batch, self.whole
        rank = max(self.kernel.ndim - 2, *map(len, own))
        batch, whole = ((count, *(1,) * (rank - len(axes)), *axes) for axes in own)
        field = field.reshape(*(whole if adjoint else batch), *field.shape[-2:])
        result = _torch_private.linear(_Convolution(self.kernel, batch, whole), adjoint, field)
        return result.reshape(count, *own[not adjoint], *result.shape[-2:])


def _convolve_whole(field, kernel, adjoint, batch):
    """Return the filtered field, each transform on the whole array.

    The adjoint is the conjugate of what the operator gives for the conjugate field with both transforms exchanged. The
    copies that continue and cut the field conjugate it on its way.
    """
    (rows, columns), (height, width) = field.shape[-2:], kernel.shape[-2:]
    dtype, on_cpu, field = field.dtype, field.is_cpu, field.conj() if adjoint else field
    forth, back = (fft.ifft, fft.fft) if adjoint else (fft.fft, fft.ifft)
    if on_cpu:
        # Only rows that are not zero are transformed going in, and only those kept coming out.
        spectrum = forth(forth(field, n=width), n=height, dim=-2)
    else:
        spectrum = (fft.ifft2 if adjoint else fft.fft2)(field, s=(height, width))
    spectrum = spectrum.mul_(kernel) if kernel.dtype == dtype and _fits(kernel, spectrum) else spectrum * kernel
    if spectrum.shape[:-2] != batch:
        spectrum = spectrum.sum_to_size(*batch, height, width)
    if on_cpu:
        window = back(back(spectrum, dim=-2)[..., :rows, :])[..., :columns]
    else:
        window = (fft.fft2 if adjoint else fft.ifft2)(spectrum)[..., :rows, :columns]
    # A copy: a view would keep the padded field.
    window = (window.conj_physical() if adjoint else window).contiguous()
    return window if window.dtype == dtype else window.to(dtype)


def _fits(kernel, spectrum) -> bool:
    """Return whether a kernel broadcasts to a spectrum by its leading axes; np.broadcast_shapes takes longer."""
    if kernel.ndim == 2:
        return True
    ours, theirs = spectrum.shape[-3::-1], kernel.shape[-3::-1]
    return len(theirs) <= len(ours) and all(n in (1, m) for n, m in zip(theirs, ours, strict=False))


def _convolve_by_fields(field, kernel, adjoint, batch):
    """Return many small fields filtered by one kernel, as many at once as have spectra that fit a core's cache."""
    result = field.new_empty(*batch, *field.shape[-2:])
    fields, results = field.reshape(-1, *field.shape[-2:]), result.view(-1, *field.shape[-2:])

    def filter_part(part):
        results[part] = _convolve_whole(fields[part], kernel, adjoint, fields[part].shape[:-2])

    _run_passes(_Pass(filter_part, len(fields), kernel.numel(), field))
    return result


def _convolve_in_blocks(field, kernel, adjoint, batch, workspace):
    """Return the filtered field, every transform on a part that fits a core's cache.

    A padded spectrum of 2160 × 3840 would be written and read four times and its fresh pages cleared by the kernel
    each time, which costs more than the arithmetic. It exists only, in memory kept for it, where one field goes
    through several kernels or several come back to one.
    """
    shape = (*batch, *field.shape[-2:])
    result = allocate_like(workspace, "field", shape, field)
    full = np.broadcast_shapes(field.shape[:-2], kernel.shape[:-2])
    whole = [array.expand(*full, *array.shape[-2:]) for array in (field, kernel, result)]
    triples = [tuple(array[place] for array in whole) for place in itertools.product(*map(range, full))]
    summed = result.numel() < math.prod(full) * math.prod(field.shape[-2:])
    for group in _grouped(triples, 2 if summed else 0):
        _filter_group(group, summed or len(group) == 1, adjoint)
    return result


def _grouped(triples, which: int):
    """Return lists of the triples that share their field (0) or their result (2)."""
    groups: dict[int, list[Any]] = {}
    for triple in triples:
        groups.setdefault(triple[which].data_ptr(), []).append(triple)
    return groups.values()


def _filter_group(group, summed: bool, adjoint) -> None:
    """Write the sum of filtered fields into their one result, or one field filtered by several kernels into as many.

    Of one field the spectrum is computed once, and of one result spectra are summed; part by part, so that a part is in
    the cache when the kernels come by. A transform's result is fresh memory even when `out` is given, so the parts are
    small and copied where they go.
    """
    fields, kernels, results = zip(*group, strict=True)
    height, width = kernels[0].shape
    shared, others = (results[0], fields) if summed else (fields[0], results)
    near = _lines(shared, width)
    far = [near] if len(group) == 1 else [_lines(other, width, index + 1) for index, other in enumerate(others)]

    def filter_columns(part):
        factors, total = [kernel[:, part].mT for kernel in kernels], None
        if summed:
            for factor, lines in zip(factors, far, strict=True):
                column = _columns_to_spectra(lines, part, height, adjoint)
                total = column.mul_(factor) if total is None else total.addcmul_(column, factor)
            _spectra_to_columns(total, near, part, adjoint)
            return
        column = _columns_to_spectra(near, part, height, adjoint)
        for factor, lines in zip(factors, far, strict=True):
            product = torch.mul(column, factor, out=_buffer("block", column.shape, column.dtype))
            _spectra_to_columns(product, lines, part, adjoint)

    sources, targets = (far, [near]) if summed else ([near], far)
    forth = itertools.starmap(_rows_to_spectra, zip(fields, sources, strict=False))
    back = itertools.starmap(_spectra_to_rows, zip(targets, results, strict=False))
    _run_passes(*forth, _Pass(filter_columns, width, height, shared, _COLUMNS), *back)


def _columns_to_spectra(lines, part: slice, height: int, adjoint) -> torch.Tensor:
    """Return the transforms of some columns, continued by zeros to `height`, as rows; for the adjoint, conjugate.

    The conjugate spectrum times the kernel is the conjugate of what the conjugate kernel gives, and takes one pass
    less: conj(F u) = N·F⁻¹ conj(u), and the copy of u may conjugate it on its way.
    """
    if adjoint:
        return fft.ifft(_padded(lines[:, part].conj().mT, height))
    return fft.fft(_padded(lines[:, part].mT, height))


def _spectra_to_columns(spectra, lines, part: slice, adjoint) -> None:
    """Write the columns that have these transforms, rows of a part, to their place in `lines`."""
    columns = (fft.fft(spectra).conj() if adjoint else fft.ifft(spectra))[:, : len(lines)]
    target = lines[:, part]
    # Rows of a power of two fall on the same lines of the cache, which holds a few of them only.
    for start in range(0, len(columns), _COLUMNS):
        target[:, start : start + _COLUMNS] = columns[start : start + _COLUMNS].mT


def _rows_to_spectra(field, lines: torch.Tensor) -> "_Pass":
    """Return the pass that writes the transforms of a field's rows, continued by zeros, into `lines`."""
    width = lines.shape[-1]

    def transform(part):
        rows = field[part]
        lines[part] = fft.fft(rows if rows.shape[-1] == width else _padded(rows, width))

    return _Pass(transform, len(field), width, field)


def _lines(field, width: int, index: int = 0) -> torch.Tensor:
    """Return memory for the transforms of a field's rows: that which this thread keeps, or fresh beyond a few.

    Rows start an odd number of cache lines apart, so that a column spreads over the whole cache: three times as quick.
    """
    per_line = max(1, _CACHE_LINE // field.element_size())
    shape = (len(field), (-(-width // per_line) | 1) * per_line)
    kept = index <= _KEPT_LINES
    return (_buffer(f"lines {index}", shape, field.dtype) if kept else field.new_empty(shape))[:, :width]


def _spectra_to_rows(lines, result) -> "_Pass":
    """Return the pass that writes the rows that have these transforms into `result`."""

    def transform(part):
        result[part] = fft.ifft(lines[part])[:, : result.shape[-1]]

    return _Pass(transform, len(lines), lines.shape[-1], lines)


class _Pass:
    """Calls of `work` with slices of `count` lines of `length` numbers, about `_BLOCK_BYTES` each.

    As many parts for each thread, which take one after another.
    """

    def __init__(self, work: Callable[..., Any], count: int, length: int, field, at_least: int = 1) -> None:
        threads, most = torch.get_num_threads(), max(at_least, _BLOCK_BYTES // (length * field.element_size()))
        step = math.ceil(count / (math.ceil(count / (most * threads)) * threads))
        self._work = work
        self._parts = collections.deque(slice(start, min(start + step, count)) for start in range(0, count, step))
        self.size = self._missing = len(self._parts)
        self._changed = threading.Condition()

    def run(self) -> None:
        """Do parts until none is left, and return when the other threads have finished their parts as well.

        Nobody waits for a thread that has not begun, which may be at work for another call.
        """
        while self._parts:
            try:
                part = self._parts.popleft()
            except IndexError:
                # Another thread has taken the last one.
                break
            try:
                self._work(part)
            except BaseException:
                self._leave(self._missing)
                raise
            self._leave(1)
        with self._changed:
            self._changed.wait_for(lambda: self._missing <= 0)

    def _leave(self, count: int) -> None:
        with self._changed:
            self._missing -= count
            if self._missing <= 0:
                self._changed.notify_all()


def _run_passes(*passes: _Pass) -> None:
    """Do passes one after another on several threads.

    A transform that torch shares out waits for all threads, beside other processes for milliseconds each time. Here
    each thread transforms parts of its own, and they meet once between two passes.
    """

    def run():
        for one in passes:
            one.run()

    for _ in each(run, [()] * min(torch.get_num_threads(), max(one.size for one in passes))):
        pass


def _padded(rows, length: int) -> torch.Tensor:
    """Return rows, continued by zeros to `length`, in memory of this thread."""
    count, own = rows.shape
    block = _buffer("block", (count, length), rows.dtype)
    block[:, :own] = rows
    block[:, own:] = 0
    return block


def _buffer(name: str, shape, dtype) -> torch.Tensor:
    """Return scratch memory of this thread, kept between calls because fresh pages are slow."""
    held = getattr(_scratch, name, None)
    count = math.prod(shape)
    if held is None or held.dtype != dtype or held.numel() < count:
        with torch.inference_mode(False):
            held = torch.empty(count, dtype=dtype)
        setattr(_scratch, name, held)
    return held[:count].view(shape)


def release_memory() -> None:
    """Give back the memory that this thread keeps between transforms."""
    _scratch.__dict__.clear()


class SparseMap:
    """The linear map of a real sparse matrix for complex tensors ``[batch, columns of the matrix]``.

    Parameters
    ----------
    matrix : scipy.sparse.csr_matrix
        Its numbers are those of the real and the imaginary part of the tensors.
    """

    def __init__(self, matrix: Any) -> None:
        self.matrix: Any = matrix
        self._held: dict[bool, torch.Tensor] = {}

    def __call__(self, fields: torch.Tensor) -> torch.Tensor:
        """Return ``[batch, rows of the matrix]``."""
        return _torch_private.linear(self, False, fields)

    def forward(self, fields: torch.Tensor) -> torch.Tensor:
        """Return what the matrix makes of fields."""
        return self._product(fields, False)

    def adjoint(self, fields: torch.Tensor) -> torch.Tensor:
        """Return what the transposed matrix makes of fields."""
        return self._product(fields, True)

    def _product(self, fields, transposed):
        columns = torch.view_as_real(fields.resolve_conj()).permute(1, 0, 2).reshape(fields.shape[-1], -1)
        result = self._table(transposed) @ columns
        return torch.view_as_complex(result.reshape(-1, len(fields), 2).transpose(0, 1).contiguous())

    def _table(self, transposed):
        if transposed not in self._held:
            one = self.matrix.T.tocsr() if transposed else self.matrix
            parts = (torch.from_numpy(part) for part in (one.indptr, one.indices, one.data))
            with warnings.catch_warnings(), torch.inference_mode(False):
                # That sparse tensors are in beta, and that their indices are not checked.
                warnings.filterwarnings("ignore", "Sparse (CSR tensor support|invariant checks)")
                self._held[transposed] = torch.sparse_csr_tensor(*parts, one.shape, check_invariants=False)
        return self._held[transposed]
