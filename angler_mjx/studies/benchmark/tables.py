"""Tables of a benchmark out of its database: Parquet, for whoever asks their own questions."""

import json
from pathlib import Path

import pyarrow as pa

from angler_mjx.runs.storage import atomic_files
from angler_mjx.runs.storage.episode_columns import EPISODE_SCHEMA
from angler_mjx.studies.benchmark.columns import NUMBER_COLUMNS, RUN_SCHEMA, TEXT_COLUMNS
from angler_mjx.studies.benchmark.store import STATUS, BenchmarkStore

RUNS, ROBOTS, PROGRESS = "runs.parquet", "robots.parquet", "progress.parquet"

_RUN_KEYS = """plannerConfigs.name AS planner, json_extract(settings, '$.name') AS planner_name,
    experiments.name AS scene, preset, robots, knows_obstacles, knows_current, problem_seed"""
_JOINS = """JOIN experiments ON experiments.id = experimentid
    JOIN plannerConfigs ON plannerConfigs.id = plannerid"""
_ORDER = "ORDER BY experimentid, plannerid, world"


def build_runs_table(store: BenchmarkStore) -> pa.Table:
    """One row a run, and one for each problem that a planner was not asked."""
    text_columns = ", ".join(f"words.{name}" for name in TEXT_COLUMNS)
    numbers = ", ".join(f"runs.{name} AS {column.name}" for column, name in NUMBER_COLUMNS)
    rows = [
        {**dict(row), "plan_status": STATUS[row["plan_status"]]}
        for row in store.rows(
            f"SELECT runs.id AS run, {_RUN_KEYS}, world, status AS plan_status, {text_columns}, "
            f"{numbers} "
            f"FROM runs JOIN words ON words.runid = runs.id {_JOINS} {_ORDER}"
        )
    ]
    rows += [
        dict(row)
        for row in store.rows(
            f"SELECT {_RUN_KEYS}, world, status AS plan_status, reason AS plan_reason "
            f"FROM closed {_JOINS} {_ORDER}"
        )
    ]
    columns = {field.name: [_cell_value(field, row) for row in rows] for field in RUN_SCHEMA}
    return pa.table(columns, schema=RUN_SCHEMA)


def _cell_value(field: pa.Field, row: dict[str, object]) -> object:
    value = row.get(field.name)
    return bool(value) if pa.types.is_boolean(field.type) else value


def build_robots_table(store: BenchmarkStore) -> pa.Table:
    """One row a robot of each run that was flown, as in ``episodes.parquet``."""
    records = store.rows("SELECT runid, episode FROM robots ORDER BY runid, robot")
    rows = [{"run": row["runid"], **json.loads(row["episode"])} for row in records]
    schema = pa.schema([pa.field("run", pa.int64()), *EPISODE_SCHEMA])
    columns = {field.name: [row.get(field.name) for row in rows] for field in schema}
    return pa.table(columns, schema=schema)


def build_progress_table(store: BenchmarkStore) -> pa.Table:
    """How the best cost of planners that go on improving fell."""
    records = store.rows("SELECT runid, time, best_cost FROM progress ORDER BY runid, time")
    schema = pa.schema(
        [
            pa.field("run", pa.int64()),
            pa.field("time_s", pa.float64()),
            pa.field("cost", pa.float64()),
        ]
    )
    columns = [[row[i] for row in records] for i in range(3)]
    return pa.table(dict(zip(schema.names, columns, strict=True)), schema=schema)


def write_tables(store: BenchmarkStore, folder: Path) -> None:
    """Write all of them into a folder."""
    for name, build in (
        (RUNS, build_runs_table),
        (ROBOTS, build_robots_table),
        (PROGRESS, build_progress_table),
    ):
        atomic_files.write_parquet(folder / name, build(store), compression="zstd")
