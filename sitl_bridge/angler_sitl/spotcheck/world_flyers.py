"""Flyers that repeat a world of a run: in the batch simulator, or with real autopilots."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Literal, Protocol, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stages import CONTROLLERS
from angler_mjx.runs.session import online_policy
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import ControllerConfig
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import Outcome, World
from angler_sitl.firmware.parameters import PositionSource
from angler_sitl.scene.scenario_options import select_scenario
from angler_sitl.session import SitlSession
from angler_sitl.spotcheck import flight
from angler_sitl.spotcheck.flight import SpotcheckFlight
from angler_sitl.spotcheck.rebuilt_worlds import single_world_scenario

type SpotLevel = Literal["guided", "thrusters"]
"""Levels that can follow plans."""
type ReferenceController = Literal["surrogate", "cascade"]
"""Controllers of the batch simulator that autopilots are compared with."""

CONTROLLER_STACKS: dict[ReferenceController, str] = {"surrogate": "ardusub", "cascade": "cascade"}
"""Controller stack of each."""
ARM_STACKS: dict[ReferenceController, tuple[str, ...]] = {
    "surrogate": ("follow", "guided", "ardusub"),
    "cascade": CONTROLLERS["arm"],
}
"""Stages of each where end effectors are brought to the goals: the same with inverse kinematics."""
CARRY_STACKS: dict[ReferenceController, tuple[str, ...]] = {
    "surrogate": CONTROLLERS["ardusub"],
    "cascade": ("follow", "pose", "velocity", "cargo_wrench", "pseudo_inverse"),
}
"""Stages of each where robots carry something together: the cascade knows the cargo's moment."""

type FlightProgress = Callable[[float], None]
"""Receiver of the flown fraction of the horizon."""


class SpotcheckFlyer(Protocol):
    """Flyer of worlds."""

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Release all resources."""
        ...

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """Fly a world.

        Args:
            index: its global index.
            worlds: itself; [1] leads.
            progress: receives the progress.
        """
        ...


class BatchFlyer:
    """Batch simulator with a selected controller."""

    def __init__(self, scenario: Scenario, against: ReferenceController) -> None:
        """Build the simulation.

        Args:
            scenario: of the run, with the robots that fly.
            against: reference controller.
        """
        controller = ControllerConfig(name=CONTROLLER_STACKS[against])
        if scenario.by_end_effector:
            controller = ControllerConfig(stages=ARM_STACKS[against])
        elif isinstance(scenario.task, CarryTask):
            controller = ControllerConfig(stages=CARRY_STACKS[against])
        self._simulator = Simulator(
            single_world_scenario(scenario).model_copy(update={"controller": controller})
        )

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Release nothing: no resources are held."""

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """Fly a world as `SpotcheckFlyer.fly`."""
        simulator = self._simulator
        sample_dt_s = simulator.steps_per_sample * simulator.spec.control_dt_s
        state, samples = simulator.reset(worlds), list[Sample]()
        for number in range(simulator.segments):
            state, sample, running = simulator.advance(worlds, state)
            samples.append(jax.tree.map(np.asarray, sample))
            progress((number + 1) / simulator.segments)
            sampled_s = ((number + 1) * simulator.samples - 1) * sample_dt_s
            # A sample after the last robot's end holds its end position.
            if int(running[0]) == 0 and sampled_s >= float(np.max(state.tally.end_time_s)):
                break
        return flight.build_flight(
            worlds,
            state,
            samples,
            world=index,
            variants=simulator.labels(),
            seed=simulator.scenario.seed,
            sample_dt_s=sample_dt_s,
        )


class SitlFlyer:
    """Real autopilots at one level, started anew for each world.

    Where a policy of the scenario updates plans or brings end effectors to the goals, it does so
    here too: from the autopilots' estimates, with the keys of the world, and with the delay of the
    batch simulator.
    """

    def __init__(
        self,
        scenario: Scenario,
        level: SpotLevel,
        source: PositionSource,
        speed: Literal["max"] | float,
        binary: Path | None,
    ) -> None:
        """Compile the scene; see `SitlSession` for arguments and errors."""
        self._scenario = scenario
        self._session = SitlSession(
            scenario, level=level, source=source, speed=speed, binary=binary
        )
        self._policy: online_policy.OnlineFlyer | None = None

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the session: no autopilot is left running."""
        self._session.close()

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """Fly a world as `SpotcheckFlyer.fly`."""
        session, timing = self._session, self._scenario.time
        observed = session.reset(worlds=worlds)
        policy = self._prepare_policy()
        samples = list[Sample]()
        for step in range(timing.control_steps):
            all_ended = all(status.outcome is not Outcome.RUNNING for status in observed.status)
            observed = session.step(None if policy is None else policy.commands(observed))
            if step % timing.steps_per_sample == 0:
                samples.append(jax.tree.map(np.asarray, session.inside().sample))
                progress((step + 1) / timing.control_steps)
                if all_ended:  # this sample holds the end position of the last robot
                    break
        internals = session.inside()
        return flight.build_flight(
            internals.worlds,
            internals.state,
            samples,
            world=index,
            variants=internals.simulator.labels(),
            seed=self._scenario.seed,
            sample_dt_s=timing.steps_per_sample * timing.control_dt_s,
        )

    def _prepare_policy(self) -> online_policy.OnlineFlyer | None:
        """Return the policy of the scenario in the current world; compiled once for all."""
        if not self._scenario.flown:
            return None
        if self._policy is None:
            self._policy = online_policy.OnlineFlyer(self._session)
        else:
            self._policy.restart()
        return self._policy


def select_fleet(scenario: Scenario, robots: int) -> Scenario:
    """Return the scenario of a run reduced to its first robots.

    Raises:
        ConfigError: the scenario has fewer robots, or they carry something together.
    """
    fleet = len(scenario.members())
    if not 1 <= robots <= fleet:
        raise ConfigError(f"--robots {robots}: the run has {fleet} robots; give 1 to {fleet}")
    if robots != fleet and isinstance(scenario.task, CarryTask):
        raise ConfigError(
            f"--robots {robots}: the {fleet} robots of the run carry something together; leave "
            "--robots out"
        )
    return scenario if robots == fleet else select_scenario(scenario, robots)
