"""The same lens in another unit: figures without a unit are equal, lengths are so many times as large."""

import pytest
import torch

from odak.learn.raytracing.system import (
    best_focus,
    field_modulation,
    field_quality,
    first_order,
    lateral_color,
    load_system,
    relative_illumination,
    seidel_sums,
    spot_diagram,
    strehl_ratio,
    system_from_dict,
    system_to_dict,
    through_focus_modulation,
    wavefront,
)

# Micrometres and metres in millimetres.
UNITS = {"um": 1e3, "m": 1e-3}


def in_unit(lens, unit):
    """Return a lens of millimetres with a distant object in another unit."""
    scale, given = UNITS[unit], system_to_dict(lens)
    given["unit"], given["aperture"] = unit, given["aperture"] * scale
    given["wavelengths"] = [value * scale for value in given["wavelengths"]]
    for item in given["surfaces"]:
        for name in {"radius", "thickness", "semi_diameter"} & set(item):
            item[name] = item[name] if item[name] is None else item[name] * scale
        if "coefficients" in item:
            item["coefficients"] = [value * scale ** (-1 - 2 * i) for i, value in enumerate(item["coefficients"])]
    return system_from_dict(given)


def figures(lens, scale):
    """Return figures without unit, and lengths in millimetres."""
    found, quality = first_order(lens), field_quality(lens, "real")
    yield "first order", [found.f_number, found.working_f_number, found.numerical_aperture, found.magnification]
    yield "lengths", [found.focal_length / scale, found.exit_pupil_distance / scale, best_focus(lens) / scale]
    yield "Seidel sums", [seidel_sums(lens).seidel / scale, *(v / scale for v in seidel_sums(lens).transverse.values())]
    yield "wavefront", wavefront(lens, "rings", 4, aim="real").rms
    yield "spots", spot_diagram(lens, "rings", 4, aim="real").rms / scale
    yield "quality", [quality.strehl, quality.wavefront_rms, quality.passed, quality.rms_spot / scale]
    yield "Strehl ratio", strehl_ratio(lens, "gauss", 32)
    yield "modulation", field_modulation(lens, [30.0 / scale], aim="real")
    yield "through focus", through_focus_modulation(lens, [-0.05 * scale, 0.05 * scale], 30.0 / scale)
    yield "illumination", relative_illumination(lens, 8, aim="real")
    yield "colour", lateral_color(lens) / scale


@pytest.mark.slow
@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["cooke_triplet", "phone_f2"])
def test_figures_do_not_depend_on_the_unit(name, unit):
    lens = load_system(name)
    scaled = in_unit(lens, unit)
    for (figure, expected), (_, found) in zip(figures(lens, 1.0), figures(scaled, UNITS[unit]), strict=True):
        for a, b in zip(expected, found, strict=True):
            scale = float(a.detach().abs().nan_to_num().max())
            torch.testing.assert_close(b, a, rtol=1e-8, atol=1e-9 * scale, equal_nan=True, msg=f"{figure}: {b} and {a}")
