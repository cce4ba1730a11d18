"""Sweep of balls among the cells of a grid: exact, by a walk through the cells on the line.

Lengths are in edges of a cell, from the lower corner of the grid. In each cell a word marks the
cells of the 27 around it that can be touched first: a neighbour across an edge counts only where
neither of the two across its faces is rock, for one of those is nearer, and so on. A ball smaller
than a cell is then tested on its piece of line in that cell against planes, edges and
corners of that cell.
"""

import math

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.segments import segment_box

_STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], np.int64)
"""[27, 3] of the neighbour whose bit is the row's number."""
_CENTRE_BIT = 13
_FACE_BITS = (4, 10, 12, 14, 16, 22)


def _allowed_masks() -> np.ndarray:
    """Return words [64] of neighbours that can be touched from near some of the faces.

    Bit 2 n of the index: near the lower face along axis n; bit 2 n + 1: near the upper one.
    """
    masks = np.zeros(64, np.int64)
    for near in range(64):
        for bit, step in enumerate(_STEPS):
            sides = [2 * n + (1 if step[n] > 0 else 0) for n in range(3) if step[n]]
            if all(near >> side & 1 for side in sides):
                masks[near] |= 1 << bit
    return masks


_ALLOWED = _allowed_masks()
_SURE = sum(1 << bit for bit in (_CENTRE_BIT, *_FACE_BITS))
"""Neighbours that any ball near to their faces touches."""
_CORNER = np.maximum(_STEPS, 0).astype(np.float64)
"""[27, 3] corner of the cell that the neighbour begins at."""
_USED = np.abs(_STEPS).astype(np.float64)
"""[27, 3] 1 for the axes that count."""
_BIT_OF_REMAINDER = np.full(37, -1, np.int64)
"""Which bit a word of one bit has set, by its remainder."""
_BIT_OF_REMAINDER[[(1 << bit) % 37 for bit in range(27)]] = np.arange(27)


@compile_function
def _touches_neighbour(
    word: int, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, r: float
) -> bool:
    """Return whether a ball moving within one cell, in its coordinates, meets a neighbour."""
    near = (
        (min(x0, x1) <= r)
        | (max(x0, x1) >= 1.0 - r) << 1
        | (min(y0, y1) <= r) << 2
        | (max(y0, y1) >= 1.0 - r) << 3
        | (min(z0, z1) <= r) << 4
        | (max(z0, z1) >= 1.0 - r) << 5
    )
    remaining = word & _ALLOWED[near]
    if remaining == 0:
        return False
    if remaining & _SURE:
        return True
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    while remaining != 0:
        bit = _BIT_OF_REMAINDER[(remaining & -remaining) % 37]
        remaining &= remaining - 1
        ux, uy, uz = _USED[bit, 0], _USED[bit, 1], _USED[bit, 2]
        wx = (x0 - _CORNER[bit, 0]) * ux
        wy = (y0 - _CORNER[bit, 1]) * uy
        wz = (z0 - _CORNER[bit, 2]) * uz
        ex, ey, ez = dx * ux, dy * uy, dz * uz
        square = ex * ex + ey * ey + ez * ez
        if square > 0.0:
            s = min(max(-(wx * ex + wy * ey + wz * ez) / square, 0.0), 1.0)
            wx, wy, wz = wx + s * ex, wy + s * ey, wz + s * ez
        if wx * wx + wy * wy + wz * wz <= r * r:
            return True
    return False


@compile_function
def _window_touches(
    cells: np.ndarray,
    at: tuple[int, int, int],
    reach: int,
    segment: tuple[float, float, float, float, float, float],
    r: float,
) -> bool:
    """Return whether a ball of any size, swept along its whole line, meets rock near one cell."""
    ax, ay, az, dx, dy, dz = segment
    for i in range(max(at[0] - reach, 0), min(at[0] + reach + 1, cells.shape[1])):
        for j in range(max(at[1] - reach, 0), min(at[1] + reach + 1, cells.shape[2])):
            for k in range(max(at[2] - reach, 0), min(at[2] + reach + 1, cells.shape[3])):
                if cells[1, i, j, k] == 0:
                    gap = segment_box(
                        ax, ay, az, dx, dy, dz, i, j, k, i + 1.0, j + 1.0, k + 1.0
                    )  # fmt: skip
                    if gap <= r * r:
                        return True
    return False


