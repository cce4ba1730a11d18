"""One flight of one world: positions of its robots, thruster signals, and outcomes.

The form is the same for a recorded run, for the batch simulator, and for real autopilots. In a file
it is an ``.npz``; rows of the robots are those of ``episodes.parquet``.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import jax
import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

from angler_mjx.runs.storage import device_to_host, results
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.folder import TRAJECTORIES, Run
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.runs.stored_arrays import stored_array
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import World, WorldState

type Floats = NDArray[np.floating]

RECORDED = "recorded"
"""Name of the recorded flight of the run itself."""


class FlightRow(TypedDict):
    """Row of a robot in ``episodes.parquet``; the columns that reports use."""

    vehicle: str
    parameter_set: str
    planned: bool
    outcome: str
    failure_pair: str
    min_clearance_m: float


@dataclass(frozen=True, kw_only=True)
class SpotcheckFlight:
    """One flight of one world; [T] samples and [R] robots lead."""

    time_s: Floats
    """[T] from the start, at the rate of the run's records."""
    p_m: Floats
    """[T, R, 3] centres of mass in W."""
    pwm_us: NDArray[np.int64]
    """[T, R, n_thruster]; 1500 in padding columns."""
    rows: tuple[FlightRow, ...]
    """Row of each robot, as in ``episodes.parquet``."""

    @property
    def end_s(self) -> Floats:
        """[R] end time of each robot's episode."""
        return np.array([results.end_time_s(row) for row in self.rows])

    def position_at(self, robot: int, time_s: float) -> Floats:
        """Return the position [3] of a robot, interpolated linearly between two samples."""
        path = self.p_m[:, robot]
        return np.array([np.interp(time_s, self.time_s, path[:, axis]) for axis in range(3)])


def load_recorded(run: Run, world: int, robots: int) -> SpotcheckFlight:
    """Load the recorded flight of the first robots of a run.

    Raises:
        ConfigError: the run stored no trajectories, or is damaged.
    """
    rows = run.episodes.filter(pc.field("world") == world).to_pylist()[:robots]
    stored = run.trajectories
    with wrap_read_errors(run.path / TRAJECTORIES):
        p = np.asarray(stored_array(stored, "p_m")[world], float)[:, :robots]
        pwm_us = np.asarray(stored_array(stored, "pwm_us")[world, :, :robots])
        is_recorded = np.isfinite(p).all(axis=(1, 2))
        return SpotcheckFlight(
            time_s=np.asarray(stored_array(stored, "time_s")[:], float)[is_recorded],
            p_m=p[is_recorded],
            pwm_us=np.rint(pwm_us[is_recorded]).astype(np.int64),
            rows=tuple(rows),
        )


def build_flight(
    worlds: World,
    state: WorldState,
    samples: Sequence[Sample],
    *,
    world: int,
    variants: Sequence[tuple[str, str]],
    seed: int,
    sample_dt_s: float,
) -> SpotcheckFlight:
    """Build a flight from a simulation's own pytrees.

    Args:
        worlds: [1] leads.
        state: at the end; [1] leads.
        samples: in order of time; [1] leads, or [1, n] of n samples.
        world: global index.
        variants: vehicle and parameter set of each variant.
        seed: of the run.
        sample_dt_s: time between samples.
    """
    tile = FinishedTile(
        first=world,
        kept=1,
        constants=jax.tree.map(np.asarray, device_to_host.select_constants(worlds, recorded=False)),
        end=jax.tree.map(np.asarray, device_to_host.select_end(state, recorded=False)),
        parts=[],
    )
    rows = results.episode_table(device_to_host.build_tile_result(tile), variants, seed).to_pylist()
    robots = len(rows)
    p = np.concatenate([np.asarray(sample.p).reshape(-1, robots, 3) for sample in samples])
    pwm = [np.asarray(sample.pwm_us) for sample in samples]
    joined = np.concatenate([sample.reshape(-1, robots, sample.shape[-1]) for sample in pwm])
    return SpotcheckFlight(
        time_s=np.arange(len(p), dtype=float) * sample_dt_s,
        p_m=p.astype(float),
        pwm_us=np.rint(np.nan_to_num(joined)).astype(np.int64),
        rows=tuple(rows),
    )


def save_flight(path: Path, flight: SpotcheckFlight) -> None:
    """Write a flight atomically.

    Raises:
        ConfigError: its folder cannot be written.
        RunError: writing to the disk failed.
    """
    with replace_file(path, flag="--out", force=True) as writing, writing.open("wb") as file:
        np.savez_compressed(
            file,
            time_s=flight.time_s,
            p_m=flight.p_m,
            pwm_us=flight.pwm_us,
            rows=np.array(json.dumps(flight.rows)),
        )


def load_flight(path: Path) -> SpotcheckFlight:
    """Read a flight.

    Raises:
        ConfigError: it is damaged.
    """
    with (
        wrap_read_errors(path, "remove it and go on with --resume"),
        np.load(path, allow_pickle=False) as archive,
    ):
        return SpotcheckFlight(
            time_s=archive["time_s"],
            p_m=archive["p_m"],
            pwm_us=archive["pwm_us"],
            rows=tuple(json.loads(str(archive["rows"]))),
        )
