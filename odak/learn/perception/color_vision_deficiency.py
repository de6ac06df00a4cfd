"""Simulation of colour-vision deficiencies (Brettel, Viénot, Machado) and losses for viewers who have one."""

import functools
import json
from importlib import resources

import numpy as np
import torch
from torch import nn

from odak import _array, _validate
from odak._torch_private import in_own_precision
from odak.learn._tensors import as_pictures, check_values, floating_tensor, in_float32
from odak.learn.perception.color import mix, root, rows, srgb_decoded, srgb_encoded
from odak.learn.tools.matrix import blur_gaussian

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
    """Simulate, for observers of normal colour vision, how a picture appears with a colour-vision deficiency.

    Parameters
    ----------
    image : torch.Tensor
        sRGB ``[..., 3, H, W]``.
    deficiency : {"protan", "deutan", "tritan"}
        Cones that differ: L, M or S.
    severity : float or torch.Tensor
        0 (none) … 1 (a dichromat). May require a gradient.
    method : {"Machado", "Brettel", "Vienot"}
        Machado et al. (2009): shifted cones, tables in steps of 0.1, linear between. Brettel et al. (1997): two half
        planes, the method for tritan. Viénot et al. (1999): one plane, protan and deutan only. The last two are for
        dichromats; a severity below 1 mixes them with the picture.
    linear : bool
        Take and return linear intensities in place of sRGB.

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
    Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 1291 (2009). All act on linear intensities.

    Examples
    --------
    Greys look the same to everybody:

    >>> import torch
    >>> from odak.learn.perception import simulate_color_vision_deficiency
    >>> result = simulate_color_vision_deficiency(torch.tensor([0.5, 0.5, 0.5]).reshape(1, 3, 1, 1))
    >>> [round(value, 4) for value in result.flatten().tolist()]
    [0.5, 0.5, 0.5]
    """
    image = as_pictures("image", image)
    deficiency = _validate.one_of("deficiency", deficiency, DEFICIENCIES)
    method = _validate.one_of("method", method, METHODS)
    severity, linear = _checked_severity(severity, image), _validate.flag("linear", linear)
    if method == "Vienot" and deficiency == "tritan":
        raise ValueError("method 'Vienot' is for protan and deutan; take 'Brettel' for tritan")
    light = image if linear else srgb_decoded(image)
    if method == "Machado":
        seen = mix(_machado_matrix(deficiency, severity), light)
    elif method == "Vienot":
        # The plane of white and of the display's blue.
        matrix = _array.outside_graphs(_onto_plane, deficiency, tuple(_RGB_TO_LMS[:, 2]))
        seen = torch.lerp(light, mix(rows(matrix), light), severity)
    else:
        seen = torch.lerp(light, _brettel(deficiency, light), severity)
    return seen if linear else srgb_encoded(seen)


