"""Squared distances of segments to points, segments and boxes: compiled, in scalars of float64.

A segment is a start (ax, ay, az) and the vector (dx, dy, dz) to its end; a vector of zero is
a point.
"""

from angler_mjx.planning.host.compiled.compiling import compile_function


@compile_function
def segment_point(
    ax: float, ay: float, az: float, dx: float, dy: float, dz: float,
    px: float, py: float, pz: float,
) -> float:  # fmt: skip
    """Return the squared distance of a segment to the point p."""
    wx, wy, wz = ax - px, ay - py, az - pz
    square = dx * dx + dy * dy + dz * dz
    s = 0.0
    if square > 0.0:
        s = min(max(-(wx * dx + wy * dy + wz * dz) / square, 0.0), 1.0)
    wx, wy, wz = wx + s * dx, wy + s * dy, wz + s * dz
    return wx * wx + wy * wy + wz * wz


@compile_function
def segment_segment(
    ax: float, ay: float, az: float, dx: float, dy: float, dz: float,
    bx: float, by: float, bz: float, ex: float, ey: float, ez: float,
) -> float:  # fmt: skip
    """Return the squared distance of a segment to the segment from b along e.

    The least is at an end of one of the two, or where the lines' common normal stands on both.
    """
    best = min(
        segment_point(bx, by, bz, ex, ey, ez, ax, ay, az),
        segment_point(bx, by, bz, ex, ey, ez, ax + dx, ay + dy, az + dz),
        segment_point(ax, ay, az, dx, dy, dz, bx, by, bz),
        segment_point(ax, ay, az, dx, dy, dz, bx + ex, by + ey, bz + ez),
    )
    nx, ny, nz = dy * ez - dz * ey, dz * ex - dx * ez, dx * ey - dy * ex
    det = nx * nx + ny * ny + nz * nz
    if det > 0.0:
        gx, gy, gz = bx - ax, by - ay, bz - az
        s = ((gy * ez - gz * ey) * nx + (gz * ex - gx * ez) * ny + (gx * ey - gy * ex) * nz) / det
        t = ((gy * dz - gz * dy) * nx + (gz * dx - gx * dz) * ny + (gx * dy - gy * dx) * nz) / det
        if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
            x, y, z = gx + t * ex - s * dx, gy + t * ey - s * dy, gz + t * ez - s * dz
            best = min(best, x * x + y * y + z * z)
    return best


@compile_function
def _distance_outside(x: float, lo: float, hi: float) -> float:
    """Return the distance below (negative) or above the interval; 0 within."""
    return min(x - lo, 0.0) + max(x - hi, 0.0)


@compile_function
def segment_box(
    ax: float, ay: float, az: float, dx: float, dy: float, dz: float,
    lx: float, ly: float, lz: float, hx: float, hy: float, hz: float,
) -> float:  # fmt: skip
    """Return the squared distance of a segment to the box from l to h; 0 where they meet.

    Half the derivative of the squared distance along the segment grows and is piecewise linear; it
    bends only where the line passes a plane of the box. Between the last bend where it is negative
    and the first where it is not, one step of Newton finds its zero.
    """
    left, right = 0.0, 1.0
    for i in range(6):
        if i < 2:
            start, delta, plane = ax, dx, lx if i == 0 else hx
        elif i < 4:
            start, delta, plane = ay, dy, ly if i == 2 else hy
        else:
            start, delta, plane = az, dz, lz if i == 4 else hz
        if delta == 0.0:
            continue
        s = (plane - start) / delta
        if left < s < right:
            slope = (
                dx * _distance_outside(ax + s * dx, lx, hx)
                + dy * _distance_outside(ay + s * dy, ly, hy)
                + dz * _distance_outside(az + s * dz, lz, hz)
            )
            if slope < 0.0:
                left = s
            else:
                right = s
    s = 0.5 * (left + right)
    x, y, z = (
        _distance_outside(ax + s * dx, lx, hx),
        _distance_outside(ay + s * dy, ly, hy),
        _distance_outside(az + s * dz, lz, hz),
    )
    curvature = 0.0
    curvature += dx * dx if x != 0.0 else 0.0
    curvature += dy * dy if y != 0.0 else 0.0
    curvature += dz * dz if z != 0.0 else 0.0
    if curvature > 0.0:
        s = min(max(s - (dx * x + dy * y + dz * z) / curvature, left), right)
        x, y, z = (
            _distance_outside(ax + s * dx, lx, hx),
            _distance_outside(ay + s * dy, ly, hy),
            _distance_outside(az + s * dz, lz, hz),
        )
    return x * x + y * y + z * z
