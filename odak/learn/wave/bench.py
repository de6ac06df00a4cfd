"""Sequence of optical elements as a module of PyTorch, whose tensors are its parameters and buffers."""

import copy
import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from odak import _validate
from odak.wave import bench


@dataclass(frozen=True)
class _Key:
    """Name under which a module holds a tensor or a module of an element."""

    name: str


class optical_bench(bench.optical_bench, torch.nn.Module):
    """Sequence of optical elements as one module, differentiable in each of its numbers.

    Parameters of PyTorch among the numbers of the elements are parameters of the module, other tensors are its buffers,
    and modules among them its modules: they go to a device, into optimizers and into a ``state_dict`` with it. Numbers
    stay numbers.

    Parameters
    ----------
    elements : sequence
        In the order in which light meets them, as of :class:`odak.wave.optical_bench`. The bench takes copies, which
        share the parameters and the modules of what is given.
    wavelength : float or torch.Tensor
        Wavelength in metres; a tensor broadcasts against the leading axes of the field.

    Raises
    ------
    ValueError, TypeError
        If an element cannot be one, or the wavelength is not positive.

    Examples
    --------
    Behind a lens of 10 cm it is brighter beyond 5 cm than there:

    >>> import torch
    >>> from odak.learn.wave import CircularAperture, FreeSpace, ThinLens, optical_bench
    >>> distance = torch.nn.Parameter(torch.tensor(0.05, dtype=torch.float64))
    >>> bench = optical_bench([CircularAperture(4e-4), ThinLens(0.1), FreeSpace(distance, window_dx=2e-6)], 532e-9)
    >>> [name for name, _ in bench.named_parameters()]
    ['element_2_distance']
    >>> focus, pitch = bench(torch.ones(128, 128, dtype=torch.complex128), 8e-6)
    >>> focus.abs().square().max().backward()
    >>> bool(distance.grad > 0)
    True
    """

    @_validate.takes_units("wavelength")
    def __init__(self, elements: Iterable[Any], wavelength: float | torch.Tensor):
        torch.nn.Module.__init__(self)
        super().__init__(elements, wavelength)
        given = self.__dict__.pop("wavelength", None)
        if isinstance(given, torch.Tensor):
            self.register_buffer("wavelength", given)
        elif given is not None:
            self.wavelength = given

    @property
    def elements(self) -> list[Any]:
        """Elements in the order in which light meets them, with the tensors that the module holds now."""
        return [self._changed(element, lambda _, value: self._shown(value)) for element in self._given]

    @elements.setter
    def elements(self, elements: Iterable[Any]) -> None:
        self._given: list[Any] = []
        for index, element in enumerate(elements):
            if isinstance(element, torch.nn.Module):
                self.add_module(f"element_{index}", element)
            self._given.append(self._changed(element, functools.partial(self._held, f"element_{index}")))

    def forward(self, field: torch.Tensor, dx: float | Sequence[float]) -> tuple[Any, ...]:
        """Return the field behind the last element, and its pixel pitch.

        Parameters
        ----------
        field : torch.Tensor
            Complex field ``[..., rows, columns]`` in front of the first element.
        dx : float or sequence of float
            Its pixel pitch in metres, one number or a pair (rows, columns).

        Returns
        -------
        tuple
            As of :meth:`propagate`.
        """
        return self.propagate(field, dx)

    @staticmethod
    def _changed(element: Any, change: Callable[[str, Any], Any]) -> Any:
        """Return a copy of an element, which may be frozen, with its attributes changed; a module as it is."""
        if isinstance(element, torch.nn.Module) or not hasattr(element, "__dict__"):
            return element
        element = copy.copy(element)
        for name, value in vars(element).items():
            object.__setattr__(element, name, change(name, value))
        return element

    def _held(self, owner: str, name: str | int, value: Any) -> Any:
        """Return a number as it is, and a key for each tensor and module, which this module holds from now on."""
        key = f"{owner}_{name}"
        if type(value) in (list, tuple):
            return type(value)(self._held(key, place, one) for place, one in enumerate(value))
        if isinstance(value, (torch.nn.Parameter, torch.nn.Module)):
            setattr(self, key, value)
        elif isinstance(value, torch.Tensor):
            self.register_buffer(key, value)
        else:
            return value
        return _Key(key)

    def _shown(self, value: Any) -> Any:
        """Return what :meth:`_held` was given, as the module holds it now."""
        if type(value) in (list, tuple):
            return type(value)(map(self._shown, value))
        return getattr(self, value.name) if isinstance(value, _Key) else value
