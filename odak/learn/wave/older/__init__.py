"""Functions of earlier releases, which compute holograms without a display as an object.

They keep the defaults and results of their releases and name their successors. Iterations, starts, schedules,
encodings, transfer functions and bounds are those of the newer modules, which import none of these: where both are
asked for the same, alternating projections find the same patterns and descent by L-BFGS patterns of one quality; the
fields of :class:`propagator` are those of :meth:`Display.fields` to 3e-4, which computes small panels on larger grids.
What stays here is what a display does not compute to 1e-6:

- `single_plane`: pixels that are points, batches of pictures, targets of a given brightness, Adam at a constant rate,
  a camera in the loop, a range of phases below 2π, lenses of points, smoothing before the double-phase encoding
- `volume`, `propagators`: pixels that are points or of several samples, impulse responses, incoherent light and
  Fraunhofer's methods, wavelengths and pitches with gradients, fields that are not padded, powers by cosines
- `multiplane`: patterns that stay double phase, a step for each plane in turn
- `multi_color`, `terms`: losses of the sources, of the eyebox and of the pattern, a learned amplitude
- `eyebox`: pixels that are points, some places of the pupil in each step
- `kernels`: transfer functions as results, and the Fresnel field of free points
"""

from odak._lazy import attach

# The names belong to odak.learn.wave, which lists them.
__getattr__, __dir__, _ = attach(__name__, __file__)
