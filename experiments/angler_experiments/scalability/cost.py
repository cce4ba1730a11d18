"""Cost of worlds, robots, obstacles, vortices, cells and way-points, in time and memory.

    python -m angler_experiments.scalability.cost --out docs/scalability/cost.jsonl
    python -m angler_experiments.scalability.plot docs/scalability/cost.jsonl

Rows are written one by one, and rows of this device in the file are not measured again: a run that
was ended, or that reached --limit-s, resumes when it is repeated. They are rows of `angler bench`
with ``extra.size``: the number of varied things.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import jax
import tyro

from angler_experiments.scalability import ladders, mjx_baseline
from angler_experiments.scalability.ladders import BY_NAME, Ladder
from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator import compile_cache
from angler_mjx.runs.simulator.devices import is_out_of_memory
from angler_mjx.runs.simulator.programs import release_memory
from angler_mjx.studies.speed import rows
from angler_mjx.studies.speed.measured import free_motion, simulation
from angler_mjx.studies.speed.rows import SpeedRow

type Engine = Literal["fused", "mjx"]
type Key = tuple[str, int, str, str]
type Rung = tuple[Ladder, Engine, int]
"""Ladder, engine and size of a row."""

PREFIX = "scalability/"
WORLDS = {"gpu": {"fused": 4096, "mjx": 256}, "cpu": {"fused": 16, "mjx": 4}}
"""Number of worlds where it is not varied."""
SMOKE: tuple[tuple[str, Engine], ...] = (("dynamics", "fused"),)
SMOKE_SIZES = (16, 64, 256)


def list_rungs(names: Sequence[str], engines: Sequence[Engine], backend: str) -> list[Rung]:
    """Return the rungs of every row, the quick ones first.

    Args:
        names: names of ladders; all if empty.
        engines: engines to measure.
        backend: cpu or gpu.

    Raises:
        ConfigError: the ladder does not exist.
    """
    for name in names:
        if name not in BY_NAME:
            raise ConfigError(f"--ladders {name}: there is {', '.join(BY_NAME)}")
    chosen = [BY_NAME[name] for name in names or BY_NAME]
    return [
        (ladder, engine, size)
        for engine in engines
        for ladder in chosen
        for size in ladder.sizes(engine, backend)
    ]


def row_key(row: dict[str, Any]) -> Key:
    """Return the key of a row: ladder, number, engine, device."""
    name = row["workload"].removeprefix(PREFIX)
    return name, int(row["extra"]["size"]), row["engine"], row["device"]


def measure_row(ladder: Ladder, engine: Engine, size: int, repeats: int, backend: str) -> SpeedRow:
    """Measure one row; it has no number where it was refused."""
    label = f"{PREFIX}{ladder.name}"
    worlds = size if ladder.key is None else WORLDS[backend][engine]
    try:
        if ladder.name == "dynamics":
            row = (
                free_motion.measure(vehicles=size, repeats=repeats)
                if engine == "fused"
                else mjx_baseline.measure_mjx(vehicles=size, repeats=repeats)
            )
        else:
            row = simulation.measure(
                ladders.build_scenario(ladder, size, engine),
                label=label,
                worlds=worlds,
                repeats=repeats,
                counted=False,
            )
    except (AnglerError, jax.errors.JaxRuntimeError) as error:
        row = SpeedRow(
            workload=label,
            inside="",
            worlds=worlds,
            robots=0,
            unit="",
            median=None,
            low=None,
            high=None,
            compile_s=None,
            repeats=0,
            engine=engine,
            refused=str(error).splitlines()[0][:300],
            out_of_memory=is_out_of_memory(error.__cause__ or error),
        )
    return replace(row, workload=label, extra={"size": float(ladder.count(size))})


def measure_missing(
    requested: Sequence[Rung], out: Path, repeats: int, limit_s: float
) -> Iterator[tuple[SpeedRow, float]]:
    """Measure the rows that a file lacks; yield each with its total seconds.

    Args:
        requested: rows of `list_rungs`.
        out: file of rows.
        repeats: timed turns of each row.
        limit_s: time after which no row begins.
    """
    environment, backend = describe_environment(), jax.default_backend()
    measured = {row_key(row) for row in rows.read_rows(out)} if out.exists() else set()
    start_s = time.perf_counter()
    for ladder, engine, size in requested:
        if (ladder.name, ladder.count(size), engine, environment["device"]) in measured:
            continue
        row_start_s = time.perf_counter()
        if row_start_s - start_s > limit_s:
            print(f"--limit-s {limit_s:g}: over; start again to go on", flush=True)
            return
        row = measure_row(ladder, engine, size, repeats, backend)
        rows.append_row(row, environment, out)
        yield row, time.perf_counter() - row_start_s
        release_memory()


def main(
    out: Path = Path("runs/cost.jsonl"),
    ladders: tuple[str, ...] = (),
    engines: tuple[Engine, ...] = ("fused", "mjx"),
    repeats: int = rows.MIN_REPEATS,
    limit_s: float = 330.0,
    smoke: bool = False,
) -> None:
    """Measure the rows that a file lacks.

    Args:
        out: File of rows; they are appended.
        ladders: Varied sizes: dynamics, worlds, robots, obstacles, vortices, cells, points; all if
            left out.
        engines: Engines to measure, one after another.
        repeats: Timed turns of each row.
        limit_s: Seconds after which no row begins.
        smoke: Only a few small rows of the equations of motion, in seconds.
    """
    compile_cache.enable_cache()
    if smoke:
        requested: list[tuple[Ladder, Engine, int]] = [
            (BY_NAME[x], engine, size) for x, engine in SMOKE for size in SMOKE_SIZES
        ]
    else:
        requested = list_rungs(ladders, engines, jax.default_backend())
    for row, took_s in measure_missing(requested, out, repeats, limit_s):
        summary = row.refused or f"{row.median:.3g} {row.unit}, compiled in {row.compile_s:.1f} s"
        size = int(row.extra["size"])
        print(f"{row.workload} {size:,} {row.engine}: {summary}; {took_s:.0f} s", flush=True)
    print(out)


if __name__ == "__main__":
    tyro.cli(main)
