"""Benchmarks of automatic designs from flat plates, with limits verified by independent rays, and one against optiland.

The judge is :func:`independent_trace.judged`.
"""

import importlib.util
import json
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from independent_trace import judged

from odak.catalog import model_glass
from odak.learn.raytracing.system import (
    Solve,
    Variable,
    automatic_design,
    lens_design,
    optical_system,
    surface,
    system_to_dict,
)

LOW, HIGH = model_glass(1.5445, 55.99), model_glass(1.6613, 20.37)
TASKS = {
    "triplet 50 mm f/2.8, 40 degrees": {
        "design": {
            "elements": ["N-LAK33B", "stop", "SF5", "N-LAK33B"],
            "focal_length": 50.0,
            "f_number": 2.8,
            "half_field": 20.0,
            "glass": (1.5, 9.0),
            "air": (0.3, 15.0),
            "edge": 0.6,
            "back": 20.0,
            "track": 80.0,
            "makers": ["schott", "ohara"],
            "axial_color": 0.1,
            "aspheric_terms": 2,
            "starts": 12,
            "iterations": 12,
            "polish": 1,
        },
        "limits": {"rms": 10e-3, "distortion": 0.02, "minutes": 4.0},
    },
    "three aspheres 4.55 mm f/4, 50 degrees": {
        "design": {
            "elements": ["stop", LOW, HIGH, LOW],
            "focal_length": 4.55,
            "f_number": 4.0,
            "half_field": 25.0,
            "aspheric_terms": 3,
            "glass": (0.25, 1.0),
            "air": (0.05, 1.0),
            "edge": 0.05,
            "back": 0.4,
            "track": 7.0,
            "starts": 3,
            "iterations": 6,
            "polish": 0,
        },
        "limits": {"rms": 8e-3, "distortion": 0.02, "minutes": 3.0},
    },
    "six aspheres 4.55 mm f/2, 80 degrees": {
        "design": {
            "elements": ["stop", LOW, HIGH, LOW, HIGH, LOW, LOW],
            "focal_length": 4.55,
            "f_number": 2.0,
            "half_field": 40.0,
            "aspheric_terms": 6,
            "glass": (0.25, 0.9),
            "air": (0.05, 0.8),
            "edge": 0.08,
            "back": 0.5,
            "track": 7.0,
            "distortion": 0.045,
            "cover": ("N-BK7", 0.21),
            "seed": 2,
        },
        "limits": {"rms": 12e-3, "distortion": 0.05, "minutes": 15.0},
    },
}
# Angles from the axis to the largest one at which a design is judged.
FIELDS = 33
# Glasses (n_d, V_d), radii and thicknesses that both optimisers begin with.
START = {
    "radius": [60.0, -400.0, math.inf, -50.0, 50.0, 400.0, -60.0],
    "thickness": [4.0, 5.0, 1.0, 1.5, 5.0, 4.0, 50.0],
    "glass": [(1.755, 52.3), None, None, (1.6727, 32.2), None, (1.755, 52.3), None],
    "low": [1.5, 0.3, 0.3, 1.5, 0.3, 1.5, 20.0],
    "high": [9.0, 15.0, 15.0, 9.0, 15.0, 9.0, 70.0],
    "stop": 2,
    "aperture": 12.5,
    "fields": [0.0, 10.0, 14.0],
    "wavelengths": [486.1327e-6, 587.5618e-6, 656.2725e-6],
}


def _plain(system) -> tuple:
    """Return a system as plain numbers: its file and its indices."""
    return system_to_dict(system), system.prescription().index.detach().numpy()


def automatic(device: str) -> Iterator[dict]:
    """Yield the time of each automatic design against its limit; raise if the lens does not meet the requirements."""
    for name, task in TASKS.items():
        asked, limits = task["design"], task["limits"]
        start = time.perf_counter()
        system = automatic_design(**asked).system
        taken = time.perf_counter() - start
        found = judged(*_plain(system), np.linspace(0, asked["half_field"], FIELDS))
        assert abs(found["focal_length"] / asked["focal_length"] - 1) < 1e-3, found
        assert abs(found["f_number"] / asked["f_number"] - 1) < 1e-3, found
        assert found["rms"] <= limits["rms"] and found["distortion"] <= limits["distortion"], found
        assert found["edge"] > 0 and found["centre"] > 0 and found["lost"] == 0, found
        task = f"{name}: {1000 * found['rms']:.1f} um, {100 * found['distortion']:.1f} %"
        yield {
            "task": task,
            "ours_s": taken,
            "floor_s": 60 * limits["minutes"],
            "floor": "the limit",
            "ratio": taken / (60 * limits["minutes"]),
            "bound": 1.0,
            **found,
        }


def start_system(numbers: dict):
    """Return the lens that both optimisers begin with."""
    rows = []
    for i, (radius, thickness, glass) in enumerate(
        zip(numbers["radius"], numbers["thickness"], numbers["glass"], strict=True)
    ):
        material = "air" if glass is None else model_glass(*glass)
        curvature = 0.0 if math.isinf(radius) else 1 / radius
        rows.append(surface(curvature=curvature, thickness=thickness, material=material, stop=i == numbers["stop"]))
    return optical_system(rows, numbers["aperture"], fields=numbers["fields"], wavelengths=numbers["wavelengths"])


def beside_optiland(device: str) -> Iterator[dict]:
    """Yield the run from a poor start beside optiland's, with the sums of the squares of the spots that both reach.

    OPTILAND_PYTHON names a Python that has optiland; without one, the row compares ours with itself.
    """
    system = start_system(START)
    bent = [i for i in range(1, 7) if i != START["stop"]]
    variables = [
        Variable("curvature", bent),
        *(Variable("thickness", i, START["low"][i], START["high"][i]) for i in range(6)),
        Variable("thickness", 6, -5.0, 5.0),
    ]
    solves = [Solve("focal_length", 0, 50.0), Solve("marginal_height", 6)]
    begun, used = time.perf_counter(), time.process_time()
    lens_design(system, ["spot"], variables, solves=solves, count=3).optimise(60)
    ours, cpu = time.perf_counter() - begun, time.process_time() - used
    merit = judged(*_plain(system), START["fields"])["sum_of_squares"]
    python = os.environ.get("OPTILAND_PYTHON", sys.executable if importlib.util.find_spec("optiland") else None)
    if python is None:
        yield {"task": f"poor start: sum of squares {merit:.1e}", "ours_s": ours, "floor_s": ours} | {
            "floor": "itself, no optiland",
            "ratio": 1.0,
            "bound": None,
        }
        return
    script = Path(__file__).parent / "peers" / "optiland_design.py"
    given = json.dumps(START)
    found = subprocess.run([python, str(script)], input=given, capture_output=True, text=True, check=True)
    theirs = json.loads(found.stdout.splitlines()[-1])
    other = start_system(START | {"radius": theirs["radius"], "thickness": theirs["thickness"]})
    reached = judged(*_plain(other), START["fields"])["sum_of_squares"]
    assert merit < reached, (merit, reached)
    yield {
        "task": f"poor start: sum of squares {merit:.1e}, theirs {reached:.1e}",
        "ours_s": cpu,
        "floor_s": theirs["cpu"],
        "floor": "optiland, processor time",
        "ratio": cpu / theirs["cpu"],
        "bound": 1.0,
        "wall_s": ours,
        "theirs_wall_s": theirs["wall"],
    }


ALL = (automatic, beside_optiland)
