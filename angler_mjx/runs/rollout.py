"""A whole run: tiles of worlds from start to end, their results into a run folder.

A run is built in a hidden folder beside its place and moved there when it is whole: finished, or
interrupted with all finished tiles in it. An interrupted run can be taken up again.
"""

import time
from dataclasses import dataclass, field
from pathlib import Path

import jax
import numpy as np
import psutil
import pyarrow as pa

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs import folder, harvest, results
from angler_mjx.runs.progress import Progress, Silent
from angler_mjx.runs.provenance import describe_environment, peak_memory_bytes
from angler_mjx.runs.recorder import Recorder, Shape
from angler_mjx.runs.scenario import Scenario
from angler_mjx.runs.simulator import CompileTime, Simulator
from angler_mjx.sim.state import Outcome, Sample
from angler_mjx.world.environment import Environment


@dataclass(frozen=True, kw_only=True)
class _Tile:
    """A finished tile on the host, waiting to be written."""

    first: int
    episodes: pa.Table
    arrays: dict[str, np.ndarray]
    environment: Environment


@dataclass(kw_only=True)
class _Clock:
    """Where the time of a run went, and the steps it was spent on."""

    compile: CompileTime
    begun: float = field(default_factory=time.perf_counter)
    simulate_s: float = 0.0
    vehicle_steps: int = 0


def rollout(
    scenario: Scenario,
    *,
    out: Path | str,
    chunk: int | None = None,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
) -> folder.Run:
    """Run a scenario into a new run folder.

    Args:
        scenario: what to run.
        out: folder to make; must not exist.
        chunk: worlds whose trajectories are held in memory before they are written; sized from
            free memory if left out. Changes no byte of the results.
        progress: what to tell while running.
        simulator: of the same scenario, to use what it has compiled already.

    Returns:
        The run. After an interruption (Ctrl-C) it holds what was finished, ``complete`` is false,
        and `resume` goes on with it.

    Raises:
        ConfigError: the folder exists or cannot be written, or the scenario cannot be used.
        RunError: the disk is full, or a world cannot hold the fleet.
    """
    place = Path(out)
    if place.exists():
        raise ConfigError(f"--out {place}: exists; give another folder or remove it")
    simulator = simulator or Simulator(scenario)
    if simulator.scenario != scenario:
        raise ConfigError("simulator: was made for another scenario")
    resolved = scenario.model_copy(update={"tile": simulator.tile})
    if scenario.time.record_hz > 0:
        folder.require_space(place, scenario.worlds * _shape(simulator).bytes_per_world())
    building = folder.create(place)
    try:
        folder.write_json(building / folder.CONFIG, resolved.model_dump(mode="json"))
        folder.write_json(building / folder.ENVIRONMENT, describe_environment())
        return _Rollout(simulator, building, place, chunk, progress or Silent()).run(new=True)
    except BaseException:
        if folder.read_parts(building) is None:
            folder.remove(building)
        raise


def resume(
    out: Path | str,
    *,
    chunk: int | None = None,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
) -> folder.Run:
    """Go on with an interrupted run; arguments and errors as in `rollout`."""
    place = Path(out)
    building = folder.reopen(place)
    scenario = folder.read_scenario(building)
    simulator = simulator or Simulator(scenario)
    if simulator.scenario.model_copy(update={"tile": simulator.tile}) != scenario:
        raise ConfigError("simulator: was made for another scenario")
    return _Rollout(simulator, building, place, chunk, progress or Silent()).run(new=False)


