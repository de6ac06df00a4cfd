"""Compare colour conversions with the package colour-science: ``python benchmarks/peers/colour_science.py``.

Prints a Markdown table of the largest differences over random colours, in float64.
"""

import warnings

import numpy as np
import torch

from odak.learn import perception

warnings.simplefilter("ignore")
import colour  # noqa: E402

D65, D50 = (0.3127, 0.3290), (0.3457, 0.3585)
COLOURS = np.random.default_rng(0).uniform(0.02, 1, (200, 3))


def main() -> None:
    """Print the table."""
    whites = [colour.xy_to_XYZ(xy) for xy in (D65, D50)]
    lab, luv = colour.XYZ_to_Lab(COLOURS, D50), colour.XYZ_to_Luv(COLOURS, D50)

    def ours(function, values, *arguments, **options):
        pictures = torch.from_numpy(values.T.copy()).reshape(1, 3, 1, -1)
        return getattr(perception, function)(pictures, *arguments, **options)[0, :, 0].T.numpy()

    def adaptation(name):
        matrix = colour.adaptation.matrix_chromatic_adaptation_VonKries(*whites, transform=name)
        return COLOURS @ matrix.T

    tasks = {
        "XYZ to L\\*a\\*b\\*, D50": (ours("xyz_to_lab", COLOURS, whites[1]), lab),
        "L\\*a\\*b\\* to XYZ, D50": (ours("lab_to_xyz", lab, whites[1]), colour.Lab_to_XYZ(lab, D50)),
        "XYZ to L\\*u\\*v\\*, D50": (ours("xyz_to_luv", COLOURS, whites[1]), luv),
        "L\\*u\\*v\\* to XYZ, D50": (ours("luv_to_xyz", luv, whites[1]), colour.Luv_to_XYZ(luv, D50)),
        "D65 to D50, Bradford": (ours("adapt_chromatically", COLOURS, *whites), adaptation("Bradford")),
        "D65 to D50, CAT16": (ours("adapt_chromatically", COLOURS, *whites, cones="CAT16"), adaptation("CAT16")),
        "XYZ to Oklab": (ours("xyz_to_oklab", COLOURS), colour.XYZ_to_Oklab(COLOURS)),
        "Oklab to XYZ": (ours("oklab_to_xyz", COLOURS), colour.Oklab_to_XYZ(COLOURS)),
        "RGB to ICtCp": (ours("rgb_to_ictcp", 1000 * COLOURS), colour.RGB_to_ICtCp(1000 * COLOURS)),
    }
    pale = np.array([0.9504, 1, 1.0888]) * COLOURS
    for name, model in (("CAM02", "CIECAM02"), ("CAM16", "CAM16")):
        average = getattr(colour, f"VIEWING_CONDITIONS_{model}")["Average"]
        seen = getattr(colour, f"XYZ_to_{model}")(100 * pale, 100 * whites[0], 64 / np.pi * 0.2, 20, average)
        wanted = getattr(colour, f"JMh_{model}_to_{name}UCS")(np.stack([seen.J, seen.M, seen.h], -1))
        found = ours("convert_color", pale, "XYZ", f"{name}-UCS", white=whites[0])
        tasks[f"XYZ to {name}-UCS"] = (found, wanted)
    tasks["XYZ to Jzazbz"] = (ours("convert_color", pale, "XYZ", "Jzazbz"), colour.XYZ_to_Jzazbz(100 * pale))
    first, second = (torch.from_numpy(one.T.copy()).reshape(1, 3, 1, -1) for one in (lab, luv))
    for formula, method, options in (
        ("CIE 1994", "CIE 1994", {}),
        ("CIE 1994 textiles", "CIE 1994", {"textiles": True}),
        ("CMC 2:1", "CMC", {}),
        ("CIEDE2000", "CIE 2000", {}),
    ):
        found = perception.color_difference(first, second, formula).flatten().numpy()
        tasks[f"difference by {formula}"] = (found, colour.delta_E(lab, luv, method, **options))
    print(f"| conversion | largest difference from colour-science {colour.__version__} |\n|---|---|")
    for name, (found, expected) in tasks.items():
        print(f"| {name} | {np.abs(found - expected).max():.0e} |")


if __name__ == "__main__":
    main()
