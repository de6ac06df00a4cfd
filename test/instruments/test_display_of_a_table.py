"""What a display of a calibration claims is what a camera on its table sees, with gaps and a response that varies."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch
from laboratory import Laboratory, without_defocus
from scipy.ndimage import gaussian_filter
from tables import instruments_of

from odak import AccuracyWarning, instruments
from odak.instruments import phase_response
from odak.learn.wave import Display, Run, optimise

PITCH = 8e-6


def table_with_gaps(shape, distance):
    """Return a table whose gaps, a tenth of the area, reflect, and whose response varies by 5 %."""
    y, x = ((np.arange(n) - n // 2) / (n / 2) for n in shape)
    y = y[:, None]
    beam = np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 2.5)
    return Laboratory(
        shape, PITCH, distance, camera_shape=tuple(int(2.1 * n) for n in shape), camera_pitch=5e-6, fill=0.9, gaps=1.0,
        phases=2 * np.pi * 1.02 * (np.arange(256) / 255) ** 1.1, amplitude=beam / beam.max(),
        factors=1 + 0.05 * (x - 0.6 * y + 0.5 * x * y), wavefront=without_defocus(x**3 - y * x + 0.5 * x**2),
    )  # fmt: skip


def seen_between_pixels(table, levels, shift=(0.0, 0.0)):
    """Return what a camera of the panel's pitch sees, displaced by parts of a pixel (x, y)."""
    shape = table.modulator.shape
    known = {"fill": table.fill, "gaps": table.gaps, "wavefront": table.wavefront, "camera_pitch": PITCH}
    there = Laboratory(
        shape, PITCH, table.distance, camera_shape=shape, **known, amplitude=abs(table.illumination),
        offset=PITCH * np.array(shift),
    )  # fmt: skip
    table.modulator.show(levels)
    there.field = table.field
    return there.light(0, 0, *shape)


@pytest.mark.parametrize("samples", [9, pytest.param(24, marks=pytest.mark.slow)])
@pytest.mark.parametrize("focal_length", [None, 15e-3])
def test_unmodulated_light_is_that_of_the_gaps(samples, focal_length):
    """A tenth of the area, of phase 0; with a laser that drifts by a tenth during the measurement."""
    options = {"camera_shape": (200, 220), "camera_pitch": 4e-6, "fill": 0.9, "gaps": 1.0, "bits": 12}
    table = Laboratory((64, 72), PITCH, 8e-3, **options, focal_length=focal_length)
    show, modulator = table.modulator.show, table.modulator

    def drifting(levels):
        table.power *= 1 + 0.05 / samples
        show(levels)

    modulator.show = drifting
    path = table.distance if focal_length is None else instruments.Lens(focal_length)
    known = instruments.OpticalTable(modulator, table.camera, table.wavelength, path, table.phases)
    assert instruments.measure_unmodulated_light(known, samples=samples) == pytest.approx(1 / 9, abs=0.012)


def test_a_display_has_the_gaps_and_the_regional_response_of_its_table():
    table = table_with_gaps((60, 72), 8e-3)
    modulator, camera = instruments_of(table)
    tables = table.factors[10::20, 12::24, None] * table.phases
    known = replace(
        instruments.Calibration.nominal(modulator, camera, table.wavelength, table.distance),
        phases=table.phases, amplitude=abs(table.illumination), wavefront=table.wavefront, regional_phases=tables,
        unmodulated=1 / 9,
    )  # fmt: skip
    display = Display.from_calibration(known, iris=None)
    assert np.abs(known.response_factors() - table.factors).max() < 1e-3
    wanted = torch.from_numpy(30 * gaussian_filter(np.random.default_rng(1).normal(size=(60, 72)), 3) % (2 * np.pi))
    levels = display.modulator.levels(wanted)
    phases = phase_response.phases_of_levels(levels.numpy(), known.response)
    assert np.abs(display.modulator.phases_of(levels, torch.float64).numpy() - phases).max() < 1e-9
    best = phase_response.nearest_levels(wanted.numpy(), known.response)
    apart = [abs(np.angle(np.exp(1j * (phase_response.phases_of_levels(n, known.response) - wanted.numpy()))))
             for n in (levels.numpy(), best)]  # fmt: skip
    assert np.allclose(*apart)
    seen, claimed = seen_between_pixels(table, levels.numpy()), display(wanted)[0, 0].numpy()
    inside = np.s_[4:-4, 4:-4]

    def missed(picture):
        picture, light = picture[inside], seen[inside]
        return np.sqrt(np.mean((light * (light * picture).sum() / (light**2).sum() - picture) ** 2)) / picture.std()

    dark = Display.from_calibration(replace(known, unmodulated=0.0), iris=None)
    assert missed(claimed) < 0.02 < 0.1 < missed(dark(wanted)[0, 0].numpy())


@pytest.mark.slow
def test_what_a_display_claims_is_what_its_table_shows_within_a_decibel():
    table = table_with_gaps((96, 112), 10e-3)
    with warnings.catch_warnings():
        # Regions, and an image as small as this.
        warnings.simplefilter("ignore", AccuracyWarning)
        found = instruments.calibrate_table(*instruments_of(table), table.wavelength, 1.01 * table.distance)
    target = gaussian_filter(np.random.default_rng(0).random((96, 112)), 3)
    target = (target - target.min()) / np.ptp(target)
    hologram = optimise(
        Display.from_calibration(found, iris=None), torch.from_numpy(target).float(), run=Run(60, progress=False)
    )
    levels, ratios, inside = hologram.levels()[0].numpy(), [], np.s_[2:-3, 2:-3]
    for down, across in np.ndindex(4, 4):
        rows = (1 - down / 4) * target + down / 4 * np.roll(target, -1, 0)
        wanted = ((1 - across / 4) * rows + across / 4 * np.roll(rows, -1, 1))[inside]
        light = seen_between_pixels(table, levels, (across / 4, down / 4))[inside]
        ratios.append(-10 * np.log10(np.mean((light * (light * wanted).sum() / (light**2).sum() - wanted) ** 2)))
    assert min(ratios) == pytest.approx(hologram.psnr.item(), abs=1.0)
