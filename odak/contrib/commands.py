"""Function interface of earlier versions: drawing into one scene per process, and commands given as texts.

One unit is a metre and colours are linear, as in Blender. No Blender has to run beforehand, no port is opened, and a
text is parsed, never executed. :class:`odak.visualize.blender.scene` offers more.
"""

import ast
import math
import queue
import threading
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak._warnings import ArgumentWarning, warn
from odak.raytracing.boundary import reflect
from odak.tools.file import save_image, validate_path
from odak.visualize._arrays import coded_light
from odak.visualize.blender.items import Item, diffuse, emission, three
from odak.visualize.blender.scenes import scene
from odak.visualize.blender.shapes import pixels


class Session:
    """Handle returned by :func:`odak.visualize.blender.init`, with the interface of a process.

    Attributes
    ----------
    scene : scene
        The scene, in metres, which are the unit of Blender.
    depth : bool
        Whether depth is rendered in place of colours.
    """

    def __init__(self, start_from: str | None = None):
        self.scene: scene = scene(unit="m", resolution=(1080, 1920))
        self.scene.start_from = start_from
        self.depth = False

    def poll(self) -> int | None:
        """Return None while this is the scene that is drawn into, 0 afterwards."""
        return None if _open.get("session") is self else 0

    def kill(self) -> None:
        """Release the scene."""
        if self.poll() is None:
            stop()

    terminate = kill


_open: dict[str, Session] = {}


def start(start_from: str | None = None) -> Session:
    """Begin an empty scene, or one that continues a ".blend" file, and return its handle."""
    _open["session"] = Session(start_from)
    return _open["session"]


def current() -> Session:
    """Return the handle of the scene that is drawn into; begin one if there is none."""
    return _open.get("session") or start()


def stop() -> None:
    """Release the scene."""
    _open.pop("session", None)


ORIGIN = (0.0, 0.0, 0.0)
RENDER_TYPES = ("rgb", "depth")


def prepare(
    resolution: Sequence[int] = (1920, 1080),
    camera_fov: float = 40.0,
    camera_location: Sequence[float] = (0.0, 0.0, -15.0),
    camera_lookat: Sequence[float] = ORIGIN,
    clip: Sequence[float] = (0.1, 100000000.0),
    device: str = "GPU",
    intensity: float = 2.0,
    world_color: Sequence[float] = (0.3, 0.3, 0.3),
) -> Any:
    """Set camera, background and device, and remove the cube and the light of a new ".blend" file.

    Parameters
    ----------
    resolution : sequence of int
        Width and height of the picture.
    camera_fov : float
        Full angle across the longer side of the picture, in degrees.
    camera_location : sequence of float
        Position of the camera.
    camera_lookat : sequence of float
        Point that the camera looks at.
    clip : sequence of float
        Nearest and farthest distance that it sees.
    device : str
        "GPU" or "CPU". Without a GPU the CPU renders, with a warning in the log.
    intensity : float
        Strength of the background.
    world_color : sequence of float
        Colour of the background, red, green and blue in linear light.

    Returns
    -------
    scene
        The scene.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init()
    >>> scene = blender.prepare(resolution=(640, 480), camera_location=(0, 0, -5), device="CPU")
    >>> scene.resolution
    (480, 640)
    >>> blender.quit()
    """
    width, height = _validate.size("resolution", resolution)
    scene = current().scene
    scene.resolution = (height, width)
    scene.device = _validate.one_of("device", device, ("gpu", "cpu"))
    fov = float(camera_fov)
    if height > width:
        fov = 2 * math.degrees(math.atan(math.tan(math.radians(fov) / 2) * width / height))
    scene.add_camera(camera_location, camera_lookat, fov=fov, clip=clip)
    scene.set_background(coded_light(world_color[:3]), intensity)
    for name in ("Cube", "Light"):
        delete_object(name)
    return scene


def import_ply(
    filename: str,
    location: Sequence[float] = ORIGIN,
    angle: Sequence[float] = ORIGIN,
    scale: Sequence[float] = (1, 1, 1),
) -> Item:
    """Draw the mesh of a PLY file.

    Parameters
    ----------
    filename : str
        A ".ply" file.
    location : sequence of float
        Position of the mesh's origin.
    angle : sequence of float
        Degrees about X, then Y, then Z, after scaling.
    scale : sequence of float
        Factors along x, y and z.

    Returns
    -------
    Item
        The object, named like the file.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> from odak.tools import write_PLY
    >>> from odak.visualize import blender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     name = os.path.join(folder, "triangle.ply")
    ...     write_PLY(np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]), name)
    ...     blender.import_ply(name, location=(0, 0, 2)).name
    'triangle'
    >>> blender.quit()
    """
    return current().scene.add_mesh(filename, location=location, rotation=angle, scale=scale)


