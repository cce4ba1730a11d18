"""Flying a batch of worlds, and what became of each."""

import math
from functools import partial

import numpy as np

from angler_mjx.runs import waves
from angler_mjx.runs.progress import Silent
from angler_mjx.sim.state import Outcome
from angler_mjx.storage import harvest
from angler_mjx.storage.harvest import FinishedTile
from angler_mjx.studies.fleet_size.asking import Condition, Study
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import Batch

DIGITS = 4
"""Of a time in seconds: those of a sum of control steps in single precision."""


def fly(study: Study, simulators: Simulators, condition: Condition, size: int, first: int) -> Batch:
    """Fly the worlds of one batch.

    Args:
        study: that asks.
        simulators: of it.
        condition: in which they are flown.
        size: of the team.
        first: index of the first world.

    Raises:
        RunError: device memory is used up.
    """
    simulator = simulators.of(condition, size)
    count = study.config.budget.batch
    parts = []
    for wave in waves.simulate(
        simulator,
        range(first, first + count, simulator.tile),
        recorded=False,
        progress=Silent(),
        seed=study.config.seed,
        strict=False,
        changed=partial(simulators.change, condition, size, simulator),
    ):
        parts += [_of_tile(study, tile) for tile in wave]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    completed = whole["completed_s"]
    return Batch(
        condition=condition.name,
        size=size,
        first=first,
        completed_s=[round(float(t), DIGITS) if math.isfinite(t) else None for t in completed],
        arrived=whole["arrived"].tolist(),
        lost=whole["lost"].tolist(),
        energy_j=whole["energy_j"].tolist(),
        path_m=whole["path_m"].tolist(),
        no_room=whole["no_room"].tolist(),
    )


def _of_tile(study: Study, tile: FinishedTile) -> dict[str, np.ndarray]:
    """Of each world of a tile, [w]."""
    result = harvest.tile_result(tile)
    fits = np.asarray(tile.constants.valid)
    if tile.constants.task is not None:
        fits = fits & np.asarray(tile.constants.task.fits)
    no_room = ~fits[: tile.kept]
    reached = result.outcome == Outcome.REACHED
    if result.task is None:
        completed = arrival(reached, result.end_time_s, study.config.needed(reached.shape[1]))
    else:
        completed = np.nan_to_num(result.task.completed_s.astype(float), nan=np.inf)
    return {
        "completed_s": np.where(no_room, np.inf, completed),
        "arrived": np.sum(reached, axis=1),
        "lost": np.sum(~reached & (result.outcome != Outcome.TIMEOUT), axis=1),
        "energy_j": np.sum(result.energy_j, axis=1, dtype=float).round(3),
        "path_m": np.sum(result.path_length_m, axis=1, dtype=float).round(3),
        "no_room": no_room,
    }


def arrival(reached: np.ndarray, end_time_s: np.ndarray, needed: int) -> np.ndarray:
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
    found: np.ndarray = times[:, needed - 1]
    return found
