"""The table of cells: planner, scene, team and knowledge, with all measures of their runs."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.studies.benchmark.report.rates import ReportRate, grouped, rate
from angler_mjx.studies.benchmark.report.reading import MEASURES, Runs


@dataclass(frozen=True, kw_only=True)
class ReportCell:
    """One planner on one scene with one team and one degree of knowledge."""

    planner: str
    scene: str
    preset: str
    robots: int
    knowledge: str
    success: ReportRate
    planned: ReportRate
    flown: ReportRate
    medians: dict[str, float]
    """Of `MEASURES`, over the asked runs that have the measure; NaN where none has."""


def cells(runs: Runs) -> list[ReportCell]:
    """All cells, in the order of their first runs."""
    keys = [runs[name].tolist() for name in ("planner", "scene", "preset", "robots")]
    found = []
    for key, rows in grouped(*keys, runs.knowledge.tolist()).items():
        held = runs.where(rows)
        asked = held.asked
        planner, scene, preset, robots, knowledge = key
        found.append(
            ReportCell(
                planner=planner,
                scene=scene,
                preset=preset,
                robots=robots,
                knowledge=knowledge,
                success=rate(held["success"], asked),
                planned=rate(held["planned"], asked),
                flown=rate(held["flown"], asked),
                medians={name: _median(held[name][asked]) for name in MEASURES},
            )
        )
    return found


def _median(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float("nan")
