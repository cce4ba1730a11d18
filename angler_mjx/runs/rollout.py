"""Run a scenario: simulate its tiles of worlds and write their results into a run folder.

A run is built in a hidden folder beside its place and moved there when it is whole: finished, or
interrupted with all finished tiles in it. An interrupted run can be taken up again.
"""

import queue
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypedDict

import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.planning.online import host_replanner
from angler_mjx.planning.online.policy import Online
from angler_mjx.progress import Progress
from angler_mjx.runs import device_batches, folder_setup, sizes
from angler_mjx.runs.log import Log
from angler_mjx.runs.processes import OneProcess, Processes, reporting_failure
from angler_mjx.runs.provenance import peak_memory_bytes, require_policy
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.runs.simulator.compilation import CompileTime
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import (
    device_to_host,
    folder,
    output_lock,
    planning_summary,
    results,
    results_folder,
)
from angler_mjx.runs.storage.atomic_files import wrap_write_errors
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.plans.read import PlanFile, open_plans
from angler_mjx.runs.storage.recorder import Recorder
from angler_mjx.scenario import notices
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.policy import Policy


class NothingKeptError(RunError):
    """A run was interrupted before its first tile was finished."""


class _ProcessReport(TypedDict):
    """Part of one process in a run."""

    devices: int
    interrupted: bool
    simulate_s: float
    disk_wait_s: float
    vehicle_steps: int


@dataclass(kw_only=True)
class _RunTimer:
    """Times of a run by activity, and the steps simulated in them."""

    compile: CompileTime
    started_s: float = field(default_factory=time.perf_counter)
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
    path, processes = Path(out), processes or OneProcess()
    with reporting_failure(processes), ExitStack() as stack:
        if processes.index == 0:
            folder.require_none(path)
        plan_file = None if plans is None else open_plans(Path(plans), scenario)
        if simulator is None:
            simulator = Simulator(
                scenario,
                devices=devices,
                policy=policy,
                workers=workers,
                paths=None if plan_file is None else plan_file.shape,
            )
            stack.callback(simulator.close)
        if simulator.scenario != scenario:
            raise ConfigError("simulator: was made for another scenario")
        if plan_file is not None and simulator.paths != plan_file.shape:
            raise ConfigError(
                f"simulator: flies {simulator.paths}, and {plan_file.path} holds "
                f"{plan_file.shape}; make "
                "it with paths=open_plans(...).shape"
            )
        buffered_tiles = sizes.max_buffered_tiles(simulator, chunk)
        lock = None
        if processes.index == 0:
            lock = folder_setup.create_run_folder(simulator, path, plan_file)
            stack.enter_context(folder_setup.hold_lock(lock, is_new=processes.count == 1))
        processes.meet("folder")
        run_progress = progress or Progress()
        return _Rollout(
            simulator, path, buffered_tiles, run_progress, processes, lock, plan_file
        ).run()


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
    path, processes = Path(out), processes or OneProcess()
    run_progress = progress or Progress()
    with reporting_failure(processes), ExitStack() as stack:
        lock = None
        if processes.index == 0:
            if scenario is not None:
                folder_setup.require_same_scenario(path, scenario)
            existing = results_folder.locate_folder(path)
            require_policy(
                existing,
                _resolve_policy(existing, policy) if simulator is None else simulator.policy,
            )
            lock = folder.reopen_folder(path, run_progress.report)
            stack.enter_context(folder_setup.hold_lock(lock, is_new=False))
        processes.meet("found")
        building = output_lock.partial_path(path)
        stored = folder.read_scenario(building)
        plan_file = folder_setup.reopen_plans(building, plans, stored)
        if simulator is None:
            simulator = Simulator(
                stored,
                devices=devices,
                policy=policy,
                workers=workers,
                paths=None if plan_file is None else plan_file.shape,
            )
            stack.callback(simulator.close)
        require_policy(building, simulator.policy)
        if (
            simulator.scenario.model_copy(update=folder_setup.resolved_settings(simulator))
            != stored
        ):
            raise ConfigError("simulator: was made for another scenario")
        buffered_tiles = sizes.max_buffered_tiles(simulator, chunk)
        if processes.index == 0 and stored.time.record_hz > 0:
            folder_setup.repair_trajectories(simulator, building, run_progress)
        processes.meet("folder")
        return _Rollout(
            simulator, path, buffered_tiles, run_progress, processes, lock, plan_file
        ).run()


