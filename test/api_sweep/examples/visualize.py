"""Valid arguments of odak.visualize, odak.manager and odak.cli."""

import numpy
from api_sweep.build import Build, field, numbers

from odak.tools import save_image

RAYS = numpy.stack([numbers(3, 3), numbers(3, 3, seed=4)], axis=1)
HEIGHTS = numbers(4, 5)


def written(name, write):
    """Return a sample: a file that `write` has put into an empty folder."""

    def build(folder):
        path = folder / name
        write(path)
        return path

    return Build(build)


def unwritten(name):
    """Return a sample: a file that does not exist yet."""
    return Build(lambda folder: folder / name)


def a_system():
    """Return a lens system."""
    from odak.learn.raytracing.system import load_system

    return load_system("cooke_triplet")


def a_plane(u, v):
    """Return points of a plane."""
    return u, v, 0 * u


PICTURE = written("a.png", lambda path: save_image(path, numbers(8, 8) * 255))
SPOTS = {
    "color": "red",
    "data_x": numbers(5),
    "data_y": numbers(4),
    "data_z": HEIGHTS,
    "distance": 2.0,
    "point": numbers(4, 3),
    "point0": numbers(3),
    "point1": numbers(3, seed=4),
    "point_end": numbers(4, 3, seed=4),
    "point_start": numbers(4, 3),
    "rays": RAYS,
    "sphere": numbers(4),
    "triangle": numbers(2, 3, 3),
    "triangles": numbers(2, 3, 3),
    "values": numbers(3, 3, 3),
    "vertices": numbers(4, 3),
    "faces": numpy.array([[0, 1, 2], [1, 2, 3]]),
}

BY_NAME = {
    "odak.visualize": {
        **SPOTS,
        "dash": "dot",
        "draw": lambda: numbers(4, 5),
        "dx": 8e-6,
        "field": numbers(6, 8),
        "filename": unwritten("a.html"),
        "image": numbers(6, 8),
        "k": 0.02,
        "label": "one",
        "opacity": 0.5,
        "points": numbers(2, 4, 3),
        "shape": [400, 300],
        "surface_color": HEIGHTS,
        "system": Build(lambda folder: a_system()),
        "up": "y",
        "wavelength": 532e-9,
    },
    "odak.cli": {"arguments": ["--version"]},
    "odak.manager.agent": {
        "compute": divmod,
        "cluster": False,
        "in_flight": 1,
        "args": [7, 2],
        "keywords": {},
        "verbose": False,
        "function": abs,
        "items": [1, -2],
        "shared": {},
        "host": "127.0.0.1",
        "trusted_network": False,
    },
    "odak.visualize.Exploration": {"values": {"x": (1, 2)}, "frames": [b"\x89PNG".ljust(24, b"\1")] * 2},
    "odak.visualize.PLY_object": {"color": [255, 0, 0]},
    "odak.visualize.blender": {
        "center": [0.0, 1.0, 2.0],
        "clip": [0.1, 100.0],
        "count": 3,
        "end": [0.0, 1.0, 2.0],
        "fov": 40.0,
        "image": numbers(4, 4, 3),
        "index": 1.5,
        "location": [1.0, 2.0, 3.0],
        "material": None,
        "points": numbers(4, 3),
        "power": 1.0,
        "radius": 0.5,
        "resolution": [16, 20],
        "rotation": [1.0, 2.0, 3.0],
        "scale": [1.0, 2.0, 3.0],
        "samples": 4,
        "segments": 8,
        "size": [1.0, 2.0],
        "start": [1.0, 1.0, 1.0],
        "strength": 1.0,
        "target": [0.0, 0.0, 0.0],
        "thickness": 0.2,
        "diameter": 1.0,
        "radii": [2.0, -2.0],
        "u": [0.0, 1.0],
        "v": [0.0, 1.0],
        "up": [0.0, 1.0, 0.0],
        "width": 2.0,
        "color": "white",
        "roughness": 0.1,
    },
}
BY_CALL = {
    "odak.visualize.blender.scene.add_light": {"size": 0.5},
    "odak.visualize.blender.scene.add_lines": {"points": numbers(2, 4, 3)},
    "odak.visualize.blender.scene.add_mesh": {"mesh": numbers(4, 3), "name": "a mesh"},
    "odak.visualize.blender.scene.add_surface": {"size": None, "surface": a_plane, "y": None, "z": None},
    "odak.visualize.plotly.detectorshow.add_field": {"field": field(6, 8)},
    "odak.visualize.plotly.field_show": {
        "field": field(6, 8),
        "quantities": ["amplitude", "phase"],
        "title": "a field",
        "labels": ["one"],
        "size": 200,
        "show": False,
    },
    "odak.visualize.plotly.plot2dshow": {
        "font_settings": {"size": 20},
        "xaxis_settings": {"visible": False},
        "yaxis_settings": {"visible": False},
    },
    "odak.visualize.plotly.plot2dshow.add_field": {
        "zoomed_inset": PICTURE,
        "zoomed_inset_settings": {"x": 0, "y": 3, "sizex": 3, "sizey": 3},
    },
    "odak.visualize.plotly.plotshow.add_plot": {"data_x": numbers(5), "data_y": numbers(5, seed=4)},
    "odak.visualize.plotly.rayshow.add_volume": {"points": numbers(27, 3), "values": numbers(27)},
    "odak.visualize.plotly.system_show": {"rings": 1, "title": "a system", "show": False},
}
for _name in ("detectorshow", "plot2dshow", "plotshow", "rayshow", "surfaceshow"):
    BY_CALL[f"odak.visualize.plotly.{_name}.save_markdown"] = {"filename": unwritten("a.md")}
