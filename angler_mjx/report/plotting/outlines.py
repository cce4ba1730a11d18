"""Outlines of solid shapes seen along an axis: convex polygons for the maps."""

import numpy as np

from angler_mjx.world.obstacles import BOX, CAPSULE

_RIM = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def project_outline(
    kind: int, size_m: np.ndarray, p: np.ndarray, q: np.ndarray, axes: tuple[int, int]
) -> np.ndarray:
    """Return the outline of an obstacle seen along a world axis.

    Args:
        kind: of the obstacle, as in `Obstacles.kind`.
        size_m: [3], as in `Obstacles.size_m`.
        p: [3] centre, W.
        q: [4] attitude wxyz, body to W.
        axes: the two world axes of the figure, e.g. (0, 1) from above.

    Returns:
        Corners [n, 2] in the figure, anticlockwise.
    """
    flat = list(axes)
    rim = np.stack([np.cos(_RIM), np.sin(_RIM)], axis=1)
    if kind == BOX:
        corners = (_CORNERS * size_m) @ rotation_matrix(q).T
        return _convex_hull(p[flat] + corners[:, flat])
    if kind == CAPSULE:
        arm = rotation_matrix(q)[:, 2] * size_m[1]
        ends = np.concatenate([rim * size_m[0] + arm[flat], rim * size_m[0] - arm[flat]])
        return _convex_hull(p[flat] + ends)
    circle: np.ndarray = p[flat] + rim * size_m[0]
    return circle


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """Return the rotation matrix [3, 3] of a unit quaternion wxyz."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the convex hull of points [n, 2], anticlockwise (Andrew's monotone chain)."""
    ordered = points[np.lexsort((points[:, 1], points[:, 0]))]
    lower, upper = _hull_chain(ordered), _hull_chain(ordered[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _hull_chain(points: np.ndarray) -> list[np.ndarray]:
    chain: list[np.ndarray] = []
    for point in points:
        while len(chain) > 1 and _turn_direction(chain[-2], chain[-1], point) <= 0:
            chain.pop()
        chain.append(point)
    return chain


def _turn_direction(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
