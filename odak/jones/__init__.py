"""Polarisation: Jones vectors and matrices, Stokes vectors and Mueller matrices, the polarisation ellipse.

Conventions of every function here and in ``odak.learn.jones``:

- Light propagates along +z, in a right-handed frame (x, y, z). Its field is Re[J·exp(i(kz − ωt))]: a longer optical
  path adds a *positive* phase, as everywhere in odak.
- A Jones vector is a column: fields are ``[..., 2, k]``, k of them side by side. A matrix is ``[..., 2, 2]``, a Stokes
  vector ``[..., 4, k]``, a Mueller matrix ``[..., 4, 4]``. Leading axes are batches and broadcast.
- Angles and retardances are in degrees. An angle runs from x towards y: counter-clockwise for an observer who looks
  at the oncoming light.
- The field of right-handed light rotates clockwise for that observer (Born and Wolf; Hecht), so (1, −i)/√2 is
  right and (1, i)/√2 left circular. The IEEE names are the other way round.
- S0 = |Ex|² + |Ey|², S1 = |Ex|² − |Ey|², S2 = 2·Re(Ex·Ey*), S3 = 2·Im(Ex·Ey*): S3 > 0 is right-handed.
- Precision follows the arrays given: float32 and complex64 give complex64. Plain numbers give complex128.

Sources: R. C. Jones, J. Opt. Soc. Am. 31, 488 (1941); M. Born and E. Wolf, Principles of Optics (1999), sections 1.4
and 10.9; D. Goldstein, Polarized Light (2011).
"""

from odak._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
