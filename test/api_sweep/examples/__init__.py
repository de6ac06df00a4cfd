"""Valid arguments of the public calls, one module for each part of the package.

A module may hold, each optional:

``BY_NAME``      {prefix of a path: {argument: valid value}}; the longest prefix wins
``BY_CALL``      {path: {argument: valid value}}, before any ``BY_NAME``
``NOT_CALLED``   {pattern of paths: reason}
``ALLOWED``      {(pattern of paths, pattern of arguments, pattern of wrong values): reason}, patterns as of fnmatch
``POSITIVE``     {prefix of a path: {arguments that must be above zero}}
``SIDES``        {prefix of a path: {arguments that are numbers of samples along an axis}}
``FREE_TEXT``    {prefix of a path: {arguments that take any text}}
``SLOW``         {paths that are swept with the slow tests}
"""

import importlib
import pkgutil


def _gathered(name):
    return {
        key: value
        for module in pkgutil.iter_modules(__path__)
        for key, value in getattr(importlib.import_module(f"{__name__}.{module.name}"), name, {}).items()
    }


BY_NAME = _gathered("BY_NAME")
BY_CALL = _gathered("BY_CALL")
NOT_CALLED = _gathered("NOT_CALLED")
ALLOWED = _gathered("ALLOWED")
POSITIVE = _gathered("POSITIVE")
FREE_TEXT = _gathered("FREE_TEXT")
SIDES = _gathered("SIDES")

# Calls that take longer than a quarter of a second with all their wrong arguments are swept with the slow tests; those
# that compute propagation and holograms are not among them.
SLOW = {
    "odak.learn.lensless.spec_track.forward",
    "odak.learn.lensless.spec_track.init_layers",
    "odak.learn.lensless.spec_track.load_weights",
    "odak.learn.lensless.spec_track.save_weights",
    "odak.learn.models.gaussian_2d.initialize_from_image",
    "odak.learn.models.gaussians_2d.initialize_from_image",
    "odak.learn.models.gaussians_2d.refine",
    "odak.learn.models.hologram_network.forward",
    "odak.learn.models.spatially_adaptive_unet.forward",
    "odak.learn.perception.SpatialSteerablePyramid.quadrature",
    "odak.learn.perception.display_color_hvs.initialize_random_spectrum_normalised",
    "odak.learn.perception.display_color_hvs.initialize_random_spectrum_normalized",
    "odak.learn.perception.metameric_failure",
    "odak.learn.perception.synthesize_texture",
    "odak.learn.perception.texture_statistics",
    "odak.learn.raytracing.intersect_parametric",
    "odak.learn.raytracing.system.accommodation_response",
    "odak.learn.raytracing.system.automatic_design",
    "odak.learn.raytracing.system.curved_paths",
    "odak.learn.raytracing.system.draw_layout",
    "odak.learn.raytracing.system.draw_spots",
    "odak.learn.raytracing.system.exit_field",
    "odak.learn.raytracing.system.fans_figure",
    "odak.learn.raytracing.system.needle_design",
    "odak.learn.raytracing.system.performance_figure",
    "odak.learn.raytracing.system.propagated_point_spread_function",
    "odak.learn.raytracing.system.pupil_figure",
    "odak.learn.raytracing.system.report_figures",
    "odak.learn.raytracing.system.simulate_image",
    "odak.learn.raytracing.system.through_focus_figure",
    "odak.learn.raytracing.system.tolerances_for_yield",
    "odak.learn.raytracing.system.zoom_design.linearised",
    "odak.learn.wave.Scene.render",
    "odak.learn.wave.Scene.splat",
    "odak.learn.wave.Scene.splat_tile",
    "odak.learn.wave.display_hologram",
    "odak.learn.wave.focal_surface_light_propagation.forward",
    "odak.learn.wave.focal_surface_light_propagation.load_weights",
    "odak.learn.wave.gerchberg_saxton",
    "odak.learn.wave.multi_color_hologram_optimizer",
    "odak.raytracing.intersect_parametric",
    "odak.visualize.blender.scene.add_system",
    "odak.visualize.plotly.detectorshow.add_field",
    "odak.visualize.plotly.detectorshow.save_html",
    "odak.visualize.plotly.field_show",
    "odak.visualize.plotly.plot2dshow.add_field",
    "odak.visualize.plotly.plot2dshow.save_html",
    "odak.visualize.plotly.plotshow",
    "odak.visualize.plotly.plotshow.add_2d_plot",
    "odak.visualize.plotly.plotshow.add_plot",
    "odak.visualize.plotly.rayshow",
    "odak.visualize.plotly.rayshow.add_line",
    "odak.visualize.plotly.rayshow.add_mesh",
    "odak.visualize.plotly.rayshow.add_rays",
    "odak.visualize.plotly.rayshow.add_sphere",
    "odak.visualize.plotly.rayshow.add_surface",
    "odak.visualize.plotly.rayshow.add_triangle",
    "odak.visualize.plotly.rayshow.add_volume",
    "odak.visualize.plotly.surfaceshow.save_html",
    "odak.visualize.plotly.system_show",
    "odak.wave.filter_in_focal_plane",
    "odak.wave.hologram_in_chunks",
    "odak.wave.propagate_on_disk",
    "odak.wave.propagate_partially_coherent",
}
