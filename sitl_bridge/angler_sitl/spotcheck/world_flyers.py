"""Flying a world of a run again: in the batch simulator, or by real autopilots."""

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Protocol, Self

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.session import online_policy
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import ControllerConfig
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import Outcome, World
from angler_sitl.firmware.parameters import PositionSource
from angler_sitl.missions.scenario_options import select_scenario
from angler_sitl.session import SitlSession
from angler_sitl.spotcheck import flight
from angler_sitl.spotcheck.flight import SpotcheckFlight
from angler_sitl.spotcheck.rebuilt_worlds import single_world_scenario

type SpotLevel = Literal["guided", "thrusters"]
"""Levels that can follow plans."""
type ReferenceController = Literal["surrogate", "cascade"]
"""Controllers of the batch simulator that autopilots are held against."""

CONTROLLER_STACKS: dict[ReferenceController, str] = {"surrogate": "ardusub", "cascade": "cascade"}
"""Their stacks."""

type FlightProgress = Callable[[float], None]
"""Told the share of the horizon that was flown."""


class SpotcheckFlyer(Protocol):
    """Flies worlds."""

    def __enter__(self) -> Self:
        """Itself."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Whatever it holds is let go."""
        ...

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """Fly a world.

        Args:
            index: its global index.
            worlds: itself; [1] leads.
            progress: told how far it is.
        """
        ...


class BatchFlyer:
    """The batch simulator with a controller of its own choice."""

    def __init__(self, scenario: Scenario, against: ReferenceController) -> None:
        """Put the simulation together.

        Args:
            scenario: of the run, with the robots that fly.
            against: whose controllers.
        """
        update = {"controller": ControllerConfig(name=CONTROLLER_STACKS[against])}
        self._simulator = Simulator(single_world_scenario(scenario).model_copy(update=update))

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is held."""

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """See `SpotcheckFlyer.fly`."""
        simulator = self._simulator
        sample_dt_s = simulator.steps_per_sample * simulator.spec.control_dt_s
        state, samples = simulator.reset(worlds), list[Sample]()
        for number in range(simulator.segments):
            state, sample, running = simulator.advance(worlds, state)
            samples.append(jax.tree.map(np.asarray, sample))
            progress((number + 1) / simulator.segments)
            sampled_s = ((number + 1) * simulator.samples - 1) * sample_dt_s
            # A sample after the last robot's end: it says where that was.
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
    """Real autopilots at one level, brought up anew for each world.

    Where the scenario looks after its plans, its policy does so here too: from what the autopilots
    believe, with the keys of the world, and as late as in the batch simulator.
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
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """No autopilot is left running."""
        self._session.close()

    def fly(self, index: int, worlds: World, progress: FlightProgress) -> SpotcheckFlight:
        """See `SpotcheckFlyer.fly`."""
        session, timing = self._session, self._scenario.time
        observed = session.reset(worlds=worlds)
        policy = self._prepare_policy()
        samples = list[Any]()
        for step in range(timing.control_steps):
            all_ended = all(status.outcome is not Outcome.RUNNING for status in observed.status)
            observed = session.step(None if policy is None else policy.commands(observed))
            if step % timing.steps_per_sample == 0:
                samples.append(jax.tree.map(np.asarray, session.inside().sample))
                progress((step + 1) / timing.control_steps)
                if all_ended:  # this sample says where the last robot was when it ended
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
        """What looks after the plans of the world that was just reset; compiled once for all."""
        if not self._scenario.online:
            return None
        if self._policy is None:
            self._policy = online_policy.OnlineFlyer(self._session)
        else:
            self._policy.restart()
        return self._policy


def select_fleet(scenario: Scenario, robots: int) -> Scenario:
    """The scenario of a run with its first so many robots.

    Raises:
        ConfigError: it has fewer.
    """
    fleet = len(scenario.members())
    if not 1 <= robots <= fleet:
        raise ConfigError(f"--robots {robots}: the run has {fleet} robots; give 1 to {fleet}")
    return scenario if robots == fleet else select_scenario(scenario, robots)
