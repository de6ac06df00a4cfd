"""Elements, beams, pupils and polarised fields as tensors, by the formulas of :mod:`odak.wave`."""

from typing import TYPE_CHECKING

import torch

from odak.learn._face import face_of, torch_face
from odak.wave import beams, elements, imaging, polarized, recording
from odak.wave.transfer_functions import pitches

if TYPE_CHECKING:
    from odak.learn._faces.wave_elements import *  # noqa: F403

_SINGLE = {"Returns": "torch.Tensor\n    complex64 ``[nx, ny]``."}


def _to_single(core, **arguments) -> torch.Tensor:
    return core(**arguments).to(torch.complex64)


if not TYPE_CHECKING:
    aspheric_lens_phase = torch_face(elements.aspheric_lens_phase)
    axicon_phase = torch_face(elements.axicon_phase)
    blazed_grating = torch_face(elements.blazed_grating, through=_to_single, describe=_SINGLE)
    circular_aperture = torch_face(elements.circular_aperture)
    cylindrical_lens_phase = torch_face(elements.cylindrical_lens_phase)
    dammann_grating = torch_face(elements.dammann_grating)
    double_convergence = torch_face(elements.double_convergence, through=_to_single, describe=_SINGLE)
    fresnel_zone_plate = torch_face(elements.fresnel_zone_plate)
    lens_phase = torch_face(elements.lens_phase)
    linear_grating = torch_face(elements.linear_grating, defaults={"add": None})
    metalens_phase = torch_face(elements.metalens_phase)
    prism_grating = torch_face(elements.prism_grating, through=_to_single, describe=_SINGLE)
    prism_phase_function = torch_face(elements.prism_phase_function, through=_to_single, describe=_SINGLE)
    rectangular_aperture = torch_face(elements.rectangular_aperture)
    spiral_phase = torch_face(elements.spiral_phase)
    zernike_basis = torch_face(elements.zernike_basis)
    zernike_phase = torch_face(elements.zernike_phase)

    airy_beam = torch_face(beams.airy_beam)
    beam_quality = torch_face(beams.beam_quality)
    beam_width = torch_face(beams.beam_width)
    bessel_beam = torch_face(beams.bessel_beam)
    fibre_coupling = torch_face(beams.fibre_coupling)
    flat_top_beam = torch_face(beams.flat_top_beam)
    gaussian_beam = torch_face(beams.gaussian_beam)
    hermite_gaussian_beam = torch_face(beams.hermite_gaussian_beam)
    laguerre_gaussian_beam = torch_face(beams.laguerre_gaussian_beam)
    mode_overlap = torch_face(beams.mode_overlap)
    power_in_bucket = torch_face(beams.power_in_bucket)

    pupil_function = torch_face(imaging.pupil_function)
    reference_wave = torch_face(recording.reference_wave)
    q_plate = torch_face(polarized.q_plate)
    thin_film_transfer = torch_face(polarized.thin_film_transfer)

    @face_of(elements.quadratic_phase_function)
    def quadratic_phase_function(core, *, dx, **arguments):
        """Return the transmission of a thin lens, exp(−ik·r²/(2f)), converging for a positive focal length.

        Parameters
        ----------
        nx : int
            Rows.
        ny : int
            Columns.
        offset : sequence of float
            Shift of the lens in pixels: `offset[1]` along the first axis, `offset[0]` along the second.

        Returns
        -------
        torch.Tensor
            complex64 ``[nx, ny]``.

        Notes
        -----
        Along each axis of n samples the positions are as in earlier releases, linspace(−n·dx/2, n·dx/2, n): the step is
        n·dx/(n − 1) and the axis of the lens lies at the index (n − 1)/2. Applied to a field of pitch `dx`, whose axis
        is at the index n // 2, the element is thus a lens of the focal length f·((n − 1)/n)², half a pixel before the
        axis where n is even. ``torch.exp(1j * lens_phase(shape, focal, dx, wavelength))`` is the lens on the grid of a
        field, centred.

        Examples
        --------
        The phase is −k·r²/(2f), here at a corner at r² = 2·(2·1e-4)²:

        >>> import torch
        >>> from odak.learn.wave import quadratic_phase_function, wavenumber
        >>> lens = quadratic_phase_function(5, 5, wavenumber(1e-6), focal=1.0, dx=8e-5)
        >>> round(lens[0, 0].angle().item(), 4), round(-float(wavenumber(1e-6)) * 8e-8 / 2, 4)
        (-0.2513, -0.2513)
        """
        # The core returns columns first.
        return _to_single(core, dx=pitches(dx)[::-1], **arguments).T
