"""Render odak/assets/scene.png and scene_depth.png: a still life and its depth, by casting rays.

Run ``python scripts/render_scene.py [FOLDER] [--size ROWS COLUMNS]``. The viewer looks along z at a table, y = 0, that
ends at a wall, z = 10; the picture is shifted down rather than the view tilted, so that the wall keeps one depth.
Depth is the distance along z, 0 at the nearest point in the picture and 1 at the wall. It is that of the ray through
the middle of a pixel; colours are the mean over three by three rays. Nothing is drawn at random.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

SHAPE = (1080, 1920)
TARGET = Path(__file__).resolve().parents[1] / "odak" / "assets"
WALL = 10.0
# Lengths on the image plane are in picture heights: focal length, and top of the picture below the horizon.
EYE_HEIGHT, FOCAL_LENGTH, TOP = 2.27, 2.2, 0.25
RAYS_PER_SIDE, BAND = 3, 12
LAMP, LAMP_RADIUS, LAMP_POINTS = (-0.403, 0.775, -0.487), 0.11, 6
SUN = np.array([[0.83], [0.79], [0.72]])
SKY, BOUNCE = np.array([[0.41], [0.45], [0.52]]), np.array([[0.25], [0.21], [0.17]])
# Letters in units of half a face: the arc of an ellipse (where it starts, middle, half width), and straight strokes.
BOLD, TALL = 0.095, 0.42
LETTERS = {
    "O": ((-1.0, 0.0, 0.32), ()),
    "D": ((-0.26, -0.26, 0.54), ((-0.26, TALL, -0.26, -TALL),)),
    "A": (None, ((-0.33, -TALL, 0, TALL), (0, TALL, 0.33, -TALL), (-0.22, -0.14, 0.22, -0.14))),
    "K": (None, ((-0.26, TALL, -0.26, -TALL), (-0.26, -0.02, 0.3, TALL), (-0.1, 0.1, 0.3, -TALL))),
}


def _colour(code: str) -> np.ndarray:
    """Return the linear intensities ``[3, 1]`` of an sRGB colour such as "ff8040"."""
    value = np.array([int(code[index : index + 2], 16) for index in (0, 2, 4)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)[:, None]


CREAM, WHITE, INK = _colour("f3e6cc"), _colour("f4f1ea"), _colour("2d3a55")


def _dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return first[0] * second[0] + first[1] * second[1] + first[2] * second[2]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(_dot(vectors, vectors))


def _turned(vectors: np.ndarray, degrees: float, axis: int = 1) -> np.ndarray:
    """Return vectors ``[3, N]`` turned about an axis: 0, 1 or 2 for x, y or z."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    result = np.array(vectors)
    result[first] = cosine * vectors[first] - sine * vectors[second]
    result[second] = sine * vectors[first] + cosine * vectors[second]
    return result


