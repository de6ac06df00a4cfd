"""ColorVideoVDP, FovVideoVDP and LPIPS through the packages of their authors, imported when first constructed."""

import contextlib
import importlib
import warnings

import torch
from torch import nn

from odak import _validate, _warnings
from odak.learn._tensors import checked_device, checked_pair


class _Wrapper(nn.Module):
    """A metric of another package; `available` says whether that is installed."""

    _module = _package = ""

    def __init__(self, required: bool):
        super().__init__()
        required = _validate.flag("required", required)
        try:
            self._import()
            self.available = True
        except ImportError as error:
            message = f"{type(self).__name__} needs the package {self._package} ({error}): pip install {self._package}"
            if required:
                raise ImportError(message) from error
            _warnings.warn(f"{message}. Until then its value is not a number.", _warnings.MissingPackageWarning)
            self.available = False

    def _import(self):
        with _quietly():
            return importlib.import_module(self._module)


class _DifferencePredictor(_Wrapper):
    """Quality on a "standard_4k" display, one picture or video after the other so that they cannot influence others."""

    def forward(
        self,
        predictions: torch.Tensor,
        targets: torch.Tensor,
        dim_order: str = "BCHW",
        frames_per_second: float | None = None,
    ) -> torch.Tensor:
        """Return the mean quality of pictures or videos.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Display-encoded pictures ``[B, C, H, W]`` or ``[C, H, W]``, or videos of F frames ``[B, C, F, H, W]``, of
            one or three channels, 0 … 1.
        dim_order : str
            Order of the axes of pictures that have four, and of videos; of the latter "BCFHW" by default.
        frames_per_second : float, optional
            Rate of the frames of videos, which determines how visible flicker and motion are; required for videos.

        Returns
        -------
        torch.Tensor
            Just-objectionable differences (JOD) without axes, float32: 10 for equal pictures, less for worse ones.
            Differentiable. Not a number when the package is missing.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, there are not three to five axes and one or three channels, or the rate is missing
            for a video, not positive, or given for pictures.
        """
        predictions, targets = checked_pair(predictions, targets)
        if not isinstance(dim_order, str):
            raise TypeError(f"dim_order must be a string, got {type(dim_order).__name__}")
        if predictions.ndim == 5:
            if frames_per_second is None:
                raise ValueError("frames_per_second must be given for videos, which have five axes")
            rate = _validate.number("frames_per_second", frames_per_second, positive=True)
            axes, options = "BCFHW", {"frames_per_second": rate}
            dim_order = axes if dim_order == "BCHW" else dim_order
        elif frames_per_second is not None:
            raise ValueError(f"frames_per_second is for videos of five axes, got {tuple(predictions.shape)}")
        else:
            axes, options = "BCHW", {}
        predictions, targets = (_as_batch(value, dim_order, axes).float() for value in (predictions, targets))
        if not self.available:
            return predictions.new_full((), torch.nan)
        with _quietly():
            scores = [
                self._metric().predict(one[None], two[None], dim_order=axes, **options)[0].reshape(())
                for one, two in zip(predictions, targets, strict=True)
            ]
        return torch.stack(scores).mean()

    def _metric(self):
        raise NotImplementedError


class CVVDP(_DifferencePredictor):
    """ColorVideoVDP: visual difference of pictures or videos in colour, in JOD; a quality, larger is better.

    Mantiuk, Hanji, Ashraf, Asano and Chapiro, ACM Trans. Graph. 43, 129 (2024).

    Parameters
    ----------
    device : torch.device
        Where the comparison runs.
    required : bool
        Raise when the package is missing. Otherwise that is logged once, and values are not numbers.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    cvvdp : pycvvdp.cvvdp or None
        The metric.

    Raises
    ------
    ImportError
        If the package is missing and required; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import CVVDP
    >>> measure, picture = CVVDP(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    10.0

    Of a video that flickers, at 30 frames per second:

    >>> video = torch.full((1, 3, 12, 64, 64), 0.5)  # doctest: +SKIP
    >>> flickering = video.clone()  # doctest: +SKIP
    >>> flickering[:, :, ::2] += 0.02  # doctest: +SKIP
    >>> measure(flickering, video, frames_per_second=30.0).item() < 10  # doctest: +SKIP
    True
    """

    _module, _package = "pycvvdp", "cvvdp"

    def __init__(self, device: torch.device = torch.device("cpu"), *, required: bool = False):  # noqa: B008
        super().__init__(required)
        device = checked_device("device", device)
        self.cvvdp = None
        if self.available:
            with _quietly():
                self.cvvdp = self._import().cvvdp(display_name="standard_4k", quiet=True, device=device)

    def _metric(self):
        return self.cvvdp


