"""Distances between segments, points and boxes, and rotations by quaternions: NumPy, float64.

Written for the referee alone, from the definitions, without the simulator's own distances.
Leading axes broadcast; the last one is x, y, z. Lengths in metres.
"""

import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.float64]


def rotate(q: Floats, v: Floats) -> Floats:
    """Rotate vectors v [..., 3] by quaternions q [..., 4] (wxyz), which are normalised first."""
    unit = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, axis = unit[..., :1], unit[..., 1:]
    twice: Floats = 2.0 * np.cross(axis, v)
    rotated: Floats = v + w * twice + np.cross(axis, twice)
    return rotated


def rotate_back(q: Floats, v: Floats) -> Floats:
    """Invert `rotate`."""
    conjugate: Floats = q * np.array([1.0, -1.0, -1.0, -1.0])
    return rotate(conjugate, v)


def segment_point(a: Floats, b: Floats, p: Floats) -> Floats:
    """Return the distance [...] of segments from a to b to points p; a = b is allowed."""
    return _length(a + _nearest_fraction(a, b, p)[..., None] * (b - a) - p)


def segment_segment(a: Floats, b: Floats, c: Floats, d: Floats) -> Floats:
    """Return the distance [...] of segments from a to b to segments from c to d.

    Two segments are nearest at an end of one of them, or where both lines have their common
    perpendicular; there the first one's line meets the plane of the second line and that
    perpendicular.
    """
    ends = [
        segment_point(a, b, c),
        segment_point(a, b, d),
        segment_point(c, d, a),
        segment_point(c, d, b),
    ]
    u, v = b - a, d - c
    plane = np.cross(v, np.cross(u, v))
    slope = _dot(u, plane)
    s = np.clip(_dot(c - a, plane) / np.where(slope > 0.0, slope, 1.0), 0.0, 1.0)
    inside = segment_point(c, d, a + s[..., None] * u)
    smallest: Floats = np.minimum.reduce([*ends, inside])
    return smallest


def segment_box(a: Floats, b: Floats, half: Floats) -> Floats:
    """Return the distance [...] of segments from a to b to boxes about the origin; 0 inside.

    Along a segment the squared distance is a parabola between any two of the six points where it
    crosses a plane of a face: the min of the seven parabolas' own minima is taken.

    Args:
        a: [..., 3].
        b: [..., 3].
        half: [..., 3] half the edges, along the axes.
    """
    a, b, half = np.broadcast_arrays(a, b, half)
    d = b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.concatenate([(half - a) / d, (-half - a) / d], axis=-1)
    cuts = np.clip(np.nan_to_num(crossings, nan=0.0), 0.0, 1.0)
    ones = np.ones((*cuts.shape[:-1], 1))
    cuts = np.sort(np.concatenate([0.0 * ones, cuts, ones], axis=-1), axis=-1)
    low, high = cuts[..., :-1], cuts[..., 1:]
    middle = a[..., None, :] + 0.5 * (low + high)[..., None] * d[..., None, :]
    side = np.where(np.abs(middle) > half[..., None, :], np.sign(middle), 0.0)
    # Beyond the face: side (a + s d) - half, of the axes that are outside in this stretch.
    rise = side * d[..., None, :]
    begin = side * a[..., None, :] - np.abs(side) * half[..., None, :]
    curve = np.sum(rise * rise, axis=-1)
    vertex = -np.sum(rise * begin, axis=-1) / np.where(curve > 0.0, curve, 1.0)
    s = np.clip(vertex, low, high)
    beyond = np.maximum(
        np.abs(a[..., None, :] + s[..., None] * d[..., None, :]), half[..., None, :]
    )
    gaps: Floats = np.min(_length(beyond - half[..., None, :]), axis=-1)
    return gaps


def _nearest_fraction(a: Floats, b: Floats, p: Floats) -> Floats:
    """Return the parameter [...] in [0, 1] of the point of a segment that is nearest to p."""
    d = b - a
    square = _dot(d, d)
    fraction: Floats = np.clip(_dot(p - a, d) / np.where(square > 0.0, square, 1.0), 0.0, 1.0)
    return fraction


def _dot(u: Floats, v: Floats) -> Floats:
    product: Floats = np.sum(u * v, axis=-1)
    return product


def _length(v: Floats) -> Floats:
    length: Floats = np.sqrt(_dot(v, v))
    return length