class _Rollout:
    """One run in the making."""

    def __init__(
        self,
        simulator: Simulator,
        building: Path,
        out: Path,
        chunk: int | None,
        progress: Progress,
    ) -> None:
        self._sim = simulator
        self._scenario = simulator.scenario
        self._building = building
        self._out = out
        self._progress = progress
        self._shape = _shape(simulator)
        self._chunk_tiles = _chunk_tiles(simulator, self._shape, chunk)
        self._recorder: Recorder | None = None

    def run(self, *, new: bool) -> folder.Run:
        """Run what is left and close the folder."""
        if self._scenario.time.record_hz > 0:
            path = self._building / folder.TRAJECTORIES
            dt = 1.0 / self._scenario.time.record_hz
            self._recorder = (
                Recorder.create(
                    path,
                    self._shape,
                    self._sim.world_shape().environment,
                    tile=self._sim.tile,
                    sample_dt_s=dt,
                )
                if new
                else Recorder.reopen(path, self._shape, tile=self._sim.tile)
            )
        before = folder.read_parts(self._building)
        finished = set() if before is None else set(before["world"].to_pylist())
        self._progress.start(self._scenario.worlds, len(finished))
        self._progress.compiling()
        clock = _Clock(compile=self._sim.compile())
        self._progress.compiled(clock.compile)
        waiting: list[_Tile] = []
        interrupted = False
        try:
            for first in range(0, self._scenario.worlds, self._sim.tile):
                if first in finished:
                    continue
                waiting.append(self._run_tile(first, clock))
                if len(waiting) == self._chunk_tiles:
                    self._flush(waiting)
        except KeyboardInterrupt:
            interrupted = True
        self._flush(waiting)
        return self._close(clock, interrupted)

    def _run_tile(self, first: int, clock: _Clock) -> _Tile:
        """One tile from its key to its results on the host."""
        begun = time.perf_counter()
        sim, kept = self._sim, min(self._sim.tile, self._scenario.worlds - first)
        worlds = sim.worlds(first)
        harvest.require_valid(worlds, first, kept)
        state = sim.reset(worlds)
        parts: list[Sample] = []
        for i in range(sim.segments):
            state, sample = sim.segment(worlds, state)
            if self._recorder is not None:
                parts.append(jax.device_get(sample))
            outcome = np.asarray(state.tally.outcome)[:kept]
            running = int(np.sum(outcome == Outcome.RUNNING))
            steps = running * sim.segment_steps * sim.spec.physics_steps
            done = running == 0
            share = (sim.segments - i) if done else 1
            self._progress.advance(kept * share / sim.segments, steps)
            if done:
                break
        result = harvest.tile_result(worlds, state, first, kept)
        steps = round(float(np.sum(result.end_time_s)) / sim.spec.physics_dt_s)
        clock.simulate_s += time.perf_counter() - begun
        clock.vehicle_steps += steps
        return _Tile(
            first=first,
            episodes=results.episode_table(result, sim.variants(), self._scenario.seed),
            arrays=harvest.arrays_of(worlds, parts, self._shape.samples, kept) if parts else {},
            environment=jax.device_get(worlds.environment),
        )

    def _flush(self, waiting: list[_Tile]) -> None:
        """Write finished tiles and forget them."""
        for tile in waiting:
            try:
                if self._recorder is not None:
                    self._recorder.write(tile.first, tile.arrays, tile.environment)
                folder.write_part(self._building, tile.first, tile.episodes)
            except OSError as error:
                kept = (
                    "nothing was finished before, and nothing is kept"
                    if folder.read_parts(self._building) is None
                    else f"what was finished before is in {self._building}; make room and go on "
                    "with --resume"
                )
                raise RunError(
                    f"--out {self._out}: writing worlds {tile.first} and on failed "
                    f"({error.strerror or error}); {kept}"
                ) from error
        waiting.clear()

    def _close(self, clock: _Clock, interrupted: bool) -> folder.Run:
        """Put the results together and give the folder its name."""
        episodes = folder.read_parts(self._building)
        if episodes is None:
            folder.remove(self._building)
            raise RunError("interrupted before the first tile was finished; nothing was kept")
        done = len(set(episodes["world"].to_pylist()))
        timing = {
            "compile_s": clock.compile.total_s,
            "simulate_s": clock.simulate_s,
            "total_s": time.perf_counter() - clock.begun + clock.compile.total_s,
            "vehicle_steps": clock.vehicle_steps,
            "vehicle_steps_per_s": clock.vehicle_steps / max(clock.simulate_s, 1e-9),
        }
        summary = {
            "scenario": self._scenario.name,
            "engine": self._scenario.engine,
            "seed": self._scenario.seed,
            "tile": self._sim.tile,
            "worlds": self._scenario.worlds,
            "worlds_done": done,
            "complete": done == self._scenario.worlds and not interrupted,
            **results.summarise(episodes),
            "timing": timing,
            "peak_memory_bytes": peak_memory_bytes(),
            "run": str(self._out),
        }
        return folder.finish(self._building, self._out, episodes, summary)


def _shape(simulator: Simulator) -> Shape:
    scenario = simulator.scenario
    world = simulator.world_shape()
    return Shape(
        worlds=scenario.worlds,
        samples=simulator.samples * simulator.segments,
        robots=len(scenario.members()),
        thrusters=world.cascade.vehicle.B.shape[-1],
        obstacles=world.environment.obstacles.kind.shape[-1],
        plan_points=world.path.time_s.shape[-1],
    )


def _chunk_tiles(simulator: Simulator, shape: Shape, chunk: int | None) -> int:
    """Tiles held in memory before they are written."""
    if chunk is not None:
        if chunk < 1:
            raise ConfigError(f"--chunk {chunk}: must be at least 1 world")
        return max(1, chunk // simulator.tile)
    # A quarter of the free memory, twice the arrays: samples come in parts and are joined.
    per_tile = 2 * simulator.tile * shape.bytes_per_world()
    return int(np.clip(psutil.virtual_memory().available // 4 // max(per_tile, 1), 1, 64))
