"""Data of a benchmark's page: rounded statistics of every selection, cells, failures, scenes."""

import math
from collections.abc import Sequence

import numpy as np

from angler_mjx.report.plotting import style
from angler_mjx.studies.benchmark.report import cells, scenes
from angler_mjx.studies.benchmark.report.rates import FEW, build_density_bins
from angler_mjx.studies.benchmark.report.reading import MEASURES, Results
from angler_mjx.studies.benchmark.report.selections import (
    build_page_selections,
    round_digits,
    select_rows,
)

_MEDIAN_DIGITS = 4
_MAX_FAILURES = 20_000


def build_page_data(results: Results) -> dict[str, object]:
    """Return everything that the page's script reads.

    Args:
        results: of a benchmark.
    """
    runs = results.runs
    knowledge = list(dict.fromkeys(runs.knowledge.tolist()))
    bins = build_density_bins(runs, results.problem)
    teams = sorted(set(runs["robots"].tolist()))
    choices = (
        _index_values(runs["scene"], results.scenes),
        _index_values(runs["robots"], teams),
        _index_values(runs.knowledge, knowledge),
    )
    selections = list(select_rows(*choices))
    report_cells = cells.build_cells(runs)
    return {
        "about": results.about,
        "planners": results.planners,
        "scenes": results.scenes,
        "teams": teams,
        "knowledge": knowledge,
        "few": FEW,
        "judged": results.judged,
        "pending": results.pending,
        "totals": {
            "problems": len(np.unique(results.problem)),
            "runs": len(runs),
            "asked": int(np.sum(runs.requested)),
            "closed": int(np.sum(runs.counted & ~runs.requested)),
            "no_room": int(np.sum(~runs.counted)),
        },
        "selections": dict(
            zip(
                (selection.key for selection in selections),
                build_page_selections(results, selections, bins),
                strict=True,
            )
        ),
        "centres": [round_digits(x) for x in bins.centres],
        "measures": MEASURES,
        "cells": [_build_cell(cell, results, knowledge) for cell in report_cells],
        "failures": _build_failures(results, report_cells),
        "outcomes": {
            name: {"color": style.OUTCOMES[name], "text": style.OUTCOME_TEXT[name]}
            for name in style.OUTCOMES
        },
        "examples": scenes.build_page_scenes(results),
    }


def _index_values(values: np.ndarray, names: Sequence[object]) -> list[int]:
    number = {name: i for i, name in enumerate(names)}
    return [number[value] for value in values.tolist()]


def _build_cell(
    cell: cells.ReportCell, results: Results, knowledge: list[str]
) -> dict[str, object]:
    runs = results.runs
    is_closed = runs.counted[cell.rows] & ~runs.requested[cell.rows]
    return {
        "planner": results.planners.index(cell.planner),
        "scene": results.scenes.index(cell.scene),
        "preset": cell.preset,
        "team": cell.robots,
        "information": knowledge.index(cell.knowledge),
        "asked": cell.success.requested,
        "closed": int(np.sum(is_closed)),
        "success": round_digits(cell.success.fraction),
        "interval": [round_digits(cell.success.low), round_digits(cell.success.high)],
        "planned": round_digits(cell.planned.fraction),
        "flown": round_digits(cell.flown.fraction),
        **{name: round_digits(value, _MEDIAN_DIGITS) for name, value in cell.medians.items()},
    }


def _build_failures(results: Results, report_cells: list[cells.ReportCell]) -> dict[str, object]:
    """Return positions of failed robots by cell; of very many every n-th one."""
    failures, runs = results.failures, results.runs
    cell_of_run = {
        run: i for i, cell in enumerate(report_cells) for run in runs["run"][cell.rows].tolist()
    }
    indices = np.array(
        [i for i, run in enumerate(failures.run.tolist()) if run in cell_of_run], int
    )
    step = max(1, math.ceil(len(indices) / _MAX_FAILURES))
    shown = indices[::step]
    outcomes = list(dict.fromkeys(failures.outcome.tolist()))
    return {
        "cell": [cell_of_run[run] for run in failures.run[shown].tolist()],
        "outcome": _index_values(failures.outcome[shown], outcomes),
        "outcomes": outcomes,
        "x": [round(x, 2) for x in failures.x_m[shown].tolist()],
        "y": [round(y, 2) for y in failures.y_m[shown].tolist()],
        "every": step,
        "total": len(indices),
    }
