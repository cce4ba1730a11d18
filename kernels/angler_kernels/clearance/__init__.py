"""Exact distances between the shapes that hulls, cells and obstacles are made of."""

from angler_kernels.clearance.grid import capsules_grid, point_grid
from angler_kernels.clearance.reference import (
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

__all__ = [
    "BOX",
    "CAPSULE",
    "SPHERE",
    "capsules_capsules",
    "capsules_grid",
    "capsules_obstacle",
    "point_box",
    "point_grid",
    "segment_box",
    "segment_oriented_box",
    "segment_point",
    "segment_segment",
]
