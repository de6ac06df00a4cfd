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


# Twice the size lets a few thousandths of a decibel wrap around.
PADDING = 8


def angular_spectrum_intensity(phase, wavelength, pitch, distance, aperture=None):
    """Propagate a phase pattern with nothing but NumPy: zero padding without wrap, exact transfer function."""
    rows, columns = phase.shape
    field = np.zeros((PADDING * rows, PADDING * columns), complex)
    inner = np.s_[:rows, :columns]
    field[inner] = np.exp(1j * phase)
    fy, fx = (np.fft.fftfreq(n, pitch) for n in field.shape)
    fy, fx = fy[:, None], fx[None, :]
    kernel = np.exp(2j * np.pi * distance * np.sqrt(1 / wavelength**2 - fx**2 - fy**2))
    if aperture is not None:
        kernel = kernel * aperture(fy, fx)
    return np.abs(np.fft.ifft2(np.fft.fft2(field) * kernel)[inner]) ** 2