def _resolve_policy(building: Path, policy: Policy | None) -> Policy | None:
    """Return the policy that commands the robots of a resumed run."""
    if not (building / folder.CONFIG).exists():
        return policy
    return scenario_policy.resolve_policy(folder.read_scenario(building), policy)


class _Rollout:
    """A run that is being made, or this process's part of it."""

    def __init__(
        self,
        simulator: Simulator,
        out: Path,
        buffered_tiles: int,
        progress: Progress,
        processes: Processes,
        lock: OutputLock | None,
        plans: PlanFile | None,
    ) -> None:
        self._plans = plans
        self._sim = simulator
        self._scenario = simulator.scenario
        self._lock = lock
        """Process 0's alone."""
        self._building = output_lock.partial_path(out)
        self._out = out
        self._buffered_tiles = buffered_tiles
        number = f".{processes.index}" if processes.index else ""
        self._progress = Log(self._building / f"{folder.LOG}{number}", progress)
        self._processes = processes
        self._shape = sizes.trajectory_shape(simulator)
        self._failures = planning_summary.PlanningFailures(self._progress.report)
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
        tiles, done = self._assign_tiles()
        total = sum(min(self._sim.tile, self._scenario.worlds - first) for first in tiles)
        self._progress.start(done + total, done)
        commanded = not isinstance(self._sim.policy, Online | None)
        for line in notices.run_notices(
            self._scenario, uses_planner=self._sim.planner is not None, is_commanded=commanded
        ):
            self._progress.report(line)
        self._progress.describe("compiling")
        clock = _RunTimer(compile=self._sim.compile())
        self._progress.report(f"compiled in {clock.compile.total_s:.1f} s")
        self._progress.describe("simulating")
        # Nobody writes a tile before everybody has looked which ones there are.
        processes.meet("start")
        interrupted = self._simulate_tiles(tiles, clock)
        statistics: _ProcessReport = {
            "devices": self._sim.devices,
            "interrupted": interrupted,
            "simulate_s": clock.simulate_s,
            "disk_wait_s": clock.disk_wait_s,
            "vehicle_steps": clock.vehicle_steps,
        }
        reports = processes.meet("end", statistics)
        if processes.index == 0:
            self._close_folder(clock, reports)
        processes.meet("closed")
        return folder.Run(self._out)

    def _assign_tiles(self) -> tuple[list[int], int]:
        """Return the first worlds of this process's tiles, and the worlds finished before."""
        stored = folder.read_parts(self._building)
        finished = set() if stored is None else set(stored["world"].to_pylist())
        remaining = []
        for first in range(0, self._scenario.worlds, self._sim.tile):
            worlds = range(first, min(first + self._sim.tile, self._scenario.worlds))
            if not finished.issuperset(worlds) or self._has_lost_arrays(first):
                remaining.append(first)
                finished.difference_update(worlds)
        return remaining[self._processes.index :: self._processes.count], len(finished)

    def _has_lost_arrays(self, first: int) -> bool:
        """Return whether trajectories of a finished tile are missing."""
        name = None if self._recorder is None else self._recorder.find_missing(first)
        if name is not None and self._processes.index == 0:
            self._progress.report(
                f"{self._building / folder.TRAJECTORIES / name}: worlds {first} and on are missing "
                "or damaged; they are computed again"
            )
        return name is not None

    def _simulate_tiles(self, tiles: list[int], clock: _RunTimer) -> bool:
        """Run the tiles and write them; returns whether that was interrupted."""
        processes, interrupted = self._processes, False
        recorded = self._recorder is not None
        writer = _TileWriter(self._write_tile, max_waiting=self._buffered_tiles)
        started_s = time.perf_counter()
        try:
            for finished in device_batches.simulate_tiles(
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
            clock.simulate_s = time.perf_counter() - started_s
            writer.close()
            clock.disk_wait_s = writer.waited_s
            for reason, count in host_replanner.take_failures():
                self._progress.report(f"planning in flight failed {count} times: {reason}")
        return interrupted

    def _write_tile(self, tile: FinishedTile) -> None:
        """Write a finished tile; its episodes last, for they say that it is whole."""
        try:
            if self._recorder is not None and tile.constants.environment is not None:
                arrays = device_to_host.recorded_arrays(tile, self._shape.samples)
                self._recorder.write(tile.first, arrays, tile.constants.environment)
                self._recorder.sync(tile.first)
            result = device_to_host.build_tile_result(tile)
            self._failures.add(result.world, result.notes)
            rows = results.episode_table(result, self._sim.labels(), self._scenario.seed)
            folder.write_part(self._building, tile.first, rows)
        except OSError as error:
            advice = (
                "nothing was finished before, and nothing is kept"
                if not folder.holds_results(self._building)
                else f"what was finished before is in {self._building}; make room and go on "
                "with --resume"
            )
            raise RunError(
                f"--out {self._out}: writing worlds {tile.first} and on failed "
                f"({error.strerror or error}); {advice}"
            ) from error

    def _close_folder(self, clock: _RunTimer, reports: list[_ProcessReport]) -> None:
        """Put the results together and give the folder its name."""
        episodes = folder.read_parts(self._building)
        if episodes is None or self._lock is None:
            if self._lock is not None and not folder.holds_results(self._building):
                self._lock.withdraw()
            raise NothingKeptError(
                "interrupted before the first tile was finished; nothing was kept"
            )
        done = len(set(episodes["world"].to_pylist()))
        simulate_s = max(report["simulate_s"] for report in reports)
        steps = sum(report["vehicle_steps"] for report in reports)
        timing = {
            "compile_s": clock.compile.total_s,
            "simulate_s": simulate_s,
            "disk_wait_s": max(report["disk_wait_s"] for report in reports),
            "total_s": time.perf_counter() - clock.started_s + clock.compile.total_s,
            "vehicle_steps": steps,
            "vehicle_steps_per_s": steps / max(simulate_s, 1e-9),
        }
        interrupted = any(report["interrupted"] for report in reports)
        episode_summary = results.summarise_episodes(episodes)
        summary = {
            "scenario": self._scenario.name,
            "engine": self._scenario.engine,
            "kernels": self._sim.kernels,
            "seed": self._scenario.seed,
            "tile": self._sim.tile,
            "devices": sum(report["devices"] for report in reports),
            "processes": len(reports),
            "worlds": self._scenario.worlds,
            "worlds_done": done,
            "complete": done == self._scenario.worlds and not interrupted,
            **episode_summary,
            "timing": timing,
            "peak_memory_bytes": peak_memory_bytes(),
            "run": str(self._out),
        }
        early = planning_summary.early_lines(episode_summary["passed_goal_early"])
        for line in (*planning_summary.reason_lines(episode_summary["planning"]), *early):
            self._progress.write(line)
        self._progress.write(f"{done} of {self._scenario.worlds} worlds are finished")
        self._progress.close()
        advice = f"all finished worlds are in {self._building}; make room and go on with --resume"
        with wrap_write_errors(f"--out {self._out}", advice):
            folder.finish_folder(self._lock, episodes, summary)


class _TileWriter:
    """Writes finished tiles in order, in a thread, while the device computes the next ones.

    Their number is bounded: `put` blocks while there is no room. After a failed write nothing more
    is written, and the error is raised by the next `put` or by `close`.
    """

    def __init__(self, write: Callable[[FinishedTile], None], *, max_waiting: int) -> None:
        """Start the thread.

        Args:
            write: writes a tile.
            max_waiting: tiles waiting or being written at most.
        """
        self._write = write
        self._slots = threading.BoundedSemaphore(max_waiting)
        self._waiting: queue.SimpleQueue[FinishedTile | None] = queue.SimpleQueue()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._write_items, name="angler-writer")
        self._thread.start()
        self.waited_s = 0.0
        """Seconds that `put` and `close` waited for the disk."""

    def put(self, tile: FinishedTile) -> None:
        """Hand over a tile.

        Raises:
            RunError: or whatever a write before raised.
        """
        started_s = time.perf_counter()
        self._slots.acquire()
        self.waited_s += time.perf_counter() - started_s
        if self._error is not None:
            self._slots.release()
            raise self._error
        self._waiting.put(tile)

    def close(self) -> None:
        """Wait until everything is written; errors as in `put`."""
        started_s = time.perf_counter()
        self._waiting.put(None)
        self._thread.join()
        self.waited_s += time.perf_counter() - started_s
        if self._error is not None:
            raise self._error

    def _write_items(self) -> None:
        while (tile := self._waiting.get()) is not None:
            try:
                if self._error is None:
                    self._write(tile)
            except BaseException as error:
                self._error = error
            finally:
                self._slots.release()
