"""Tests of cameras and modulators of any maker: whether a driver does what its protocol says, with a remedy if not."""

import gc
import re
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from odak import _show, _validate
from odak.instruments.protocols import Camera, CheckedCamera, SLMDriver

# Share of the range that the brightest pixel gets, and the one from which a pixel is lit.
BRIGHT, LIT = 0.6, 0.3
# Shares of that exposure at which counts are compared, and captures that are averaged for each.
SHARES, AVERAGED = (1.0, 0.7, 0.45, 0.25), 6
# Deviations of exposures and counts, as shares, and of the exponent of a gamma curve, that are faults.
EXPOSURE, EXPONENT = 0.04, 0.08
# Captures among which older frames are looked for.
SEVERAL = 6
# Share of an older image that is a fault.
OLDER = 0.1
# Parts of the second half of the captures, by which buffers are full, whose growth of memory is compared.
PARTS = 5
# Growth of the memory for each capture, in frames, and in bytes for each part: what Python allocates, the process.
LEAK, LEAST_LEAK = 0.5, (1 << 16, 1 << 20)


@dataclass(frozen=True)
class Finding(_show.Shown):
    """What a test of an instrument found.

    Attributes
    ----------
    check : str
        What was tested.
    passed : bool or None
        Whether it is as it should be; None if it was not tested.
    found : str
        What was found.
    remedy : str
        What to do, empty if nothing is to be done.

    Examples
    --------
    >>> from odak.instruments import Finding
    >>> Finding("gamma", False, "counts grow as the power 0.45 of the exposure", "switch off the gamma curve").passed
    False
    """

    check: str
    passed: bool | None
    found: str
    remedy: str = ""


def check_instruments(
    camera: Camera | None = None, modulator: SLMDriver | None = None, *, captures: int = 1000
) -> list[Finding]:
    """Test whether a camera and a modulator do what their protocols say.

    Counts and frames of a camera, its exposure, late and frozen frames, its bit depth, its region and many captures are
    tested with any steady light; whether captures follow the patterns of a modulator, and after which time, with both.

    Parameters
    ----------
    camera : Camera, optional
        The camera, which sees steady light that it can saturate. Its exposure and region are restored.
    modulator : SLMDriver, optional
        The modulator; with a camera, the one whose light the camera sees.
    captures : int
        Number of captures in a row, among which frozen frames and growing memory are looked for.

    Returns
    -------
    list of Finding
        What was tested, in this order. What depends on a test that failed is not tested: its `passed` is None.

    Raises
    ------
    ValueError
        If neither is given, or `captures` is not positive.

    Examples
    --------
    >>> from odak.instruments import SimulatedTable, check_instruments
    >>> table = SimulatedTable(seed=1, shape=(32, 32), distance=4e-3, camera_shape=(48, 56))
    >>> found = check_instruments(table.camera, table.modulator, captures=20)
    >>> [finding.check for finding in found if finding.passed is False]
    []
    """
    if camera is None and modulator is None:
        raise ValueError("camera or modulator must be given, got None for both")
    captures = _validate.integer("captures", captures, minimum=2)
    found: list[Finding] = []
    if modulator is not None:
        _run(found, {"levels": (_levels, "")}, modulator)
    if camera is not None:
        if modulator is not None and found[0].passed:
            draw = np.random.default_rng(0)
            modulator.show(draw.integers(1 << modulator.bits, size=tuple(modulator.shape)))
        before, region = camera.exposure, camera.region
        bench = _Bench(camera, modulator if found and found[0].passed else None, captures)
        try:
            _run(found, CAMERA, bench)
        finally:
            camera.exposure, camera.region = before, region
    return found


def _run(found: list[Finding], checks: dict[str, tuple[Callable[[Any], Finding | None], str]], bench: Any) -> None:
    """Add the findings of checks, of those whose requirement passed."""
    for name, (check, needed) in checks.items():
        passed = {finding.check: finding.passed for finding in found}
        missing = [other for other in needed.split() if not passed.get(other)]
        if missing:
            found.append(Finding(name, None, f"not tested, for it needs {missing[0]}"))
            continue
        try:
            finding = check(bench)
        except Exception as error:
            # Drivers raise anything, and what they raise is what was to be found.
            finding = Finding(name, False, f"{type(error).__name__}: {error}", "correct what the error says")
        if finding is not None:
            found.append(finding)


