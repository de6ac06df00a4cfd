"""Functions of position as tensors: Zernike polynomials."""

from odak.tools.zernike import noll_to_nm, osa_to_nm, zernike_norm, zernike_polynomial

__all__ = ["noll_to_nm", "osa_to_nm", "zernike_norm", "zernike_polynomial"]
