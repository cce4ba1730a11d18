"""The results folder of a benchmark, read: rows as NumPy columns, failed robots, examples."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NotRequired, TypedDict, cast

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from angler_mjx.errors import ConfigError
from angler_mjx.files import format_path, read_json

RUNS, ROBOTS, ABOUT, EXAMPLES = "runs.parquet", "robots.parquet", "about.json", "examples"
CLOSED = "closed"
"""Status of a run that was not asked, as its cell had been given up."""
NO_ROOM = "no room"
"""Status of a run that nobody was asked, as its world cannot hold the team."""

POLICY = "policy"
"""Status of a run in which a policy flew: nothing was to be planned."""

TEXT_COLUMNS = ("planner", "scene", "preset", "knows_obstacles", "knows_current", "plan_status")
INTEGER_COLUMNS = ("run", "robots", "problem_seed", "world", "robots_planned", "robots_reached")
BOOLEAN_COLUMNS = ("planned", "flown", "success")
MEASURES = (
    "planning_s",
    "first_s",
    "best_s",
    "makespan_s",
    "flowtime_s",
    "energy_j",
    "plan_turn_rad",
    "min_clearance_m",
    "min_separation_m",
    "density",
    "path_ratio",
    "free_lines",
)
"""Columns of numbers that may be missing in a row."""
OPTIONAL_COLUMNS = ("failed_replans",)
"""Columns of numbers that older folders lack."""
FAILURE_COLUMNS = ("failure_x_m", "failure_y_m")

_HELP = "give the results folder of a benchmark"


@dataclass(frozen=True)
class Runs:
    """Rows of ``runs.parquet``, a column each; what is missing in a column of numbers is NaN."""

    columns: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def __len__(self) -> int:
        return len(self.columns["run"])

    def where(self, chosen: np.ndarray) -> "Runs":
        """The rows that a mask, or indices, choose."""
        return Runs({name: values[chosen] for name, values in self.columns.items()})

    @cached_property
    def requested(self) -> np.ndarray:
        """Bool [n]: neither closed nor without room."""
        requested: np.ndarray = ~np.isin(self["plan_status"].astype(str), (CLOSED, NO_ROOM))
        return requested

    @cached_property
    def counted(self) -> np.ndarray:
        """Bool [n]: asked, or taken to fail as the planner had been given up.

        Where cells are pooled, or planners compared, what hopeless planners were not asked must
        not be left out: the easy problems alone would be left.
        """
        counted: np.ndarray = self["plan_status"] != NO_ROOM
        return counted

    @cached_property
    def knowledge(self) -> np.ndarray:
        """Str [n]: what a planner was told of obstacles / of the current."""
        pairs = zip(self["knows_obstacles"], self["knows_current"], strict=True)
        return np.array([f"{a} / {b}" for a, b in pairs], object)

    @cached_property
    def planners(self) -> list[str]:
        """Labels, in the order of the rows."""
        return list(dict.fromkeys(self["planner"].tolist()))

    @cached_property
    def scenes(self) -> list[str]:
        """Scenes, in the order of the rows."""
        return list(dict.fromkeys(self["scene"].tolist()))


@dataclass(frozen=True, kw_only=True)
class ReportFailures:
    """Where robots failed, a row each."""

    run: np.ndarray
    outcome: np.ndarray
    x_m: np.ndarray
    y_m: np.ndarray


class OnlineFlights(TypedDict, total=False):
    """Replanning and order of a planner's flights."""

    replan_hz: float
    order: str


class AnnouncedPlanner(TypedDict):
    """A planner of a benchmark, as its folder announces it."""

    label: str
    name: str
    online: NotRequired[OnlineFlights]


class About(TypedDict, total=False):
    """Contents of ``about.json`` that figures read; the page shows others too."""

    name: str
    deadline_s: float | None
    planners: list[AnnouncedPlanner]
    scenes: list[str]


@dataclass(frozen=True, kw_only=True)
class Results:
    """All that a report is made of."""

    folder: Path
    about: About
    runs: Runs
    problem: np.ndarray
    """int [n] which problem a row is; see `index_problems`."""
    world: np.ndarray
    """int [n] which world a row lies in, whatever team; worlds are independent."""
    failures: ReportFailures
    examples: list[Path]

    @property
    def judged(self) -> str:
        """The column that rates are of: success, or planned while nothing has been flown."""
        return "success" if self.runs["flown"].any() else "planned"

    @property
    def pending(self) -> int:
        """Runs that were planned, or are a policy's, and have not been flown."""
        runs = self.runs
        ready = runs["planned"] | (runs["plan_status"] == POLICY)
        return int(np.sum(ready & ~runs["flown"] & runs.requested))

    @cached_property
    def planners(self) -> list[str]:
        """Labels: those announced, then others that rows have."""
        announced = [str(entry["label"]) for entry in self.about.get("planners", [])]
        return _order_names(announced, self.runs.planners)

    @cached_property
    def planner(self) -> np.ndarray:
        """Int [n]: index of the planner of each row."""
        number = {name: i for i, name in enumerate(self.planners)}
        return np.array([number[name] for name in self.runs["planner"].tolist()], int)

    @cached_property
    def scenes(self) -> list[str]:
        """Scenes: those announced, then others that rows have."""
        return _order_names([str(name) for name in self.about.get("scenes", [])], self.runs.scenes)

    @cached_property
    def run_table(self) -> np.ndarray:
        """Int [planner, problem]: row of the counted run, -1 without one."""
        table = np.full((len(self.planners), int(self.problem.max()) + 1), -1)
        rows = np.flatnonzero(self.runs.counted)[::-1]
        table[self.planner[rows], self.problem[rows]] = rows
        return table

    def select_runs(self, rows: np.ndarray) -> np.ndarray:
        """Return the part of `run_table` that holds selected rows.

        Args:
            rows: bool [n].
        """
        table = np.where(np.append(rows, False)[self.run_table], self.run_table, -1)
        return table[:, np.any(table >= 0, axis=0)]


