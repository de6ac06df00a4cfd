"""`odak hologram` as the tests run it, and what its files hold."""

import functools
import json

import numpy as np
import typer
from physics import confined, filtered, free_space_transfer, unwrapped_propagation
from PIL import Image
from typer.testing import CliRunner

from odak.cli import app

ROWS, COLUMNS = 64, 96
# Stored values are taken as light, so that targets are the pictures of the tests.
SMALL = ["--linear", "--resolution", str(ROWS), str(COLUMNS), "--distance", "3e-3"]
SMALL += ["--iterations", "5", "--device", "cpu"]


# It would make the commands anew from their annotations each time.
typer.testing._get_command = functools.cache(typer.main.get_command)


def invoke(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


def run(*arguments, expect=0):
    result = invoke("hologram", *arguments)
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
        if aperture is None:
            return unwrapped_propagation(np.exp(1j * phase), distance, pitch, wavelength, padding=padding)
        shape = tuple(padding * n for n in phase.shape)
        frequencies = (np.fft.fftfreq(n, step) for n, step in zip(shape, np.ones(2) * pitch, strict=True))
        transfer = free_space_transfer(shape, distance, pitch, wavelength)
        transfer = transfer * aperture(*np.meshgrid(*frequencies, indexing="ij"))
        return filtered(np.exp(1j * phase), confined(transfer, phase.shape))

    return np.abs((4 * propagated(16) - propagated(8)) / 3) ** 2
