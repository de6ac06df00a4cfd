"""`odak hologram` as the tests run it, and what its files hold."""

import json

import numpy as np
from physics import filtered, free_space_transfer
from PIL import Image
from typer.testing import CliRunner

from odak.cli import app

ROWS, COLUMNS = 64, 96
SMALL = ["--resolution", str(ROWS), str(COLUMNS), "--distance", "3e-3", "--iterations", "5", "--device", "cpu"]


def run(*arguments, expect=0):
    result = CliRunner().invoke(app, ["hologram", *map(str, arguments)])
    assert result.exit_code == expect, result.output + repr(result.exception)
    return result


def read_report(folder):
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def angular_spectrum_intensity(phase, wavelength, pitch, distance, aperture=None):
    """Propagate a phase pattern with NumPy only: exact transfer function, extrapolated to zero wrap-around.

    `pitch` is a number, or a pair (rows, columns). What wraps around falls with the square of the padding, and so does
    the error of a stop whose edge, weighted by a half, lies on a frequency of both grids.
    """

    def propagated(padding):
        shape = tuple(padding * n for n in phase.shape)
        transfer = free_space_transfer(shape, distance, pitch, wavelength)
        if aperture is not None:
            frequencies = (np.fft.fftfreq(n, step) for n, step in zip(shape, np.ones(2) * pitch, strict=True))
            transfer = transfer * aperture(*np.meshgrid(*frequencies, indexing="ij"))
        return filtered(np.exp(1j * phase), transfer)

    return np.abs((4 * propagated(16) - propagated(8)) / 3) ** 2
