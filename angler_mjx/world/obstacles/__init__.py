"""Bodies that are not cells: explicit and drawn obstacles, still, drifting or scripted.

The face of the obstacle modules: what an obstacle is (`obstacle_types`), what the water does to its
shape (`obstacle_bodies`), how it moves (`obstacle_motion`), what a file may ask for
(`obstacle_config`) and how one world's obstacles are drawn (`obstacle_drawing`).
"""

from angler_mjx.world.obstacles.config import ObstaclesConfig
from angler_mjx.world.obstacles.motion import reset, step
from angler_mjx.world.obstacles.sampling import draw
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
    "ObstacleState",
    "Obstacles",
    "ObstaclesConfig",
    "bounding_radius",
    "draw",
    "reset",
    "step",
]