SIDES = {}
FREE_TEXT = {"odak.visualize": {"label", "title"}}
NOT_CALLED = {
    **{
        f"odak.visualize.blender.{pattern}": "starts Blender, or works inside it"
        for pattern in (
            *(
                "check",
                "init",
                "delete_the_cube",
                "find_blender",
                "prepare",
                "quit",
                "render",
                "send_msg",
                "import_ply",
            ),
            *("libblend.[adis]*", "libblend.create_[cp]*", "libblend.clear_material", "driver*", "runner*", "server*"),
            *("scene.find", "scene.remove"),
            *("session*", "locate*", "cylinder_between", "scene.render*", "scene.save", "wrapper*", "scene.load"),
        )
    },
    "odak.visualize.PLY_object.save_*": "need a mesh that something is drawn in; they have tests of their own",
    "odak.visualize.plotly.*.save_image": "draws in a browser: seconds for each argument",
    "odak.visualize.plotly.close_browser": "closes the browser that other tests draw in",
    "odak.visualize.plotly.*.show": "opens a page",
    "odak.manager.make_certificates": "writes files once; its arguments have tests of their own",
    "odak.manager.[Ss]*erver*": "starts processes; its arguments have tests of their own",
}
ALLOWED = {
    ("odak.manager.agent", "host", "an unknown option"): "any name of a machine",
    ("odak.manager.agent", "security", "a text"): "a folder of certificates",
    ("odak.manager.agent.map", "items", "*"): "what the user's own function takes",
    ("odak.manager.agent.submit", "args", "*"): "what the user's own function takes",
    ("odak.visualize.blender.scene.add_*", "points", "* inside"): "documented: a line ends, a point is left out",
    ("odak.visualize.blender.scene.add_rays", "rays", "* inside"): "documented: rays that are not finite are left out",
    (
        "odak.visualize.blender.libblend.reflect_ray",
        "input_ray",
        "* inside",
    ): "the ray's start is not part of the result",
    ("odak.visualize.*", "label", "a number"): "curves may be named by numbers",
    ("odak.visualize.*", "title", "a number"): "pictures may be named by numbers",
    ("odak.visualize.plotly.*.add_s*", "mode", "*"): "documented: of no effect",
    ("odak.visualize.plotly.rayshow.add_sphere", "dash", "*"): "documented: of no effect",
    ("odak.visualize.plotly.rayshow.add_triangle", "dash", "*"): "documented: of no effect",
}
