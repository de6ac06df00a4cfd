"""Which parameters of a model are trained."""

import torch


def freeze(model: torch.nn.Module) -> None:
    """Leave all parameters of a model out of the gradients.

    Parameters
    ----------
    model : torch.nn.Module
        Model to change.
    """
    _module(model).requires_grad_(False)


def unfreeze(model: torch.nn.Module) -> None:
    """Take all parameters of a model into the gradients again.

    Parameters
    ----------
    model : torch.nn.Module
        Model to change.
    """
    _module(model).requires_grad_(True)


def _module(model):
    if not isinstance(model, torch.nn.Module):
        raise TypeError(f"model must be a torch.nn.Module, got {type(model).__name__}")
    return model
