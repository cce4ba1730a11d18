"""Which cells of a survey a robot sees: range, cone, and lines between points that meet no rock.

Rounding in float32 can turn what is close: each question has two answers, whether it is so for sure
and whether it can be so.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee.geometry import Floats, rotate

NEAR_M = 1e-5
"""Distances to the end of the range and to the face of the cone that rounding can turn."""
NEAR_CELLS = 1e-4
"""The same of a line to the edge of a cell, in cells."""

type Flags = NDArray[np.bool_]
type Cells = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Eye:
    """What a robot sees with, and the rock that hides things from it."""

    half_angle_rad: float
    range_m: float
    occupied: Flags
    """[nx, ny, nz]"""
    low_m: Floats
    """[3] lower corner of the grid."""
    edge_m: float


def seen(eye: Eye, p: Floats, q: Floats, cells: Cells) -> tuple[Flags, Flags]:
    """Return which cells [n, 3] a robot sees for sure, and which it can see, bool [n] each.

    Args:
        eye: of the robot.
        p: [3] its position in W.
        q: [4] its attitude, wxyz.
        cells: [n, 3] indices.
    """
    way = eye.low_m + eye.edge_m * (cells + 0.5) - p
    length = np.linalg.norm(way, axis=1)
    spare = eye.range_m - length
    if eye.half_angle_rad < np.pi - 1e-3:
        down = -rotate(q, np.array([0.0, 0.0, 1.0]))
        spare = np.minimum(spare, way @ down - np.cos(eye.half_angle_rad) * length)
    sure, can = spare > NEAR_M, spare >= -NEAR_M
    asked = np.flatnonzero(can)
    is_hidden, can_be_hidden = hidden(eye.occupied, (p - eye.low_m) / eye.edge_m, cells[asked])
    sure[asked] &= ~can_be_hidden
    can[asked] &= ~is_hidden
    return sure, can


def hidden(occupied: Flags, begin: Floats, cells: Cells) -> tuple[Flags, Flags]:
    """Return whether rock lies on the lines to centres of cells, for sure, and whether it can.

    A line is cut at every plane between cells; the middles of the pieces say which cells it
    crosses. The cell in which a line begins hides nothing.

    Args:
        occupied: bool [nx, ny, nz].
        begin: [3] where the lines begin, in cells from the grid's lower corner.
        cells: [n, 3] where they end.
    """
    way = cells + 0.5 - begin
    planes = np.arange(max(occupied.shape) + 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cuts = (planes - begin[:, None]) / way[:, :, None]
    cuts = np.where((cuts > 0.0) & (cuts < 1.0), cuts, 1.0)
    cuts = cuts.reshape(len(cells), 3 * len(planes))
    cuts = np.sort(np.pad(cuts, ((0, 0), (1, 0))), axis=1)
    piece = np.diff(cuts, axis=1) * np.linalg.norm(way, axis=1, keepdims=True)
    own = np.floor(begin)

    def rock(points: Floats) -> Flags:
        at = np.floor(points)
        inside = np.clip(at, 0, np.array(occupied.shape) - 1).astype(int)
        met: Flags = occupied[tuple(np.moveaxis(inside, -1, 0))] & np.any(at != own, axis=-1)
        return met

    def point(share: Floats) -> Floats:
        points: Floats = begin + share[..., None] * way[:, None, :]
        return points

    middles = rock(point(0.5 * (cuts[:, 1:] + cuts[:, :-1])))
    is_hidden = np.any(middles & (piece > NEAR_CELLS), axis=1)
    can_be_hidden = np.any(middles & (piece > 0.0), axis=1)
    corners = np.stack(np.meshgrid(*3 * [[-NEAR_CELLS, NEAR_CELLS]], indexing="ij"), -1)
    for corner in corners.reshape(-1, 3):
        can_be_hidden |= np.any(rock(point(cuts[:, 1:-1]) + corner) & (cuts[:, 1:-1] < 1.0), axis=1)
    return is_hidden, can_be_hidden
