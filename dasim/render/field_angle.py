"""Off-axis diffraction: the in-focus pattern is wider than on the axis, the geometric blur stays round.

Seen from a point of the sensor at the field angle theta, the stop is foreshortened, and its light reaches the sensor
obliquely. The optical path from a point rho of the stop to an offset u from the geometric image is rho T u / s, with
the image distance s and T = diag(cos^3 theta, cos theta) in the tangential and sagittal directions. The in-focus
pattern is therefore the on-axis pattern at T u, wider by 1 / cos^3 and 1 / cos. Defocus adds the path
rho T rho c / (2 s A) for a blur of diameter c and a lens of diameter A, so that blurred rays land where they do on the
axis.

With t the tangent of the field angle as a vector in the picture, T v = cos (v - t (t v) cos^2).

Tested in tests/dasim/render/test_field_angle.py.
"""

from __future__ import annotations

from typing import Any


def _square_of_cosine(tangent: Any) -> Any:
    import drjit as dr

    return dr.rcp(1 + dr.squared_norm(tangent))


def foreshortened(v: Any, tangent: Any) -> Any:
    """T v: the position in the on-axis pattern that corresponds to the off-axis position ``v``."""
    import drjit as dr

    square = _square_of_cosine(tangent)
    return (v - tangent * (dr.dot(tangent, v) * square)) * dr.sqrt(square)


def widened(v: Any, tangent: Any) -> Any:
    """The inverse, T^-1 v = (v + t (t v)) / cos: the off-axis position of a point ``v`` of the on-axis pattern."""
    import drjit as dr

    return (v + tangent * dr.dot(tangent, v)) * dr.rsqrt(_square_of_cosine(tangent))


def mean_scale(tangent: Any) -> Any:
    """Geometric mean of the two scales of T, cos^2."""
    return _square_of_cosine(tangent)


def scale_along(v: Any, tangent: Any) -> Any:
    """Scale |T v| / |v| of T in the direction of ``v``; that of the mean at the centre."""
    import drjit as dr

    length = dr.norm(v)
    return dr.select(length > 1e-6, dr.norm(foreshortened(v, tangent)) / length, mean_scale(tangent))