# A body answers two questions about points ``[3, N]`` counted from its centre. `hit`: how many ray lengths away is its
# surface, infinite where missed? `surface`: what are the normals and the colours, both ``[3, N]``, at the surface?
# `bound` is the radius of a sphere around it, and `solid` the share of that sphere that hides the sky.
@dataclass(frozen=True)
class _Ball:
    centre: tuple[float, float, float]
    bound: float
    paint: Callable
    tilt: float
    gloss: float = 0.5
    solid: float = 1.0

    def hit(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        along, square = _dot(start, ray), _dot(ray, ray)
        root = along**2 - square * (_dot(start, start) - self.bound**2)
        return np.where(root > 0, (-along - np.sqrt(np.maximum(root, 0))) / square, np.inf)

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        normals = points / self.bound
        return normals, self.paint(_turned(normals, self.tilt, axis=2))


@dataclass(frozen=True)
class _Cube:
    centre: tuple[float, float, float]
    half: float
    turn: float
    paint: Callable
    gloss: float = 0.12
    solid: float = 0.45

    @property
    def bound(self) -> float:
        return self.half * 3**0.5

    def hit(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        ray = _turned(ray, -self.turn)
        inverse = 1 / np.where(ray == 0, 1e-300, ray)
        middle, reach = -_turned(start, -self.turn) * inverse, self.half * np.abs(inverse)
        enter, leave = (middle - reach).max(axis=0), (middle + reach).min(axis=0)
        return np.where(enter < leave, enter, np.inf)

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = _turned(points, -self.turn) / self.half
        axis = np.abs(place).argmax(axis=0)
        normals = np.where(np.arange(3)[:, None] == axis, np.sign(place), 0.0)
        across = np.where(axis == 0, place[2] * np.sign(place[0]), place[0])
        upward = np.where(axis == 1, place[2], place[1])
        return _turned(normals, self.turn), self.paint(across, upward, axis)


@dataclass(frozen=True)
class _Disc:
    centre: tuple[float, float, float]
    bound: float
    lean: float
    turn: float
    paint: Callable
    gloss: float = 0.05
    solid: float = 0.25

    def _local(self, vectors: np.ndarray) -> np.ndarray:
        return _turned(_turned(vectors, -self.turn), -self.lean, axis=0)

    def hit(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        start, ray = self._local(start), self._local(ray)
        distance = -start[2] / np.where(ray[2] == 0, 1e-300, ray[2])
        inside = (start[0] + distance * ray[0]) ** 2 + (start[1] + distance * ray[1]) ** 2 < self.bound**2
        return np.where(inside, distance, np.inf)

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        place = self._local(points) / self.bound
        facing = np.zeros_like(points)
        facing[2] = -1
        return _turned(_turned(facing, self.lean, axis=0), self.turn), self.paint(place[0], place[1])


def _painted(tint: np.ndarray, *coats: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return a colour covered by others, each with the mask ``[N]`` of where it lies; later ones on top."""
    for colour, where in coats:
        tint = np.where(where, colour, tint)
    return tint


def _bars(place: np.ndarray, count: float) -> np.ndarray:
    return np.floor(place * count) % 2 == 0


def _near_whole(place: np.ndarray, width: float) -> np.ndarray:
    return np.abs(place - np.round(place)) < width


def _inked(letter: str, across: np.ndarray, upward: np.ndarray) -> np.ndarray:
    arc, strokes = LETTERS[letter]
    ink = np.zeros(across.shape, dtype=bool)
    if arc:
        start, middle, half = arc
        ring = np.abs(np.hypot((across - middle) / half, upward / TALL) - 1) * (half + TALL) / 2
        ink = (ring < BOLD) & (across > start)
    for x, y, end, top in strokes:
        u, v = end - x, top - y
        along = np.clip(((across - x) * u + (upward - y) * v) / (u**2 + v**2), 0, 1)
        ink |= np.hypot(across - x - along * u, upward - y - along * v) < BOLD
    return ink


def _toy(letter: str, code: str) -> Callable:
    """Return the paint of a toy cube: a letter on its upright faces, rings on top, a scale around each face."""

    def paint(across: np.ndarray, upward: np.ndarray, axis: np.ndarray) -> np.ndarray:
        wide, narrow = np.maximum(np.abs(across), np.abs(upward)), np.minimum(np.abs(across), np.abs(upward))
        along = np.where(np.abs(across) > np.abs(upward), upward, across)
        scale = (wide > 0.81) & (wide < 0.92) & (narrow < 0.75) & _bars(along + 1.025, 20)
        radius = np.hypot(across, upward)
        marks = np.where(axis == 1, _bars(radius, 8) & (radius < 0.75), _inked(letter, across, upward))
        return _painted(CREAM, (_colour(code), (wide > 0.75) | marks), (CREAM, scale))

    return paint


def _die(across: np.ndarray, upward: np.ndarray, axis: np.ndarray) -> np.ndarray:
    pip = (np.hypot(np.abs(across) - 0.52, np.abs(upward) - 0.52) < 0.2) & ((axis != 0) | (across * upward < 0))
    pip |= np.hypot(np.where(axis == 1, np.abs(across) - 0.52, across), upward) < 0.2
    wide = np.maximum(np.abs(across), np.abs(upward))
    scale = (wide > 0.86) & _bars(np.where(np.abs(across) > np.abs(upward), upward, across), 30)
    return _painted(_colour("f2b632"), (_colour("b8690f"), (wide > 0.94) | scale), (INK, pip))


def _gores(first: str, second: str, count: int) -> Callable:
    """Return the paint of a ball striped from pole to pole, with a belt."""

    def paint(normals: np.ndarray) -> np.ndarray:
        turn = np.arctan2(normals[2], normals[0]) / (2 * np.pi) * count
        height = np.abs(normals[1])
        seam = np.abs(turn - np.round(turn)) * np.sqrt(np.maximum(1 - height**2, 0)) < 0.06
        tint = _painted(_colour(first), (_colour(second), _bars(turn, 1)), (INK, seam), (WHITE, height < 0.07))
        return _painted(tint, (INK, (height < 0.07) & _bars(turn, 6)), (_colour(first), height > 0.95))

    return paint


def _checks(first: str, second: str, count: int) -> Callable:
    """Return the paint of a ball with `count` meridians and as many steps of latitude on the way around."""

    def paint(normals: np.ndarray) -> np.ndarray:
        turn = np.arctan2(normals[2], normals[0]) / (2 * np.pi) * count
        rise = np.arcsin(np.clip(normals[1], -1, 1)) / (2 * np.pi) * count
        line = _near_whole(turn, 0.05) | _near_whole(rise, 0.05)
        return _painted(_colour(first), (_colour(second), _bars(turn, 1) ^ _bars(rise, 1)), (WHITE, line))

    return paint


def _star(across: np.ndarray, upward: np.ndarray) -> np.ndarray:
    radius, turn = np.hypot(across, upward), np.arctan2(upward, across) / (2 * np.pi)
    spokes, scale = _bars(turn, 72) & (radius < 0.72), _bars(turn, 180) & (radius > 0.83) & (radius < 0.92)
    return _painted(WHITE, (INK, spokes), (_colour("d9534a"), radius > 0.78), (WHITE, scale | (radius > 0.97)))


def _table(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    x = x - 0.2
    odd = _bars(x, 2) ^ _bars(z, 2)
    across, along = np.abs(x / 0.5 % 1 - 0.5) * 2, np.abs(z / 0.5 % 1 - 0.5) * 2
    wide, both = np.maximum(across, along), across + along
    dashes = _bars(np.where(across > along, z, x), 40) & (wide > 0.8) & (wide < 0.88)
    brown, mint = (both < 0.3) | (wide > 0.64) & (wide < 0.69) | dashes, (both > 0.62) & (both < 0.7) | (both < 0.2)
    tint = _painted(_colour("ecd8b4"), (_colour("b98450"), brown))
    return _painted(tint, (_colour("4a8d93"), odd), (_colour("9ccfc8"), odd & (mint | dashes)))


def _wallpaper(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    across, upward = np.abs(x / 0.4 % 1 - 0.5) * 2, np.abs((y - 0.35) / 0.4 % 1 - 0.5) * 2
    lattice, flower = np.abs(across + upward - 0.62) < 0.045, across + upward < 0.26
    tint = _painted(_colour("bcd6ea"), (_colour("d2e4f0"), _bars(x, 2.5)), (_colour("5f8cb8"), lattice))
    tint = _painted(tint, (_colour("e98a55"), flower), (_colour("5f8cb8"), _near_whole(x * 2.5, 0.025)))
    moulding = (np.abs(y - 0.2) < 0.012) | (y < 0.1) & _bars(x, 10)
    return _painted(tint, (_colour("f6ead2"), y < 0.2), (_colour("b07f50"), moulding))


SCENE = (
    _Ball((-1.12, 0.40, 4.95), 0.40, _gores("e4572e", "f6e7cf", 12), 24),
    _Cube((0.98, 0.24, 4.85), 0.24, 32, _die),
    _Cube((-0.58, 0.33, 5.95), 0.33, 20, _toy("O", "c8402f")),
    _Cube((0.42, 0.36, 6.6), 0.36, -24, _toy("D", "2f7d5b")),
    _Cube((1.45, 0.39, 7.35), 0.39, 16, _toy("A", "3a62a8")),
    _Cube((2.38, 0.43, 8.2), 0.43, -20, _toy("K", "8a4a9e")),
    _Disc((-1.95, 0.63, 7.6), 0.65, 14, -14, _star),
    _Ball((-0.5, 0.60, 9.0), 0.60, _checks("2f8f7f", "7cc3a2", 24), -18),
    _Ball((1.2, 0.50, 9.2), 0.50, _gores("f0b93a", "d9762f", 16), 32),
    _Ball((-3.25, 0.36, 9.1), 0.36, _checks("b8487a", "e39ab5", 16), 30),
    _Ball((-0.15, 0.14, 4.65), 0.14, _checks("3560a8", "9db9e8", 12), 40),
    _Ball((1.78, 0.18, 5.7), 0.18, _gores("3f9b5f", "f3e6cc", 8), -30),
    _Ball((-1.95, 0.20, 5.6), 0.20, _checks("6d4fa0", "b9a2dc", 12), 15),
)


def _lamp_points() -> np.ndarray:
    """Return directions ``[3, rays of a pixel, points]`` towards points spread evenly over the lamp, a disc."""
    index = np.arange(RAYS_PER_SIDE**2 * LAMP_POINTS)
    radius, turn = LAMP_RADIUS * np.sqrt((index + 0.5) / len(index)), index * np.pi * (3 - np.sqrt(5))
    middle, side = _unit(np.array(LAMP)[:, None]), _unit(np.array([[LAMP[2]], [0.0], [-LAMP[0]]]))
    points = middle + radius * (np.cos(turn) * side + np.sin(turn) * np.cross(middle, side, axis=0))
    return _unit(points).reshape(3, LAMP_POINTS, -1).transpose(0, 2, 1)


def _nearest(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth, and what is seen: −2 the wall, −1 the table, else the place in `SCENE`."""
    depth = np.minimum(EYE_HEIGHT / np.maximum(-rays[1], 1e-9), WALL)
    seen, square = np.where(depth < WALL, -1, -2), _dot(rays, rays)
    for index, body in enumerate(SCENE):
        start = np.array([[0], [EYE_HEIGHT], [0]]) - np.array(body.centre)[:, None]
        near = np.flatnonzero(_dot(start, rays) ** 2 > square * (_dot(start, start) - body.bound**2))
        distance = body.hit(start, rays[:, near])
        closer = distance < depth[near]
        depth[near[closer]], seen[near[closer]] = distance[closer], index
    return depth, seen


def _surfaces(points: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return normals and colours ``[3, N]``, and gloss ``[N]``."""
    normals, tints, gloss = np.zeros_like(points), np.empty_like(points), np.zeros(seen.shape)
    normals[1], normals[2] = seen == -1, -(seen == -2).astype(float)
    for index, paint, axis in ((-1, _table, 2), (-2, _wallpaper, 1)):
        mine = np.flatnonzero(seen == index)
        tints[:, mine] = paint(points[0, mine], points[axis, mine])
    for index, body in enumerate(SCENE):
        mine = np.flatnonzero(seen == index)
        normals[:, mine], tints[:, mine] = body.surface(points[:, mine] - np.array(body.centre)[:, None])
        gloss[mine] = body.gloss
    return normals, tints, gloss


def _unhidden(points: np.ndarray, normals: np.ndarray, seen: np.ndarray, lamp: np.ndarray) -> tuple:
    """Return the shares ``[N]`` of the lamp and of the sky that points see; for the sky, a body counts as a ball."""
    sun, sky = np.ones(seen.shape), np.ones(seen.shape)
    middle = _unit(np.array(LAMP)[:, None])
    square, along, height = _dot(points, points), _dot(points, middle), _dot(points, normals)
    for index, body in enumerate(SCENE):
        centre = np.array(body.centre)[:, None]
        gap = np.maximum(square - 2 * _dot(points, centre) + _dot(centre, centre), body.bound**2 / 4)
        facing = np.maximum(_dot(normals, centre) - height, 0) / np.sqrt(gap)
        # A convex body hides nothing from its own surface but what lies below the horizon there.
        other = seen != index
        sky *= 1 - other * facing * np.minimum(body.solid * body.bound**2 / gap, 1)
        ahead = _dot(centre, middle) - along
        reach = body.bound + LAMP_RADIUS * (np.abs(ahead) + body.bound)
        near = np.flatnonzero(other & (ahead > -body.bound) & (gap - ahead**2 < reach**2))
        start = points[:, near] - centre
        for point in range(LAMP_POINTS):
            distance = body.hit(start, lamp[:, near, point])
            sun[near] -= ((distance > 0) & (distance < np.inf)) / LAMP_POINTS
    edge = np.where(seen == -1, WALL - points[2], points[1])
    return np.maximum(sun, 0), sky * (1 - 0.35 * np.exp(-edge / 0.35))


def _shade(rays: np.ndarray, depth: np.ndarray, seen: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    points = rays * depth
    points[1] += EYE_HEIGHT
    normals, tints, gloss = _surfaces(points, seen)
    sun, sky = _unhidden(points, normals, seen, lamp)
    middle = _unit(np.array(LAMP)[:, None])
    sun *= np.maximum(_dot(normals, middle), 0)
    upward = 0.5 + 0.5 * normals[1]
    shine = gloss * (sun > 0) * np.maximum(_dot(normals, _unit(middle - _unit(rays))), 0) ** 60
    return tints * ((SKY * upward + BOUNCE * (1 - upward)) * sky + SUN * sun) + shine


def _render_rows(shape: tuple[int, int], rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the linear intensities ``[3, rows, columns]`` and the distance along z of some rows."""
    offsets = (np.arange(RAYS_PER_SIDE) - RAYS_PER_SIDE // 2)[:, None] / RAYS_PER_SIDE
    rays = np.ones((3, RAYS_PER_SIDE, RAYS_PER_SIDE, len(rows), shape[1]))
    rays[0] = ((np.arange(shape[1]) + 0.5 + offsets - shape[1] / 2) / shape[0] / FOCAL_LENGTH)[None, :, None, :]
    rays[1] = -((TOP + (rows + 0.5 + offsets) / shape[0]) / FOCAL_LENGTH)[:, None, :, None]
    size, rays = rays.shape[1:], rays.reshape(3, -1)
    depth, seen = _nearest(rays)
    lamp = np.repeat(_lamp_points(), len(rows) * shape[1], axis=1)
    light = _shade(rays, depth, seen, lamp).reshape(3, -1, *size[2:]).mean(axis=1)
    return light, depth.reshape(size)[RAYS_PER_SIDE // 2, RAYS_PER_SIDE // 2]


def render(shape: tuple[int, int] = SHAPE, rows: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
    """Render the scene, or some rows of it.

    Parameters
    ----------
    shape : tuple of int
        Rows and columns of the whole picture.
    rows : slice, optional
        Rows to render; all by default.

    Returns
    -------
    picture : numpy.ndarray
        uint8 ``[rows, columns, 3]``, sRGB.
    depth : numpy.ndarray
        uint16 ``[rows, columns]``, 0 nearest to the viewer and 65535 at the wall.
    """
    wanted = np.arange(shape[0])[rows]
    bands = [_render_rows(shape, wanted[first : first + BAND]) for first in range(0, len(wanted), BAND)]
    light = np.clip(np.concatenate([band[0] for band in bands], axis=1), 0, 1)
    picture = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    # Nothing is nearer than the table in the last row.
    nearest = EYE_HEIGHT * FOCAL_LENGTH / (TOP + (shape[0] - 0.5) / shape[0])
    depth = (np.concatenate([band[1] for band in bands]) - nearest) / (WALL - nearest)
    return np.round(255 * picture).astype(np.uint8).transpose(1, 2, 0), np.round(65535 * depth).astype(np.uint16)


def main() -> None:
    """Write the picture and its depth to the folder named on the command line, beside the shipped ones by default."""
    parser = argparse.ArgumentParser(description="Render the scene and its depth map that ship with odak.")
    parser.add_argument("folder", nargs="?", type=Path, default=TARGET)
    parser.add_argument("--size", nargs=2, type=int, default=SHAPE, metavar=("ROWS", "COLUMNS"))
    arguments = parser.parse_args()
    picture, depth = render(tuple(arguments.size))
    Image.fromarray(picture).save(arguments.folder / "scene.png", optimize=True)
    Image.fromarray(depth).save(arguments.folder / "scene_depth.png", optimize=True)


if __name__ == "__main__":
    main()