class FVVDP(_DifferencePredictor):
    """FovVideoVDP: visual difference of pictures or videos in luminance, in JOD; a quality, larger is better.

    Mantiuk et al., ACM Trans. Graph. 40, 49 (2021).

    Parameters
    ----------
    device : torch.device
        Where the comparison runs.
    required : bool
        Raise when the package is missing. Otherwise that is logged once, and values are not numbers.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    fvvdp : pyfvvdp.fvvdp or None
        The metric.

    Raises
    ------
    ImportError
        If the package is missing and required; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import FVVDP
    >>> measure, picture = FVVDP(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    10.0
    """

    _module, _package = "pyfvvdp", "pyfvvdp"

    def __init__(self, device: torch.device = torch.device("cpu"), *, required: bool = False):  # noqa: B008
        super().__init__(required)
        device = checked_device("device", device)
        self.fvvdp = None
        if self.available:
            with _quietly():
                self.fvvdp = self._import().fvvdp(display_name="standard_4k", heatmap="none", quiet=True, device=device)

    def _metric(self):
        return self.fvvdp


class LPIPS(_Wrapper):
    """Learned perceptual image patch similarity with SqueezeNet: a distance, 0 for equal pictures.

    Zhang, Isola, Efros, Shechtman and Wang, CVPR (2018). torchvision fetches SqueezeNet's weights when the first
    pictures are compared; neither the import nor the constructor uses the network.

    Parameters
    ----------
    required : bool
        Raise when the package is missing. Otherwise that is logged once, and values are not numbers.

    Attributes
    ----------
    available : bool
        Whether the package is there.
    lpips : lpips.LPIPS or None
        The network, once it has been used; its weights are frozen.

    Raises
    ------
    ImportError
        If the package is missing and required; the message states what to install.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import LPIPS
    >>> measure, picture = LPIPS(), torch.rand(1, 3, 64, 64)  # doctest: +SKIP
    >>> measure(picture, picture).item()  # doctest: +SKIP
    0.0
    """

    _module = _package = "lpips"

    def __init__(self, *, required: bool = False):
        super().__init__(required)
        self.lpips = None

    def forward(self, predictions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the mean distance of pictures.

        Parameters
        ----------
        predictions, targets : torch.Tensor
            Pictures ``[B, C, H, W]`` or ``[C, H, W]`` of one or three channels, 0 … 1; values outside are clipped.

        Returns
        -------
        torch.Tensor
            Distance without axes, float32. Differentiable. Not a number when the package is missing.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ, or there are not three or four axes and one or three channels.
        """
        pictures = [_as_batch(value).float() for value in checked_pair(predictions, targets)]
        if not self.available:
            return pictures[0].new_full((), torch.nan)
        # The network was trained on −1 … 1.
        pictures = [(2 * picture - 1).clamp(-1, 1).expand(-1, 3, -1, -1) for picture in pictures]
        return self._network(pictures[0].device)(*pictures).mean()

    def _network(self, device):
        if self.lpips is None:
            with _quietly():
                self.lpips = self._import().LPIPS(net="squeeze", verbose=False).requires_grad_(False)
        return self.lpips.to(device)


@contextlib.contextmanager
def _quietly():
    """Keep the deprecation warnings of other packages from the caller."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _as_batch(pictures, dim_order="BCHW", axes="BCHW"):
    """Return pictures or videos with their axes in the order `axes`, C being 1 or 3."""
    if pictures.ndim not in (3, len(axes)):
        raise ValueError(f"predictions and targets must have three or four axes, got {tuple(pictures.shape)}")
    if pictures.ndim == 3:
        batch = pictures[None]
    elif sorted(dim_order) != sorted(axes):
        raise ValueError(f"dim_order must name the axes {', '.join(axes)} once each, got {dim_order!r}")
    else:
        batch = pictures.permute(*(dim_order.index(axis) for axis in axes))
    if batch.shape[1] not in (1, 3):
        raise ValueError(f"predictions and targets must have one or three channels, got {batch.shape[1]}")
    return batch
