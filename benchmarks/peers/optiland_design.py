"""Optimise a lens with optiland, from a start in JSON to a result in JSON. Requires only optiland."""

import json
import sys
import time
import warnings

import numpy as np

warnings.simplefilter("ignore")
from optiland.materials import AbbeMaterial  # noqa: E402
from optiland.optic import Optic  # noqa: E402
from optiland.optimization import LeastSquares, OptimizationProblem  # noqa: E402

STEPS = 60


def main() -> None:
    """Read the start, run the least squares of optiland, print the end."""
    given = json.load(sys.stdin)
    lens, count = Optic(), len(given["radius"])
    lens.surfaces.add(index=0, thickness=np.inf)
    for i in range(count):
        glass = given["glass"][i]
        lens.surfaces.add(
            index=i + 1,
            radius=given["radius"][i],
            thickness=given["thickness"][i],
            material="air" if glass is None else AbbeMaterial(*glass),
            is_stop=i == given["stop"],
        )
    lens.surfaces.add(index=count + 1)
    lens.set_aperture(aperture_type="EPD", value=given["aperture"])
    lens.fields.set_type(field_type="angle")
    for angle in given["fields"]:
        lens.fields.add(y=angle)
    for k, wavelength in enumerate(given["wavelengths"]):
        lens.wavelengths.add(value=1000 * wavelength, is_primary=k == 1)
    problem = OptimizationProblem()
    for angle in given["fields"]:
        spot = {"optic": lens, "surface_number": -1, "Hx": 0, "Hy": angle / max(given["fields"]), "num_rays": 3}
        spot |= {"wavelength": "all", "distribution": "hexapolar"}
        problem.add_operand(operand_type="rms_spot_size", target=0, weight=1, input_data=spot)
    problem.add_operand(operand_type="f2", target=50.0, weight=1, input_data={"optic": lens})
    for i in range(count):
        if i != given["stop"]:
            problem.add_variable(lens, "radius", surface_number=i + 1)
        problem.add_variable(lens, "thickness", surface_number=i + 1, min_val=given["low"][i], max_val=given["high"][i])
    begun, used = time.perf_counter(), time.process_time()
    LeastSquares(problem).optimize(maxiter=STEPS)
    wall, cpu = time.perf_counter() - begun, time.process_time() - used
    surfaces = [lens.surfaces[i + 1] for i in range(count)]
    radius = [float(item.geometry.radius) for item in surfaces]
    thickness = [float(np.squeeze(lens.surfaces.get_thickness(i + 1))) for i in range(count)]
    print(json.dumps({"wall": wall, "cpu": cpu, "radius": radius, "thickness": thickness}))


if __name__ == "__main__":
    main()
