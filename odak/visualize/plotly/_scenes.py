"""Pictures of three-dimensional scenes in rows and columns: their axes, cameras and sizes."""

from collections.abc import Sequence
from typing import Any

from odak import _validate
from odak._array import Array
from odak.visualize import _arrays
from odak.visualize.plotly import _checks, _layout
from odak.visualize.plotly._picture import Picture

SCENE_SIZE = (800, 700)
AXES = ("x", "y", "z")


class ScenePicture(Picture):
    """A picture whose settings tell the ``rows`` and ``columns`` of scenes, their ``labels`` and ``aspect ratio``."""

    def get_scene_number(self, row: int = 1, column: int = 1) -> int:
        """Return the number of a scene, counted row by row from 1.

        Raises
        ------
        ValueError
            If there is no such row or column.
        """
        for name, value, limit in (("row", row, self.settings["rows"]), ("column", column, self.settings["columns"])):
            if _validate.integer(name, value, minimum=1) > limit:
                raise ValueError(f"{name} must be 1 to {limit}, got {value}")
        return self.settings["columns"] * (row - 1) + column

    def set_axis_limits(
        self,
        row: int = 1,
        column: int = 1,
        x_limits: Any = (-1.0, 1.0),
        y_limits: Any = (-1.0, 1.0),
        z_limits: Any = (-1.0, 1.0),
    ) -> None:
        """Set the ranges of the axes of a scene."""
        limits = zip(AXES, (x_limits, y_limits, z_limits), strict=True)
        ranges = {f"{a}axis": {"range": _checks.numbers(f"{a}_limits", v, 2)} for a, v in limits}
        self._scene(row, column).update(ranges)

    def set_camera(
        self,
        row: int = 1,
        column: int = 1,
        x: float = 0.0,
        y: float = 0.0,
        z: float = 1.0,
        up: Array = None,
    ) -> None:
        """Set where the camera of a scene stands, in units of the scene, and which axis (x, y, z) points up."""
        camera = {"eye": {name: float(_validate.real(name, v)) for name, v in zip(AXES, (x, y, z), strict=True)}}
        if isinstance(up, str):
            up = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}[_validate.one_of("up", up, AXES)]
        if up is not None:
            camera["up"] = dict(zip(AXES, map(float, _checks.numbers("up", up, 3)), strict=True))
        self._scene(row, column).camera.update(camera)

    def show(self, aspect_ratio: Sequence[float] | str | None = None) -> str | None:
        """Show the picture, in the notebook or in a browser; never wait for a window.

        Parameters
        ----------
        aspect_ratio : sequence of float or str, optional
            Lengths of the x, y and z axes in all scenes; "data" draws all three to one scale. [1, 1, 1] by default.

        Returns
        -------
        str or None
            As :meth:`odak.visualize.plotly.plotshow.show`.
        """
        if aspect_ratio is not None:
            self.settings["aspect ratio"] = aspect_ratio
        return super().show()

    def save_offline(self, filename: Any = "plot.html") -> str:
        """Save the picture as a page, and return its ``<div>`` without plotly.js; as :meth:`save_html`."""
        return self.save_html(filename)

    def update_layout(self) -> None:
        """Bring the figure in line with its settings; showing and saving do this first."""
        settings, ratio = self.settings, self.settings["aspect ratio"]
        if isinstance(ratio, str):
            aspect = {"aspectmode": _validate.one_of("aspect_ratio", ratio, ("data", "cube", "auto"))}
        else:
            sides = _arrays.real_array("aspect_ratio", ratio).tolist()
            aspect = {"aspectmode": "manual", "aspectratio": dict(zip(AXES, sides, strict=True))}
        titles = {f"{a}axis": {"title": {"text": text}} for a, text in zip(AXES, settings["labels"], strict=True)}
        self.fig.update_scenes({**aspect, **titles})
        super().update_layout()
        _layout.place_scene_bars(self.fig)

    def image_size(self) -> tuple[float, float]:
        """Return width and height of images: those of the settings, or 800 × 700 for each scene."""
        settings = self.settings
        return (
            settings["width"] or SCENE_SIZE[0] * settings["columns"],
            settings["height"] or SCENE_SIZE[1] * settings["rows"],
        )

    def _scene(self, row: int, column: int):
        number = self.get_scene_number(row, column)
        return self.fig.layout["scene" if number == 1 else f"scene{number}"]

    def _add(self, trace, row: int, column: int) -> None:
        self.get_scene_number(row, column)
        self.fig.add_trace(trace, row=row, col=column)
