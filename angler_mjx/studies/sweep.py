"""A sweep: the runs of a grid of settings, and the table that they come to.

A folder is built hidden, as a run's is. ``runs/`` holds a run folder for each cell, ``sweep.json``
all numbers, ``sweep.parquet`` a row for each cell, ``sweep.md`` tables for people, ``sweep.png`` a
figure. A sweep that is interrupted holds them for the cells that were finished.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import pyarrow as pa

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.files import FaultyError, format_faults, validate_model
from angler_mjx.progress import Progress
from angler_mjx.report.plotting import style
from angler_mjx.runs import multi_run
from angler_mjx.runs.multi_run import RUNS_FOLDER, RunOptions
from angler_mjx.runs.processes import OneProcess, Processes
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.resumable_folder import open_folder
from angler_mjx.runs.rollout import NothingKeptError
from angler_mjx.runs.simulator.world_preparation import check_planner
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.scenario.editing import remove_horizon, scenario_table
from angler_mjx.scenario.horizon_check import check_reachable
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies import chart, measures, paired, tables
from angler_mjx.studies.grid import (
    GridCell,
    SettingAxis,
    count_cells,
    iterate_cells,
)
from angler_mjx.studies.rows import CellRow, PairRow, SweepResults

SWEEP, TABLE, PAGE, FIGURE = "sweep.json", "sweep.parquet", "sweep.md", "sweep.png"

MAX_CELLS = 10_000
"""Cells of a sweep."""
_MAX_NAME_LENGTH = 80
"""Characters of a run folder's name."""


@dataclass(frozen=True, kw_only=True)
class StudyCell(GridCell):
    """Cell of a sweep with its scenario."""

    scenario: Scenario

    @property
    def path(self) -> str:
        """Of its run, below the sweep's folder."""
        parts = [f"{key.rpartition('.')[2]}_{name}" for key, name in self.names.items()]
        text = re.sub(r"[^A-Za-z0-9_.-]+", "_", "_".join(parts))[:_MAX_NAME_LENGTH].strip("._")
        return f"{RUNS_FOLDER}/{self.number:03d}_{text}"


@dataclass(frozen=True, kw_only=True)
class SweepRequest:
    """What a person asked for."""

    name: str
    """Of the scenario."""
    table: Mapping[str, object]
    """Of the scenario."""
    axes: tuple[SettingAxis, ...]
    cells: tuple[StudyCell, ...]

    def resolved(self) -> dict[str, object]:
        """All of it in plain values."""
        return {
            "set": {axis.key: list(axis.names) for axis in self.axes},
            "scenario": dict(self.table),
        }


def build_request(scenario: Scenario, axes: Sequence[SettingAxis], source: str) -> SweepRequest:
    """What is to be flown; every cell is checked.

    Args:
        scenario: with the worlds and the seed of all cells.
        axes: that are varied.
        source: of the scenario, for messages.

    Raises:
        ConfigError: naming what is wrong with any cell.
    """
    table = scenario_table(scenario)
    return SweepRequest(
        name=scenario.name,
        table=table,
        axes=tuple(axes),
        cells=build_cells(table, axes, source),
    )


def build_cells(
    table: Mapping[str, Any], axes: Sequence[SettingAxis], source: str
) -> tuple[StudyCell, ...]:
    """All cells; the last axis changes fastest.

    A cell whose world has another preset gets that one's horizon, unless one is set.

    Args:
        table: of the scenario (`angler_mjx.scenario.editing.scenario_table`).
        axes: to be varied.
        source: of the scenario, for messages.

    Raises:
        ConfigError: naming everything that is wrong with any of them, and the settings by which.
    """
    count = count_cells(axes)
    if count > MAX_CELLS:
        raise ConfigError(f"--set: makes {count:,} cells; {MAX_CELLS:,} are the most: vary less")
    study_cells: list[StudyCell] = []
    faults: dict[str, list[Mapping[str, str]]] = {}
    for cell in iterate_cells(axes):
        try:
            scenario = _build_scenario(table, cell)
        except FaultyError as error:
            for fault in error.faults:
                faults.setdefault(fault.text, []).append(cell.names)
        except ConfigError as error:
            faults.setdefault(str(error), []).append(cell.names)
        else:
            study_cells.append(StudyCell(**vars(cell), scenario=scenario))
    if faults:
        varied_keys = [axis.key for axis in axes if len(axis.values) > 1]
        raise ConfigError(
            format_faults(source, [_format_fault(x, at, varied_keys) for x, at in faults.items()])
        )
    return tuple(study_cells)


def _build_scenario(table: Mapping[str, Any], cell: GridCell) -> Scenario:
    """Build the scenario of a cell.

    Raises:
        FaultyError, ConfigError: it cannot be flown.
    """
    values, preset = cell.values, table["world"].get("preset")
    base = dict(table)
    if values.get("world.preset", preset) != preset and "time.horizon_s" not in values:
        base = remove_horizon(base)
    scenario = validate_model(Scenario, cell.edit(base))
    check_planner(scenario)
    check_reachable(scenario)
    return scenario


def _format_fault(text: str, settings: Sequence[Mapping[str, str]], keys: Sequence[str]) -> str:
    """A fault, and the settings that all cells share that have it."""
    shared = [
        f"--set {key}={settings[0][key]}"
        for key in keys
        if all(x[key] == settings[0][key] for x in settings)
    ]
    return f"{text} ({' '.join(shared)})" if shared else text


