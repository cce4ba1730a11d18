"""Columns of ``episodes.parquet``, one row per robot per world: each is declared once, here.

A declaration says name, type, unit, meaning, whether values may be missing, and how the values of a
tile of worlds are computed. Schema, rows, reading of older tables and the reference page follow
from `EPISODE_COLUMNS`; ``python -m angler_mjx.runs.storage.episode_columns docs/generated`` writes
the page.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa

from angler_mjx.planning.online.policy import ReplanningMemory
from angler_mjx.planning.online.replanning import FleetPlans
from angler_mjx.robot.control.plans import length_m
from angler_mjx.runs.simulator.host_planning import PlanNotes, planning_status
from angler_mjx.sim.state import Outcome, Tally, Touched, World, WorldState
from angler_mjx.world.tasks.spec import TaskState


@dataclass(frozen=True, kw_only=True)
class TileResult:
    """Host arrays of a finished tile, from which its rows are computed; [w, r] lead."""

    world: np.ndarray
    """int [w] global indices."""
    variant: np.ndarray
    """int [w, r]."""
    planned: np.ndarray
    """bool [w, r]."""
    outcome: np.ndarray
    """int [w, r]; robots that still ran at the horizon have a time-out."""
    tally: Tally
    p: np.ndarray
    """[w, r, 3] final position, m in W."""
    notes: PlanNotes | None = None
    """None where worlds were planned on the device."""
    task: TaskState | None = None
    """None where each robot has a goal of its own."""
    kept: Mapping[str, np.ndarray] = field(default_factory=dict)
    """[w] or [w, r] values of the columns that are taken from worlds or states, by name."""
    variants: Sequence[tuple[str, str]] = ()
    """Vehicle and parameter set of each variant; of the run, as the next."""
    seed: int = 0

    @property
    def is_reached(self) -> np.ndarray:
        """Bool [w, r] robots that reached their goals."""
        reached: np.ndarray = self.outcome == Outcome.REACHED
        return reached

    def where_planned(self, name: str) -> np.ndarray:
        """Return kept values [w, r] of robots with a path; NaN for the others."""
        return np.where(self.planned, self.kept[name], np.nan)


type ColumnValues = np.ndarray | jax.Array | None
"""[w] or [w, r] values of a column on the host; None where all are missing."""


@dataclass(frozen=True)
class EpisodeColumn:
    """A column of the episode table.

    One of the three functions gives its values; with one of the last two, `of_tile` may convert
    them on the host (`TileResult.kept`).
    """

    name: str
    type: pa.DataType
    unit: str
    """Empty for text, "1" for numbers without a unit."""
    text: str
    """Meaning, and when the value is missing."""
    _: KW_ONLY
    may_be_null: bool = False
    """Whether values may be missing from the first edition of the table on."""
    since: int = 0
    """Edition of the table that added the column: one more than the last column's. Tables of older
    editions are read with nulls in it."""
    of_tile: Callable[[TileResult], ColumnValues] | None = None
    """Values on the host."""
    of_world: Callable[[World], jax.Array | None] | None = None
    """Values on the device from the sampled worlds; [w] or [w, r], None where all are missing."""
    of_state: Callable[[WorldState], jax.Array | None] | None = None
    """Values on the device from the last state, likewise."""

    @property
    def nullable(self) -> bool:
        """Whether values may be missing; numbers that are not finite are stored as null."""
        return self.may_be_null or self.since > 0

    @property
    def arrow_field(self) -> pa.Field:
        """Field of the schema, with unit and meaning as metadata."""
        return pa.field(
            self.name, self.type, metadata={"unit": self.unit, "description": self.text}
        )

    def build(self, result: TileResult) -> pa.Array:
        """Return the column's values [w * r] of a tile."""
        values = result.kept.get(self.name) if self.of_tile is None else self.of_tile(result)
        shape = result.outcome.shape
        if values is None:
            return pa.nulls(result.outcome.size, self.type)
        by_robot = np.asarray(values if values.ndim == 2 else values[:, None])
        rows = np.broadcast_to(by_robot, shape).reshape(-1)
        if pa.types.is_string(self.type):
            return pa.array(rows.tolist(), self.type)
        missing = ~np.isfinite(rows) if self.nullable and rows.dtype.kind == "f" else None
        return pa.array(rows.astype(self.type.to_pandas_dtype()), self.type, mask=missing)


def select_world_columns(worlds: World) -> dict[str, jax.Array]:
    """Return the values of all columns that are taken from sampled worlds, by name."""
    values = {x.name: x.of_world(worlds) for x in EPISODE_COLUMNS if x.of_world is not None}
    return {name: value for name, value in values.items() if value is not None}


