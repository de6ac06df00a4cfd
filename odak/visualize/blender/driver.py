"""Draws and renders a scene inside Blender: reads data, runs none of it.

    python driver.py SCENE.json OUTPUT                                       with a Python that has the package bpy
    blender --background --python driver.py -- SCENE.json OUTPUT             with the program

OUTPUT ends in .png, .exr, .blend or .raw (float32 red, green, blue, opacity, from the lower left corner). This file
stands alone: it needs Blender 3.4 or later, with the NumPy that comes with it, and nothing besides.
"""

import json
import math
import os
import sys
import traceback
import warnings
from typing import Any

import numpy as np

HERE = os.path.dirname(os.path.abspath(__file__))
# Files of this folder must not be imported in place of modules of Blender that have the same names.
sys.path[:] = [path for path in sys.path if os.path.abspath(path or os.getcwd()) != HERE]

if __name__ == "__main__":
    import bpy
    import mathutils

COLOR = "odak_color"
# Nodes of the kinds of material, and which entries their inputs take.
SHADERS: Any = {
    "diffuse": ("ShaderNodeBsdfDiffuse", {}),
    "emission": ("ShaderNodeEmission", {"Strength": "strength"}),
    "glass": ("ShaderNodeBsdfGlass", {"IOR": "index", "Roughness": "roughness"}),
    "metal": ("ShaderNodeBsdfPrincipled", {"Roughness": "roughness"}),
}
# The matt edge of a lens.
GROUND = {"material": {"name": "ground edge", "kind": "diffuse", "color": (0.55, 0.58, 0.6)}, "colors": None}
UNITS = {"m": "METERS", "mm": "MILLIMETERS", "um": "MICROMETERS", "nm": "MICROMETERS"}
# Since then curves can be made from Python.
CURVES = (4, 2, 0)
# Number of emitting faces up to which they are sampled directly: lists of millions take minutes to prepare.
MOST_SAMPLED = 5000
GPUS = ("CUDA", "OPTIX", "HIP", "ONEAPI", "METAL")


def main(arguments: Any) -> None:
    """Write the file that the command line asks for."""
    if len(arguments) != 2:
        raise SystemExit(__doc__)
    # Blender 5 warns of settings that version 6 removes; older versions need them.
    warnings.filterwarnings("ignore", category=DeprecationWarning)
    path, output = (os.path.abspath(argument) for argument in arguments)
    with open(path, encoding="utf-8") as stream:
        document = json.load(stream)
    store = os.path.join(os.path.dirname(path), os.path.basename(document["arrays"]))
    with np.load(store, allow_pickle=False) as arrays:
        scene = build(document, arrays)
    produce(scene, document["render"], output)


def say(words: Any) -> None:
    """Print a line for the process that started this one."""
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


def build(document: Any, arrays: Any) -> Any:
    """Return Blender's scene with all objects, lights and cameras."""
    if document["start_from"]:
        bpy.ops.wm.open_mainfile(filepath=document["start_from"], load_ui=False, use_scripts=False)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for name in document["remove"]:
        if name in bpy.data.objects:
            bpy.data.objects.remove(bpy.data.objects[name], do_unlink=True)
    scene.unit_settings.system = "METRIC"
    scene.unit_settings.scale_length = document["metres"]
    scene.unit_settings.length_unit = UNITS[document["unit"]]
    for entry in document["objects"]:
        add_object(scene, entry, arrays)
    for number, entry in enumerate(document["lights"]):
        add_light(scene, f"light {number}", entry, document["metres"])
    if document["camera"]:
        add_camera(scene, document["camera"])
    if document["background"]:
        set_background(scene, document["background"])
    set_quality(scene, document["render"])
    return scene


def add_object(scene: Any, entry: Any, arrays: Any) -> None:
    """Add one object."""
    image = make_image(entry, arrays) if entry["image"] else None
    material = make_material(entry, image)
    shape = make_rods(scene, entry, arrays) if entry["rods"] and bpy.app.version >= CURVES else make_mesh(entry, arrays)
    if not hasattr(shape, "polygons") or len(shape.polygons) > MOST_SAMPLED:
        do_not_sample(material)
    shape.materials.append(material)
    if entry.get("ground") and hasattr(shape, "polygons"):
        shape.materials.append(make_material(GROUND, None))
        count = len(shape.polygons)
        shape.polygons.foreach_set("material_index", np.int32(np.arange(count) >= count - entry["ground"]))
    thing = bpy.data.objects.new(entry["name"], shape)
    thing.location, thing.scale = entry["location"], entry["scale"]
    thing.rotation_euler = [math.radians(angle) for angle in entry["rotation"]]
    if hasattr(thing, "visible_shadow"):
        thing.visible_shadow = entry["shadow"]
    scene.collection.objects.link(thing)