def cylinder_between(
    start_loc: Sequence[float],
    end_loc: Sequence[float],
    r: float = 0.1,
    objname: str = "cylinder",
    color: Sequence[float] = (0.0, 0.5, 0.0, 0.0),
) -> Item:
    """Draw a matt cylinder between two points.

    Parameters
    ----------
    start_loc : sequence of float
        Centre of the first end.
    end_loc : sequence of float
        Centre of the second end.
    r : float
        Its radius.
    objname : str
        Name of the object.
    color : sequence of float
        Red, green, blue; a fourth number is ignored.

    Returns
    -------
    Item
        The object.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> blender.cylinder_between((0, 0, 0), (0, 0, 5), r=0.2, objname="rod").name
    'rod'
    >>> blender.quit()
    """
    scene = current().scene
    return scene.add_cylinder(start_loc, end_loc, r, color=coded_light(color[:3]), name=objname)


def render(fn: str, exit: bool = False) -> str:
    """Render the picture, or its depth after :func:`set_render_type`, to a PNG file.

    Parameters
    ----------
    fn : str
        Name that ends in ".png". Depth is grey: black the nearest, white the farthest and whatever lies behind.
    exit : bool
        Release the scene afterwards.

    Returns
    -------
    str
        The path.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> _ = blender.prepare(resolution=(640, 480), device="CPU")
    >>> _ = blender.cylinder_between((-2, 0, 0), (2, 0, 0))
    >>> blender.render("cylinder.png", exit=True)  # doctest: +SKIP
    'cylinder.png'

    Other kinds of files are refused before Blender starts:

    >>> try:
    ...     blender.render("cylinder.txt")
    ... except ValueError as error:
    ...     print(".png" in str(error))
    True
    >>> blender.quit()
    """
    now, path = current(), validate_path(fn, [".png"])
    if now.depth:
        depth = now.scene.render_depth()
        seen = depth[np.isfinite(depth)]
        low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)
        grey = np.clip((depth - low) / (high - low if high > low else 1.0), 0.0, 1.0)
        save_image(path, grey, cmin=0.0, cmax=1.0)
    else:
        now.scene.render(path)
    if exit:
        quit()
    return path


def set_render_type(render_type: str = "rgb") -> None:
    """Choose what :func:`render` writes: "rgb" or "depth"."""
    current().depth = _validate.one_of("render_type", render_type, RENDER_TYPES) == "depth"


def quit() -> None:
    """Release the scene; later drawing commands begin a new one.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init()
    >>> blender.quit()
    >>> session.poll()
    0
    """
    stop()


def delete_object(label: str) -> None:
    """Remove the object with a name, if there is one, also from the ".blend" file that the scene continues."""
    scene = current().scene
    scene.remove(label) if any(item.name == label for item in scene.objects) else scene.removed.append(label)


def set_rotation(input_obj: Item, angle: Sequence[float]) -> None:
    """Rotate an object: degrees about X, then Y, then Z."""
    input_obj.rotation = three("angle", angle)


def set_location(input_obj: Item, location: Sequence[float]) -> None:
    """Move an object."""
    input_obj.location = three("location", location)


def clear_material(material: Item) -> None:
    """Give an object a plain white matt material."""
    material.material, material.image, material.colors = diffuse(), None, None


def assign_color(fn: str, obj: Item, color: Sequence[float] = ORIGIN, label: str = "color") -> None:
    """Make an object emit light of a colour.

    Parameters
    ----------
    fn : str
        Ignored.
    obj : Item
        The object.
    color : sequence of float
        Red, green, blue, linear light.
    label : str
        Name of the material.
    """
    clear_material(obj)
    shining = emission(coded_light(color[:3]))
    obj.material = type(shining)("emission", shining.color, name=label)


def assign_texture(fn: str, obj: Item, label: str) -> None:
    """Give an object a picture as its texture.

    Parameters
    ----------
    fn : str
        Name of the image file.
    obj : Item
        The object. Without texture coordinates, the picture is mapped onto the two axes along which it is longest.
    label : str
        Name of the material.
    """
    image = pixels("fn", fn)
    clear_material(obj)
    obj.image = image
    obj.material = type(obj.material)("diffuse", name=label)
    if obj.uv is None:
        extent = np.ptp(obj.vertices, axis=0)
        first, second = sorted(np.argsort(-extent, kind="stable")[:2])
        low = obj.vertices.min(axis=0)
        obj.uv = ((obj.vertices - low) / np.where(extent > 0, extent, 1.0))[:, [first, second]].astype(np.float32)


