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
from angler_mjx.runs.session.batch import Inside
from angler_mjx.runs.session.interface import Floats, Observation
from angler_mjx.runs.storage import device_to_host, folder, results
from angler_mjx.runs.storage import inputs as copies
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.recorder import Recorder, Shape
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.record import Sample, asked_in, sizes_of


class Recordable(Protocol):
    """A session whose truth can be recorded."""

    def inside(self) -> Inside:
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
        given = np.column_stack([self.position_m, self.yaw_rad])
        place = np.column_stack([np.interp(times, self.time_s, column) for column in given.T])
        made = {"plan_time_s": times, "plan_m": place[:, :3]}
        if joints:
            still = np.zeros_like(place)
            made |= {"plan_yaw_rad": place[:, 3], "plan_degree": np.full(rows, LINEAR)}
            made |= {"plan_velocity": still, "plan_acceleration": still}
        return made


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
        self._every = scenario.time.steps_per_sample
        self._steps = 0
        self._samples: list[Sample] = []
        self._ways: dict[int, FlownPath] = {}
        self._inputs = tuple(inputs)
        self._claimed: OutputLock | None = None

    def __enter__(self) -> Self:
        """Take the folder's name, so that nobody waits for an hour in vain, and copy the inputs."""
        claimed = folder.create(self._out)
        try:
            vehicles = [entry.vehicle for entry in self._scenario.fleet]
            files = [*copies.of_world(self._scenario.world), *self._inputs]
            copies.take(claimed.building, vehicles, files)
        except OSError as error:
            claimed.withdraw()
            raise ConfigError(f"--out {self._out}: cannot be written ({error.strerror})") from error
        except BaseException:
            claimed.withdraw()
            raise
        self._claimed = claimed
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take away what was not finished."""
        if self._claimed is not None:
            self._claimed.withdraw()

    @property
    def building(self) -> Path:
        """The hidden folder, for files that are to lie beside those of every run.

        Raises:
            RunError: it is not open.
        """
        if self._claimed is None:
            raise RunError("the recording is not open")
        return self._claimed.building

    def begin(self, session: Recordable) -> None:
        """Record a session from here on; it runs the same scenario."""
        self._session = session

    def plan(self, robot: int, way: FlownPath) -> None:
        """Keep this as a robot's plan, and not the planner's path."""
        self._ways[robot] = way

    def after(self, observation: Observation) -> None:
        """Keep a sample, if one is due; called after every step."""
        sample = self._session.inside().sample
        if sample is not None and self._steps % self._every == 0:
            self._samples.append(jax.tree.map(np.asarray, sample))
        self._steps += 1

    def close(self, course: RecordedCourse) -> folder.Run | None:
        """Write the run.

        Returns:
            The run; None if not even one step was made.

        Raises:
            RunError: the disk gave out.
        """
        if self._claimed is None or not self._samples:
            return None
        claimed, self._claimed = self._claimed, None
        building = claimed.building
        try:
            inside = self._session.inside()
            tile = self._tile(inside)
            scenario = self._resolved(inside)
            folder.write_json(building / folder.CONFIG, scenario.model_dump(mode="json"))
            folder.write_json(building / folder.ENVIRONMENT, describe_environment())
            self._write_trajectories(building, tile)
            episodes = results.episode_table(
                device_to_host.tile_result(tile), inside.simulator.labels(), scenario.seed
            )
            summary = {**self._summary(scenario, course), **results.summarise(episodes)}
            return folder.finish(claimed, episodes, summary)
        except OSError as error:
            raise RunError(
                f"--out {self._out}: cannot be written ({error.strerror or error}); what there is "
                f"lies in {building}"
            ) from error
        finally:
            claimed.release()

    def _tile(self, inside: Inside) -> FinishedTile:
        """The world as the tile of a run, its samples joined to [1, n, ...]."""
        joined: Sample = jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *self._samples)
        kept = jax.tree.map(np.array, device_to_host.constants(inside.worlds, recorded=True))
        for robot, way in self._ways.items():
            kept.planned[0, robot] = True
            # In as many rows as the planner's paths have.
            rows = kept.plan["plan_time_s"].shape[-1]
            for name, values in way.arrays(rows, joints="plan_degree" in kept.plan).items():
                kept.plan[name][0, robot] = values
        return FinishedTile(
            first=self._world,
            kept=1,
            constants=kept,
            end=jax.tree.map(np.asarray, device_to_host.end(inside.state, recorded=True)),
            parts=[joined],
        )

    def _resolved(self, inside: Inside) -> Scenario:
        """The scenario as it was run. Its horizon stays: what is drawn in time depends on it."""
        changed: dict[str, Any] = {
            # As many as are needed for this index; the others are not in the run.
            "worlds": self._world + 1,
            "tile": 1,
            # Of flights on real autopilots nothing is recorded beside what all have.
            "store": self._scenario.store.model_copy(update={"also": asked_in(self._samples[0])}),
            "engine": inside.simulator.scenario.engine,
            "kernels": inside.simulator.kernels,
        }
        return self._scenario.model_copy(update=changed)

    def _write_trajectories(self, building: Path, tile: FinishedTile) -> None:
        environment = tile.constants.environment
        first = tile.parts[0]
        sizes = sizes_of(first, lead=2)
        plan = tile.constants.plan
        if environment is None or plan is None:
            raise RunError("the session keeps no environment to record")
        shape = Shape(
            worlds=self._world + 1,
            samples=len(self._samples),
            robots=sizes["robot"],
            thrusters=sizes["thruster"],
            obstacles=sizes["obstacle"],
            plan_points=plan["plan_time_s"].shape[-1],
            estimated=first.belief is not None,
            jointed="plan_degree" in plan,
            finely=self._scenario.store,
            also=asked_in(first),
            task=device_to_host.task_sizes(tile.constants.task),
        )
        recorder = Recorder.create(
            building / folder.TRAJECTORIES,
            shape,
            environment,
            tile=1,
            sample_dt_s=1.0 / self._scenario.time.record_hz,
        )
        recorder.write(tile.first, device_to_host.arrays(tile, shape.samples), environment)
        recorder.sync(tile.first)

    def _summary(self, scenario: Scenario, course: RecordedCourse) -> dict[str, Any]:
        """As of every run, and how it went."""
        steps = course.steps * scenario.time.physics_steps * len(scenario.members())
        broken = {"interrupted": course.interrupted} if course.interrupted else {}
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
            **broken,
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
