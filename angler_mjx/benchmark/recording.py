"""How fast a run is recorded, beside what the disk can do.

Both are timed to the end of ``fsync``, in the same folder and in turns, because a disk shared with
others changes from second to second. The samples are real ones: a tile of a scenario is simulated
to its horizon once, and written again and again as new tiles.
"""

import os
import shutil
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs import harvest, sizes, waves
from angler_mjx.runs.harvest import FinishedTile
from angler_mjx.runs.progress import Silent
from angler_mjx.runs.recorder import Recorder
from angler_mjx.runs.simulator import Simulator

BLOCK_BYTES = 16 * 2**20
"""Of one plain write: large enough that the call does not matter."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What was measured; rates are medians over the repeats."""

    disk_mbps: float
    """Plain large writes and fsync, MB/s."""
    recorder_mbps: float
    """The recorder's, counted in bytes that reached the disk, MB/s."""
    samples_mbps: float
    """The same, counted in bytes of samples before compression, MB/s."""
    spread: float
    """Greatest less least over median of the disk's own rate."""
    bytes_per_robot_sample: float
    """On disk, with its share of the obstacles' samples."""
    repeats: int

    @property
    def ratio(self) -> float:
        """Recorder over disk, in bytes on disk."""
        return self.recorder_mbps / self.disk_mbps

    def break_even_hz(self, vehicle_steps_per_s: float, physics_dt_s: float) -> float:
        """Record rate above which the device would wait for the disk, Hz of simulated time.

        Robots together live ``vehicle_steps_per_s * physics_dt_s`` seconds in a second; each writes
        its bytes at the record rate.

        Args:
            vehicle_steps_per_s: of the device, physics steps of all robots.
            physics_dt_s: simulated time of one.
        """
        seconds = vehicle_steps_per_s * physics_dt_s
        return self.recorder_mbps * 1e6 / (seconds * self.bytes_per_robot_sample)


def measure(simulator: Simulator, folder: Path, *, repeats: int = 5) -> Recording:
    """Measure disk and recorder in a folder.

    Args:
        simulator: of a scenario with ``record_hz`` above 0; it is compiled if it was not.
        folder: on the disk in question; what is written there is taken away again.
        repeats: turns, after one that does not count.

    Raises:
        ConfigError: nothing is recorded, or the folder cannot be written.
        RunError: a world cannot hold the fleet.
    """
    scenario = simulator.scenario
    if scenario.time.record_hz == 0:
        raise ConfigError("record_hz = 0: there is nothing to record; give a scenario that does")
    simulator.compile()
    tile = next(waves.simulate(simulator, [0], recorded=True, progress=Silent()))[0]
    place = folder / f".recording-{os.getpid()}"
    try:
        place.mkdir(parents=True)
        return _in_turns(simulator, tile, place, repeats)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _in_turns(simulator: Simulator, tile: FinishedTile, place: Path, repeats: int) -> Recording:
    shape = sizes.shape_of(simulator)
    environment = tile.constants.environment
    if environment is None:
        raise RunError("the tile was simulated without its environment")

    def recorder(turn: int) -> tuple[Path, Recorder]:
        path = place / f"turn_{turn}.zarr"
        return path, Recorder.create(
            path,
            shape,
            simulator.world_shape().environment,
            tile=simulator.tile,
            sample_dt_s=1.0 / simulator.scenario.time.record_hz,
        )

    def record(made: tuple[Path, Recorder]) -> Path:
        path, into = made
        into.write(0, harvest.arrays(tile, shape.samples), environment)
        return path

    on_disk = _bytes_in(record(recorder(-1)))
    _remove_all(place)
    plain, recorded = [], []
    for turn in range(repeats):
        plain.append(on_disk / _timed(lambda: _plain(place, on_disk)) / 1e6)
        _remove_all(place)
        made = recorder(turn)
        recorded.append(on_disk / _timed(partial(record, made)) / 1e6)
        _remove_all(place)
    samples = tile.kept * shape.bytes_per_world()
    rate = float(np.median(recorded))
    return Recording(
        disk_mbps=float(np.median(plain)),
        recorder_mbps=rate,
        samples_mbps=rate * samples / on_disk,
        spread=(max(plain) - min(plain)) / float(np.median(plain)),
        bytes_per_robot_sample=on_disk / (tile.kept * shape.samples * shape.robots),
        repeats=repeats,
    )


def _plain(place: Path, size: int) -> Path:
    """Write a file of a size in large blocks of bytes that no disk can make smaller."""
    path = place / "plain"
    block = memoryview(np.random.default_rng(0).bytes(BLOCK_BYTES))
    with path.open("wb", buffering=0) as file:
        for begin in range(0, size, BLOCK_BYTES):
            file.write(block[: min(BLOCK_BYTES, size - begin)])
    return path


def _timed(write: Callable[[], Path]) -> float:
    """Seconds until what was written is on the disk."""
    begun = time.perf_counter()
    path = write()
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    # Together: one after another, many small files would wait for the disk once each.
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(_sync, files))
    return time.perf_counter() - begun


def _sync(file: Path) -> None:
    handle = os.open(file, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _bytes_in(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def _remove_all(place: Path) -> None:
    for path in place.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
