"""How fast a run is recorded, beside what the disk can do and what the device makes.

Disk and recorder are timed in the same folder and in turns, because a disk shared with others
changes from second to second. Both are timed to the end of ``fsync``, both let the disk begin while
they go on, and both write the same number of bytes. The samples are real ones: a tile of a scenario
is simulated to its horizon once, and written again and again as new tiles of a run.
"""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.runs import sizes
from angler_mjx.runs.storage import atomic_files, device_to_host, shards
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.record import Sample
from angler_mjx.studies.speed.measured import simulation
from angler_mjx.studies.speed.measured.simulation import TimedSimulation
from angler_mjx.studies.speed.rows import SpeedRow, check_repeats, summarise_rates

BLOCK_BYTES = 16 * 2**20
"""Of one plain write: large enough that the call does not matter."""
MIN_BYTES = 256 * 10**6
"""On disk in one turn, in as many tiles as that takes: opening files should not matter either."""


def measure(
    scenario: Scenario,
    *,
    label: str,
    worlds: int,
    repeats: int,
    folder: Path,
    min_bytes: int = MIN_BYTES,
    progress: Progress | None = None,
) -> SpeedRow:
    """Measure simulation, recorder and disk.

    Args:
        scenario: with ``record_hz`` above 0.
        label: name of the workload.
        worlds: of a tile.
        repeats: turns, after one that does not count.
        folder: on the disk in question; what is written there is taken away again.
        min_bytes: written in one turn at least.
        progress: receives steps and turns.

    Returns:
        Rates in MB/s of bytes that reached the disk. ``extra`` holds the disk's own rate
        (``disk_mbps``) and how much it varied (``disk_spread``), the ratio of both
        (``disk_ratio``), the rate in samples before compression (``samples_mbps``),
        ``bytes_per_robot_sample`` on disk, ``vehicle_steps_per_s`` of the simulation in tiles of
        the same size, and ``break_even_hz``.

    Raises:
        ConfigError: too few repeats, nothing is recorded, or the folder cannot be written.
        RunError: as in `simulation.measure`.
    """
    check_repeats(repeats)
    progress = progress or Progress()
    if scenario.time.record_hz == 0:
        raise ConfigError("record_hz = 0: there is nothing to record; give a scenario that does")
    with _temporary_folder(folder) as temporary:
        timed = simulation.time_simulation(
            scenario, label=label, worlds=worlds, repeats=repeats, progress=progress
        )
        progress.describe("simulating a tile to its end")
        tile = _simulate_to_horizon(timed)
        progress.describe("writing")
        written = _measure_turns(timed, tile, temporary, repeats, min_bytes, progress)
    speed = timed.row.median or 0.0
    recorder = float(np.median(written.recorder_mbps))
    disk = float(np.median(written.disk_mbps))
    return replace(
        timed.row,
        inside=f"{written.tiles} tiles of {worlds:,} worlds, {scenario.time.record_hz:g} Hz, from "
        "samples on the host to the end of fsync: joining, compression, files",
        unit="MB/s",
        **summarise_rates(written.recorder_mbps),
        flops=None,
        flops_from="not counted: nothing is computed",
        least_bytes=None,
        active_share=None,
        extra={
            "disk_mbps": disk,
            "disk_spread": (max(written.disk_mbps) - min(written.disk_mbps)) / disk,
            "disk_ratio": recorder / disk,
            "samples_mbps": recorder * written.compression,
            "bytes_per_robot_sample": written.bytes_per_robot_sample,
            "vehicle_steps_per_s": speed,
            "break_even_hz": break_even_hz(
                recorder, written.bytes_per_robot_sample, speed, scenario.time.physics_dt_s
            ),
        },
    )


def break_even_hz(
    recorder_mbps: float, bytes_per_robot_sample: float, vehicle_steps_per_s: float, dt_s: float
) -> float:
    """Record rate above which the device would wait for the disk, Hz of simulated time.

    Robots together live ``vehicle_steps_per_s * dt_s`` seconds in a second; each writes its bytes
    at the record rate.

    Args:
        recorder_mbps: bytes on disk, MB/s.
        bytes_per_robot_sample: on disk.
        vehicle_steps_per_s: of the device, physics steps of all robots.
        dt_s: simulated time of one.
    """
    return recorder_mbps * 1e6 / (vehicle_steps_per_s * dt_s * bytes_per_robot_sample)


@dataclass(frozen=True, kw_only=True)
class _Written:
    """What was measured of the disk."""

    tiles: int
    disk_mbps: list[float]
    recorder_mbps: list[float]
    compression: float
    """Bytes of samples for each byte on disk."""
    bytes_per_robot_sample: float
    """On disk, with its share of the obstacles' samples."""


