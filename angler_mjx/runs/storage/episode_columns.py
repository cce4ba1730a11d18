"""The columns of ``episodes.parquet``: one row per robot per world."""

import pyarrow as pa

_FIELDS: tuple[tuple[str, pa.DataType, str, str], ...] = (
    ("world", pa.int64(), "1", "index of the world; with the seed it makes the world again"),
    ("robot", pa.int32(), "1", "index in the fleet"),
    ("seed", pa.int64(), "1", "seed of the run"),
    ("vehicle", pa.string(), "", "vehicle"),
    ("parameter_set", pa.string(), "", "hydrodynamic parameter set"),
    ("planned", pa.bool_(), "1", "whether the planner found a way"),
    ("outcome", pa.string(), "", "how the episode ended"),
    ("time_to_goal_s", pa.float32(), "s", "arrival; null if not reached"),
    ("path_length_m", pa.float32(), "m", "way of the centre of mass until the end"),
    ("energy_j", pa.float32(), "J", "electrical energy of the thrusters until the end"),
    ("min_clearance_m", pa.float32(), "m", "least hull distance to cells, floor, obstacles"),
    (
        "min_separation_m",
        pa.float32(),
        "m",
        "least hull distance to other robots, at most 1; null if alone",
    ),
    ("failure_time_s", pa.float32(), "s", "end of a failed episode; null if reached"),
    ("failure_x_m", pa.float32(), "m", "centre of mass then, east; null if reached"),
    ("failure_y_m", pa.float32(), "m", "north; null if reached"),
    ("failure_z_m", pa.float32(), "m", "up, 0 at the surface; null if reached"),
    (
        "failure_pair",
        pa.string(),
        "",
        "what was touched: cell, floor, obstacle:i, robot:i; or none",
    ),
    ("impact_speed_mps", pa.float32(), "m/s", "relative speed at the touch; null without one"),
    ("redraws", pa.int32(), "1", "drawings thrown away before this world"),
    ("planning_s", pa.float32(), "s", "planner's time for the world; null on the device"),
    ("plan_status", pa.string(), "", "how planning ended, see docs/planners.md"),
    ("plan_reason", pa.string(), "", "why the robot has no path; null if it has one, or unknown"),
    ("plan_length_m", pa.float32(), "m", "planned way; null without a path"),
    ("plan_end_s", pa.float32(), "s", "when the path is over; null without a path"),
    ("late_s", pa.float32(), "s", "arrival after the end of the path; null if not reached"),
    (
        "failed_replans",
        pa.int32(),
        "1",
        "times that no new plan was found on the way; null where none was asked for",
    ),
    ("variant", pa.int32(), "1", "number in variants.json, where vehicles are randomised"),
    ("current_factor", pa.float32(), "1", "the current's, drawn for the world; null where not"),
    ("sensor_noise_factor", pa.float32(), "1", "the robot's, drawn; null where not"),
    ("jobs_done", pa.int32(), "1", "jobs of the task that the robot did; null without a task"),
    (
        "task_progress",
        pa.float32(),
        "1",
        "share of the world's task that was done, of a survey that was seen; null without one",
    ),
    (
        "task_completed_s",
        pa.float32(),
        "s",
        "when the world's task was complete; null where it never was",
    ),
    ("packets_sent", pa.int32(), "1", "packets that the robot began; null without acoustics"),
    ("packets_heard", pa.int32(), "1", "packets of others that it understood; null likewise"),
    (
        "passed_goal_early",
        pa.bool_(),
        "1",
        "whether it was at its goal before its plan's last approach; null in older runs",
    ),
)

ADDED_COLUMNS = (1, 6, 9, 10, 16)
"""Columns at the end that older runs lack: before a plan was flown no sooner than on its last
approach, before there were tasks and acoustics, before vehicles
were randomised, before failed replans were told, and before there was a choice of planners."""

NULLABLE_NUMBERS = (
    "time_to_goal_s",
    "min_separation_m",
    "failure_time_s",
    "failure_x_m",
    "failure_y_m",
    "failure_z_m",
    "impact_speed_mps",
    "planning_s",
    "plan_length_m",
    "plan_end_s",
    "late_s",
    "failed_replans",
    "variant",
    "current_factor",
    "sensor_noise_factor",
    "jobs_done",
    "task_progress",
    "task_completed_s",
    "packets_sent",
    "packets_heard",
)
"""Columns in which a value may be missing: null, so that two tables of the same rows are equal."""

NULLABLE_OTHERS = ("plan_status", "plan_reason", "passed_goal_early")
"""Other columns in which a value may be missing."""

EPISODE_SCHEMA = pa.schema(
    [
        pa.field(name, kind, metadata={"unit": unit, "description": text})
        for name, kind, unit, text in _FIELDS
    ]
)
"""Columns of ``episodes.parquet``, with unit and meaning in each field's metadata."""
