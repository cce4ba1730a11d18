"""Columns of a run, by their names: in the database and in the tables made of it."""

from typing import NamedTuple

import pyarrow as pa


class Column(NamedTuple):
    """Of one run."""

    name: str
    kind: pa.DataType
    unit: str
    text: str
    stored: str | None
    """As the database calls it, in its table of runs; in that of words if None."""


RENAMED = {"flown_length_m": "path_length_m"}
"""Columns of databases that older versions made, and their names now."""

_F, _I, _B, _S = pa.float64(), pa.int32(), pa.bool_(), pa.string()

MEASURE_COLUMNS: tuple[Column, ...] = (
    Column("planning_s", _F, "s", "wall time inside plan(); compiling apart", "time"),
    Column("warm_up_s", _F, "s", "compiling before it, where this run was a process's first", ""),
    Column("first_s", _F, "s", "to the first plan", ""),
    Column(
        "best_s", _F, "s", "to the plan that was given, where the planner went on improving", ""
    ),
    Column("planned", _B, "1", "every robot has a path", "solved"),
    Column("robots_planned", _I, "1", "robots that have one", ""),
    Column("plan_length_m", _F, "m", "planned length, sum of all robots", "solution_length"),
    Column("plan_makespan_s", _F, "s", "when the last path is over", ""),
    Column("plan_flowtime_s", _F, "s", "sum of the times of all paths", ""),
    Column("plan_turn_rad", _F, "rad", "turning along a path, mean of robots", "solution_turning"),
    Column("flown", _B, "1", "some robot had a path, and the plans were flown", ""),
    Column("robots_reached", _I, "1", "robots that arrived", ""),
    Column("reached", _B, "1", "all robots arrived", ""),
    Column("success", _B, "1", "every robot had a path, or a policy, and arrived", ""),
    Column("makespan_s", _F, "s", "arrival of the last robot; null unless all arrived", ""),
    Column("flowtime_s", _F, "s", "sum of all arrivals; null unless all arrived", ""),
    Column("late_s", _F, "s", "latest arrival after the end of its path", ""),
    Column(
        "failed_replans",
        _I,
        "1",
        "times that a robot on its way got no new plan, sum of robots; null if none was asked for",
        "",
    ),
    Column("path_length_m", _F, "m", "flown length, sum of all robots", ""),
    Column("energy_j", _F, "J", "electrical energy of the thrusters of all robots", ""),
    Column("min_clearance_m", _F, "m", "least hull distance to cells, floor, obstacles", ""),
    Column("min_separation_m", _F, "m", "least hull distance of two robots, at most 1", ""),
    Column("failure_time_s", _F, "s", "end of the first robot that failed", ""),
    Column("failure_x_m", _F, "m", "where that was, east", ""),
    Column("failure_y_m", _F, "m", "north", ""),
    Column("failure_z_m", _F, "m", "up, 0 at the surface", ""),
    Column("failure_robot", _I, "1", "which robot that was", ""),
    Column("failure", _S, "", "its outcome", None),
    Column(
        "failure_pair", _S, "", "what it touched: cell, floor, obstacle:i, robot:i; or none", None
    ),
    Column("density", _F, "1", "share of the world's cells that are rock", ""),
    Column("path_ratio", _F, "1", "shortest way over straight line, mean of robots", ""),
    Column("free_lines", _F, "1", "share of robots whose straight line is free of rock", ""),
    Column("straight_m", _F, "m", "sum of the straight lines", ""),
)
"""What is measured of a run; ``stored`` is "" where the database has the same name."""

KEY_COLUMNS: tuple[Column, ...] = (
    Column("run", pa.int64(), "1", "number of the run in the database; null if not asked", None),
    Column("planner", _S, "", "label of the planner", None),
    Column("planner_name", _S, "", "name of the planner", None),
    Column("scene", _S, "", "preset and scene", None),
    Column("preset", _S, "", "preset of the world", None),
    Column("robots", _I, "1", "size of the team", None),
    Column("knows_obstacles", _S, "", "what was known of moving obstacles", None),
    Column("knows_current", _S, "", "what was known of the current", None),
    Column("problem_seed", pa.int64(), "1", "seed of the world", None),
    Column("world", pa.int64(), "1", "index of the world", None),
    Column(
        "plan_status",
        _S,
        "",
        "how planning ended; closed, no room: not asked; policy: needs none",
        None,
    ),
    Column("plan_reason", _S, "", "why there are not plans for all robots", None),
)
"""What says which run it is, and how planning ended."""

RUN_SCHEMA = pa.schema(
    [
        pa.field(one.name, one.kind, metadata={"unit": one.unit, "description": one.text})
        for one in (*KEY_COLUMNS, *MEASURE_COLUMNS)
    ]
)
"""Columns of ``runs.parquet``."""

NUMBER_COLUMNS = tuple(
    (one, one.stored or one.name) for one in MEASURE_COLUMNS if one.stored is not None
)
"""Columns that the database's table of runs holds, and what they are called there."""

TEXT_COLUMNS = ("plan_reason", "failure", "failure_pair")
"""Columns that its table of words holds."""

CLOSED, NO_ROOM = "closed", "no room"
"""Statuses of problems that a planner was not asked: it had been given up on; the world has no room
for the team."""

POLICY = "policy"
"""Status of problems that a policy flew: nothing was planned before the start."""
