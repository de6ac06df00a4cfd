"""`odak info`: what odak runs on."""

import platform

import torch

from odak.cli.report import device_name, versions


def describe() -> list[tuple[str, str]]:
    """Return versions, devices, threads and FFT libraries as pairs of name and value."""
    rows = list(versions().items())
    rows.append(("platform", platform.platform()))
    rows.append(("devices", ", ".join(device_name(device) for device in devices())))
    rows.append(("threads", str(torch.get_num_threads())))
    rows.append(("fft", fft_backends()))
    return rows


def devices() -> list[torch.device]:
    """Return the devices that torch can compute on here."""
    found = [torch.device("cpu")]
    found += [torch.device("cuda", index) for index in range(torch.cuda.device_count())]
    if torch.backends.mps.is_available():
        found.append(torch.device("mps"))
    return found


def fft_backends() -> str:
    """Return the libraries behind torch's FFT on this machine's devices, and NumPy's."""
    cpu = "MKL" if torch.backends.mkl.is_available() else "PocketFFT"
    gpu = f", torch on CUDA: cuFFT (CUDA {torch.version.cuda})" if torch.cuda.is_available() else ""
    return f"torch on CPU: {cpu}{gpu}, NumPy: PocketFFT"
