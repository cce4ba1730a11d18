"""The database of a benchmark: one SQLite file, in which a finished run is never lost.

Its tables experiments, plannerConfigs, runs, enums and progress are those of OMPL's benchmarks, as
Planner Arena reads them; columns of ours stand beside OMPL's. Tables of our own hold what is no
number: ``words`` and ``plans`` of a run, and rows of ``robots``; ``closed`` says what was not
asked; ``scenery`` and ``tracks`` hold the worlds that are drawn. Whatever was committed is on the
disk: a process may be killed at any time.
"""

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from math import isfinite
from pathlib import Path
from types import TracebackType
from typing import Self

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.studies.benchmark.columns import NUMBER_COLUMNS, POLICY, RENAMED, TEXT_COLUMNS
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.problem_settings import Setting

FILE = "results.sqlite"

STATUS = ("planned", "partial", "none", "timeout", "error", "died", POLICY)
"""How planning ends, by its number in the database."""

_KINDS = {"double": "REAL", "int32": "INTEGER", "bool": "BOOLEAN"}

_SCHEMA = """
CREATE TABLE experiments (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512), totaltime REAL,
    timelimit REAL, memorylimit REAL, runcount INTEGER, version VARCHAR(128),
    hostname VARCHAR(1024), cpuinfo TEXT, date DATETIME, seed VARCHAR(24), setup TEXT,
    preset TEXT, robots INTEGER, knows_obstacles TEXT, knows_current TEXT, problem_seed INTEGER);
CREATE TABLE plannerConfigs (id INTEGER PRIMARY KEY AUTOINCREMENT, name VARCHAR(512) NOT NULL,
    settings TEXT);
CREATE TABLE enums (name VARCHAR(512), value INTEGER, description TEXT, PRIMARY KEY (name, value));
CREATE TABLE runs (id INTEGER PRIMARY KEY AUTOINCREMENT, experimentid INTEGER, plannerid INTEGER,
    world INTEGER, status ENUM, {columns}, UNIQUE (experimentid, plannerid, world),
    FOREIGN KEY (experimentid) REFERENCES experiments(id) ON DELETE CASCADE,
    FOREIGN KEY (plannerid) REFERENCES plannerConfigs(id) ON DELETE CASCADE);
CREATE TABLE progress (runid INTEGER, time REAL, best_cost REAL, PRIMARY KEY (runid, time),
    FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
CREATE TABLE words (runid INTEGER PRIMARY KEY, plan_reason TEXT, failure TEXT, failure_pair TEXT,
    FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
CREATE TABLE plans (runid INTEGER PRIMARY KEY, paths BLOB,
    FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
CREATE TABLE robots (runid INTEGER, robot INTEGER, episode TEXT, PRIMARY KEY (runid, robot),
    FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
CREATE TABLE tracks (runid INTEGER PRIMARY KEY, track BLOB,
    FOREIGN KEY (runid) REFERENCES runs(id) ON DELETE CASCADE);
CREATE TABLE scenery (experimentid INTEGER, world INTEGER, arrays BLOB,
    PRIMARY KEY (experimentid, world));
CREATE TABLE closed (experimentid INTEGER, plannerid INTEGER, world INTEGER, status TEXT,
    reason TEXT,
    PRIMARY KEY (experimentid, plannerid, world));
"""

SETTING_COLUMNS = ("preset", "robots", "knows_obstacles", "knows_current", "problem_seed")
"""Of an experiment, beside OMPL's."""


