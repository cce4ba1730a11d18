"""Scenario of a planning problem of another benchmark, and a list of what differs from it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path, parse_model
from angler_mjx.report.interop.problem_files import dynobench, moving_ai
from angler_mjx.report.interop.problem_files.foreign_problem import ForeignProblem
from angler_mjx.robot.importing.notes import Note
from angler_mjx.robot.importing.toml_text import format_tables
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.scenario import Scenario

MAX_CELLS = 128
"""Cells of a world along each axis."""
DEPTH_M = 2.0
"""Depth of the top of the region."""
CELL_M = 1.5
"""Edge of cells where the problem has none, at most."""
WALL_M = 1.0
"""Thickness of walls around a region that is no whole number of cells."""
_HORIZON_FACTOR, _HORIZON_MARGIN_S = 4.0, 60.0
"""Horizon: so many times the longest straight line, and more."""


@dataclass(frozen=True, kw_only=True)
class ImportedProblem:
    """Scenario of a problem."""

    scenario: Scenario
    text: str
    """TOML text, with the notes as comments."""
    notes: tuple[Note, ...]


def read_problem(
    path: Path, *, map_file: Path | None, robots: int | None, region: moving_ai.Region | None
) -> ForeignProblem:
    """Read a problem by the suffix of its file.

    Raises:
        ConfigError: the suffix is unknown, a flag does not fit it, or the file has a fault.
    """
    if path.suffix in moving_ai.SUFFIXES:
        if robots is None:
            raise ConfigError(f"{format_path(path)}: give --robots, the number of its rows to take")
        return moving_ai.read_problem(path, map_file=map_file, robots=robots, region=region)
    if path.suffix in dynobench.SUFFIXES:
        if map_file is not None or region is not None:
            raise ConfigError("--map and --region: are for MovingAI's files; leave them out")
        return dynobench.read_problem(path, robots=robots)
    suffixes = ", ".join((*moving_ai.SUFFIXES, *dynobench.SUFFIXES))
    raise ConfigError(f"{format_path(path)}: problems are read from {suffixes}")


def import_problem(
    path: Path,
    *,
    map_file: Path | None = None,
    robots: int | None = None,
    region: moving_ai.Region | None = None,
    scale_m: float = CELL_M,
    layers: int = 3,
    vehicle: str = "bluerov2_heavy",
) -> ImportedProblem:
    """Import a problem.

    Args:
        path: of the problem's file.
        map_file: map of MovingAI's files; the one that they name if None.
        robots: number of robots that are taken.
        region: part of a map.
        scale_m: metres of a unit of the file: a cell's edge, or a length of 1.
        layers: cells along z of problems in the plane, whose robots start in the middle.
        vehicle: name of a shipped vehicle, or path of a vehicle file.

    Raises:
        ConfigError: a fault of a file, or a problem that no world can hold.
    """
    if not 0.0 < scale_m <= 1000.0:
        raise ConfigError(f"--scale-m {scale_m:g}: must be above 0, at most 1000")
    if not 2 <= layers <= MAX_CELLS:
        raise ConfigError(f"--layers {layers}: must be 2 to {MAX_CELLS}")
    problem = read_problem(path, map_file=map_file, robots=robots, region=region)
    entry = parse_model(FleetEntry, {"vehicle": vehicle}, source="--vehicle")
    tables = _build_tables(problem, path, scale_m, layers, vehicle, entry.cruise_speed_mps)
    scenario = parse_model(Scenario, tables, source=f"{path} as a scenario")
    notes = tuple(problem.notes)
    lines = [f"# {path.name}, imported by `angler scenarios import`."]
    lines += [f"# {''.join(c if c.isprintable() else ' ' for c in str(note))}" for note in notes]
    return ImportedProblem(
        scenario=scenario, text="\n".join(lines) + "\n\n" + format_tables(tables), notes=notes
    )


def _build_tables(
    problem: ForeignProblem,
    path: Path,
    scale_m: float,
    layers: int,
    vehicle: str,
    speed_mps: float,
) -> dict[str, Any]:
    notes, planar = problem.notes, problem.dimensions == 2
    edges = scale_m * (np.array(problem.high) - np.array(problem.low))
    cell = scale_m if problem.cells is not None else _choose_cell(edges)
    # Along an axis that is no whole number of cells, the region is larger and gets walls.
    shape = [max(2, math.ceil(edge / cell - 1e-6)) for edge in edges] + [layers] * planar
    if max(shape) > MAX_CELLS:
        raise ConfigError(
            f"{format_path(path)}: takes {' x '.join(map(str, shape))} cells, a world has at most "
            f"{MAX_CELLS} along each axis; give --region"
        )
    notes.add("converted", f"lengths by {scale_m:g} m a unit (--scale-m)")
    if planar:
        notes.add("assumed", f"the plane is the middle of {layers} layers of {cell:g} m (--layers)")
    size = cell * np.array(shape, float)
    bottom = -DEPTH_M - size[2]
    middle = np.append(edges / 2, size[2] / 2) if planar else edges / 2
    offset = np.array([0.0, 0.0, bottom + size[2] / 2])

    def to_world(points: np.ndarray) -> np.ndarray:
        """Convert points [n, 2 or 3] of the problem to W, m."""
        metres = scale_m * (points - np.array(problem.low))
        if planar:
            metres = np.append(metres, np.full((len(metres), 1), middle[2]), axis=1)
        moved: np.ndarray = metres - middle + offset
        return moved

    start, goal = to_world(problem.start), to_world(problem.goal)
    boxes = [
        _box_table(
            to_world(np.array([box.center]))[0],
            np.append(scale_m * np.array(box.size), size[2] if planar else []),
        )
        for box in problem.boxes
    ]
    walls = _build_walls(edges if not planar else np.append(edges, size[2]), size, offset)
    if walls:
        notes.add("assumed", "walls where the region ends within a cell")
    horizon = _HORIZON_FACTOR * float(np.linalg.norm(goal - start, axis=1).max()) / speed_mps
    world: dict[str, Any] = {
        "preset": "open",
        "shape": shape,
        "cell_m": cell,
        "depth_m": DEPTH_M,
        "placement": "given",
        "clearance_m": 0.0,
        "start_m": [[round(float(x), 6) for x in row] for row in start],
        "goal_m": [[round(float(x), 6) for x in row] for row in goal],
    }
    if problem.cells is not None:
        world["rule"] = {"type": "cells", "layers": _format_layers(problem.cells, layers)}
    if boxes or walls:
        world["obstacles"] = {"explicit": boxes + walls}
    notes.add("dropped", f"shapes of robots: flown by {vehicle} (--vehicle)")
    letters = "".join(c if c.isalnum() and c.isascii() else "_" for c in problem.name.lower())
    return {
        "schema_version": 1,
        "name": letters.strip("_") or "problem",
        "description": f"Problem {''.join(c if c.isprintable() else ' ' for c in path.name)}",
        "worlds": 1,
        "seed": 1,
        "time": {"horizon_s": float(math.ceil(horizon + _HORIZON_MARGIN_S))},
        "world": world,
        "fleet": [{"vehicle": vehicle, "count": len(start)}],
    }


def _choose_cell(edges: np.ndarray) -> float:
    """Return an edge of cells of which the region's longest edge is a whole number, m."""
    longest = float(edges.max())
    return longest / max(2, math.ceil(longest / CELL_M))


