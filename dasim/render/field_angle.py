"""Diffraction off the axis: the in-focus pattern is wider, the geometric blur stays round.

From a place of the sensor at the field angle theta the stop looks foreshortened, and the sensor is tilted to the light.
A stop of height rho has the optical path rho T u / s to a place u beside the geometric image, s the image distance,
with T = diag(cos^3 theta, cos theta) in tangential and sagittal direction: the pattern in focus is that of the axis at
T u, wider by 1 / cos^3 and 1 / cos. Defocus has the path rho T rho c / (2 s A) for a blur of diameter c and a lens of
diameter A, so that the rays of the blur land where they do on the axis.

With t the tangent of the field angle as a vector in the picture, T v = cos (v - t (t v) cos^2).

Tested in tests/dasim/render/test_field_angle.py.
"""

from __future__ import annotations

from typing import Any


def _square_of_cosine(tangent: Any) -> Any:
    import drjit as dr

    return dr.rcp(1 + dr.squared_norm(tangent))


def foreshortened(v: Any, tangent: Any) -> Any:
    """T v: where the axis' pattern has what lies at ``v`` off the axis."""
    import drjit as dr

    square = _square_of_cosine(tangent)
    return (v - tangent * (dr.dot(tangent, v) * square)) * dr.sqrt(square)


def widened(v: Any, tangent: Any) -> Any:
    """The inverse, T^-1 v = (v + t (t v)) / cos: where something of the axis' pattern lies off the axis."""
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
