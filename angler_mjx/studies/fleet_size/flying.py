"""Flying a batch of worlds, and what became of each."""

import math
from collections.abc import Sequence
from functools import partial
from typing import TypedDict

import numpy as np

from angler_mjx.progress import Progress
from angler_mjx.runs import device_batches
from angler_mjx.runs.storage import device_to_host
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.planning_summary import PlanningFailures
from angler_mjx.sim.state import Outcome
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import Batch

TIME_DIGITS = 4
"""Of a time in seconds: those of a sum of control steps in single precision."""


class TileValues(TypedDict):
    """Values of the worlds of a tile; see `Batch`."""

    completed_s: list[float | None]
    arrived: list[int]
    lost: list[int]
    energy_j: list[float]
    path_length_m: list[float]
    no_room: list[bool]
    planned: list[int | None]


class BatchPart(TypedDict):
    """Tiles of a batch, in plain values."""

    first: list[int]
    """First world of each tile."""
    tiles: list[TileValues]


"""Some tiles of a batch: ``first`` of each, and by name the values of the worlds of each, plain."""


def fly_batch(
    study: FleetSizeStudy,
    simulators: Simulators,
    condition: Condition,
    size: int,
    first: int,
    *,
    partition: tuple[int, int] = (0, 1),
    failures: PlanningFailures | None = None,
) -> BatchPart:
    """Fly the worlds of one batch, or a share of its tiles.

    Args:
        study: that asks.
        simulators: of it.
        condition: in which they are flown.
        size: of the team.
        first: index of the first world.
        partition: which share of the tiles, of how many.
        failures: says what planners fail at.

    Raises:
        RunError: device memory is used up.
    """
    simulator = simulators.of(condition, size)
    at, count = partition
    tiles = range(first, first + study.config.budget.batch, simulator.tile)[at::count]
    parts: list[TileValues] = []
    for device_batch in device_batches.simulate_tiles(
        simulator,
        tiles,
        recorded=False,
        progress=Progress(),
        seed=study.config.seed,
        strict=False,
        modify_worlds=partial(simulators.change, condition, size, simulator),
    ):
        parts += [_summarise_tile(study, tile, failures) for tile in device_batch]
    return {"first": list(tiles), "tiles": parts}


def merge_parts(condition: Condition, size: int, first: int, parts: Sequence[BatchPart]) -> Batch:
    """A batch from all its tiles, in the order of its worlds.

    Args:
        condition: in which it was flown.
        size: of the team.
        first: index of the first world.
        parts: whose tiles are all of the batch.
    """
    tiles = [
        tile
        for _, tile in sorted(
            (pair for part in parts for pair in zip(part["first"], part["tiles"], strict=True)),
            key=lambda pair: pair[0],
        )
    ]
    return Batch(
        condition=condition.name,
        size=size,
        first=first,
        completed_s=[x for tile in tiles for x in tile["completed_s"]],
        arrived=[x for tile in tiles for x in tile["arrived"]],
        lost=[x for tile in tiles for x in tile["lost"]],
        energy_j=[x for tile in tiles for x in tile["energy_j"]],
        path_length_m=[x for tile in tiles for x in tile["path_length_m"]],
        no_room=[x for tile in tiles for x in tile["no_room"]],
        planned=[x for tile in tiles for x in tile["planned"]],
    )


def _summarise_tile(
    study: FleetSizeStudy, tile: FinishedTile, failures: PlanningFailures | None
) -> TileValues:
    """Of each world of a tile."""
    result = device_to_host.build_tile_result(tile)
    if failures is not None:
        failures.add(result.world, result.notes)
    planned = np.sum(result.planned, axis=1).tolist()
    fits = np.asarray(tile.constants.valid)
    if tile.constants.task is not None:
        fits = fits & np.asarray(tile.constants.task.fits)
    no_room = ~fits[: tile.kept]
    reached = result.outcome == Outcome.REACHED
    if result.task is None:
        completed = compute_completion_s(
            reached,
            np.asarray(result.tally.end_time_s),
            study.config.required_arrivals(reached.shape[1]),
        )
    else:
        completed = np.nan_to_num(result.task.completed_s.astype(float), nan=np.inf)
    completed = np.where(no_room, np.inf, completed)
    return {
        "completed_s": [
            round(float(t), TIME_DIGITS) if math.isfinite(t) else None for t in completed
        ],
        "arrived": np.sum(reached, axis=1).tolist(),
        "lost": np.sum(~reached & (result.outcome != Outcome.TIMEOUT), axis=1).tolist(),
        "energy_j": np.sum(result.tally.energy_j, axis=1, dtype=float).round(3).tolist(),
        "path_length_m": np.sum(result.tally.path_length_m, axis=1, dtype=float).round(3).tolist(),
        "no_room": no_room.tolist(),
        "planned": planned if result.task is None else [None] * len(planned),
    }


def compute_completion_s(reached: np.ndarray, end_time_s: np.ndarray, needed: int) -> np.ndarray:
    """When as many robots as are needed had arrived.

    Args:
        reached: bool [w, r].
        end_time_s: [w, r].
        needed: robots, 1 or more.

    Returns:
        [w] inf where they never had.
    """
    times = np.sort(np.where(reached, end_time_s.astype(float), np.inf), axis=1)
    if needed > times.shape[1]:
        return np.full(len(times), np.inf)
    completion_s: np.ndarray = times[:, needed - 1]
    return completion_s