class CVDLoss(nn.Module):
    """Contrast and colour lost to a viewer with a colour-vision deficiency: :func:`cvd_loss` of the simulated picture.

    Parameters
    ----------
    deficiency : {"protan", "deutan", "tritan"}
        Cones that differ: L, M or S.
    severity : float
        0 (none) to 1 (a dichromat).
    method : {"Machado", "Brettel", "Vienot"}
        Method of :func:`simulate_color_vision_deficiency`.
    alpha : float
        Weight of local contrast.
    beta : float
        Weight of colour.

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

    alpha: float
    beta: float

    def __init__(
        self,
        deficiency: str = "deutan",
        severity: float = 1.0,
        method: str = "Machado",
        alpha: float = 15.0,
        beta: float = 1.0,
    ):
        super().__init__()
        self.deficiency: str = _validate.one_of("deficiency", deficiency, DEFICIENCIES)
        self.method: str = _validate.one_of("method", method, METHODS)
        self.severity: float = _validate.constant("severity", severity)
        self.alpha, self.beta = (_validate.constant(name, v) for name, v in (("alpha", alpha), ("beta", beta)))

    def forward(self, image: torch.Tensor, target: torch.Tensor | None = None) -> torch.Tensor:
        """Return the loss.

        Parameters
        ----------
        image : torch.Tensor
            sRGB ``[B, 3, H, W]`` as shown, sides at least 4.
        target : torch.Tensor, optional
            Picture that the simulated image is compared with; the image itself by default.

        Returns
        -------
        torch.Tensor
            The loss, without axes, float32 of half precision.

        Raises
        ------
        ValueError, TypeError
            If the shapes differ or the pictures are not ``[B, 3, H, W]`` of real floats.
        """
        target = image if target is None else target
        for name, picture in (("image", image), ("target", target)):
            as_pictures(name, picture)
            _validate.shaped(name, picture, "[B, C, H, W]")
            check_values(1.0, **{name: picture})
        _validate.alike(image=image, target=target)
        image, target = in_float32(image), in_float32(target)
        simulated = simulate_color_vision_deficiency(image, self.deficiency, self.severity, self.method)
        return cvd_loss(target, simulated, self.alpha, self.beta)[0]


def _checked_severity(severity, image):
    _validate.number("severity", severity)
    severity = torch.as_tensor(severity, dtype=image.dtype, device=image.device)
    if severity.ndim:
        raise ValueError(f"severity must be one number, got {tuple(severity.shape)}")
    return _validate.inside("severity", severity, least=0, most=1)


@functools.cache
def _machado_tables():
    path = resources.files("odak.learn.perception").joinpath("data", "color_vision_deficiency_machado_2009.json")
    return json.loads(path.read_text(encoding="utf-8"))


@in_own_precision
def _machado_matrix(deficiency, severity):
    tables = _array.outside_graphs(_machado_tables)
    matrices = severity.new_tensor(tables[deficiency])
    # Linear interpolation between the tables of the severities.
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


def _brettel(deficiency, light):
    short, long = (_JUDD_VOS_TO_LMS @ np.array(_ANCHORS[wavelength]) for wavelength in _ANCHORS_OF[deficiency])
    row = DEFICIENCIES.index(deficiency)
    # The half planes meet in the plane of white and the missing cone's axis.
    edge = np.cross(_RGB_TO_LMS.sum(1), np.eye(3)[row])
    edge = edge if edge @ short > 0 else -edge
    side = mix(rows((edge @ _RGB_TO_LMS)[None]), light)
    seen = [mix(rows(_array.outside_graphs(_onto_plane, deficiency, tuple(anchor))), light) for anchor in (short, long)]
    return torch.where(side > 0, *seen)


_SMALLEST = 4


def extract_local_patches(
    image: torch.Tensor, patch_size: int = 4, stride: int = 2
) -> tuple[torch.Tensor, list[tuple[int, int]]]:
    """Cut pictures into patches.

    Parameters
    ----------
    image : torch.Tensor
        ``[B, C, H, W]``.
    patch_size : int
        Side p of a patch in pixels.
    stride : int
        Step from one patch to the next in pixels.

    Returns
    -------
    tuple
        Patches ``[B, C·p·p, N]``, row by row, each channel after channel; and the N top left corners (x, y).

    Raises
    ------
    ValueError, TypeError
        If the image is not ``[B, C, H, W]`` of real floats, or the patch is larger than it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import extract_local_patches
    >>> patches, corners = extract_local_patches(torch.zeros(1, 3, 6, 8), patch_size=4, stride=2)
    >>> tuple(patches.shape), corners[-1]
    ((1, 48, 6), (4, 2))
    """
    image = _checked("image", image)
    patch_size = _validate.integer("patch_size", patch_size, minimum=1)
    stride = _validate.integer("stride", stride, minimum=1)
    rows, columns = image.shape[-2:]
    if patch_size > min(rows, columns):
        raise ValueError(f"patch_size must be at most the image's {rows} x {columns}, got {patch_size}")
    corners = [
        (x, y) for y in range(0, rows - patch_size + 1, stride) for x in range(0, columns - patch_size + 1, stride)
    ]
    return nn.functional.unfold(image, patch_size, stride=stride), corners


def compute_local_contrast_similarity(
    patch_x: torch.Tensor, patch_y: torch.Tensor, epsilon: float = 1e-8
) -> torch.Tensor:
    """Return the similarity of the contrasts of patches: (2σₓσᵧ + ε)/(σₓ² + σᵧ² + ε), σ being deviations plus ε.

    Parameters
    ----------
    patch_x : torch.Tensor
        Patches ``[D, N]``, D samples each.
    patch_y : torch.Tensor
        Patches to compare with, of the same shape.
    epsilon : float
        Keeps the ratio apart from 0/0.

    Returns
    -------
    torch.Tensor
        ``[N]``, 1 for equal contrast. Differentiable, with finite gradients for flat patches.

    Raises
    ------
    ValueError, TypeError
        If the patches are not ``[D, N]`` of real floats and one shape.

    Examples
    --------
    Patches of which one has twice the contrast of the other have the similarity 2·2/(1 + 4):

    >>> import torch
    >>> from odak.learn.perception import compute_local_contrast_similarity
    >>> patch = torch.tensor([[0.0], [1.0]])
    >>> round(compute_local_contrast_similarity(patch, 2 * patch).item(), 6)
    0.8
    """
    for name, patch in (("patch_x", patch_x), ("patch_y", patch_y)):
        floating_tensor(name, patch)
    _validate.shaped("patch_x", patch_x, "[D, N]")
    _validate.alike(patch_x=patch_x, patch_y=patch_y)
    _validate.number("epsilon", epsilon, positive=True)
    return _similarity(patch_x, patch_y, 0, epsilon)


def local_contrast_loss(
    image: torch.Tensor, simulated_image: torch.Tensor, patch_size: int = 4, stride: int = 2, epsilon: float = 1e-8
) -> torch.Tensor:
    """Return the change of local contrast by a simulation (equation 5): the mean of 1 − similarity over patches.

    Parameters
    ----------
    image : torch.Tensor
        Picture ``[B, C, H, W]``, sides at least 4.
    simulated_image : torch.Tensor
        The picture as simulated, of the same shape.
    patch_size : int
        Side of a patch in pixels.
    stride : int
        Step from one patch to the next in pixels.
    epsilon : float
        Added to deviations and to both sides of the ratio of similarity, which is then defined for flat patches.

    Returns
    -------
    torch.Tensor
        The loss, without axes; exactly 0 for equal pictures.

    Raises
    ------
    ValueError, TypeError
        If the pictures are not as said, or the patch is larger than they are.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import local_contrast_loss
    >>> picture = torch.linspace(0, 1, 192).reshape(1, 3, 8, 8)
    >>> local_contrast_loss(picture, picture).item() < 1e-6, local_contrast_loss(picture, 0 * picture).item() > 0.9
    (True, True)
    """
    image, simulated_image = _checked_pair(image, simulated_image)
    _validate.number("epsilon", epsilon, positive=True)
    return _contrast_lost(image, simulated_image, patch_size, stride, epsilon)


def color_information_loss(
    image: torch.Tensor, simulated_image: torch.Tensor, kernel_size: int = 5, sigma: float = 1.0
) -> torch.Tensor:
    """Return the change of colour by a simulation (equation 6): the mean absolute difference of blurred pictures.

    Parameters
    ----------
    image : torch.Tensor
        Picture ``[B, C, H, W]``, sides at least 4.
    simulated_image : torch.Tensor
        The picture as simulated, of the same shape.
    kernel_size : int
        Side of the blur's kernel, in pixels.
    sigma : float
        Its width. :func:`odak.learn.tools.blur_gaussian` does not normalise: a kernel of 5 and σ = 1 sums
        to 0.639, so that an offset of 0.1 becomes 0.06.

    Returns
    -------
    torch.Tensor
        The loss, without axes; exactly 0 for equal pictures.

    Raises
    ------
    ValueError, TypeError
        If the pictures are not as said, or the kernel is not acceptable.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import color_information_loss
    >>> picture = torch.linspace(0, 1, 48).reshape(1, 3, 4, 4)
    >>> color_information_loss(picture, picture).item()
    0.0
    """
    image, simulated_image = _checked_pair(image, simulated_image)
    kernel_size = _validate.integer("kernel_size", kernel_size, minimum=1)
    sigma = _validate.constant("sigma", sigma, least=0)
    return _colour_lost(image, simulated_image, kernel_size, sigma)


def cvd_loss(
    image: torch.Tensor,
    simulated_image: torch.Tensor,
    alpha: float = 15.0,
    beta: float = 1.0,
    lc_patch_size: int = 4,
    lc_stride: int = 2,
    ci_kernel_size: int = 5,
    ci_sigma: float = 1.0,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Return α·(local contrast) + β·(colour), and both (equation 3).

    Parameters
    ----------
    image : torch.Tensor
        Picture ``[B, C, H, W]``, sides at least 4.
    simulated_image : torch.Tensor
        The picture as simulated, of the same shape.
    alpha : float
        Weight of local contrast.
    beta : float
        Weight of colour.
    lc_patch_size : int
        Side of the patches of :func:`local_contrast_loss` in pixels.
    lc_stride : int
        Step between these patches in pixels.
    ci_kernel_size : int
        Side of the kernel of :func:`color_information_loss` in pixels.
    ci_sigma : float
        Width of this kernel in pixels.

    Returns
    -------
    tuple of torch.Tensor
        Total, contrast and colour, without axes.

    Raises
    ------
    ValueError, TypeError
        If an argument is outside its range, naming it.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import cvd_loss
    >>> picture = torch.linspace(0, 1, 48).reshape(1, 3, 4, 4)
    >>> [term.item() for term in cvd_loss(picture, picture)]
    [0.0, 0.0, 0.0]
    """
    alpha, beta = _validate.number("alpha", alpha), _validate.number("beta", beta)
    lc_patch_size = _validate.integer("lc_patch_size", lc_patch_size, minimum=1)
    lc_stride = _validate.integer("lc_stride", lc_stride, minimum=1)
    ci_kernel_size = _validate.integer("ci_kernel_size", ci_kernel_size, minimum=1)
    ci_sigma = _validate.constant("ci_sigma", ci_sigma, least=0)
    image, simulated_image = _checked_pair(image, simulated_image)
    contrast = _contrast_lost(image, simulated_image, lc_patch_size, lc_stride, 1e-8)
    colour = _colour_lost(image, simulated_image, ci_kernel_size, ci_sigma)
    return alpha * contrast + beta * colour, contrast, colour


