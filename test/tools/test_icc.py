import struct

import numpy as np
import pytest
from PIL import ImageCms

from odak.tools.icc import _curve, _decoded, profile_of


def fixed(*values):
    return struct.pack(f">{len(values)}i", *(round(65536 * value) for value in values))


def test_the_profile_of_srgb_has_its_primaries_and_its_curve():
    content = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    profile = profile_of(content)
    # ICC's own profile of sRGB: colorants under D50, to the digits of the file.
    np.testing.assert_allclose(profile.to_xyz[:, 0], [0.4360, 0.2225, 0.0139], atol=1e-4)
    np.testing.assert_allclose(profile.to_xyz.sum(1), [0.9642, 1.0, 0.8249], atol=1e-3)
    levels = np.linspace(0, 1, 64).reshape(1, 8, 8).repeat(3, 0)
    light = np.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(profile.light(levels)[1], light[0], atol=1e-3)


@pytest.mark.parametrize(
    ("tag", "wanted"),
    [
        (b"curv" + bytes(4) + struct.pack(">I", 0), lambda x: x),
        (b"curv" + bytes(4) + struct.pack(">IH", 1, 512), lambda x: x**2),
        (
            b"curv" + bytes(4) + struct.pack(">I3H", 3, 0, 16384, 65535),
            lambda x: np.interp(x, [0, 0.5, 1], [0, 0.25, 1]),
        ),
        (b"para" + bytes(4) + struct.pack(">HH", 0, 0) + fixed(2.5), lambda x: x**2.5),
        (
            b"para" + bytes(4) + struct.pack(">HH", 1, 0) + fixed(2, 1.25, -0.25),
            lambda x: np.where(x >= 0.2, (1.25 * x - 0.25) ** 2, 0),
        ),
        (
            b"para" + bytes(4) + struct.pack(">HH", 2, 0) + fixed(2, 0.75, -0.25, 0.125),
            lambda x: np.where(x >= 1 / 3, (0.75 * x - 0.25) ** 2 + 0.125, 0.125),
        ),
        (
            b"para" + bytes(4) + struct.pack(">HH", 4, 0) + fixed(2, 0.75, 0.125, 0.5, 0.25, 0.0625, 0.03125),
            lambda x: np.where(x >= 0.25, (0.75 * x + 0.125) ** 2 + 0.0625, 0.5 * x + 0.03125),
        ),
    ],
)
def test_curves_of_all_kinds(tag, wanted):
    levels = np.linspace(0, 1, 101)
    np.testing.assert_allclose(_decoded(_curve(tag), levels), wanted(levels), atol=1e-4)


def test_broken_profiles_are_refused_and_tables_are_none():
    with pytest.raises(ValueError, match="colour profile in the file cannot be used"):
        profile_of(b"no profile")
    assert profile_of(ImageCms.ImageCmsProfile(ImageCms.createProfile("LAB")).tobytes()) is None
    with pytest.raises(ValueError, match="a curve has the type"):
        _curve(b"text" + bytes(20))
    with pytest.raises(ValueError, match="a curve has the kind 7"):
        _curve(b"para" + bytes(4) + struct.pack(">HH", 7, 0))
