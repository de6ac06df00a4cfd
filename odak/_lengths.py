"""Lengths in metres and angles in degrees: numbers, texts and quantities with units, and lengths that fit together."""

import math
import re

import numpy

from odak._array import is_array, is_readable, is_torch
from odak._warnings import ArgumentWarning, warn

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12}
# Wavelengths per pixel of no grid: light does not leave the pixels of the first, and is evanescent behind the second.
# Between the second pair there are grids, of near fields and of telescopes, which are rare: a warning.
COARSEST, FINEST = 5e6, 1e-3
_COARSE, _FINE = 1e5, 1e-2
# A pixel of so many Fresnel zones casts its own shadow: the distance was meant to be the pitch.
_FRESNEL_ZONES = 1e5
# Light of lenses, in metres: from that of lithography, 13.5 nm, to far infrared, 118 um, with a margin.
_LIGHT = (5e-9, 2e-4)
# Focal lengths of lenses in wavelengths: a half millimetre, and half a kilometre, in visible light.
_SHORTEST_FOCUS, _LONGEST_FOCUS = 1e3, 1e9
# Films: a wavelength over the thinnest, of about an atom, and the thickest one over a wavelength.
_THINNEST_FILM, _THICKEST_FILM = 3e3, 100.0
# Per kelvin; that of rubber is 3e-4.
_LARGEST_EXPANSION = 1e-3
# Lengths in an array that are compared, one for each field of a batch.
_MOST_LENGTHS = 64


def in_metres(name: str, value):
    """Return a length, or a list of lengths, in metres: texts and quantities as numbers, numbers as they are."""
    if type(value) is float or is_torch(value):
        return value
    if type(value) is str:
        try:
            return parse_length(value)
        except ValueError as error:
            raise ValueError(f"{name} must be a length in metres, or with a unit: {error}") from None
    if type(value) in (list, tuple):
        made = [in_metres(name, entry) for entry in value]
        return type(value)(made) if any(a is not b for a, b in zip(made, value, strict=True)) else value
    return _of_quantity(name, value, "m", "a length") if hasattr(value, "to") else value


def in_unit(name: str, value, unit: str):
    """Return a length, or a list of lengths, in one of :data:`UNITS`: numbers as they are, texts and quantities too."""
    made = in_metres(name, value)
    if made is value:
        return value
    scale = 1.0 / UNITS[unit]
    return type(made)(scale * one for one in made) if isinstance(made, (list, tuple)) else scale * made


def light_in(name: str, value, unit: str):
    """Return wavelengths of a lens in its unit, with a warning of numbers that are no light in this unit."""
    ends = _range_of(value)
    if ends is not None:
        for bare in dict.fromkeys(ends):
            if not _LIGHT[0] <= bare * UNITS[unit] <= _LIGHT[1]:
                _doubt_unit(name, bare, unit, likely_length(bare * UNITS[unit], 1e-7, 2e-5, "nm"))
                break
    return in_unit(name, value, unit)


def focal_length_in(name: str, value, wavelengths, unit: str):
    """Return a focal length in the unit of its lens, with a warning of a number that no lens for this light has."""
    ends, waves = _range_of(value), _range_of(wavelengths)
    if ends is not None and waves is not None:
        short, long = ends[0] < _SHORTEST_FOCUS * waves[1], ends[1] > _LONGEST_FOCUS * waves[0]
        if short or long:
            _doubt_unit(name, ends[0], unit, likely_length(ends[0] * UNITS[unit], 2e-3, 2.0, "mm"))
    return in_unit(name, value, unit)


def film_in(name: str, value, wavelength, unit: str) -> None:
    """Warn of the thicknesses of films, numbers in a unit, that are no films beside the wavelength."""
    ends, waves = _range_of(value), _range_of(wavelength)
    if ends is None or waves is None:
        return
    least, most = (share * wave * UNITS[unit] for share, wave in ((1e-2, waves[0]), (3, waves[1])))
    for bare in ends:
        if not waves[0] / _THINNEST_FILM <= bare <= _THICKEST_FILM * waves[1]:
            _doubt_unit(name, bare, unit, likely_length(bare * UNITS[unit], least, most, "nm"))
            return