def _contrast_lost(image, simulated_image, patch_size, stride, epsilon):
    patches = [extract_local_patches(picture, patch_size, stride)[0] for picture in (image, simulated_image)]
    return (1 - _similarity(*patches, 1, epsilon)).mean()


def _colour_lost(image, simulated_image, kernel_size, sigma):
    # The blur is linear: the difference is blurred once, instead of both pictures.
    return blur_gaussian(image - simulated_image, (kernel_size, kernel_size), (sigma, sigma)).abs().mean()


def _similarity(one, two, axis, epsilon):
    one, two = (root(patches.var(axis, correction=0)) + epsilon for patches in (one, two))
    return (2 * one * two + epsilon) / (one**2 + two**2 + epsilon)


def _checked(name, image):
    floating_tensor(name, image)
    _validate.shaped(name, image, "[B, C, H, W]")
    return image


def _checked_pair(image, simulated_image):
    for name, picture in (("image", image), ("simulated_image", simulated_image)):
        check_values(**{name: _checked(name, picture)})
    if image.shape != simulated_image.shape or not image.numel() or min(image.shape[-2:]) < _SMALLEST:
        raise ValueError(
            f"image and simulated_image must have one shape, sides at least {_SMALLEST}, and not be empty; "
            f"got {tuple(image.shape)} and {tuple(simulated_image.shape)}"
        )
    _validate.one_device(image=image, simulated_image=simulated_image)
    dtype = torch.promote_types(image.dtype, simulated_image.dtype)
    # The term that keeps ratios of flat patches defined is below what half precision resolves.
    return in_float32(image.to(dtype)), in_float32(simulated_image.to(dtype))
