"""Visible cells of a survey: range, cone, and lines between points without rock.

Rounding in float32 can change close results: each question has two answers, certain and possible.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee.geometry import Floats, rotate

NEAR_M = 1e-5
"""Distances to the end of the range and to the face of the cone that rounding can change."""
NEAR_CELLS = 1e-4
"""Distance of a line to the edge of a cell that rounding can change, in cells."""

type Flags = NDArray[np.bool_]
type Cells = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Camera:
    """Camera of a robot, and the rock that hides objects from it."""

    half_angle_rad: float
    range_m: float
    occupied: Flags
    """[nx, ny, nz]"""
    low_m: Floats
    """[3] lower corner of the grid."""
    edge_m: float


def find_visible(eye: Camera, p: Floats, q: Floats, cells: Cells) -> tuple[Flags, Flags]:
    """Return the cells [n, 3] that a robot certainly sees, and possibly sees, bool [n] each.

    Args:
        eye: of the robot.
        p: [3] its position in W.
        q: [4] its attitude, wxyz.
        cells: [n, 3] indices.
    """
    offset_m = eye.low_m + eye.edge_m * (cells + 0.5) - p
    length = np.linalg.norm(offset_m, axis=1)
    margin = eye.range_m - length
    if eye.half_angle_rad < np.pi - 1e-3:
        down = -rotate(q, np.array([0.0, 0.0, 1.0]))
        margin = np.minimum(margin, offset_m @ down - np.cos(eye.half_angle_rad) * length)
    is_visible, can_be_visible = margin > NEAR_M, margin >= -NEAR_M
    candidates = np.flatnonzero(can_be_visible)
    is_hidden, can_be_hidden = find_hidden(
        eye.occupied, (p - eye.low_m) / eye.edge_m, cells[candidates]
    )
    is_visible[candidates] &= ~can_be_hidden
    can_be_visible[candidates] &= ~is_hidden
    return is_visible, can_be_visible


def find_hidden(occupied: Flags, begin: Floats, cells: Cells) -> tuple[Flags, Flags]:
    """Return whether rock certainly, and possibly, lies on the lines to centres of cells.

    A line is cut at every plane between cells; the middles of the pieces give the crossed cells.
    The first cell of a line hides nothing.

    Args:
        occupied: bool [nx, ny, nz].
        begin: [3] start of the lines, in cells from the grid's lower corner.
        cells: [n, 3] ends of the lines.
    """
    direction = cells + 0.5 - begin
    planes = np.arange(max(occupied.shape) + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cuts = (planes - begin[:, None]) / direction[:, :, None]
    cuts = np.where((cuts > 0.0) & (cuts < 1.0), cuts, 1.0)
    cuts = cuts.reshape(len(cells), 3 * len(planes))
    cuts = np.sort(np.pad(cuts, ((0, 0), (1, 0))), axis=1)
    piece = np.diff(cuts, axis=1) * np.linalg.norm(direction, axis=1, keepdims=True)
    start_cell = np.floor(begin)

    def is_rock(points: Floats) -> Flags:
        cell = np.floor(points)
        inside = np.clip(cell, 0, np.array(occupied.shape) - 1).astype(int)
        is_hit: Flags = occupied[tuple(np.moveaxis(inside, -1, 0))] & np.any(
            cell != start_cell, axis=-1
        )
        return is_hit

    def points_at(fraction: Floats) -> Floats:
        points: Floats = begin + fraction[..., None] * direction[:, None, :]
        return points

    middles = is_rock(points_at(0.5 * (cuts[:, 1:] + cuts[:, :-1])))
    is_hidden = np.any(middles & (piece > NEAR_CELLS), axis=1)
    can_be_hidden = np.any(middles & (piece > 0.0), axis=1)
    corners = np.stack(np.meshgrid(*3 * [[-NEAR_CELLS, NEAR_CELLS]], indexing="ij"), -1)
    for corner in corners.reshape(-1, 3):
        can_be_hidden |= np.any(
            is_rock(points_at(cuts[:, 1:-1]) + corner) & (cuts[:, 1:-1] < 1.0), axis=1
        )
    return is_hidden, can_be_hidden
