"""What happened in a session, as a run folder: figures, replays and exports read it like any other.

Samples are kept in memory and written at the end, for until then nobody knows how many there are:
an hour of four robots at 5 Hz takes 10 MB.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.joint_trajectory import LINEAR
from angler_mjx.runs.provenance import describe_environment, peak_memory_bytes
from angler_mjx.runs.session.batch_session import SessionInternals
from angler_mjx.runs.session.interface import Floats, Observation
from angler_mjx.runs.storage import device_to_host, folder, results
from angler_mjx.runs.storage import input_copies as copies
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.record import Sample, recorded_options, sizes_of


class Recordable(Protocol):
    """A session whose truth can be recorded."""

    def inside(self) -> SessionInternals:
        """What lies behind it."""
        ...


@dataclass(frozen=True, kw_only=True)
class FlownPath:
    """Where a robot was to be, at so many times."""

    time_s: Floats
    """[n]."""
    position_m: Floats
    """[n, 3] in W."""
    yaw_rad: Floats
    """[n] unwrapped."""

    def arrays(self, rows: int, *, joints: bool) -> dict[str, Any]:
        """As plans are recorded: so many rows, joined by lines.

        Args:
            rows: of the plan.
            joints: whether the plans of the run are trajectories of joints.
        """
        times = np.linspace(self.time_s[0], self.time_s[-1], rows)
        columns = np.column_stack([self.position_m, self.yaw_rad])
        sampled = np.column_stack([np.interp(times, self.time_s, column) for column in columns.T])
        arrays = {"plan_time_s": times, "plan_m": sampled[:, :3]}
        if joints:
            zeros = np.zeros_like(sampled)
            arrays |= {"plan_yaw_rad": sampled[:, 3], "plan_degree": np.full(rows, LINEAR)}
            arrays |= {"plan_velocity": zeros, "plan_acceleration": zeros}
        return arrays


@dataclass(frozen=True, kw_only=True)
class RecordedCourse:
    """How a session went, for the summary of its run."""

    steps: int
    """Control steps."""
    wall_s: float
    compile_s: float
    more: Mapping[str, Any]
    """Further keys of the summary."""
    interrupted: str = ""
    """What broke it off; empty if it came to its end."""


class SessionRecording:
    """A run folder in the making; a hidden one, of which nothing stays unless it is finished."""

    def __init__(
        self,
        out: Path,
        scenario: Scenario,
        world: int,
        inputs: Sequence[tuple[str, Path]] = (),
    ) -> None:
        """Nothing is made yet.

        Args:
            out: folder to make; must not exist.
            scenario: that is run.
            world: global index of its world.
            inputs: role and file of what is used beside the scenario's vehicles.

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
        """Take the folder's name, so that nobody waits for an hour in vain, and copy the inputs."""
        lock = folder.create_folder(self._out)
        try:
            vehicles = [entry.vehicle for entry in self._scenario.fleet]
            files = [*copies.world_files(self._scenario.world), *self._inputs]
            copies.copy_inputs(lock.building, vehicles, files)
        except OSError as error:
            lock.withdraw()
            raise ConfigError(f"--out {self._out}: cannot be written ({error.strerror})") from error
        except BaseException:
            lock.withdraw()
            raise
        self._lock = lock
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take away what was not finished."""
        if self._lock is not None:
            self._lock.withdraw()

    @property
    def building(self) -> Path:
        """The hidden folder, for files that are to lie beside those of every run.

        Raises:
            RunError: it is not open.
        """
        if self._lock is None:
            raise RunError("the recording is not open")
        return self._lock.building

    def begin(self, session: Recordable) -> None:
        """Record a session from here on; it runs the same scenario."""
        self._session = session

    def plan(self, robot: int, path: FlownPath) -> None:
        """Keep this as a robot's plan, and not the planner's path."""
        self._paths[robot] = path

    def after(self, observation: Observation) -> None:
        """Keep a sample, if one is due; called after every step."""
        sample = self._session.inside().sample
        if sample is not None and self._steps % self._steps_per_sample == 0:
            self._samples.append(jax.tree.map(np.asarray, sample))
        self._steps += 1

    def close(self, course: RecordedCourse) -> folder.Run | None:
        """Write the run.

        Returns:
            The run; None if not even one step was made.

        Raises:
            RunError: the disk gave out.
        """
        if self._lock is None or not self._samples:
            return None
        lock, self._lock = self._lock, None
        building = lock.building
        try:
            internals = self._session.inside()
            tile = self._build_tile(internals)
            scenario = self._resolved_scenario(internals)
            folder.write_json(building / folder.CONFIG, scenario.model_dump(mode="json"))
            folder.write_json(building / folder.ENVIRONMENT, describe_environment())
            self._write_trajectories(building, tile)
            episodes = results.episode_table(
                device_to_host.build_tile_result(tile), internals.simulator.labels(), scenario.seed
            )
            summary = {
                **self._build_summary(scenario, course),
                **results.summarise_episodes(episodes),
            }
            return folder.finish_folder(lock, episodes, summary)
        except OSError as error:
            raise RunError(
                f"--out {self._out}: cannot be written ({error.strerror or error}); what there is "
                f"lies in {building}"
            ) from error
        finally:
            lock.release()

    def _build_tile(self, internals: SessionInternals) -> FinishedTile:
        """The world as the tile of a run, its samples joined to [1, n, ...]."""
        joined: Sample = jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *self._samples)
        constants = jax.tree.map(
            np.array, device_to_host.select_constants(internals.worlds, recorded=True)
        )
        for robot, path in self._paths.items():
            constants.planned[0, robot] = True
            # In as many rows as the planner's paths have.
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
        """The scenario as it was run. Its horizon stays: what is drawn in time depends on it."""
        changes: dict[str, Any] = {
            # As many as are needed for this index; the others are not in the run.
            "worlds": self._world + 1,
            "tile": 1,
            # Of flights on real autopilots nothing is recorded beside what all have.
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

    def _build_summary(self, scenario: Scenario, course: RecordedCourse) -> dict[str, Any]:
        """As of every run, and how it went."""
        steps = course.steps * scenario.time.physics_steps * len(scenario.members())
        interruption = {"interrupted": course.interrupted} if course.interrupted else {}
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
