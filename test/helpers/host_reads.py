"""Code of odak.learn that reads numbers from a device, which waits for all work queued there: reasons, and a search."""

import ast
from fnmatch import fnmatchcase
from pathlib import Path

import structure

import odak

FOLDER = Path(odak.__file__).parent / "learn"
# "module: functions" that may read numbers, by the reason why they must. Messages of errors, texts (`__repr__`) and
# random numbers, which are drawn on the CPU, need none.
REASONS = {
    "files, figures and reports are made by the processor": """
        perception/quality: _pooled eccentricity_report
        wave/displays/display: from_calibration
        wave/holograms/result: save
        raytracing/mesh: read_PLY save_heights_as_PLY write_PLY
        raytracing/system/automatic: automatic_design record
        raytracing/system/design: report
        raytracing/system/drawing: *
        raytracing/system/sketches: *
        raytracing/system/limits: *
        raytracing/system/system_files: *
        raytracing/system/codev: *
        raytracing/system/oslo: *
        raytracing/system/zemax: *
        raytracing/system/zooms: settings
        tools/file: *
        tools/function: __array__
        tools/models: fit
        raytracing/system/prescriptions: _view of
        raytracing/system/waves: _view field_modulation field_quality relative_illumination
        wave/holograms/result: _view
        wave/holograms/eyeboxes: *
        wave/holograms/eye_reports: *
        wave/pictures: _view
        wave/gaussians/sets: _points save_splats
        tools/iterations: go iterate minimise
        wave/training: fingerprint
        wave/display_models: capture count display_camera fit_display of registration
    """,
    "an argument is refused, or its kind decides on the way, once per call": """
        models/hologram_networks: _planes
        perception/dithering: _shown
        perception/eyesight: ocular_modulation_transfer
        perception/flicker: sequence_loss
        perception/gaze: __post_init__ fixations simulate_gaze
        perception/display_color: _checked_axis individual_cone_fundamentals metameric_failure spectrum_to_xyz
        perception/metameric: _metamer
        perception/quality: _require_positive
        raytracing/system/analysis: paraxial_points
        raytracing/system/automatic: _image_height _is_correctable _what_varies glasses standard_design standard_limits
        raytracing/system/design: __init__ _now
        raytracing/system/operands: glass_hull nearest_glasses
        raytracing/system/environment: expanded_system tell_unknown
        raytracing/system/eye: _traced_terms
        raytracing/system/lens_fields: __init__ _checked _traced passage
        raytracing/system/image_simulation: _chief _response point_spread_map
        raytracing/system/optimise: _deviated _dispersed _irregular_shapes iso_10110_tolerances
        raytracing/system/paraxial: _check_forward _near_reach ghost_system medium met seidel_sums
        raytracing/system/films: __post_init__ _between reflects
        raytracing/system/polarisation: _ghost jones_vector ghosts
        raytracing/system/pupils: _far real_places
        raytracing/system/specification: checked_fields checked_settings number_or_infinity plain
        raytracing/system/surfaces: _any _image _optional is_off_axis vary
        raytracing/system/waves: _derivatives _exit_pupil _length _sign exit_field
        raytracing/mesh: _checked_faces _checked_vertices components
        raytracing/nonsequential: __post_init__ _plain _reach polarized result system_elements trace
        tools/matrix: quantize slice_rgbd_targets
        tools/transformation: quaternion_to_rotation_matrix
        wave/displays/display: _amplitudes _lit_by_points
        wave/displays/panels: __post_init__ phases_of
        wave/displays/sources: __post_init__
        wave/displays/parts: frames_lit
        wave/displays/paths/base: nearness
        wave/displays/paths/retina: nearness
        wave/holograms/bounds: least_error_of_band least_error_of_light tell_bounds
        wave/holograms/optimising: optimise
        wave/pictures: _primaries _sources light_of
        wave/holograms/starts: starting_phases
        wave/holograms/targets: checked_target
        wave/older/eyebox: eyebox_hologram
        wave/eyes: __post_init__ angles_of_each of_each seen within
        wave/gaussians/scene: chosen
        wave/gaussians/sets: prune
        wave/loss: _checked_geometry _checked_picture
        wave/older/terms: eyebox_mask
        wave/older/propagators: _set_powers is_diagonal
        wave/training: check_brightness checked_intensities started
    """,
    "the size of the result, or the memory that it takes, depends on the numbers": """
        models/gaussians: _compact_runs
        perception/foveation: __init__ _strips level_weights
        perception/quality: _split
        perception/csf: foveated_budget
        perception/pooled_model: _overlapping _windows
        raytracing/boundary: intersect_w_triangle_batch
        raytracing/mesh: _faces init_heights
        raytracing/surfaces: intersect_parametric
        raytracing/system/eye: _radial_transfer
        raytracing/system/lens_fields: _products
        raytracing/system/pupils: _clear_parts pupil_quadrature
        raytracing/system/waves: _grid
        tools/transformation: load_voxelized_PLY point_cloud_to_voxel
        wave/slm: turns_of
        wave/gaussians/splatting: _groups _rounds choose_tiling
        wave/loss: geometric_targets
    """,
    "what was kept from an earlier call is compared with what is needed": """
        perception/csf: _sensitivities
    """,
    "numbers of NumPy or constants, which are on the CPU": """
        raytracing/system/crystals: of
        raytracing/system/solids: *
        perception/appearance: _planckian_locus
        perception/color: _column rows tone_map
        perception/display_color: _checked _fundamentals read_spectra
        perception/pyramids: keep _quadrature_filters
        wave/displays/paths/free: renew
        wave/holograms/scenery: *
        wave/holograms/views: *
    """,
    "on the CPU only: an extreme that is read spares work there, and the device takes another way": """
        raytracing/boundary: _picked
        raytracing/system/fused: _intersect _is_onward _newton _on_sheet _run blocks work
        raytracing/mesh: embree_scene nearest_faces_by_embree
        raytracing/system/pupils: _key
        raytracing/system/tracing: _by_numpy
        tools/matrix: _gaussian_lines
        wave/older/propagators: holograms
    """,
    "a search ends when it has converged: one reading for an iteration of many operations": """
        raytracing/system/coatings: _cleaned _doubles _needles _refined needle_design
        models/gaussians: _improve refine
        perception/discrimination: __init__ maximum_differentiation twice
        perception/pyramids: _largest_share
        raytracing/nonsequential: follow
        raytracing/surfaces: _search plain
        raytracing/system/automatic: _optimised _set_next_stage _with_equal_spots grow
        raytracing/system/design: _take_glasses best_of restarts
        raytracing/system/eye: accommodation_response
        raytracing/system/optimise: _linearly_compensated _seeing_limits least_squares tolerances_for_yield
        raytracing/system/pupils: _chief_rays _continuation _differences _past_ends _search _solve
        raytracing/system/sequence: axis_signs
        raytracing/system/waves: _peak resolved strehl_ratio
        wave/display_models: _match_brightness _numbers match_gaps misfit
        wave/holograms/solvers/levels: _proposed _sweep step
        wave/holograms/solvers/sweeps: *
        tools/iterations: step
    """,
}
# Those whose syntax does not show it, such as `float(loss)`.
AT_RUN_TIME = {
    "wave/holograms/solvers/levels:step",
    "wave/holograms/solvers/levels:_sweep",
    "perception/discrimination:__init__",
    "models/gaussians:_improve",
    "models/gaussians:refine",
    "raytracing/system/lens_fields:_products",
    "raytracing/system/design:_now",
    "raytracing/system/optimise:tolerances_for_yield",
    "raytracing/system/polarisation:_ghost",
    "raytracing/system/surfaces:_image",
    "tools/transformation:load_voxelized_PLY",
    "tools/iterations:iterate",
    "tools/iterations:minimise",
    "tools/iterations:go",
}
_METHODS = {"item", "tolist", "cpu", "numpy"}
_CASTS = {"float", "int", "bool", "complex"}
# Methods whose result is an array: a cast or a condition of it reads a number.
_OF_ARRAYS = {
    "abs", "all", "amax", "amin", "any", "argmax", "argmin", "count_nonzero", "detach", "diff", "double", "isfinite",
    "max", "mean", "min", "norm", "prod", "sqrt", "square", "std", "sum",
}  # fmt: skip
_MODULES_OF_NUMBERS = {"math", "np", "numpy", "random"}
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
_CONDITIONS = (ast.If, ast.While, ast.IfExp, ast.Assert)
_TEXTS = {"__repr__", "__str__", "extra_repr"}