def _box_table(position: np.ndarray, size: np.ndarray) -> dict[str, Any]:
    return {
        "type": "box",
        "position_m": [round(float(x), 6) for x in position],
        "size_m": [round(float(x), 6) for x in size],
    }


def _build_walls(edges: np.ndarray, size: np.ndarray, offset: np.ndarray) -> list[dict[str, Any]]:
    """Return walls between the region and the ends of the grid, where these differ.

    Args:
        edges: [3] of the region, m, in the middle of the grid.
        size: [3] of the grid, m.
        offset: [3] middle of the grid, W.
    """
    walls = []
    for axis in range(3):
        gap = 0.5 * (size[axis] - edges[axis])
        if gap < 1e-6:
            continue
        for side in (-1.0, 1.0):
            position = offset.copy()
            position[axis] += side * (0.5 * edges[axis] + 0.5 * (gap + WALL_M))
            wall = size + 2.0 * WALL_M
            wall[axis] = gap + WALL_M
            walls.append(_box_table(position, wall))
    return walls


def _format_layers(cells: np.ndarray, layers: int) -> list[dict[str, Any]]:
    """Return the layers of a map as scenario files have them, equal ones joined."""
    if cells.ndim == 2:
        return [{"rows": _format_rows(cells), "count": layers}]
    result: list[dict[str, Any]] = []
    for z in range(cells.shape[2]):
        rows = _format_rows(cells[:, :, z])
        if result and result[-1]["rows"] == rows:
            result[-1]["count"] += 1
        else:
            result.append({"rows": rows, "count": 1})
    return result


def _format_rows(cells: np.ndarray) -> list[str]:
    return ["".join("#" if cell else "." for cell in row) for row in cells.T[::-1]]
