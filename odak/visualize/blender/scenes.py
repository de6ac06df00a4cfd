"""A scene as plain data, and its renders."""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from odak import _validate
from odak.catalog.materials import MICROMETRES
from odak.tools.file import validate_path
from odak.visualize.blender import runner, scene_files
from odak.visualize.blender.items import Camera, Item, Light
from odak.visualize.blender.lenses import Lenses
from odak.visualize.blender.lines import Lines
from odak.visualize.blender.materials import D_LINE, Material, chosen
from odak.visualize.blender.meshes import Mesh
from odak.visualize.blender.shapes import Shapes
from odak.visualize.blender.views import Views

__all__ = ["scene"]

# Blender makes no smaller pictures.
SMALLEST = 4
DEVICES = ("auto", "cpu", "gpu", "cuda", "optix", "hip", "oneapi", "metal")


class scene(Lines, Shapes, Lenses, Views):
    """Rays, meshes, surfaces and lenses, to be rendered by Blender.

    Parameters
    ----------
    unit : str
        Unit of all lengths: "mm", "m", "um" or "nm". One unit of the scene is one unit of Blender, and Blender is told
        how long it is.
    wavelength : float, optional
        Vacuum wavelength in `unit` at which named glasses have their index; the d line, 587.5618 nm, by default.
    resolution : sequence of int
        Rows and columns of the picture.
    samples : int
        Light paths per pixel.
    device : str
        "auto": a GPU through CUDA (or what else there is) if there is one, else the CPU. "cpu". "gpu", "cuda", "optix",
        "hip", "oneapi", "metal": with a warning in the log and the CPU if there is none.

    Attributes
    ----------
    objects : list of Item
        What there is to see.
    camera : Camera or None
        Set by :meth:`add_camera`.
    lights : list of Light
        Set by :meth:`add_light`.
    background : dict or None
        Set by :meth:`set_background`. Until then it is grey, a quarter of white; and until a light is added as well,
        a sun shines over the camera's left shoulder.
    metres : float
        Length of one unit.
    start_from : str or None
        A ".blend" file that Blender is to open first, without running any script in it.
    removed : list of str
        Names of objects of that file to leave out.

    Raises
    ------
    ValueError
        If an argument is outside its range.

    Notes
    -----
    Nothing here needs Blender but :meth:`render`, :meth:`render_depth` and :meth:`save` with a ".blend" file; see
    :func:`odak.visualize.blender.find_blender`. Axes are those of odak: z the optical axis, y upwards.

    Examples
    --------
    >>> from odak.visualize import blender
    >>> picture = blender.scene(unit="mm")
    >>> _ = picture.add_sphere([0, 0, 20], radius=5, material="N-BK7")
    >>> _ = picture.add_rays([[0, 1, 0], [0, 0, 1]], distance=40)
    >>> [item.name for item in picture.objects]
    ['sphere', 'rays']
    """

    def __init__(
        self,
        unit: str = "mm",
        *,
        wavelength: float | None = None,
        resolution: Sequence[int] = (480, 640),
        samples: int = 64,
        device: str = "auto",
    ):
        self.unit = _validate.one_of("unit", unit, ("mm", "m", "um", "nm"))
        self.metres = MICROMETRES[self.unit] * 1e-6
        wavelength = D_LINE / self.metres if wavelength is None else wavelength
        self.wavelength = float(_validate.real("wavelength", wavelength, positive=True))
        self.resolution = _validate.size("resolution", resolution)
        self.samples = _validate.integer("samples", samples, minimum=1)
        self.device = _validate.one_of("device", device, DEVICES)
        self.objects: list[Item] = []
        self.lights: list[Light] = []
        self.camera: Camera | None = None
        self.start_from: str | None = None
        self.removed: list[str] = []
        self.background: dict | None = None

    def find(self, name: str) -> Item:
        """Return the object of a name; raise ValueError that lists the names if there is none."""
        for item in self.objects:
            if item.name == name:
                return item
        names = ", ".join(repr(item.name) for item in self.objects) or "none"
        raise ValueError(f"name must be that of an object of the scene ({names}), got {name!r}")

    def remove(self, item: Any) -> None:
        """Take an object out of the scene.

        Parameters
        ----------
        item : Item or str
            The object, or its name.
        """
        found = self.find(item) if isinstance(item, str) else item
        self.objects[:] = [other for other in self.objects if other is not found]

    def render(
        self,
        path: str | os.PathLike | None = None,
        *,
        resolution: Sequence[int] | None = None,
        samples: int | None = None,
        device: str | None = None,
        denoise: bool = False,
        transparent: bool = False,
        seed: int = 0,
        blender: str | os.PathLike | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> Any:
        """Render the picture with Cycles, Blender's path tracer; no window opens.

        Parameters
        ----------
        path : str or os.PathLike, optional
            Where to write it: ".png" (sRGB, 8 bits) or ".exr" (linear light, 32-bit floats). Without one the picture is
            returned.
        resolution, samples, device
            In place of the scene's.
        denoise : bool
            Remove noise with OpenImageDenoise, where this Blender has it.
        transparent : bool
            Leave the background out: the picture has a fourth channel, which says how opaque it is.
        seed : int
            Of the random light paths; the same one gives the same picture.
        blender : str or os.PathLike, optional
            Which Blender; see :func:`odak.visualize.blender.find_blender`.
        timeout : float, optional
            Seconds after which to give up; None to wait for ever.
        verbose : bool
            Show a progress bar.

        Returns
        -------
        str or numpy.ndarray
            The path, or linear light as float32 ``[rows, columns, 3]`` (4 with `transparent`, colours multiplied by
            it), row 0 at the top. Values above 1 are brighter than white.

        Raises
        ------
        BlenderNotFoundError
            If there is no Blender; the message says how to get one.
        BlenderError
            If Blender fails; the message ends with what it wrote.
        TimeoutError
            If it takes too long.

        Notes
        -----
        Without a camera, one is taken that sees all objects, as of :meth:`add_camera` without arguments. The file
        appears whole or not at all.
        """
        job = self._job("picture", resolution, samples, device, seed)
        job |= {"denoise": bool(denoise), "transparent": bool(transparent)}
        if path is None:
            pixels = runner.run_for_array(self._document(job), blender, timeout, verbose)
            return pixels if transparent else pixels[..., :3]
        path = validate_path(path, (".png", ".exr"))
        return runner.run_for_file(self._document(job), path, blender, timeout, verbose)

    def render_depth(
        self,
        *,
        resolution: Sequence[int] | None = None,
        device: str | None = None,
        blender: str | os.PathLike | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> np.ndarray:
        """Return how far away from the camera's plane the first surface is in the middle of each pixel.

        Parameters
        ----------
        resolution, device, blender, timeout, verbose
            As in :meth:`render`.

        Returns
        -------
        numpy.ndarray
            float32 ``[rows, columns]`` in the scene's unit, along the camera's axis; infinite where nothing is.
            Glass counts as a surface.
        """
        job = self._job("depth", resolution, 1, device, 0)
        pixels = runner.run_for_array(self._document(job), blender, timeout, verbose)
        return np.where(pixels[..., 3] > 0.5, pixels[..., 0], np.float32(np.inf))

    def save(
        self,
        path: str | os.PathLike,
        *,
        blender: str | os.PathLike | None = None,
        timeout: float | None = 3600.0,
        verbose: bool = True,
    ) -> str:
        """Write the scene to a file.

        Parameters
        ----------
        path : str or os.PathLike
            ".blend", to be opened in Blender; or ".json", beside which a ".npz" of the same name holds the arrays.
        blender, timeout, verbose
            As in :meth:`render`, for a ".blend" file.

        Returns
        -------
        str
            The path.
        """
        path = validate_path(path, (".blend", ".json"))
        job = self._job("blend", None, None, None, 0)
        if path.endswith(".json"):
            return scene_files.write(path, self._document(job))
        return runner.run_for_file(self._document(job), path, blender, timeout, verbose)

    @classmethod
    def load(cls, path: str | os.PathLike) -> "scene":
        """Return the scene of a ".json" file that :meth:`save` wrote.

        Raises
        ------
        ValueError
            If the file is missing or malformed; the message names it.
        """
        path = validate_path(path, [".json"])
        document = scene_files.read(path)
        try:
            return cls._from(document)
        except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
            raise ValueError(f"{path!r} cannot be read as a scene: {error}") from error

    @classmethod
    def _from(cls, document: dict) -> "scene":
        job = document["render"]
        found = cls(
            document["unit"],
            wavelength=document["wavelength"],
            resolution=job["resolution"],
            samples=job["samples"],
            device=job["device"],
        )
        found.start_from, found.removed = document["start_from"], document["remove"]
        found.background = document["background"]
        found.objects = [scene_files.item_from(entry) for entry in document["objects"]]
        found.lights = [Light(**entry) for entry in document["lights"]]
        found.camera = None if document["camera"] is None else Camera(**document["camera"])
        return found

    def _add(self, name: str, mesh: Mesh, material, color, default: Material | None, **options) -> Item:
        if not isinstance(name, str) or not name:
            raise TypeError(f"name must be a string that is not empty, got {name!r}")
        made_of = chosen(material, color, default, self.wavelength, self.unit)
        taken = {item.name for item in self.objects}
        free = name
        for number in range(1, len(taken) + 2):
            if free not in taken:
                break
            free = f"{name}.{number:03d}"
        self.objects.append(Item.of(free, mesh, made_of, **options))
        return self.objects[-1]

    def _job(self, what: str, resolution, samples, device, seed) -> dict:
        size = self._resolution(resolution)
        if min(size) < SMALLEST:
            raise ValueError(f"resolution must be at least {SMALLEST} rows and columns, got {list(size)}")
        return {
            "what": what,
            "resolution": list(size),
            "samples": self.samples if samples is None else _validate.integer("samples", samples, minimum=1),
            "device": self.device if device is None else _validate.one_of("device", device, DEVICES),
            "seed": _validate.integer("seed", seed),
            "denoise": False,
            "transparent": False,
        }

    def _document(self, job: dict) -> dict:
        """Return the scene as what :func:`odak.visualize.blender.scene_files.write` writes."""
        if self.start_from:
            camera, lights, background = self.camera, self.lights, self.background
        else:
            camera = self._view(job["resolution"])
            lights, background = self._lighting(camera)
        return {
            "unit": self.unit,
            "metres": self.metres,
            "wavelength": self.wavelength,
            "objects": self.objects,
            "lights": [dataclasses.asdict(light) for light in lights],
            "camera": None if camera is None else dataclasses.asdict(camera) | {"clip": self._reach(camera)},
            "background": background,
            "start_from": validate_path(self.start_from, [".blend"]) if self.start_from else None,
            "remove": self.removed,
            "render": job,
        }
