"""Obstacles beside the grid's cells: explicit and sampled, static, drifting or scripted.

Public names of the package: arrays of obstacles (`types`), their drag in water (`bodies`), their
motion (`motion`), their tables in files (`config`) and the sampling of one world's (`sampling`).
"""

from angler_mjx.world.obstacles.config import ObstaclesConfig
from angler_mjx.world.obstacles.motion import (
    drift_freely,
    follow_script,
    keep_within,
    reset,
    step,
)
from angler_mjx.world.obstacles.sampling import DriftingSampler, sample_obstacles
from angler_mjx.world.obstacles.types import (
    BOX,
    CAPSULE,
    CIRCLE,
    DRIFT,
    SINE,
    SPHERE,
    STATIC,
    STRAIGHT,
    Obstacles,
    ObstacleState,
    bounding_radius,
)

__all__ = [
    "BOX",
    "CAPSULE",
    "CIRCLE",
    "DRIFT",
    "SINE",
    "SPHERE",
    "STATIC",
    "STRAIGHT",
    "DriftingSampler",
    "ObstacleState",
    "Obstacles",
    "ObstaclesConfig",
    "bounding_radius",
    "drift_freely",
    "follow_script",
    "keep_within",
    "reset",
    "sample_obstacles",
    "step",
]
