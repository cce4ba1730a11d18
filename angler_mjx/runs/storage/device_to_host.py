"""Results of a finished tile of worlds: selected on the device, copied to the host."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import jax
import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.errors import RunError
from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.storage.episode_columns import (
    TileResult,
    select_state_columns,
    select_world_columns,
)
from angler_mjx.runs.storage.trajectory_layout import END_GROUP, plan_arrays
from angler_mjx.sim.record import (
    FIELDS,
    JOINT_AXIS,
    STATE_FIELDS,
    TASK,
    JointRecord,
    RecordedField,
    Sample,
)
from angler_mjx.sim.state import Outcome, Tally, World, WorldState
from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.spec import TaskState, TaskWorld

type TileArrays = dict[str, Callable[[slice], np.ndarray]]
"""Recorded arrays of a tile by name: each gives its part of a slice of worlds, [n, ...]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TileConstants:
    """Constants of a tile's worlds that the host keeps; [tile] leads."""

    valid: jax.Array
    variant: jax.Array
    planned: jax.Array
    columns: dict[str, jax.Array]
    """Episode columns that are taken from worlds; see `EpisodeColumn.of_world`."""
    environment: Environment | None
    """None where nothing is recorded, as the plans."""
    plan: dict[str, jax.Array] | None
    """By the names of their arrays; see `runs.storage.trajectory_layout`."""
    task: TaskWorld | None = None
    """None where each robot has a goal of its own."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LastState:
    """The state after the last sample of a tile; [tile] leads.

    A sample is the state at the beginning of a step: without this one nobody could see where a
    robot is that ended in the last step.
    """

    step: jax.Array
    """int32 [tile] control steps taken until then."""
    p: jax.Array
    q: jax.Array
    nu: jax.Array
    outcome: jax.Array
    obstacle_p: jax.Array
    obstacle_q: jax.Array
    joints: JointRecord | None = None
    """None where no vehicle has joints."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TileEnd:
    """Parts of a tile's last state that the host keeps; [tile] leads."""

    tally: Tally
    p: jax.Array
    last: LastState | None = None
    """What follows on the samples; None where nothing is recorded."""
    columns: dict[str, jax.Array] = field(default_factory=dict)
    """Episode columns that are taken from the state; see `EpisodeColumn.of_state`."""
    task: TaskState | None = None
    """None where each robot has a goal of its own."""


@dataclass(frozen=True, kw_only=True)
class FinishedTile:
    """A finished tile on the host, waiting to be written."""

    first: int
    kept: int
    """Worlds of the run in it: fewer than the tile at the end of a run."""
    constants: TileConstants
    end: TileEnd
    parts: list[Sample]
    """Samples of its segments, until all robots had ended; empty where nothing is recorded."""
    notes: PlanNotes | None = None
    """How its worlds were planned, where that was not on the device."""


def select_constants(worlds: World, *, recorded: bool) -> TileConstants:
    """Return the parts of sampled worlds that the host keeps."""
    return TileConstants(
        valid=worlds.environment.valid,
        task=worlds.task,
        variant=worlds.variant,
        planned=worlds.planned,
        columns=select_world_columns(worlds),
        environment=worlds.environment if recorded else None,
        plan=plan_arrays(worlds.path) if recorded else None,
    )


def select_end(state: WorldState, *, recorded: bool) -> TileEnd:
    """Return the parts of the last state that the host keeps."""
    last = LastState(
        step=state.step,
        p=state.vehicles.p,
        q=state.vehicles.q,
        nu=state.vehicles.nu,
        outcome=state.tally.outcome,
        obstacle_p=state.obstacles.p,
        obstacle_q=state.obstacles.q,
        joints=_last_joints(state),
    )
    return TileEnd(
        tally=state.tally,
        p=state.vehicles.p,
        last=last if recorded else None,
        columns=select_state_columns(state),
        task=state.task,
    )


def _last_joints(state: WorldState) -> JointRecord | None:
    joints = state.vehicles.joints
    if joints is None:
        return None
    return JointRecord(position=joints.position, velocity=joints.velocity)


def last_state_from(following: Sample, step: int) -> LastState:
    """Return the state after the last sample of a tile, from the samples that follow it.

    Args:
        following: samples of the next segment; [tile, n] leads.
        step: control steps taken until its first one.
    """
    names = {field.path[0] for field in STATE_FIELDS}
    first = jax.tree.map(
        lambda leaf: np.asarray(leaf)[:, 0], {name: getattr(following, name) for name in names}
    )
    return LastState(step=np.full(len(first["p"]), step, np.int32), **first)  # type: ignore[arg-type]


def require_valid(constants: TileConstants, first: int, n_worlds: int) -> None:
    """Refuse a run in which a world could not be furnished for the fleet."""
    valid = np.asarray(constants.valid)[:n_worlds]
    if not valid.all():
        bad = first + int(np.flatnonzero(~valid)[0])
        raise RunError(
            f"world {bad} cannot hold the fleet: no drawing within the redraw limit had room for "
            "its starts and goals; use fewer robots (fleet.count), a larger world.shape, a lower "
            "world.density or a smaller world.clearance_m"
        )
    if constants.task is None:
        return
    task_fits = np.asarray(constants.task.fits)[:n_worlds]
    if not task_fits.all():
        bad = first + int(np.flatnonzero(~task_fits)[0])
        raise RunError(
            f"world {bad} has no room for its task: robots reach too few of the cells that its "
            "places are drawn in, or task.viewpoints are too few to see task.coverage of what is "
            "to be surveyed; take fewer places or goods, more viewpoints, or a larger part of the "
            "world"
        )


