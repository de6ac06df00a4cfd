"""`odak hologram` as the tests run it, and what its files hold."""

import json

import numpy as np
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
        rows, columns = phase.shape
        field = np.zeros((padding * rows, padding * columns), complex)
        field[:rows, :columns] = np.exp(1j * phase)
        frequencies = (np.fft.fftfreq(n, step) for n, step in zip(field.shape, np.ones(2) * pitch, strict=True))
        fy, fx = np.meshgrid(*frequencies, indexing="ij")
        kernel = np.exp(2j * np.pi * distance * np.sqrt(1 / wavelength**2 - fx**2 - fy**2))
        kernel = kernel if aperture is None else kernel * aperture(fy, fx)
        return np.fft.ifft2(np.fft.fft2(field) * kernel)[:rows, :columns]

    return np.abs((4 * propagated(16) - propagated(8)) / 3) ** 2
