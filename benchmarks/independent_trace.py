"""Spots, distortion and edges of a lens by rays traced in NumPy, without the library."""

import math

import numpy as np


def judged(lens: dict, indices, angles, rings: int = 10, flanges: bool = False) -> dict:
    """Return focal length, f-number, spots, distortion, least thicknesses, chief ray angle and count of lost rays.

    Parameters
    ----------
    lens : dict
        A lens as its JSON file has it: spheres and even aspheres about an axis, an object at infinity, the diameter of
        the entrance pupil as its aperture.
    indices : array
        Refractive indices ``[W, S + 1]`` in front of the first surface and behind each.
    angles : sequence of float
        Field angles in degrees.
    rings : int
        Rings of rays, each of them turned against the next.
    flanges : bool
        Whether a surface is a plane beyond its own beam, as that of a moulded lens is.

    Notes
    -----
    Rays aim at the paraxial entrance pupil. Each surface is intersected by Newton's method and refracts by Snell's law
    in its vector form (Welford, Aberrations of Optical Systems, 1986, section 4.3).
    """
    rows = [
        (1 / s["radius"] if s.get("radius") else 0.0, s.get("conic", 0.0), s.get("coefficients", []), s["thickness"])
        for s in lens["surfaces"]
    ]
    stop = next((i for i, s in enumerate(lens["surfaces"]) if s.get("stop")), 0)
    indices, aperture = np.asarray(indices, dtype=float), lens["aperture"]
    middle = lens["reference"]
    # A ray at a millionth of the aperture gives the first order, the pupil is found from the stop backwards.
    tiny, steepest = 1e-6, 0.0
    y, u, n = tiny, 0.0, 1.0
    for i, (c, _, a, t) in enumerate(rows):
        c = c + (2 * a[0] if a else 0.0)
        m = indices[middle, i + 1]
        u, n = (n * u - (m - n) * c * y) / m, m
        y = y + t * u
    focal = -tiny / u
    y, u = 0.0, tiny
    for i in range(stop - 1, -1, -1):
        c, _, a, t = rows[i]
        y = y - t * u
        n, m = indices[middle, i + 1], indices[middle, i]
        u = (n * u + (n - m) * (c + (2 * a[0] if a else 0.0)) * y) / m
    pupil = 0.0 if stop == 0 or u == 0 else -y / u
    points = [(0.0, 0.0)] + [
        (k / rings * math.cos(p + 0.37 * k), k / rings * math.sin(p + 0.37 * k))
        for k in range(1, rings + 1)
        for p in np.arange(6 * k) * math.pi / (3 * k)
    ]
    points = np.array(points) * aperture / 2
    sizes, bent, lost, edges = [], [], 0, [math.inf] * len(rows)
    reach = np.zeros(len(rows))
    scale = math.nan
    # The image height of a tiny field is what distortion is counted from.
    for angle in (1e-3, *angles):
        found, chief = [], 0.0
        for w in range(len(indices)):
            tangent = math.tan(math.radians(angle))
            direction = np.array([0.0, tangent, 1.0]) / math.hypot(tangent, 1.0)
            p = np.stack([points[:, 0], points[:, 1] - pupil * tangent, 0 * points[:, 0]], -1)
            d = np.tile(direction, (len(p), 1))
            for i, (c, k, a, t) in enumerate(rows):
                p = p + ((0.0 - p[:, 2]) / d[:, 2])[:, None] * d
                for _ in range(60):
                    before = p[:, 2].copy()
                    r2 = p[:, 0] ** 2 + p[:, 1] ** 2
                    height, slope = _sag(r2, c, k, a)
                    gap = height - p[:, 2]
                    p = p + (gap / (d[:, 2] - 2 * slope * (p[:, 0] * d[:, 0] + p[:, 1] * d[:, 1])))[:, None] * d
                    if np.array_equal(p[:, 2], before, equal_nan=True):
                        break
                reach[i] = max(reach[i], np.sqrt(np.nanmax(p[:, 0] ** 2 + p[:, 1] ** 2)))
                r2 = p[:, 0] ** 2 + p[:, 1] ** 2
                _, slope = _sag(r2, c, k, a)
                normal = np.stack([-2 * slope * p[:, 0], -2 * slope * p[:, 1], np.ones(len(p))], -1)
                normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
                mu = indices[w, i] / indices[w, i + 1]
                cosine = (d * normal).sum(-1)
                with np.errstate(invalid="ignore"):
                    root = np.sqrt(1 - mu**2 * (1 - cosine**2))
                d = mu * d + (root - mu * cosine)[:, None] * normal
                p = p - np.array([0.0, 0.0, t])
            p = p - (p[:, 2] / d[:, 2])[:, None] * d
            lost += int((~np.isfinite(p).all(-1)).sum())
            found.append(p[:, :2])
            if w == middle:
                chief = p[0, 1]
                steepest = max(steepest, math.degrees(math.acos(min(d[0, 2], 1.0))))
        both = np.concatenate(found)
        if math.isnan(scale):
            scale = chief / math.tan(math.radians(angle))
            continue
        sizes.append(float(np.sqrt(((both - both.mean(0)) ** 2).sum(-1).mean())))
        bent.append(abs(chief / (scale * math.tan(math.radians(angle))) - 1) if angle else 0.0)
    for i in range(len(rows) - 1):
        if i == stop and i == 0:
            continue
        for share in np.linspace(0, 1, 21):
            radius = share * max(reach[i], reach[i + 1])
            here, there = (
                float(_sag(np.array([(min(radius, reach[j]) if flanges else radius) ** 2]), *rows[j][:3])[0][0])
                for j in (i, i + 1)
            )
            edges[i] = min(edges[i], rows[i][3] + there - here)
    return {
        "focal_length": focal,
        "f_number": focal / aperture,
        "sizes": sizes,
        "rms": max(sizes),
        "mean_rms": float(np.mean(sizes)),
        "sum_of_squares": float(np.square(sizes).sum()),
        "distortion": max(bent),
        "edge": min(edges),
        "centre": min(row[3] for row in rows),
        "chief_ray_angle": steepest,
        "lost": lost,
    }


def _sag(r2, c, k, a):
    """Return the height of an even asphere and its derivative by r²."""
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1 - (1 + k) * c * c * r2)
    height, slope = c * r2 / (1 + root), c / (2 * root)
    for j, value in enumerate(a):
        height, slope = height + value * r2 ** (j + 1), slope + (j + 1) * value * r2**j
    return height, slope