def permitted() -> list[str]:
    """Return the patterns "module:function" of :data:`REASONS`."""
    lines = [line.split(":") for text in REASONS.values() for line in text.split("\n") if line.strip()]
    return [f"{module.strip()}:{function}" for module, functions in lines for function in functions.split()]


def is_permitted(place: str) -> bool:
    """Say whether a function "module:function" may read numbers."""
    return any(fnmatchcase(place, pattern) for pattern in permitted())


def host_reads(folder: Path = FOLDER) -> set[str]:
    """Return "module:function" of the functions that visibly read numbers, by the syntax of a folder's modules.

    A cast or a condition is counted where it holds a call of torch or a method of arrays: what a bare name holds is not
    known before the code runs.
    """
    found = set()
    for path in folder.rglob("*.py"):
        module = path.relative_to(folder).with_suffix("").as_posix()
        pending: list[tuple[ast.AST, str]] = [(structure.tree(path), "<module>")]
        while pending:
            node, function = pending.pop()
            if isinstance(node, ast.Raise) or (isinstance(node, _FUNCTIONS) and node.name in _TEXTS):
                continue
            if isinstance(node, _FUNCTIONS):
                function = node.name
            elif isinstance(node, ast.Call):
                if _is_read(node):
                    found.add(f"{module}:{function}")
            elif isinstance(node, _CONDITIONS) and any(map(_is_reduction, _terms(node.test))):
                found.add(f"{module}:{function}")
            pending.extend((child, function) for child in ast.iter_child_nodes(node))
    return found


def _is_read(call: ast.Call) -> bool:
    if isinstance(call.func, ast.Attribute):
        return call.func.attr in _METHODS and not call.args and not _is_random(call.func.value)
    cast = isinstance(call.func, ast.Name) and call.func.id in _CASTS and bool(call.args)
    return cast and not _is_random(call.args[0]) and any(map(_is_array, ast.walk(call.args[0])))


def _terms(test):
    """Yield the parts of a condition that are joined by `and`, `or` and `not`."""
    parts = test.values if isinstance(test, ast.BoolOp) else [test.operand] if isinstance(test, ast.UnaryOp) else []
    for part in parts:
        yield from _terms(part)
    if not parts:
        yield test


def _is_reduction(node) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ("any", "all")


def _is_array(node) -> bool:
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
        return False
    owner = node.func.value.id if isinstance(node.func.value, ast.Name) else ""
    return owner == "torch" or (node.func.attr in _OF_ARRAYS and owner not in _MODULES_OF_NUMBERS)


def _is_random(node) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func).startswith("torch.rand")