def run_sweep(
    request: SweepRequest,
    out: Path,
    *,
    progress: Progress,
    resume: bool = False,
    devices: int | None = None,
    workers: int | None = None,
    processes: Processes | None = None,
) -> SweepResults:
    """Make a sweep, or go on with one.

    Args:
        request: what is to be in it.
        out: folder to make.
        progress: of how far it is.
        resume: go on with an interrupted one.
        devices: to fly on; all if left out. Changes no byte of the results.
        workers: processes that plan, where a planner is one of the host.
        processes: that share the flights of each cell; each calls this with the same arguments.

    Returns:
        What ``sweep.json`` holds; its ``complete`` is false after an interruption.

    Raises:
        ConfigError: the folder is taken, or is of another sweep.
        RunError: the disk or the device gave out, or another process did. Cells that were finished
            stand in the folder with their tables, as after an interruption.
    """
    together = processes or OneProcess()
    declared = multi_run.declare_folder(
        "sweep", request.resolved(), models={"scenario": Scenario}, is_complete=is_complete
    )
    flights = [(cell.path, cell.scenario) for cell in request.cells]
    options: RunOptions = {"devices": devices, "workers": workers}
    with open_folder(declared, out, resume=resume, processes=together) as opened:
        building = opened.building
        try:
            complete = _fly_cells(flights, building, progress, together, options)
        except AnglerError:
            if _has_whole_cell(flights, building):
                opened.publish(partial(_write_results, request, complete=False))
            raise
        opened.publish(partial(_write_results, request, complete=complete))
    return read_sweep(out)


def is_complete(out: Path) -> bool:
    """Return whether a folder holds a sweep with all its cells."""
    return (out / SWEEP).is_file() and bool(read_sweep(out).get("complete"))


def read_sweep(out: Path) -> SweepResults:
    """What the ``sweep.json`` of a folder holds.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / SWEEP).is_file():
        raise ConfigError(f"{out}: not the folder of a sweep (no {SWEEP} in it)")
    return cast(SweepResults, read_table(out / SWEEP))


def _fly_cells(
    flights: Sequence[tuple[str, Scenario]],
    building: Path,
    progress: Progress,
    together: Processes,
    options: RunOptions,
) -> bool:
    """Fly the cells; whether all are whole. An interruption keeps what was finished."""
    try:
        return multi_run.fly_runs(flights, building, progress, together, options)
    except (KeyboardInterrupt, NothingKeptError):
        if together.count > 1 or not _has_whole_cell(flights, building):
            raise
        return False


def _has_whole_cell(flights: Sequence[tuple[str, Scenario]], building: Path) -> bool:
    return any(multi_run.run_status(building / path) == "whole" for path, _ in flights)


def _write_results(request: SweepRequest, building: Path, *, complete: bool) -> None:
    """Write table, page and figure."""
    results = _gather_results(request, building, complete=complete)
    write_json(building / SWEEP, dict(results))
    tables.write_parquet(results, building / TABLE)
    tables.write_page(results, building / PAGE)
    style.save_figure(chart.plot_sweep(results), building / FIGURE, palette=128)
    if complete:
        (building / multi_run.REQUEST_FILE).unlink()


def _gather_results(request: SweepRequest, building: Path, *, complete: bool) -> SweepResults:
    """Everything that is known of the cells that are whole."""
    rows: list[CellRow] = []
    episodes: dict[int, pa.Table] = {}
    for cell in request.cells:
        if multi_run.run_status(building / cell.path) != "whole":
            continue
        run = Run(building / cell.path)
        episodes[cell.number] = run.episodes
        rows.append(
            {
                "cell": cell.number,
                "run": cell.path,
                "set": dict(cell.names),
                **measures.measure_run(run),
            }
        )
    first = request.cells[0].scenario
    results = {
        "scenario": request.name,
        "worlds": first.worlds,
        "seed": first.seed,
        "complete": complete,
        "axes": [
            {"key": x.key, "names": list(x.names), "values": list(x.values)} for x in request.axes
        ],
        "cells": rows,
        "pairs": _compare_pairs(request.axes, rows, episodes),
        "environment": describe_environment(),
    }
    return cast(SweepResults, results)


def _compare_pairs(
    axes: Sequence[SettingAxis], rows: Sequence[CellRow], episodes: Mapping[int, pa.Table]
) -> list[PairRow]:
    """Every value of an axis against its first, all other settings being the same."""
    held = {tuple(row["set"].values()): row for row in rows}
    comparisons: list[PairRow] = []
    for i, axis in enumerate(axes):
        others = [other.names for other in (*axes[:i], *axes[i + 1 :])]
        for fixed_names in itertools.product(*others):
            cell = [(*fixed_names[:i], name, *fixed_names[i:]) for name in axis.names]
            axis_rows = [held.get(settings) for settings in cell]
            for second in axis_rows[1:]:
                if axis_rows[0] is None or second is None:
                    continue
                pairing = paired.pair_runs(episodes[axis_rows[0]["cell"]], episodes[second["cell"]])
                comparisons.append(
                    {
                        "key": axis.key,
                        "first": axis_rows[0]["cell"],
                        "second": second["cell"],
                        "same_problems": axis_rows[0]["problems"] == second["problems"],
                        **pairing,
                    }
                )
    return comparisons
