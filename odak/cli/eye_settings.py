"""Settings of `odak hologram` for eyes: views, meshes and splats that are seen through pupils in an eyebox."""

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from odak._lengths import parse_length
from odak.cli.options import InputError, Settings, at_least, length, option, option_name

SCENES = ("views", "mesh", "splats")
PAIR = "LENGTH[,LENGTH]"


def parse_pair(text: str | float) -> float | tuple[float, float]:
    """Return a length in metres, or two with a comma between them, such as ``2mm,4mm``."""
    if not isinstance(text, str):
        return text
    parts = [parse_length(part) for part in text.split(",")]
    if len(parts) > 2:
        raise ValueError(f"{text!r} must be a length, or two with a comma between them, such as 2mm,4mm")
    return parts[0] if len(parts) == 1 else (parts[0], parts[1])


@dataclass(frozen=True, kw_only=True)
class EyesSettings(Settings):
    """Settings of a scene that eyes look at.

    Attributes
    ----------
    views : str, optional
        Light field: pictures of a scene from places of the pupil, in place of IMAGE. A folder with pictures and a table
        views.csv of lines file,y,x, where each is from in metres in the plane of the pupils; or such a table.
    mesh : str, optional
        PLY file of a mesh, in place of IMAGE, lit by a lamp beside the eye. It fills the picture, seen with its y axis
        upwards and its z axis towards the viewer.
    splats : str, optional
        PLY file of 3-D Gaussian splatting, in place of IMAGE; it stands as a mesh does.
    turned : tuple of float
        Angles in degrees by which a mesh or splats are turned about their x, y and z axis.
    sides : int
        Number of places along each side of the eyebox from which a mesh or splats are rendered.
    plane : float, optional
        Distance from the pupils to what is at the same place of all views, or to the middle of a mesh or splats.
    eyebox : float or tuple of float
        Size of the area in which the middles of pupils are to be; two of them, with a comma, for height and width. The
        report states the quality at pupils in it for which the hologram is not optimised.
    pupil : float
        Diameter of the pupils.
    pupils : int
        Number of pupils that the hologram is optimised for: one in the middle, others at random places of an area 1.3
        times as high and wide as the eyebox.
    focus : float or tuple of float, optional
        Distance on which these eyes are focused; two of them, with a comma, for the nearest and the furthest.
    """

    views: str | None = option(None, metavar="FOLDER|FILE")
    mesh: str | None = option(None, metavar="FILE")
    splats: str | None = option(None, metavar="FILE")
    turned: tuple[float, float, float] = option((0.0, 0.0, 0.0), metavar="X Y Z")
    sides: int = option(9, metavar="COUNT", check=at_least(1))
    plane: float | None = length(None, shown="that of the modulator")
    eyebox: float | tuple[float, float] = length(2e-3, parse=parse_pair, metavar=PAIR)
    pupil: float = length(3e-3)
    pupils: int = option(9, metavar="COUNT", check=at_least(1))
    focus: float | tuple[float, float] | None = length(
        None, parse=parse_pair, metavar=PAIR, shown="that of the modulator"
    )

    @property
    def scene(self) -> str | None:
        """The kind of scene that eyes look at, None without one."""
        return next((name for name in SCENES if getattr(self, name) is not None), None)

    @property
    def scene_path(self) -> Path:
        """File or folder of the scene."""
        return Path(os.path.expanduser(getattr(self, str(self.scene)))).absolute()

    def values(self, *without: str) -> dict[str, Any]:
        """Return the settings by name, but for some, and but for those of eyes where there is no scene."""
        of_eyes = [] if self.scene is not None else [item.name for item in fields(EyesSettings)]
        return super().values(*without, *of_eyes)

    def check_scene(self) -> None:
        """Raise InputError unless there is one scene at most, which exists, and options of eyes have an effect."""
        chosen = [option_name(name) for name in SCENES if getattr(self, name) is not None]
        if len(chosen) > 1:
            raise InputError(f"{' and '.join(chosen)} are scenes: give one of them")
        rendered = {"turned", "sides"}
        of_eyes = {"plane", "eyebox", "pupil", "pupils", "focus", *rendered}
        for name in sorted(self.given & (rendered if self.scene == "views" else set() if chosen else of_eyes)):
            needed = "--mesh or --splats" if name in rendered else "--views, --mesh or --splats"
            raise InputError(f"{option_name(name)} has no effect without {needed}")
        if chosen and not self.scene_path.exists():
            raise InputError(f"{chosen[0]} must exist, got {str(self.scene_path)!r}")
        for name, words in (("images", "IMAGE"), ("cluster", "--cluster"), ("watch", "--watch")):
            if chosen and name in self.given:
                raise InputError(f"{words} has no effect with {chosen[0]}, which is the picture")
