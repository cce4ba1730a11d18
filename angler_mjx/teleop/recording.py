"""What was driven, as a run folder: replays, figures and exports read it like any other run.

Samples are kept in memory and written at the end, for until then nobody knows how many there are:
an hour of four robots at 5 Hz takes 10 MB. Beside the files of every run lies ``keys.txt``, the
keys that were pressed: as a script they drive the same scene the same way again.
"""

from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs import folder, harvest, results
from angler_mjx.runs.harvest import FinishedTile
from angler_mjx.runs.provenance import describe_environment, peak_memory_bytes
from angler_mjx.runs.recorder import Recorder, Shape
from angler_mjx.runs.scenario import Scenario
from angler_mjx.session.batch import Inside
from angler_mjx.session.interface import Observation
from angler_mjx.sim.state import Sample
from angler_mjx.teleop import script
from angler_mjx.teleop.loop import Driven

KEYS = "keys.txt"
"""Name of the file of keys in a run folder."""


class Recordable(Protocol):
    """A session whose truth can be recorded."""

    def inside(self) -> Inside:
        """What lies behind it."""
        ...


class Recording:
    """A run folder in the making; a hidden one, of which nothing stays unless it is finished."""

    def __init__(self, out: Path, scenario: Scenario, world: int) -> None:
        """Nothing is made yet.

        Args:
            out: folder to make; must not exist.
            scenario: that is driven.
            world: global index of its world.

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
        self._building: Path | None = None

    def __enter__(self) -> Self:
        """Take the folder's name, so that nobody drives for an hour in vain."""
        self._building = folder.create(self._out)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take away what was not finished."""
        if self._building is not None:
            folder.remove(self._building)

    def begin(self, session: Recordable) -> None:
        """Record a session from here on; it runs the same scenario."""
        self._session = session

    def after(self, observation: Observation) -> None:
        """Keep a sample, if one is due; see `loop.Watcher`."""
        sample = self._session.inside().sample
        if sample is not None and self._steps % self._every == 0:
            self._samples.append(jax.tree.map(np.asarray, sample))
        self._steps += 1

    def finish(self, driven: Driven, compile_s: float) -> folder.Run | None:
        """Write the run.

        Args:
            driven: how it went.
            compile_s: seconds that compiling took.

        Returns:
            The run; None if not even one step was driven.

        Raises:
            RunError: the disk gave out.
        """
        if self._building is None or not self._samples:
            return None
        building = self._building
        try:
            inside = self._session.inside()
            tile = self._tile(inside)
            scenario = self._resolved(inside)
            folder.write_json(building / folder.CONFIG, scenario.model_dump(mode="json"))
            folder.write_json(building / folder.ENVIRONMENT, describe_environment())
            self._write_trajectories(building, tile)
            episodes = results.episode_table(
                harvest.tile_result(tile), inside.simulator.variants(), scenario.seed
            )
            script.save(building / KEYS, driven.keys)
            summary = {
                **self._summary(scenario, driven, compile_s),
                **results.summarise(episodes),
            }
            run = folder.finish(building, self._out, episodes, summary)
        except OSError as error:
            raise RunError(
                f"--out {self._out}: cannot be written ({error.strerror or error})"
            ) from error
        self._building = None
        return run

    def _tile(self, inside: Inside) -> FinishedTile:
        """The world as the tile of a run, its samples joined to [1, n, ...]."""
        joined: Sample = jax.tree.map(lambda *leaves: np.stack(leaves, axis=1), *self._samples)
        return FinishedTile(
            first=self._world,
            kept=1,
            constants=jax.tree.map(np.asarray, harvest.constants(inside.worlds, recorded=True)),
            end=jax.tree.map(np.asarray, harvest.end(inside.state)),
            parts=[joined],
        )

    def _resolved(self, inside: Inside) -> Scenario:
        """The scenario as it was driven. Its horizon stays: what is drawn in time depends on it."""
        changed: dict[str, Any] = {
            # As many as are needed for this index; the others are not in the run.
            "worlds": self._world + 1,
            "tile": 1,
            "kernels": inside.simulator.kernels,
        }
        return self._scenario.model_copy(update=changed)

    def _write_trajectories(self, building: Path, tile: FinishedTile) -> None:
        environment = tile.constants.environment
        first = tile.parts[0]
        if environment is None or tile.constants.plan_time_s is None:
            raise RunError("the session keeps no environment to record")
        shape = Shape(
            worlds=self._world + 1,
            samples=len(self._samples),
            robots=first.p.shape[2],
            thrusters=first.pwm_us.shape[-1],
            obstacles=first.obstacle_p.shape[2],
            plan_points=tile.constants.plan_time_s.shape[-1],
        )
        recorder = Recorder.create(
            building / folder.TRAJECTORIES,
            shape,
            environment,
            tile=1,
            sample_dt_s=1.0 / self._scenario.time.record_hz,
        )
        recorder.write(tile.first, harvest.arrays(tile, shape.samples), environment)

    def _summary(self, scenario: Scenario, driven: Driven, compile_s: float) -> dict[str, Any]:
        """As of every run, and how it was driven."""
        overruns = driven.overruns
        steps = driven.steps * scenario.time.physics_steps * len(scenario.members())
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
            "complete": True,
            "timing": {
                "compile_s": compile_s,
                "simulate_s": driven.wall_s,
                "disk_wait_s": 0.0,
                "total_s": compile_s + driven.wall_s,
                "vehicle_steps": steps,
                "vehicle_steps_per_s": steps / max(driven.wall_s, 1e-9),
            },
            "teleop": {
                "steps": driven.steps,
                "scene_s": driven.scene_s,
                "realtime": overruns is not None,
                "overruns": None if overruns is None else overruns.count,
                "worst_overrun_s": None if overruns is None else overruns.worst_s,
                "keys": len(driven.keys),
            },
            "peak_memory_bytes": peak_memory_bytes(),
            "run": str(self._out),
        }
