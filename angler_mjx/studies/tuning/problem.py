"""What is tuned: settings from outside, and candidates turned into costs."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import SimSpec
from angler_mjx.studies.flights import kinds
from angler_mjx.studies.flights.measures import LAST_S, FlightMeasures
from angler_mjx.studies.tuning import knobs, objectives, samples
from angler_mjx.studies.tuning.flying import Done, TuningFlyer
from angler_mjx.studies.tuning.objectives import Objective, RelativeObjective
from angler_mjx.studies.tuning.samples import COURSES, FlightSet
from angler_mjx.studies.tuning.search import Generation

type Method = Literal["gradient", "cma"]

SWITCHING_STAGES = ("ardusub", "ismc", "aitsm")
"""Stages that switch: the gradient of a flight says little about the next one."""


@dataclass(frozen=True, kw_only=True)
class TuningSettings:
    """What is to be tuned, and how."""

    scenario: Scenario
    controller: str
    objective: Objective
    method: Method
    rollouts: int
    """Flights of each candidate."""
    generations: int
    seed: int

    def table(self) -> dict[str, object]:
        """As plain values."""
        return {**vars(self), "scenario": self.scenario.model_dump(mode="json")}


def method_of(objective: Objective, controller: str) -> Method:
    """The method that suits: gradients where costs are smooth, evolution elsewhere."""
    rough = objective == "robust" or any(
        x in SWITCHING_STAGES for x in stages.CONTROLLERS[controller]
    )
    return "cma" if rough else "gradient"


def spec_of(scenario: Scenario, controller: str) -> SimSpec:
    """Settings of the flights: the scenario's, with the gains that it gives to this controller.

    Raises:
        ConfigError: there is no such controller, a vehicle cannot go sideways, or the control
            period does not suit.
    """
    if controller not in stages.CONTROLLERS:
        raise ConfigError(f"--controller {controller}: there is {', '.join(stages.CONTROLLERS)}")
    for i, entry in enumerate(scenario.fleet):
        if any("sway" in able.missing_axes for able in entry.drive_limits()):
            raise ConfigError(
                f"scenario {scenario.name}: fleet[{i}] has no sway, and tuning flies steps to the "
                "side; give a scenario of vehicles that can go there"
            )
    names, controller_config = stages.CONTROLLERS[controller], scenario.controller
    same = (
        controller_config.stages or stages.CONTROLLERS[controller_config.name or "cascade"]
    ) == names
    stack, gains = stages.build_stack(names, controller_config.gains if same else {})
    spec = replace(scenario.sim_spec(), stages=stack, gains=gains, instrumented=())
    if spec.control_dt_s > 0.1 * LAST_S:
        raise ConfigError(
            f"scenario {scenario.name}: control_dt_s = {spec.control_dt_s:g} is too long to tune at"
        )
    return spec


class TuningProblem:
    """A tuning set up: vehicles, knobs, and the two sets of flights."""

    def __init__(self, settings: TuningSettings) -> None:
        """Build what is flown (host side).

        Raises:
            ConfigError: settings that cannot be used.
        """
        self.settings = settings
        self.spec = spec_of(settings.scenario, settings.controller)
        self.knobs = knobs.build_knobs(self.spec)
        self.robots = samples.select_robots(settings.scenario)
        groups = len(self.robots.labels) * len(COURSES)
        if settings.rollouts < groups:
            raise ConfigError(
                f"--rollouts {settings.rollouts}: {groups} at least, one for each of "
                f"{len(self.robots.labels)} robots on each of {len(COURSES)} courses"
            )
        if settings.generations < 1 or settings.seed < 0:
            raise ConfigError(
                f"--generations {settings.generations}, --seed {settings.seed}: give 1 or more "
                "generations and a seed of 0 or more"
            )
        self._flyer = TuningFlyer(self.spec, self.knobs)

    def flights(self, part: int) -> FlightSet:
        """Those of one part, ``TRAIN`` or ``HELD_OUT``."""
        return samples.sample_flights(
            self.robots,
            self.settings.rollouts,
            self.settings.seed,
            part,
            self.spec.control_dt_s,
            timed=kinds.keeps_time(self.spec),
            thrust_error=samples.THRUST_ERROR if self.settings.objective == "robust" else 0.0,
        )

    @cached_property
    def train(self) -> FlightSet:
        """The flights that candidates are judged by."""
        return self.flights(samples.TRAIN)

    def fly(self, settings: FloatArray, flights: FlightSet) -> FlightMeasures:
        """Measures [n] of one candidate [n_knob]."""
        batch_measures = self._flyer.fly(settings[None], flights)
        flight_measures: FlightMeasures = jax.tree.map(lambda leaf: leaf[0], batch_measures)
        return flight_measures

    def judge(self, flights: FlightSet, start: FlightMeasures) -> RelativeObjective:
        """The objective on some flights, relative to the gains that the search begins with."""
        return objectives.build_objective(self.settings.objective, flights.group, start)

    @cached_property
    def _judge(self) -> RelativeObjective:
        return self.judge(self.train, self.fly(np.zeros(len(self.knobs)), self.train))

    def evaluate(self, settings: FloatArray, *, gradients: bool, done: Done) -> Generation:
        """Fly candidates [c, n_knob] on the training flights."""
        slopes = None
        if gradients:
            by_measure, batch_measures = self._flyer.slopes(settings, self.train, done)
            slopes = self._judge.gradients(batch_measures, by_measure).tolist()
        else:
            batch_measures = self._flyer.fly(settings, self.train, done)
        return Generation(
            costs=self._judge.costs(batch_measures).tolist(),
            failed=np.asarray(batch_measures.failed).sum(axis=1).tolist(),
            gradients=slopes,
        )
