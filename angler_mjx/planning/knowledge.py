"""What a planner may know of what moves: names of `angler_mjx.sim.knowledge`."""

from angler_mjx.sim.knowledge import (
    STEP_S,
    KnownCurrent,
    KnownObstacles,
    Knows,
    Level,
    Observation,
    current,
    obstacles,
)

__all__ = [
    "STEP_S",
    "KnownCurrent",
    "KnownObstacles",
    "Knows",
    "Level",
    "Observation",
    "current",
    "obstacles",
]
