"""From the device to the host: what a finished tile of worlds leaves behind."""

import jax
import numpy as np

from angler_mjx.errors import RunError
from angler_mjx.runs.results import TileResult
from angler_mjx.sim.state import Outcome, Sample, World, WorldState


def require_valid(worlds: World, first: int, kept: int) -> None:
    """Refuse a run in which a world could not be furnished for the fleet."""
    valid = np.asarray(worlds.environment.valid)[:kept]
    if not valid.all():
        bad = first + int(np.flatnonzero(~valid)[0])
        raise RunError(
            f"world {bad} cannot hold the fleet: no drawing within the redraw limit had room for "
            "its starts and goals; use fewer robots, a larger shape or a lower density"
        )


def tile_result(worlds: World, state: WorldState, first: int, kept: int) -> TileResult:
    """Device state of a tile as host arrays, the horizon's end turned into time-outs."""
    tally = jax.tree.map(lambda leaf: np.asarray(leaf)[:kept], state.tally)
    outcome = np.where(tally.outcome == Outcome.RUNNING, Outcome.TIMEOUT, tally.outcome)
    return TileResult(
        world=np.arange(first, first + kept),
        variant=np.asarray(worlds.variant)[:kept],
        planned=np.asarray(worlds.path.found)[:kept],
        outcome=outcome,
        end_time_s=tally.end_time_s,
        path_length_m=tally.path_length_m,
        energy_j=tally.energy_j,
        min_clearance_m=tally.min_clearance_m,
        min_separation_m=tally.min_separation_m,
        touched=tally.touched,
        touched_index=tally.touched_index,
        impact_speed_mps=tally.impact_speed_mps,
        p=np.asarray(state.vehicles.p)[:kept],
        redraws=np.asarray(worlds.environment.redraws)[:kept],
    )


def arrays_of(worlds: World, parts: list[Sample], samples: int, kept: int) -> dict[str, np.ndarray]:
    """Recorded arrays of a tile by name, [kept, samples, ...], NaN where the tile had ended."""
    names = {
        "p_m": "p",
        "q": "q",
        "nu": "nu",
        "pwm_us": "pwm_us",
        "target_m": "target_m",
        "current_mps": "current_mps",
        "outcome": "outcome",
        "obstacle_p_m": "obstacle_p",
        "obstacle_q": "obstacle_q",
    }
    arrays = {}
    for name, attribute in names.items():
        joined = np.concatenate([getattr(part, attribute)[:kept] for part in parts], axis=1)
        missing = samples - joined.shape[1]
        if joined.dtype.kind == "f":
            tail = np.full((kept, missing, *joined.shape[2:]), np.nan, joined.dtype)
        else:
            tail = np.repeat(joined[:, -1:], missing, axis=1)
        arrays[name] = np.concatenate([joined, tail], axis=1)
    arrays["pwm_us"] = np.nan_to_num(np.rint(arrays["pwm_us"]), nan=0.0).astype(np.uint16)
    arrays["outcome"] = arrays["outcome"].astype(np.uint8)
    arrays["plan_time_s"] = np.asarray(worlds.path.time_s)[:kept]
    arrays["plan_m"] = np.asarray(worlds.path.position_m)[:kept]
    return arrays
