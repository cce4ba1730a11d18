"""Example scenes of a benchmark: read, and thinned out for the page."""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path
from angler_mjx.studies.benchmark.report.reading import Results

_MAX_PLANNED, _MAX_FLOWN = 40, 80
"""Points of a way that the page draws, at most."""
_MAX_POINTS = 250_000
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
    paths: list[ScenePath]

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


def read_example(path: Path) -> Example:
    """Read one example.

    Raises:
        ConfigError: the file is none.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return _build_example({name: file[name] for name in file.files})
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise ConfigError(
            f"{format_path(path)}: no example of a benchmark ({error}); remove it, or write it "
            "again"
        ) from error


def _build_example(arrays: Mapping[str, np.ndarray]) -> Example:
    return Example(
        scene=str(arrays["scene"]),
        world=int(arrays["world"]),
        occupied=arrays["occupied"].astype(bool),
        origin_m=arrays["origin_m"],
        cell_m=float(arrays["cell_m"]),
        start_m=arrays["start_m"],
        goal_m=arrays["goal_m"],
        obstacle_p_m=arrays["obstacle_p_m"].reshape(-1, 3),
        obstacle_radius_m=arrays["obstacle_radius_m"],
        obstacle_moves=arrays["obstacle_moves"].astype(bool),
        paths=[
            ScenePath(
                planner=str(planner),
                planned_m=arrays[f"planned_{k}"],
                flown_m=arrays[f"flown_{k}"],
                outcome=[str(name) for name in arrays[f"outcome_{k}"]],
            )
            for k, planner in enumerate(arrays["planners"])
        ],
    )


type PagePoints = list[list[float]]
"""East and north [m] of points."""


class PagePath(TypedDict):
    """How one planner fared, as the page reads it."""

    planner: str
    planned: list[PagePoints]
    flown: list[PagePoints]
    outcome: list[str]


class PageScene(TypedDict):
    """An example as the page reads it."""

    title: str
    top: list[list[int]]
    """Cells up to the highest rock of each column."""
    layers: int
    origin: list[float]
    cell: float
    start: PagePoints
    goal: PagePoints
    obstacles: list[list[float]]
    """East, north, radius [m], and 1 for one that moves."""
    paths: list[PagePath]


def build_page_scenes(results: Results) -> list[PageScene]:
    """Examples for the page, the first ones if all would be too much."""
    shown: list[PageScene] = []
    points_left = _MAX_POINTS
    for path in results.examples:
        example = read_example(path)
        points_left -= len(example.paths) * len(example.start_m) * (_MAX_PLANNED + _MAX_FLOWN)
        if shown and points_left < 0:
            break
        shown.append(_build_page_scene(example))
    return shown


def _build_page_scene(example: Example) -> PageScene:
    return {
        "title": example.title,
        "top": example.top.tolist(),
        "layers": example.occupied.shape[2],
        "origin": _round_point(example.origin_m[:2]),
        "cell": example.cell_m,
        "start": _thin_points(example.start_m),
        "goal": _thin_points(example.goal_m),
        "obstacles": [
            [*_round_point(p[:2]), round(float(r), 2), int(moves)]
            for p, r, moves in zip(
                example.obstacle_p_m,
                example.obstacle_radius_m,
                example.obstacle_moves,
                strict=True,
            )
        ],
        "paths": [
            {
                "planner": scene_path.planner,
                "planned": [
                    _thin_points(scene_path.planned_m[r], _MAX_PLANNED)
                    for r in range(len(scene_path.planned_m))
                ],
                "flown": [
                    _thin_points(scene_path.flown_m[:, r], _MAX_FLOWN)
                    for r in range(scene_path.flown_m.shape[1])
                ],
                "outcome": scene_path.outcome,
            }
            for scene_path in example.paths
        ],
    }


def _thin_points(path_m: np.ndarray, max_points: int | None = None) -> PagePoints:
    """East and north of the points that are there, evenly thinned, the last one kept."""
    finite = path_m[np.isfinite(path_m).all(axis=1)]
    if max_points is not None and len(finite) > max_points:
        finite = finite[np.unique(np.linspace(0, len(finite) - 1, max_points).round().astype(int))]
    return [_round_point(p[:2]) for p in finite]


def _round_point(point: np.ndarray) -> list[float]:
    return [round(float(x), 2) for x in point]