def expansion_in(name: str, value):
    """Return a coefficient of expansion per kelvin, with a warning of one that no solid has."""
    ends = _range_of(abs(value) if isinstance(value, (float, int)) else value)
    if ends is not None and ends[1] > _LARGEST_EXPANSION:
        meant = f"; did you mean {ends[1]:g}e-6, {ends[1]:g} parts per million?" if ends[1] < 1e3 else ""
        warn(f"{name} is an expansion per kelvin: {ends[1]:g} is that of no solid{meant}", ArgumentWarning)
    return value


def _doubt_unit(name: str, value: float, unit: str, meant: str) -> None:
    """Warn of a bare number whose unit was probably not that of the system."""
    warn(
        f"{name}: {value:g} is taken as {value:g} {unit}, the unit of the system; did you mean {meant!r}? A text with "
        "a unit of its own is taken as it stands",
        ArgumentWarning,
    )


def in_degrees(name: str, value):
    """Return an angle, or a list of angles, in degrees, with a warning of one that is a whole angle in radians."""
    if type(value) is float:
        turned = math.degrees(value)
        # A number of degrees hits a whole number of half degrees in radians once in ten million times.
        if 0.5 < abs(turned) <= 360 and abs(turned * 2 - round(turned * 2)) < 1e-9 * abs(turned):
            warn(
                f"{name} is in degrees: {value:.6g} is {turned:.4g} degrees in radians, was that meant?",
                ArgumentWarning,
            )
        return value
    if type(value) in (list, tuple):
        made = [in_degrees(name, entry) for entry in value]
        return type(value)(made) if any(a is not b for a, b in zip(made, value, strict=True)) else value
    return _of_quantity(name, value, "deg", "an angle") if hasattr(value, "to") and not is_torch(value) else value


def _of_quantity(name: str, value, unit: str, what: str):
    """Return the numbers of a quantity of pint, astropy or another library in a unit; other values as they are."""
    if not (hasattr(value, "magnitude") or hasattr(value, "unit") or hasattr(value, "units")):
        return value
    try:
        made = value.to(unit)
    except Exception as error:
        raise ValueError(f"{name} must be {what}, got {value!r:.80}: {error}") from error
    made = made.magnitude if hasattr(made, "magnitude") else made.value
    return made if is_array(made) and made.ndim else float(made)


def parse_length(text: str | float) -> float:
    """Return a length in metres from a number, or from a number and a unit such as ``532nm``, ``8um`` or ``15cm``."""
    if not isinstance(text, str):
        return text
    found = re.fullmatch(r"\s*([^a-zA-Zµμ]*(?:[eE][+-]?\d+)?|nan|inf)\s*([a-zµμ]*)\s*", text)
    unit = (found[2] or "m").replace("µ", "u").replace("μ", "u") if found else ""
    try:
        value = float(found[1]) if found else math.nan
    except ValueError:
        unit = ""
    if unit not in UNITS:
        raise ValueError(f"{text!r} is not a length; write it as 8e-6 (metres), 8um, 532nm or 15cm")
    return value * UNITS[unit] if unit != "m" else value


def likely_length(value: float, least: float, most: float, unit: str) -> str:
    """Return a length that is likely to have been meant by a number that was taken for metres."""
    for factor in (1e-3, 1e-6, 1e-9, 1e3, 1e6):
        if least <= value * factor <= most:
            return f"{value * factor / UNITS[unit]:g}{unit}"
    return f"{float(f'{math.sqrt(least * most) / UNITS[unit]:.1g}'):g}{unit}"


def lengths_together(wave, pitch, distance=None, *, names=("wavelength", "dx", "distance")) -> None:
    """Raise ValueError for lengths that cannot belong to one propagation; warn of those that rarely do."""
    numbers = type(wave) is type(pitch) is type(distance) is float
    if numbers and 0 < _FINE * wave <= pitch <= _COARSE * wave and pitch <= abs(distance):
        return
    message = _doubt(names, wave, pitch, distance)
    if message is not None:
        warn(message, ArgumentWarning)


