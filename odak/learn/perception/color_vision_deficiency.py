"""What people with a colour-vision deficiency see: Brettel, Viénot and Machado."""

import functools
import json
from importlib import resources

import numpy as np
import torch
from torch import nn

from odak import _array, _validate
from odak.learn._precision import in_own_precision
from odak.learn.perception.color_matrices import as_pictures, mix, rows
from odak.learn.perception.cvd_loss_functions import cvd_loss
from odak.learn.perception.pixel_blocks import by_values
from odak.learn.perception.pixel_formulas import decoded, decoded_slopes, encoded, encoded_slopes
from odak.learn.perception.util import check_values

DEFICIENCIES = ("protan", "deutan", "tritan")
METHODS = ("Machado", "Brettel", "Vienot")

# Linear BT.709 RGB to the XYZ of Judd and Vos, and that to the cones of Smith and Pokorny (1975), L + M = Y.
_RGB_TO_JUDD_VOS = np.array(
    [(0.409568, 0.355041, 0.179167), (0.213389, 0.706743, 0.0798680), (0.0186297, 0.114620, 0.912367)]
)
_JUDD_VOS_TO_LMS = np.array([(0.15514, 0.54312, -0.03286), (-0.15514, 0.45684, 0.03286), (0.0, 0.0, 0.01608)])
_RGB_TO_LMS = _JUDD_VOS_TO_LMS @ _RGB_TO_JUDD_VOS
# XYZ of Judd and Vos of lights, by wavelength in nanometres, that people with a deficiency see as others do.
_ANCHORS = {
    475: (0.13287, 0.11284, 0.94220),
    485: (0.05699, 0.16987, 0.58640),
    575: (0.84394, 0.91558, 0.00197),
    660: (0.16161, 0.06100, 0.00001),
}
_ANCHORS_OF = {"protan": (475, 575), "deutan": (475, 575), "tritan": (485, 660)}


def simulate_color_vision_deficiency(
    image: torch.Tensor,
    deficiency: str = "deutan",
    severity: float | torch.Tensor = 1.0,
    method: str = "Machado",
    *,
    linear: bool = False,
) -> torch.Tensor:
    """Return what somebody with a colour-vision deficiency sees, for somebody without one.

    Parameters
    ----------
    image : torch.Tensor
        sRGB ``[..., 3, H, W]``.
    deficiency : {"protan", "deutan", "tritan"}
        Which cones differ: L, M or S.
    severity : float or torch.Tensor
        0 (none) … 1 (a dichromat). May require a gradient.
    method : {"Machado", "Brettel", "Vienot"}
        Machado et al. (2009): shifted cones, tables in steps of 0.1, linear between. Brettel et al. (1997): two half
        planes, the method for tritan. Viénot et al. (1999): one plane, protan and deutan only. The last two are for
        dichromats; a severity below 1 mixes them with the picture.
    linear : bool
        Take and return linear light in place of sRGB.

    Returns
    -------
    torch.Tensor
        ``[..., 3, H, W]``, four axes for three; greys stay grey to 1e-5. Not clipped: values outside 0 … 1 are colours
        that the display cannot show. Differentiable, with finite gradients.

    Raises
    ------
    ValueError, TypeError
        If the image does not hold three channels of real floats, a name is not known, the severity is outside 0 … 1,
        or Viénot's method is asked for tritan.

    Notes
    -----
    Brettel, Viénot and Mollon, J. Opt. Soc. Am. A 14, 2647 (1997), its neutral axis being the display's white; Viénot,
    Brettel and Mollon, Color Res. Appl. 24, 243 (1999), without its reduction of contrast; Machado, Oliveira and
    Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 1291 (2009). All act on linear light.
    """
    image = as_pictures("image", image)
    deficiency = _validate.one_of("deficiency", deficiency, DEFICIENCIES)
    method = _validate.one_of("method", method, METHODS)
    severity, linear = _checked_severity(severity, image), _validate.flag("linear", linear)
    if method == "Vienot" and deficiency == "tritan":
        raise ValueError("method 'Vienot' is for protan and deutan; take 'Brettel' for tritan")
    light = image if linear else by_values(decoded, image, decoded_slopes)
    if method == "Machado":
        seen = mix(_machado_matrix(deficiency, severity), light)
    else:
        dichromat = _vienot(deficiency, light) if method == "Vienot" else _brettel(deficiency, light)
        seen = torch.lerp(light, dichromat, severity)
    return seen if linear else by_values(encoded, seen, encoded_slopes)


