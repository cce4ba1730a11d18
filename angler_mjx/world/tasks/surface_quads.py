"""The surface of a survey as squares, where its cells touch rock or the sea floor."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.history import TaskHistory
from angler_mjx.world.tasks.spec import Surface

_OUT = 0.48
"""Distance of a square from the middle of its cell, in cells."""


@dataclass(frozen=True, kw_only=True)
class SurfaceQuads:
    """Squares on faces of cells, a little on the water's side."""

    centre_m: np.ndarray
    """[n, 3] in W."""
    axis: np.ndarray
    """int [n] axis normal to each: 0 for x, 1 for y, 2 for z."""
    cell: np.ndarray
    """int [n] index of its cell among those of the survey, in the order of its array."""


def surface_quads(
    of: Surface,
    cells: np.ndarray,
    occupied: np.ndarray,
    origin_m: np.ndarray,
    cell_m: float,
    floor_z_m: float,
) -> SurfaceQuads:
    """Return the faces through which the cells of a survey touch its surface.

    Args:
        of: surveyed surface: for the floor, the lower faces of the lowest free cells; for rock, all
            faces behind which there is rock.
        cells: bool [nx, ny, nz] cells of the survey.
        occupied: bool [nx, ny, nz] rock.
        origin_m: [3] lower corner of the grid, in W.
        cell_m: edge of a cell.
        floor_z_m: height of the sea floor.
    """
    rock, number = np.pad(occupied, 1), np.cumsum(cells).reshape(cells.shape) - 1
    wanted, centres, axes, owners = np.argwhere(cells), [], [], []
    middle = origin_m[2] + cell_m * (np.arange(cells.shape[2]) + 0.5)
    ground = np.argmax(~occupied & (middle > floor_z_m), axis=2)
    for axis in range(3):
        for side in (-1, 1):
            step = side * np.eye(3, dtype=int)[axis]
            at = wanted + 1 + step
            touches = rock[at[:, 0], at[:, 1], at[:, 2]]
            if of == "floor":
                touches = np.zeros(len(wanted), bool)
            if of != "rock" and axis == 2 and side < 0:
                touches = touches | (wanted[:, 2] == ground[wanted[:, 0], wanted[:, 1]])
            touching = wanted[touches]
            centre = origin_m + cell_m * (touching + 0.5 + _OUT * step)
            if axis == 2 and side < 0:
                centre[:, 2] = np.maximum(centre[:, 2], floor_z_m + (0.5 - _OUT) * cell_m)
            centres.append(centre)
            axes.append(np.full(len(touching), axis))
            owners.append(number[touching[:, 0], touching[:, 1], touching[:, 2]])
    return SurfaceQuads(
        centre_m=np.concatenate(centres), axis=np.concatenate(axes), cell=np.concatenate(owners)
    )


def survey_surface(task: TaskHistory, environment: Environment) -> SurfaceQuads | None:
    """Return the surface of the survey of a world; None where its task is another."""
    if task.cells is None or task.spec.survey is None:
        return None
    grid = environment.grid
    return surface_quads(
        task.spec.survey.of,
        task.cells,
        np.asarray(grid.occupied),
        np.asarray(grid.origin_m),
        float(grid.cell_m),
        float(environment.floor_z_m),
    )
