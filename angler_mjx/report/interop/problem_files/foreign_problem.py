"""A planning problem of another benchmark, in its own units and axes, as readers give it."""

from dataclasses import dataclass, field

import numpy as np

from angler_mjx.robot.importing.notes import Notes


@dataclass(frozen=True, kw_only=True)
class ForeignBox:
    """A box of a problem, its edges along the axes."""

    center: tuple[float, ...]
    size: tuple[float, ...]
    """Full edges."""


@dataclass(frozen=True, kw_only=True)
class ForeignProblem:
    """A problem in two or three dimensions; x and y as in W, z up."""

    name: str
    low: tuple[float, ...]
    """Lower corner of the region."""
    high: tuple[float, ...]
    start: np.ndarray
    """[robot, 2 or 3]."""
    goal: np.ndarray
    """[robot, 2 or 3]."""
    boxes: tuple[ForeignBox, ...] = ()
    cells: np.ndarray | None = None
    """Whether each cell, one unit long, is blocked: bool [nx, ny] or [nx, ny, nz]; None where the
    region has no cells."""
    notes: Notes = field(default_factory=Notes)

    @property
    def dimensions(self) -> int:
        """Number of dimensions, 2 or 3."""
        return len(self.low)
