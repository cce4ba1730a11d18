"""Exact distances between the shapes of hulls, cells and obstacles."""

from angler_kernels.clearance.grid import capsules_grid, point_grid
from angler_kernels.clearance.neighbours import (
    capsules_neighbours,
    cell_neighbours,
    neighbour_window,
    point_neighbours,
)
from angler_kernels.clearance.shapes import (
    BOX,
    CAPSULE,
    SPHERE,
    capsules_capsules,
    capsules_obstacle,
    point_box,
    segment_box,
    segment_oriented_box,
    segment_point,
    segment_segment,
)
from angler_kernels.clearance.surface import point_surface, segment_surface

__all__ = [
    "BOX",
    "CAPSULE",
    "SPHERE",
    "capsules_capsules",
    "capsules_grid",
    "capsules_neighbours",
    "capsules_obstacle",
    "cell_neighbours",
    "neighbour_window",
    "point_box",
    "point_grid",
    "point_neighbours",
    "point_surface",
    "segment_box",
    "segment_oriented_box",
    "segment_point",
    "segment_segment",
    "segment_surface",
]