@compile_function
def ball_touches(cells: np.ndarray, x: float, y: float, z: float, r: float) -> bool:
    """Return whether a ball inside the grid meets rock."""
    i = min(max(int(x), 0), cells.shape[1] - 1)
    j = min(max(int(y), 0), cells.shape[2] - 1)
    k = min(max(int(z), 0), cells.shape[3] - 1)
    if r < 1.0:
        word = cells[0, i, j, k]
        if word == 0:
            return False
        x, y, z = x - i, y - j, z - k
        return _touches_neighbour(word, x, y, z, x, y, z, r)
    reach = int(r) + 1
    if cells[1, i, j, k] > reach:
        return False
    return _window_touches(cells, (i, j, k), reach, (x, y, z, 0.0, 0.0, 0.0), r)


@compile_function
def _cell_crossing(start: float, delta: float, at: int) -> tuple[float, float, int]:
    """Return where a coordinate leaves its cell, the step to the next cell, and its sign.

    Positions are fractions of the line.
    """
    if delta > 0.0:
        return (at + 1.0 - start) / delta, 1.0 / delta, 1
    if delta < 0.0:
        return (at - start) / delta, -1.0 / delta, -1
    return math.inf, math.inf, 0


@compile_function
def swept_ball_touches(
    cells: np.ndarray,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    r: float,
) -> bool:  # fmt: skip
    """Return whether a ball of radius r that goes from a to b inside the grid meets rock.

    ``cells`` are of `cell_map.build_cell_map`.
    """
    nx, ny, nz = cells.shape[1], cells.shape[2], cells.shape[3]
    i = min(max(int(ax), 0), nx - 1)
    j = min(max(int(ay), 0), ny - 1)
    k = min(max(int(az), 0), nz - 1)
    dx, dy, dz = bx - ax, by - ay, bz - az
    out_x, step_x, sign_x = _cell_crossing(ax, dx, i)
    out_y, step_y, sign_y = _cell_crossing(ay, dy, j)
    out_z, step_z, sign_z = _cell_crossing(az, dz, k)
    reach = int(r) + 1
    s = 0.0
    while True:
        leave = min(out_x, out_y, out_z)
        end = min(leave, 1.0)
        if r < 1.0:
            word = cells[0, i, j, k]
            if word != 0:
                ox, oy, oz = ax - i, ay - j, az - k
                if _touches_neighbour(
                    word,
                    ox + s * dx, oy + s * dy, oz + s * dz,
                    ox + end * dx, oy + end * dy, oz + end * dz,
                    r,
                ):  # fmt: skip
                    return True
        elif cells[1, i, j, k] <= reach and _window_touches(
            cells, (i, j, k), reach, (ax, ay, az, dx, dy, dz), r
        ):
            return True
        if leave >= 1.0:
            return False
        s = leave
        if out_x == leave:
            i += sign_x
            out_x += step_x
            if i < 0 or i >= nx:
                return False
        elif out_y == leave:
            j += sign_y
            out_y += step_y
            if j < 0 or j >= ny:
                return False
        else:
            k += sign_z
            out_z += step_z
            if k < 0 or k >= nz:
                return False


@compile_function
def point_gap(cells: np.ndarray, x: float, y: float, z: float, max_gap: float) -> float:
    """Return the distance of a point to the nearest rock, at most ``max_gap``."""
    nx, ny, nz = cells.shape[1], cells.shape[2], cells.shape[3]
    i = min(max(int(x), 0), nx - 1)
    j = min(max(int(y), 0), ny - 1)
    k = min(max(int(z), 0), nz - 1)
    # What lies n rings off is at least n - 1 cells and the way to the cell's own nearest face away.
    side = min(x - i, i + 1.0 - x, y - j, j + 1.0 - y, z - k, k + 1.0 - z)
    ring = cells[1, i, j, k]
    last = max(nx, ny, nz)
    while ring <= last:
        if ring - 1.0 + max(side, 0.0) >= max_gap:
            break
        for u in range(max(i - ring, 0), min(i + ring + 1, nx)):
            for v in range(max(j - ring, 0), min(j + ring + 1, ny)):
                shell = u == i - ring or u == i + ring or v == j - ring or v == j + ring
                w = k - ring
                while w <= k + ring:
                    if 0 <= w < nz and cells[1, u, v, w] == 0:
                        gx = max(u - x, 0.0, x - u - 1.0)
                        gy = max(v - y, 0.0, y - v - 1.0)
                        gz = max(w - z, 0.0, z - w - 1.0)
                        max_gap = min(max_gap, math.sqrt(gx * gx + gy * gy + gz * gz))
                    w += 1 if shell or ring == 0 else 2 * ring
        ring += 1
    return max_gap
