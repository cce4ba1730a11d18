"""A whole run: tiles of worlds from start to end, their results into a run folder.

A run is built in a hidden folder beside its place and moved there when it is whole: finished, or
interrupted with all finished tiles in it. An interrupted run can be taken up again.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs import sizes, waves
from angler_mjx.runs.processes import Alone, Team
from angler_mjx.runs.progress import Progress, Silent
from angler_mjx.runs.provenance import (
    describe_environment,
    peak_memory_bytes,
    require_policy,
    write_policy,
)
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.policy import Policy
from angler_mjx.simulator.simulator import CompileTime, Simulator
from angler_mjx.storage import folder, harvest, results
from angler_mjx.storage.harvest import FinishedTile
from angler_mjx.storage.recorder import Recorder
from angler_mjx.storage.writer import Writer


@dataclass(kw_only=True)
class _Clock:
    """Where the time of a run went, and the steps it was spent on."""

    compile: CompileTime
    begun: float = field(default_factory=time.perf_counter)
    simulate_s: float = 0.0
    disk_wait_s: float = 0.0
    vehicle_steps: int = 0


def rollout(
    scenario: Scenario,
    *,
    out: Path | str,
    chunk: int | None = None,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
    devices: int | None = None,
    team: Team | None = None,
    policy: Policy | None = None,
) -> folder.Run:
    """Run a scenario into a new run folder.

    Args:
        scenario: what to run.
        out: folder to make; must not exist.
        chunk: finished worlds held in memory until they are written, beside those that are being
            simulated; sized from free memory if left out. Changes no byte of the results.
        progress: what to tell while running.
        simulator: of the same scenario, to use what it has compiled already.
        devices: devices of this process to run on; all if left out. Changes no byte of the results.
        team: processes that share the run; each calls this with the same arguments.
        policy: that commands the robots, where no simulator is given; ``policy.json`` says which.

    Returns:
        The run. After an interruption (Ctrl-C) it holds what was finished, ``complete`` is false,
        and `resume` goes on with it.

    Raises:
        ConfigError: the folder exists or cannot be written, or the scenario cannot be used.
        RunError: the disk or the device's memory is full, a world cannot hold the fleet, or another
            process of the team failed.
    """
    place, team = Path(out), team or Alone()
    with _telling(team):
        if team.index == 0 and place.exists():
            raise ConfigError(f"--out {place}: exists; give another folder or remove it")
        simulator = simulator or Simulator(scenario, devices=devices, policy=policy)
        if simulator.scenario != scenario:
            raise ConfigError("simulator: was made for another scenario")
        room = sizes.room(simulator, chunk)
        if team.index == 0:
            _begin(simulator, place)
        team.meet("folder")
        try:
            return _Rollout(simulator, place, room, progress or Silent(), team).run()
        except BaseException:
            building = folder.partial_path(place)
            if team.count == 1 and building.exists() and folder.read_parts(building) is None:
                folder.remove(building)
            raise


def resume(
    out: Path | str,
    *,
    chunk: int | None = None,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
    devices: int | None = None,
    team: Team | None = None,
    policy: Policy | None = None,
) -> folder.Run:
    """Go on with an interrupted run, with the policy that it had; otherwise as `rollout`."""
    place, team = Path(out), team or Alone()
    with _telling(team):
        if team.index == 0:
            folder.reopen(place)
        team.meet("folder")
        scenario = folder.read_scenario(folder.partial_path(place))
        simulator = simulator or Simulator(scenario, devices=devices, policy=policy)
        require_policy(folder.partial_path(place), simulator.policy)
        if simulator.scenario.model_copy(update=_resolved(simulator)) != scenario:
            raise ConfigError("simulator: was made for another scenario")
        room = sizes.room(simulator, chunk)
        return _Rollout(simulator, place, room, progress or Silent(), team).run()


@contextmanager
def _telling(team: Team) -> Iterator[None]:
    """Tell the other processes if this one cannot go on, and part from them."""
    try:
        yield
    except BaseException as error:
        team.fail(str(error) or type(error).__name__)
        team.leave()
        raise


def _resolved(simulator: Simulator) -> dict[str, Any]:
    """What the simulator chose where the scenario said nothing."""
    return {"tile": simulator.tile, "kernels": simulator.kernels}


def _begin(simulator: Simulator, place: Path) -> None:
    """Make the folder of a new run, with what is known before the first world."""
    scenario, shape = simulator.scenario, sizes.shape_of(simulator)
    resolved = scenario.model_copy(update=_resolved(simulator))
    if scenario.time.record_hz > 0:
        folder.require_space(place, scenario.worlds * shape.bytes_per_world())
    building = folder.create(place)
    try:
        folder.write_json(building / folder.CONFIG, resolved.model_dump(mode="json"))
        folder.write_json(building / folder.ENVIRONMENT, describe_environment())
        write_policy(building, simulator.policy)
        if scenario.time.record_hz > 0:
            Recorder.create(
                building / folder.TRAJECTORIES,
                shape,
                simulator.world_shape().environment,
                tile=simulator.tile,
                sample_dt_s=1.0 / scenario.time.record_hz,
            )
    except BaseException:
        folder.remove(building)
        raise


class _Rollout:
    """One run in the making, or this process's share of it."""

    def __init__(
        self, simulator: Simulator, out: Path, room: int, progress: Progress, team: Team
    ) -> None:
        self._sim = simulator
        self._scenario = simulator.scenario
        self._building = folder.partial_path(out)
        self._out = out
        self._room = room
        self._progress = progress
        self._team = team
        self._shape = sizes.shape_of(simulator)
        self._recorder: Recorder | None = None
        if self._scenario.time.record_hz > 0:
            self._recorder = Recorder.reopen(
                self._building / folder.TRAJECTORIES, self._shape, tile=simulator.tile
            )

    def run(self) -> folder.Run:
        """Run what is left and close the folder."""
        team = self._team
        tiles, done = self._share()
        total = sum(min(self._sim.tile, self._scenario.worlds - first) for first in tiles)
        self._progress.start(done + total, done)
        self._progress.compiling()
        clock = _Clock(compile=self._sim.compile())
        self._progress.compiled(clock.compile)
        # Nobody writes a tile before everybody has looked which ones there are.
        team.meet("start")
        interrupted = self._simulate(tiles, clock)
        figures = {
            "devices": self._sim.devices,
            "interrupted": interrupted,
            "simulate_s": clock.simulate_s,
            "disk_wait_s": clock.disk_wait_s,
            "vehicle_steps": clock.vehicle_steps,
        }
        shares = team.meet("end", figures)
        if team.index == 0:
            self._close(clock, shares)
        team.meet("closed")
        return folder.Run(self._out)

    def _share(self) -> tuple[list[int], int]:
        """First worlds of this process's tiles, and the worlds that were finished before."""
        before = folder.read_parts(self._building)
        finished = set() if before is None else set(before["world"].to_pylist())
        tiles = range(0, self._scenario.worlds, self._sim.tile)
        left = [first for first in tiles if first not in finished]
        return left[self._team.index :: self._team.count], len(finished)

    def _simulate(self, tiles: list[int], clock: _Clock) -> bool:
        """Run the tiles and write them; returns whether that was interrupted."""
        team, interrupted = self._team, False
        recorded = self._recorder is not None
        writer = Writer[FinishedTile](self._write, room=self._room)
        begun = time.perf_counter()
        try:
            for finished in waves.simulate(
                self._sim, tiles, recorded=recorded, progress=self._progress
            ):
                for tile in finished:
                    seconds = float(np.sum(np.asarray(tile.end.tally.end_time_s)[: tile.kept]))
                    clock.vehicle_steps += round(seconds / self._sim.spec.physics_dt_s)
                    writer.put(tile)
                team.check()
                if team.stopping:
                    interrupted = True
                    break
        except KeyboardInterrupt:
            interrupted = True
            team.stop()
        finally:
            clock.simulate_s = time.perf_counter() - begun
            writer.close()
            clock.disk_wait_s = writer.waited_s
        return interrupted

    def _write(self, tile: FinishedTile) -> None:
        """Write a finished tile; its episodes last, for they say that it is whole."""
        try:
            if self._recorder is not None and tile.constants.environment is not None:
                arrays = harvest.arrays(tile, self._shape.samples)
                self._recorder.write(tile.first, arrays, tile.constants.environment)
            rows = results.episode_table(
                harvest.tile_result(tile), self._sim.variants(), self._scenario.seed
            )
            folder.write_part(self._building, tile.first, rows)
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

    def _close(self, clock: _Clock, shares: list[dict[str, Any]]) -> None:
        """Put the results together and give the folder its name."""
        episodes = folder.read_parts(self._building)
        if episodes is None:
            folder.remove(self._building)
            raise RunError("interrupted before the first tile was finished; nothing was kept")
        done = len(set(episodes["world"].to_pylist()))
        simulate_s = max(share["simulate_s"] for share in shares)
        steps = sum(share["vehicle_steps"] for share in shares)
        timing = {
            "compile_s": clock.compile.total_s,
            "simulate_s": simulate_s,
            "disk_wait_s": max(share["disk_wait_s"] for share in shares),
            "total_s": time.perf_counter() - clock.begun + clock.compile.total_s,
            "vehicle_steps": steps,
            "vehicle_steps_per_s": steps / max(simulate_s, 1e-9),
        }
        interrupted = any(share["interrupted"] for share in shares)
        summary = {
            "scenario": self._scenario.name,
            "engine": self._scenario.engine,
            "kernels": self._sim.kernels,
            "seed": self._scenario.seed,
            "tile": self._sim.tile,
            "devices": sum(share["devices"] for share in shares),
            "processes": len(shares),
            "worlds": self._scenario.worlds,
            "worlds_done": done,
            "complete": done == self._scenario.worlds and not interrupted,
            **results.summarise(episodes),
            "timing": timing,
            "peak_memory_bytes": peak_memory_bytes(),
            "run": str(self._out),
        }
        folder.finish(self._building, self._out, episodes, summary)
