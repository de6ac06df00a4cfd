"""Every propagation, kernel and single-plane hologram function of the PyTorch face, under the path users know."""

from odak.learn.wave.direct_holograms import point_wise, shift_w_double_phase
from odak.learn.wave.gradient_descent import stochastic_gradient_descent
from odak.learn.wave.kernels import (
    get_angular_spectrum_kernel,
    get_band_limited_angular_spectrum_kernel,
    get_impulse_response_fresnel_kernel,
    get_incoherent_angular_spectrum_kernel,
    get_propagation_kernel,
    get_seperable_impulse_response_fresnel_kernel,
    get_transfer_function_fresnel_kernel,
)
from odak.learn.wave.light_kernels import get_light_kernels, get_point_wise_impulse_response_fresnel_kernel
from odak.learn.wave.phase_retrieval import gerchberg_saxton
from odak.learn.wave.propagation import (
    impulse_response_fresnel,
    propagate_beam,
    seperable_impulse_response_fresnel,
)
from odak.wave.classical import (
    adaptive_sampling_angular_spectrum,
    angular_spectrum,
    band_extended_angular_spectrum,
    band_limited_angular_spectrum,
    custom,
    fraunhofer,
    fraunhofer_equal_size_adjust,
    fraunhofer_inverse,
    gerchberg_saxton_3d,
    incoherent_angular_spectrum,
    rayleigh_sommerfeld,
    rayleigh_sommerfeld_sum,
    transfer_function_fresnel,
)

__all__ = [
    "adaptive_sampling_angular_spectrum",
    "angular_spectrum",
    "band_extended_angular_spectrum",
    "band_limited_angular_spectrum",
    "custom",
    "fraunhofer",
    "fraunhofer_equal_size_adjust",
    "fraunhofer_inverse",
    "gerchberg_saxton",
    "gerchberg_saxton_3d",
    "get_angular_spectrum_kernel",
    "get_band_limited_angular_spectrum_kernel",
    "get_impulse_response_fresnel_kernel",
    "get_incoherent_angular_spectrum_kernel",
    "get_light_kernels",
    "get_point_wise_impulse_response_fresnel_kernel",
    "get_propagation_kernel",
    "get_seperable_impulse_response_fresnel_kernel",
    "get_transfer_function_fresnel_kernel",
    "impulse_response_fresnel",
    "incoherent_angular_spectrum",
    "point_wise",
    "propagate_beam",
    "rayleigh_sommerfeld",
    "rayleigh_sommerfeld_sum",
    "seperable_impulse_response_fresnel",
    "shift_w_double_phase",
    "stochastic_gradient_descent",
    "transfer_function_fresnel",
]