def _levels(modulator: SLMDriver) -> Finding:
    """Return whether a modulator has its members, takes levels, waits, and refuses what is none."""
    if not isinstance(modulator, SLMDriver):
        missing = [name for name in ("shape", "pitch", "bits", "settling_time", "show") if not hasattr(modulator, name)]
        return Finding("levels", False, f"the modulator has no {', '.join(missing)}", "add what the protocol names")
    rows, columns = modulator.shape
    top = (1 << modulator.bits) - 1
    for levels in (np.zeros((rows, columns), int), np.add.outer(np.arange(rows), np.arange(columns)) % 2 * top):
        modulator.show(levels)
    for wrong, text in ((np.zeros((rows + 1, columns), int), "another shape"), (levels + 1, f"levels above {top}")):
        try:
            modulator.show(wrong)
        except (TypeError, ValueError):
            continue
        return Finding("levels", False, f"show takes {text}", "refuse them by a ValueError: they wrap around silently")
    modulator.show(levels)
    return Finding("levels", True, f"0 to {top} on {rows} x {columns} pixels")


class _Bench:
    """A camera under test, and the modulator whose light it sees."""

    def __init__(self, camera: Any, modulator: SLMDriver | None, captures: int):
        self.camera, self.modulator, self.captures = camera, modulator, captures
        self.checked: Any = None
        self.exposure = 0.0
        self.lit = np.zeros(0, bool)

    def mean(self, count: int = AVERAGED) -> np.ndarray:
        return self.checked.capture(count).astype(float).mean(0)

    def settled(self, share: float) -> float:
        """Set a share of the exposure, let older frames pass, and return what the camera says that it took."""
        seconds = self.checked.expose(share * self.exposure)
        self.checked.capture(SEVERAL)
        return seconds


def _frames(bench: _Bench) -> Finding:
    """Return whether captures have the shape, the type and the range that the camera states."""
    camera = bench.camera
    missing = [
        name for name in ("shape", "pitch", "bits", "exposure", "region", "capture") if not hasattr(camera, name)
    ]
    if missing:
        return Finding("frames", False, f"the camera has no {', '.join(missing)}", "add what the protocol names")
    camera.region = None
    bench.checked = CheckedCamera(camera)
    for count in (1, 3):
        frames = np.asarray(camera.capture(count))
        if frames.shape[:1] != (count,) or frames.ndim < 3:
            return Finding(
                "frames", False, f"capture({count}) returns {list(frames.shape)}",
                f"return [{count}, rows, columns]",
            )  # fmt: skip
        bench.checked.capture(count)
    # What is shifted or too large shows in bright light.
    limit, last = float(bench.checked.top), np.inf
    for _ in range(24):
        # The last of several, of a camera whose frames come late.
        brightest = float(bench.checked.capture(SEVERAL)[-1].max())
        # What does not grow with the exposure is at its end, wherever that is.
        limit = brightest if 0.2 * limit < brightest <= 1.02 * last and last < np.inf else limit
        if 0.4 * limit <= brightest <= 0.8 * limit:
            break
        factor = 0.4 if brightest > BRIGHT * limit else float(np.clip(BRIGHT * limit / max(brightest, 1), 1.2, 4))
        last = brightest if factor > 1 else np.inf
        before = camera.exposure
        if abs(bench.checked.expose(before * factor) / before - 1) < 1e-3:
            break
    bench.exposure = camera.exposure
    frame = bench.mean()
    if frame.max() < 1.05 * np.median(frame) + 2:
        return Finding(
            "frames", False, f"all pixels have about {np.median(frame):.0f} counts at {bench.exposure:.3g} s",
            "let the camera see light",
        )  # fmt: skip
    floor = float(np.quantile(frame, 0.02))
    bench.lit = frame > floor + LIT * (frame.max() - floor)
    return Finding("frames", True, f"{list(frame.shape)}, {frames.dtype}, up to {frame.max():.0f} counts")