def build_tile_result(tile: FinishedTile) -> TileResult:
    """Return a tile's end as host arrays; robots that still ran at the horizon have a time-out."""
    constants, end, notes = tile.constants, tile.end, tile.notes
    kept, tally, task = jax.tree.map(
        lambda leaf: np.asarray(leaf)[: tile.kept],
        (constants.columns | end.columns, end.tally, end.task),
    )
    return TileResult(
        world=np.arange(tile.first, tile.first + tile.kept),
        variant=np.asarray(constants.variant)[: tile.kept],
        planned=np.asarray(constants.planned)[: tile.kept],
        outcome=np.where(tally.outcome == Outcome.RUNNING, Outcome.TIMEOUT, tally.outcome),
        tally=tally,
        p=np.asarray(end.p)[: tile.kept],
        notes=None if notes is None else notes.rows(slice(tile.kept)),
        task=task,
        kept=kept,
    )


def task_sizes(task: TaskWorld | None) -> dict[str, int]:
    """Return the sizes of a task's dimensions by their names in `trajectory_layout`."""
    if task is None:
        return {}
    cells = () if task.survey is None else task.survey.cells.shape[-3:]
    return {
        "place": task.position_m.shape[-2],
        "job": task.exists.shape[-1],
        **dict(zip("xyz", cells, strict=False)),
    }


def _task_arrays(tile: FinishedTile) -> TileArrays:
    """Return the arrays of a task and of its progress at the end."""
    world, state = tile.constants.task, tile.end.task
    if world is None or state is None:
        return {}
    task_arrays: dict[str, jax.Array | np.ndarray] = {
        "place_m": world.position_m,
        "exists": np.asarray(world.exists).astype(np.uint8),
        "by": np.asarray(state.by).astype(np.int16),
        "done_at_s": state.done_at_s,
    }
    if world.survey is not None:
        cells = np.asarray(world.survey.cells)
        packed = np.asarray(state.seen).astype("<u4").view(np.uint8)
        seen = np.unpackbits(packed, axis=-1, count=cells.shape[-1], bitorder="little")
        task_arrays["cells"] = cells.astype(np.uint8) + (seen & cells)
        if state.seen_at_s is not None:
            task_arrays["seen_at_s"] = np.where(cells, state.seen_at_s, np.nan)
    return {f"{TASK}/{name}": partial(_select_rows, values) for name, values in task_arrays.items()}


def recorded_arrays(tile: FinishedTile, samples: int) -> TileArrays:
    """Return the recorded arrays of a tile.

    Args:
        tile: with its parts.
        samples: in the whole horizon.
    """
    result: TileArrays = {}
    for entry in FIELDS:
        rows = [values for part in tile.parts if (values := entry.of(part)) is not None]
        if rows:
            result[entry.about.array] = partial(
                _convert_stored, entry, partial(_join_parts, rows, samples)
            )
    if tile.end.last is not None:
        result[f"{END_GROUP}/step"] = partial(_select_rows, tile.end.last.step)
        for field in STATE_FIELDS:
            values = field.of(tile.end.last)
            if JOINT_AXIS in field.about.axes and values is not None:
                values = _without_absent(values, field.of(tile.parts[0]))
            if values is not None:
                result[f"{END_GROUP}/{field.about.array}"] = partial(_select_rows, values)
    for name, values in (tile.constants.plan or {}).items():
        result[name] = partial(_select_rows, values)
    return result | _task_arrays(tile)


def _without_absent(last: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """Return the joints [n, R, J] of the last state, NaN where samples [n, T, R, J] have none.

    The state itself keeps joints at 0 for robots without any.
    """
    return np.where(np.isnan(samples[:, 0]), np.nan, last).astype(last.dtype)


def _join_parts(parts: list[np.ndarray], samples: int, worlds: slice) -> np.ndarray:
    """Return [n, samples, ...]; after the tile's end NaN, or the last value of whole numbers."""
    count = len(parts[0][worlds])
    joined = np.empty((count, samples, *parts[0].shape[2:]), parts[0].dtype)
    offset = 0
    for part in parts:
        joined[:, offset : offset + part.shape[1]] = part[worlds]
        offset += part.shape[1]
    joined[:, offset:] = np.nan if joined.dtype.kind == "f" else joined[:, offset - 1 : offset]
    return joined


def _select_rows(values: ArrayLike, worlds: slice) -> np.ndarray:
    return np.asarray(values)[worlds]


def _convert_stored(
    field: RecordedField, make: Callable[[slice], np.ndarray], worlds: slice
) -> np.ndarray:
    """Return values as stored, except the type of floats, which is converted block by block."""
    values = make(worlds)
    if field.about.none is not None:
        # fmax takes the number where the other is NaN; nan_to_num takes six times as long.
        np.fmax(values, field.about.none, out=values)
    return values if field.stored.kind == "f" else values.astype(field.stored)
