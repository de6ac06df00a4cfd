"""Non-sequential light through a lens: this library against optiland, bin by bin.

Both trace a point source of 10 degrees through the same biconvex lens, with all reflections between its faces, onto a
screen. The interpreter of an environment with optiland is an argument: ``python benchmarks/nonsequential.py
path/to/python``. Without it, only this library traces.
"""

import json
import subprocess
import sys
import time

import numpy as np

RAYS, RADIUS, THICKNESS, INDEX, PLACE, REACH = 1_000_000, 50.0, 8.0, 1.6, 50.0, 15.0
SCREEN, SIDE, BINS, HALF_ANGLE = 120.0, 40.0, 40, 10.0

OPTILAND = """
import json, sys, time
from unittest.mock import MagicMock
# Drawing in three dimensions, which is not used here, needs a package of its own.
for name in ("vtk", "vtk.util", "vtk.util.numpy_support"):
    sys.modules.setdefault(name, MagicMock())
from optiland.coordinate_system import CoordinateSystem as Place
from optiland.materials import IdealMaterial
from optiland.nonsequential import (
    IrradianceDetectorConfig, LensConfig, NSQScene, PointSourceConfig, Spectrum
)
from optiland.nonsequential.materials import NSQMaterial
g = json.loads(sys.argv[1])
scene = NSQScene()
light = PointSourceConfig(Spectrum.monochromatic(0.55), 1.0, half_angle_deg=g["half_angle"])
scene.add_source("source", Place(), light)
glass = NSQMaterial(IdealMaterial(n=g["index"]))
lens = LensConfig(g["radius"], -g["radius"], g["thickness"], glass, g["reach"])
scene.add_lens("lens", Place(z=g["place"]), lens)
screen = IrradianceDetectorConfig(g["side"], g["side"], g["bins"], g["bins"], splat="hard")
scene.add_detector("screen", Place(z=g["screen"]), screen)
begin = time.perf_counter()
found = scene.trace(num_rays=g["rays"], seed=1, max_depth=40).detectors["screen"]
seconds = time.perf_counter() - begin
area = (g["side"] / g["bins"]) ** 2
print(json.dumps([(found.irradiance * area).tolist(), seconds]))
"""


def ours(split: bool) -> tuple[np.ndarray, float]:
    """Return the power in each bin of the screen, and seconds, of this library: all ways followed, or one drawn."""
    from odak.learn.raytracing import Conic, Element, Interface, Plane, RayScene, light_source

    faces = [
        Element(Conic(1 / RADIUS), (1.0, INDEX), center=(0, 0, PLACE), aperture=REACH),
        Element(Conic(-1 / RADIUS), (INDEX, 1.0), center=(0, 0, PLACE + THICKNESS), aperture=REACH),
    ]
    screen = Element(Plane(), interface=Interface(0, 0), center=(0, 0, SCREEN), detects=True, name="screen")
    light = light_source("point", RAYS, half_angle=HALF_ANGLE)
    begin = time.perf_counter()
    found = RayScene([*faces, screen]).trace(light, 550e-6, split=split)
    seconds = time.perf_counter() - begin
    held = found.received["screen"]
    # Whole rays to bins, as the other program counts them; `irradiance` shares each among the four bins about it.
    edges = np.linspace(-SIDE / 2, SIDE / 2, BINS + 1)
    bins, *_ = np.histogram2d(*held.point[:, [1, 0]].T.numpy(), bins=(edges, edges), weights=held.power.numpy())
    return bins, seconds


def theirs(interpreter: str) -> tuple[np.ndarray, float]:
    """Return the same of optiland in an environment of its own."""
    given = {
        "half_angle": HALF_ANGLE, "index": INDEX, "radius": RADIUS, "thickness": THICKNESS, "reach": REACH,
        "place": PLACE, "side": SIDE, "bins": BINS, "screen": SCREEN, "rays": RAYS,
    }  # fmt: skip
    run = subprocess.run(
        [interpreter, "-c", OPTILAND, json.dumps(given)], check=True, capture_output=True, text=True, timeout=600
    )
    bins, seconds = json.loads(run.stdout.strip().splitlines()[-1])
    return np.array(bins), seconds


def main() -> None:
    """Print power on the screen, times, and by how much bins differ in units of the noise of a million rays."""
    power, seconds = ours(True)
    print(f"odak, all ways   {power.sum():.5f} of the light in {seconds:.1f} s")
    drawn, seconds = ours(False)
    print(f"odak, ways drawn {drawn.sum():.5f} of the light in {seconds:.1f} s")
    if len(sys.argv) > 1:
        other, seconds = theirs(sys.argv[1])
        print(f"optiland         {other.sum():.5f} of the light in {seconds:.1f} s")
        bright = power * RAYS > 50
        expected = power[bright] * RAYS
        squares = (other[bright] * RAYS - expected) ** 2 / expected
        noise = (power.sum() * (1 - power.sum()) / RAYS) ** 0.5
        print(f"power differs by {(other.sum() - power.sum()) / noise:+.1f} standard deviations")
        print(f"mean square of {bright.sum()} bins: {squares.mean():.2f} of their variance")


if __name__ == "__main__":
    main()
