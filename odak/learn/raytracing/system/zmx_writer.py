"""The text of a .zmx file from a system."""

from odak.catalog.materials import MICROMETRES
from odak.learn.raytracing.system.surfaces import AIR, MIRROR, surface

_APERTURES = {"EPD": "ENPD {} ", "F-number": "FNUM {} 0", "NA": "OBNA {} 0", "stop": "FLOA"}


def text_of(system) -> str:
    """Return the lines of a file in millimetres; numbers by `repr`, which loses no digit."""
    scale = MICROMETRES[system.unit] / MICROMETRES["mm"]
    kind = 0 if system.at_infinity else 1
    if system.aperture_type == "NA" and system.at_infinity:
        raise ValueError("aperture_type NA with an object at infinity has no .zmx form; use the F-number")
    size = system.aperture if system.aperture_type in ("F-number", "NA") else system.aperture * scale
    factor = scale if kind else 1.0
    lines = ["VERS 140124 258 36214", "MODE SEQ", f"NAME {system.name}", "UNIT MM X W X CM MR CPMM"]
    lines += [_APERTURES[system.aperture_type].format(repr(size)).strip()]
    lines += [f"FTYP {kind} 0 {len(system.fields)} {len(system.wavelengths)} 0 0 0"]
    lines += [
        f"{key} " + " ".join(repr(field[axis] * factor) for field in system.fields)
        for axis, key in enumerate(("XFLN", "YFLN"))
    ]
    lines += [f"WAVM {i} {value * MICROMETRES[system.unit]!r} 1" for i, value in enumerate(system.wavelengths, start=1)]
    lines += [f"PWAV {system.reference + 1}", "SURF 0", "  TYPE STANDARD", "  CURV 0.0"]
    lines += [f"  DISZ {'INFINITY' if system.at_infinity else repr(system.object_distance * scale)}"]
    for number, item in enumerate(system.surfaces, start=1):
        lines += _surface(number, item, scale, number - 1 == system.stop, system)
    lines += [f"SURF {len(system.surfaces) + 1}", *_shape("image", system.image or surface(), scale), "  DISZ 0"]
    if system.image is not None and system.image.semi_diameter is not None:
        lines += _limit(system.image.semi_diameter * scale)
    return "\n".join(lines) + "\n"


def _shape(name: str, item, scale: float) -> list[str]:
    if bool(item.shift.any()) or bool(item.tilt.any()):
        raise ValueError(f"{name} is shifted or tilted, which is not written")
    coefficients = item.coefficients.tolist()
    lines = [f"  TYPE {'EVENASPH' if coefficients else 'STANDARD'}"]
    lines += [f"  CURV {float(item.curvature.detach()) / scale!r}"]
    lines += [f"  CONI {float(item.conic.detach())!r}"] if float(item.conic.detach()) else []
    return lines + [f"  PARM {i} {value * scale ** (1 - 2 * i)!r}" for i, value in enumerate(coefficients, start=1)]


def _limit(radius: float) -> list[str]:
    return [f"  CLAP 0 {radius!r} 0", f"  DIAM {radius!r} 1 0 0 1"]


def _surface(number: int, item, scale: float, stop: bool, system) -> list[str]:
    shape = _shape(f"surfaces[{number - 1}]", item, scale)
    if item.material is None:
        raise ValueError(f"surfaces[{number - 1}] is followed by an index, not by a glass with a name")
    lines = [f"SURF {number}", *(["  STOP"] if stop else []), *shape]
    lines += [f"  DISZ {float(item.thickness.detach()) * scale!r}"]
    if item.material != AIR:
        name = "MIRROR" if item.material == MIRROR else item.material.name.replace(" ", "_")
        lines += [f"  GLAS {name} 0 0 1.5 40 0 0 0 0 0 0" if name == "MIRROR" else f"  GLAS {name} 0 0"]
    if item.semi_diameter is not None:
        lines += _limit(item.semi_diameter * scale)
    elif stop and system.aperture_type == "stop":
        lines += [f"  DIAM {system.aperture * scale / 2!r} 1 0 0 1"]
    return lines
