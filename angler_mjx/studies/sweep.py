"""A sweep: the runs of a grid of settings, and the table that they come to.

A folder is built hidden, as a run's is. ``runs/`` holds a run folder for each cell, ``sweep.json``
all numbers, ``sweep.parquet`` a row for each cell, ``sweep.md`` tables for people, ``sweep.png`` a
figure. A sweep that is interrupted holds them for the cells that were finished.
"""

import itertools
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from angler_mjx.errors import AnglerError, ConfigError, RunError
from angler_mjx.report.viewing import style
from angler_mjx.runs import several
from angler_mjx.runs.processes import OneProcess, Processes, telling
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.rollout import NothingKeptError
from angler_mjx.runs.several import RunsProgress
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.runs.storage.damage import read_table
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.scenario.editing import table_of
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies import cells, chart, measures, paired, tables
from angler_mjx.studies.cells import StudyCell
from angler_mjx.studies.settings import SettingAxis

SWEEP, TABLE, PAGE, FIGURE = "sweep.json", "sweep.parquet", "sweep.md", "sweep.png"


@dataclass(frozen=True, kw_only=True)
class SweepRequest:
    """What a person asked for."""

    name: str
    """Of the scenario."""
    table: Mapping[str, Any]
    """Of the scenario."""
    axes: tuple[SettingAxis, ...]
    cells: tuple[StudyCell, ...]

    def resolved(self) -> dict[str, Any]:
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
    table = table_of(scenario)
    return SweepRequest(
        name=scenario.name,
        table=table,
        axes=tuple(axes),
        cells=cells.cells(table, axes, source),
    )


def make(
    asked: SweepRequest,
    out: Path,
    *,
    told: RunsProgress,
    resume: bool = False,
    devices: int | None = None,
    workers: int | None = None,
    processes: Processes | None = None,
) -> dict[str, Any]:
    """Make a sweep, or go on with one.

    Args:
        asked: what is to be in it.
        out: folder to make.
        told: of how far it is.
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
    with telling(together), ExitStack() as stack:
        claimed = None
        if together.index == 0:
            claimed = (
                _again(asked, out) if resume else several.begin(out, "sweep", asked.resolved())
            )
            stack.callback(claimed.release)
        together.meet("sweep")
        building = output_lock.partial_path(out)
        flights = [(cell.path, cell.scenario) for cell in asked.cells]
        how = {"devices": devices, "workers": workers}
        try:
            complete = _fly(flights, building, told, together, how)
        except AnglerError:
            if claimed is not None and _any_whole(flights, building):
                _close(asked, claimed, complete=False)
            raise
        if claimed is not None:
            _close(asked, claimed, complete=complete)
        together.meet("closed")
    return read(out)


def read(out: Path) -> dict[str, Any]:
    """What the ``sweep.json`` of a folder holds.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / SWEEP).is_file():
        raise ConfigError(f"{out}: not the folder of a sweep (no {SWEEP} in it)")
    return read_table(out / SWEEP)


def _again(asked: SweepRequest, out: Path) -> OutputLock:
    whole = (out / SWEEP).is_file() and bool(read(out).get("complete"))
    return several.again(out, "sweep", asked.resolved(), whole=whole)


def _fly(
    flights: Sequence[tuple[str, Scenario]],
    building: Path,
    told: RunsProgress,
    together: Processes,
    how: Mapping[str, Any],
) -> bool:
    """Fly the cells; whether all are whole. An interruption keeps what was finished."""
    try:
        return several.fly(flights, building, told, together, how)
    except (KeyboardInterrupt, NothingKeptError):
        if together.count > 1 or not _any_whole(flights, building):
            raise
        return False


def _any_whole(flights: Sequence[tuple[str, Scenario]], building: Path) -> bool:
    return any(several.stands(building / path) == "whole" for path, _ in flights)


def _close(asked: SweepRequest, claimed: OutputLock, *, complete: bool) -> None:
    """Table, page and figure; then the folder gets its name."""
    place = claimed.building
    try:
        found = _gather(asked, place, complete=complete)
        folder.write_json(place / SWEEP, found)
        tables.write_parquet(found, place / TABLE)
        tables.write_page(found, place / PAGE)
        style.save(chart.draw(found), place / FIGURE, palette=128)
        if complete:
            (place / several.MAKING).unlink()
    except OSError as error:
        raise RunError(
            f"--out {claimed.out}: cannot be written ({error.strerror or error}); its flights are "
            f"in {place}: make room and go on with --resume"
        ) from error
    claimed.publish()


def _gather(asked: SweepRequest, place: Path, *, complete: bool) -> dict[str, Any]:
    """Everything that is known of the cells that are whole."""
    rows, episodes = [], {}
    for cell in asked.cells:
        if several.stands(place / cell.path) != "whole":
            continue
        run = Run(place / cell.path)
        episodes[cell.number] = run.episodes
        rows.append(
            {
                "cell": cell.number,
                "run": cell.path,
                "set": dict(cell.names),
                **measures.of_run(run),
            }
        )
    first = asked.cells[0].scenario
    return {
        "scenario": asked.name,
        "worlds": first.worlds,
        "seed": first.seed,
        "complete": complete,
        "axes": [
            {"key": x.key, "names": list(x.names), "values": list(x.values)} for x in asked.axes
        ],
        "cells": rows,
        "pairs": _pairs(asked.axes, rows, episodes),
        "environment": describe_environment(),
    }


def _pairs(
    axes: Sequence[SettingAxis], rows: Sequence[Mapping[str, Any]], episodes: Mapping[int, pa.Table]
) -> list[dict[str, Any]]:
    """Every value of an axis against its first, all other settings being the same."""
    held = {tuple(row["set"].values()): row for row in rows}
    made = []
    for i, axis in enumerate(axes):
        others = [other.names for other in (*axes[:i], *axes[i + 1 :])]
        for beside in itertools.product(*others):
            cell = [(*beside[:i], name, *beside[i:]) for name in axis.names]
            there = [held.get(one) for one in cell]
            for second in there[1:]:
                if there[0] is None or second is None:
                    continue
                pairing = paired.pair(episodes[there[0]["cell"]], episodes[second["cell"]])
                made.append(
                    {
                        "key": axis.key,
                        "first": there[0]["cell"],
                        "second": second["cell"],
                        "same_problems": there[0]["problems"] == second["problems"],
                        **measures.plain(pairing),
                    }
                )
    return made