def select_state_columns(state: WorldState) -> dict[str, jax.Array]:
    """Return the values of all columns that are taken from the last state, by name."""
    values = {x.name: x.of_state(state) for x in EPISODE_COLUMNS if x.of_state is not None}
    return {name: value for name, value in values.items() if value is not None}


def _vehicle_labels(result: TileResult, part: int) -> np.ndarray:
    labels = np.array([variant[part] for variant in result.variants], object)
    return np.take(labels, result.variant)


def _outcome_names(result: TileResult) -> np.ndarray:
    names = np.array([outcome.name.lower() for outcome in Outcome], object)
    return np.take(names, result.outcome)


def _arrival_s(result: TileResult) -> np.ndarray:
    return np.where(result.is_reached, result.tally.end_time_s, np.nan)


def _failure_time_s(result: TileResult) -> np.ndarray:
    return np.where(result.is_reached, np.nan, result.tally.end_time_s)


def _failure_position(result: TileResult, axis: int) -> np.ndarray:
    return np.where(result.is_reached, np.nan, result.p[..., axis])


def _cargo_error(result: TileResult, name: str) -> ColumnValues:
    error = result.tally.cargo_error
    return None if error is None else getattr(error, name)


def _failure_pair(result: TileResult) -> np.ndarray:
    touched, index = result.tally.touched, result.tally.touched_index
    pairs: np.ndarray = np.vectorize(_format_pair, otypes=[object])(touched, index)
    return pairs


def _format_pair(kind: int, index: int) -> str:
    name = {
        Touched.NOTHING: "none",
        Touched.CELL: "cell",
        Touched.FLOOR: "floor",
        Touched.OBSTACLE: f"obstacle:{index}",
        Touched.ROBOT: f"robot:{index}",
    }
    return name[Touched(kind)]


def _plan_status(result: TileResult) -> np.ndarray:
    return planning_status(result.planned) if result.notes is None else result.notes.status


def _plan_reason(result: TileResult) -> ColumnValues:
    if result.notes is None:
        return None
    reasons = result.notes.reason.astype(object)
    reasons[reasons == ""] = None
    return reasons


def _failed_replans(state: WorldState) -> jax.Array | None:
    """Return failed replans [w, r] until each robot's end; others may have moved on after it."""
    carry = None if state.policy is None else state.policy.carry
    if not isinstance(carry, ReplanningMemory) or carry.plans is None:
        return None
    count: jax.Array = _failed_until(carry.plans, state.tally.outcome, state.tally.end_time_s)
    return count


@jax.jit
def _failed_until(plans: FleetPlans, outcome: jax.Array, end_time_s: jax.Array) -> jax.Array:
    return plans.failed(jnp.where(outcome == Outcome.RUNNING, jnp.inf, end_time_s))


_length_m = jax.jit(length_m)

_INT, _FLOAT, _BOOL, _TEXT = pa.int32(), pa.float32(), pa.bool_(), pa.string()