def _doubt(names: tuple[str, str, str], wave, pitch, distance) -> str | None:
    """Return the text of a warning where wavelength, pitch and distance rarely belong together, None if they do.

    ValueError is raised where they cannot, with what was probably meant.
    """
    wave_name, pitch_name, distance_name = names
    waves = _range_of(wave)
    if waves is None:
        return None
    shortest, longest = waves
    pixels = _range_of(pitch)
    if pixels is None:
        if pitch is None and 100 <= longest <= 1e4:
            meant = likely_length(longest, 1e-7, 2e-5, "nm")
            return f"{wave_name} is in metres: {longest:g} is {longest:g} metres; did you mean {meant}?"
        return None
    finest, coarsest = pixels
    reach = _range_of(-distance if isinstance(distance, (float, int)) and distance < 0 else distance)
    furthest = reach[1] if reach is not None else 0.0
    if 0 < furthest < finest:
        # Propagation over less than a pixel happens, in near fields; not over so little of one.
        as_pitch = longest / 2 < furthest < 1e3 * longest
        if as_pitch and finest > 10 * furthest and finest**2 / (longest * furthest) > _FRESNEL_ZONES:
            raise ValueError(
                f"{distance_name} must be one over which light leaves its pixel, got {furthest:g} m for pixels of "
                f"{finest:g} m: were {distance_name} and {pitch_name} exchanged?"
            )
        if finest < longest / 20:
            raise ValueError(
                f"{wave_name} must be of light on this grid, got {longest:g} m for pixels of {finest:g} m and "
                f"{distance_name} of {furthest:g} m: were {wave_name} and {distance_name} exchanged?"
            )
    if finest < FINEST * longest:
        meant = likely_length(longest, 1e-7, 2e-5, "nm")
        raise ValueError(
            f"{wave_name} must be of light on this grid, got {longest:g} m for pixels of {finest:g} m, whose field "
            f"would be evanescent: did you mean {meant}?"
        )
    if coarsest > COARSEST * shortest:
        meant = likely_length(coarsest, 1e-6, 1e-3, "um")
        raise ValueError(
            f"{pitch_name} must be of a grid for this light, got {coarsest:g} m for a wavelength of {shortest:g} m: "
            f"did you mean {meant}?"
        )
    fine = finest < _FINE * longest
    if not fine and coarsest <= _COARSE * shortest:
        return None
    ratio = f"{finest:g} m is under a hundredth of" if fine else f"{coarsest:g} m is over 100 000 times"
    return f"{pitch_name} of {ratio} the {wave_name}, {longest:g} m: lengths are in metres, was another unit meant?"


def _range_of(value) -> tuple[float, float] | None:
    """Return the least and the largest of plain numbers; None of others, of those below or at 0, and of infinite ones.

    Tensors that require a gradient, wait on a GPU or are transformed are not looked at.
    """
    if isinstance(value, (float, int)):
        return (value, value) if 0 < value < math.inf else None
    if isinstance(value, (list, tuple)):
        found = [_range_of(entry) for entry in value]
        known = [entry for entry in found if entry is not None]
        return (min(a for a, _ in known), max(b for _, b in known)) if known and len(known) == len(found) else None
    if is_torch(value):
        if value.requires_grad or not (value.is_cpu and value.is_floating_point() and is_readable(value)):
            return None
    elif not isinstance(value, (numpy.ndarray, numpy.generic)) or value.dtype.kind not in "fiu":
        return None
    # What is no list of a few lengths takes too long to read.
    if not 0 < math.prod(value.shape) <= _MOST_LENGTHS:
        return None
    listed = value.reshape(-1).tolist() if value.ndim else [value.item()]
    least, largest = min(listed), max(listed)
    return (least, largest) if least > 0 and largest < math.inf else None
