"""Example scenes of a benchmark: read, and thinned out for the page."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import named
from angler_mjx.studies.benchmark.report.reading import Results

_PLANNED, _FLOWN = 40, 80
"""Points of a way that the page draws, at most."""
_MOST_POINTS = 250_000
"""Points of all examples in a page; about 3 MB."""


@dataclass(frozen=True, kw_only=True)
class ScenePath:
    """How one planner fared."""

    planner: str
    planned_m: np.ndarray
    """[R, P, 3]; NaN where there is no way."""
    flown_m: np.ndarray
    """[T, R, 3]; T is 0 if it was not flown."""
    outcome: list[str]


@dataclass(frozen=True, kw_only=True)
class Example:
    """One problem, and the ways of all planners."""

    scene: str
    world: int
    occupied: np.ndarray
    """bool [nx, ny, nz]."""
    origin_m: np.ndarray
    cell_m: float
    start_m: np.ndarray
    goal_m: np.ndarray
    obstacle_p_m: np.ndarray
    obstacle_radius_m: np.ndarray
    obstacle_moves: np.ndarray
    ways: list[ScenePath]

    @property
    def title(self) -> str:
        """Scene, team and world in words."""
        team = len(self.start_m)
        return f"{self.scene}, {team} robot{'s' * (team != 1)}, world {self.world}"

    @property
    def top(self) -> np.ndarray:
        """Int [nx, ny]: cells up to the highest rock of each column; 0 without rock."""
        nz = self.occupied.shape[2]
        height = nz - self.occupied[:, :, ::-1].argmax(axis=2)
        top: np.ndarray = np.where(self.occupied.any(axis=2), height, 0)
        return top


def read(path: Path) -> Example:
    """Read one example.

    Raises:
        ConfigError: the file is none.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return _example({name: file[name] for name in file.files})
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ConfigError(
            f"{named(path)}: no example of a benchmark ({error}); remove it, or write it again"
        ) from error


def _example(held: Mapping[str, np.ndarray]) -> Example:
    return Example(
        scene=str(held["scene"]),
        world=int(held["world"]),
        occupied=held["occupied"].astype(bool),
        origin_m=held["origin_m"],
        cell_m=float(held["cell_m"]),
        start_m=held["start_m"],
        goal_m=held["goal_m"],
        obstacle_p_m=held["obstacle_p_m"].reshape(-1, 3),
        obstacle_radius_m=held["obstacle_radius_m"],
        obstacle_moves=held["obstacle_moves"].astype(bool),
        ways=[
            ScenePath(
                planner=str(planner),
                planned_m=held[f"planned_{k}"],
                flown_m=held[f"flown_{k}"],
                outcome=[str(name) for name in held[f"outcome_{k}"]],
            )
            for k, planner in enumerate(held["planners"])
        ],
    )


def embedded(results: Results) -> list[dict[str, Any]]:
    """Examples for the page, the first ones if all would be too much."""
    shown: list[dict[str, Any]] = []
    left = _MOST_POINTS
    for path in results.examples:
        example = read(path)
        left -= len(example.ways) * len(example.start_m) * (_PLANNED + _FLOWN)
        if shown and left < 0:
            break
        shown.append(_thin(example))
    return shown


def _thin(example: Example) -> dict[str, Any]:
    return {
        "title": example.title,
        "top": example.top.tolist(),
        "layers": example.occupied.shape[2],
        "origin": _flat(example.origin_m[:2]),
        "cell": example.cell_m,
        "start": _points(example.start_m),
        "goal": _points(example.goal_m),
        "obstacles": [
            [*_flat(p[:2]), round(float(r), 2), int(moves)]
            for p, r, moves in zip(
                example.obstacle_p_m,
                example.obstacle_radius_m,
                example.obstacle_moves,
                strict=True,
            )
        ],
        "ways": [
            {
                "planner": way.planner,
                "planned": [_points(way.planned_m[r], _PLANNED) for r in range(len(way.planned_m))],
                "flown": [_points(way.flown_m[:, r], _FLOWN) for r in range(way.flown_m.shape[1])],
                "outcome": way.outcome,
            }
            for way in example.ways
        ],
    }


def _points(way_m: np.ndarray, most: int | None = None) -> list[list[float]]:
    """East and north of the points that are there, evenly thinned, the last one kept."""
    known = way_m[np.isfinite(way_m).all(axis=1)]
    if most is not None and len(known) > most:
        known = known[np.unique(np.linspace(0, len(known) - 1, most).round().astype(int))]
    return [_flat(p[:2]) for p in known]


def _flat(point: np.ndarray) -> list[float]:
    return [round(float(x), 2) for x in point]