class BenchmarkStore:
    """The database, open."""

    def __init__(self, path: Path, *, new: bool = False, only_read: bool = False) -> None:
        """Open or make it.

        Args:
            path: of the file.
            new: make it.
            only_read: leave it as it is.

        Raises:
            ConfigError: it is none, or is damaged.
            RunError: it cannot be written.
        """
        self.path, self._only_read = path, only_read
        try:
            mode = "ro" if only_read else "rwc"
            self._base = sqlite3.connect(f"{path.absolute().as_uri()}?mode={mode}", uri=True)
            self._base.row_factory = sqlite3.Row
            if not only_read:
                self._base.execute("PRAGMA journal_mode = WAL")
                self._base.execute("PRAGMA synchronous = FULL")
            if new:
                columns = ", ".join(
                    f"{name} {_KINDS[str(column.kind)]}" for column, name in NUMBER_COLUMNS
                )
                self._base.executescript(_SCHEMA.format(columns=columns))
                rows = [("status", i, text) for i, text in enumerate(STATUS)]
                self._write("INSERT INTO enums VALUES (?, ?, ?)", rows)
            self._base.execute("SELECT count(*) FROM closed")
            if not only_read:
                self._update_columns()
        except sqlite3.DatabaseError as error:
            raise self._name_error(error) from error

    def _update_columns(self) -> None:
        """Rename columns of runs in a database of an older version, and add those that it lacks."""
        existing = {row["name"] for row in self._base.execute("PRAGMA table_info(runs)")}
        for old, new in RENAMED.items():
            if old in existing and new not in existing:
                self._base.execute(f"ALTER TABLE runs RENAME COLUMN {old} TO {new}")
                existing.add(new)
        for column, name in NUMBER_COLUMNS:
            if name not in existing:
                kind = _KINDS[str(column.kind)]
                self._base.execute(f"ALTER TABLE runs ADD COLUMN {name} {kind}")

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(self, *why: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Leave one file that holds everything."""
        with suppress(sqlite3.Error):  # another one reads it: it is whole with its log beside it
            if not self._only_read:
                self._base.execute("PRAGMA journal_mode = DELETE")
        self._base.close()

    def ensure_setting(self, setting: Setting, about: Mapping[str, object]) -> int:
        """The number of a setting's experiment; makes it if there is none.

        Args:
            setting: whose.
            about: more of OMPL's columns.
        """
        information = setting.information
        key_values = {
            "name": setting.scene,
            "preset": setting.preset,
            "robots": setting.robots,
            "knows_obstacles": information.obstacles,
            "knows_current": information.current,
            "problem_seed": setting.seed,
        }
        where = " AND ".join(f"{key} = :{key}" for key in key_values)
        rows = self.rows(f"SELECT id FROM experiments WHERE {where}", key_values)
        if rows:
            return int(rows[0]["id"])
        other_values = {
            "timelimit": setting.scenario.planner.deadline_s,
            "runcount": setting.scenario.worlds,
            "seed": str(setting.seed),
            **about,
        }
        return self._insert("experiments", {**key_values, **other_values})

    def ensure_planner(self, planner: ComparedPlanner) -> int:
        """The number of a planner; makes it if there is none."""
        rows = self.rows("SELECT id FROM plannerConfigs WHERE name = ?", (planner.label,))
        if rows:
            return int(rows[0]["id"])
        settings = {"name": planner.name, **planner.settings, **planner.online}
        return self._insert(
            "plannerConfigs",
            {"name": planner.label, "settings": json.dumps(settings, sort_keys=True)},
        )

    def add(
        self,
        experiment: int,
        planner: int,
        world: int,
        status: str,
        measured: Mapping[str, object],
        paths: bytes | None,
        progress: Iterable[tuple[float, float]] = (),
    ) -> int:
        """Keep a run that was planned.

        Args:
            experiment: of its setting.
            planner: that planned.
            world: index.
            status: how that ended.
            measured: by the names of `angler_mjx.studies.benchmark.columns`.
            paths: the plans, packed; None where there is none.
            progress: times and costs of improvements.

        Returns:
            Its number.
        """
        key_values = {"experimentid": experiment, "plannerid": planner, "world": world}
        with self._transaction():
            run = self._insert_one(
                "runs", {**key_values, "status": STATUS.index(status), **_number_values(measured)}
            )
            self._insert_one("words", {"runid": run, **_text_values(measured)})
            if paths is not None:
                self._insert_one("plans", {"runid": run, "paths": paths})
            self._base.executemany(
                "INSERT OR REPLACE INTO progress VALUES (?, ?, ?)",
                [(run, time_s, cost) for time_s, cost in progress],
            )
        return run

    def close_problems(
        self, experiment: int, planner: int, worlds: Iterable[int], status: str, reason: str
    ) -> None:
        """Say that a planner is not asked some problems, and why."""
        rows = [(experiment, planner, world, status, reason) for world in worlds]
        self._write("INSERT OR REPLACE INTO closed VALUES (?, ?, ?, ?, ?)", rows)

    def add_flights(
        self,
        flights: Sequence[tuple[int, Mapping[str, object], Sequence[Mapping[str, object]]]],
        tracks: Mapping[int, bytes],
    ) -> None:
        """Keep what became of some runs' plans; all or none of them.

        Args:
            flights: number of the run, what was measured, and a row of each robot.
            tracks: where robots of some runs were, by the runs' numbers.
        """
        with self._transaction():
            self._base.executemany("INSERT OR REPLACE INTO tracks VALUES (?, ?)", tracks.items())
            for run, measured, robots in flights:
                numbers = _number_values(measured)
                keys = ", ".join(f"{key} = :{key}" for key in numbers)
                self._base.execute(f"UPDATE runs SET {keys} WHERE id = :id", {**numbers, "id": run})
                self._base.execute(
                    "UPDATE words SET failure = :failure, failure_pair = :failure_pair "
                    "WHERE runid = :run",
                    {**_text_values(measured), "run": run},
                )
                self._base.executemany(
                    "INSERT OR REPLACE INTO robots VALUES (?, ?, ?)",
                    [(run, row["robot"], _encode_json(row)) for row in robots],
                )

    def add_scenery(self, experiment: int, world: int, arrays: bytes) -> None:
        """Keep what a world looks like."""
        row = (experiment, world, arrays)
        self._write("INSERT OR REPLACE INTO scenery VALUES (?, ?, ?)", [row])

    def add_time(self, experiment: int, seconds: float) -> None:
        """Say that so much more time was spent on a setting."""
        self._write(
            "UPDATE experiments SET totaltime = coalesce(totaltime, 0) + ? WHERE id = ?",
            [(seconds, experiment)],
        )

    def rows(
        self, query: str, values: Mapping[str, object] | Sequence[object] = ()
    ) -> list[sqlite3.Row]:
        """What a query finds.

        Raises:
            ConfigError: the file is damaged.
        """
        try:
            return self._base.execute(query, values).fetchall()
        except sqlite3.DatabaseError as error:
            raise self._name_error(error) from error

    def _insert(self, table: str, row: Mapping[str, object]) -> int:
        with self._transaction():
            return self._insert_one(table, row)

    def _insert_one(self, table: str, row: Mapping[str, object]) -> int:
        names = ", ".join(row)
        placeholders = ", ".join(f":{name}" for name in row)
        cursor = self._base.execute(f"INSERT INTO {table} ({names}) VALUES ({placeholders})", row)
        return int(cursor.lastrowid or 0)

    def _write(self, query: str, rows: Sequence[tuple[object, ...]]) -> None:
        with self._transaction():
            self._base.executemany(query, rows)

    def _transaction(self) -> "_Transaction":
        return _Transaction(self._base, self)

    def _name_error(self, error: sqlite3.Error) -> Exception:
        message = f"{self.path}: {error}"
        if isinstance(error, sqlite3.OperationalError) and "disk" in str(error):
            return RunError(f"{message}; make room and go on with --resume")
        return ConfigError(f"{message}; this is no database of a benchmark, or it is damaged")


class _Transaction:
    """A transaction, whose errors name the file."""

    def __init__(self, base: sqlite3.Connection, store: BenchmarkStore) -> None:
        self._base, self._store = base, store

    def __enter__(self) -> None:
        self._base.__enter__()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._base.__exit__(kind, error, trace)
        except sqlite3.Error as failed:
            raise self._store._name_error(failed) from failed
        if isinstance(error, sqlite3.Error):
            raise self._store._name_error(error) from error


def _number_values(measured: Mapping[str, object]) -> dict[str, object]:
    """By the database's names; what is not measured is left out."""
    values = {
        name: measured.get(column.name)
        for column, name in NUMBER_COLUMNS
        if column.name in measured
    }
    return {name: value for name, value in values.items() if value is not None}


def _encode_json(row: Mapping[str, object]) -> str:
    """As JSON, which has no NaN."""
    finite = {k: None if isinstance(x, float) and not isfinite(x) else x for k, x in row.items()}
    return json.dumps(finite)


def _text_values(measured: Mapping[str, object]) -> dict[str, object]:
    return {name: measured.get(name) for name in TEXT_COLUMNS}