def create_plane(objname: str, location: Sequence[float], size: Sequence[float] = (1.0, 1.0)) -> Item:
    """Draw a rectangle that faces +z; return the object."""
    return current().scene.add_plane(size, location=location, name=objname)


def create_plane_from_meshes(objname: str, location: Sequence[float], size: Sequence[float] = (1.0, 1.0)) -> Item:
    """Draw a rectangle that faces +z; return the object."""
    return create_plane(objname, location, size)


def create_circle(objname: str, location: Sequence[float], radius: float = 1.0) -> Item:
    """Draw a disc that faces +z; return the object."""
    return current().scene.add_disc(radius, location=location, name=objname)


def intersect_a_ray(p0: Sequence[float], p1: Sequence[float], ob: Item) -> Any:
    """Intersect an object with the ray from one point towards another, and beyond it.

    Parameters
    ----------
    p0, p1 : sequence of float
        Where the ray starts, and a point on its way.
    ob : Item
        The object.

    Returns
    -------
    tuple
        Whether the ray intersects the object, the first intersection (``[3]``, False if there is none) and its
        distance from the start (0 if there is none).
    """
    import torch

    from odak.learn.raytracing import triangle_mesh

    _, length = create_ray_from_two_points(p0, p1)
    if not length > 0:
        raise ValueError(f"p0 and p1 must be different points, got {list(p0)} for both")
    mesh = triangle_mesh(torch.from_numpy(ob.placed_vertices()), torch.from_numpy(ob.faces).long(), backend="torch")
    start = torch.tensor([three("p0", p0), three("p1", p1)], dtype=torch.float64)
    direction = (start[1] - start[0]) / (start[1] - start[0]).norm()
    hit = mesh.intersect(torch.stack((start[0], direction))[None])
    if int(hit.face[0]) < 0:
        return False, False, 0
    return True, hit.point[0].numpy(), float(hit.distance[0])


def create_ray_from_two_points(x0y0z0: Sequence[float], x1y1z1: Sequence[float]) -> tuple[np.ndarray, float]:
    """Return the ray from one point to another, and their distance.

    Parameters
    ----------
    x0y0z0, x1y1z1 : sequence of float
        The two points.

    Returns
    -------
    tuple
        Start and direction cosines, float32 ``[2, 3]``, and the distance. The cosines are 0 for a distance of 0.
    """
    start, end = np.asarray(three("x0y0z0", x0y0z0)), np.asarray(three("x1y1z1", x1y1z1))
    length = float(np.linalg.norm(end - start))
    return np.stack((start, (end - start) / (length or 1.0))).astype(np.float32), length


