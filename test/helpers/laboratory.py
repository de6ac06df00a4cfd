"""An optical table from the physics alone, of any size: nothing here comes from the package.

Each pixel of the panel is a square that sends a spherical wave within the envelope of its diffraction, sinc of the
direction's sines (Goodman, Introduction to Fourier Optics, eq. 4-28). Only pixels of the camera that are read are
computed, by products of matrices, because the path √(d² + x² + y²) is that of rows and that of columns up to a small
product of the two, which is expanded. All orders of diffraction are there, and nothing wraps around.

With a `focal_length`, a lens stands at that distance from panel and camera: the light is the Fourier sum of the pixels
within the same envelope (eq. 5-20), with the light of the gaps around them, which has phase 0.
"""

import numpy as np

WELL = 20_000.0
# Bytes of waves that are kept, of the regions that a camera reads.
MOST_KEPT = 100_000_000
# Rows or columns of images whose pixels are averaged over their area, at most.
FINE = 300


class Laboratory:
    """Panel and camera behind it, without a lens or at its two focal planes, with the members of the protocols.

    `gaps` is the amplitude of the light of gaps, of phase 0: 1 behind a lens and 0 without one by default. `factors`
    are those of the phases of pixels. `offset` (x, y in metres) and `signs` place and mirror the camera; `wavefront`
    and `amplitude` are maps or numbers; `phases` are those of the levels. An intensity of 1 is that of the illumination
    on the panel.
    """

    def __init__(
        self, shape=(1080, 1920), pitch=8e-6, distance=0.1, wavelength=532e-9, camera_shape=(1200, 1920),
        camera_pitch=5e-6, bits=12, fill=1.0, phases=None, wavefront=0.0, amplitude=1.0, offset=(0.0, 0.0),
        signs=(1, 1), seed=0, terms=2, focal_length=None, gaps=None, factors=1.0,
    ):  # fmt: skip
        self.wavelength, self.distance, self.fill, self.terms = wavelength, distance, fill, terms
        self.focal_length, self.factors = focal_length, factors
        # Amplitude of the light of gaps.
        self.gaps = float(focal_length is not None) if gaps is None else gaps
        self.phases = 2 * np.pi * np.arange(256) / 256 if phases is None else phases
        self.wavefront = wavefront
        self.illumination = np.broadcast_to(amplitude * np.exp(1j * np.asarray(wavefront)), shape)
        self.offset, self.signs, self.noise = np.asarray(offset), signs, np.random.default_rng(seed)
        self.modulator, self.camera = Panel(self, shape, pitch), Camera(self, camera_shape, camera_pitch, bits)
        self.field, self.waves, self.power = self.illumination.astype(np.complex64), {}, 1.0
        # Standard deviations from frame to frame of phases and light as shares, and of the image in pixels; and drifts
        # in 100 captures of the light as a share, and of the image in pixels.
        self.flicker, self.wander, self.vibration, self.unsteady = 0.0, 0.0, 0.0, np.random.default_rng([seed, 1])
        self.dimming = self.sliding = 0.0
        # Ambient light that is switched on after so many captures.
        self.lamp, self.dark_captures = 0.0, 0

    def errors(self, found):
        """Return the errors of a calibration of a table whose wavefront has no tilt and no defocus.

        Phases in rad, registration in pixels (largest of the middle 70 %), wavefront in rad without tilt and defocus
        (root mean square), distance as a share, amplitude as a share of the largest (root mean square).
        """
        points = np.random.default_rng(0).uniform(-0.35, 0.35, (200, 2)) * self.modulator.shape[::-1]
        seen = found.registration.camera_pixels(points * self.modulator.pitch)
        missed = np.stack([self.points(seen[:, 0], 1), self.points(seen[:, 1], 0)], axis=-1)
        missed = np.linalg.norm(missed - points * self.modulator.pitch, axis=-1)
        true = np.abs(self.illumination)
        return {
            "phases": np.abs(found.phases - self.phases).max(),
            "registration": missed.max() / self.camera.pitch,
            "wavefront": without_defocus(found.wavefront - self.wavefront).std(),
            "distance": found.distance / self.distance - 1,
            "amplitude": np.sqrt(((found.amplitude - true / true.max()) ** 2).mean()),
        }

    def points(self, pixels, axis):
        """Return x (axis 1) or y (axis 0) in metres of columns or rows of the camera."""
        middle = self.camera.shape[axis] / 2
        return self.signs[1 - axis] * (pixels - middle) * self.camera.pitch + self.offset[1 - axis]

    def spherical(self, first, count, axis, whole=False):
        """Return the waves ``[term, pixels of the camera, pixels of the panel]`` along an axis.

        `whole` is for squares without gaps.
        """
        key = (first, count, axis, whole)
        if key not in self.waves:
            panel, p, d = self.modulator.shape[axis], self.modulator.pitch, self.distance
            # A pixel of the camera averages over its area: two points along each axis, but one of large images.
            offsets = np.array([-1, 1]) / np.sqrt(12) if count <= FINE else np.zeros(1)
            places = self.points(np.add.outer(np.arange(first, first + count), offsets).ravel(), axis)
            width = p * np.sqrt(1.0 if whole else self.fill)
            at = (np.arange(panel) - panel // 2) * p
            if self.focal_length is not None:
                sines = places[:, None] / (self.wavelength * self.focal_length)
                wave = np.sinc(width * sines) * width / np.sqrt(self.wavelength * self.focal_length)
                return (wave * np.exp(-2j * np.pi * sines * at)).astype(np.complex64)[None]
            away = places[:, None] - at
            path = np.hypot(d, away)
            wave = np.sinc(width * away / (self.wavelength * path)) * width / np.sqrt(self.wavelength * d)
            wave = wave * np.exp(2j * np.pi * np.remainder((path - d) / self.wavelength, 1))
            if sum(kept.nbytes for kept in self.waves.values()) > MOST_KEPT:
                self.waves.clear()
            # (x² + y²)²/8d³ has a part 2x²y² that rows and columns alone have not.
            self.waves[key] = np.stack([(wave * (away / d) ** (2 * k)).astype(np.complex64) for k in range(self.terms)])
        return self.waves[key]

    def light(self, row, column, rows, columns):
        """Return the intensity at pixels of the camera."""
        down, across = self.spherical(row, rows, 0), self.spherical(column, columns, 1)
        seen, factor = 0, 1.0
        for k, (left, right) in enumerate(zip(down, across, strict=True)):
            if k:
                factor *= -2j * np.pi / self.wavelength * self.distance / 4 / k
            # The narrow side first.
            product = left @ self.field @ right.T if rows <= columns else left @ (self.field @ right.T)
            seen = seen + np.complex64(factor) * product
        if self.gaps and self.fill < 1:
            for sign, whole in ((self.gaps, True), (-self.gaps, False)):
                down, across = (self.spherical(*line, whole)[0] for line in ((row, rows, 0), (column, columns, 1)))
                seen = seen + sign * (down @ self.illumination.astype(np.complex64) @ across.T)
        finely = (rows, len(seen) // rows, columns, seen.shape[1] // columns)
        return self.power * (seen.real**2 + seen.imag**2).reshape(finely).mean((1, 3))


def without_defocus(surface):
    """Return a surface without its mean, its tilts and its defocus."""
    y, x = ((np.arange(n) - n // 2) / n for n in surface.shape)
    y = y[:, None] * surface.shape[0] / surface.shape[1]
    system = np.stack(np.broadcast_arrays(1.0, x, y, x**2 + y**2), axis=-1).reshape(-1, 4)
    found = np.linalg.solve(system.T @ system, system.T @ surface.ravel())
    return surface - (system @ found).reshape(surface.shape)


def full_panel(bits, focal_length=None):
    """Return a table with a panel of 1080 x 1920 pixels, whose camera is mirrored and displaced.

    The aberration is about one wavelength from peak to valley, and the beam is off the axis. Behind a lens the camera
    sees 2.7 mm x 3 mm about the axis.
    """
    y, x = ((np.arange(n) - n // 2) / 960 for n in (1080, 1920))
    y = y[:, None]
    beam = np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 1.5)
    return Laboratory(
        pitch=3.74e-6, distance=0.15, camera_shape=(680, 1180) if focal_length is None else (420, 460),
        camera_pitch=6.5e-6, bits=bits, focal_length=focal_length,
        wavefront=without_defocus(np.pi * (x**3 - 0.5 * x * y**2 + 0.8 * x * y + 0.5 * (x**2 - y**2))),
        amplitude=beam / beam.max(), offset=(8e-5, -5e-5), signs=(-1, 1), terms=1,
    )  # fmt: skip


def table_of(shape, pitch, distance, bits, camera_pitch=5e-6):
    """Return a table without a lens of a size and a distance, whose camera sees a quarter more than the panel."""
    y, x = ((np.arange(n) - n // 2) / (max(shape) / 2) for n in shape)
    y = y[:, None]
    beam = np.exp(-((x - 0.1) ** 2 + (y + 0.05) ** 2) / 1.5)
    return Laboratory(
        shape, pitch, distance, camera_shape=tuple(int(1.25 * n * pitch / camera_pitch) for n in shape),
        camera_pitch=camera_pitch, bits=bits, amplitude=beam / beam.max(), offset=(8e-5, -5e-5), signs=(-1, 1),
        wavefront=without_defocus(np.pi * (x**3 - 0.5 * x * y**2 + 0.8 * x * y + 0.5 * (x**2 - y**2))),
    )  # fmt: skip


def random_table(seed):
    """Return a small table whose size, faults and noise a seed draws, and its nominal distance, off by up to 2 %."""
    draw = np.random.default_rng([seed, 77])
    rows, columns = (int(n) for n in draw.integers(56, 84, 2))
    y, x = ((np.arange(n) - n // 2) / (max(rows, columns) / 2) for n in (rows, columns))
    y = y[:, None]
    high = [x * (x**2 + y**2), y * (x**2 + y**2), x**4 - y**4, x * x * y * y]
    terms = [x * y, x**2 - y**2, x**3 + 0 * y, y**3 + 0 * x, *high]
    surface = without_defocus(sum(w * term for w, term in zip(draw.normal(size=len(terms)), terms, strict=True)))
    surface *= 2 * np.pi * draw.uniform(0.03, 0.3) / surface.std()
    level = np.arange(256) / 255
    turns, gamma, ripple = draw.uniform(0.97, 1.15), draw.uniform(0.8, 1.3), draw.uniform(-0.1, 0.1)
    phases = 2 * np.pi * turns * (level**gamma + ripple * np.sin(2 * np.pi * level) / np.pi)
    middle = draw.uniform(-0.2, 0.2, 2)
    beam = np.exp(-((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / draw.uniform(1, 3))
    distance, bits = draw.uniform(7e-3, 11e-3), int(draw.choice([8, 10, 12]))
    side = int(max(rows, columns) * 2.9)
    table = Laboratory(
        (rows, columns), 8e-6, distance, camera_shape=(side, side + 8), camera_pitch=4e-6, bits=bits,
        fill=draw.uniform(0.85, 1), phases=phases, wavefront=surface, amplitude=beam / beam.max(),
        offset=draw.uniform(-2.5e-5, 2.5e-5, 2), signs=tuple(int(s) for s in draw.choice([-1, 1], 2)), seed=seed,
    )  # fmt: skip
    return table, distance * (1 + draw.uniform(-0.02, 0.02))


class Panel:
    bits = 8

    def __init__(self, table, shape, pitch):
        self.table, self.shape, self.pitch, self.settling_time, self.shown = table, shape, pitch, 0.0, 0

    def show(self, levels):
        self.shown += 1
        self.now = np.asarray(self.table.phases)[levels] * self.table.factors
        self.send(1.0)

    def send(self, factor):
        """Let the pixels show their phases times a factor."""
        self.table.field = (self.table.illumination * np.exp(1j * factor * self.now)).astype(np.complex64)


class Camera:
    def __init__(self, table, shape, pitch, bits):
        self.table, self.shape, self.pitch, self.bits = table, shape, pitch, bits
        self.exposure, self.region, self.taken = 1e-3, None, 0

    def capture(self, count=1):
        row, column, rows, columns = self.region or (0, 0, *self.shape)
        table = self.table
        unsteady = (table.flicker, table.wander, table.vibration, table.dimming, table.sliding)
        if count > 1 and any(unsteady):
            return np.concatenate([self.capture(1) for _ in range(count)])
        self.taken += count
        if table.flicker:
            table.modulator.send(1 + table.flicker * table.unsteady.normal())
        offset, power, passed = table.offset, table.power, self.taken / 100
        if any(unsteady):
            moved = table.vibration * table.unsteady.normal(size=2) + table.sliding * passed
            table.power = power * (1 + table.wander * table.unsteady.normal() - table.dimming * passed)
            if table.vibration or table.sliding:
                table.offset = offset + self.pitch * moved
                table.waves.clear()
        lamp = table.lamp * (self.taken > table.dark_captures)
        electrons = (table.light(row, column, rows, columns) + lamp) * self.exposure * 1e4
        table.offset, table.power = offset, power
        electrons = np.minimum(electrons, 10 * WELL)
        noise = self.table.noise.standard_normal((count, *electrons.shape), dtype=np.float32)
        # Shot noise, and read noise of 3 electrons on an offset of 30.
        read = electrons + 30 + np.sqrt(electrons + 9) * noise
        top = (1 << self.bits) - 1
        return np.rint(np.clip(read / WELL, 0, 1) * top).astype(np.uint16)


class Altered:
    """Camera whose captures are altered by a function of the frames and the camera."""

    def __init__(self, camera, change, **members):
        self.__dict__.update(camera=camera, change=change, **members)

    def __getattr__(self, name):
        return getattr(self.camera, name)

    def __setattr__(self, name, value):
        setattr(self.camera, name, value)

    def capture(self, count=1):
        return self.change(self.camera.capture(count), self.camera)