class CVDLoss(nn.Module):
    """What a picture loses for a viewer with a colour-vision deficiency: :func:`cvd_loss` of what that viewer sees.

    Parameters
    ----------
    deficiency, severity, method
        As in :func:`simulate_color_vision_deficiency`.
    alpha, beta : float
        Weights of local contrast and of colour.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import CVDLoss
    >>> picture = torch.rand(1, 3, 8, 8, generator=torch.Generator().manual_seed(0))
    >>> CVDLoss("protan", severity=0.0)(picture).item() < 1e-4 < CVDLoss("protan")(picture).item()
    True
    """

    def __init__(
        self,
        deficiency: str = "deutan",
        severity: float = 1.0,
        method: str = "Machado",
        alpha: float = 15.0,
        beta: float = 1.0,
    ):
        super().__init__()
        self.deficiency = _validate.one_of("deficiency", deficiency, DEFICIENCIES)
        self.method = _validate.one_of("method", method, METHODS)
        self.severity = float(_validate.number("severity", severity))
        self.alpha, self.beta = (float(_validate.number(name, v)) for name, v in (("alpha", alpha), ("beta", beta)))

    def forward(self, image: torch.Tensor, target: torch.Tensor | None = None) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image : torch.Tensor
            sRGB ``[B, 3, H, W]`` as shown, sides at least 4.
        target : torch.Tensor, optional
            What should be seen; the image itself by default.

        Returns
        -------
        torch.Tensor
            The loss, without axes.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ or the pictures are not ``[B, 3, H, W]`` of real floats.
        """
        for name, picture in (("image", image), ("target", image if target is None else target)):
            as_pictures(name, picture)
            if picture.ndim != 4:
                raise ValueError(f"{name} must be [B, 3, H, W], got {tuple(picture.shape)}")
            check_values(1.0, **{name: picture})
        if target is not None and target.shape != image.shape:
            raise ValueError(f"target must have the image's shape {tuple(image.shape)}, got {tuple(target.shape)}")
        _validate.one_device(image=image, target=target)
        seen = simulate_color_vision_deficiency(image, self.deficiency, self.severity, self.method)
        return cvd_loss(image if target is None else target, seen, self.alpha, self.beta)[0]


def _checked_severity(severity, image):
    _validate.number("severity", severity)
    severity = torch.as_tensor(severity, dtype=image.dtype, device=image.device)
    if severity.ndim:
        raise ValueError(f"severity must be one number, got {tuple(severity.shape)}")
    if _array.is_readable(severity) and not 0 <= float(severity.detach()) <= 1:
        raise ValueError(f"severity must be 0 … 1, got {float(severity.detach())!r}")
    return severity


@functools.cache
def _machado_tables():
    path = resources.files("odak.learn.perception").joinpath("data", "color_vision_deficiency_machado_2009.json")
    return json.loads(path.read_text(encoding="utf-8"))


@in_own_precision
def _machado_matrix(deficiency, severity):
    tables = _array.outside_graphs(_machado_tables)
    matrices = severity.new_tensor(tables[deficiency])
    # Each table weighs as a hat over its own severity, which is linear between them.
    steps = severity.new_tensor(tables["severities"])
    weights = (1 - 10 * (severity - steps).abs()).clamp_min(0)
    return torch.tensordot(weights / weights.sum(), matrices, 1)


@functools.cache
def _onto_plane(deficiency, anchor):
    """Return the matrix, in linear RGB, along the missing cone's axis onto the plane of black, white and an anchor."""
    row = DEFICIENCIES.index(deficiency)
    normal = np.cross(_RGB_TO_LMS.sum(1), anchor)
    projection = np.eye(3)
    projection[row] = -normal / normal[row]
    projection[row, row] = 0.0
    return np.linalg.inv(_RGB_TO_LMS) @ projection @ _RGB_TO_LMS


def _vienot(deficiency, light):
    # The plane of white and of the display's blue.
    return mix(rows(_array.outside_graphs(_onto_plane, deficiency, tuple(_RGB_TO_LMS[:, 2]))), light)


def _brettel(deficiency, light):
    short, long = (_JUDD_VOS_TO_LMS @ np.array(_ANCHORS[wavelength]) for wavelength in _ANCHORS_OF[deficiency])
    row = DEFICIENCIES.index(deficiency)
    # The half planes part where the colour lies on the plane of white and the missing cone's axis.
    edge = np.cross(_RGB_TO_LMS.sum(1), np.eye(3)[row])
    edge = edge if edge @ short > 0 else -edge
    side = mix(rows((edge @ _RGB_TO_LMS)[None]), light)
    seen = [mix(rows(_array.outside_graphs(_onto_plane, deficiency, tuple(anchor))), light) for anchor in (short, long)]
    return torch.where(side > 0, *seen)
