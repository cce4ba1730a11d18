"""What the page holds of a benchmark: columns of numbers, rounded, and the scenes it draws."""

import math
from typing import Any

import numpy as np

from angler_mjx.report.viewing import style
from angler_mjx.studies.benchmark.report import cells, scenes
from angler_mjx.studies.benchmark.report.profiles import COSTS
from angler_mjx.studies.benchmark.report.rates import FEW, ReportRate, build_density_bins
from angler_mjx.studies.benchmark.report.reading import MEASURES, Results

_DIGITS = 4
_COST_DIGITS = 7
"""The page compares costs: its ratios must agree with ``comparisons.csv`` to four digits."""
_MAX_FAILURES = 20_000


def build_page_data(results: Results) -> dict[str, Any]:
    """Everything that the page's script reads.

    Args:
        results: of a benchmark.
    """
    runs = results.runs
    knowledge = list(dict.fromkeys(runs.knowledge.tolist()))
    bins = build_density_bins(runs, results.problem)
    rows = {
        "planner": _index_values(runs["planner"], results.planners),
        "scene": _index_values(runs["scene"], results.scenes),
        "team": runs["robots"].tolist(),
        "information": _index_values(runs.knowledge, knowledge),
        "problem": results.problem.tolist(),
        "world": results.world.tolist(),
        "asked": runs.requested.astype(int).tolist(),
        "counted": runs.counted.astype(int).tolist(),
        "planned": runs["planned"].astype(int).tolist(),
        "success": runs["success"].astype(int).tolist(),
        "bin": bins.of.tolist(),
        **{name: [round_digits(x, _COST_DIGITS) for x in runs[name]] for name in COSTS},
    }
    return {
        "about": results.about,
        "planners": results.planners,
        "scenes": results.scenes,
        "teams": sorted(set(runs["robots"].tolist())),
        "knowledge": knowledge,
        "few": FEW,
        "judged": results.judged,
        "pending": results.pending,
        "rows": rows,
        "bins": {
            "centres": [round_digits(x) for x in bins.centres],
            "edges": [round_digits(x) for x in bins.edges],
        },
        "measures": MEASURES,
        "cells": [_build_cell(cell, results, knowledge) for cell in cells.build_cells(runs)],
        "failures": _build_failures(results),
        "outcomes": {
            name: {"color": style.OUTCOMES[name], "text": style.OUTCOME_TEXT[name]}
            for name in style.OUTCOMES
        },
        "examples": scenes.build_page_scenes(results),
    }


def round_digits(value: float, digits: int = _DIGITS) -> float | int | None:
    """A number for JSON with so many digits; None for what is no number."""
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{digits}g}")
    return int(short) if short.is_integer() else short


def _index_values(values: np.ndarray, names: list[str]) -> list[int]:
    number = {name: i for i, name in enumerate(names)}
    return [number[value] for value in values.tolist()]


def _build_cell(cell: cells.ReportCell, results: Results, knowledge: list[str]) -> dict[str, Any]:
    def counted(rate: ReportRate) -> int:
        return rate.count

    return {
        "planner": results.planners.index(cell.planner),
        "scene": results.scenes.index(cell.scene),
        "preset": cell.preset,
        "team": cell.robots,
        "information": knowledge.index(cell.knowledge),
        "asked": cell.success.requested,
        "closed": cell.success.closed,
        "success": counted(cell.success),
        "planned": counted(cell.planned),
        "flown": counted(cell.flown),
        **{name: round_digits(value) for name, value in cell.medians.items()},
    }


def _build_failures(results: Results) -> dict[str, Any]:
    """Places of robots that failed, by row; every so many of them where there are very many."""
    failures, runs = results.failures, results.runs
    row_of_run = {number: i for i, number in enumerate(runs["run"].tolist())}
    indices = np.array([i for i, run in enumerate(failures.run.tolist()) if run in row_of_run], int)
    step = max(1, math.ceil(len(indices) / _MAX_FAILURES))
    shown = indices[::step]
    outcomes = list(dict.fromkeys(failures.outcome.tolist()))
    return {
        "row": [row_of_run[run] for run in failures.run[shown].tolist()],
        "outcome": _index_values(failures.outcome[shown], outcomes),
        "outcomes": outcomes,
        "x": [round(x, 2) for x in failures.x_m[shown].tolist()],
        "y": [round(y, 2) for y in failures.y_m[shown].tolist()],
        "every": step,
        "total": len(indices),
    }