def make_mesh(entry: Any, arrays: Any) -> Any:
    """Return a mesh of triangles."""
    points, faces = arrays[entry["vertices"]], arrays[entry["faces"]]
    count = len(faces)
    mesh = bpy.data.meshes.new(entry["name"])
    mesh.vertices.add(len(points))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    if bpy.app.version < (3, 6, 0):
        mesh.polygons.foreach_set("loop_total", np.full(count, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.full(count, bool(entry["smooth"])))
    if entry["uv"]:
        mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", arrays[entry["uv"]][faces].ravel())
    if entry["colors"]:
        light = opaque(arrays[entry["colors"]])
        mesh.attributes.new(COLOR, "FLOAT_COLOR", "POINT").data.foreach_set("color", light)
    mesh.update(calc_edges=True)
    if entry["normals"]:
        if hasattr(mesh, "use_auto_smooth"):
            mesh.use_auto_smooth = True
        mesh.normals_split_custom_set_from_vertices(arrays[entry["normals"]].tolist())
    return mesh


def opaque(light: Any) -> Any:
    """Return red, green, blue and an opacity of 1, flat."""
    return np.insert(np.float32(light), 3, 1.0, axis=-1).ravel()


def make_rods(scene: Any, entry: Any, arrays: Any) -> Any:
    """Return rods as curves, which Cycles intersects in closed form, within boxes that lie along them."""
    rods = arrays[entry["rods"]]
    count = len(rods)
    curves = bpy.data.hair_curves.new(entry["name"])
    curves.add_curves([2] * count)
    curves.position_data.foreach_set("vector", rods[..., :3].ravel())
    curves.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", rods[..., 3].ravel())
    if entry["colors"]:
        light = arrays[entry["colors"]]
        light = opaque(light[:: len(light) // count])
        curves.attributes.new(COLOR, "FLOAT_COLOR", "CURVE").data.foreach_set("color", light)
    scene.cycles_curves.shape = "THICK"
    return curves


def do_not_sample(material: Any) -> None:
    """Exclude an emitting object from the direct sampling of light sources."""
    if hasattr(material.cycles, "emission_sampling"):
        material.cycles.emission_sampling = "NONE"
    else:
        material.cycles.sample_as_light = False


def make_image(entry: Any, arrays: Any) -> Any:
    """Return a picture."""
    levels = arrays[entry["image"]]
    image = bpy.data.images.new(entry["name"], levels.shape[1], levels.shape[0], alpha=False)
    image.colorspace_settings.name = "sRGB"
    image.pixels.foreach_set(opaque(levels[::-1] / 255))
    image.update()
    image.pack()
    return image


def new_material(name: Any) -> Any:
    """Return a material without nodes, and the nodes and links of its tree."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree.nodes, material.node_tree.links


def make_material(entry: Any, image: Any) -> Any:
    """Return a material of nodes."""
    data = entry["material"]
    material, nodes, links = new_material(data["name"] or entry["name"])
    kind, sockets = SHADERS[data["kind"]]
    node = nodes.new(kind)
    color = node.inputs["Base Color" if data["kind"] == "metal" else "Color"]
    color.default_value = (*data["color"], 1.0)
    for socket, key in sockets.items():
        node.inputs[socket].default_value = data[key]
    if data["kind"] == "metal":
        node.inputs["Metallic"].default_value = 1.0
    if image is not None:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image, picture.extension = image, "EXTEND"
        links.new(picture.outputs["Color"], color)
    elif entry["colors"]:
        attribute = nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = COLOR
        links.new(attribute.outputs["Color"], color)
    links.new(node.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def place(thing: Any, entry: Any) -> None:
    """Set location and orientation of a camera or a light; both look along their own −z."""
    right, up, behind = entry["axes"]
    rows = [[right[i], up[i], behind[i], entry["location"][i]] for i in range(3)]
    # A plain list would be read column by column.
    thing.matrix_world = mathutils.Matrix([*rows, [0.0, 0.0, 0.0, 1.0]])


def add_camera(scene: Any, entry: Any) -> None:
    """Add the camera."""
    camera = bpy.data.cameras.new("camera")
    camera.sensor_fit = "HORIZONTAL"
    if entry["projection"] == "orthographic":
        camera.type, camera.ortho_scale = "ORTHO", entry["width"]
    else:
        camera.angle = math.radians(entry["fov"])
    camera.clip_start, camera.clip_end = entry["clip"]
    thing = bpy.data.objects.new("camera", camera)
    place(thing, entry)
    scene.collection.objects.link(thing)
    scene.camera = thing


def add_light(scene: Any, name: Any, entry: Any, metres: Any) -> None:
    """Add a light, its power scaled so that distances in units of length act as distances in metres."""
    light = bpy.data.lights.new(name, entry["kind"].upper())
    light.color = entry["color"]
    if entry["kind"] == "sun":
        light.energy = entry["power"]
    else:
        light.energy = entry["power"] / metres**2
    if entry["kind"] == "area":
        light.size = entry["size"]
        if bpy.app.version < (4, 0, 0):
            # Older versions took an area light as isotropic: radiance P/(4A), not P/(πA).
            light.energy *= 4 / math.pi
    elif entry["kind"] == "point":
        light.shadow_soft_size = entry["size"] / 2
    else:
        light.angle = 0.0
    thing = bpy.data.objects.new(name, light)
    thing.visible_camera = entry.get("visible", True)
    place(thing, entry)
    scene.collection.objects.link(thing)


def set_background(scene: Any, entry: Any) -> None:
    """Set the environment: one colour, or a gradient of greys along a direction."""
    world = bpy.data.worlds.new("background")
    world.use_nodes = True
    node = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    node.inputs["Color"].default_value = (*entry["color"], 1.0)
    node.inputs["Strength"].default_value = entry["strength"]
    if entry.get("gradient"):
        nodes, links = world.node_tree.nodes, world.node_tree.links
        where, along, share, ramp = (
            nodes.new(name)
            for name in ("ShaderNodeTexCoord", "ShaderNodeVectorMath", "ShaderNodeMapRange", "ShaderNodeValToRGB")
        )
        along.operation = "DOT_PRODUCT"
        along.inputs[1].default_value = entry["gradient"]["up"]
        share.inputs["From Min"].default_value = -1.0
        links.new(where.outputs["Generated"], along.inputs[0])
        links.new(along.outputs["Value"], share.inputs["Value"])
        links.new(share.outputs[0], ramp.inputs["Fac"])
        stops = entry["gradient"]["stops"]
        elements = ramp.color_ramp.elements
        while len(elements) < len(stops):
            elements.new(1.0)
        for element, (sine, grey) in zip(elements, stops):  # noqa: B905 (Python of Blender 3.4)
            element.position, element.color = (sine + 1) / 2, (grey, grey, grey, 1.0)
        links.new(ramp.outputs["Color"], node.inputs["Color"])
    scene.world = world


def set_quality(scene: Any, job: Any) -> None:
    """Set renderer, resolution and the encoding of light as pixel values."""
    if "cycles" not in bpy.context.preferences.addons:
        import addon_utils

        addon_utils.enable("cycles")
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    render.resolution_y, render.resolution_x = job["resolution"]
    render.resolution_percentage = 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0
    render.use_file_extension = False
    render.film_transparent = bool(job["transparent"]) or job["what"] == "depth"
    render.dither_intensity = 0.0
    cycles.samples, cycles.seed = job["samples"], job["seed"]
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = bool(job["denoise"])
    if cycles.use_denoising:
        try:
            cycles.denoiser = "OPENIMAGEDENOISE"
        except TypeError:
            cycles.use_denoising = False
            say("odak: this Blender has no denoiser; the image is not denoised")
    cycles.max_bounces = cycles.transmission_bounces = cycles.transparent_max_bounces = 24
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    choose_device(cycles, job["device"])


def choose_device(cycles: Any, wanted: Any) -> None:
    """Select the device of Cycles, with a message where it is not available."""
    cycles.device = "CPU"
    if wanted == "cpu":
        return
    preferences = bpy.context.preferences.addons["cycles"].preferences
    for kind in GPUS if wanted in ("auto", "gpu") else (wanted.upper(),):
        try:
            preferences.compute_device_type = kind
            preferences.get_devices()
        except (TypeError, ValueError):
            # This Blender was built without that kind.
            continue
        found = [device for device in preferences.devices if device.type == kind]
        if found:
            for device in preferences.devices:
                device.use = device.type == kind
            cycles.device = "GPU"
            say(f"device {kind}: {', '.join(device.name for device in found)}")
            return
    if wanted != "auto":
        say(f"odak: there is no device for {wanted!r}; the CPU renders")


def produce(scene: Any, job: Any, output: Any) -> None:
    """Write the output file."""
    extension = os.path.splitext(output)[1].lower()
    if extension == ".blend":
        bpy.ops.wm.save_as_mainfile(filepath=output, compress=True, check_existing=False)
        return
    if job["what"] == "depth":
        measure_depth(scene)
    target = output if extension != ".raw" else output + ".exr"
    settings = scene.render.image_settings
    settings.file_format = "PNG" if extension == ".png" else "OPEN_EXR"
    settings.color_mode = "RGBA" if scene.render.film_transparent or extension == ".raw" else "RGB"
    settings.color_depth = "8" if extension == ".png" else "32"
    scene.render.filepath = target
    if bpy.app.version >= (5, 0, 0):
        # It no longer reports its progress by itself.
        bpy.app.handlers.render_stats.append(lambda words, *_: say(words))
    bpy.ops.render.render(write_still=True)
    if extension == ".raw":
        image = bpy.data.images.load(target)
        pixels = np.empty(len(image.pixels), dtype=np.float32)
        image.pixels.foreach_get(pixels)
        pixels.tofile(output)


def measure_depth(scene: Any) -> None:
    """Make every surface emit its distance along the camera's axis, sampled in the middle of each pixel."""
    material, nodes, links = new_material("depth")
    seen, shine, output = (
        nodes.new(name) for name in ("ShaderNodeCameraData", "ShaderNodeEmission", "ShaderNodeOutputMaterial")
    )
    links.new(seen.outputs["View Z Depth"], shine.inputs["Color"])
    links.new(shine.outputs[0], output.inputs["Surface"])
    for layer in scene.view_layers:
        layer.material_override = material
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    scene.render.filter_size = 0.01


def run() -> None:
    """Run the command and exit at once: some versions of Blender crash during their clean-up."""
    code = 0
    try:
        main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    except Exception:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    run()
