"""A whole run: tiles of worlds from start to end, their results into a run folder.

A run is built in a hidden folder beside its place and moved there when it is whole: finished, or
interrupted with all finished tiles in it. An interrupted run can be taken up again.
"""

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.online import host_planner
from angler_mjx.planning.online.policy import Online
from angler_mjx.runs import device_batches, opening, sizes
from angler_mjx.runs.log import Log
from angler_mjx.runs.processes import OneProcess, Processes, telling
from angler_mjx.runs.progress import Progress, SilentProgress
from angler_mjx.runs.provenance import peak_memory_bytes, require_policy
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.runs.simulator.compiling import CompileTime
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host, folder, output_lock, planned, results
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.plans.read import PlanFile, open_plans
from angler_mjx.runs.storage.recorder import Recorder
from angler_mjx.runs.storage.writer import Writer
from angler_mjx.scenario import notices
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.policy import Policy


class NothingKeptError(RunError):
    """A run was interrupted before its first tile was finished."""


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
    processes: Processes | None = None,
    policy: Policy | None = None,
    workers: int | None = None,
    plans: Path | str | None = None,
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
        processes: processes that share the run; each calls this with the same arguments.
        policy: that commands the robots, where no simulator is given; ``policy.json`` says which.
        workers: processes that plan, where the planner is one of the host; one for each processor
            if left out. Changes no byte of the results.
        plans: file of plans to fly (`angler_mjx.runs.storage.plans`), instead of the scenario's
            planner; ``plans.json`` says which.

    Returns:
        The run. After an interruption (Ctrl-C) it holds what was finished, ``complete`` is false,
        and `resume` goes on with it.

    Raises:
        ConfigError: the folder exists or cannot be written, or the scenario cannot be used.
        RunError: the disk or the device's memory is full, a world cannot hold the fleet, or another
            process of the run failed.
    """
    place, processes = Path(out), processes or OneProcess()
    with telling(processes), ExitStack() as stack:
        if processes.index == 0:
            folder.require_none(place)
        found = None if plans is None else open_plans(Path(plans), scenario)
        if simulator is None:
            simulator = Simulator(
                scenario,
                devices=devices,
                policy=policy,
                workers=workers,
                paths=None if found is None else found.shape,
            )
            stack.callback(simulator.close)
        if simulator.scenario != scenario:
            raise ConfigError("simulator: was made for another scenario")
        if found is not None and simulator.paths != found.shape:
            raise ConfigError(
                f"simulator: flies {simulator.paths}, and {found.path} holds {found.shape}; make "
                "it with paths=open_plans(...).shape"
            )
        room = sizes.room(simulator, chunk)
        claimed = None
        if processes.index == 0:
            claimed = opening.begin(simulator, place, found)
            stack.enter_context(opening.held(claimed, new=processes.count == 1))
        processes.meet("folder")
        run_progress = progress or SilentProgress()
        return _Rollout(simulator, place, room, run_progress, processes, claimed, found).run()


def resume(
    out: Path | str,
    *,
    scenario: Scenario | None = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    simulator: Simulator | None = None,
    devices: int | None = None,
    processes: Processes | None = None,
    policy: Policy | None = None,
    workers: int | None = None,
    plans: Path | str | None = None,
) -> folder.Run:
    """Go on with an interrupted run; arguments and errors as in `rollout`.

    What the run stored is looked through first. Tiles of which something is missing or damaged are
    computed again, and ``progress`` is told.

    Args:
        out: name of the run.
        scenario: that a person takes the run to be of; refused if it is of another one.
        chunk: as in `rollout`.
        progress: as in `rollout`.
        simulator: as in `rollout`.
        devices: as in `rollout`.
        processes: as in `rollout`.
        policy: the one that the run was begun with.
        workers: as in `rollout`.
        plans: the file that the run was begun with, if it lies elsewhere now.

    Raises:
        ConfigError: there is no interrupted run of that name, another process goes on with it, it
            is of another scenario or policy, or its vehicle files were edited since.
        RunError: as in `rollout`.
    """
    place, processes = Path(out), processes or OneProcess()
    run_progress = progress or SilentProgress()
    with telling(processes), ExitStack() as stack:
        claimed = None
        if processes.index == 0:
            if scenario is not None:
                opening.require_same(place, scenario)
            begun = folder.where(place)
            require_policy(
                begun, _commands(begun, policy) if simulator is None else simulator.policy
            )
            claimed = folder.reopen(place, run_progress.tell)
            stack.enter_context(opening.held(claimed, new=False))
        processes.meet("found")
        building = output_lock.partial_path(place)
        stored = folder.read_scenario(building)
        found = opening.plans_again(building, plans, stored)
        if simulator is None:
            simulator = Simulator(
                stored,
                devices=devices,
                policy=policy,
                workers=workers,
                paths=None if found is None else found.shape,
            )
            stack.callback(simulator.close)
        require_policy(building, simulator.policy)
        if simulator.scenario.model_copy(update=opening.resolved(simulator)) != stored:
            raise ConfigError("simulator: was made for another scenario")
        room = sizes.room(simulator, chunk)
        if processes.index == 0 and stored.time.record_hz > 0:
            opening.mend(simulator, building, run_progress)
        processes.meet("folder")
        return _Rollout(simulator, place, room, run_progress, processes, claimed, found).run()


def _commands(building: Path, policy: Policy | None) -> Policy | None:
    """What will command the robots of a run that goes on."""
    if not (building / folder.CONFIG).exists():
        return policy
    return scenario_policy.policy_of(folder.read_scenario(building), policy)


class _Rollout:
    """One run in the making, or this process's share of it."""

    def __init__(
        self,
        simulator: Simulator,
        out: Path,
        room: int,
        progress: Progress,
        processes: Processes,
        claimed: OutputLock | None,
        plans: PlanFile | None,
    ) -> None:
        self._plans = plans
        self._sim = simulator
        self._scenario = simulator.scenario
        self._claimed = claimed
        """Process 0's alone."""
        self._building = output_lock.partial_path(out)
        self._out = out
        self._room = room
        number = f".{processes.index}" if processes.index else ""
        self._progress = Log(self._building / f"{folder.LOG}{number}", progress)
        self._processes = processes
        self._shape = sizes.shape_of(simulator)
        self._failures = planned.PlanningFailures(self._progress.tell)
        self._recorder: Recorder | None = None
        if self._scenario.time.record_hz > 0:
            self._recorder = Recorder.reopen(
                self._building / folder.TRAJECTORIES, self._shape, tile=simulator.tile
            )

    def run(self) -> folder.Run:
        """Run what is left and close the folder."""
        try:
            run = self._run()
        except BaseException as error:
            self._progress.write(f"ended: {error or type(error).__name__}")
            raise
        finally:
            self._progress.close()
        return run

    def _run(self) -> folder.Run:
        processes = self._processes
        tiles, done = self._share()
        total = sum(min(self._sim.tile, self._scenario.worlds - first) for first in tiles)
        self._progress.start(done + total, done)
        commanded = not isinstance(self._sim.policy, Online | None)
        for line in notices.lines(
            self._scenario, planned=self._sim.planner is not None, commanded=commanded
        ):
            self._progress.tell(line)
        self._progress.compiling()
        clock = _Clock(compile=self._sim.compile())
        self._progress.compiled(clock.compile)
        # Nobody writes a tile before everybody has looked which ones there are.
        processes.meet("start")
        interrupted = self._simulate(tiles, clock)
        figures = {
            "devices": self._sim.devices,
            "interrupted": interrupted,
            "simulate_s": clock.simulate_s,
            "disk_wait_s": clock.disk_wait_s,
            "vehicle_steps": clock.vehicle_steps,
        }
        shares = processes.meet("end", figures)
        if processes.index == 0:
            self._close(clock, shares)
        processes.meet("closed")
        return folder.Run(self._out)

    def _share(self) -> tuple[list[int], int]:
        """First worlds of this process's tiles, and the worlds that were finished before."""
        before = folder.read_parts(self._building)
        finished = set() if before is None else set(before["world"].to_pylist())
        left = []
        for first in range(0, self._scenario.worlds, self._sim.tile):
            worlds = range(first, min(first + self._sim.tile, self._scenario.worlds))
            if not finished.issuperset(worlds) or self._lost(first):
                left.append(first)
                finished.difference_update(worlds)
        return left[self._processes.index :: self._processes.count], len(finished)

    def _lost(self, first: int) -> bool:
        """Whether trajectories of a finished tile are not there any more."""
        name = None if self._recorder is None else self._recorder.lacks(first)
        if name is not None and self._processes.index == 0:
            self._progress.tell(
                f"{self._building / folder.TRAJECTORIES / name}: worlds {first} and on are missing "
                "or damaged; they are computed again"
            )
        return name is not None

    def _simulate(self, tiles: list[int], clock: _Clock) -> bool:
        """Run the tiles and write them; returns whether that was interrupted."""
        processes, interrupted = self._processes, False
        recorded = self._recorder is not None
        writer = Writer[FinishedTile](self._write, room=self._room)
        begun = time.perf_counter()
        try:
            for finished in device_batches.simulate(
                self._sim,
                tiles,
                recorded=recorded,
                progress=self._progress,
                plans=self._plans,
            ):
                for tile in finished:
                    seconds = float(np.sum(np.asarray(tile.end.tally.end_time_s)[: tile.kept]))
                    clock.vehicle_steps += round(seconds / self._sim.spec.physics_dt_s)
                    writer.put(tile)
                processes.check()
                if processes.stopping:
                    interrupted = True
                    break
        except KeyboardInterrupt:
            interrupted = True
            processes.stop()
        finally:
            clock.simulate_s = time.perf_counter() - begun
            writer.close()
            clock.disk_wait_s = writer.waited_s
            for reason, count in host_planner.take_failures():
                self._progress.tell(f"planning in flight failed {count} times: {reason}")
        return interrupted

    def _write(self, tile: FinishedTile) -> None:
        """Write a finished tile; its episodes last, for they say that it is whole."""
        try:
            if self._recorder is not None and tile.constants.environment is not None:
                arrays = device_to_host.arrays(tile, self._shape.samples)
                self._recorder.write(tile.first, arrays, tile.constants.environment)
                self._recorder.sync(tile.first)
            result = device_to_host.tile_result(tile)
            self._failures.add(result.world, result.notes)
            rows = results.episode_table(result, self._sim.labels(), self._scenario.seed)
            folder.write_part(self._building, tile.first, rows)
        except OSError as error:
            kept = (
                "nothing was finished before, and nothing is kept"
                if not folder.holds_results(self._building)
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
        if episodes is None or self._claimed is None:
            if self._claimed is not None and not folder.holds_results(self._building):
                self._claimed.withdraw()
            raise NothingKeptError(
                "interrupted before the first tile was finished; nothing was kept"
            )
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
        early = planned.early(summary["passed_goal_early"])
        for line in (*planned.lines(summary["planning"]), *early):
            self._progress.write(line)
        self._progress.write(f"{done} of {self._scenario.worlds} worlds are finished")
        self._progress.close()
        try:
            folder.finish(self._claimed, episodes, summary)
        except OSError as error:
            raise RunError(
                f"--out {self._out}: cannot be written ({error.strerror or error}); all finished "
                f"worlds are in {self._building}; make room and go on with --resume"
            ) from error