def _late(bench: _Bench) -> Finding:
    """Return whether the first frames after a change of the exposure are older than it."""
    light = []
    for share in (1.0, 0.4):
        bench.checked.expose(share * bench.exposure)
        frames = bench.checked.capture(1), *(bench.checked.capture(1) for _ in range(2 * SEVERAL))
        light.append([float(frame[0][bench.lit].mean()) for frame in frames])
    before, after = light[0][-1], np.array(light[1])
    if abs(before - after[-1]) < OLDER * before:
        return Finding("late frames", None, "not tested, for the counts do not follow the exposure")
    older = np.flatnonzero(abs(after - after[-1]) > 0.5 * abs(before - after[-1]))
    if len(older):
        return Finding(
            "late frames", False, f"{older[-1] + 1} frames after a change are older than it",
            f"discard {older[-1] + 1} frames before each capture, empty the camera's buffer, or use a trigger",
        )  # fmt: skip
    return Finding("late frames", True, "the first frame after a change shows it")


def _exposures(bench: _Bench) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return exposures asked for and reported in seconds, and the light of lit pixels over that of the others."""
    asked, taken, light = np.array(SHARES) * bench.exposure, [], []
    dim = ~bench.lit
    for share in SHARES:
        taken.append(bench.settled(share))
        frame = bench.mean()
        light.append(frame[bench.lit].mean() - (frame[dim].mean() if dim.any() else 0.0))
    bench.checked.exposure = bench.exposure
    return asked, np.array(taken), np.array(light)


def _exposure(bench: _Bench) -> Finding:
    """Return whether the camera takes the exposures that it reports: counts follow them, by a power at least."""
    _, taken, light = _exposures(bench)
    if np.ptp(light) < 0.2 * light.max():
        return Finding(
            "exposure", False, f"counts change by {np.ptp(light) / light.max():.0%} where exposures change fourfold",
            "switch off automatic exposure and gain; check that the setting reaches the camera",
        )  # fmt: skip
    if not (np.diff(taken) < 0).all():
        return Finding(
            "exposure", False, f"exposures reported are {_listed(taken)} s where shares {_listed(SHARES)} were set",
            "report what the camera takes, read from it, not what was asked for",
        )  # fmt: skip
    _, missed = _power(taken, light)
    if missed > EXPOSURE:
        return Finding(
            "exposure", False, f"counts deviate by {missed:.0%} from powers of the reported {_listed(taken)} s",
            "report the exposure that the camera takes, read from it: it has limits and steps of its own",
        )  # fmt: skip
    return Finding("exposure", True, f"counts follow {_listed(taken)} s to {missed:.1%}")


def _gamma(bench: _Bench) -> Finding:
    """Return whether counts are proportional to the exposure."""
    _, taken, light = _exposures(bench)
    power, _ = _power(taken, light)
    if abs(power - 1) > EXPONENT:
        return Finding(
            "gamma", False, f"counts grow as the power {power:.2f} of the exposure",
            "switch off the gamma curve and automatic gain, or use raw frames",
        )  # fmt: skip
    return Finding("gamma", True, f"counts grow as the power {power:.2f} of the exposure")


def _power(taken: np.ndarray, light: np.ndarray) -> tuple[float, float]:
    """Return the power of the exposures with which light grows, and its largest deviation from it as a share."""
    line = np.polynomial.Polynomial.fit(np.log(taken), np.log(np.maximum(light, 1e-9)), 1).convert()
    return float(line.coef[1]), float(np.abs(np.log(np.maximum(light, 1e-9)) - line(np.log(taken))).max())


def _listed(values: Any) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _depth(bench: _Bench) -> Finding:
    """Return whether counts reach the top of the range that the bits state, and no further."""
    camera, top, seen = bench.checked, bench.checked.top, 0.0
    for _ in range(10):
        before, brightest = camera.exposure, float(camera.capture(1).max())
        if brightest >= top or abs(camera.expose(3 * before) / before - 1) < 1e-3:
            break
        camera.capture(SEVERAL)
        if seen and brightest <= 1.02 * seen and float(camera.capture(1).max()) <= 1.02 * brightest:
            bits = int(brightest).bit_length()
            return Finding(
                "bit depth", False, f"counts end at {brightest:.0f}, and {camera.bits} bits are stated, up to {top}",
                f"set camera.bits to {bits}" + ("" if brightest == (1 << bits) - 1 else ", or scale the counts"),
            )  # fmt: skip
        seen = brightest
    camera.exposure = bench.exposure
    camera.capture(SEVERAL)
    frame = camera.capture(4)
    used, distinct = int(np.bitwise_or.reduce(frame.astype(np.int64), axis=None)), len(np.unique(frame))
    missing = (used & -used).bit_length() - 1
    if missing > 0 and distinct > 8:
        return Finding(
            "bit depth", False, f"all counts are multiples of {1 << missing}",
            f"return frames >> {missing}, with camera.bits {camera.bits - missing}: the data are shifted",
        )  # fmt: skip
    return Finding("bit depth", True, f"{camera.bits} bits, {distinct} different counts")


def _region(bench: _Bench) -> Finding:
    """Return whether a region shows the rows and columns that it names."""
    camera = bench.camera
    rows, columns = camera.shape
    row, column, high, wide = rows // 4, columns // 3, rows // 2, columns // 4
    camera.region = None
    whole, again = (gaussian_filter(bench.mean(), 1) for _ in range(2))
    camera.region = (row, column, high, wide)
    raw = np.asarray(camera.capture(2))
    size = list(raw.shape[1:3])
    if size not in ([high, wide], [rows, columns]):
        camera.region = None
        hint = "rows and columns are exchanged" if size == [wide, high] else "another part is read"
        return Finding("region", False, f"a region of [{high}, {wide}] gives frames of {size}", f"{hint}: correct it")
    part = gaussian_filter(bench.mean(), 1)
    camera.region = None

    window = np.s_[row : row + high, column : column + wide]
    here, best = (float(np.corrcoef(whole[window].ravel(), seen.ravel())[0, 1]) for seen in (part, again[window]))
    if here < 0.8 * best:
        return Finding(
            "region", False, f"the region at row {row}, column {column} shows another part of the whole frame",
            "region is first row, first column, rows, columns: correct the order and the offset",
        )  # fmt: skip
    return Finding("region", True, f"correlation with that part of the whole frame {here:.3f}")


def _orientation(bench: _Bench) -> Finding | None:
    """Return whether frames have the rows and columns of the sensor, which are told apart where they differ."""
    rows, columns = bench.camera.shape
    frames = np.asarray(bench.camera.capture(1))
    if rows != columns and list(frames.shape[1:3]) == [columns, rows]:
        return Finding(
            "orientation", False, f"frames are {[columns, rows]}, the sensor {[rows, columns]}", "transpose the frames"
        )
    return Finding("orientation", True, f"rows and columns as in camera.shape, {[rows, columns]}")


def _patterns(bench: _Bench) -> Finding | None:
    """Return whether captures follow the patterns of a modulator, and how soon."""
    modulator, camera = bench.modulator, bench.checked
    if modulator is None:
        return None
    draw = np.random.default_rng(0)
    patterns = draw.integers(1 << modulator.bits, size=(2, *modulator.shape))
    camera.exposure = bench.exposure
    before = modulator.settling_time
    settled, firsts, seconds = [], [], []
    try:
        for pattern in patterns[[0, 1, 0, 1]]:
            modulator.settling_time = before
            start = time.monotonic()
            modulator.show(pattern)
            seconds.append(time.monotonic() - start)
            firsts.append(camera.capture(1)[0].astype(float))
            # The same again, for as long as nothing can be on its way.
            modulator.settling_time = max(4 * before, 0.2)
            modulator.show(pattern)
            settled.append(bench.mean(SEVERAL))
    finally:
        modulator.settling_time = before
    change = settled[1] - settled[0]
    size = float((change**2).sum())
    noise = float(((settled[2] - settled[0]) ** 2).sum() + ((settled[3] - settled[1]) ** 2).sum()) / 2
    if size < 4 * noise:
        return Finding(
            "patterns", False, "captures of two patterns differ by no more than captures of one",
            "let the camera see the light of the modulator; check that patterns reach the panel that is lit",
        )  # fmt: skip
    # Share of the pattern before in each first capture.
    shares = [
        float(((frame - now) * (then - now)).sum() / ((then - now) ** 2).sum())
        for frame, now, then in zip(firsts[1:], settled[1:], settled[:-1], strict=True)
    ]
    if max(shares) > OLDER:
        return Finding(
            "patterns", False, f"{max(shares):.0%} of the pattern before are in the capture after show returns",
            f"set a longer settling_time of the modulator, now {before:g} s",
        )  # fmt: skip
    return Finding("patterns", True, f"captures follow patterns; show takes {1e3 * float(np.mean(seconds)):.0f} ms")


def _many(bench: _Bench) -> Finding:
    """Return whether captures in a row are new frames, of the same light, and do not fill the memory."""
    camera, last, same = bench.checked, None, 0
    camera.exposure = bench.exposure
    camera.capture(SEVERAL)
    marks = np.unique((np.linspace(0.5, 1, PARTS + 1) * bench.captures).astype(int)).tolist()
    memory: list[tuple[float, float]] = []
    taken = []
    with ExitStack() as counting:
        for number in range(1, bench.captures + 1):
            start = time.monotonic()
            frame = camera.capture(1)[0]
            taken.append(time.monotonic() - start)
            # Noise makes frames differ.
            same += last is not None and np.array_equal(frame, last)
            last = frame
            if number == marks[0]:
                counting.enter_context(_counted())
            if number in marks:
                memory.append(_memory())
    if same:
        return Finding(
            "captures", False, f"{same} of {bench.captures} frames repeat the one before bit by bit",
            "wait for a new frame, or trigger each; a frozen camera must raise an error",
        )  # fmt: skip
    counts = np.diff(marks)[:, None]
    grown = np.diff(memory, axis=0)
    # Other work of the process takes or frees memory now and then; what is lost with each capture shows in most parts.
    lost = np.median(grown - np.maximum(LEAST_LEAK, LEAK * frame.nbytes * counts), axis=0) > 0
    if lost.any():
        rate = float(np.median(grown / counts, axis=0)[lost].max())
        return Finding(
            "captures", False, f"memory grows by {rate / 1e3:.0f} kB with each capture",
            "release each frame after it was copied",
        )  # fmt: skip
    # Counting what Python allocates takes time.
    pace = float(np.mean(taken[: marks[0]]))
    return Finding("captures", True, f"{bench.captures}, {1e3 * pace:.3g} ms each, {1e3 * max(taken):.3g} ms at most")


@contextmanager
def _counted() -> Iterator[None]:
    """Count what Python allocates, and keep the garbage of before, which would be freed at any time."""
    counting = tracemalloc.is_tracing()
    gc.freeze()
    tracemalloc.start()
    try:
        yield
    finally:
        if not counting:
            tracemalloc.stop()
        gc.unfreeze()


def _memory() -> tuple[float, float]:
    """Return the bytes that Python has allocated since they are counted, and those of the process, 0 if not known.

    The latter are without pages of files, which the system drops when memory is short, and with pages that it stored.
    """
    gc.collect()
    allocated = float(tracemalloc.get_traced_memory()[0])
    status = Path("/proc/self/status")
    kilobytes = re.findall(r"(?:RssAnon|RssShmem|VmSwap):\s+(\d+)", status.read_text() if status.exists() else "")
    if kilobytes:
        return allocated, 1024.0 * sum(map(int, kilobytes))
    try:
        import psutil
    except ImportError:
        return allocated, 0.0
    return allocated, float(psutil.Process().memory_info().rss)


# Checks of a camera, and those that must have passed before.
CAMERA: dict[str, tuple[Callable[[Any], Finding | None], str]] = {
    "orientation": (_orientation, ""),
    "frames": (_frames, "orientation"),
    "late frames": (_late, "frames"),
    "captures": (_many, "frames"),
    "exposure": (_exposure, "frames"),
    "bit depth": (_depth, "exposure"),
    "gamma": (_gamma, "exposure"),
    "region": (_region, "frames"),
    "patterns": (_patterns, "frames exposure captures"),
}
