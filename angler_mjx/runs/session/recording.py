"""Recording of a session as a run folder: figures, replays and exports read it like any other.

Samples are kept in memory and written at the end, because their number is unknown until then: an
hour of four robots at 5 Hz takes 10 MB.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.files import JsonTable
from angler_mjx.robot.control.commands.joint_trajectory import LINEAR
from angler_mjx.runs.provenance import describe_environment, peak_memory_bytes
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.runs.session.interface import Floats, Observation
from angler_mjx.runs.storage import device_to_host, folder, results
from angler_mjx.runs.storage import input_copies as copies
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_json
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.fleet import label_joints
from angler_mjx.sim.record import Sample, recorded_options, sizes_of


class Recordable(Protocol):
    """Session whose true state can be recorded."""

    def inside(self) -> SessionInternals:
        """Return its internals."""
        ...


@dataclass(frozen=True, kw_only=True)
class FlownPath:
    """Reference positions of a robot at some times."""

    time_s: Floats
    """[n] times."""
    position_m: Floats
    """[n, 3] in W."""
    yaw_rad: Floats
    """[n] unwrapped."""

    def arrays(self, rows: int, *, joints: bool) -> dict[str, np.ndarray]:
        """Return arrays of a recorded plan, resampled to a number of rows by straight lines.

        Args:
            rows: rows of the plan.
            joints: whether the plans of the run are trajectories of joints.
        """
        times = np.linspace(self.time_s[0], self.time_s[-1], rows)
        columns = np.column_stack([self.position_m, self.yaw_rad])
        sampled = np.column_stack([np.interp(times, self.time_s, column) for column in columns.T])
        arrays: dict[str, np.ndarray] = {"plan_time_s": times, "plan_m": sampled[:, :3]}
        if joints:
            zeros = np.zeros_like(sampled)
            arrays |= {"plan_yaw_rad": sampled[:, 3], "plan_degree": np.full(rows, LINEAR)}
            arrays |= {"plan_velocity": zeros, "plan_acceleration": zeros}
        return arrays


@dataclass(frozen=True, kw_only=True)
class RecordedCourse:
    """Course of a session, for the summary of its run."""

    steps: int
    """Control steps."""
    wall_s: float
    compile_s: float
    more: JsonTable
    """Further keys of the summary."""
    interrupted: str = ""
    """Cause of an interruption; empty after a complete session."""


class SessionRecording:
    """Run folder being written; hidden, and removed unless it is finished."""

    def __init__(
        self,
        out: Path,
        scenario: Scenario,
        world: int,
        inputs: Sequence[tuple[str, Path]] = (),
    ) -> None:
        """Set the inputs; the folder is created later.

        Args:
            out: folder to create; must not exist.
            scenario: scenario of the session.
            world: global index of its world.
            inputs: role and file of inputs other than the scenario's vehicles.

        Raises:
            ConfigError: the scenario stores no trajectories.
        """
        self._out, self._scenario, self._world = out, scenario, world
        if scenario.time.record_hz == 0:
            raise ConfigError(
                f"--out {out}: the scenario stores no trajectories (time.record_hz = 0); "
                "set a rate, for example record_hz = 5"
            )
        self._steps_per_sample = scenario.time.steps_per_sample
        self._steps = 0
        self._samples: list[Sample] = []
        self._paths: dict[int, FlownPath] = {}
        self._inputs = tuple(inputs)
        self._lock: OutputLock | None = None

    def __enter__(self) -> Self:
        """Reserve the folder's name, so that conflicts show early, and copy the inputs."""
        lock = folder.create_folder(self._out)
        with lock.filling() as building:
            vehicles = [entry.vehicle for entry in self._scenario.fleet]
            files = [*copies.world_files(self._scenario.world), *self._inputs]
            copies.copy_inputs(building, vehicles, files)
        self._lock = lock
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Remove an unfinished recording."""
        if self._lock is not None:
            self._lock.withdraw()

    @property
    def building(self) -> Path:
        """Return the hidden folder, for files in addition to those of every run.

        Raises:
            RunError: the recording is not open.
        """
        if self._lock is None:
            raise RunError("the recording is not open")
        return self._lock.building

    def begin(self, session: Recordable) -> None:
        """Record a session of the same scenario from now on."""
        self._session = session

    def plan(self, robot: int, path: FlownPath) -> None:
        """Record this plan of a robot instead of the planner's path."""
        self._paths[robot] = path

    def after(self, observation: Observation) -> None:
        """Record a sample if one is due; called after every step."""
        sample = self._session.inside().sample
        if sample is not None and self._steps % self._steps_per_sample == 0:
            self._samples.append(jax.tree.map(np.asarray, sample))
        self._steps += 1

    def close(self, course: RecordedCourse) -> folder.Run | None:
        """Write the run.

        Returns:
            The run; None without steps.

        Raises:
            RunError: writing failed.
        """
        if self._lock is None or not self._samples:
            return None
        lock, self._lock = self._lock, None
        advice = f"the unfinished recording is in {lock.building}"
        try:
            with wrap_write_errors(f"--out {self._out}", advice):
                return self._write_run(lock, course)
        finally:
            lock.release()

    def _write_run(self, lock: OutputLock, course: RecordedCourse) -> folder.Run:
        """Write the files of the run, and give its folder its name."""
        building, internals = lock.building, self._session.inside()
        tile = self._build_tile(internals)
        scenario = self._resolved_scenario(internals)
        write_json(building / folder.CONFIG, scenario.model_dump(mode="json"))
        write_json(building / folder.ENVIRONMENT, describe_environment())
        self._write_trajectories(building, tile)
        episodes = results.episode_table(
            device_to_host.build_tile_result(tile), internals.simulator.labels(), scenario.seed
        )
        summary = {
            **self._build_summary(scenario, course),
            **results.summarise_episodes(episodes),
        }
        return folder.finish_folder(lock, episodes, summary)

    def _build_tile(self, internals: SessionInternals) -> FinishedTile:
        """Build the world as the tile of a run, its samples joined to [1, n, ...]."""
        joined: Sample = jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *self._samples)
        constants = jax.tree.map(
            np.array, device_to_host.select_constants(internals.worlds, recorded=True)
        )
        for robot, path in self._paths.items():
            constants.planned[0, robot] = True
            # With as many rows as the planner's paths.
            rows = constants.plan["plan_time_s"].shape[-1]
            for name, values in path.arrays(rows, joints="plan_degree" in constants.plan).items():
                constants.plan[name][0, robot] = values
        return FinishedTile(
            first=self._world,
            kept=1,
            constants=constants,
            end=jax.tree.map(np.asarray, device_to_host.select_end(internals.state, recorded=True)),
            parts=[joined],
        )

    def _resolved_scenario(self, internals: SessionInternals) -> Scenario:
        """Return the scenario as run. Its horizon is kept: samples in time depend on it."""
        changes: dict[str, object] = {
            # As many worlds as this index needs; the others are not in the run.
            "worlds": self._world + 1,
            "tile": 1,
            # Flights on real autopilots record only the common columns.
            "store": self._scenario.store.model_copy(
                update={"also": recorded_options(self._samples[0])}
            ),
            "engine": internals.simulator.scenario.engine,
            "kernels": internals.simulator.kernels,
        }
        return self._scenario.model_copy(update=changes)

    def _write_trajectories(self, building: Path, tile: FinishedTile) -> None:
        environment = tile.constants.environment
        first = tile.parts[0]
        sizes = sizes_of(first, lead=2)
        plan = tile.constants.plan
        if environment is None or plan is None:
            raise RunError("the session keeps no environment to record")
        shape = TrajectoryShape(
            worlds=self._world + 1,
            samples=len(self._samples),
            robots=sizes["robot"],
            thrusters=sizes["thruster"],
            obstacles=sizes["obstacle"],
            plan_points=plan["plan_time_s"].shape[-1],
            estimated=first.belief is not None,
            jointed="plan_degree" in plan,
            store_config=self._scenario.store,
            also=recorded_options(first),
            task=device_to_host.task_sizes(tile.constants.task),
            joints={} if first.joints is None else label_joints(self._scenario.members()),
        )
        recorder = Recorder.create(
            building / folder.TRAJECTORIES,
            shape,
            environment,
            tile=1,
            sample_dt_s=1.0 / self._scenario.time.record_hz,
        )
        recorder.write(tile.first, device_to_host.recorded_arrays(tile, shape.samples), environment)
        recorder.sync(tile.first)

    def _build_summary(self, scenario: Scenario, course: RecordedCourse) -> JsonTable:
        """Build the summary of a run, with the course of the session."""
        steps = course.steps * scenario.time.physics_steps * len(scenario.members())
        interruption: JsonTable = {}
        if course.interrupted:
            interruption["interrupted"] = course.interrupted
        return {
            "scenario": scenario.name,
            "engine": scenario.engine,
            "kernels": scenario.kernels,
            "seed": scenario.seed,
            "tile": 1,
            "devices": 1,
            "processes": 1,
            "worlds": scenario.worlds,
            "worlds_done": 1,
            "complete": not course.interrupted,
            **interruption,
            "timing": {
                "compile_s": course.compile_s,
                "simulate_s": course.wall_s,
                "disk_wait_s": 0.0,
                "total_s": course.compile_s + course.wall_s,
                "vehicle_steps": steps,
                "vehicle_steps_per_s": steps / max(course.wall_s, 1e-9),
            },
            **course.more,
            "peak_memory_bytes": peak_memory_bytes(),
            "run": str(self._out),
        }