@contextmanager
def _temporary_folder(folder: Path) -> Iterator[Path]:
    """A folder of its own, which is taken away again."""
    temporary = folder / f".recording-{os.getpid()}"
    try:
        temporary.mkdir(parents=True)
        yield temporary
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror or error})") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _simulate_to_horizon(timed: TimedSimulation) -> FinishedTile:
    """Simulate the tile until its robots have ended."""
    simulator, worlds = timed.simulator, timed.worlds
    state, parts = simulator.reset(worlds), list[Sample]()
    cells = simulator.programs.flight.pack_cells(worlds)
    for _ in range(simulator.segments):
        state, sample, running = timed.program(simulator.fleet, worlds, state, cells)
        parts.append(_to_host(sample))
        if not np.asarray(running).any():
            break
    return FinishedTile(
        first=0,
        kept=simulator.tile,
        constants=_to_host(device_to_host.select_constants(worlds, recorded=True)),
        end=_to_host(device_to_host.select_end(state, recorded=True)),
        parts=parts,
    )


def _to_host[T](tree: T) -> T:
    on_host: T = jax.tree.map(np.asarray, tree)
    return on_host


def _measure_turns(
    timed: TimedSimulation,
    tile: FinishedTile,
    folder: Path,
    repeats: int,
    min_bytes: int,
    progress: Progress,
) -> _Written:
    simulator = timed.simulator
    shape = replace(sizes.trajectory_shape(simulator), worlds=simulator.tile)
    dt_s = 1.0 / simulator.scenario.time.record_hz
    begin = partial(_RepeatedRun, folder / "run.zarr", tile, shape, dt_s)
    single_run = begin(1)
    single_run.write()
    run_bytes = _folder_bytes(folder)
    _clear_folder(folder)
    tiles = -(-min_bytes // run_bytes)
    disk, recorder = [], []
    progress.start(repeats, unit="turns")
    for turn in range(repeats + 1):
        run = begin(tiles)
        taken = _time_write(run.write, folder)
        size = _folder_bytes(folder)
        _clear_folder(folder)
        plain = _time_write(partial(_write_plain, folder / "plain", size), folder)
        _clear_folder(folder)
        if turn > 0:
            recorder.append(size / taken / 1e6)
            disk.append(size / plain / 1e6)
        progress.advance(int(turn > 0))
    return _Written(
        tiles=tiles,
        disk_mbps=disk,
        recorder_mbps=recorder,
        compression=tiles * tile.kept * shape.bytes_per_world() / size,
        bytes_per_robot_sample=size / (tiles * tile.kept * shape.samples * shape.robots),
    )


class _RepeatedRun:
    """A run whose tiles are all the same one."""

    def __init__(
        self, path: Path, tile: FinishedTile, shape: TrajectoryShape, dt_s: float, tiles: int
    ) -> None:
        if tile.constants.environment is None:
            raise RunError("the tile was simulated without its environment: there is none to write")
        self._tile, self._tiles, self._samples = tile, tiles, shape.samples
        self._environment = tile.constants.environment
        whole = replace(shape, worlds=tiles * tile.kept)
        self._recorder = Recorder.create(
            path, whole, self._environment, tile=tile.kept, sample_dt_s=dt_s
        )

    def write(self) -> None:
        """Write all tiles, one after another, as a run does."""
        for number in range(self._tiles):
            arrays = device_to_host.recorded_arrays(self._tile, self._samples)
            self._recorder.write(number * self._tile.kept, arrays, self._environment)


@cache
def _random_block() -> bytes:
    return np.random.default_rng(0).bytes(BLOCK_BYTES)


def _write_plain(path: Path, size: int) -> None:
    """Write a file of a size in large blocks of bytes that no disk can make smaller."""
    block = memoryview(_random_block())
    with path.open("wb", buffering=0) as file:
        for begin in range(0, size, BLOCK_BYTES):
            written = file.write(block[: min(BLOCK_BYTES, size - begin)])
            shards.start_writeback(file.fileno(), begin, written)


def _time_write(write: Callable[[], None], folder: Path) -> float:
    """Seconds until what was written is on the disk."""
    begun = time.perf_counter()
    write()
    files = [path for path in folder.rglob("*") if path.is_file()]
    # Together: one after another, many small files would wait for the disk once each.
    with ThreadPoolExecutor(16) as pool:
        list(pool.map(atomic_files.sync_path, files))
    return time.perf_counter() - begun


def _folder_bytes(path: Path) -> int:
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def _clear_folder(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink()
