"""The table of cells: planner, scene, team and knowledge, with all measures of their runs."""

from dataclasses import dataclass

import numpy as np

from angler_mjx.studies.benchmark.report.rates import ReportRate, compute_rate, group_rows
from angler_mjx.studies.benchmark.report.reading import MEASURES, Runs


@dataclass(frozen=True, kw_only=True)
class ReportCell:
    """One planner on one scene with one team and one degree of knowledge."""

    planner: str
    scene: str
    preset: str
    robots: int
    knowledge: str
    rows: np.ndarray
    """int [k] its rows."""
    success: ReportRate
    planned: ReportRate
    flown: ReportRate
    medians: dict[str, float]
    """Of `MEASURES`, over the asked runs that have the measure; NaN where none has."""


def build_cells(runs: Runs) -> list[ReportCell]:
    """All cells, in the order of their first runs."""
    keys = [runs[name].tolist() for name in ("planner", "scene", "preset", "robots")]
    report_cells = []
    for rows in group_rows(*keys, runs.knowledge.tolist()).values():
        cell_runs = runs.where(rows)
        requested = cell_runs.requested
        report_cells.append(
            ReportCell(
                planner=str(cell_runs["planner"][0]),
                scene=str(cell_runs["scene"][0]),
                preset=str(cell_runs["preset"][0]),
                robots=int(cell_runs["robots"][0]),
                knowledge=str(cell_runs.knowledge[0]),
                rows=rows,
                success=compute_rate(cell_runs["success"], requested),
                planned=compute_rate(cell_runs["planned"], requested),
                flown=compute_rate(cell_runs["flown"], requested),
                medians={name: _finite_median(cell_runs[name][requested]) for name in MEASURES},
            )
        )
    return report_cells


def _finite_median(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float("nan")
