"""From the device to the host: what a finished tile of worlds leaves behind."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import RunError
from angler_mjx.planning.online.policy import ReplanningMemory
from angler_mjx.planning.online.replanning import FleetPlans
from angler_mjx.robot.control.plans import length_m
from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.storage.results import TaskResult, TileResult
from angler_mjx.runs.storage.trajectory_layout import END_GROUP, plan_arrays
from angler_mjx.sim.record import FIELDS, STATE_FIELDS, TASK, RecordedField, Sample
from angler_mjx.sim.state import Outcome, Tally, World, WorldFactors, WorldState
from angler_mjx.world.environment import Environment
from angler_mjx.world.tasks.spec import TaskState, TaskWorld

type TileArrays = dict[str, Callable[[slice], np.ndarray]]
"""Recorded arrays of a tile by name: each gives its part of a slice of worlds, [n, ...]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TileConstants:
    """What the host keeps of the worlds of a tile; [tile] leads."""

    valid: jax.Array
    redraws: jax.Array
    variant: jax.Array
    planned: jax.Array
    plan_length_m: jax.Array
    """[tile, r] of the lines between a path's points."""
    plan_end_s: jax.Array
    """[tile, r] when a path is over."""
    environment: Environment | None
    """None where nothing is recorded, as the plans."""
    plan: dict[str, jax.Array] | None
    """By the names of their arrays; see `runs.storage.trajectory_layout`."""
    factors: WorldFactors | None = None
    """None where none were drawn."""
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


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TileEnd:
    """What the host keeps of the last state of a tile; [tile] leads."""

    tally: Tally
    p: jax.Array
    last: LastState | None = None
    """What follows on the samples; None where nothing is recorded."""
    failed_replans: jax.Array | None = None
    """int32 [tile, r] until each robot's end; None where nothing was planned anew."""
    task: TaskState | None = None
    """None where each robot has a goal of its own."""
    packets: jax.Array | None = None
    """int32 [tile, r, 2] that each sent, and heard; None without acoustics."""


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


_length_m = jax.jit(length_m)


def select_constants(worlds: World, *, recorded: bool) -> TileConstants:
    """What to keep of worlds."""
    return TileConstants(
        valid=worlds.environment.valid,
        task=worlds.task,
        redraws=worlds.environment.redraws,
        variant=worlds.variant,
        planned=worlds.planned,
        plan_length_m=_length_m(worlds.path),
        plan_end_s=worlds.path.time_s[..., -1],
        factors=worlds.factors,
        environment=worlds.environment if recorded else None,
        plan=plan_arrays(worlds.path) if recorded else None,
    )


def select_end(state: WorldState, *, recorded: bool) -> TileEnd:
    """What to keep of the last state."""
    last = LastState(
        step=state.step,
        p=state.vehicles.p,
        q=state.vehicles.q,
        nu=state.vehicles.nu,
        outcome=state.tally.outcome,
        obstacle_p=state.obstacles.p,
        obstacle_q=state.obstacles.q,
    )
    return TileEnd(
        tally=state.tally,
        p=state.vehicles.p,
        last=last if recorded else None,
        failed_replans=_failed_replans(state),
        task=state.task,
        packets=_packet_counts(state),
    )


def _packet_counts(state: WorldState) -> jax.Array | None:
    modem = state.modem
    return None if modem is None else jnp.stack([modem.in_flight.sent, modem.n_received], axis=-1)


def _failed_replans(state: WorldState) -> jax.Array | None:
    """What a robot's planner did after its end is not counted: others may have flown on."""
    carry = None if state.policy is None else state.policy.carry
    if not isinstance(carry, ReplanningMemory) or carry.plans is None:
        return None
    count: jax.Array = _failed_until(carry.plans, state.tally.outcome, state.tally.end_time_s)
    return count


@jax.jit
def _failed_until(plans: FleetPlans, outcome: jax.Array, end_time_s: jax.Array) -> jax.Array:
    return plans.failed(jnp.where(outcome == Outcome.RUNNING, jnp.inf, end_time_s))