EPISODE_COLUMNS: tuple[EpisodeColumn, ...] = (
    EpisodeColumn(
        "world",
        pa.int64(),
        "1",
        "index of the world; with the seed it makes the world again",
        of_tile=lambda result: result.world,
    ),
    EpisodeColumn(
        "robot",
        _INT,
        "1",
        "index in the fleet",
        of_tile=lambda result: np.broadcast_to(
            np.arange(result.outcome.shape[1]), result.outcome.shape
        ),
    ),
    EpisodeColumn(
        "seed",
        pa.int64(),
        "1",
        "seed of the run",
        of_tile=lambda result: np.full(result.outcome.shape, result.seed, np.int64),
    ),
    EpisodeColumn("vehicle", _TEXT, "", "vehicle", of_tile=partial(_vehicle_labels, part=0)),
    EpisodeColumn(
        "parameter_set",
        _TEXT,
        "",
        "hydrodynamic parameter set",
        of_tile=partial(_vehicle_labels, part=1),
    ),
    EpisodeColumn(
        "planned",
        _BOOL,
        "1",
        "whether the planner found a path",
        of_tile=lambda result: result.planned,
    ),
    EpisodeColumn("outcome", _TEXT, "", "how the episode ended", of_tile=_outcome_names),
    EpisodeColumn(
        "time_to_goal_s",
        _FLOAT,
        "s",
        "arrival; null if not reached",
        may_be_null=True,
        of_tile=_arrival_s,
    ),
    EpisodeColumn(
        "path_length_m",
        _FLOAT,
        "m",
        "length of the path of the centre of mass until the end",
        of_tile=lambda result: result.tally.path_length_m,
    ),
    EpisodeColumn(
        "energy_j",
        _FLOAT,
        "J",
        "electrical energy of the thrusters until the end",
        of_tile=lambda result: result.tally.energy_j,
    ),
    EpisodeColumn(
        "min_clearance_m",
        _FLOAT,
        "m",
        "least hull distance to cells, floor, obstacles",
        of_tile=lambda result: result.tally.min_clearance_m,
    ),
    EpisodeColumn(
        "min_separation_m",
        _FLOAT,
        "m",
        "least hull distance to other robots, at most 1; null if alone",
        may_be_null=True,
        of_tile=lambda result: result.tally.min_separation_m,
    ),
    EpisodeColumn(
        "failure_time_s",
        _FLOAT,
        "s",
        "end of a failed episode; null if reached",
        may_be_null=True,
        of_tile=_failure_time_s,
    ),
    EpisodeColumn(
        "failure_x_m",
        _FLOAT,
        "m",
        "centre of mass at that time, east; null if reached",
        may_be_null=True,
        of_tile=partial(_failure_position, axis=0),
    ),
    EpisodeColumn(
        "failure_y_m",
        _FLOAT,
        "m",
        "north; null if reached",
        may_be_null=True,
        of_tile=partial(_failure_position, axis=1),
    ),
    EpisodeColumn(
        "failure_z_m",
        _FLOAT,
        "m",
        "up, 0 at the surface; null if reached",
        may_be_null=True,
        of_tile=partial(_failure_position, axis=2),
    ),
    EpisodeColumn(
        "failure_pair",
        _TEXT,
        "",
        "body touched (with contacts, in the hardest impact): cell, floor, obstacle:i, robot:i; "
        "or none",
        of_tile=_failure_pair,
    ),
    EpisodeColumn(
        "impact_speed_mps",
        _FLOAT,
        "m/s",
        "relative speed at the touch, with contacts at the hardest impact; null without one",
        may_be_null=True,
        of_tile=lambda result: result.tally.impact_speed_mps,
    ),
    EpisodeColumn(
        "redraws",
        _INT,
        "1",
        "samples discarded before this world",
        of_world=lambda worlds: worlds.environment.redraws,
    ),
    EpisodeColumn(
        "planning_s",
        _FLOAT,
        "s",
        "planner's time for the world; null on the device",
        since=1,
        of_tile=lambda result: None if result.notes is None else result.notes.planning_s,
    ),
    EpisodeColumn(
        "plan_status",
        _TEXT,
        "",
        "how planning ended, see docs/reference/planners.md",
        since=1,
        of_tile=_plan_status,
    ),
    EpisodeColumn(
        "plan_reason",
        _TEXT,
        "",
        "why the robot has no path; null if it has one, or unknown",
        since=1,
        of_tile=_plan_reason,
    ),
    EpisodeColumn(
        "plan_length_m",
        _FLOAT,
        "m",
        "length of the planned path, between its points; null without a path",
        since=1,
        of_world=lambda worlds: _length_m(worlds.path),
        of_tile=lambda result: result.where_planned("plan_length_m"),
    ),
    EpisodeColumn(
        "plan_end_s",
        _FLOAT,
        "s",
        "end of the path; null without a path",
        since=1,
        of_world=lambda worlds: worlds.path.time_s[..., -1],
        of_tile=lambda result: result.where_planned("plan_end_s"),
    ),
    EpisodeColumn(
        "late_s",
        _FLOAT,
        "s",
        "arrival after the end of the path; null if not reached",
        since=1,
        of_tile=lambda result: _arrival_s(result) - result.where_planned("plan_end_s"),
    ),
    EpisodeColumn(
        "failed_replans",
        _INT,
        "1",
        "failed attempts to plan anew until the end; null without replanning",
        since=2,
        of_state=_failed_replans,
    ),
    EpisodeColumn(
        "variant",
        _INT,
        "1",
        "number in variants.json, where vehicles are randomised",
        since=3,
        of_tile=lambda result: result.variant,
    ),
    EpisodeColumn(
        "current_factor",
        _FLOAT,
        "1",
        "sampled factor of the world's current; null where none is sampled",
        since=3,
        of_world=lambda worlds: None if worlds.factors is None else worlds.factors.current,
    ),
    EpisodeColumn(
        "sensor_noise_factor",
        _FLOAT,
        "1",
        "sampled factor of the robot's sensor noise; null where none is sampled",
        since=3,
        of_world=lambda worlds: None if worlds.factors is None else worlds.factors.sensor_noise,
    ),
    EpisodeColumn(
        "jobs_done",
        _INT,
        "1",
        "jobs of the task that the robot did; null without a task",
        since=4,
        of_tile=lambda result: None if result.task is None else result.task.did,
    ),
    EpisodeColumn(
        "task_progress",
        _FLOAT,
        "1",
        "fraction of the world's task that was done, of a survey that was seen; null without one",
        since=4,
        of_tile=lambda result: None if result.task is None else result.task.progress,
    ),
    EpisodeColumn(
        "task_completed_s",
        _FLOAT,
        "s",
        "completion of the world's task; null if it was not completed",
        since=4,
        of_tile=lambda result: None if result.task is None else result.task.completed_s,
    ),
    EpisodeColumn(
        "packets_sent",
        _INT,
        "1",
        "packets that the robot began to send; null without acoustics",
        since=4,
        of_state=lambda state: None if state.modem is None else state.modem.in_flight.sent,
    ),
    EpisodeColumn(
        "packets_heard",
        _INT,
        "1",
        "packets of others that it understood; null without acoustics",
        since=4,
        of_state=lambda state: None if state.modem is None else state.modem.n_received,
    ),
    EpisodeColumn(
        "passed_goal_early",
        _BOOL,
        "1",
        "whether it was at its goal before its plan's last approach; null in older runs",
        since=5,
        of_tile=lambda result: result.tally.passed_early,
    ),
    EpisodeColumn(
        "joint_commands_clipped",
        _INT,
        "1",
        "control steps in which a command to its joints was beyond their limits; null without arms",
        since=6,
        of_state=lambda state: state.carry.joints_clipped,
    ),
    EpisodeColumn(
        "impact_energy_j",
        _FLOAT,
        "J",
        "energy of the hardest impact; 0 without a touch, null without contacts",
        since=7,
        of_tile=lambda result: result.tally.impact_energy_j,
    ),
    EpisodeColumn(
        "contact_depth_m",
        _FLOAT,
        "m",
        "greatest overlap with another body or the ground; null without contacts",
        since=7,
        of_tile=lambda result: result.tally.contact_depth_m,
    ),
    EpisodeColumn(
        "grip_force_n",
        _FLOAT,
        "N",
        "greatest force of the robot's grip on the body that it carries with others; null where "
        "robots carry nothing together",
        since=7,
        of_tile=lambda result: result.tally.grip_force_n,
    ),
    EpisodeColumn(
        "internal_force_n",
        _FLOAT,
        "N",
        "greatest force of the grip less the mean of all grips, which moves nothing; null likewise",
        since=7,
        of_tile=lambda result: result.tally.internal_force_n,
    ),
    EpisodeColumn(
        "cargo_distance_m",
        _FLOAT,
        "m",
        "distance of the carried body from its goal at the end of the robot's episode; null "
        "likewise",
        since=7,
        of_tile=partial(_cargo_error, name="distance_m"),
    ),
    EpisodeColumn(
        "cargo_angle_rad",
        _FLOAT,
        "rad",
        "angle of the carried body from its attitude at the goal, then; null likewise",
        since=7,
        of_tile=partial(_cargo_error, name="angle_rad"),
    ),
    EpisodeColumn(
        "gripped_s",
        _FLOAT,
        "s",
        "time at which the robot's gripper closed on the body; null if it never did, and where "
        "robots hold their body from the start",
        since=8,
        of_state=lambda state: None if state.grips is None else state.grips.closed_s,
    ),
)
"""All columns, in the order of the table; new ones at the end."""

EPISODE_SCHEMA = pa.schema([column.arrow_field for column in EPISODE_COLUMNS])
"""Columns of ``episodes.parquet``, with unit and meaning in each field's metadata."""

COMMAND = "python -m angler_mjx.runs.storage.episode_columns docs/generated"


def format_page() -> str:
    """Return the reference page of the columns, in Markdown."""
    lines = [
        f"<!-- generated by {COMMAND} -->",
        "",
        "# Episode table",
        "",
        "`episodes.parquet` of a [run folder](../reference/runs.md) has one row per robot per "
        "world. Units and meanings are also in the metadata of its schema.",
        "",
        "| column | type | unit | meaning |",
        "|---|---|---|---|",
    ]
    for column in EPISODE_COLUMNS:
        cells = (f"`{column.name}`", str(column.type), column.unit, column.text)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the page into the folder given as argument."""
    (Path(sys.argv[1]) / "episodes.md").write_text(format_page(), encoding="utf-8")


if __name__ == "__main__":
    main()