def read_results(folder: Path) -> Results:
    """Read a results folder; it need not be complete.

    Raises:
        ConfigError: it is none, or holds no run.
    """
    if not folder.is_dir():
        raise ConfigError(f"{format_path(folder)}: no folder; {_HELP}")
    for name in (ABOUT, RUNS):
        if not (folder / name).is_file():
            raise ConfigError(f"{format_path(folder)}: holds no {name}; {_HELP}")
    about = read_json(folder / ABOUT)
    if not isinstance(about, dict):
        raise ConfigError(f"{format_path(folder / ABOUT)}: holds no table; {_HELP}")
    runs = _read_runs(folder / RUNS)
    if len(runs) == 0:
        raise ConfigError(
            f"{format_path(folder / RUNS)}: holds no run yet; let the benchmark go on"
        )
    problem = index_problems(runs)
    return Results(
        folder=folder,
        about=cast(About, about),
        runs=runs,
        problem=problem,
        world=index_worlds(runs),
        failures=_read_failures(folder / ROBOTS, runs),
        examples=sorted((folder / EXAMPLES).glob("*.npz"), key=lambda path: (len(path.name), path)),
    )


def index_problems(runs: Runs) -> np.ndarray:
    """Int [n] which problem each row is: scene, team, seed and world.

    Where a planner was asked one problem with several degrees of knowledge, these are problems of
    their own; otherwise planners with different knowledge are compared on one problem.
    """
    names = ("scene", "robots", "problem_seed", "world")
    without_information = _number_rows(runs, names)
    planner = _number_rows(runs, ("planner",))
    if len(np.unique(np.stack([without_information, planner]), axis=1).T) == len(runs):
        return without_information
    return _number_rows(runs, (*names, "knows_obstacles", "knows_current"))


def index_worlds(runs: Runs) -> np.ndarray:
    """Int [n] which world each row lies in, whatever team."""
    return _number_rows(runs, ("scene", "problem_seed", "world"))


def _number_rows(runs: Runs, names: tuple[str, ...]) -> np.ndarray:
    keys = list(zip(*(runs[name].tolist() for name in names), strict=True))
    number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    return np.array([number[key] for key in keys], int)


def _order_names(announced: list[str], present: list[str]) -> list[str]:
    return [name for name in dict.fromkeys([*announced, *present]) if name in set(present)]


def _read_table(path: Path) -> pa.Table:
    try:
        return pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        raise ConfigError(f"{format_path(path)}: cannot be read ({error}); {_HELP}") from error


def _read_runs(path: Path) -> Runs:
    table = _read_table(path)
    wanted = (
        *TEXT_COLUMNS,
        *INTEGER_COLUMNS,
        *BOOLEAN_COLUMNS,
        *MEASURES,
        *FAILURE_COLUMNS,
        "failure",
    )
    missing = [name for name in wanted if name not in table.column_names]
    if missing:
        raise ConfigError(f"{format_path(path)}: lacks the columns {', '.join(missing)}; {_HELP}")
    columns = {name: _to_text_array(table[name]) for name in (*TEXT_COLUMNS, "failure")}
    columns |= {name: table[name].fill_null(0).to_numpy() for name in INTEGER_COLUMNS}
    columns |= {
        name: np.array(table[name].fill_null(False).to_pylist(), bool) for name in BOOLEAN_COLUMNS
    }
    columns |= {name: _to_float_array(table[name]) for name in (*MEASURES, *FAILURE_COLUMNS)}
    empty = np.full(table.num_rows, np.nan)
    column_names = table.column_names
    columns |= {
        name: _to_float_array(table[name]) if name in column_names else empty
        for name in OPTIONAL_COLUMNS
    }
    return Runs(columns)


def _to_text_array(column: pa.ChunkedArray) -> np.ndarray:
    return np.array(["" if text is None else text for text in column.to_pylist()], object)


def _to_float_array(column: pa.ChunkedArray) -> np.ndarray:
    values: np.ndarray = column.cast(pa.float64()).to_numpy()
    return values


def _read_failures(path: Path, runs: Runs) -> ReportFailures:
    """All robots that had a path, or a policy, and failed; without a table the first of each."""
    needed = ("run", "planned", "outcome", *FAILURE_COLUMNS)
    if path.is_file():
        table = _read_table(path)
        if all(name in table.column_names for name in needed):
            flew = runs["run"][runs["plan_status"] == POLICY]
            table = table.filter(
                pc.or_(table["planned"], pc.is_in(table["run"], pa.array(flew, pa.int64())))
            )
            return _select_failures(
                table["run"].to_numpy(),
                _to_text_array(table["outcome"]),
                *(_to_float_array(table[name]) for name in FAILURE_COLUMNS),
            )
    return _select_failures(runs["run"], runs["failure"], *(runs[name] for name in FAILURE_COLUMNS))


def _select_failures(
    run: np.ndarray, outcome: np.ndarray, x: np.ndarray, y: np.ndarray
) -> ReportFailures:
    kept = np.isfinite(x) & np.isfinite(y) & (outcome != "reached") & (outcome != "")
    return ReportFailures(run=run[kept], outcome=outcome[kept], x_m=x[kept], y_m=y[kept])