def last_state_from(following: Sample, step: int) -> LastState:
    """The state after the last sample of a tile, from the samples that follow on it.

    Args:
        following: samples of the next segment; [tile, n] leads.
        step: control steps taken until its first one.
    """
    first: dict[str, Any] = {
        field.path[-1]: np.asarray(field.of(following))[:, 0] for field in STATE_FIELDS
    }
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
    """A tile's end as host arrays, the horizon's end turned into time-outs."""
    n_worlds, factors = tile.kept, tile.constants.factors
    tally = jax.tree.map(lambda leaf: np.asarray(leaf)[:n_worlds], tile.end.tally)
    outcome = np.where(tally.outcome == Outcome.RUNNING, Outcome.TIMEOUT, tally.outcome)
    return TileResult(
        world=np.arange(tile.first, tile.first + n_worlds),
        variant=np.asarray(tile.constants.variant)[:n_worlds],
        planned=np.asarray(tile.constants.planned)[:n_worlds],
        outcome=outcome,
        end_time_s=tally.end_time_s,
        passed_early=tally.passed_early,
        path_length_m=tally.path_length_m,
        energy_j=tally.energy_j,
        min_clearance_m=tally.min_clearance_m,
        min_separation_m=tally.min_separation_m,
        touched=tally.touched,
        touched_index=tally.touched_index,
        impact_speed_mps=tally.impact_speed_mps,
        p=np.asarray(tile.end.p)[:n_worlds],
        plan_length_m=np.asarray(tile.constants.plan_length_m)[:n_worlds],
        plan_end_s=np.asarray(tile.constants.plan_end_s)[:n_worlds],
        notes=None if tile.notes is None else tile.notes.rows(slice(n_worlds)),
        redraws=np.asarray(tile.constants.redraws)[:n_worlds],
        task=_task_result(tile),
        packets=None if tile.end.packets is None else np.asarray(tile.end.packets)[:n_worlds],
        failed_replans=None
        if tile.end.failed_replans is None
        else np.asarray(tile.end.failed_replans)[:n_worlds],
        current_factor=None if factors is None else np.asarray(factors.current)[:n_worlds],
        sensor_noise_factor=None
        if factors is None
        else np.asarray(factors.sensor_noise)[:n_worlds],
    )


def task_sizes(task: TaskWorld | None) -> dict[str, int]:
    """Sizes of the dimensions of a task by their names in `layout`, worlds leading or not."""
    if task is None:
        return {}
    cells = () if task.survey is None else task.survey.cells.shape[-3:]
    return {
        "place": task.position_m.shape[-2],
        "job": task.exists.shape[-1],
        **dict(zip("xyz", cells, strict=False)),
    }


def _task_result(tile: FinishedTile) -> TaskResult | None:
    world, state = tile.constants.task, tile.end.task
    if world is None or state is None:
        return None
    return TaskResult(
        jobs_done=np.asarray(state.did)[: tile.kept],
        progress=np.asarray(state.progress)[: tile.kept],
        completed_s=np.asarray(state.completed_s)[: tile.kept],
    )


def _task_arrays(tile: FinishedTile) -> TileArrays:
    """What a task was, and how far it was at the end."""
    world, state = tile.constants.task, tile.end.task
    if world is None or state is None:
        return {}
    task_arrays = {
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
    """Recorded arrays of a tile.

    Args:
        tile: with its parts.
        samples: in the whole horizon.
    """
    result: TileArrays = {}
    for field in FIELDS:
        rows = [values for part in tile.parts if (values := field.of(part)) is not None]
        if rows:
            result[field.about.array] = partial(
                _convert_stored, field, partial(_join_parts, rows, samples)
            )
    if tile.end.last is not None:
        result[f"{END_GROUP}/step"] = partial(_select_rows, tile.end.last.step)
        for field in STATE_FIELDS:
            result[f"{END_GROUP}/{field.about.array}"] = partial(
                _select_rows, field.of(tile.end.last)
            )
    for name, values in (tile.constants.plan or {}).items():
        result[name] = partial(_select_rows, values)
    return result | _task_arrays(tile)


def _join_parts(parts: list[np.ndarray], samples: int, worlds: slice) -> np.ndarray:
    """[n, samples, ...]: NaN, or for whole numbers the last value, where the tile had ended."""
    count = len(parts[0][worlds])
    joined = np.empty((count, samples, *parts[0].shape[2:]), parts[0].dtype)
    offset = 0
    for part in parts:
        joined[:, offset : offset + part.shape[1]] = part[worlds]
        offset += part.shape[1]
    joined[:, offset:] = np.nan if joined.dtype.kind == "f" else joined[:, offset - 1 : offset]
    return joined


def _select_rows(values: Any, worlds: slice) -> np.ndarray:
    return np.asarray(values)[worlds]


def _convert_stored(
    field: RecordedField, make: Callable[[slice], np.ndarray], worlds: slice
) -> np.ndarray:
    """As it is stored, but for the type of floats: these are converted block by block."""
    values = make(worlds)
    if field.about.none is not None:
        # fmax takes the number where the other is NaN; nan_to_num takes six times as long.
        np.fmax(values, field.about.none, out=values)
    return values if field.stored.kind == "f" else values.astype(field.stored)
