"""What must work once odak is installed: every module imports, a beam propagates, the command line makes a hologram.

    python packaging/smoke.py     # with the Python of the environment that odak is installed in

Run from a folder without the sources, so that it is the installed package that counts.
"""

import importlib
import json
import pkgutil
import subprocess
import sys
import tempfile
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import torch

import odak
from odak.learn.wave import propagate_beam

# They run inside Blender, on its bpy.
INSIDE_BLENDER = "odak.visualize.blender.libblend"
WAVELENGTH, PITCH, DISTANCE = 532e-9, 8e-6, 5e-3


def import_everything() -> int:
    """Import every module of the package and resolve every public name; return how many modules there are."""
    modules = [module.name for module in pkgutil.walk_packages(odak.__path__, "odak.")]
    modules = [name for name in modules if name not in (INSIDE_BLENDER, "odak.__main__")]
    for name in modules:
        module = importlib.import_module(name)
        for public in getattr(module, "__all__", ()):
            getattr(module, public)
    return len(modules)


def propagate() -> float:
    """Return the share of the power of a Gaussian beam that propagation keeps."""
    x = torch.linspace(-1, 1, 128, dtype=torch.float64)
    field = torch.exp(-8 * (x[:, None] ** 2 + x**2)).to(torch.complex128)
    k = odak.wave.wavenumber(WAVELENGTH)
    out = propagate_beam(field, k, DISTANCE, PITCH, WAVELENGTH, propagation_type="Angular Spectrum")
    return (out.abs().square().sum() / field.abs().square().sum()).item()


def hologram(command: Path) -> float:
    """Return the PSNR in dB of the hologram that the command line computes."""
    subprocess.run([command, "--help"], check=True, stdout=subprocess.DEVNULL)
    with tempfile.TemporaryDirectory() as folder:
        size = ["--resolution", "64", "96", "--distance", "3e-3", "--iterations", "30", "--device", "cpu"]
        run = [command, "hologram", "photo", "--grey", "--output", folder, *size]
        subprocess.run([*run, "--quiet"], check=True)
        return json.loads((Path(folder) / "report.json").read_text(encoding="utf-8"))["psnr_db"]


def examples(command: Path) -> int:
    """Return how many scripts of the gallery the command line lists, one of which is copied and read."""
    listed = subprocess.run([command, "examples"], check=True, capture_output=True, text=True).stdout.splitlines()
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([command, "examples", "talbot_carpet", "--output", folder], check=True, capture_output=True)
        compile((Path(folder) / "talbot_carpet.py").read_text(encoding="utf-8"), "talbot_carpet.py", "exec")
    return len(listed)


def main() -> None:
    """Check the installation that runs this."""
    installed = Path(odak.__file__).parent
    assert installed.is_relative_to(sys.prefix), f"{installed} is not the installed package"
    assert distribution("odak-optics").version == odak.__version__
    assert (installed / "py.typed").is_file()
    modules = import_everything()
    kept = propagate()
    assert np.isclose(kept, 1.0, atol=1e-6), kept
    psnr = hologram(Path(sys.executable).with_name("odak"))
    assert psnr > 15, psnr
    scripts = examples(Path(sys.executable).with_name("odak"))
    assert scripts > 50, scripts
    counted = f"{modules} modules, {scripts} examples"
    print(f"odak {odak.__version__}: {counted}, power kept {kept:.9f}, hologram {psnr:.1f} dB")


if __name__ == "__main__":
    main()
