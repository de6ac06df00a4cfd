"""Individual observers: cone fundamentals by density and peak of pigments, and the failure of metameric matches."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch

from odak import _validate
from odak.learn.perception.color import ciede2000, xyz_to_lab
from odak.learn.perception.display_color import color_matching_functions, cone_fundamentals

# Fourier series in the logarithm of the wavelength, constant, then cosine and sine of each order: logarithms of the
# absorbances of the pigments. A. Stockman and A. T. Rider, Color Res. Appl. 48, 818 (2023), doi 10.1002/col.22879.
ABSORBANCES = {
    "L": (
        (
            -42.41760856 - 0.004264105,
            -2.656791612,
            75.011093607,
            56.477062776,
            7.509397607,
            9.061442173,
            -38.068488495,
            -20.974610259,
            -6.64274625,
            -3.785039126,
            9.322071459,
            3.134494745,
            1.603799055,
            0.439302358,
            -0.676958684,
            -0.072988371,
            -0.07885751,
        ),
        553.1,
    ),
    "M": (
        (
            -210.6568853069 + 0.0005894876,
            -0.1458073553,
            386.731976325,
            305.471058467,
            5.0218382813,
            6.838622435,
            -208.2062335724,
            -118.4890200521,
            -5.762586633,
            -3.7973553168,
            55.1803460639,
            19.9728512548,
            1.8990456325,
            0.6913410864,
            -5.0891806213,
            -0.7070689492,
            -0.1419926703,
        ),
        529.9,
    ),
    "S": (
        (
            207.3880950935 + 0.0002358232,
            -6.3065623516,
            -393.7100478026,
            -315.6650602846,
            19.2917535553,
            19.6414743488,
            214.2211570447,
            121.8584683485,
            -15.1820737886,
            -8.6774057156,
            -56.7596380441,
            -20.6318720369,
            3.693487504,
            1.048302248,
            5.3656615075,
            0.7898783086,
            -0.1480357836,
        ),
        416.9,
    ),
}
# Densities over the wavelength, in the same form.
MACULAR = (
    3712.2037792986,
    374.1811575175,
    -7007.6989637831,
    -5887.2857515364,
    -633.0475233043,
    -716.0429039473,
    4386.8811254914,
    2882.1092658881,
    638.1347550701,
    468.4980700497,
    -1653.756738812,
    -817.1240899995,
    -286.4038978705,
    -144.7996457395,
    340.3364828167,
    115.5652804221,
    59.1650826447,
    18.6678197694,
    -30.2344535413,
    -5.4683753172,
    -4.1335064207,
    -0.5043959566,
    0.5094171266,
)
LENS = (
    -313.9508632762,
    -70.3216819666,
    585.4719725809,
    471.5395862431,
    117.3539102044,
    127.0168222865,
    -324.4700544731,
    -188.1638078982,
    -104.5512488013,
    -68.3078486904,
    89.7815373733,
    33.4498264952,
    35.272363887,
    13.6524086627,
    -8.7568168893,
    -1.2825766708,
    -3.5126531075,
    -0.4477840959,
    0.0428291365,
)
MACULAR_SCALE, LENS_SCALE = 1.0050048550, 1.0091871745
LOG_START, LOG_STEP = 2.556302500767287267, 0.1187666467581842301
# Shares of the two common variants of the L pigment, the distance between their peaks in nanometres, and the factor
# that gives the mean of the two the maximum 1.
SHARES, VARIANT, L_SCALE = (0.56, 0.44), -2.70, 1.000935055234848
MACULAR_PEAK, LENS_AT_400, DENSITIES = 0.35, 1.7649, (0.5, 0.5, 0.4)
# Standard deviations over people: of densities in parts of their means, of peaks in nanometres. Asano, Fairchild and
# Blondé, PLoS ONE 11, e0145671 (2016), doi 10.1371/journal.pone.0145671, table 5, after its second step, which scales
# those of the literature (19.1 and 37.2 %; 17.9, 17.9 and 14.7 %; 4, 3 and 2.5 nm) by 0.98 for lens and macula and by
# 0.5 for the pigments.
LENS_SPREAD, MACULAR_SPREAD = 0.187, 0.365
DENSITY_SPREADS, PEAK_SPREADS = (0.09, 0.09, 0.074), (2.0, 1.5, 1.3)
AXIS = tuple(range(390, 781))


def individual_cone_fundamentals(
    wavelengths: torch.Tensor | Sequence[float],
    lens: float = LENS_AT_400,
    macular: float = MACULAR_PEAK,
    densities: Sequence[float] = DENSITIES,
    shifts: Sequence[float] = (0.0, 0.0, 0.0),
) -> torch.Tensor:
    """Return the sensitivities of one person's L, M and S cones to light of equal power.

    Parameters
    ----------
    wavelengths : torch.Tensor or sequence of float
        In nanometres, 390 to 780.
    lens : float
        Optical density of the lens at 400 nm.
    macular : float
        Peak optical density of the macular pigment; 0.35 is that of the standard observer for 2°.
    densities : sequence of float
        Peak optical densities of the L, M and S pigments.
    shifts : sequence of float
        Of the peaks of the L, M and S pigments, in nanometres.

    Returns
    -------
    torch.Tensor
        ``[3, S]``, float64, each with a maximum of 1 over whole nanometres.

    Raises
    ------
    ValueError, TypeError
        If a wavelength or a number is out of range.

    Notes
    -----
    Formulas of Stockman and Rider, Color Res. Appl. 48, 818 (2023), doi 10.1002/col.22879. With the default numbers
    they are CIE 170-1:2006 for 2° (:func:`cone_fundamentals`) within two per cent of the maximum.

    Examples
    --------
    >>> from odak.learn.perception import cone_fundamentals, individual_cone_fundamentals
    >>> waves = [450.0, 540.0, 600.0]
    >>> bool((individual_cone_fundamentals(waves) - cone_fundamentals(waves)).abs().max() < 0.02)
    True
    """
    nm = torch.as_tensor(_validate.real("wavelengths", wavelengths), dtype=torch.float64)
    if nm.ndim != 1 or not len(nm) or float(nm.min()) < AXIS[0] or float(nm.max()) > AXIS[-1]:
        raise ValueError(f"wavelengths must be a list of numbers from 390 to 780 nanometres, got {wavelengths!r:.80}")
    lens, macular = (_validate.constant(name, one) for name, one in (("lens", lens), ("macular", macular)))
    for name, value in (("lens", lens), ("macular", macular)):
        if value < 0:
            raise ValueError(f"{name} must not be negative, got {value}")
    densities = [float(one) for one in _validate.several("densities", densities, 3)]
    if min(densities) <= 0:
        raise ValueError(f"densities must be positive, got {densities}")
    shifts = [float(one) for one in _validate.several("shifts", shifts, 3)]
    whole = torch.tensor(AXIS, dtype=torch.float64)
    peaks = _fundamentals(whole, lens, macular, densities, shifts).amax(1, keepdim=True)
    return _fundamentals(nm, lens, macular, densities, shifts) / peaks


def _fundamentals(nm, lens, macular, densities, shifts):
    filters = macular / MACULAR_PEAK * _density(nm, MACULAR, 375.0, 550.0) * MACULAR_SCALE
    filters = filters + lens / LENS_AT_400 * _density(nm, LENS, 360.0, 660.0) * LENS_SCALE
    found = []
    for (name, (series, peak)), density, shift in zip(ABSORBANCES.items(), densities, shifts, strict=True):
        moves = [(1.0, shift)]
        if name == "L":
            moves = [(L_SCALE * share, shift + step) for share, step in zip(SHARES, (0.0, VARIANT), strict=True)]
        angle = (torch.log10(nm) - LOG_START + math.log10(peak)) / LOG_STEP
        absorbance = sum(
            share * 10 ** _series(angle - math.log10(peak + move) / LOG_STEP, series) for share, move in moves
        )
        found.append(nm * (1 - 10 ** (-density * absorbance)) * 10**-filters)
    return torch.stack(found)


def _density(nm, series, start, end):
    """Return a density over the wavelength, whose series runs over half a period from `start` to `end`."""
    return _series(math.pi * (nm - start) / (end - start), series).where((nm >= start) & (nm <= end), 0.0)


def _series(angle, series):
    total = series[0] + 0 * angle
    for order in range(1, len(series) // 2 + 1):
        total = total + series[2 * order - 1] * torch.cos(order * angle) + series[2 * order] * torch.sin(order * angle)
    return total


def sample_observers(number: int, wavelengths: torch.Tensor | Sequence[float] = AXIS, seed: int = 0) -> torch.Tensor:
    """Return the cone fundamentals of people drawn at random.

    Parameters
    ----------
    number : int
        Of people.
    wavelengths : torch.Tensor or sequence of float
        In nanometres, 390 to 780.
    seed : int
        Of the draw.

    Returns
    -------
    torch.Tensor
        ``[number, 3, S]``, float64.

    Raises
    ------
    ValueError, TypeError
        If an argument is out of range.

    Notes
    -----
    Densities of lens, macula and pigments, and peaks of pigments, are normal about those of the standard observer with
    the deviations of Asano, Fairchild and Blondé, PLoS ONE 11, e0145671 (2016), doi 10.1371/journal.pone.0145671:
    18.7 % for the lens, 36.5 % for the macula, 9, 9 and 7.4 % for the densities and 2, 1.5 and 1.3 nm for the peaks of
    the L, M and S pigments. Densities stay above a twentieth of their means. Age, which changes the lens, is not
    varied.

    Examples
    --------
    >>> from odak.learn.perception import sample_observers
    >>> sample_observers(5, [450.0, 550.0]).shape
    torch.Size([5, 3, 2])
    """
    number = _validate.integer("number", number, minimum=1)
    generator = torch.Generator().manual_seed(_validate.integer("seed", seed))
    draws = torch.randn(number, 8, dtype=torch.float64, generator=generator).tolist()
    people = []
    for lens, macular, *rest in draws:
        density = [
            mean * max(0.05, 1 + spread * draw)
            for mean, spread, draw in zip(DENSITIES, DENSITY_SPREADS, rest[:3], strict=True)
        ]
        shifts = [spread * draw for spread, draw in zip(PEAK_SPREADS, rest[3:], strict=True)]
        people.append(
            individual_cone_fundamentals(
                wavelengths,
                LENS_AT_400 * max(0.05, 1 + LENS_SPREAD * lens),
                MACULAR_PEAK * max(0.05, 1 + MACULAR_SPREAD * macular),
                density,
                shifts,
            )
        )
    return torch.stack(people)


class MetamericFailure(NamedTuple):
    """How people see a match that the standard observer accepts.

    Attributes
    ----------
    differences : torch.Tensor
        CIEDE2000 difference for each person, ``[N]``.
    weights : torch.Tensor
        Of the three primaries in the match of the standard observer, ``[3]``.

    Examples
    --------
    A target that is one of the primaries is matched by it alone, for everybody:

    >>> import torch
    >>> from odak.learn.perception import metameric_failure, sample_observers
    >>> waves = torch.arange(390.0, 781.0, dtype=torch.float64)
    >>> lasers = torch.stack([torch.exp(-((waves - peak) ** 2) / 2) for peak in (638.0, 520.0, 450.0)])
    >>> found = metameric_failure(lasers, lasers[1], sample_observers(3))
    >>> tuple(found.differences.shape), bool(found.differences.max() < 1e-6)
    ((3,), True)
    """

    differences: torch.Tensor
    weights: torch.Tensor


def metameric_failure(
    primaries: torch.Tensor,
    reference: torch.Tensor,
    observers: torch.Tensor,
    wavelengths: torch.Tensor | Sequence[float] = AXIS,
) -> MetamericFailure:
    """Return individual observers' colour differences of a display and a light that match for the standard one.

    Parameters
    ----------
    primaries : torch.Tensor
        Spectra of a display's three primaries ``[3, S]``.
    reference : torch.Tensor
        Spectrum of the light that the display shall match ``[S]``, to which each person adapts.
    observers : torch.Tensor
        Cone fundamentals ``[N, 3, S]``, as :func:`sample_observers` gives them.
    wavelengths : torch.Tensor or sequence of float
        Of the samples, in equal steps, in nanometres.

    Returns
    -------
    MetamericFailure
        Differentiable in the spectra.

    Raises
    ------
    ValueError, TypeError
        If shapes do not fit, or the primaries cannot match the reference.

    Notes
    -----
    The standard observer is :func:`cone_fundamentals`. Each person's cone responses to the display are divided by those
    to the reference (von Kries), and the ratio taken as that of the standard observer's cones, whose responses are
    turned into XYZ by the matrix that fits the CIE 1931 functions best.

    Examples
    --------
    >>> import torch
    >>> from odak.learn.perception import illuminant_d65, metameric_failure, sample_observers
    >>> waves = torch.arange(390.0, 781.0, dtype=torch.float64)
    >>> lasers = torch.stack([torch.exp(-((waves - peak) ** 2) / 2) for peak in (638.0, 520.0, 450.0)])
    >>> found = metameric_failure(lasers, illuminant_d65(waves), sample_observers(20))
    >>> bool(found.differences.mean() > 1)
    True
    """
    standard = cone_fundamentals(wavelengths).double()
    matching = color_matching_functions(wavelengths).double()
    spectra = {"primaries": (primaries, 2), "reference": (reference, 1), "observers": (observers, 3)}
    for name, (value, axes) in spectra.items():
        if not isinstance(value, torch.Tensor) or not value.is_floating_point():
            raise TypeError(f"{name} must be a tensor of real floats, got {getattr(value, 'dtype', type(value))}")
        if value.ndim != axes or value.shape[-1] != standard.shape[-1]:
            raise ValueError(f"{name} must have {standard.shape[-1]} wavelengths, got {tuple(value.shape)}")
        _validate.real(name, value.detach())
    _validate.one_device(primaries=primaries, reference=reference, observers=observers)
    standard, matching = standard.to(primaries.device), matching.to(primaries.device)
    if primaries.shape[0] != 3 or observers.shape[1] != 3:
        raise ValueError(
            f"primaries must be [3, S] and observers [N, 3, S], got {tuple(primaries.shape)}, {tuple(observers.shape)}"
        )
    primaries, reference, observers = primaries.double(), reference.double(), observers.double()
    mixing = standard @ primaries.T
    if float(torch.linalg.cond(mixing.detach())) > 1e8:
        raise ValueError("primaries must be three that the cones can distinguish")
    weights = torch.linalg.solve(mixing, standard @ reference)
    shown, wanted = observers @ (primaries.T @ weights), observers @ reference
    to_xyz = torch.linalg.lstsq(standard.T, matching.T).solution.T
    white = to_xyz @ (standard @ reference)
    seen = (shown / wanted * (standard @ reference)) @ to_xyz.T / white[1]
    white = white / white[1]
    lab = xyz_to_lab(torch.cat([seen, white[None]])[:, :, None, None], white)
    differences = ciede2000(lab[:-1], lab[-1:].expand_as(lab[:-1]))
    return MetamericFailure(differences.reshape(-1), weights)
