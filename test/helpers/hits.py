"""Intersections of rays with single surfaces as `Hit`, piece by piece, from the closed forms."""

from odak.raytracing import intersections as forms
from odak.raytracing.batches import in_pieces


def _hit(form, ranks, *arrays):
    return in_pieces(lambda *a: forms.as_hit(form(*a)), ranks, *arrays)


def plane(start, direction, point, normal):
    return _hit(forms.plane, (1, 1, 1, 1), start, direction, point, normal)


def sphere(start, direction, centre, radius):
    return _hit(forms.sphere, (1, 1, 1, 0), start, direction, centre, radius)


def cylinder(start, direction, centre, radius, axis):
    return _hit(forms.cylinder, (1, 1, 1, 0, 1), start, direction, centre, radius, axis)


def conic(start, direction, curvature, constant, aperture=None):
    def hit(*arrays):
        found, sheet = forms.conic(*arrays)
        return forms.as_hit(found, forms.conic_status(found, sheet))

    return in_pieces(hit, (1, 1, 0, 0, 0), start, direction, curvature, constant, aperture)