def reflect_ray(
    input_ray: np.ndarray, normal: Sequence[float], intersection: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Reflect a ray at a point.

    Parameters
    ----------
    input_ray : array
        Start and direction ``[2, 3]``.
    normal, intersection : sequence of float
        Normal there, of any length, and the point.

    Returns
    -------
    tuple of numpy.ndarray
        The point, and one that is ten units farther on the reflected ray; ``[3]`` each.
    """
    point, across = np.asarray(three("intersection", intersection)), np.asarray(three("normal", normal))
    given = np.asarray(_validate.array("input_ray", input_ray), dtype=np.float64)
    _validate.shaped("input_ray", given, "[2, 3]")
    if not across.any():
        raise ValueError("normal must not be zero")
    surface = np.stack((point, across / np.linalg.norm(across)))
    ray = np.stack((point, given[1]))
    direction = np.asarray(reflect(ray, surface)).reshape(2, 3)[1]
    return point, point + 10 * direction / np.linalg.norm(direction)


def init(headless: bool = False, blend_fn: str = "") -> Session:
    """Begin a scene.

    Parameters
    ----------
    headless : bool
        Ignored: no window opens.
    blend_fn : str
        A ".blend" file to continue; no script in it is run. Empty for an empty scene.

    Returns
    -------
    Session
        A handle with `poll` and `kill`, as a process has them; its `scene` receives the objects that are drawn.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init(headless=True)
    >>> rod = blender.cylinder_between((0, 0, 0), (0, 0, 5))
    >>> [item.name for item in session.scene.objects]
    ['cylinder']
    >>> session.kill()
    """
    return start(validate_path(blend_fn, [".blend"]) if blend_fn else None)


def check(proc: Session) -> None:
    """Release the scene of a handle of :func:`init`; there is no process to wait for.

    Parameters
    ----------
    proc : Session
        Handle of :func:`init`.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init()
    >>> session.poll() is None
    True
    >>> blender.check(session)
    >>> session.poll()
    0
    """
    proc.kill()


def delete_the_cube() -> None:
    """Remove the cube that a new ".blend" file holds.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init()
    >>> blender.delete_the_cube()
    >>> session.scene.objects
    []
    >>> blender.quit()
    """
    delete_object("Cube")


def send_msg(cmds: Iterable[str]) -> bool:
    """Execute commands given as texts.

    Parameters
    ----------
    cmds : iterable of str
        Calls such as ``"prepare(device='CPU')"``, with literals as arguments; see
        :func:`odak.visualize.blender.validate_and_queue_command`. A text is parsed, never executed.

    Returns
    -------
    bool
        True.

    Raises
    ------
    ValueError
        If one is refused. None of them is carried out then.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> session = blender.init()
    >>> blender.send_msg(["cylinder_between((0, 0, 0), (0, 0, 5))", "delete_the_cube()"])
    True
    >>> [item.name for item in session.scene.objects]
    ['cylinder']
    >>> blender.quit()
    """
    texts = [cmds] if isinstance(cmds, str) else list(cmds)
    for text in texts:
        if all(parse_function_call_safely(text, name)[0] is None for name in COMMANDS):
            known = ", ".join(COMMANDS)
            raise ValueError(f"cmds must be calls of {known} with literals as arguments, got {text!r:.100}")
    for text in texts:
        validate_and_queue_command(text)
        execute_queued_functions()
    return True


COMMANDS = ("import_ply", "prepare", "delete_the_cube", "render", "cylinder_between", "quit", "delete_object")
LONGEST = 4096
_waiting: queue.Queue = queue.Queue(maxsize=100)


def parse_function_call_safely(cmd_str: str, expected_func_name: str) -> tuple[str | None, list[Any], dict[Any, Any]]:
    """Parse the text of a call.

    Parameters
    ----------
    cmd_str : str
        Such as ``"render('picture.png', exit=True)"``. Arguments must be literals: numbers, strings, lists, tuples,
        dictionaries, True, False, None.
    expected_func_name : str
        The name that must be called.

    Returns
    -------
    tuple
        Name, positional and named arguments; (None, [], {}) for any other text.
    """
    refused: tuple[Any, ...] = (None, [], {})
    if not isinstance(cmd_str, str) or len(cmd_str) > LONGEST:
        return refused
    try:
        call = ast.parse(cmd_str.strip(), mode="eval").body
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name) or call.func.id != expected_func_name:
            return refused
        if any(keyword.arg is None for keyword in call.keywords):
            return refused
        arguments = [ast.literal_eval(argument) for argument in call.args]
        return call.func.id, arguments, {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords}
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return refused


def validate_and_queue_command(cmd_str: str) -> bool:
    """Queue a command if it is one of those known, and its arguments are literals.

    Parameters
    ----------
    cmd_str : str
        Text of the call of import_ply, prepare, delete_the_cube, render, cylinder_between, quit or delete_object.

    Returns
    -------
    bool
        True if it was queued; a warning says why not.
    """
    for expected in COMMANDS:
        name, arguments, named = parse_function_call_safely(cmd_str, expected)
        if name is not None:
            return run_in_main_thread((globals()[name], arguments, named))
    warn(
        f"ignored {cmd_str!r:.100}: accepted are calls of {', '.join(COMMANDS)} with literals as arguments",
        ArgumentWarning,
    )
    return False


def run_in_main_thread(function_tuple: Any) -> bool:
    """Queue a call.

    Parameters
    ----------
    function_tuple : tuple or callable
        Function, positional arguments, named arguments; or a function without arguments.

    Returns
    -------
    bool
        Whether the call was queued: at most 100 calls wait.
    """
    function, arguments, named = (function_tuple, [], {}) if callable(function_tuple) else function_tuple
    try:
        _waiting.put_nowait((function, arguments, named))
    except queue.Full:
        warn(f"{_waiting.maxsize} commands are waiting already: {function.__name__} is discarded", ArgumentWarning)
        return False
    return True


def execute_queued_functions() -> float:
    """Execute the queued calls in order; return 0.1, the seconds after which to call again.

    Raises
    ------
    Exception
        What a command raises; those behind it stay queued.
    """
    while True:
        try:
            function, arguments, named = _waiting.get_nowait()
        except queue.Empty:
            return 0.1
        function(*arguments, **named)


class whisper2blender(threading.Thread):
    """A thread that executes the queued calls once. No port is opened.

    Parameters
    ----------
    port, host, path_max : int, str, int
        Ignored.
    """

    def __init__(self, port: int = 8082, host: str = "127.0.0.1", path_max: int = LONGEST):
        super().__init__(daemon=True)
        self.port: int = port
        self.host: str = host
        self.path_max: int = path_max

    def run(self) -> None:
        """Execute the queued calls."""
        execute_queued_functions()


def main() -> None:
    """Execute the queued calls."""
    execute_queued_functions()
